"""The detector on simulated frames, whose stars are known. Run with `pytest` after `pip install .`."""

import numpy as np
import pytest
from boresight_sep import find_with_sep

from simulator import Renderer, Scenario
from startracker import DetectionSettings, StarTracker
from startracker.detection import estimate

SMALL = ["detector.width=384", "detector.height=384", "detector.pixel_pitch_um=14", "optics.psf.sigma_px=0.8"]


@pytest.fixture(scope="module")
def frame_and_truth():
    return Renderer(Scenario.load("cubesat_ideal", SMALL)).frame(0)


def test_bright_stars_are_found_within_a_pixel(frame_and_truth):
    frame, truth = frame_and_truth
    spots = find_with_sep(frame.image, estimate(frame.image), DetectionSettings())
    inside = np.all((truth.sources.image_xy > 5) & (truth.sources.image_xy < 378), axis=1)
    bright = truth.sources.image_xy[inside][np.argsort(-truth.sources.electrons[inside])[:10]]
    distance = np.linalg.norm(bright[:, None] - spots.centre[None], axis=2).min(axis=1)
    assert (distance < 1.0).all()
    assert (np.diff(spots.flux) <= 0).all()


def test_the_tracker_takes_it_by_name(frame_and_truth):
    frame, truth = frame_and_truth
    solution = StarTracker(frame.camera, detector="sep").solve(frame.image, observer=frame.observer)
    assert solution.solved
    assert solution.attitude.angle_to(truth.attitude) < 1e-4  # radians: 20″


def test_a_scenario_takes_it_by_name():
    assert Scenario.load("cubesat_ideal", ["tracker.detector=sep"]).tracker.detector == "sep"


def test_empty_and_bad_pixels():
    image = np.random.default_rng(1).normal(100.0, 5.0, (64, 64)).astype(np.float32)
    image[10, 10] = np.nan
    assert len(find_with_sep(image, estimate(image), DetectionSettings(threshold_sigma=8.0))) == 0
