"""What the targets are set for: frames, trials, identification, tracking, the database."""

import gc

import numpy as np
import pytest

from benchmarks.cases import CASES
from benchmarks.database import megabytes
from benchmarks.frames import FrameCase
from benchmarks.scenes import Case, SceneMaker
from benchmarks.speed.workload import CUBESAT, PLAIN, even_scenario, expose, renderer, scene, small_scenario
from simulator import Scenario
from simulator.study.star_tracker import build_tracker
from simulator.study.trials.blocks import run_block
from simulator.study.trials.trial import TrialRunner, solve_frame
from startracker import Attitude, Observer, StarTracker, TrackingSession, load_catalog
from startracker.catalog import guide as guides
from startracker.centroid import METHODS as CENTROIDERS
from startracker.detection import METHODS as DETECTORS
from startracker.field_solution import STATED_PX
from startracker.front_end import Clock, find_stars
from startracker.identification import METHODS
from startracker.identification.observed import Observed
from startracker.inputs import given_image
from startracker.settings import IdentificationSettings
from startracker.solution import Status

CASE = CASES["10deg 6.0, 0.1 px"]
SCENES, TRIALS, NOISE_PX = 2000, 25, 0.1


def test_cubesat_frame(timed):
    made = renderer(Scenario.load(CUBESAT))
    frame, _ = timed(made.frame, lambda index: index, 40)
    assert frame.image.shape == (1024, 1024)


def test_plain_frame(timed):
    made = renderer(even_scenario(1024, 200, *PLAIN))
    assert timed(lambda given: expose(made, *given), lambda index: (scene(made, index), index), 40).image.any()


def test_detection_and_centroids(timed):
    made = renderer(Scenario.load(CUBESAT))
    settings = made.scenario.tracker

    def find(frame):
        return find_stars(
            given_image(frame),
            DETECTORS[settings.detector],
            CENTROIDERS[settings.centroider],
            settings.detection,
            settings.centroid,
            Clock(),
        )

    assert len(timed(find, lambda index: made.frame(index)[0], 30).stars.xy) > 5


@pytest.mark.parametrize("rate_deg_s", [1, 3, 10])
def test_trailed(timed, rate_deg_s):
    """Frames at random attitudes, trailed across the line of sight."""
    made, solved = renderer(FrameCase("trailed", rate_deg_s=rate_deg_s).scenario("adaptive")), []
    tracker = build_tracker(made.scenario, made.camera)
    timed(lambda frame: solved.append(solve_frame(tracker, frame).solved), lambda index: made.frame(index)[0], 40)
    assert np.mean(solved) > 0.9


def test_small_trial(timed, benchmark):
    """A block of trials with its rows made into a table, as a run keeps them."""
    runner = TrialRunner(small_scenario())
    result = timed(
        lambda block: run_block(runner.run, block), lambda index: range(TRIALS * index, TRIALS * (index + 1)), 12, 1
    )
    status = result.table["status"].to_pylist()
    benchmark.extra_info |= {"trials": TRIALS, "solved": status.count("solved") / TRIALS}


def test_identification(timed, benchmark):
    maker, tracker = SceneMaker(CASE, 4), StarTracker(CASE.camera(), magnitude_limit=CASE.magnitude_limit)
    camera, guide, settings, solved = tracker.camera, tracker.guide, IdentificationSettings(), []

    def observed(index):
        scene = maker.scene(index)
        return Observed(camera.unproject(scene.xy), scene.flux, np.full(len(scene.xy), STATED_PX * camera.pixel_rad))

    def identify(seen):
        solved.append(METHODS["adaptive"](seen, guide, settings, None).status is Status.SOLVED)

    timed(identify, observed, SCENES, 20)
    benchmark.extra_info["solved"] = float(np.mean(solved[20:]))


def test_solve_centroids(timed):
    maker, tracker = SceneMaker(CASE, 4), StarTracker(CASE.camera(), magnitude_limit=CASE.magnitude_limit)
    timed(lambda given: tracker.solve_centroids(given.xy, given.flux), maker.scene, SCENES, 20)


def test_solve_centroids_observed(timed):
    """The camera and the tracker of `cubesat_ideal.yaml`, an observer in motion, and stated errors."""
    made = renderer(Scenario.load(CUBESAT))
    tracker, observer = (
        build_tracker(made.scenario, made.camera),
        Observer(2026.2, (10.0, -25.0, 12.0), (-0.9, 0.4, 0.2)),
    )
    guide = tracker.guide.apparent_to(observer)

    def field(index):
        rng = np.random.default_rng(index)
        while True:
            which, _, xy = guide.in_field(Attitude(rng.normal(size=4)).as_matrix())
            if 20 <= len(which) <= 40:
                return xy + NOISE_PX * rng.normal(size=xy.shape), 10.0 ** (-0.4 * guide.v_mag[which])

    timed(lambda given: tracker.solve_centroids(*given, sigma_px=NOISE_PX, observer=observer), field, SCENES, 20)


@pytest.mark.parametrize("points", [8, 15, 40, 100])
def test_no_sky(timed, points):
    case = Case(f"{points} random points", sky=False, false_stars=points)
    maker, tracker = SceneMaker(case, 4), StarTracker(case.camera(), magnitude_limit=case.magnitude_limit)
    assert not timed(lambda given: tracker.solve_centroids(given.xy, given.flux), maker.scene, 60).solved


def test_database(timed, benchmark):
    load_catalog("hipparcos")
    maker = SceneMaker(CASE, 4)
    first = maker.scene(0)

    def forget(_):
        guides._build.cache_clear()
        gc.collect()

    def build(_):
        tracker = StarTracker(CASE.camera(), magnitude_limit=CASE.magnitude_limit)
        tracker.solve_centroids(first.xy, first.flux)  # makes what is made when first asked for
        return tracker

    made = timed(build, forget, 8)
    benchmark.extra_info |= {"megabytes": megabytes(made.guide), "guide_stars": len(made.guide)}


def test_tracking(timed):
    session = TrackingSession(StarTracker(CASE.camera(), magnitude_limit=CASE.magnitude_limit))
    field, rng = SceneMaker(CASE, 4).scene(0), np.random.default_rng(1)

    def frame(index):
        return field.xy + 0.02 * rng.normal(size=field.xy.shape), field.flux, 0.1 * index

    timed(lambda given: session.update_centroids(*given), frame, 2000, 50)
    assert session.state.mode == "tracking"


def test_cubesat_trial(timed):
    runner = TrialRunner(Scenario.load(CUBESAT))
    assert timed(runner.run, lambda index: index, 40)["status"]
