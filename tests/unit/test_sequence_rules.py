"""The sensor's rules and its calibration within a sequence: columns and summaries from numbers written down here."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from simulator import Scenario
from simulator.mission.motion import MotionState
from simulator.study.sequence.calibration import CalibratedCamera
from simulator.study.sequence.operation import OperatedCamera, summarise_operation
from simulator.study.sequence.true_defects import compare_defects
from startracker.calibration.lens_filter import LensUpdate
from startracker.geometry.attitude import Attitude
from startracker.geometry.camera import Camera
from startracker.geometry.lens import change_lens
from startracker.settings import DetectionSettings, OperationSettings
from startracker.solution import MatchedStars, Solution, Status
from startracker.tracking.operation import Verdict

LENS = Camera.from_fov(fov_deg=10.0, width=100, height=80)
TRUE = Attitude.from_radec_roll(40.0, 20.0, 10.0)
FULL = 1000.0
ZERO_RATE = 1e4
"""Electrons per second of a star of V = 0."""
B_V = np.array([0.0, 1.0, np.nan, 0.5, 0.2])
TRUE_V = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
SKY = np.random.default_rng(1).normal(50.0, 3.0, (80, 100))


def magnitude_of_dn(flux):
    """2 e⁻/DN in 0.5 s: four electrons per second and DN."""
    return 2.5 * math.log10(ZERO_RATE / (4.0 * flux))


class Renderer:
    """A camera whose frames are given, and which says with what exposures they were asked for."""

    def __init__(self, image=SKY):
        self.camera, self.exposure_s, self.image, self.asked = LENS, 0.5, image, []
        photometer = SimpleNamespace(electrons_per_s=lambda v, b_v: np.float64(ZERO_RATE * 10 ** (-0.4 * v)))
        self.focal_plane = SimpleNamespace(photometer=photometer)

    def frame(self, k, **given):
        self.asked.append((k, given))
        return frame_of(self.image), "truth"


def frame_of(image):
    return SimpleNamespace(image=image, saturation_dn=FULL, gain_e_per_dn=2.0, exposure_s=0.5)


def operated(image=SKY, **changes):
    scenario = SimpleNamespace(sequence=SimpleNamespace(operation=OperationSettings(use=True, **changes)))
    catalog = SimpleNamespace(id=np.array([11, 12, 13, 14, 15]), b_v=B_V)
    tracker = SimpleNamespace(detection=DetectionSettings(), guide=SimpleNamespace(catalog=catalog))
    return OperatedCamera(scenario, Renderer(image), tracker)


def solution(ids=(11, 12, 13, 14, 15), flux=(250.0, 250.0, 250.0, 250.0, 0.0), saturated_at=3):
    """Stars: two of a known colour, one of an unknown one, one with a saturated pixel beside it, one without signal."""
    n = len(ids)
    xy = np.column_stack([10.0 * np.arange(n) + 10.0, np.full(n, 20.0)])
    stars = MatchedStars(
        xy, np.array(ids), np.array([""] * n), TRUE_V[:n], np.array(flux[:n], dtype=float), np.zeros((n, 2))
    )
    return Solution(Status.SOLVED, "", TRUE, np.eye(3), stars)


SESSION = SimpleNamespace(exposure_s=9.0, rate_rad_s=np.array([0.0, 0.0, 0.1]), filter_attitude=TRUE)
STATE = MotionState(7.0, TRUE, np.array([1.0, 2.0, 3.0]))


def test_the_exposure_of_the_rules_is_used_and_frames_with_the_sun_suspend():
    """At 0.1 rad/s the Sun's 0.6° take 0.105 s."""
    camera, session = operated(np.full((80, 100), FULL), shortest_exposure_s=0.01), SimpleNamespace(**vars(SESSION))
    camera.rules.exposure_s = 0.25
    assert camera.expose(4, STATE, 3.0, session, "shaking")[1] == "truth"
    k, given = camera.renderer.asked[0]
    assert (k, given["at_s"], given["attitude"], given["jitter"], given["exposure_s"]) == (
        4,
        7.0,
        TRUE,
        "shaking",
        0.25,
    )
    assert given["rate_camera_rad_s"] is STATE.rate_camera_rad_s
    assert (session.exposure_s, camera.exposure_s) == (0.25, 0.25)
    assert camera.refused() == {"status": "suspended", "reason": camera.verdict.reason}
    assert "no frame for 0.105 s" in camera.verdict.reason
    assert camera.expose(5, STATE, 3.1, session, None) is None
    assert camera.refused() == {"status": "suspended", "reason": "suspended until the Sun has passed"}
    assert len(camera.renderer.asked) == 1
    assert camera.expose(6, STATE, 3.2, session, None) is not None


@pytest.mark.parametrize(
    ("rule", "status"), [("sun", "suspended"), ("stale", "stale"), ("exposure", "discarded"), ("moon", "discarded")]
)
def test_status_of_a_refused_frame(rule, status):
    camera = operated()
    camera.verdict = Verdict(rule, "because", None)
    assert camera.refused() == {"status": status, "reason": "because"}


def test_columns_of_a_used_frame():
    """V 1 and 2 measured as 2.5 each, with errors of 1.5 and 0.5; stars 13 to 15 are left out."""
    image = SKY.copy()
    image[22, 42] = FULL
    camera = operated()
    cleared = np.zeros((80, 100), bool)
    cleared[:3, :4] = True
    camera.verdict, camera.exposure_s = Verdict("moon", "", SKY, (9, 5), cleared), 0.125
    learned = []
    camera.rules = SimpleNamespace(learn=lambda *given: learned.append(given), blemishes=cleared)
    frame, solved = frame_of(image), solution()
    row = camera.columns(frame, solved, SESSION)
    measured = magnitude_of_dn(250.0)
    assert measured == pytest.approx(2.5)
    assert row == {
        "exposure_s": 0.125,
        "rule": "moon",
        "saturated_px": 9,
        "cleared_px": 12,
        "magnitude_stars": 2,
        "magnitude_error_mean": pytest.approx(1.0),
        "magnitude_error_rms": pytest.approx(math.sqrt(1.25)),
        "blemished_px": 12,
    }
    np.testing.assert_allclose(camera.colours[0], [[0.0, 1.5], [1.0, 0.5]])
    assert learned == [(image, camera.verdict, TRUE, solved.stars)]
    # A star that is not in the catalogue has no colour; without any star there is no number
    row = camera.columns(frame, solution(ids=(99,)), SESSION)
    assert row["magnitude_stars"] == 0
    assert math.isnan(row["magnitude_error_mean"])
    assert math.isnan(row["magnitude_error_rms"])
    assert len(camera.colours) == 1
    assert len(learned) == 2


@pytest.mark.parametrize("missing", ["frame", "image", "solution"])
def test_what_is_not_used_teaches_nothing(missing):
    camera = operated()
    camera.rules = SimpleNamespace(learn=None, blemishes=np.zeros((2, 2), bool))
    camera.verdict = Verdict("", "", None if missing == "image" else SKY)
    solved = Solution(Status.NO_MATCH, "") if missing == "solution" else solution()
    row = camera.columns(None if missing == "frame" else frame_of(SKY), solved, SESSION)
    assert (row["saturated_px"], row["cleared_px"], row["magnitude_stars"], row["blemished_px"]) == (0, 0, 0, 0)
    assert math.isnan(row["magnitude_error_rms"])
    assert camera.colours == []


def test_a_missing_frame_has_no_verdict():
    camera = operated()
    camera.verdict = Verdict("moon", "", SKY, (9,))
    row = camera.dropped(solution(), SESSION)
    assert (row["rule"], row["saturated_px"], row["magnitude_stars"]) == ("", 0, 0)


def dark_of(*extra):
    """Dark signal at 2 s: of ten pixels three 18 e⁻, four 20 e⁻, three 22 e⁻ (MAD 2), besides a few others."""
    dark = np.tile([9.0, 10.0, 11.0, 9.0, 10.0, 11.0, 10.0, 9.0, 11.0, 10.0], (80, 10))
    dark[0, : len(extra)] = (20.0 + np.array(extra)) / 2.0
    return dark


LIMIT = 3.0 * math.sqrt(4.0**2 + 20.0 + (1.4826 * 2.0) ** 2)
"""Of 3 σ: read noise of 4 e⁻, shot noise of 20 e⁻, and the spread of the dark signal."""


@pytest.mark.parametrize("dead", [False, True])
def test_pixels_that_are_defective_and_those_that_may_be(dead):
    """Certain above twice the limit, possible above half of it; dead pixels are possible."""
    dark = dark_of(1.99 * LIMIT, 2.01 * LIMIT, 2.01 * LIMIT, 0.49 * LIMIT, 0.51 * LIMIT)
    pattern = SimpleNamespace(dark_e_s=dark, dead=None)
    if dead:
        pattern.dead = np.zeros((80, 100), bool)
        pattern.dead[5, 5] = True
    renderer = SimpleNamespace(
        detector=SimpleNamespace(pattern=pattern),
        camera=LENS,
        exposure_s=2.0,
        scenario=SimpleNamespace(detector=SimpleNamespace(read_noise_e=4.0)),
    )
    mapped = np.zeros((80, 100), bool)
    mapped[0, [0, 1, 3, 4, 7]] = mapped[5, 5] = True
    found = compare_defects(renderer, mapped, 3.0)
    assert found == {"mapped": 6, "certain": 2, "certain_mapped": 1, "sound_mapped": 2 if dead else 3}
    pattern.dark_e_s, pattern.dead = np.float64(3.0), None  # the same everywhere
    assert compare_defects(renderer, mapped, 3.0) == {"mapped": 6, "certain": 0, "certain_mapped": 0, "sound_mapped": 6}


def summary_of(colours):
    pattern = SimpleNamespace(dark_e_s=dark_of(2.01 * LIMIT), dead=None)
    camera = SimpleNamespace(
        renderer=SimpleNamespace(
            detector=SimpleNamespace(pattern=pattern),
            camera=LENS,
            exposure_s=2.0,
            scenario=SimpleNamespace(detector=SimpleNamespace(read_noise_e=4.0)),
        ),
        rules=SimpleNamespace(blemishes=np.eye(80, 100, dtype=bool), settings=OperationSettings(blemish_sigma=3.0)),
        colours=colours,
    )
    columns = {
        "status": np.array(
            ["discarded", "suspended", "suspended", "solved", "solved", "solved", "solved"], dtype=object
        ),
        "rule": np.array(["exposure", "sun", "sun", "moon", "moon", "moon", ""], dtype=object),
        "exposure_s": np.array([0.4, 0.2, 0.2, 0.1, 0.2, 0.2, 0.3]),
        "render_ms": np.array([1.0, 1.0, np.nan, 1.0, 1.0, 1.0, 1.0]),
    }
    return summarise_operation(camera, columns, 0.5)


def test_summary_of_the_rules():
    b_v = np.array([0.0, 0.5, 1.0, 1.5])
    error = 0.1 - 0.3 * b_v
    above, below = (np.column_stack([b_v, error + s]) for s in (0.02, -0.02))
    found = summary_of([above, below])
    assert (found["discarded"], found["suspended_s"], found["sun_frames"], found["moon_frames"]) == (1, 1.0, 1, 3)
    assert found["exposure_s"] == {"first": 0.4, "shortest": 0.1, "last": 0.3}
    assert found["blemishes"] == {"mapped": 80, "certain": 1, "certain_mapped": 1, "sound_mapped": 79}
    magnitudes = found["magnitudes"]
    both = np.concatenate([error + 0.02, error - 0.02])
    assert magnitudes == {
        "stars": 8,
        "mean": pytest.approx(both.mean()),
        "rms": pytest.approx(math.sqrt(np.mean(both**2))),
        "colour_slope": pytest.approx(-0.3),
        "std_without_colour": pytest.approx(0.02),
    }


def test_a_colour_slope_needs_eight_stars_of_different_colours():
    line = np.column_stack([np.arange(8.0), np.arange(8.0)])
    for few in (line[:7], np.column_stack([np.ones(9), np.arange(9.0)])):
        found = summary_of([few])["magnitudes"]
        assert (found["colour_slope"], found["std_without_colour"], found["stars"]) == (None, None, len(few))
        assert found["mean"] == pytest.approx(few[:, 1].mean())
    assert summary_of([line])["magnitudes"]["colour_slope"] == pytest.approx(1.0)
    assert set(summary_of([])["magnitudes"].values()) == {0, None}


# ---------------------------------------------------------------------- calibration in flight
CHANGE = {"f": 1e-4, "aspect": 2e-5, "cx": 0.25, "cy": -0.5, "k1": 1e-3}
VALUES, SIGMAS = np.array([1.2e-4, 3e-5, 0.2, -0.3, 2e-3]), np.array([1e-5, 2e-5, 0.1, 0.2, 5e-4])
COLUMNS = ("focal_length_ppm", "aspect_ppm", "principal_point_x_px", "principal_point_y_px", "distortion_k1")
FACTORS = (1e6, 1e6, 1.0, 1.0, 1.0)


def calibrated(*overrides, last=None):
    scenario = Scenario.load(
        "thermal",
        overrides=[f"tracker.in_flight_calibration={{use: true, parameters: [{', '.join(CHANGE)}]}}", *overrides],
    )
    true = change_lens(LENS, CHANGE)
    pattern = SimpleNamespace(dark_e_s=dark_of(1e6, 1e6), dead=None)
    renderer = SimpleNamespace(
        camera=LENS,
        exposure_s=2.0,
        scenario=scenario,
        focal_plane=SimpleNamespace(at=lambda t_s: SimpleNamespace(true_camera=true if t_s == 50.0 else LENS)),
        detector=SimpleNamespace(pattern=pattern),
    )
    tracker = SimpleNamespace(centroid=SimpleNamespace(psf_sigma_px=1.0), detection=DetectionSettings())
    camera = CalibratedCamera(scenario, renderer, tracker)
    mask = np.zeros((80, 100), bool)
    mask[0, :3] = True
    lens = SimpleNamespace(
        names=tuple(CHANGE),
        change=VALUES,
        sigma=SIGMAS,
        covariance=np.diag(SIGMAS**2),
        time_constant_s=np.array([10.0, 20.0, 30.0, 40.0, math.inf]),
        restarts=2,
        noise_factor=1.5,
    )
    xy = np.argwhere(mask)[:, ::-1]
    camera.calibration = SimpleNamespace(
        lens=lens, psf=SimpleNamespace(width_px=0.8, sigma_px=0.1), last=last, defects=SimpleNamespace(mask=mask, xy=xy)
    )
    return camera


@pytest.mark.parametrize("tracked", [True, False])
def test_columns_of_the_calibration(tracked):
    row = calibrated(last=LensUpdate(True, "", np.ones(1, bool), 7.5, 5)).columns(50.0, tracked=tracked)
    for k, (name, factor) in enumerate(zip(COLUMNS, FACTORS, strict=True)):
        assert row[name] == pytest.approx(factor * VALUES[k])
        assert row[f"sigma_{name}"] == pytest.approx(factor * SIGMAS[k])
        assert row[f"true_{name}"] == pytest.approx(factor * list(CHANGE.values())[k], rel=1e-9)
    assert (row["psf_width_px"], row["sigma_psf_width_px"], row["defective_px"]) == (0.8, 0.1, 3)
    assert (row["lens_updated"], row["lens_freedom"]) == ((True, 5) if tracked else (False, 0))
    assert row["lens_distance2"] == 7.5 if tracked else math.isnan(row["lens_distance2"])


def test_before_the_first_update_and_one_that_was_not_used():
    row = calibrated().columns(0.0, tracked=True)
    assert (row["lens_updated"], row["lens_freedom"], row["true_focal_length_ppm"]) == (False, 0, 0.0)
    row = calibrated(last=LensUpdate(False, "far", np.ones(1, bool), 99.0, 5)).columns(0.0, tracked=True)
    assert (row["lens_updated"], row["lens_distance2"]) == (False, 99.0)


@pytest.mark.parametrize(
    ("override", "width"),
    [
        ("optics.psf.sigma_px=0.6", math.hypot(0.6, 0.25)),  # 1.5 µm of diffusion in pixels of 6 µm
        ("optics.psf.model=diffraction", math.nan),
        ("optics.psf.sigma_px=null", math.nan),
    ],
)
def test_true_width_of_star_images(override, width):
    keys = ["detector.charge_diffusion_um=1.5", "detector.pixel_pitch_um=6", "optics.psf.model=gaussian", override]
    found = calibrated(*keys).true_width_px
    assert found == pytest.approx(width, nan_ok=True)


def summary_columns(camera, distance2=(math.nan, 3.0, 99.0, 4.0), updated=(False, True, False, True), width=0.5):
    columns = {"t_s": np.array([0.0, 10.0, 20.0, 50.0]), "lens_updated": np.array(updated)}
    row = camera.columns(50.0, tracked=True)
    for name in COLUMNS:
        for prefix in ("", "sigma_", "true_"):
            columns[f"{prefix}{name}"] = np.array([-1.0, -2.0, -3.0, row[f"{prefix}{name}"]])
    columns["lens_distance2"] = np.array(distance2)
    columns["psf_width_px"] = np.array([9.0, 9.0, 9.0, 0.8])
    columns["sigma_psf_width_px"] = np.array([9.0, 9.0, 9.0, 0.1])
    columns["true_psf_width_px"] = np.array([9.0, 9.0, 9.0, width])
    return columns


def test_summary_of_the_calibration():
    camera = calibrated("tracker.in_flight_calibration.defect_sigma=3", "detector.read_noise_e=4")
    found = camera.summarise(summary_columns(camera))
    error = (VALUES - np.array(list(CHANGE.values()))) / SIGMAS
    assert list(found["parameters"]) == list(COLUMNS)
    for k, (name, factor) in enumerate(zip(COLUMNS, FACTORS, strict=True)):
        assert found["parameters"][name] == {
            "value": pytest.approx(factor * VALUES[k]),
            "sigma": pytest.approx(factor * SIGMAS[k]),
            "true": pytest.approx(factor * list(CHANGE.values())[k]),
            "error_sigmas": pytest.approx(error[k]),
            "time_constant_s": [10.0, 20.0, 30.0, 40.0, None][k],
        }
    assert (found["frames_used"], found["frames_beyond_gate"], found["restarts"]) == (2, 1, 2)
    assert found["chi2"] == {
        "value": pytest.approx(np.sum(error**2)),
        "freedom": 5,
        "bounds95": pytest.approx(stats.chi2.ppf([0.025, 0.975], 5)),
        "within": True,
    }
    assert found["noise_factor"] == 1.5
    assert found["psf_width_px"] == {"value": 0.8, "sigma": 0.1, "true": 0.5}
    defects = found["defective_pixels"]
    assert defects == {
        "mapped": 3, "certain": 2, "certain_mapped": 2, "sound_mapped": 1, "xy": [[0, 0], [1, 0], [2, 0]]
    }  # fmt: skip


def test_at_most_200_defects_are_listed():
    camera = calibrated()
    camera.calibration.defects.xy = np.arange(402).reshape(201, 2)
    assert (
        camera.summarise(summary_columns(camera))["defective_pixels"]["xy"] == np.arange(400).reshape(200, 2).tolist()
    )


def test_a_calibration_beyond_its_bounds():
    for scale in (0.2, 5.0):
        camera = calibrated()
        camera.calibration.lens.covariance = np.diag(SIGMAS**2) / scale**2
        found = camera.summarise(summary_columns(camera, width=math.nan))
        assert found["chi2"]["within"] is False
        assert found["psf_width_px"]["true"] is None
