"""A stated error of the camera model keeps the covariance honest: `tracker.centroid.camera_model_px`.

The normalised error squared of an attitude has mean 3 and variance 6 if its covariance is correct.
"""

import numpy as np
import pytest

from simulator import Scenario
from simulator.study.trials.trial import TrialRunner
from startracker import centroid, detection
from startracker.front_end import Clock, find_stars
from startracker.inputs import given_image
from startracker.settings import CentroidSettings, DetectionSettings
from startracker.tracking.candidates import Sky, measure_windows

FRAMES = 12
CAMERAS = 6


def normalised_errors(keys):
    """NEES (n,) of frames of several cameras; hot pixels left out, which spoil one star in 400."""
    nees = []
    for seed in range(CAMERAS):
        overrides = ["detector.hot_pixel_fraction=0", f"seed={seed + 50}", *keys]
        runner = TrialRunner(Scenario.load("cubesat_ideal", overrides))
        nees += [runner.run(k)["nees"] for k in range(FRAMES)]
    return np.array(nees)


def test_a_stated_error_makes_the_covariance_true():
    """A centroid curve of 0.02 px, different for every star, 0.014 px rms: too small to be seen in the residuals of one
    frame, and twice the noise of the brightest stars."""
    curve = "detector.intra_pixel.centroid_curve_px=0.02"
    unknown = normalised_errors([curve])
    stated = normalised_errors([curve, f"tracker.centroid.camera_model_px={0.02 / np.sqrt(2.0)}"])
    assert stated.mean() == pytest.approx(3.0, abs=4.0 * np.sqrt(6.0 / len(stated)))
    better = unknown - stated  # of the same frames
    assert better.mean() > 3.0 * better.std() / np.sqrt(len(better))


@pytest.fixture(scope="module")
def frame_and_tracker():
    runner = TrialRunner(Scenario.load("cubesat_ideal", ["pointing.error_deg=0.1"]))
    frame, truth = runner.renderer.frame(2)
    return frame, truth, runner.tracker


def test_it_is_added_to_every_centroid(frame_and_tracker):
    frame, _, _ = frame_and_tracker
    detect, measure = detection.METHODS["components"], centroid.METHODS["maximum_likelihood"]
    settings = [CentroidSettings(), CentroidSettings(camera_model_px=0.3)]
    plain, stated = (
        find_stars(given_image(frame), detect, measure, DetectionSettings(), s, Clock(), camera=frame.camera).stars
        for s in settings
    )
    assert np.array_equal(plain.xy, stated.xy)
    np.testing.assert_allclose(stated.variance_px2 - plain.variance_px2, 0.09, rtol=1e-12)
    np.testing.assert_allclose(
        stated.covariance_px2 - plain.covariance_px2,
        np.broadcast_to(0.09 * np.eye(2), plain.covariance_px2.shape),
        atol=1e-12,
    )


def test_it_is_added_in_the_windows_of_tracking(frame_and_tracker):
    frame, truth, tracker = frame_and_tracker
    expected = Sky(tracker.guide, tracker.camera.pixel_rad).expected(truth.attitude.as_matrix(), frame.observer, 30)
    found = []
    for error_px in (0.0, 0.3):
        tracker.centroid = CentroidSettings(camera_model_px=error_px)
        found.append(
            measure_windows(frame.image, tracker, expected, 12, 0.0, 1.0, frame.saturation_dn, frame.gain_e_per_dn)
        )
    np.testing.assert_allclose(found[1].stated_px ** 2 - found[0].stated_px ** 2, 0.09, rtol=1e-9)
