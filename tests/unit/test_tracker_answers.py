"""Every call ends with a status and a reason; nothing inside ever comes out as an exception or a made-up attitude."""

import math
import subprocess
import sys

import numpy as np
import pytest

import startracker
from startracker import Attitude, Camera, InputError, Observer, StarTracker, Status
from startracker.geometry.distortion import Distortion
from startracker.observer import aberrate

CAMERA = Camera.from_fov(10.0, 512, 512)


@pytest.fixture(scope="module")
def tracker():
    return StarTracker(CAMERA, magnitude_limit=6.5)


def field(tracker, attitude, observer=None):
    guide = tracker.guide.apparent_to(observer)
    index, _, xy = guide.in_field(attitude.as_matrix())
    return index, xy, 10.0 ** (-0.4 * guide.v_mag[index])


def draw(xy, flux, shape=(512, 512), sigma=1.1):
    """Gaussian stars, sampled at the pixels' centres."""
    image = np.full(shape, 20.0)
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    for (x, y), f in zip(xy, flux, strict=True):
        image += 3e6 * f * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2 * sigma**2))
    return image


CONTENT = {
    "none": (np.empty((0, 2)), Status.NO_STARS),
    "empty list": ([], Status.NO_STARS),
    "one": ([[1.0, 2.0]], Status.TOO_FEW_STARS),
    "not a number": (np.full((9, 2), np.nan), Status.NO_STARS),
    "infinite": (np.full((9, 2), np.inf), Status.NO_STARS),
    "one star repeated": (np.full((9, 2), 77.0), Status.TOO_FEW_STARS),
    "outside": (np.arange(20.0).reshape(10, 2) + 1e6, Status.NO_STARS),
    "in a line": (np.stack([np.arange(10) * 50.0, np.arange(10) * 50.0], axis=1), Status.NO_MATCH),
    "a regular grid": (np.stack(np.meshgrid(*[np.arange(5) * 100.0] * 2), -1).reshape(-1, 2), Status.NO_MATCH),
}


@pytest.mark.parametrize("name", CONTENT)
def test_centroids_that_are_no_sky(tracker, name):
    xy, status = CONTENT[name]
    solution = tracker.solve_centroids(xy)
    assert solution.status is status
    assert solution.reason
    assert solution.attitude is None
    assert solution.covariance is None
    assert solution.matched == 0


IMAGES = {
    "black": (np.zeros((512, 512)), Status.NO_STARS),
    "white, 8 bit": (np.full((512, 512), 255, np.uint8), Status.SATURATED),
    "white, float": (np.full((512, 512), 65535.0), Status.SATURATED),
    "not a number": (np.full((512, 512), np.nan), Status.BAD_IMAGE),
    "another size": (np.zeros((100, 512)), Status.BAD_IMAGE),
    "no pixels": (np.zeros((0, 0)), Status.BAD_IMAGE),
    "colour": (np.zeros((512, 512, 3)), Status.BAD_IMAGE),
    "text": (np.array([["a", "b"]]), Status.BAD_IMAGE),
    "ragged": ([[1, 2], [3]], Status.BAD_IMAGE),
    "noise": (np.random.default_rng(0).normal(100.0, 5.0, (512, 512)), Status.NO_STARS),
    "a chequerboard": (np.indices((512, 512)).sum(axis=0) // 32 % 2 * 1000.0, None),
    "complex": (np.ones((512, 512), complex), Status.BAD_IMAGE),
}


@pytest.mark.parametrize("name", IMAGES)
def test_images_that_are_no_sky(tracker, name):
    image, status = IMAGES[name]
    solution = tracker.solve(image)
    assert status is None or solution.status is status, solution.reason
    assert not solution.solved
    assert solution.reason
    assert solution.attitude is None


def test_a_drawn_field_gives_its_attitude_back(tracker):
    attitude = Attitude.from_radec_roll(85.0, -2.0, 123.0)
    index, xy, flux = field(tracker, attitude)
    image = draw(xy, flux)
    solution = tracker.solve(image)
    assert solution.solved, solution.reason
    assert math.degrees(attitude.angle_to(solution.attitude)) * 3600 < 5.0
    assert set(solution.stars.catalog_id) <= set(tracker.guide.catalog.id[index])
    assert solution.matched >= 0.6 * len(index)
    assert {"background", "detection", "centroid", "identification", "attitude", "total"} <= set(solution.times_ms)
    assert solution.camera is CAMERA
    assert solution.fov_deg == pytest.approx(10.0)
    image[:, 300:] = 65535.0
    spoilt = tracker.solve(image, saturation_dn=60000.0)
    assert spoilt.status in (Status.SATURATED, Status.SOLVED)


def test_bad_pixels_do_not_stop_it(tracker):
    attitude = Attitude.from_radec_roll(85.0, -2.0, 123.0)
    _, xy, flux = field(tracker, attitude)
    image = draw(xy, flux)
    image[10:13] = np.nan
    image[200, 200] = np.inf
    solution = tracker.solve(image)
    assert solution.solved, solution.reason
    assert math.degrees(attitude.angle_to(solution.attitude)) * 3600 < 10.0


def test_many_saturated_pixels_are_named(tracker):
    image = np.random.default_rng(1).normal(100.0, 5.0, (512, 512))
    image[:100] = 4095.0
    solution = tracker.solve(image, saturation_dn=4095.0)
    assert solution.status is Status.SATURATED
    assert "20 % of the pixels" in solution.reason


def test_the_observer_is_taken_account_of(tracker):
    observer = Observer(2026.2, np.array([-22.0, 18.0, 9.0]), np.array([0.7, -0.6, -0.3]))
    attitude = Attitude.from_radec_roll(300.0, 30.0, 5.0)
    _, xy, flux = field(tracker, attitude, observer)
    told = tracker.solve_centroids(xy, flux, observer=observer)
    untold = tracker.solve_centroids(xy, flux)
    assert math.degrees(attitude.angle_to(told.attitude)) * 3600 < 1e-6
    expected = aberrate(attitude.boresight[None], observer.velocity_km_s)[0]
    aberration = math.degrees(math.acos(float(expected @ attitude.boresight))) * 3600
    off = math.degrees(attitude.angle_to(untold.attitude)) * 3600
    assert off == pytest.approx(aberration, rel=0.5)
    assert off > 5.0


@pytest.mark.parametrize("parity", [1, -1])
def test_distortion_and_parity_are_the_cameras(parity):
    camera = Camera(2000.0, 2010.0, 300.0, 250.0, 640, 512, Distortion(k1=-0.15, p1=0.002), parity)
    tracker = StarTracker(camera, magnitude_limit=6.0)
    attitude = Attitude.from_radec_roll(10.0, -80.0, 250.0)
    _, xy, flux = field(tracker, attitude)
    solution = tracker.solve_centroids(xy, flux)
    assert solution.solved, solution.reason
    assert math.degrees(attitude.angle_to(solution.attitude)) * 3600 < 1e-6
    assert solution.parity == parity
    turned = np.stack([camera.width - 1 - xy[:, 0], xy[:, 1]], axis=1)
    assert not tracker.solve_centroids(turned, flux).solved


def test_a_blended_star_does_not_spoil_a_frame_without_noise(tracker):
    attitude = Attitude.from_radec_roll(85.0, -2.0, 123.0)
    _, xy, flux = field(tracker, attitude)
    pulled = xy.copy()
    pulled[[1, 4]] += [[0.4, -0.3], [-0.2, 0.5]]
    solution = tracker.solve_centroids(pulled, flux)
    assert math.degrees(attitude.angle_to(solution.attitude)) * 3600 < 1e-3
    assert solution.matched == len(xy)  # the blends are named too
    assert np.count_nonzero(~solution.stars.used) == 2
    assert np.hypot(*solution.stars.residual_px[~solution.stars.used].T).min() > 0.4
    assert solution.rmse_arcsec < 1e-3


def test_a_wrong_prior_is_overruled_by_the_sky_and_said(tracker):
    attitude = Attitude.from_radec_roll(85.0, -2.0, 123.0)
    _, xy, flux = field(tracker, attitude)
    solution = tracker.solve_centroids(xy, flux, prior=Attitude.from_radec_roll(185.0, 20.0, 3.0))
    assert solution.solved
    assert "outside the prior" in solution.reason
    assert math.degrees(attitude.angle_to(solution.attitude)) * 3600 < 1e-3


def test_flux_that_is_no_number_counts_as_faint(tracker):
    attitude = Attitude.from_radec_roll(85.0, -2.0, 123.0)
    _, xy, flux = field(tracker, attitude)
    flux[[3, 5, 8]] = np.nan, -1.0, 0.0
    assert tracker.solve_centroids(xy, flux).solved
    assert tracker.solve_centroids(xy, np.full(len(xy), np.nan)).solved


def test_a_focal_length_two_percent_off_is_fitted():
    truth = Camera.from_fov(10.0, 512, 512)
    good = StarTracker(truth, magnitude_limit=6.5)
    attitude = Attitude.from_radec_roll(85.0, -2.0, 123.0)
    _, xy, flux = field(good, attitude)
    tracker = StarTracker(Camera.from_fov(10.2, 512, 512), magnitude_limit=6.5, focal_error=0.03)
    solution = tracker.solve_centroids(xy, flux)
    assert solution.solved, solution.reason
    assert solution.fov_deg == pytest.approx(10.0, abs=0.005)
    assert math.degrees(attitude.angle_to(solution.attitude)) < 0.02


def test_mistakes_of_the_caller_are_one_clear_line(tracker):
    with pytest.raises(InputError, match=r"'math_groups' is not one of the identifiers.*did you mean 'match_groups'"):
        StarTracker(CAMERA, identifier="math_groups")
    with pytest.raises(InputError, match="shape"):
        tracker.solve_centroids(np.zeros((4, 3)))
    with pytest.raises(InputError, match="5 centroids, but 4 fluxes"):
        tracker.solve_centroids(np.zeros((5, 2)), np.zeros(4))
    with pytest.raises(InputError, match="prior_deg"):
        tracker.solve_centroids(np.zeros((5, 2)), prior=Attitude.from_radec_roll(0, 0, 0), prior_deg=-1)
    with pytest.raises(InputError, match="focal_error"):
        StarTracker(CAMERA, focal_error=-0.1)


def test_the_package_is_light_and_complete():
    code = (
        "import sys, startracker; heavy = {'astropy', 'matplotlib', 'skyfield', 'colour', 'pydantic', 'PIL'};"
        "print(sorted(heavy & set(sys.modules)), startracker.__version__)"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.split(maxsplit=1)[0] == "[]"
    for name in startracker.__all__:
        assert getattr(startracker, name) is not None
    assert set(startracker.__all__) <= set(dir(startracker))
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = startracker.nothing
