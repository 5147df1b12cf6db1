"""The summary of a sequence and of its heads from columns whose numbers are known."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from simulator.study.sequence.statistics import fused_nees, nees_test, summarise_heads, summarise_sequence

AXES = ("roll", "pitch", "yaw", "cross_x", "cross_y", "about_boresight")
JUDGEMENT = SimpleNamespace(by_name=lambda errors: {"limits": errors}, to_dict=lambda: {"passed": True})
STATUS = np.array(["no_match", "solved", "no_match", "too_few", "solved", "solved", "no_match", "solved"], dtype=object)
SOLVED = STATUS == "solved"


def columns_of(prefix="", **changes):
    """Eight frames, of which four are solved; errors of a frame in units of a degree are its number."""
    number = np.arange(8.0)
    columns = {
        f"{prefix}status": STATUS,
        f"{prefix}wrong": np.zeros(8, bool),
        f"{prefix}nees": np.where(SOLVED, 1.0 + number, np.nan),
        f"{prefix}stars_misidentified": np.array([0, 0, 0, 0, 2, 0, 0, 3]),
        f"{prefix}stars_matched": np.array([90, 10, 90, 90, 11, 12, 90, 15]),
        **{f"{prefix}error_{axis}_deg": np.where(SOLVED, number, np.nan) for axis in AXES},
    }
    return {**columns, **changes}


def sequence_columns(**changes):
    return {
        **columns_of(),
        "index": np.arange(8),
        "mode": np.array(["none", "lost_in_space", *["tracking"] * 5, "coasting"], dtype=object),
        "restarted": np.array([0, 1, 0, 0, 0, 1, 0, 0], bool),
        **{f"rate_{axis}_deg_s": np.full(8, 3.0) for axis in "xyz"},
        **{f"true_rate_{axis}_deg_s": np.where(SOLVED, 1.0, 99.0) for axis in "xyz"},
        **changes,
    }


def test_counts_and_times():
    found = summarise_sequence(sequence_columns(), 0.5, JUDGEMENT)
    assert (found["frames"], found["duration_s"], found["solved"], found["availability"]) == (8, 4.0, 4, 0.5)
    assert found["unsolved_by_status"] == {"no_match": 3, "too_few": 1}
    assert found["time_in_mode_s"] == {
        "tracking": 2.5,
        "prior": 0.0,
        "lost_in_space": 0.5,
        "coasting": 0.5,
        "none": 0.5,
    }
    assert (found["first_solution_s"], found["longest_outage_s"]) == (0.5, 1.0)
    assert (found["restarts"], found["stars_misidentified"], found["stars_matched_mean"]) == (2, 5, 12.0)
    assert found["rate_rms_deg_s"] == {"x": 2.0, "y": 2.0, "z": 2.0}
    rms = math.sqrt((1 + 16 + 25 + 49) / 4.0)
    assert found["errors_deg"]["roll"]["rms"] == pytest.approx(rms)
    assert found["specification"]["limits"]["yaw"] == pytest.approx(3.0 * rms)
    assert found["verdict"] == {"passed": True}
    assert found["beyond_specification"] == 0
    assert found["nees"]["mean"] == pytest.approx((2 + 5 + 6 + 8) / 4.0)
    assert not {"bias_error_deg_h", "scale_error_ppm", "single"} & found.keys()
    beyond = summarise_sequence(sequence_columns(beyond_specification=np.arange(8) > 5), 0.5, JUDGEMENT)
    assert beyond["beyond_specification"] == 2


def test_what_was_never_solved_has_no_numbers():
    none = sequence_columns(status=np.full(8, "no_match", dtype=object), stars_matched=np.zeros(8))
    found = summarise_sequence(none, 0.5, JUDGEMENT)
    assert (found["first_solution_s"], found["longest_outage_s"], found["stars_matched_mean"]) == (None, 4.0, None)
    assert found["rate_rms_deg_s"]["x"] is None
    assert found["nees"] == {"mean": None, "effective_frames": 0.0, "bounds95": None, "within": None}


def test_errors_of_the_gyro_are_those_at_the_end():
    bias = {f"bias_{axis}_deg_h": np.array([9.0] * 7 + [1.5]) for axis in "xyz"}
    true = {f"true_bias_{axis}_deg_h": np.array([9.0] * 7 + [1.0]) for axis in "xyz"}
    scale = {f"scale_{axis}_ppm": np.array([9.0] * 7 + [np.nan if axis == "z" else 30.0]) for axis in "xyz"}
    known = {f"true_scale_{axis}_ppm": np.array([9.0] * 7 + [50.0]) for axis in "xyz"}
    found = summarise_sequence(sequence_columns(**bias, **true, **scale, **known), 0.5, JUDGEMENT)
    assert found["bias_error_deg_h"] == {"x": 0.5, "y": 0.5, "z": 0.5}
    assert found["scale_error_ppm"] == {"x": -20.0, "y": -20.0, "z": None}


def test_single_frames_are_compared_where_both_are_solved():
    """Errors alone three times as large where both are solved, and huge elsewhere."""
    alone = np.array([False, True, True, False, True, False, False, False])
    errors = np.where(alone & SOLVED, 3.0 * np.arange(8.0), 1e6)
    single = {
        "single_status": np.where(alone, "solved", "no_match").astype(object),
        "single_wrong": np.zeros(8, bool),
        **{f"single_error_{axis}_deg": errors for axis in AXES},
    }
    found = summarise_sequence(sequence_columns(**single), 0.5, JUDGEMENT)["single"]
    assert (found["solved"], found["availability"]) == (3, 0.375)
    assert all(found["gain"][axis] == pytest.approx(3.0) for axis in AXES)
    assert found["errors_deg"]["roll"]["max"] == 1e6
    exact = sequence_columns(**single, error_yaw_deg=np.zeros(8))
    assert summarise_sequence(exact, 0.5, JUDGEMENT)["single"]["gain"]["yaw"] is None
    unknown = sequence_columns(**{**single, "single_error_yaw_deg": np.full(8, np.nan)})
    assert summarise_sequence(unknown, 0.5, JUDGEMENT)["single"]["gain"]["yaw"] is None


def test_bounds_of_a_mean_follow_the_effective_number():
    nees = np.array([2.0, np.nan, 4.0, 3.0, np.inf])
    found = nees_test(nees, 7.5)
    assert (found["mean"], found["effective_frames"]) == (3.0, 7.5)
    assert found["bounds95"] == pytest.approx(stats.chi2.ppf([0.025, 0.975], 22.5) / 7.5)
    assert found["within"] is True
    assert nees_test(nees + 9.0, 7.5)["within"] is False
    assert nees_test(nees - 2.5, 7.5)["within"] is False


def test_the_effective_number_of_a_fused_attitude_is_that_of_its_errors():
    """Σρ² over the positive pairs of lags of the errors about all three axes of the camera together."""
    rng = np.random.default_rng(1)
    n = 60
    u = np.cumsum(rng.normal(size=(3, n)), axis=1) * 0.2
    sigma = rng.uniform(1.0, 2.0, (3, n))
    columns = {"status": np.array(["solved"] * n, dtype=object), "nees": rng.chisquare(3, n)}
    for row, axis in enumerate(("cross_x", "cross_y", "about_boresight")):
        columns[f"error_{axis}_deg"], columns[f"sigma_{axis}_deg"] = u[row] * sigma[row], sigma[row]
    rho = [np.sum(u[:, k:] * u[:, : n - k]) / np.sum(u**2) for k in range(n)]
    total, k = 1.0, 1
    while k < n - 1 and rho[k] + rho[k + 1] > 0.0:
        total, k = total + 2.0 * (rho[k] ** 2 + rho[k + 1] ** 2), k + 2
    assert total > 3.0
    found = fused_nees(columns)
    assert found["effective_frames"] == pytest.approx(n / total)
    # frames that are not solved, or have no covariance, are left out
    columns["status"][::7], columns["nees"][3] = "no_match", np.nan
    kept = (columns["status"] == "solved") & np.isfinite(columns["nees"])
    fewer = {name: values[kept] for name, values in columns.items()}
    assert fused_nees(columns) == fused_nees(fewer)
    one = {name: values[1:2] for name, values in columns.items()}
    assert fused_nees(one)["effective_frames"] == 1.0
    none = {**columns, "status": np.full(n, "no_match", dtype=object)}
    assert fused_nees(none) == {"mean": None, "effective_frames": 0.0, "bounds95": None, "within": None}


@pytest.mark.parametrize(
    ("errors", "effective"),
    [
        ((1, 1), 2.0),  # a single lag is not a pair
        ((1, 1, 1), 3.0 / (1.0 + 2.0 * (4.0 + 1.0) / 9.0)),
        ((1, 0, 0, 1, 0), 5.0),  # the first pair is zero: what follows is not summed, though it is positive
        ((1, 1, -1, 1, 1), 5.0),  # products 5, 0, −1, 2, 1
        ((1, 1, 0, 1, 1), 5.0 / (1.0 + 2.0 * (4.0 + 1.0 + 4.0 + 1.0) / 16.0)),  # products 4, 2, 1, 2, 1
    ],
)
def test_pairs_of_lags_of_few_errors(errors, effective):
    n = len(errors)
    columns = {"status": np.full(n, "solved", dtype=object), "nees": np.ones(n)}
    for axis in ("cross_x", "cross_y", "about_boresight"):
        columns[f"error_{axis}_deg"], columns[f"sigma_{axis}_deg"] = 2.0 * np.array(errors), np.full(n, 2.0)
    assert fused_nees(columns)["effective_frames"] == pytest.approx(effective)


def test_numbers_of_each_head():
    prefix = "head_a_"
    columns = {
        **columns_of(prefix),
        f"{prefix}update": np.array(["", "started", "", "", "used", "used", "", "rejected"], dtype=object),
        f"{prefix}agreement": np.array(["consistent"] * 6 + ["moved"] * 2, dtype=object),
    }
    scenario = SimpleNamespace(heads=[SimpleNamespace(name="a")], sequence=SimpleNamespace(step_s=0.5))
    found = summarise_heads(columns, scenario)["a"]
    assert (found["solved"], found["availability"], found["longest_outage_s"]) == (4, 0.5, 1.0)
    assert found["unsolved_by_status"] == {"no_match": 3, "too_few": 1}
    assert (found["stars_misidentified"], found["stars_matched_mean"]) == (5, 12.0)
    assert found["agreement"] == {"consistent": 6, "moved": 2}
    used = {"started": 1, "used": 2, "rejected": 1, "realigned": 0, "restarted": 0, "too_late": 0}
    assert found["filter"] == used
    assert found["errors_deg"]["roll"]["max"] == 7.0
    assert found["nees"]["mean"] == pytest.approx(5.25)
    assert "alignment_arcsec" not in found
    ends = np.array([9.0] * 7 + [1.0])
    for axis in "xyz":
        columns[f"{prefix}true_alignment_{axis}_arcsec"] = 4.0 * ends
        columns[f"{prefix}alignment_{axis}_arcsec"] = 5.0 * ends
        columns[f"{prefix}sigma_alignment_{axis}_arcsec"] = np.where(ends > 1.0, ends, np.nan)
    never = {**columns, f"{prefix}status": np.full(8, "no_match", dtype=object)}
    assert summarise_heads(never, scenario)["a"]["stars_matched_mean"] is None
    found = summarise_heads(columns, scenario)["a"]["alignment_arcsec"]
    assert found == {axis: {"true": 4.0, "estimated": 5.0, "sigma": None} for axis in "xyz"}
