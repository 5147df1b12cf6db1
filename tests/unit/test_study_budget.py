"""The error budget against errors that are put together from known parts, and on a small camera for real."""

import json
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pytest

from simulator.build import build_scenes
from simulator.scenario import Scenario
from simulator.study.axes import AXES
from simulator.study.budget import error_budget as module
from simulator.study.budget.effects import CLASSES, EFFECTS
from simulator.study.budget.error_budget import budget
from simulator.study.budget.outliers import find_outliers
from simulator.study.budget.plot import budget_figure
from startracker.errors import BoresightError, InputError

SMALL = ("detector.width=256", "detector.height=256", "optics.focal_length_mm=12", "optics.aperture_mm=8.5")
QUIET = (
    "detector.hot_pixel_fraction=0", "detector.dark_current_e_s=0", "detector.dsnu=0", "sky.background=false",
    "sky.light_deflection=false", "sky.planets=false", "sky.magnitude_limit=6.5", "detector.adc_bits=null",
    "detector.gain_e_per_dn=3", "pointing.target=[83.8, -1.2, 20.0]",
)  # fmt: skip
PARTS = {"shot": 3.0, "read": 2.0, "prnu": 1.0, "floor": 0.5}
N = 2000


def fake_run(scenario, trials, **_):
    """Errors in arcseconds as the sum of independent normal parts, each there where its effect is on."""
    on = {
        "shot": scenario.detector.shot_noise,
        "read": scenario.detector.read_noise_e > 0,
        "prnu": scenario.detector.prnu > 0,
        "floor": True,
    }
    parts = [PARTS[k] * np.random.default_rng([j, 5]).normal(size=trials) for j, k in enumerate(PARTS) if on[k]]
    table = {f"error_{axis}_deg": np.sum(parts, axis=0) / 3600 for axis in AXES}
    table |= {"status": ["solved"] * (trials - 1) + ["no_match"], "wrong": [False] * trials}
    return SimpleNamespace(table=pa.table(table), interrupted=False)


def test_known_parts_are_found(monkeypatch):
    """The mean of e² less that without, over N trials, is σ² plus twice the mean of σ z times the rest: its standard
    deviation is σ √(2 σ² + 4 rest²) / √N; four of these, in terms of the root: half of it over σ."""
    monkeypatch.setattr(module, "run_trials", fake_run)
    told = []
    found = budget(
        Scenario.load("cubesat_ideal", overrides=QUIET), N, progress=lambda done, total: told.append((done, total))
    )
    assert [row.name for row in found.effects] == ["shot noise", "read noise", "response non-uniformity"]
    total = sum(v * v for v in PARTS.values())
    for row, part in zip(found.effects, ("shot", "read", "prnu"), strict=True):
        sigma, rest = PARTS[part], total - PARTS[part] ** 2
        spread = 0.5 * np.sqrt((2 * sigma**2 + 4 * rest) / N)
        assert row.added_rms_deg("cross_x") * 3600 == pytest.approx(sigma, abs=4 * spread)
        low, high = row.interval_deg2["cross_x"]
        assert low < row.added_deg2["cross_x"] < high
        assert (high - low) * 3600**2 == pytest.approx(2 * 1.96 * 2 * sigma * spread, rel=0.25)
    assert [(row.name, row.kind) for row in found.classes] == [
        (CLASSES["pixel_spatial"], "pixel_spatial"),
        (CLASSES["temporal"], "temporal"),
    ]
    temporal = np.hypot(PARTS["shot"], PARTS["read"])
    spread = 0.5 * np.sqrt((2 * temporal**2 + 4 * (total - temporal**2)) / N)
    assert found.classes[1].added_rms_deg("about_boresight") * 3600 == pytest.approx(temporal, abs=4 * spread)
    assert found.remainder.rms_off_deg["cross_y"] * 3600 == pytest.approx(0.5, rel=4 / np.sqrt(2 * N))
    assert (found.solved, found.trials, found.effects[0].trials) == (N - 1, N, N - 1)
    assert not told  # the runs were not real
    assert budget(Scenario.load("cubesat_ideal", overrides=QUIET), N) == found
    entry = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert entry["effects"][0]["axes"]["cross_x"]["added_rms_deg"] == found.effects[0].added_rms_deg("cross_x")
    text = found.table()
    assert text.index("shot noise") < text.index("read noise") < text.index("response non-uniformity")
    figure = budget_figure(found)
    assert len(figure.axes) == 2
    assert next(label.get_text() for label in figure.axes[0].get_yticklabels()) == "shot noise"


@pytest.mark.parametrize("wrong", [False, True])
def test_one_outlier_is_named_and_belongs_to_no_effect(monkeypatch, wrong):
    """A trial off by 600″ with everything on, and in order as soon as anything is off: 180,000 / N square arcseconds
    would be added by each of three effects, 13.4″ in place of 3, 2 and 1."""

    def with_outlier(scenario, trials, **given):
        found = fake_run(scenario, trials, **given)
        on = scenario.detector.shot_noise and scenario.detector.read_noise_e > 0 and scenario.detector.prnu > 0
        if not on:
            return found
        columns = {name: found.table[name].to_pylist() for name in found.table.column_names}
        columns["error_cross_x_deg"][17] = 600.0 / 3600
        columns["wrong"][17] = wrong
        return SimpleNamespace(table=pa.table(columns), interrupted=False)

    monkeypatch.setattr(module, "run_trials", fake_run)
    plain = budget(Scenario.load("cubesat_ideal", overrides=QUIET), N)
    assert plain.outliers == ()
    monkeypatch.setattr(module, "run_trials", with_outlier)
    found = budget(Scenario.load("cubesat_ideal", overrides=QUIET), N)
    (outlier,) = found.outliers
    assert (outlier.index, outlier.axis, outlier.wrong) == (17, "cross_x", wrong)
    assert outlier.runs == ("all effects on",)
    assert outlier.error_deg == pytest.approx(600.0 / 3600)
    # robust sigma √(9 + 4 + 1 + 0.25) = 3.77″, good to some 3 % for 2000 trials
    assert outlier.sigmas == pytest.approx(600.0 / 3.775, rel=0.1)
    for row, before in zip((*found.effects, *found.classes), (*plain.effects, *plain.classes), strict=True):
        for axis in ("cross_x", "cross_y", "about_boresight"):
            assert row.added_rms_deg(axis) == pytest.approx(before.added_rms_deg(axis), rel=0.05)
    assert found.rms_deg["cross_x"] * 3600 == pytest.approx(3.775, rel=0.1)
    # with it: √(3.775² + 600²/2000) = 13.9″, set apart
    assert found.rms_with_outliers_deg["cross_x"] * 3600 == pytest.approx(np.hypot(3.775, 600 / np.sqrt(N)), rel=0.02)
    assert "outliers included" in found.table()
    assert found.solved == plain.solved - wrong
    assert found.effects[0].trials == plain.effects[0].trials - 1
    text = found.table()
    assert "trial 17" in text
    assert "600.000″ cross x" in text
    assert "in 1 of 6 runs; caused by 'shot noise' together with 'read noise'" in text
    entry = json.loads(json.dumps(found.to_dict(), allow_nan=False))["outliers"]
    assert [row["index"] for row in entry] == [17]


def test_outlier_of_the_scene_stays_in_every_run(monkeypatch):
    """One that no effect is the cause of is an outlier in all runs, and is said to belong to the scene."""

    def with_outlier(scenario, trials, **given):
        columns = {name: c.to_pylist() for name, c in zip(*_columns(fake_run(scenario, trials, **given)), strict=True)}
        columns["error_about_boresight_deg"][3] += 1.0
        return SimpleNamespace(table=pa.table(columns), interrupted=False)

    monkeypatch.setattr(module, "run_trials", with_outlier)
    (outlier,) = budget(Scenario.load("cubesat_ideal", overrides=QUIET), 200).outliers
    assert (outlier.index, outlier.axis) == (3, "about_boresight")
    assert len(outlier.runs) == outlier.of == 6
    assert "caused by the scene" in str(outlier)


def test_outlier_is_attributed_to_the_effect_without_which_it_is_gone():
    rng = np.random.default_rng(8)
    all_right = [np.ones(50, bool)] * 5
    names = ("all effects on", "shot noise", "cosmic rays", "temporal noise", "everything")
    errors = [rng.normal(size=(50, 3)) / 3600] * 5
    hit = [e.copy() for e in errors]
    for run in (0, 1):  # gone without the cosmic rays, and without the class that contains them
        hit[run][7, 0] = 90.0 / 3600
    (outlier,) = find_outliers(names, hit, all_right, all_right, None, names[1:3])
    assert (outlier.index, outlier.gone, outlier.cause) == (7, ("cosmic rays",), "caused by 'cosmic rays'")
    many = ("all effects on", *(f"effect {k}" for k in range(7)), "everything")
    hit = [errors[0].copy() for _ in many]
    hit[0][7, 0] = 90.0 / 3600
    (outlier,) = find_outliers(many, hit, [all_right[0]] * 9, [all_right[0]] * 9, None, many[1:-1])
    assert outlier.cause == "gone whichever of 7 effects is off: at a threshold of the tracker"
    hit = [errors[0].copy() for _ in many]
    hit[3][7, 0] = 90.0 / 3600
    (outlier,) = find_outliers(many, hit, [all_right[0]] * 9, [all_right[0]] * 9, None, many[1:-1])
    assert outlier.cause == "only without 'effect 2'"


def test_a_field_with_few_stars_is_no_outlier():
    """Of 400 fields one in ten has ten times the bound: 3 sigma there are 30 of the others, but not an outlier."""
    rng = np.random.default_rng(4)
    bound = np.where(np.arange(400) % 10 == 0, 10.0, 1.0)[:, None] * np.ones(3) / 3600
    errors, right = rng.normal(size=(400, 3)) * bound, np.ones(400, bool)
    assert len(find_outliers(("on",), [errors], [right], [right])) > 5
    assert find_outliers(("on",), [errors], [right], [right], bound) == ()
    errors[3, 1] = 12.0 / 3600  # of a good field
    bound[5] = np.nan
    (outlier,) = find_outliers(("on",), [errors], [right], [right], bound)
    assert outlier.index == 3
    # the robust standard deviation of 400 normal values is known to 1.17/√(2 × 400) × ... some 6 %
    assert outlier.sigmas == pytest.approx(12.0, rel=0.25)


def test_bias_that_is_switched_off_makes_no_outliers():
    """10″ of bias and 0.5″ of noise: without the bias, errors lie 20 sigma from where they were, and nearer to zero."""
    rng = np.random.default_rng(8)
    noise, all_right = rng.normal(size=(50, 3)) / 7200, np.ones(50, bool)
    runs = [noise + 10.0 / 3600, noise]
    assert find_outliers(("all effects on", "bias"), runs, [all_right] * 2, [all_right] * 2) == ()
    runs[1] = noise + 0.0
    runs[1][4, 1] = 150.0 / 3600
    (outlier,) = find_outliers(("all effects on", "bias"), runs, [all_right] * 2, [all_right] * 2)
    assert (outlier.index, outlier.axis, outlier.runs) == (4, "cross_y", ("bias",))
    assert find_outliers(("on",), [runs[1][:10]], [all_right[:10]], [all_right[:10]]) == ()  # too few to say


def _columns(found):
    return found.table.column_names, found.table.columns


def test_an_interrupt_keeps_what_is_done(monkeypatch):
    calls = []

    def stopped(scenario, trials, **_):
        calls.append(scenario)
        return SimpleNamespace(table=fake_run(scenario, trials).table, interrupted=len(calls) == 3)

    monkeypatch.setattr(module, "run_trials", stopped)
    found = budget(Scenario.load("cubesat_ideal", overrides=QUIET), 50)
    assert (found.interrupted, [row.name for row in found.effects], found.remainder) == (True, ["shot noise"], None)
    assert "Interrupted" in found.table()
    written = found.to_dict()
    assert (written["interrupted"], written["remainder"], len(written["effects"])) == (True, None, 1)
    calls.append(None)
    calls[:] = [None, None]
    with pytest.raises(BoresightError, match="no results"):
        budget(Scenario.load("cubesat_ideal", overrides=QUIET), 50)


def test_one_trial_is_no_budget():
    with pytest.raises(InputError, match="at least 2"):
        budget(Scenario.load("cubesat_ideal"), 1)


def test_every_effect_can_be_switched_off_in_every_shipped_scenario():
    for name in ("cubesat_ideal", "cubesat", "sunsat"):
        scenario = Scenario.load(name)
        for effect in EFFECTS:
            changes = effect.off(scenario)
            without = scenario.changed(changes)
            assert not effect.off(without), effect.name
            assert effect.kind in CLASSES


def test_errors_of_the_camera_are_effects():
    """Each is off in the cubesat and the thesis' satellite, and can be switched off alone in the flight camera."""
    names = {
        "calibration residual", "lateral colour", "decentring of the lens", "intra-pixel response", "time tag",
        "unresolved faint stars", "catalogue errors",
    }  # fmt: skip
    known = {effect.name: effect for effect in EFFECTS}
    flight = Scenario.load("cubesat")
    for name in names:
        assert not known[name].off(Scenario.load("cubesat_ideal"))
        assert not known[name].off(Scenario.load("sunsat")) or name == "catalogue errors"  # of bsc5
        without = flight.changed(known[name].off(flight))
        assert {other for other in names if known[other].off(without)} == names - {name}


def test_smear_off_is_a_camera_that_stands_still():
    scenario = Scenario.load("cubesat_ideal", overrides=["pointing.error_deg=0", "sky.magnitude_limit=3"])
    effect = next(effect for effect in EFFECTS if effect.name == "smear by rates")

    def rate(of):
        scene = build_scenes(of).scene(0, lambda stage: np.random.default_rng(1), 0.1, of.detector.exposure_s)
        return float(np.linalg.norm(scene.pointing.rate_camera_rad_s))

    # the orbital rate of the circular state and that of the nodal period differ by J2, some 1e-3
    assert rate(scenario.changed(effect.off(scenario))) < 5e-3 * rate(scenario)


def test_for_real():
    """Read noise of 60 electrons is most of what a small camera without other noise has."""
    overrides = [*SMALL, *QUIET, "detector.read_noise_e=60", "detector.shot_noise=false", "detector.prnu=0"]
    scenario = Scenario.load("cubesat_ideal", overrides=overrides)
    told = []
    found = budget(scenario, 4, progress=lambda done, total: told.append((done, total)))
    assert told[-1] == (3 * 4, 3 * 4)  # everything, one effect, nothing
    (row,) = found.effects
    assert (row.name, found.classes[0].name) == ("read noise", CLASSES["temporal"])
    assert row.added_deg2["cross_x"] > 0.5 * found.rms_deg["cross_x"] ** 2
    assert found.remainder.rms_off_deg == row.rms_off_deg


def test_the_table_and_the_file_have_the_same_numbers():
    """Arcseconds, and degrees; roots keep the sign of the square, and an interval has both ends or none."""
    third = {"cross_x": 1e6, "cross_y": -4e6, "about_boresight": 0.25e6}
    squares = {axis: value / 3600.0**2 for axis, value in third.items()}
    off = dict.fromkeys(third, 7000.0 / 3600.0)
    ends = {
        "cross_x": [-0.25e6 / 3600.0**2, 2.25e6 / 3600.0**2],
        "cross_y": [None, None],
        "about_boresight": [None, 1.0],
    }
    one = module.Contribution("one", "detector", off, squares, ends, 90, 91)
    two = module.Contribution("two", "optics", off, dict.fromkeys(third, 9e6 / 3600.0**2), ends, 90, 91)
    found = module.Budget(
        "name", 5, 100, 95, dict.fromkeys(third, 11000.0 / 3600.0), {}, (one, two), (two,), one,
        rms_with_outliers_deg=dict.fromkeys(third, 13000.0 / 3600.0),
    )  # fmt: skip
    lines = found.table().splitlines()
    assert lines[0] == "Error budget of name: 100 trials, seed 5"
    assert lines[3].split() == ["all", "effects", "on", *["11000.000"] * 3]
    rows = [line.split() for line in lines if line.startswith(("  one", "  two"))]
    assert [row[0] for row in rows] == ["two", "one", "two"]  # the largest about the first axis comes first
    assert rows[1] == ["one", "1000.000", "(-500.000", "to", "1500.000)", "-2000.000", "500.000"]
    assert any(line.split() == ["all", "effects", "off", *["7000.000"] * 3] for line in lines)
    assert any(line.split()[-3:] == ["13000.000"] * 3 for line in lines)
    assert "Interrupted" not in found.table()
    entry = found.to_dict()["effects"][0]
    assert (entry["name"], entry["class"], entry["trials"], entry["solved"]) == ("one", "detector", 90, 91)
    assert entry["axes"]["cross_y"]["added_rms_deg"] == pytest.approx(-2000.0 / 3600.0)
    assert entry["axes"]["cross_x"]["added_rms_interval95_deg"] == pytest.approx([-500.0 / 3600.0, 1500.0 / 3600.0])
    assert entry["axes"]["cross_y"]["added_rms_interval95_deg"] == [None, None]
    assert entry["axes"]["about_boresight"]["rms_off_deg"] == pytest.approx(7000.0 / 3600.0)
    assert found.to_dict()["remainder"] == entry
