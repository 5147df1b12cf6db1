"""A sequence with several heads, part by part: what reaches the filter and when, priors, columns, and the mountings."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from star_sequences import SMALL_CAMERA

from simulator import Scenario
from simulator.frame import FrameTruth, TrueSources
from simulator.mission.gyro import GyroSamples
from simulator.mission.motion import MotionState
from simulator.mission.pointing import MOUNTINGS, local_level
from simulator.randomness import seed_of, stream
from simulator.study.sequence import head_camera as head_module
from simulator.study.sequence.head_camera import BodyState, HeadCamera
from simulator.study.sequence.heads import HeadsRunner, _alignment_columns, _Flight, _HeadFrame
from simulator.study.sequence.true_motion import jitter_at
from simulator.study.specification.requirements import Specification
from startracker.fusion import FusionStatus, Head, HeadStatus, Update
from startracker.geometry.attitude import Attitude
from startracker.geometry.camera import Camera
from startracker.solution import MatchedStars, Solution, Status
from startracker.tracking import RateNoise
from startracker.tracking.mekf import Innovation

ARCSEC = math.radians(1.0 / 3600.0)
BODY = Attitude.from_matrix(Attitude.from_radec_roll(40.0, 20.0, 10.0).as_matrix(), "icrs", "body")
TURN = Attitude.from_matrix([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]], "body", "camera")
STRAIGHT = Attitude([0.0, 0.0, 0.0, 1.0], "body", "camera")
RATE = np.array([0.01, 0.02, 0.03])
SOLVED = Solution(Status.SOLVED, "fits", TURN @ BODY, np.eye(3) * 1e-10)
LOST = Solution(Status.NO_MATCH, "nothing fits")


def turned(vector_deg, attitude):
    return Attitude.from_rotation_vector(np.radians(vector_deg), "camera", "camera") @ attitude


class Fusion:
    """A filter that says what is written down, and what it was told."""

    def __init__(self, mekf=None, updates=()):
        self.mekf, self.updates, self.told = mekf, iter(updates), []

    def estimate(self, t_s):
        self.told.append(("estimate", t_s))
        return self.mekf

    def add_gyro(self, start_s, end_s, turn):
        self.told.append(("gyro", start_s, end_s, turn.tolist()))

    def add_attitude(self, head, tag_s, attitude, covariance):
        self.told.append(("attitude", head, tag_s))
        return next(self.updates)

    def status(self, t_s):
        return FusionStatus("head_flagged", "head b moves", {"a": HeadStatus("consistent"), "b": HeadStatus("moving")})


class Mekf:
    """Head 0 is turned by TURN; body and bias have standard deviations of 1″, 2″, 3″ and 0.1, 0.2, 0.3 °/s."""

    covariance = np.diag(np.array([1.0, 2.0, 3.0, 360.0, 720.0, 1080.0]) * ARCSEC) ** 2
    bias_rad_s, rate_rad_s = np.radians([1.0, 2.0, 3.0]) / 3600.0, RATE + 1e-3
    scale, scale_sigma = np.array([1e-6, 2e-6, 3e-6]), np.array([4e-6, 5e-6, 6e-6])

    def __init__(self, error_deg=(0.0, 0.0, 0.0), sigma_deg=None):
        self.error_deg, self.sigma_deg = error_deg, sigma_deg

    def mounting(self, head):
        return TURN

    def head_attitude(self, head):
        return turned(self.error_deg, TURN @ BODY)

    def head_covariance(self, head):
        if self.sigma_deg is not None:
            return np.diag(np.radians(np.array(self.sigma_deg)) ** 2)
        matrix = TURN.as_matrix()
        return matrix @ self.covariance[:3, :3] @ matrix.T

    def alignment_rad(self, head):
        return np.array([10.0, 20.0, 30.0]) * ARCSEC

    def alignment_sigma_rad(self, head):
        return np.array([1.0, 2.0, 3.0]) * ARCSEC


class HeadOf:
    """One head whose frames are solved as given."""

    def __init__(self, name="a", solution=SOLVED, alignment_arcsec=0.0, prior=True):
        self.name, self.solution, self.asked = name, solution, []
        self.head = SimpleNamespace(alignment_sigma_arcsec=alignment_arcsec)
        self.misalignment_rad = np.array([11.0, 22.0, 33.0]) * ARCSEC
        self.filter_head = Head(name, TURN)
        self.renderer = SimpleNamespace(exposure_s=0.2)
        self.scenario = SimpleNamespace(tracker=SimpleNamespace(prior=prior))
        self.blind = False

    def sees(self, since_s):
        return not self.blind

    def missing(self):
        return {"status": "no_frame"}

    def take(self, k, state):
        return "frame", SimpleNamespace(time_tag_error_s=0.03)

    def solve(self, frame, prior, prior_deg):
        self.asked.append((prior, prior_deg))
        return self.solution

    def columns(self, frame, truth, solution):
        return {"status": str(solution.status)}

    def motion(self, state):
        return MotionState(state.t_s, TURN @ state.body, TURN.apply(state.rate_rad_s))

    def rotation_rad(self, state):
        return None


def flight(*cameras, delays=(0.0, 0.0), offsets=(0.0, 0.0), gyro=False, scale_ppm=0.0, fusion=None, step_s=0.5):
    """One pass over three rows, with the given filter."""
    cameras = cameras or (HeadOf("a"), HeadOf("b"))
    heads = [SimpleNamespace(delay_s=d, time_offset_s=o) for d, o in zip(delays, offsets, strict=True)]
    section = SimpleNamespace(
        step_s=step_s,
        gyro=SimpleNamespace(use=gyro, angle_random_walk_deg_sqrt_h=6.0, scale_factor_ppm=scale_ppm),
    )
    grid_s = [0.0, step_s, 2.0 * step_s]
    ends_s = sorted({t_s + offset for t_s in grid_s for offset in offsets})
    states = {t_s: BodyState(t_s, 100.0 + t_s, BODY, RATE, None) for t_s in ends_s}
    rates, biases = np.array([RATE] * (len(ends_s) - 1)), np.arange(3.0 * len(ends_s)).reshape(-1, 3) * ARCSEC
    runner = SimpleNamespace(
        scenario=SimpleNamespace(heads=heads, sequence=section, pointing=SimpleNamespace(error_deg=2.0)),
        cameras=list(cameras),
        noise=RateNoise(),
        gyro=GyroSamples(rates, biases, np.array([1.5e-6, 2.5e-6, 3.5e-6])) if gyro else None,
        ends_s=ends_s,
        grid_s=grid_s,
        states=states,
        start=SimpleNamespace(mounting=TURN, prior=TURN @ BODY),
        clock=SimpleNamespace(isot=lambda t_s: f"{t_s:g} s after"),
        specification=Specification.of_limits({"roll": 1e-3}),
    )
    runner.exposed = lambda head, k: states[grid_s[k] + offsets[head]]
    made = _Flight(runner)
    if fusion is not None:
        made.fusion = fusion
    return made


@pytest.mark.parametrize(
    ("delays", "offsets", "step_s", "memory_s"),
    [((0.0, 0.0), (0.0, 0.0), 0.5, 60.0), ((5.0, 40.0), (4.0, 2.0), 4.0, 124.0), ((40.0, 5.0), (0.0, 0.0), 4.0, 120.0)],
)
def test_the_memory_outlasts_the_longest_delay(delays, offsets, step_s, memory_s, monkeypatch):
    """Twice the longest delay from the step's time, and ten steps; at least a minute."""
    given = {}
    monkeypatch.setattr("simulator.study.sequence.heads.FusionFilter", lambda heads, noise, **kept: given.update(kept))
    flight(delays=delays, offsets=offsets, step_s=step_s)
    assert given == {"false_rejection": 1e-6, "memory_s": memory_s}


def test_what_has_arrived_reaches_the_filter_in_order():
    """Samples of the gyro up to the present, then attitudes by their arrival, not by their exposure."""
    fusion = Fusion(updates=[Update("started"), Update("restarted", Innovation(True, 2.5, 3)), Update("used")])
    made = flight(delays=(1.0, 0.2), offsets=(0.0, 0.25), gyro=True, fusion=fusion)
    first, second = made.take(0, 0), made.take(1, 0)
    assert (first.columns["update"], second.columns["update"]) == (None, None)
    fusion.told.clear()
    made.receive(0.45)
    assert fusion.told == [("attitude", 1, 0.25 + 0.03)]  # the sample to 0.25 s came with the exposure
    made.receive(0.5)
    assert fusion.told[1:] == [("gyro", 0.25, 0.5, pytest.approx((RATE * 0.25).tolist()))]
    assert (made._samples, made._restarted) == (2, False)
    made.receive(0.99)
    assert first.columns["update"] is None
    made.receive(1.0)
    assert fusion.told[-1] == ("attitude", 0, 0.03)
    assert (second.columns["update"], first.columns["update"]) == ("started", "restarted")
    assert math.isnan(second.columns["innovation_distance2"])
    assert first.columns["innovation_distance2"] == 2.5
    assert made._restarted
    made.receive(math.inf)
    assert (made._samples, fusion.told[-1][:3]) == (5, ("gyro", 1.0, 1.25))


@pytest.mark.parametrize(
    ("prior", "solution", "mode", "update"),
    [
        (True, SOLVED, "prior", None),
        (False, SOLVED, "lost_in_space", None),
        (True, Solution(Status.SOLVED, "", BODY, np.eye(3), prior_contradicted=True), "lost_in_space", None),
        (True, LOST, "none", ""),
        (True, Solution(Status.SOLVED, "", BODY, None), "none", ""),
    ],
)
def test_a_frame_of_a_head(prior, solution, mode, update, monkeypatch):
    times = iter([1.0, 1.25, 1.75])
    monkeypatch.setattr("simulator.study.sequence.heads.clock", lambda: next(times))
    made = flight(HeadOf("a", solution, prior=prior), HeadOf("b"), offsets=(0.25, 0.0), fusion=Fusion())
    taken = made.take(0, 0)
    assert (taken.head, taken.frame, taken.solution) == (0, "frame", solution)
    columns = taken.columns
    assert (columns["mode"], columns["update"], columns["elapsed_s"]) == (mode, update, 0.25)
    assert (columns["render_ms"], columns["track_ms"]) == (250.0, 500.0)
    assert math.isnan(columns["innovation_distance2"])
    assert len(made._arriving) == (update is None)


def test_a_head_without_a_frame():
    made = flight(fusion=Fusion())
    made.runner.cameras[1].blind = True
    taken = made.take(1, 0)
    assert (taken.frame, taken.solution.status, taken.columns["status"]) == (None, Status.NO_STARS, "no_frame")
    assert {name: taken.columns[name] for name in ("mode", "update", "render_ms", "track_ms", "elapsed_s")} == {
        "mode": "none", "update": "", "render_ms": 0.0, "track_ms": 0.0, "elapsed_s": 0.0
    }  # fmt: skip
    assert math.isnan(taken.columns["innovation_distance2"])
    assert not made._arriving


@pytest.mark.parametrize(
    ("sigma_deg", "width_deg"),
    [((0.003, 0.004, 0.0), 0.1), ((0.3, 0.4, 1.2), 6.5), ((1.0, 2.0, 2.0), 15.0), ((1.0, 2.0, 2.01), None)],
)
def test_the_filter_s_estimate_is_a_prior_within_five_sigmas(sigma_deg, width_deg):
    """Of all axes together; at least 0.1°, and none beyond the 15° of the tracker."""
    made = flight(fusion=Fusion(Mekf(sigma_deg=sigma_deg)), offsets=(0.0, 0.25))
    prior, found = made._prior(1, 2)
    assert made.fusion.told[-1] == ("estimate", 1.25)
    if width_deg is None:
        assert (prior, found) == (None, 1.0)
    else:
        assert found == pytest.approx(width_deg)
        assert prior.angle_to(TURN @ BODY) < 1e-9


def test_before_the_filter_has_an_attitude_only_the_first_frame_has_a_prior():
    made = flight(fusion=Fusion())
    prior, width_deg = made._prior(1, 0)
    assert prior.angle_to(TURN @ BODY) < 1e-9
    assert width_deg == 2.0
    made.runner.scenario.pointing.error_deg = 0.01
    assert made._prior(1, 0)[1] == 0.1
    assert made._prior(1, 1) == (None, 1.0)
    made.runner.cameras[1].scenario.tracker.prior = False
    assert made._prior(1, 0) == (None, 1.0)


def test_columns_of_the_filter():
    """Camera x, y, z are body y, z, x; the first head has no alignment to estimate, the second one has."""
    jitter = SimpleNamespace(mean=lambda s: np.array([0.0, 0.0, s]) * ARCSEC, rate=lambda s: np.array([s, 0.0, 0.0]))
    made = flight(
        HeadOf("a"), HeadOf("b", alignment_arcsec=60.0), gyro=True, scale_ppm=50.0, fusion=Fusion(Mekf((0.0, 0.0, 1.0)))
    )
    made.runner.states[0.5] = BodyState(0.5, 100.5, BODY, RATE, jitter)
    made.receive(0.5)
    made._restarted = True
    row = made.fused(1)
    known = {
        "index": 1, "elapsed_s": 0.5, "t_s": 100.5, "utc": "100.5 s after", "restarted": True, "distrusted": False,
        "windows": 0, "stars_expected": 0, "agreement": "head_flagged", "agreement_reason": "head b moves",
        "head_a_agreement": "consistent", "head_b_agreement": "moving", "beyond_specification": True,
    }  # fmt: skip
    assert {name: row[name] for name in known} == known
    assert row["error_about_boresight_deg"] == pytest.approx(1.0, rel=1e-6)
    assert row["error_roll_deg"] == pytest.approx(1.0, rel=1e-6)
    # body z is camera y, with the mean of the jitter over 0.2 s
    assert row["error_cross_y_deg"] == pytest.approx(-0.2 / 3600.0, rel=1e-3)
    assert row["sigma_cross_x_deg"] * 3600.0 == pytest.approx(2.0)
    assert row["sigma_roll_deg"] * 3600.0 == pytest.approx(1.0)
    white = 0.1 / math.sqrt(0.5)  # 6 °/√h over 0.5 s, in °/s
    true = RATE + np.array([0.2, 0.0, 0.0])
    for k, axis in enumerate("xyz"):
        body = (k + 1) % 3
        assert row[f"true_rate_{axis}_deg_s"] == pytest.approx(math.degrees(true[body]))
        assert row[f"rate_{axis}_deg_s"] == pytest.approx(math.degrees(RATE[body] + 1e-3))
        assert row[f"sigma_rate_{axis}_deg_s"] == pytest.approx(math.hypot(white, 0.1 * (body + 1)))
        assert row[f"bias_{axis}_deg_h"] == pytest.approx(k + 1.0)
        assert row[f"true_bias_{axis}_deg_h"] == pytest.approx(3.0 + k)
        assert row[f"sigma_bias_{axis}_deg_h"] == pytest.approx(360.0 * (k + 1))
        assert row[f"scale_{axis}_ppm"] == pytest.approx(k + 1.0)
        assert row[f"true_scale_{axis}_ppm"] == pytest.approx(k + 1.5)
        assert row[f"sigma_scale_{axis}_ppm"] == pytest.approx(k + 4.0)
        assert row[f"head_b_true_alignment_{axis}_arcsec"] == pytest.approx(11.0 * (k + 1))
        assert row[f"head_b_alignment_{axis}_arcsec"] == pytest.approx(10.0 * (k + 1))
        assert row[f"head_b_sigma_alignment_{axis}_arcsec"] == pytest.approx(k + 1.0)
    assert "head_a_alignment_x_arcsec" not in row
    assert made.fused(1)["restarted"] is False


def test_columns_before_the_filter_has_an_attitude():
    made = flight(HeadOf("a", alignment_arcsec=1.0), HeadOf("b"), gyro=True, scale_ppm=50.0, fusion=Fusion())
    made.receive(0.5)
    row = made.fused(1)
    unknown = ("qw", "error_roll_deg", "nees", "rate_x_deg_s", "sigma_rate_x_deg_s", "bias_y_deg_h", "scale_z_ppm")
    unknown += (
        "sigma_bias_x_deg_h",
        "sigma_scale_x_ppm",
        "head_a_alignment_x_arcsec",
        "head_a_sigma_alignment_x_arcsec",
    )
    assert all(math.isnan(row[name]) for name in unknown)
    assert row["beyond_specification"] is False
    assert row["head_a_true_alignment_x_arcsec"] == pytest.approx(11.0)


def test_rates_without_a_gyro_and_before_its_first_sample():
    made = flight(fusion=Fusion(Mekf()))
    row = made.fused(0)
    assert row["sigma_rate_x_deg_s"] == pytest.approx(0.2)
    assert not any("bias" in name or "scale" in name for name in row)
    made = flight(gyro=True, fusion=Fusion(Mekf()))
    row = made.fused(0)
    assert math.isnan(row["rate_x_deg_s"])
    assert math.isnan(row["sigma_rate_x_deg_s"])
    assert row["bias_x_deg_h"] == pytest.approx(1.0)
    assert not any("scale" in name for name in row)
    assert _alignment_columns(HeadOf("a"), 0, None) == {}


# ---------------------------------------------------------------------- rows
SUMS = ("stars_in_field", "bodies_in_field", "satellites_in_field")
SUMS += ("stars_detected", "stars_matched", "stars_misidentified")


def taken(head, solution=SOLVED, **changes):
    """A frame of a head whose counts are 10, 20, … plus its number."""
    counts = {name: 10 * k + head for k, name in enumerate(SUMS)}
    said = {"status": str(solution.status), "reason": solution.reason, "mode": "prior", "excluded": ""}
    rest = {"render_ms": 1.0 + head, "track_ms": 3.0 + head, "inconsistent_cause": "", "update": "used"}
    return _HeadFrame(head, f"frame {head}", solution, counts | said | rest | changes)


def fused(**changes):
    """A row of the filter with an error of twice the limit of 1e-3°."""
    axes = ("roll", "pitch", "yaw", "cross_x", "cross_y", "about_boresight")
    row = {f"error_{axis}_deg": 2e-3 if axis == "roll" else 0.0 for axis in axes}
    row |= {"nees": 1.0, "qw": 0.5, "agreement": "consistent", "agreement_reason": "", "beyond_specification": True}
    return row | {"misidentified": False, "inconsistent": False, "wrong": False, "inconsistent_cause": ""} | changes


def row_of(row, *frames):
    runner = SimpleNamespace(
        cameras=[SimpleNamespace(name="a"), SimpleNamespace(name="b")],
        specification=Specification.of_limits({"roll": 1e-3}),
    )
    return HeadsRunner._tracked(runner, row, list(frames))


def test_a_row_sums_its_heads():
    tracked = row_of(fused(), taken(0, excluded="Sun"), taken(1, LOST, mode="none", excluded="Moon, Earth"))
    row = tracked.row
    assert [row[name] for name in SUMS] == [1, 21, 41, 61, 81, 101]
    assert (row["render_ms"], row["track_ms"]) == (3.0, 7.0)
    assert row["excluded"] == "a: Sun, b: Moon, Earth"
    assert (row["head_a_status"], row["head_b_status"], row["head_b_stars_matched"]) == ("solved", "no_match", 41)
    assert (tracked.frame, tracked.solution, tracked.window_half_px) == ("frame 0", SOLVED, 0)
    assert tracked.window_xy.shape == (0, 2)
    assert row_of(fused(), taken(0), taken(1)).row["excluded"] == ""


@pytest.mark.parametrize(
    ("frames", "row", "mode", "status", "reason"),
    [
        ((taken(0, mode="lost_in_space"), taken(1)), fused(), "prior", "solved", ""),
        ((taken(0, LOST), taken(1, mode="lost_in_space")), fused(), "lost_in_space", "solved", ""),
        (
            (taken(0), taken(1)),
            fused(agreement="head_flagged", agreement_reason="head b moves"),
            "prior",
            "solved",
            "head b moves",
        ),
        (
            (taken(0), taken(1)),
            fused(agreement="heads_disagree", agreement_reason="why"),
            "prior",
            "heads_disagree",
            "why",
        ),
        (
            (taken(0), taken(1)),
            fused(agreement="gyro_disagrees", agreement_reason="why"),
            "prior",
            "gyro_disagrees",
            "why",
        ),
        ((taken(0, LOST), taken(1, LOST)), fused(), "coasting", "no_match", "nothing fits"),
        ((taken(0, LOST), taken(1, LOST)), fused(qw=math.nan), "none", "no_match", "nothing fits"),
        (
            (taken(0, LOST), taken(1)),
            fused(qw=math.nan),
            "none",
            "waiting",
            "no attitude has reached the filter",
        ),
    ],
)
def test_mode_and_status_of_a_row(frames, row, mode, status, reason):
    found = row_of(row, *frames).row
    assert (found["mode"], found["status"], found["reason"]) == (mode, status, reason)
    assert found["beyond_specification"] is (status == "solved")
    assert not found["wrong"]


@pytest.mark.parametrize(
    ("nees", "causes", "inconsistent", "cause"),
    [(31.0, ("noise", ""), False, ""), (32.0, ("", "noise"), True, "noise"), (32.0, ("", ""), True, "unknown")],
)
def test_outcome_of_the_filter(nees, causes, inconsistent, cause):
    """Stars are those of the heads: the filter itself misidentifies none, and is wrong beyond the specification."""
    frames = [taken(k, inconsistent_cause=causes[k]) for k in range(2)]
    row = row_of(fused(nees=nees, beyond_specification=False), *frames).row
    assert (row["inconsistent"], row["wrong"], row["inconsistent_cause"]) == (inconsistent, inconsistent, cause)
    assert row["misidentified"] is False
    assert row["beyond_specification"] is False


def test_rows_wait_for_their_attitudes(monkeypatch):
    """Head b is exposed later and arrives two steps late: rows come once theirs are known, the last ones at the end."""
    log = []

    class Flight_:
        def __init__(self, runner):
            self.fusion, self.waiting, self.now_s = "filter", [], 0.0

        def take(self, head, k):
            frame = taken(head, update=None, number=k)
            log.append(("take", head, k))
            self.waiting.append((0.5 * k + (1.0 if head == 1 else 0.0), frame))
            return frame

        def receive(self, now_s):
            log.append(("receive", now_s))
            for at_s, frame in self.waiting:
                if at_s <= now_s:
                    frame.columns["update"] = "used"

        def fused(self, k):
            log.append(("fused", k))
            return fused(index=k)

    monkeypatch.setattr("simulator.study.sequence.heads._Flight", Flight_)
    heads = [SimpleNamespace(time_offset_s=offset) for offset in (0.3, 0.0, 0.2)]
    runner = SimpleNamespace(
        scenario=SimpleNamespace(heads=heads),
        grid_s=[0.0, 0.5, 1.0, 1.5],
        cameras=[SimpleNamespace(name=name) for name in "abc"],
        specification=Specification.of_limits({"roll": 1e-3}),
    )
    runner._tracked = lambda row, frames: HeadsRunner._tracked(runner, row, frames)
    came = []
    for tracked in HeadsRunner.frames(runner):
        came.append((tracked.row["index"], len([entry for entry in log if entry[0] == "fused"])))
        assert tracked.row["head_c_number"] == tracked.row["index"]
        assert tracked.frame == "frame 0"
    assert runner.fusion == "filter"
    assert log[:5] == [("take", 1, 0), ("receive", 0.0), ("fused", 0), ("take", 2, 0), ("take", 0, 0)]
    assert came == [(0, 3), (1, 4), (2, 4), (3, 4)]
    assert log[-1] == ("receive", math.inf)


def test_the_body_at_all_rows_and_exposures(monkeypatch):
    """In the local level: its attitude by the orbit, its rate about −y; the jitter of the first camera in body axes."""
    monkeypatch.setattr(head_module, "tracker_of", lambda scenario, renderer: None)
    heads = "heads=[{name: a, mounting: orbit_normal}, {name: b, mounting: zenith, time_offset_s: 0.2}]"
    keys = [*SMALL_CAMERA[:-1], "pointing.error_deg=0", heads, "sequence.frames=3", "sequence.start_s=100"]
    runner = HeadsRunner(Scenario.load("cubesat_ideal", overrides=keys))
    times = [0.0, 0.2, 0.5, 0.7, 1.0, 1.2]
    assert list(runner.states) == runner.ends_s == pytest.approx(times)
    assert [runner.exposed(h, k).since_s for h in (0, 1) for k in range(3)] == pytest.approx(times[::2] + times[1::2])
    orbit = runner.cameras[0].renderer.scenes.orbit
    for state in runner.states.values():
        assert state.t_s == pytest.approx(100.0 + state.since_s)
        level = local_level(*orbit.state(state.t_s)).as_matrix()
        np.testing.assert_allclose(state.body.as_matrix(), level, atol=1e-9)
        assert state.rate_rad_s[1] == pytest.approx(-2.0 * math.pi / orbit.period_s, rel=0.01)
        assert state.jitter is None
    jittered = HeadsRunner(
        Scenario.load("cubesat_ideal", overrides=[*keys, "pointing.jitter={rms_arcsec: [9, 9, 9], corner_hz: 1}"])
    )
    scenes = jittered.cameras[0].renderer.scenes
    for state, path in zip(
        jittered.states.values(), jitter_at(jittered.scenario, scenes, jittered.ends_s), strict=True
    ):
        expected = path.mean(0.1) @ MOUNTINGS["orbit_normal"].as_matrix()
        np.testing.assert_allclose(state.jitter.mean(0.1), expected, atol=1e-15)
        assert np.abs(expected).max() > 1e-6


# ---------------------------------------------------------------------- one head
HEAD = "name: b, mounting: zenith, alignment_sigma_arcsec: 60, correlated_arcsec: [1, 2, 3], correlation_s: 30"


@pytest.fixture
def build(monkeypatch):
    def made(head="", *overrides):
        heads = f"heads=[{{name: a, mounting: orbit_normal}}, {{{HEAD}{head}}}]"
        scenario = Scenario.load("cubesat_ideal", overrides=[heads, *overrides])
        scenes = SimpleNamespace(mounting_rotation_rad=lambda t_s: None if t_s < 100.0 else np.array([0.0, 0.0, 1e-3]))
        frames = []

        def renderer(scenario, seed):
            def frame(index, **given):
                frames.append((index, given))
                return "frame", "truth"

            return SimpleNamespace(scenes=scenes, seed=seed, frame=frame, frames=frames, scenario=scenario)

        monkeypatch.setattr(head_module, "Renderer", renderer)
        monkeypatch.setattr(
            head_module, "tracker_of", lambda scenario, renderer: SimpleNamespace(solve=lambda image, **given: given)
        )
        return HeadCamera(scenario, scenario.heads[1])

    return made


def test_a_head_and_what_the_filter_knows_of_it(build):
    camera = build(", misalignment_arcsec: [10, 20, 30], bending_arcsec: 5, bending_s: 300")
    known, vector = MOUNTINGS["zenith"], np.array([10.0, 20.0, 30.0]) * ARCSEC
    np.testing.assert_allclose(known.rotation_vector_to(camera.mounting), vector, atol=1e-12)
    np.testing.assert_allclose(camera.misalignment_rad, vector)
    head = camera.filter_head
    assert (head.name, head.correlation_s, head.bending_s) == ("b", 30.0, 300.0)
    assert head.mounting.angle_to(known) < 1e-12
    assert head.alignment_sigma_rad == pytest.approx(60.0 * ARCSEC)
    assert head.correlated_sigma_rad == pytest.approx(tuple(k * ARCSEC for k in (1.0, 2.0, 3.0)))
    assert head.bending_sigma_rad == pytest.approx(5.0 * ARCSEC)
    assert camera.renderer.seed == seed_of(camera.scenario.seed, "head", "b")
    assert camera.same_catalog


def test_a_misalignment_is_drawn_and_bending_is_that_of_a_sine(build):
    """The rms of a sine is its amplitude over √2; the largest of the three axes counts, whatever its sign."""
    camera = build("", "pointing.thermo_elastic={amplitude_arcsec: [10, -40, 20], reference: node}")
    drawn = stream(seed_of(camera.scenario.seed, "head", "b"), "misalignment").standard_normal(3)
    np.testing.assert_allclose(camera.misalignment_rad, drawn * 60.0 * ARCSEC)
    assert camera.filter_head.bending_sigma_rad == pytest.approx(40.0 / math.sqrt(2.0) * ARCSEC)


def test_gaps_of_the_sequence_and_of_the_head(build):
    """Each begins with its first moment and ends before its last."""
    camera = build(", dropouts: [{start_s: 5, duration_s: 2}]", "sequence.dropouts=[{start_s: 1, duration_s: 2}]")
    seen = {0.9: True, 1.0: False, 2.9: False, 3.0: True, 4.9: True, 5.0: False, 6.9: False, 7.0: True}
    assert {t_s: camera.sees(t_s) for t_s in seen} == seen


def test_a_head_sees_the_motion_of_the_body_in_its_own_axes(build):
    camera = build(", misalignment_arcsec: [0, 0, 0]")
    mounting = MOUNTINGS["zenith"]
    still = camera.motion(BodyState(1.0, 7.0, BODY, RATE, None))
    assert still.t_s == 7.0
    assert still.camera.angle_to(mounting @ BODY) < 1e-12
    np.testing.assert_allclose(still.rate_camera_rad_s, mounting.as_matrix() @ RATE, atol=1e-12)
    bent = camera.motion(BodyState(1.0, 100.0, BODY, RATE, None))
    assert still.camera.rotation_vector_to(bent.camera) == pytest.approx([0.0, 0.0, 1e-3])
    axes = []
    jitter = SimpleNamespace(
        in_axes=lambda matrix: axes.append(matrix) or "in camera axes",
        mean=lambda exposure_s: np.array([exposure_s, 0.0, 0.0]),
        rate=lambda exposure_s: np.array([0.0, exposure_s, 0.0]),
    )
    state = BodyState(1.0, 7.0, BODY, RATE, jitter)
    assert camera.take(9, state) == ("frame", "truth")
    camera.take(10, state._replace(jitter=None))
    (index, given), (_, second) = camera.renderer.frames
    assert (index, given["at_s"], given["jitter"], second["jitter"]) == (9, 7.0, "in camera axes", None)
    assert given["attitude"].angle_to(still.camera) < 1e-12
    np.testing.assert_allclose(given["rate_camera_rad_s"], still.rate_camera_rad_s)
    np.testing.assert_allclose(axes[0], mounting.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(BODY.rotation_vector_to(state.jittered(1e-3)), [1e-3, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(state.jittered_rate_rad_s(0.5), RATE + np.array([0.0, 0.5, 0.0]))
    assert state._replace(jitter=None).jittered(1e-3) is BODY
    assert state._replace(jitter=None).jittered_rate_rad_s(1.0) is RATE


def test_columns_of_a_head(build):
    camera = build()
    xy = np.array([[10.0, 10.0], [50.0, 40.0], [20.0, 20.0]])
    sources = TrueSources(
        np.array([11, 12, 0]),
        np.array(list("abc")),
        np.array(["star", "star", "planet"]),
        xy, xy, np.ones((3, 3)), np.array([1.0, 99.0, 2.0]), np.ones(3), np.ones(3), np.zeros(3, bool),
    )  # fmt: skip
    true = TURN @ BODY
    frame = SimpleNamespace(camera=Camera.from_fov(fov_deg=10.0, width=100, height=80))
    truth = FrameTruth(true, TURN, RATE, 1.0, sources, excluded=("Sun", "Moon"))
    stars = MatchedStars(xy[:2], np.array([11, 77]), np.array(["", ""]), np.ones(2), np.ones(2), np.zeros((2, 2)))
    attitude, covariance = turned([0.0, 0.0, 1e-3], true), np.diag(np.radians([1e-3, 2e-3, 5e-4]) ** 2)
    solution = Solution(Status.SOLVED, "fits", attitude, covariance, stars, centroids=np.zeros((5, 2)))
    row = camera.columns(frame, truth, solution)
    known = {
        "status": "solved", "reason": "fits", "stars_in_field": 1, "bodies_in_field": 1, "satellites_in_field": 0,
        "excluded": "Sun, Moon", "stars_detected": 5, "stars_matched": 2, "stars_misidentified": 1,
        "misidentified": True, "wrong": True, "inconsistent": False,
    }  # fmt: skip
    assert {name: row[name] for name in known} == known
    assert row["error_roll_deg"] == pytest.approx(1e-3, rel=1e-6)
    assert row["sigma_about_boresight_deg"] == pytest.approx(5e-4)
    assert row["nees"] == pytest.approx(4.0, rel=1e-6)
    camera.same_catalog = False
    assert camera.columns(frame, truth, solution)["stars_misidentified"] == 0
    none = camera.missing()
    assert none.keys() == row.keys()
    assert all(none[name] == 0 for name in (*SUMS, "wrong"))
    assert (none["status"], none["reason"], none["excluded"]) == ("no_frame", "no frame", "")
    assert math.isnan(none["error_roll_deg"])
    image = SimpleNamespace(image="pixels", observer="here", saturation_dn=9.0, gain_e_per_dn=2.0)
    given = {"observer": "here", "saturation_dn": 9.0, "gain_e_per_dn": 2.0}
    assert camera.solve(image, BODY, 3.0) == {"prior": BODY, "prior_deg": 3.0, **given}
