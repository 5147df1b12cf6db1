"""Parts of a calibration in flight: settings, width of star images, map of defective pixels, the session."""

import math
from dataclasses import replace

import numpy as np
import pytest
from lens_sequences import WIDE, lens, new_sky
from scipy.spatial.transform import Rotation
from scipy.special import ndtr

from startracker.calibration import IdentifiedStars, InFlightCalibration, InFlightSettings, LensFilter, WidthFilter
from startracker.calibration.psf_width import star_widths
from startracker.detection.defect_map import DefectMap
from startracker.errors import InputError
from startracker.geometry.attitude import Attitude
from startracker.geometry.camera import Camera
from startracker.geometry.distortion import Distortion
from startracker.inputs import GivenImage
from startracker.observer import Observer
from startracker.settings import CentroidSettings
from startracker.tracker import StarTracker
from startracker.tracking import CalibratedSession, RateNoise, TrackingSession

NARROW = Camera.from_fov(10.0, 128, 128)


@pytest.mark.parametrize(
    ("key", "value", "text"),
    [
        ("parameters", ("f", "k9"), "must name some of f, aspect, cx"),
        ("parameters", ("f", "f"), "each once"),
        ("focal_length_ppm", 0.0, "focal_length_ppm"),
        ("principal_point_drift_px_sqrt_h", -1.0, "principal_point_drift_px_sqrt_h"),
        ("false_rejection", 1.0, "false_rejection"),
        ("defect_share", 0.0, "defect_share"),
    ],
)
def test_settings_out_of_range(key, value, text):
    with pytest.raises(InputError, match=text):
        InFlightSettings(**{key: value})


@pytest.mark.parametrize(
    ("camera", "parameters"),
    [
        (Camera.from_fov(90.0, 512, 512, projection="equisolid"), ("f",)),
        (Camera.from_fov(90.0, 512, 512, projection="equidistant"), ("f", "k1")),
        (Camera.from_fov(30.0, 512, 512), ("f", "k4")),
        (Camera.from_fov(30.0, 512, 512, Distortion(k4=0.01)), ("f",)),
        (Camera.from_fov(30.0, 512, 512), ()),
    ],
)
def test_a_camera_without_such_parameters_is_refused(camera, parameters):
    with pytest.raises(InputError, match="calibration in flight"):
        LensFilter(camera, InFlightSettings(parameters=parameters))


def test_initial_sigmas_are_those_stated():
    """Each coefficient of the distortion displaces the corner by `distortion_px`: by the camera's own projection."""
    settings = InFlightSettings(parameters=("f", "cx", "k1", "k2", "p1"))
    filtered = LensFilter(Camera.from_fov(26.0, 1024, 1024), settings)
    sigma = dict(zip(filtered.names, filtered.sigma, strict=True))
    assert sigma["f"] == pytest.approx(2e-4)
    assert sigma["cx"] == pytest.approx(0.2)
    corner = filtered.camera.unproject([[-0.5 + 0.5, -0.5 + 0.5]])
    for name in ("k1", "k2"):
        moved = lens(filtered.camera, (name,), [sigma[name]]).project(corner)
        assert math.hypot(*moved[0]) == pytest.approx(0.1, rel=0.01)
    assert filtered.drift[0] == pytest.approx(20e-6 / 60.0)


def test_few_stars_and_negative_times():
    filtered = LensFilter(WIDE)
    matrix, stars = new_sky(np.random.default_rng(1), WIDE, 3, 0.05)
    found = filtered.update(matrix, stars)
    assert not found.accepted
    assert "fewer than 4 stars" in found.reason
    with pytest.raises(InputError, match="forward in time"):
        filtered.predict(-1.0)
    assert filtered.change.tolist() == [0.0] * 4


def test_rows_of_a_rolling_shutter_rotate_with_the_camera():
    """Rows exposed 20 µs after each other while the camera rotates at 1°/s about x: the field is sheared by 3.5e-4,
    which is not a change of the lens. Without the rate of the camera as an unknown the focal length would be off by
    half of that."""
    rolling = Camera(2000.0, 2000.0, 511.5, 511.5, 1024, 1024, row_time_s=2e-5)
    for camera, right in ((rolling, True), (replace(rolling, row_time_s=0.0), False)):
        rng, filtered = np.random.default_rng(6), LensFilter(camera, InFlightSettings(focal_length_ppm=1000.0))
        for k in range(20):
            matrix, stars = new_sky(rng, camera, 30, 0.02, 30 * k)
            for n in range(30):
                turn = [math.radians(1.0) * (stars.xy[n, 1] - 511.5) * 2e-5, 0.0, 0.0]
                row = Rotation.from_rotvec(turn).as_matrix() @ matrix
                stars.xy[n] = camera.project(stars.directions[n] @ row.T)[0] + 0.02 * rng.normal(size=2)
            filtered.predict(1.0)
            filtered.update(matrix, stars)
        assert (abs(filtered.change[0]) < 4.0 * filtered.sigma[0]) == right


# ---------------------------------------------------------------------- the width of star images
def gaussian_image(sigma_px, xy, flux, noise_dn, seed=1, shape=(200, 240)):
    """Pixel-integrated Gaussians by differences of the normal distribution, on a level of 100 DN."""
    rows, columns = np.arange(shape[0]), np.arange(shape[1])
    image = np.random.default_rng(seed).normal(100.0, noise_dn, shape)
    for (x, y), light in zip(xy, flux, strict=True):
        along = ndtr((columns + 0.5 - x) / sigma_px) - ndtr((columns - 0.5 - x) / sigma_px)
        down = ndtr((rows + 0.5 - y) / sigma_px) - ndtr((rows - 0.5 - y) / sigma_px)
        image += light * np.outer(down, along)
    return image


def test_widths_of_gaussian_stars():
    """The fitted Gaussian has the width of the image's; noise of 1 DN against 20,000 DN changes it by some 1e-4."""
    xy = np.array([[30.2, 40.7], [90.0, 60.5], [150.4, 150.1], [200.9, 90.3], [3.0, 100.0]])
    flux = np.array([20000.0, 22000.0, 24000.0, 26000.0, 30000.0])
    image = gaussian_image(0.83, xy, flux, 1.0)
    assert star_widths(image, xy, flux, None, 100.0) == pytest.approx([0.83] * 4, abs=2e-3)  # not at the border
    assert len(star_widths(image, xy, flux, 5000.0, 100.0)) < 4  # without saturated ones
    trailed = sum(gaussian_image(0.83, xy + np.array([step, 0.0]), flux / 9, 0.0) for step in np.linspace(-1.5, 1.5, 9))
    assert len(star_widths(trailed, xy, flux, None, 100.0)) == 0


def test_width_is_a_kalman_filter_of_a_random_walk():
    """300 sequences of a drifting width: the mean of the normalised squares of the errors is 1 within 3 √(2/300)."""
    normal = []
    for seed in range(300):
        rng = np.random.default_rng(seed)
        width, filtered = 0.9 + 0.1 * rng.normal(), WidthFilter(0.1, 0.001, 0.9)
        for _ in range(80):
            width += 0.001 * rng.normal()
            filtered.predict(1.0)
            assert filtered.update(width + 0.02 * rng.normal(size=9))
        normal.append((filtered.width_px - width) / filtered.sigma_px)
    assert np.mean(np.square(normal)) == pytest.approx(1.0, abs=3.0 * math.sqrt(2.0 / 300.0))
    assert filtered.sigma_px < 0.004
    assert not filtered.update(np.full(9, 2.0))  # beyond five standard deviations
    assert not filtered.update(np.array([0.9, 0.9]))  # too few
    first = WidthFilter(0.1, 0.0)
    assert first.update(np.array([0.8, 0.9, 1.0]))
    assert first.width_px == 0.9


# ---------------------------------------------------------------------- defective pixels
def pixels(seed, *bright):
    image = np.random.default_rng(seed).normal(100.0, 3.0, (128, 128))
    for x, y in bright:
        image[round(y), round(x)] += 300.0
    return image


def attitude_about(axis, degrees):
    return Attitude.from_matrix(Rotation.from_rotvec(np.radians(degrees) * np.asarray(axis, dtype=float)).as_matrix())


def defect_map(camera=NARROW):
    return DefectMap(camera, frames=5, share=0.75, sigma=5.0, shift_px=6.0)


def test_at_rest_nothing_is_defective():
    """Ten frames of the same sky: an unknown bright object is not a defect, and neither is the hot pixel yet."""
    found = defect_map()
    for k in range(10):
        found.add(pixels(k, (40, 50), (90, 20)), attitude_about([0, 1, 0], 0.01 * k), np.empty((0, 2)))
    assert not found.mask.any()


def test_hot_pixels_are_found_while_the_sky_moves():
    """A hot pixel stays; an unknown object moves with the sky by 8 px a frame, and is nowhere twice."""
    found, pixel_deg = defect_map(), math.degrees(NARROW.pixel_rad)
    for k in range(8):
        image = pixels(k, (90, 20), (20 + 8 * k, 60))
        found.add(image, attitude_about([0, 1, 0], 8.0 * pixel_deg * k), np.empty((0, 2)))
    assert found.xy.tolist() == [[90, 20]]


def test_about_the_boresight_the_middle_stays_in_place():
    """A camera that rolls by 15° a frame: an object on the axis is not a defect, hot pixels away from the axis are."""
    found = defect_map()
    for k in range(12):
        found.add(pixels(k, (63, 64), (100, 100)), attitude_about([0, 0, 1], 15.0 * k), np.empty((0, 2)))
    assert found.xy.tolist() == [[100, 100]]


def test_pixels_of_known_stars_are_not_tested():
    found, pixel_deg = defect_map(), math.degrees(NARROW.pixel_rad)
    for k in range(8):
        found.add(pixels(k, (90, 20)), attitude_about([0, 1, 0], 8.0 * pixel_deg * k), np.array([[91.2, 18.9]]))
    assert not found.mask.any()


# ---------------------------------------------------------------------- all together
def test_frames_of_stars_at_rest_are_used_once():
    calibration = InFlightCalibration(WIDE)
    rng = np.random.default_rng(2)
    matrix, stars = new_sky(rng, WIDE, 20, 0.05)
    attitude = Attitude.from_matrix(matrix)
    assert calibration.update(0.0, attitude, stars).accepted
    again = calibration.update(1.0, attitude, stars)
    assert not again.accepted
    assert "not moved" in again.reason
    assert calibration.lens.frames == 1
    turned = Rotation.from_rotvec([0.0, 2.0 * WIDE.pixel_rad, 0.0]).as_matrix() @ matrix
    measured = WIDE.project(stars.directions @ turned.T)
    moved = IdentifiedStars(measured, stars.directions, stars.sigma_px, stars.catalog_id, stars.flux)
    assert calibration.update(2.0, Attitude.from_matrix(turned), moved).accepted


def test_the_motion_of_the_stars_is_the_median_over_the_field():
    """A roll about the boresight by which the median of a grid of 4 × 4 pixels moves by 1.02 px (those on the edges, at
    0.527 widths), and their mean by 0.97 px."""
    calibration = InFlightCalibration(WIDE, InFlightSettings(shift_px=1.0))
    rng = np.random.default_rng(2)
    matrix, stars = new_sky(rng, WIDE, 20, 0.05)
    assert calibration.update(0.0, Attitude.from_matrix(matrix), stars).accepted
    for moved_px, accepted in ((0.98, False), (1.02, True)):
        roll = Rotation.from_rotvec([0.0, 0.0, moved_px / (0.527 * 1023)]).as_matrix() @ matrix
        measured = WIDE.project(stars.directions @ roll.T)
        moved = IdentifiedStars(measured, stars.directions, stars.sigma_px, stars.catalog_id, stars.flux)
        assert calibration.update(1.0, Attitude.from_matrix(roll), moved).accepted == accepted


def test_drifts_are_those_stated():
    """Per √h in the settings, per √s in the filters: a factor of √3600."""
    calibration = InFlightCalibration(WIDE, InFlightSettings(psf_width_drift_px_sqrt_h=0.3))
    before = calibration.psf.variance_px2
    calibration.psf.predict(3600.0)
    assert calibration.psf.variance_px2 - before == pytest.approx(0.3**2)
    lens_filter = calibration.lens
    variance = lens_filter.covariance[1, 1]
    lens_filter.predict(3600.0)
    assert lens_filter.covariance[1, 1] - variance == pytest.approx(0.02**2)


@pytest.mark.parametrize(("factor", "star_px"), [(1.5, 0.0), (1.0, 0.0), (1.0, 0.1)])
def test_errors_larger_than_stated_are_noticed(factor, star_px):
    """Six stars in each of 150 frames leave 9 degrees of freedom in each: the ratio of actual to stated errors is known
    to 1/√(2 · 1350) = 1.9 %; four of these, and 1 % for the frames whose χ² is cut off. A ratio below 1 is 1."""
    rng = np.random.default_rng(12)
    settings = InFlightSettings(star_error_px=star_px, focal_length_ppm=1.0, principal_point_px=1e-3, field_px=0.0)
    filtered = LensFilter(WIDE, settings)
    for k in range(150):
        matrix, stars = new_sky(rng, WIDE, 6, factor * math.hypot(0.05, star_px), 6 * k)
        filtered.update(matrix, replace(stars, sigma_px=np.full(6, 0.05)))
    assert filtered.noise_factor == pytest.approx(factor, rel=0.085)


def test_mask_and_width_are_passed_on():
    calibration = InFlightCalibration(NARROW, psf_width_px=0.8)
    image = np.ones((128, 128), np.uint16)
    assert calibration.masked(image) is image
    calibration.defects.mask[5, 7] = True
    assert np.argwhere(np.isnan(calibration.masked(image))).tolist() == [[5, 7]]
    wrong = np.ones((4, 4))
    assert calibration.masked(wrong) is wrong  # reported by the tracker
    assert calibration.centroiding(CentroidSettings(psf_sigma_px=1.0)).psf_sigma_px == 0.8
    free = InFlightCalibration(NARROW)
    assert free.centroiding(CentroidSettings()) == CentroidSettings()
    rng = np.random.default_rng(3)
    matrix, stars = new_sky(rng, NARROW, 8, 0.05)
    free.update(0.0, Attitude.from_matrix(matrix), stars, GivenImage(wrong))
    assert math.isnan(free.psf.width_px)


@pytest.fixture(scope="module")
def tracker():
    return StarTracker(Camera.from_fov(20.0, 1024, 1024), magnitude_limit=5.5)


def sky_centroids(tracker, camera, attitude, observer, rng):
    """Centroids of the guide stars with a camera that may differ from the tracker's."""
    vectors = tracker.guide.apparent_to(observer).directions @ attitude.as_matrix().T
    inside = np.flatnonzero(vectors[:, 2] > math.cos(camera.half_diagonal_rad))
    xy = camera.project(vectors[inside])
    seen = np.flatnonzero(camera.contains(xy))
    return xy[seen] + 0.03 * rng.normal(size=(len(seen), 2)), 10.0 ** (-0.4 * tracker.guide.v_mag[inside[seen]])


def test_session_finds_the_focal_length_and_leaves_its_tracker_as_it_was(tracker):
    """300 ppm of the focal length, from lists of centroids; without a velocity nothing is learnt, as aberration
    changes the scale of the field."""
    observer = Observer(2026.0, velocity_km_s=(10.0, -20.0, 15.0))
    true = replace(tracker.camera, fx=tracker.camera.fx * 1.0003, fy=tracker.camera.fy * 1.0003)
    for known in (observer, None):
        rng = np.random.default_rng(4)
        session = CalibratedSession(tracker, InFlightCalibration(tracker.camera), RateNoise(1e-5))
        plain = TrackingSession(tracker, RateNoise(1e-5))
        for k in range(25):
            attitude = Attitude.from_radec_roll(80.0 + 0.3 * k, 5.0, 10.0)
            xy, flux = sky_centroids(tracker, true, attitude, observer, rng)
            solution = session.update_centroids(xy, flux, float(k), observer=known)
            other = plain.update_centroids(xy, flux, float(k), observer=known)
            assert solution.solved
            assert other.solved
        lens_filter = session.calibration.lens
        if known is None:
            assert lens_filter.frames == 0
            assert session.tracker.camera == tracker.camera
            continue
        assert lens_filter.frames == 25
        assert abs(lens_filter.change[0] - 3e-4) < 4.0 * lens_filter.sigma[0] < 1e-4
        assert session.tracker.camera == session.calibration.camera != tracker.camera
        assert session.tracker.camera.fx == pytest.approx(lens_filter.camera.fx, rel=1e-5)
        assert solution.camera is not None
        np.testing.assert_allclose(session.covariance[:3, :3], solution.covariance)
        larger = solution.covariance - other.covariance[:3, :3]
        assert larger[0, 0] > 0.0  # the lens is part of the error across the boresight
        assert "LensFilter(25 frames" in repr(session.calibration)


def test_stars_of_a_solution_have_their_errors(tracker):
    rng, observer = np.random.default_rng(5), Observer(2026.0, velocity_km_s=(10.0, -20.0, 15.0))
    attitude = Attitude.from_radec_roll(80.0, 5.0, 10.0)
    xy, flux = sky_centroids(tracker, tracker.camera, attitude, observer, rng)
    stated = tracker.solve_centroids(xy, flux, sigma_px=0.03, observer=observer)
    assert stated.stars.sigma_px == pytest.approx(0.03, rel=0.01)
    assert stated.stars.fitted.sigma_px.shape == (len(stated.stars.fitted),)
    free = tracker.solve_centroids(xy, flux, observer=observer)
    assert np.isnan(free.stars.sigma_px).all()
    stars = IdentifiedStars.of(free, tracker)
    assert stars.sigma_px == pytest.approx(0.03, rel=0.3)
    predicted = tracker.camera.project(stars.directions @ free.attitude.as_matrix().T)
    np.testing.assert_allclose(stars.xy - predicted, free.stars.fitted.residual_px, atol=1e-6)


# ---------------------------------------------------------------------- protection of the lens
def test_frames_beyond_the_gate_make_the_lens_uncertain_after_five():
    """The focal length jumps by 30 of its standard deviations: four frames are refused, with the fifth the initial
    uncertainty is added, and the next is used. A frame that fits in between begins the count again."""
    settings = InFlightSettings(parameters=("f", "cx"), field_px=0.0, star_error_px=0.0)
    rng, filtered = np.random.default_rng(3), LensFilter(WIDE, settings)
    jumped = lens(WIDE, ("f",), [30.0 * filtered.initial_sigma[0]])
    number = 0

    def frame(camera):
        nonlocal number
        number += 40
        return filtered.update(*new_sky(rng, camera, 40, 0.02, number))

    for _ in range(3):
        assert frame(WIDE).accepted
    assert (filtered.frames, filtered.restarts) == (3, 0)
    found = [frame(jumped) for _ in range(4)]
    assert not any(one.accepted for one in found)
    assert all(one.reason.endswith("is beyond the gate") for one in found)
    assert frame(WIDE).accepted
    before = filtered.filtered.copy(), filtered.random.copy(), filtered.prior_variance.copy()
    for _ in range(4):
        assert "made uncertain" not in frame(jumped).reason
    np.testing.assert_array_equal(filtered.filtered, before[0])
    assert frame(jumped).reason.endswith("is beyond the gate; the lens was made uncertain after 5 such frames")
    initial = np.diag(filtered.initial_sigma**2)
    np.testing.assert_allclose(filtered.filtered, before[0] + initial)
    np.testing.assert_allclose(filtered.random, before[1] + initial)
    np.testing.assert_allclose(filtered.prior_variance, before[2] + np.diag(initial))
    assert (filtered.frames, filtered.restarts) == (4, 1)


def test_errors_larger_than_stated_weigh_less():
    """Three times the stated errors: the ratio is found, at least 1, and one frame's own is its root of χ² over ν."""
    settings = InFlightSettings(parameters=("f",), field_px=0.0, star_error_px=0.0)
    for size, low, high in ((3.0, 2.7, 3.1), (0.5, 1.0, 1.0)):  # the first frames count with a part of theirs
        rng, filtered = np.random.default_rng(4), LensFilter(WIDE, settings)
        assert filtered.noise_factor == 1.0
        for k in range(30):
            matrix, stars = new_sky(rng, WIDE, 40, 0.05 * size, 40 * k)
            found = filtered.update(matrix, replace(stars, sigma_px=np.full(40, 0.05)))
            assert found.accepted
            assert k or found.noise_factor == pytest.approx(max(size, 1.0), rel=0.25)
        assert low <= filtered.noise_factor <= high


def test_the_time_constant_is_that_of_the_steady_filter():
    """P / Q of a parameter, for ever without a drift, and longer by its correlation with others."""
    settings = InFlightSettings(parameters=("f", "cx"), focal_length_drift_ppm_sqrt_h=0.0)
    filtered = LensFilter(WIDE, settings)
    drift2, sigma2 = filtered.drift[1] ** 2, filtered.initial_sigma[1] ** 2
    np.testing.assert_allclose(filtered.time_constant_s, [np.inf, sigma2 / drift2])
    filtered.predict(9.0)
    np.testing.assert_allclose(filtered.time_constant_s[1], (sigma2 + 9.0 * drift2) / drift2)
    np.testing.assert_allclose(filtered.prior_variance[1], sigma2 + 9.0 * drift2)
    np.testing.assert_allclose(filtered.random, filtered.filtered)


def test_a_frame_that_is_not_used_still_has_the_error_of_its_attitude():
    filtered = LensFilter(WIDE)
    matrix, stars = new_sky(np.random.default_rng(5), WIDE, 30, 0.05)
    found = filtered.unused(matrix, stars, "why")
    assert (found.accepted, found.reason, found.used.tolist()) == (False, "why", [False] * 30)
    same = filtered.update(matrix, stars)
    # the same as of a frame that was used, whose stars all fit
    assert same.used.all()
    np.testing.assert_allclose(found.attitude_covariance, same.attitude_covariance, rtol=0.05)
    few = LensFilter(WIDE).unused(matrix, stars.select(np.arange(30) < 3), "why")
    assert few.attitude_covariance is None
    assert LensFilter(WIDE).unused(matrix, stars.select(np.arange(30) < 4), "why").attitude_covariance is not None
