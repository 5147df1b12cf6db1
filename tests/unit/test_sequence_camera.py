"""Rows of one camera's sequence from a session, a renderer and rules whose answers are written down here."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from simulator import Scenario
from simulator.frame import FrameTruth, TrueSources
from simulator.mission.motion import MotionState
from simulator.mission.pointing import Pointing
from simulator.study.sequence import camera as module
from simulator.study.sequence.camera import Moment, SequenceCamera
from simulator.study.sequence.columns import error_columns, is_beyond, opening_columns, three_columns
from simulator.study.specification.requirements import Specification
from startracker.geometry.attitude import Attitude
from startracker.geometry.camera import Camera
from startracker.solution import MatchedStars, Solution, Status
from startracker.tracking.mekf import Innovation

TRUE = Attitude.from_radec_roll(40.0, 20.0, 10.0)
MOUNTING = Attitude.from_matrix([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]], "body", "camera")
ERROR_DEG = np.array([1e-3, -2e-3, 4e-3])
SIGMA_DEG = np.array([2e-3, 1e-3, 4e-3, 0.1, 0.2, 0.4])
NEES = 0.25 + 4.0 + 1.0
RATE_RAD_S = np.array([1e-3, 2e-3, -3e-3])
CAMERA_AXES = ("cross_x", "cross_y", "about_boresight")
BODY_AXES = ("roll", "pitch", "yaw")
LENS = Camera.from_fov(fov_deg=10.0, width=100, height=80)


def turned(vector_deg, attitude=TRUE):
    return Attitude.from_rotation_vector(np.radians(vector_deg), "camera", "camera") @ attitude


class Session:
    """What a `TrackingSession` would say, and what it was told."""

    def __init__(self, solution, **state):
        self.solution, self.calls, self.exposure_s = solution, [], None
        self.filter_attitude, self.covariance = turned(ERROR_DEG), np.diag(np.radians(SIGMA_DEG) ** 2)
        self.rate_rad_s, self.bias_rad_s = RATE_RAD_S + 1e-4, None
        known = {"mode": "tracking", "innovation": Innovation(True, 2.5, 3), "restarted": False, "distrusted": True}
        counts = {"windows": 7, "expected": 9, "matched": 2}
        self.state = SimpleNamespace(**known | counts | {"window_xy": None, "window_half_px": 5} | state)

    def update(self, image, t_s, **given):
        self.calls.append(("update", image, t_s, given))
        return self.solution

    def update_centroids(self, xy, flux, t_s, **given):
        self.calls.append(("update_centroids", xy, t_s, given))
        return self.solution

    def reset(self, prior, sigma_deg):
        self.calls.append(("reset", prior, sigma_deg))


class Rules:
    """Rules of operation with a verdict."""

    def __init__(self, image):
        self.verdict = SimpleNamespace(image=image)

    def expose(self, index, state, since_s, session, jitter):
        self.exposed = index, state, since_s, jitter
        return FRAME, truth()

    def columns(self, frame, solution, session):
        return {"rule": "one", "with_frame": frame is not None}

    def dropped(self, solution, session):
        return {"rule": "dropped"}

    def refused(self):
        return {"status": "suspended", "reason": "the Sun"}


IMAGE = np.zeros((80, 100))
FRAME = SimpleNamespace(image=IMAGE, camera=LENS, observer="here", saturation_dn=900.0, gain_e_per_dn=2.0)
SOLVED = Solution(
    Status.SOLVED,
    "as expected",
    turned(ERROR_DEG),
    np.diag(np.radians(SIGMA_DEG[:3]) ** 2),
    MatchedStars(
        np.array([[10.0, 10.0], [50.0, 40.0]]),
        np.array([11, 12]),
        np.array(["a", "b"]),
        np.array([1.0, 2.0]),
        np.ones(2),
        np.zeros((2, 2)),
    ),
    centroids=np.zeros((4, 2)),
    times_ms={"detect": 3.0, "solve": 4.0},
)
LOST = Solution(Status.NO_MATCH, "nothing fits")


def truth(tag_error_s=0.0, **changes):
    """Stars 11 (V 1.0), 12 (V 6.5) and 13 (V 9), a planet and a satellite in the field; star 14 is outside."""
    xy = np.array([[10.0, 10.0], [50.0, 40.0], [60.0, 60.0], [20.0, 20.0], [30.0, 30.0], [-9.0, 5.0]])
    known = {"name": np.array(list("abcdef")), "kind": np.array(["star"] * 3 + ["planet", "satellite", "star"])}
    values = {name: np.ones(6) for name in ("b_v", "electrons")}
    sources = TrueSources(
        np.array([11, 12, 13, 0, 5, 14]),
        **known,
        xy=xy,
        image_xy=xy,
        direction=np.ones((6, 3)),
        v_mag=np.array([1.0, 6.5, 9.0, 2.0, 3.0, 1.0]),
        variable=np.zeros(6, bool),
        **values,
    )
    given = {"excluded": ("Sun", "Moon"), "time_tag_error_s": tag_error_s}
    return FrameTruth(TRUE, MOUNTING, RATE_RAD_S, 100.0, sources, **{**given, **changes})


class Renderer:
    def __init__(self, scenario, truth_):
        self.scenario, self.exposure_s, self.truth = scenario, 0.2, truth_
        self.scenes = SimpleNamespace(clock=SimpleNamespace(isot=lambda t_s: f"{t_s:g} s after"))

    def frame(self, index, **given):
        self.asked = index, given
        return FRAME, self.truth


@pytest.fixture
def build(monkeypatch):
    """A camera with a session, whose frame takes 250 ms to render and 500 ms to track."""

    def made(session, *overrides, single=False, operated=None, frame_truth=None):
        scenario = Scenario.load("cubesat_ideal", overrides=["tracker.magnitude_limit=6.5", *overrides])
        tracker = SimpleNamespace(solve=lambda image, **known: SOLVED)
        monkeypatch.setattr(module, "tracker_of", lambda scenario, renderer: tracker)
        monkeypatch.setattr(module, "session_of", lambda *given: session)
        times = iter([1.0, 1.25, 1.75])
        monkeypatch.setattr(module, "clock", lambda: next(times))
        start = Pointing(TRUE, TRUE, TRUE, MOUNTING, RATE_RAD_S)
        camera = SequenceCamera(scenario, Renderer(scenario, frame_truth or truth()), start, single=single)
        camera.session, camera.operated = session, operated
        return camera

    return made


def moment(**given):
    return Moment(3, 1.5, MotionState(100.0, TRUE, RATE_RAD_S), **given)


def test_a_tracked_frame(build):
    """Every column of a frame: mounting (x, y, z of the camera are y, z, x of the body), 1-σ and their units."""
    session = Session(SOLVED, window_xy=np.ones((7, 2)))
    camera = build(session, frame_truth=truth(0.25))
    at_tag = turned(np.degrees(RATE_RAD_S * 0.25))
    session.filter_attitude = turned(ERROR_DEG, at_tag)
    taken = camera.take(moment())
    assert session.calls == [
        (
            "update",
            IMAGE,
            1.75,
            {"gyro_rad_s": None, "observer": "here", "saturation_dn": 900.0, "gain_e_per_dn": 2.0},
        )
    ]
    assert camera.renderer.asked == (
        3,
        {"at_s": 100.0, "attitude": TRUE, "rate_camera_rad_s": RATE_RAD_S, "jitter": None},
    )
    row = taken.row
    text = {"utc": "100 s after", "mode": "tracking", "status": "solved", "reason": "as expected"}
    counts = {"stars_in_field": 2, "bodies_in_field": 1, "satellites_in_field": 1, "excluded": "Sun, Moon"}
    stars = {"stars_detected": 4, "stars_matched": 2, "stars_misidentified": 0, "windows": 7, "stars_expected": 9}
    flags = {"restarted": False, "distrusted": True, "wrong": False, "beyond_specification": False}
    times = {"index": 3, "elapsed_s": 1.5, "t_s": 100.0, "render_ms": 250.0, "track_ms": 500.0}
    known = text | counts | stars | flags | times | {"innovation_distance2": 2.5, "innovation_freedom": 3}
    assert {name: row[name] for name in known} == known
    for k, (camera_axis, body_axis) in enumerate(zip(CAMERA_AXES, ("pitch", "yaw", "roll"), strict=True)):
        for axis in (camera_axis, body_axis):
            assert row[f"error_{axis}_deg"] == pytest.approx(ERROR_DEG[k], rel=1e-6)
            assert row[f"sigma_{axis}_deg"] == pytest.approx(SIGMA_DEG[k])
        name = "xyz"[k]
        assert row[f"true_rate_{name}_deg_s"] == pytest.approx(math.degrees(RATE_RAD_S[k]))
        assert row[f"rate_{name}_deg_s"] == pytest.approx(math.degrees(RATE_RAD_S[k] + 1e-4))
        assert row[f"sigma_rate_{name}_deg_s"] == pytest.approx(SIGMA_DEG[3 + k])
    assert row["nees"] == pytest.approx(NEES)
    assert row["true_ra_deg"] == at_tag.ra_deg
    assert (taken.window_half_px, taken.window_xy.shape, taken.frame, taken.solution) == (5, (7, 2), FRAME, SOLVED)
    assert build(Session(SOLVED)).take(moment()).window_xy.shape == (0, 2)
    assert not {"single_status", "rule", "true_bias_x_deg_h"} & row.keys()
    assert SequenceCamera(camera.scenario, camera.renderer, camera.start).single is False


def test_a_frame_that_is_used_by_the_rules(build):
    """The rules expose it and may clear pixels: the session gets their image."""
    cleared = IMAGE + 1.0
    session, rules = Session(SOLVED), Rules(cleared)
    shaking = SimpleNamespace(mean=lambda exposure_s: np.zeros(3), rate=lambda exposure_s: np.zeros(3))
    taken = build(session, operated=rules).take(moment(jitter=shaking))
    assert session.calls[0][1] is cleared
    assert rules.exposed[0] == 3
    assert rules.exposed[2:] == (1.5, shaking)
    assert (taken.row["rule"], taken.row["with_frame"], taken.row["status"]) == ("one", True, "solved")


def test_a_mounting_that_bends_is_an_error_of_the_body_alone(build):
    bent = np.radians([0.0, 0.0, 0.01])
    session = Session(SOLVED)
    session.filter_attitude = turned([0.0, 0.0, 0.01])
    moved = truth(mounting_rotation_rad=bent)
    row = build(session, frame_truth=moved).take(moment(rotation_rad=bent)).row
    assert (row["mounting_x_deg"], row["mounting_z_deg"]) == (0.0, pytest.approx(0.01))
    assert row["error_about_boresight_deg"] == pytest.approx(0.01)
    assert row["error_roll_deg"] == pytest.approx(0.02, rel=1e-6)  # the mounting is not known: both add


@pytest.mark.parametrize(
    ("solution", "known", "mode", "beyond"),
    [
        (SOLVED, True, "tracking", True),
        (LOST, True, "coasting", False),
        (LOST, False, "none", False),
    ],
)
def test_modes(build, solution, known, mode, beyond):
    """1° off, forty times the limit of 0.025°: beyond the specification only in frames that are solved."""
    session = Session(solution, innovation=None)
    session.filter_attitude = turned([0.0, 0.0, 1.0]) if known else None
    session.covariance = np.diag(np.radians(np.full(6, 1.0)) ** 2) if known else None
    row = build(session).take(moment()).row
    assert (row["mode"], row["beyond_specification"]) == (mode, beyond)
    assert (row["innovation_freedom"], math.isnan(row["innovation_distance2"])) == (0, True)
    assert math.isnan(row["error_roll_deg"]) is not known
    assert math.isnan(row["rate_x_deg_s"]) is not known


def test_outcome_of_a_frame(build):
    """Star 12 is taken for 13: misidentified, so wrong; unless sky and tracker have catalogues of their own."""
    sources = truth().sources
    sources.id[:] = [11, 13, 12, 0, 5, 14]
    confused = FrameTruth(TRUE, MOUNTING, RATE_RAD_S, 100.0, sources)
    row = build(Session(SOLVED), frame_truth=confused).take(moment()).row
    assert (row["stars_misidentified"], row["misidentified"], row["wrong"]) == (1, True, True)
    camera = build(Session(SOLVED), single=True, frame_truth=confused)
    camera.same_catalog = False
    row = camera.take(moment()).row
    assert (row["stars_misidentified"], row["misidentified"], row["single_misidentified"]) == (0, False, False)


def test_the_same_frame_alone(build):
    """Solved without a session: the errors are those of its own solution."""
    session = Session(LOST)
    session.filter_attitude = None
    row = build(session, single=True).take(moment()).row
    assert row["status"] == "no_match"
    assert (row["single_status"], row["single_matched"], row["single_ms"]) == ("solved", 2, 7.0)
    assert row["single_error_cross_y_deg"] == pytest.approx(ERROR_DEG[1], rel=1e-6)
    assert row["single_error_yaw_deg"] == pytest.approx(ERROR_DEG[1], rel=1e-6)
    assert (row["single_misidentified"], row["single_inconsistent"], row["single_wrong"]) == (False, False, False)
    sources = truth().sources
    sources.id[0] = 99
    camera = build(Session(SOLVED), single=True, frame_truth=FrameTruth(TRUE, MOUNTING, RATE_RAD_S, 100.0, sources))
    assert camera.take(moment()).row["single_misidentified"]
    camera = build(Session(SOLVED), single=True)
    camera.tracker.solve = lambda image, **known: LOST
    row = camera.take(moment()).row
    assert (row["single_status"], row["single_matched"], row["single_wrong"]) == ("no_match", 0, False)
    assert math.isnan(row["single_error_roll_deg"])
    assert row["single_ms"] == 0.0


@pytest.mark.parametrize("rules", [None, Rules(IMAGE)])
def test_a_missing_frame_is_only_predicted(build, rules):
    """The true attitude has the mean jitter of the exposure, of 0.2 s."""
    session = Session(LOST)
    shaking = SimpleNamespace(
        mean=lambda exposure_s: np.array([exposure_s, 0.0, 0.0]) * 1e-3, rate=lambda exposure_s: np.array([0, 0, 1.0])
    )
    taken = build(session, single=True, operated=rules).take(
        moment(missing=True, jitter=shaking, gyro_rad_s=RATE_RAD_S)
    )
    row = taken.row
    assert (row["status"], row["reason"], row["mode"]) == ("no_frame", "no frame", "coasting")
    assert (row["single_status"], row["single_matched"], row["single_wrong"]) == ("no_frame", 0, False)
    assert math.isnan(row["single_ms"])
    assert math.isnan(row["render_ms"])
    assert (row["track_ms"], row["stars_in_field"], row["stars_misidentified"], row["excluded"]) == (0.0, 0, 0, "")
    assert (row["bodies_in_field"], row["satellites_in_field"]) == (0, 0)
    assert row.get("rule") == ("dropped" if rules else None)
    assert taken.frame is taken.truth is None
    assert (taken.window_half_px, taken.window_xy.shape) == (0, (0, 2))
    name, xy, at_s, given = session.calls[0]
    assert (name, xy.shape, at_s, list(given)) == ("update_centroids", (0, 2), 1.5, ["gyro_rad_s"])
    assert row["error_cross_x_deg"] == pytest.approx(ERROR_DEG[0] - math.degrees(2e-4), rel=1e-4)
    assert row["true_rate_z_deg_s"] == pytest.approx(math.degrees(RATE_RAD_S[2] + 1.0))


def test_frames_that_the_rules_refuse(build):
    """Discarded after it was taken, and compared with its own truth (the exposure of the rules is another one); and not
    taken at all, whatever the last verdict was."""
    session, rules = Session(LOST), Rules(None)
    own = FrameTruth(turned([1e-3, 0.0, 0.0]), MOUNTING, RATE_RAD_S, 100.0, truth().sources)
    rules.expose = lambda *given: (FRAME, own)
    taken = build(session, single=True, operated=rules).take(moment())
    row = taken.row
    assert (row["status"], row["reason"], row["rule"], row["with_frame"]) == ("suspended", "the Sun", "one", True)
    assert (row["render_ms"], row["track_ms"], row["stars_in_field"], row["single_status"]) == (
        250.0,
        0.0,
        2,
        "no_frame",
    )
    assert taken.frame is FRAME
    assert row["error_cross_x_deg"] == pytest.approx(0.0, abs=1e-8)
    assert session.calls[0][0] == "update_centroids"
    rules.expose, rules.verdict = lambda *given: None, SimpleNamespace(image=IMAGE)
    taken = build(Session(LOST), operated=rules).take(moment())
    row = taken.row
    assert (row["status"], row["with_frame"], row["stars_in_field"], taken.frame) == ("suspended", False, 0, None)
    assert math.isnan(row["render_ms"])
    assert "single_status" not in row
    assert taken.window_half_px == 0


GYRO = ("sequence.gyro={use: true, angle_random_walk_deg_sqrt_h: 6, bias_deg_h: 5}", "sequence.step_s=0.25")


def test_rates_of_a_gyro_have_its_noise(build):
    """6 °/√h are 0.1 °/√s: over 0.25 s the rate has 0.2 °/s besides the uncertainty of the bias, in °/h as well."""
    session = Session(SOLVED)
    session.bias_rad_s = np.radians([1.0, 2.0, 3.0]) / 3600.0
    known = {"gyro_rad_s": RATE_RAD_S, "bias_rad_s": np.radians([1.5, 2.5, 3.5]) / 3600.0}
    row = build(session, *GYRO).take(moment(**known)).row
    for k, axis in enumerate("xyz"):
        assert row[f"sigma_rate_{axis}_deg_s"] == pytest.approx(math.hypot(0.2, SIGMA_DEG[3 + k]))
        assert row[f"bias_{axis}_deg_h"] == pytest.approx(k + 1.0)
        assert row[f"true_bias_{axis}_deg_h"] == pytest.approx(k + 1.5)
        assert row[f"sigma_bias_{axis}_deg_h"] == pytest.approx(3600.0 * SIGMA_DEG[3 + k])


@pytest.mark.parametrize("missing", ["gyro_rad_s", "rate_rad_s", "covariance", "bias_rad_s"])
def test_what_is_not_known_has_no_number(build, missing):
    session = Session(SOLVED)
    session.bias_rad_s = np.zeros(3)
    if missing != "gyro_rad_s":
        setattr(session, missing, None)
    given = {"bias_rad_s": np.zeros(3), "gyro_rad_s": None if missing == "gyro_rad_s" else RATE_RAD_S}
    row = build(session, *GYRO).take(moment(**given)).row
    assert math.isnan(row["rate_x_deg_s"]) is (missing != "bias_rad_s")
    assert math.isnan(row["sigma_rate_x_deg_s"]) is (missing != "bias_rad_s")
    assert math.isnan(row["bias_x_deg_h"]) is (missing == "bias_rad_s")
    assert math.isnan(row["sigma_bias_x_deg_h"]) is (missing == "covariance")
    assert math.isfinite(row["true_rate_x_deg_s"])
    assert row["true_bias_x_deg_h"] == 0.0


@pytest.mark.parametrize(
    ("error_deg", "prior", "given", "sigma_deg"),
    [
        (6.0, True, True, 6.0 / math.sqrt(3.0)),
        (0.0, True, True, 0.1 / math.sqrt(3.0)),
        (6.0, False, True, None),
        (6.0, True, False, None),
    ],
)
def test_a_pass_begins_at_the_prior(build, error_deg, prior, given, sigma_deg):
    """Uniform within ± 6°: a standard deviation of 6°/√3, and never less than that of 0.1°."""
    session = Session(SOLVED)
    camera = build(session, f"pointing.error_deg={error_deg}", f"tracker.prior={str(prior).lower()}")
    camera.operated = Rules(IMAGE)
    camera.begin(None, TRUE if given else None)
    assert session.calls == ([("reset", TRUE, pytest.approx(sigma_deg))] if sigma_deg else [])
    assert camera.operated is None
    assert camera.calibrated is None


def test_the_rules_and_another_renderer(build, monkeypatch):
    camera = build(Session(SOLVED), "sequence.operation.use=true", "tracker.prior=false")
    monkeypatch.setattr(module, "OperatedCamera", lambda *given: SimpleNamespace(given=given))
    camera.begin(None, None)
    assert camera.operated.given == (camera.scenario, camera.renderer, camera.tracker)
    other = Renderer(Scenario.load("cubesat_ideal"), truth())
    other.exposure_s = 0.7
    camera.use(other)
    assert camera.renderer is camera.operated.renderer is other
    assert camera.scenario is camera.operated.scenario is other.scenario
    assert camera.session.exposure_s == 0.7


def test_errors_need_an_estimate_and_its_covariance():
    covariance = np.diag(np.radians(SIGMA_DEG[:3]) ** 2)
    whole = error_columns(TRUE, turned(ERROR_DEG), covariance, MOUNTING)
    assert len(whole) == 13
    assert all(math.isfinite(value) for value in whole.values())
    for estimate, known in ((None, covariance), (turned(ERROR_DEG), None), (None, None)):
        found = error_columns(TRUE, estimate, known, MOUNTING)
        assert found.keys() == whole.keys()
        assert all(math.isnan(value) for value in found.values())


def test_columns_in_their_units():
    found = three_columns("rate", "deg_s", np.array([1.0, 2, 3]), np.array([4.0, 5, 6]), np.array([7.0, 8, 9]), 10.0)
    names = [f"{kind}rate_{axis}_deg_s" for axis in "xyz" for kind in ("true_", "", "sigma_")]
    assert list(found.items()) == list(zip(names, [10.0, 40, 70, 20, 50, 80, 30, 60, 90], strict=True))
    unknown = three_columns("rate", "deg_s", np.array([1.0, 2, 3]), None, None, 10.0)
    assert [unknown[name] for name in names[::3]] == [10.0, 20.0, 30.0]
    assert all(math.isnan(unknown[name]) for name in names if not name.startswith("true"))
    assert opening_columns(1, 2.0, 3.0, "utc")["beyond_specification"] is False
    limits = Specification.of_limits({"cross_x": 0.01})
    row = {f"error_{axis}_deg": 0.09 for axis in (*BODY_AXES, *CAMERA_AXES)}
    assert not is_beyond(row, limits)
    assert is_beyond(row | {"error_cross_x_deg": 0.11}, limits)
