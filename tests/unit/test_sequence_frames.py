"""Frames of a sequence in order: times, gaps, the gyro's samples, recorded motion; and its rows and identity."""

import math
import signal
from types import SimpleNamespace

import numpy as np
import pytest
from star_sequences import SMALL_CAMERA

from simulator import Scenario
from simulator.randomness import stream
from simulator.study.sequence import frames as frames_module
from simulator.study.sequence import run as run_module
from simulator.study.sequence.frames import SequenceRunner
from simulator.study.sequence.run import run_sequence
from simulator.study.sequence.true_motion import jitter_at, recorded_states
from startracker.errors import BoresightError, InputError
from startracker.geometry.attitude import Attitude

GYRO = "sequence.gyro={use: true, angle_random_walk_deg_sqrt_h: 1e-12, bias_deg_h: 0, bias_instability_deg_h: 0}"


@pytest.fixture
def build(monkeypatch):
    """A runner whose camera only writes down what it is given."""

    class Camera:
        tracker, operated, calibrated = "tracker", None, None

        def __init__(self, scenario, renderer, start, *, single):
            self.single = single

        def begin(self, noise, prior):
            self.began = noise, prior

        def take(self, moment):
            return moment

    monkeypatch.setattr(frames_module, "SequenceCamera", Camera)
    return lambda *overrides, **given: SequenceRunner(
        Scenario.load("cubesat_ideal", overrides=[*SMALL_CAMERA, "sequence.step_s=0.25", *overrides]), **given
    )


def test_times_gaps_and_states(build):
    """A gap begins with its first moment and ends before its last; frame 0 is 40 s after the epoch."""
    runner = build(
        "sequence.frames=8",
        "sequence.start_s=40",
        "sequence.dropouts=[{start_s: 0.5, duration_s: 0.5}, {start_s: 1.5, duration_s: 0.1}]",
    )
    moments = list(runner.frames())
    assert [moment.index for moment in moments] == list(range(8))
    assert [moment.since_s for moment in moments] == [0.25 * k for k in range(8)]
    assert [moment.state.t_s for moment in moments] == [40.0 + 0.25 * k for k in range(8)]
    assert [moment.index for moment in moments if moment.missing] == [2, 3, 6]
    assert runner.camera.began == (runner.noise, runner.start.prior)
    assert runner.camera.single is False
    assert all(one is None for m in moments for one in (m.gyro_rad_s, m.bias_rad_s, m.jitter, m.rotation_rad))
    assert runner.gyro is runner.biases is None


def test_a_gyro_measures_the_motion_since_the_last_frame(build):
    """Without any noise its rate is the rotation between the two frames divided by the step; jitter is in both."""
    jitter = "pointing.jitter={rms_arcsec: [20, 20, 20], corner_hz: 0.5, psd: lorentz}"
    runner = build("sequence.frames=5", GYRO, jitter)
    moments = list(runner.frames())
    assert moments[0].gyro_rad_s is None
    for k, moment in enumerate(moments):
        np.testing.assert_array_equal(moment.bias_rad_s, np.zeros(3))
        camera = moment.camera(runner.renderer.exposure_s)
        assert camera.angle_to(runner.cameras[k]) < 1e-12
        assert camera.angle_to(moment.state.camera) > 1e-7
        rate = moment.state.rate_camera_rad_s + moment.jitter.rate(runner.renderer.exposure_s)
        np.testing.assert_allclose(runner.rates[k], rate, atol=1e-15)
        if k:
            turn = runner.cameras[k - 1].rotation_vector_to(runner.cameras[k])
            np.testing.assert_allclose(moment.gyro_rad_s, turn / 0.25, atol=1e-12)
    drawn = runner.renderer.scenes.sequence_jitter(stream(runner.scenario.seed, "jitter", 0), 0.0)
    np.testing.assert_array_equal(moments[3].jitter.mean(0.1), drawn.shifted(0.75).mean(0.1))  # that of trial 0
    assert jitter_at(build().scenario, build().renderer.scenes, [0.0, 1.0]) == []


def test_a_mounting_that_bends_turns_the_camera(build):
    keys = ["pointing.thermo_elastic={amplitude_arcsec: [0, 60, 0], reference: node}", "sequence.frames=2"]
    bent, rigid = build(*keys), build("sequence.frames=2")
    for k, moment in enumerate(bent.frames()):
        turn = rigid.states[k].camera.rotation_vector_to(moment.state.camera)
        np.testing.assert_allclose(turn, moment.rotation_rad, atol=1e-12)
        assert np.abs(moment.rotation_rad).max() > 1e-5


def recording(tmp_path, times, name="attitudes.csv"):
    path = tmp_path / name
    lines = ["t_s,qx,qy,qz,qw,rate_x_rad_s,rate_y_rad_s,rate_z_rad_s"]
    lines += [f"{t_s!r},0,0,{math.sin(0.01 * k)},{math.cos(0.01 * k)},1,2,{k}" for k, t_s in enumerate(times)]
    path.write_text("\n".join(lines) + "\n")
    return path


def test_recorded_motion(build, tmp_path):
    """The camera of the table, mounting included: one frame more than needed, and times to a millionth of a second."""
    path = recording(tmp_path, [40.0, 40.25 + 9e-7, 40.5, 40.75])
    keys = ["pointing.thermo_elastic={amplitude_arcsec: [0, 60, 0], reference: node}", "sequence.start_s=40"]
    runner = build(f"sequence.recording={path}", "sequence.frames=3", *keys)
    for k, state in enumerate(runner.states):
        assert (state.t_s, state.rate_camera_rad_s.tolist()) == (40.0 + 0.25 * k, [1.0, 2.0, float(k)])
        angle = Attitude([0.0, 0.0, 0.0, 1.0]).rotation_vector_to(state.camera)
        np.testing.assert_allclose(np.abs(angle), [0.0, 0.0, 0.02 * k], atol=1e-12)
    scenes = runner.renderer.scenes
    late = runner.scenario.changed(
        {"sequence.recording": str(recording(tmp_path, [40.0, 40.25 + 2e-6, 40.5], "b.csv"))}
    )
    with pytest.raises(InputError, match=r"b.csv:3: t_s is 40.250002, but frame 1 is at 40.25 s"):
        recorded_states(late, scenes, runner.since_s)
    early = runner.scenario.changed(
        {"sequence.recording": str(recording(tmp_path, [40.0, 40.25 - 2e-6, 40.5], "c.csv"))}
    )
    with pytest.raises(InputError, match=r"c.csv:3: t_s is 40.249998, but frame 1 is at 40.25 s"):
        recorded_states(early, scenes, runner.since_s)
    with pytest.raises(InputError, match=r"has 4 of 5 frames; sequence.frames may be 4 at most"):
        recorded_states(runner.scenario, scenes, [0.25 * k for k in range(5)])
    assert len(recorded_states(runner.scenario, scenes, [0.0, 0.25, 0.5, 0.75])) == 4


# ---------------------------------------------------------------------- the whole
def row(index):
    axes = ("roll", "pitch", "yaw", "cross_x", "cross_y", "about_boresight")
    names = {"status": "solved", "mode": "tracking", "reason": "", "inconsistent_cause": "", "utc": ""}
    flags = dict.fromkeys(("wrong", "misidentified", "inconsistent", "beyond_specification", "restarted"), False)
    counts = {"index": index, "stars_misidentified": 0, "stars_matched": 9, "stars_in_field": 9, "stars_detected": 9}
    numbers = {"t_s": 0.5 * index, "elapsed_s": 0.5 * index, "nees": 3.0, "render_ms": index, "track_ms": 2.0 * index}
    errors = {f"{name}_{axis}_deg": 1e-4 for axis in axes for name in ("error", "sigma")}
    rates = {f"{prefix}rate_{axis}_deg_s": 0.0 for axis in "xyz" for prefix in ("", "true_")}
    return names | flags | counts | {name: float(value) for name, value in (numbers | errors | rates).items()}


@pytest.fixture
def rows(monkeypatch):
    """Sequences whose frames are made up."""

    class Runner:
        operated = calibrated = None

        def __init__(self, scenario, *, single=False):
            self.count = scenario.sequence.frames

        def frames(self):
            return (SimpleNamespace(row=row(k)) for k in range(self.count))

    monkeypatch.setattr(run_module, "SequenceRunner", Runner)
    monkeypatch.setattr(run_module, "_write", lambda sequence, folder, views, asked: ())
    times = iter(np.arange(100.0, 200.0, 2.5))
    monkeypatch.setattr(run_module, "clock", lambda: next(times))


def scenario_of(frames, *overrides):
    return Scenario.load("cubesat_ideal", overrides=[f"sequence.frames={frames}", "sequence.step_s=0.5", *overrides])


@pytest.mark.usefixtures("rows")
@pytest.mark.parametrize("flush", [1, 3, 7, 500])
def test_rows_in_pieces(monkeypatch, flush):
    monkeypatch.setattr(run_module, "_FLUSH_FRAMES", flush)
    told = []
    sequence = run_sequence(scenario_of(7), progress=lambda done, total: told.append((done, total)))
    assert sequence.columns["index"].tolist() == list(range(7))
    assert told == [(k, 7) for k in range(8)]
    summary = sequence.summary
    assert (summary["requested"], summary["interrupted"], summary["elapsed_s"]) == (7, False, 2.5)
    assert summary["median_ms"] == {"render": 3.0, "track": 6.0}
    assert summary["identity"]["amounts"] == {"frames": 7}
    assert not {"heads", "operation", "in_flight_calibration"} & summary.keys()
    # true positions and velocities of a low orbit beside the rows
    radius_km = np.linalg.norm([sequence.columns[name] for name in ("x_km", "y_km", "z_km")], axis=0)
    assert ((radius_km > 6_500.0) & (radius_km < 8_000.0)).all()


@pytest.mark.usefixtures("rows")
def test_an_interruption_keeps_the_frames_and_does_not_replace_more(tmp_path, monkeypatch):
    def stop(done, total):
        if done == 3:
            signal.raise_signal(signal.SIGINT)

    part = run_sequence(scenario_of(5), progress=stop)
    assert (part.summary["frames"], part.summary["requested"], part.summary["interrupted"]) == (3, 5, True)
    assert part.summary["identity"]["amounts"] == {"frames": 3}
    standing = SimpleNamespace(amounts={"frames": 3})
    monkeypatch.setattr(run_module, "standing", lambda folder, kind: standing)
    assert run_sequence(scenario_of(5), out=tmp_path, progress=stop).summary["frames"] == 3
    standing.amounts["frames"] = 4
    with pytest.raises(BoresightError, match=r"interrupted after 3 frames; .* run of 4"):
        run_sequence(scenario_of(5), out=tmp_path, progress=stop)
    assert run_sequence(scenario_of(5), out=tmp_path, progress=stop, force=True).summary["frames"] == 3


@pytest.mark.usefixtures("rows")
def test_parts_of_the_summary(monkeypatch):
    """Rules and calibration are summarised where the runner has them."""
    monkeypatch.setattr(run_module.SequenceRunner, "operated", "rules", raising=False)
    calibrated = SimpleNamespace(summarise=lambda columns: ("calibration", len(columns["index"])))
    monkeypatch.setattr(run_module.SequenceRunner, "calibrated", calibrated, raising=False)
    monkeypatch.setattr(run_module, "summarise_operation", lambda rules, columns, step_s: (rules, step_s))
    summary = run_sequence(scenario_of(2)).summary
    assert summary["operation"] == ("rules", 0.5)
    assert summary["in_flight_calibration"] == ("calibration", 2)


def test_frames_are_no_part_of_the_identity():
    """More frames of the same sequence continue it; another scenario, or frames solved alone as well, do not."""
    identity = run_module._identity
    known = identity(scenario_of(3), False, 3)
    assert (known.kind, known.seed, known.amounts) == ("sequence", scenario_of(3).seed, {"frames": 3})
    assert identity(scenario_of(9), False, 3).sha256 == known.sha256
    assert identity(scenario_of(3), True, 3).sha256 != known.sha256
    assert identity(scenario_of(3, "detector.exposure_s=0.123"), False, 3).sha256 != known.sha256
