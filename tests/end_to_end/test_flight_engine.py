"""`tracker.engine: flight`: studies run the exported C of a scenario's camera, compiled once."""

import math
import os
import pickle
import threading
from pathlib import Path

import numpy as np
import pytest

from simulator.checks import load_scenario
from simulator.live.messages import solution_message
from simulator.live.mission import LiveMission
from simulator.study.axes import CAMERA_AXES
from simulator.study.datasheet.frames import DatasheetFrames
from simulator.study.exported_c.targets import HOST
from simulator.study.flight import library
from simulator.study.flight.engine import FlightEngine
from simulator.study.flight.library import FlightLibrary, Known, compiled_library
from simulator.study.flight.program import FlightProgram, list_text, velocity_of
from simulator.study.flight.session import FlightSession
from simulator.study.sequence.frames import SequenceRunner
from simulator.study.sequence.heads import HeadsRunner
from simulator.study.trackers import session_of
from simulator.study.trials.engine import run_trials
from simulator.study.trials.trial import TrialRunner, solve_frame
from startracker.errors import InputError
from startracker.flight.apparent import epoch_of
from startracker.geometry.attitude import Attitude
from startracker.solution import Status
from startracker.tracker import StarTracker

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(HOST.missing() is not None, reason="no gcc on this machine (Debian: gcc)"),
]

SMALL = ["detector.width=256", "detector.height=256", "detector.pixel_pitch_um=22", "detector.full_well_e=54000"]
"""The field of the cubesat's camera on a sixteenth of its pixels."""
FRAMES = 12
MODES = ["prior", "lost_in_space", "prior", "prior", "prior", "prior"]
"""Of a sequence: near the attitude of other sensors; five standard deviations after a second without a known rate are
more than a prior may have; near the prediction."""
TIMES = ("render_ms", "solve_ms", "background_ms", "detection_ms", "centroid_ms", "identification_ms", "attitude_ms")


def scenario_of(engine, *values):
    return load_scenario("cubesat_ideal", [f"tracker.engine={engine}", *SMALL, *values])


@pytest.fixture(scope="module", autouse=True)
def caches(tmp_path_factory):
    """An empty cache for this file, in which each library is compiled once."""
    folder = tmp_path_factory.mktemp("caches")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(folder))
        patch.delenv("CC", raising=False)
        yield folder


@pytest.fixture(scope="module")
def flight(caches):
    return TrialRunner(scenario_of("flight"))


@pytest.fixture(scope="module")
def reference():
    return TrialRunner(scenario_of("reference"))


@pytest.fixture(scope="module")
def design(flight):
    return flight.tracker.design


@pytest.fixture
def no_compiler(monkeypatch):
    """The compiler must not be called."""
    monkeypatch.setattr(library, "command", lambda words: pytest.fail("compiled again"))


def without_times(row):
    return {name: value for name, value in row.items() if name not in TIMES}


def test_rows_have_the_columns_of_the_reference_and_comparable_values(flight, reference):
    rows = [(flight.run(k), reference.run(k)) for k in range(FRAMES)]
    for ours, theirs in rows:
        assert {name: type(value) for name, value in ours.items()} == {n: type(v) for n, v in theirs.items()}
        assert ours["status"] == theirs["status"]
        assert ours["stars_misidentified"] == 0
        assert ours["stars_used"] == pytest.approx(theirs["stars_used"], abs=4)
    solved = [pair for pair in rows if pair[0]["status"] == "solved"]
    assert len(solved) > FRAMES // 2
    for axis in CAMERA_AXES:
        ours, theirs = np.array([[row[f"error_{axis}_deg"] for row in pair] for pair in solved]).T
        sigma = np.array([pair[1][f"sigma_{axis}_deg"] for pair in solved])
        # the same pixels: the difference of two estimates is a part of the error of one
        assert np.sqrt(np.mean(((ours - theirs) / sigma) ** 2)) < 0.5
    # NEES of 3 degrees of freedom: mean 3, standard deviation sqrt(6 / N)
    nees = np.mean([pair[0]["nees"] for pair in solved])
    assert abs(nees - 3.0) < 5.0 * math.sqrt(6.0 / len(solved))


def test_a_solution_describes_its_stars(flight):
    frame, truth = flight.renderer.frame(0)
    solution = solve_frame(flight.tracker, frame)
    stars = solution.stars
    assert solution.solved
    assert "identified" in solution.reason
    assert set(solution.times_ms) == {"detection", "identification", "total"}
    assert len(solution.centroids) >= len(stars) == solution.matched > 5
    assert np.isin(stars.catalog_id, truth.sources.id).all()
    # in units of the stated errors; their mean square is about 1, less the three fitted parameters
    assert 0.3 < np.mean((stars.residual_px / stars.sigma_px[:, None]) ** 2) < 2.0
    assert solution.observer is frame.observer
    assert solution.aberration_corrected
    assert solution.radec_of(stars.xy).shape == (len(stars), 2)


def test_the_library_answers_as_the_exported_program(flight, design, tmp_path):
    """Frames and a sequence of lists with the filter, bit for bit."""
    program, ours = FlightProgram(design, tmp_path), FlightLibrary(flight.tracker.library.file)
    lists = []
    for k in range(3):
        frame, _ = flight.renderer.frame(k)
        velocity, epoch = velocity_of(frame.observer.velocity_km_s), epoch_of(frame.observer.epoch_jyear)
        ours.read(frame.image, Known(velocity, epoch))
        answer, stars = ours.finish()
        assert answer == program.frames([frame.image], velocity, epoch)[0]
        lists.append((stars, velocity, epoch))
    texts, answers = [], []
    for k, (stars, velocity, epoch) in enumerate([lists[0]] * 3):
        texts.append(list_text(stars, velocity, time_us=k * 10**6, epoch=epoch))
        time, prior = ours.predict(k * 10**6)
        assert time == 0
        ours.solve_stars(stars, Known(velocity, epoch, k * 10**6, prior))
        answers.append((ours.take(), ours.answer()[0]))
    for (result, answer), expected in zip(answers, program.sequence(texts), strict=True):
        assert expected.counts == answer.counts | {"filter": result}
        assert expected._replace(counts={}) == answer._replace(counts={})


@pytest.mark.parametrize("arithmetic", ["fixed", "float"])
def test_the_filter_is_read_as_it_is_written(arithmetic, flight):
    """Its attitude and covariance are those of the answer that it replaces."""
    scenario = scenario_of("flight", f"tracker.flight.arithmetic={arithmetic}")
    runner = flight if arithmetic == "fixed" else TrialRunner(scenario)
    session, (frame, _) = session_of(runner.tracker), runner.renderer.frame(0)
    solution = session.update(frame, 0.0)
    assert session.tracker.design.arithmetic == arithmetic
    assert session.filter_attitude.angle_to(solution.attitude) < 1e-8
    assert session.covariance[:3, :3] == pytest.approx(solution.covariance, rel=1e-6, abs=1e-17)
    assert session.rate_rad_s.tolist() == session.bias_rad_s.tolist() == [0.0, 0.0, 0.0]
    # exported in whole units of 2^-20 rad/s: half of one is 1.4e-5 of 2 degrees a second
    assert session.covariance[3:, 3:].diagonal() == pytest.approx([session.noise.rate_sigma_rad_s**2] * 3, rel=3e-5)


def test_results_are_the_same_with_two_workers(flight):
    tables = [run_trials(flight.scenario, 6, workers=workers).table.drop_columns(list(TIMES)) for workers in (1, 2)]
    assert tables[0].equals(tables[1])


# ------------------------------------------------------------------ compiler and cache
def test_without_a_compiler_there_is_one_line(monkeypatch):
    monkeypatch.setenv("PATH", "/nonexistent")
    with pytest.raises(InputError, match=r"^tracker.engine: there is no C compiler here \(cc, gcc or clang\); install"):
        TrialRunner(scenario_of("flight"))
    monkeypatch.setenv("CC", "nothing -m64")
    with pytest.raises(InputError, match=r"^tracker.engine: CC=nothing: there is no such C compiler"):
        TrialRunner(scenario_of("flight"))


def test_what_only_the_design_shows_is_refused_by_key():
    with pytest.raises(InputError, match=r"^tracker.engine: .*pixels of at most 0.12°"):
        TrialRunner(scenario_of("flight", "detector.pixel_pitch_um=60"))


def test_a_library_is_compiled_once(design, flight, no_compiler):
    assert compiled_library(design) == flight.tracker.library.file
    other_seed = TrialRunner(flight.scenario.changed({"study.trials": 3}))
    assert other_seed.tracker.library.file == flight.tracker.library.file


def test_another_compiler_has_another_library(design, monkeypatch, tmp_path):
    monkeypatch.setattr(library, "command", lambda words: Path(words[words.index("-o") + 1]).write_bytes(b"built"))
    first = compiled_library(design, tmp_path)
    monkeypatch.setenv("CC", "gcc -g")
    assert compiled_library(design, tmp_path).parent != first.parent


@pytest.mark.parametrize("damage", [lambda b: b[: len(b) // 2], lambda b: b[:-1] + bytes([b[-1] ^ 1]), lambda b: b""])
def test_a_damaged_library_is_compiled_again(damage, design, flight, monkeypatch, tmp_path):
    whole, calls = flight.tracker.library.file.read_bytes(), []

    def compiler(words):
        calls.append(words)
        Path(words[words.index("-o") + 1]).write_bytes(whole)

    monkeypatch.setattr(library, "command", compiler)
    file = compiled_library(design, tmp_path)
    file.write_bytes(damage(whole))
    assert compiled_library(design, tmp_path) == file
    assert file.read_bytes() == whole
    assert len(calls) == 2
    assert [found.name for found in file.parent.glob("*.so")] == [file.name]


def test_two_compilations_at_the_same_time_leave_one_library(design, monkeypatch, tmp_path):
    both = threading.Barrier(2)

    def compiler(words):
        both.wait(60.0)  # neither has finished before the other begins
        Path(words[words.index("-o") + 1]).write_bytes(b"built")

    monkeypatch.setattr(library, "command", compiler)
    found = []
    threads = [threading.Thread(target=lambda: found.append(compiled_library(design, tmp_path))) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found[0] == found[1]
    assert [entry for entry in found[0].parent.iterdir() if entry.is_dir()] == []


def test_a_folder_that_cannot_be_written_is_named(design, tmp_path):
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(InputError, match=r"cannot be compiled there .*XDG_CACHE_HOME"):
        compiled_library(design, tmp_path / "file")


def test_a_library_is_loaded_again_by_another_process(flight):
    copy = pickle.loads(pickle.dumps(flight.tracker))
    frame, _ = flight.renderer.frame(0)
    assert copy.solve(frame).attitude.quat.tolist() == flight.tracker.solve(frame).attitude.quat.tolist()
    assert os.path.samefile(copy.library.file, flight.tracker.library.file)


# ------------------------------------------------------------------ lists, sequences
def test_lists_are_solved_with_the_stated_errors(flight):
    frame, _ = flight.renderer.frame(0)
    seen = flight.tracker.solve(frame)
    xy, flux, sigma = seen.stars.xy, seen.stars.flux, seen.stars.sigma_px
    order = np.argsort(flux)  # not brightest first
    again = flight.tracker.solve_centroids(xy[order], flux[order], sigma_px=sigma[order], observer=frame.observer)
    assert again.solved
    assert set(again.stars.catalog_id) == set(seen.stars.catalog_id)
    with pytest.raises(InputError, match="a flux and an error for every centroid"):
        flight.tracker.solve_centroids(xy, flux[:-1], sigma_px=sigma)
    nothing = flight.tracker.solve_centroids(np.empty((0, 2)), np.empty(0))
    assert nothing.status in (Status.NO_STARS, Status.TOO_FEW_STARS)
    assert nothing.attitude is None


def test_a_prior_that_is_wrong_is_contradicted(flight):
    frame, truth = flight.renderer.frame(0)
    alone = flight.tracker.solve(frame, lost_in_space=True)
    right = flight.tracker.solve(frame, prior=truth.attitude, prior_deg=0.5)
    elsewhere = Attitude.from_radec_roll(truth.attitude.ra_deg, truth.attitude.dec_deg, truth.attitude.roll_deg + 90.0)
    wrong = flight.tracker.solve(frame, prior=elsewhere, prior_deg=0.5)
    assert alone.solved
    assert right.solved
    assert not right.prior_contradicted
    assert wrong.solved
    assert wrong.prior_contradicted
    assert "outside the prior" in wrong.reason


@pytest.mark.parametrize("shape", [(10, 12), (10, 12, 3)])
def test_an_image_of_another_size_is_a_bad_image_for_the_reason_of_the_reference(flight, reference, shape):
    image = np.zeros(shape, np.uint16)
    expected = reference.tracker.solve(image)
    assert expected.status is Status.BAD_IMAGE
    for found in (flight.tracker.solve(image), FlightSession(flight.tracker).update(image, 0.0)):
        assert (found.status, found.reason) == (expected.status, expected.reason)


def test_a_uniform_image_is_a_bad_image(flight):
    uniform = flight.tracker.solve(np.full((256, 256), 100, np.uint16))
    assert uniform.status is Status.BAD_IMAGE
    assert "same value" in uniform.reason


@pytest.fixture(scope="module")
def sequences(caches):
    values = ["sequence.frames=10", "sequence.dropouts=[{start_s: 6, duration_s: 1}]", "sequence.step_s=1"]
    values.append("sequence.rate_walk_deg_s_sqrt_s=1e-6")
    runners = [SequenceRunner(scenario_of(engine, *values), single=True) for engine in ("flight", "reference")]
    return [[frame.row for frame in runner.frames()] for runner in runners]


def test_sequences_use_the_filter_of_the_flight_build(sequences):
    ours, theirs = sequences
    assert [list(row) for row in ours] == [list(row) for row in theirs]
    assert [row["status"] for row in ours] == [row["status"] for row in theirs]
    assert [row["mode"] for row in ours] == [*MODES, "coasting", "prior", "prior", "prior"]
    assert [row["restarted"] for row in ours] == [True] + [False] * 9
    assert all(row["innovation_freedom"] == 3 for row in ours[1:6])
    assert ours[-1]["sigma_cross_x_deg"] < 0.8 * ours[0]["sigma_cross_x_deg"]  # of ten frames
    for axis in CAMERA_AXES:
        error = np.array([row[f"error_{axis}_deg"] / row[f"sigma_{axis}_deg"] for row in ours])
        assert (np.abs(error) < 5.0).all()
    last = ours[-1]
    for axis in "xyz":
        assert (
            abs(last[f"rate_{axis}_deg_s"] - last[f"true_rate_{axis}_deg_s"]) < 5.0 * last[f"sigma_rate_{axis}_deg_s"]
        )


def test_a_session_refuses_times_that_do_not_advance(flight):
    session, (frame, _) = FlightSession(flight.tracker), flight.renderer.frame(0)
    assert session.update(frame, 10.0).solved
    back = session.update(frame, 9.0)
    assert back.status is Status.BAD_TIME
    assert back.attitude is None
    assert session.state.mode == "coasting"
    again = session.update(frame, 9.5)  # the second time before that of the filter, later than the first
    assert again.solved
    assert "clock was set back" in again.reason
    assert session.state.restarted


def test_a_session_begins_with_the_attitude_of_other_sensors(flight):
    session, (frame, truth) = FlightSession(flight.tracker), flight.renderer.frame(0)
    session.reset(truth.attitude, 0.3)
    assert session.filter_attitude is None
    session.update(frame, 0.0)
    assert session.state.mode == "prior"
    session.reset()
    session.update(frame, 0.0)
    assert session.state.mode == "lost_in_space"


def test_an_attitude_far_from_the_prediction_is_rejected_once(flight):
    session = FlightSession(flight.tracker)
    (one, _), (other, _) = flight.renderer.frame(0), flight.renderer.frame(1)
    for k in range(3):
        assert session.update(one, float(k)).solved
    before = session.filter_attitude
    first = session.update(other, 3.0)
    assert first.solved
    assert session.state.mode == "coasting"
    assert not session.state.solved
    assert session.filter_attitude.angle_to(before) < math.radians(1.0) < first.attitude.angle_to(before)
    assert session.update(other, 4.0).solved
    assert session.state.restarted


# ------------------------------------------------------------------ other studies
def test_heads_of_both_engines_are_fused():
    values = ["tracker.engine=reference", "sequence.frames=3", *SMALL]
    given = load_scenario("two_heads", values)
    heads = [given.heads[0].model_copy(update={"tracker": {"engine": "flight"}}), given.heads[1]]
    runner = HeadsRunner(given.changed({"heads": heads}))
    assert [type(camera.tracker) for camera in runner.cameras] == [FlightEngine, StarTracker]
    rows = [frame.row for frame in runner.frames()]
    assert {row["head_side_status"] for row in rows} == {row["head_zenith_status"] for row in rows} == {"solved"}
    assert all(row["mode"] != "none" for row in rows)


def test_a_live_mission_runs_it():
    mission = LiveMission(scenario_of("flight"))
    rows = [mission.step().tracked.row for _ in range(3)]
    assert [row["status"] for row in rows] == ["solved"] * 3
    assert mission.camera.session.noise == mission.camera.tracker.design.motion
    mission.set({"detector.exposure_s": 0.1})
    live = mission.step()
    assert live.tracked.row["status"] == "solved"
    assert solution_message(live, mission.camera.session, 1.0).mode == "prior"


def test_a_datasheet_solves_lists_with_false_stars():
    frames = DatasheetFrames(scenario_of("flight"))
    assert frames.trials(0, 2)["right"].all()
    assert frames.with_false_stars(0, 2, 10)["right"].all()
