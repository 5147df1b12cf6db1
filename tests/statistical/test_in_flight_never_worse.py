"""Calibration in flight never makes attitudes worse: a session with it against one without, on the same star positions.

The noise of the star positions is the same in both sessions, so that their errors differ only by the lens, and 1.1
times the error without calibration needs no allowance for the noise: it leaves √(1.1² − 1) = 46 % of that error for
what the estimate of the lens adds.
"""

from dataclasses import replace

import numpy as np
import pytest
from lens_sequences import lens, waves
from scipy.stats import multivariate_normal, norm

from simulator import Scenario
from simulator.study.sequence.frames import SequenceRunner
from simulator.study.star_tracker import build_tracker
from startracker import Attitude, CalibratedSession, Camera, InFlightCalibration, Observer, StarTracker
from startracker.calibration import InFlightSettings
from startracker.calibration.applied import applied_change
from startracker.tracking import RateNoise, TrackingSession

GROUND = Camera.from_fov(20.0, 1024, 1024)
OBSERVER = Observer(2026.2, velocity_km_s=(10.0, 25.0, 11.0))
NOISE_PX = 0.02
FRAMES = 80

PARTS = {
    "everywhere": lambda x, y: x < np.inf,
    "in one half": lambda x, y: x > 512,
    "in one quadrant": lambda x, y: (x > 512) & (y > 512),
}


@pytest.fixture(scope="module")
def tracker():
    return StarTracker(GROUND, magnitude_limit=6.0)


def flown(tracker, seed, true=GROUND, displacement=None, part="everywhere"):
    """Errors (2, N, 3), rad, and NEES (2, N) of sessions without and with calibration."""
    rng, sky = np.random.default_rng(seed), tracker.guide.apparent_to(OBSERVER)
    calibrated = CalibratedSession(tracker, InFlightCalibration(GROUND), RateNoise(1e-5))
    sessions, errors, nees = (TrackingSession(tracker, RateNoise(1e-5)), calibrated), [], []
    for k in range(FRAMES):
        truth = Attitude.from_radec_roll(80.0 + 0.5 * k, 5.0 + 10.0 * np.sin(k / 20.0), 30.0 + 0.3 * k)
        _, _, xy = sky.in_field(truth.as_matrix(), camera=true)
        xy = xy[PARTS[part](*xy.T)]
        measured = xy + NOISE_PX * rng.normal(size=xy.shape) + (0.0 if displacement is None else displacement(xy))
        for session in sessions:
            solution = session.update_centroids(measured, None, 5.0 * k, observer=OBSERVER)
            if solution.attitude is None:
                errors.append([np.nan] * 3)
                nees.append(np.nan)
                continue
            errors.append(truth.rotation_vector_to(solution.attitude))
            nees.append(errors[-1] @ np.linalg.solve(solution.covariance, errors[-1]))
    return np.reshape(errors, (FRAMES, 2, 3)).swapaxes(0, 1), np.reshape(nees, (FRAMES, 2)).T


def rms(errors):
    return np.sqrt(np.nanmean(np.sum(np.square(errors), axis=-1), axis=-1))


@pytest.mark.parametrize("part", PARTS)
def test_a_perfect_camera_stays_as_it_is(tracker, part):
    """Before, the estimated principal point was applied from the first frame: 4.4, 2.0 and 1.8 times the error."""
    errors, nees = flown(tracker, 1, part=part)
    plain, calibrated = rms(errors)
    assert calibrated <= 1.1 * plain
    assert np.nanmean(nees[1]) < 4.0


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("rms_px", [pytest.param(0.03, marks=pytest.mark.slow), 0.3])
def test_a_smooth_distortion_is_not_taken_for_the_lens(tracker, part, rms_px):
    """A displacement that k1 cannot describe: before, the principal point and the focal length followed it (0.3 px: 1.9
    and 1.5 times the error for stars everywhere and in one half, NEES 11)."""
    errors, nees = flown(tracker, 2, displacement=waves(2, rms_px), part=part)
    plain, calibrated = rms(errors)
    assert calibrated <= 1.1 * plain
    assert np.nanmean(nees[1]) < 4.0


@pytest.mark.parametrize("part", ["in one half", "in one quadrant"])
def test_a_focal_length_that_changed_is_applied(tracker, part):
    """300 ppm with stars on one side of the field, which displaces the boresight: the error is at most 0.75 times as
    large, of which noise alone is 0.4 to 0.6 (before: 0.96 and 1.29 times)."""
    errors, nees = flown(tracker, 3, true=lens(GROUND, ("f",), [3e-4]), part=part)
    plain, calibrated = rms(errors)
    assert calibrated < 0.75 * plain
    assert np.nanmean(nees[1]) < 4.0 < np.nanmean(nees[0])


@pytest.mark.parametrize("half_blinded", [False, True])
def test_hot_pixels_that_accumulate(half_blinded):
    """Rendered frames of a camera without any change, with 100 more hot pixels in each; and with half of the image
    saturated. The defects that are mapped do not cost more than they give."""
    keys = ["sequence.frames=24", "sequence.step_s=20", "optics.thermal.swing_k=0"]
    scenario = Scenario.load("thermal", overrides=keys)
    runner = SequenceRunner(scenario)
    camera = runner.renderer.focal_plane.true_camera
    plain = TrackingSession(build_tracker(scenario, camera), runner.noise)
    calibrated = CalibratedSession(build_tracker(scenario, camera), InFlightCalibration(camera), runner.noise)
    rng, added, errors = np.random.default_rng(5), np.zeros((camera.height, camera.width)), []
    for k, tracked in enumerate(runner.frames()):
        frame = tracked.frame
        row, column = rng.integers(0, camera.height, 100), rng.integers(0, camera.width, 100)
        np.add.at(added, (row, column), rng.uniform(100.0, 3000.0, 100))
        image = np.minimum(frame.image + added, 4095.0)
        if half_blinded:
            image[:, : camera.width // 2] = 4095.0
        frame = replace(frame, image=image.astype(frame.image.dtype))
        for session in (plain, calibrated):
            solution = session.update(frame, 20.0 * k)
            errors.append(runner.cameras[k].rotation_vector_to(solution.attitude))
    without, found = rms(np.reshape(errors, (24, 2, 3)).swapaxes(0, 1))
    assert found <= 1.1 * without


def test_the_covariance_of_a_frame_that_is_not_used_is_its_own(tracker):
    """Stars at rest, of which only one quadrant remains: the lens is not updated, but an error of the focal length now
    displaces the boresight by that fraction of the distance of the stars (260 px, 5° from it), and before by that of
    their mean position, within 130 px of the centre."""
    calibration = InFlightCalibration(GROUND, InFlightSettings(parameters=("f",), field_px=0.0))
    session = CalibratedSession(tracker, calibration, RateNoise(1e-5))
    truth, sky = Attitude.from_radec_roll(80.0, 5.0, 30.0), tracker.guide.apparent_to(OBSERVER)
    _, _, xy = sky.in_field(truth.as_matrix(), camera=GROUND)
    rng, found = np.random.default_rng(4), []
    for k, part in enumerate(["everywhere", "everywhere", "in one quadrant"]):
        chosen = xy[PARTS[part](*xy.T)]
        session.update_centroids(chosen + NOISE_PX * rng.normal(size=chosen.shape), None, 5.0 * k, observer=OBSERVER)
        found.append(np.trace(calibration.attitude_covariance))
    assert calibration.lens.frames == 1
    assert "not moved" in calibration.last.reason
    assert found[2] > 4.0 * found[1]


# ---------------------------------------------------------------------- what is applied
def test_one_parameter_against_the_posterior_by_integration():
    """Prior: unchanged, or with odds of 0.01 normal with standard deviation 2; measured with standard deviation 0.3."""
    prior, noise = 2.0, 0.3
    p = np.linspace(-12.0, 12.0, 200_001)
    for measured in (0.2, 0.9, 1.2, 1.5, 4.0):
        of_changed = norm.pdf(p, scale=prior) * np.exp(-0.5 * ((measured - p) / noise) ** 2)
        changed = 0.01 * np.trapezoid(of_changed, p)
        unchanged = np.exp(-0.5 * (measured / noise) ** 2)
        expected = 0.01 * np.trapezoid(p * of_changed, p) / (changed + unchanged)
        share = prior**2 / (prior**2 + noise**2)
        estimate, variance = np.array([share * measured]), np.array([[share * noise**2]])
        assert applied_change(("f",), estimate, variance, np.array([prior**2])) == pytest.approx(expected, rel=1e-6)


def test_two_parameters_against_the_evidence_of_each_hypothesis():
    """Correlated measurements of two parameters with very different units: the mean over four hypotheses, whose
    evidence is the density of the measurement; odds of 0.01 for one change, and 0.1 for another one."""
    prior, noise = np.diag([1.0, 25e-8]), np.array([[0.04, 5e-5], [5e-5, 1e-7]])
    for measured in ([0.1, 1e-4], [0.75, 2e-4], [0.7, 1.3e-3], [2.0, -1e-3]):
        posterior = np.linalg.inv(np.linalg.inv(prior) + np.linalg.inv(noise))
        total, mean = 0.0, np.zeros(2)
        for changed, odds in (([], 1.0), ([0], 0.01), ([1], 0.01), ([0, 1], 0.001)):
            free = prior * np.isin([0, 1], changed)
            weight = odds * multivariate_normal(np.zeros(2), noise + free).pdf(measured)
            total, mean = total + weight, mean + weight * (free @ np.linalg.solve(noise + free, measured))
        estimate = posterior @ np.linalg.solve(noise, measured)
        found = applied_change(("cx", "cy"), estimate, posterior, np.diag(prior))
        np.testing.assert_allclose(found, mean / total, rtol=1e-6, atol=1e-12)
