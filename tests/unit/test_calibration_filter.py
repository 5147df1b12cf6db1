"""Steps of the filter of the lens, each against its formula with dense matrices."""

import math
from dataclasses import replace

import numpy as np
import pytest
from lens_sequences import WIDE, lens, new_sky
from scipy.spatial.transform import Rotation
from scipy.stats import chi2 as chi2_distribution

from startracker.calibration import InFlightCalibration, InFlightSettings, LensFilter
from startracker.calibration.lens_equations import lens_equations
from startracker.calibration.residual_field import FIELD_TERMS, FrameInformation, field_columns
from startracker.geometry.attitude import Attitude, rotation_vector_to_matrix
from startracker.inputs import GivenImage

SETTINGS = InFlightSettings(parameters=("f", "cx", "cy"), field_px=0.3, star_error_px=0.02)


def filter_after(frames=3, settings=SETTINGS, count=30, true=WIDE, seed=1):
    """A filter that has seen some frames of other stars."""
    rng, filtered = np.random.default_rng(seed), LensFilter(WIDE, settings)
    for k in range(frames):
        filtered.predict(10.0)
        assert filtered.update(*new_sky(rng, true, count, 0.05, 1000 * k)).accepted
    return filtered, rng


@pytest.mark.parametrize("row_time_s", [0.0, 2e-5])
def test_equations_of_a_frame_leave_out_its_attitude(row_time_s):
    """The normal equations of lens, field and attitude, with the attitude eliminated; a rolling shutter has a rate, of
    which 0.2 rad/s is usual."""
    rng, camera = np.random.default_rng(2), replace(WIDE, row_time_s=row_time_s)
    matrix, stars = new_sky(rng, camera, 12, 0.05)
    stars = replace(stars, sigma_px=rng.uniform(0.03, 0.08, 12))
    names, columns = ("f", "cx", "k1"), field_columns(WIDE, stars.xy)[:, :, :4]
    off = Rotation.from_rotvec([2e-4, -1e-4, 3e-4]).as_matrix() @ matrix
    found = lens_equations(camera, off, stars, names, columns)
    turned, step, row_s = found.matrix, 1e-6, (stars.xy[:, 1] - 511.5) * row_time_s
    by_turn = []
    for axis in np.eye(3):
        ends = [
            camera.project(stars.directions @ (rotation_vector_to_matrix(s * step * axis) @ turned).T) for s in (1, -1)
        ]
        by_turn.append((ends[0] - ends[1]) / (2.0 * step))
    if row_time_s:
        by_turn += [slope * row_s[:, None] for slope in by_turn]
    by_lens = []
    for k, size in enumerate((1e-6, 1e-3, 1e-5)):
        change = size * np.eye(3)[k]
        ends = [lens(camera, names, s * change).project(stars.directions @ turned.T) for s in (1, -1)]
        by_lens.append((ends[0] - ends[1]) / (2.0 * size))
    weight = np.repeat(1.0 / stars.sigma_px, 2)[:, None]
    own = np.stack(by_turn, axis=2).reshape(24, -1) * weight
    free = np.concatenate([np.stack(by_lens, axis=2), columns], axis=2).reshape(24, -1) * weight
    normal = own.T @ own + np.diag([0.0] * 3 + [25.0] * (len(by_turn) - 3))
    share = np.linalg.solve(normal, own.T @ free)
    residual = ((stars.xy - camera.project(stars.directions @ turned.T)) * weight.reshape(12, 2)).ravel()
    # at the attitude that fits, what is left of the residuals is that of the rate
    left = residual - own @ np.linalg.solve(normal, own.T @ residual)
    scale = np.sqrt(np.diag(free.T @ free))
    information = free.T @ (free - own @ share)
    np.testing.assert_allclose(
        found.information / np.outer(scale, scale), information / np.outer(scale, scale), atol=1e-5
    )
    np.testing.assert_allclose(found.vector / scale, free.T @ left / scale, atol=1e-4)
    np.testing.assert_allclose(found.residual, left.reshape(12, 2) / weight.reshape(12, 2), atol=1e-5)
    np.testing.assert_allclose(found.attitude_by_lens, -share[:3], rtol=1e-3, atol=1e-4 * np.abs(share[:3]).max())
    beside = free - own @ share
    np.testing.assert_allclose(found.weighted.reshape(24, -1) / scale, beside / scale, atol=1e-5)
    np.testing.assert_allclose(found.by_lens * stars.sigma_px[:, None, None] ** -1.0, found.weighted, rtol=1e-12)
    part = rng.uniform(0.0, 1.0, 12)
    np.testing.assert_allclose(
        found.noise_information(part),
        beside.T @ (np.repeat(part, 2)[:, None] * beside),
        rtol=1e-3,
        atol=1e-4 * np.abs(found.information).max(),
    )
    # the derivative of the vector by the direction of a star, at the attitude
    moved = stars.directions.copy()
    axis = np.cross(moved[3], [0.3, 0.5, 0.8])
    change = 1e-6 * axis / np.linalg.norm(axis)
    ends = []
    for sign in (1.0, -1.0):
        moved[3] = stars.directions[3] + sign * change
        ends.append(lens_equations(camera, turned, replace(stars, directions=moved.copy()), names, columns).vector)
    np.testing.assert_allclose((ends[0] - ends[1]) / 2.0 / scale, found.by_star[3] @ change / scale, atol=2e-4)


def test_the_misfit_of_a_frame_knows_the_errors_of_the_lens():
    """rᵀ (Σ + H P Hᵀ)⁻¹ r with the stated errors and those of the stars; two of each star less the attitude."""
    filtered, rng = filter_after()
    matrix, stars = new_sky(rng, WIDE, 15, 0.05, 9000)
    frame = lens_equations(filtered.camera, matrix, stars, filtered.names, field_columns(WIDE, stars.xy))
    found, freedom = filtered._misfit(stars, frame)
    by_lens, residual = frame.by_lens.reshape(30, -1), frame.residual.ravel()
    covariance = np.diag(np.repeat(stars.sigma_px**2 + 0.02**2, 2)) + by_lens @ filtered._joint @ by_lens.T
    assert found == pytest.approx(residual @ np.linalg.solve(covariance, residual), rel=1e-6)
    assert freedom == 27
    px2 = filtered._lens_px2(frame.by_lens)
    expected = [0.5 * np.trace(frame.by_lens[m] @ filtered._joint @ frame.by_lens[m].T) for m in range(15)]
    np.testing.assert_allclose(px2, expected, rtol=1e-9)


def test_the_distance_of_a_frame_from_the_estimate():
    """bᵀ (I + I P I)⁻¹ b of the parameters that the frame shows, which are the degrees of freedom."""
    filtered, rng = filter_after()
    size = 3
    joint = filtered.field.joint(filtered.filtered)
    root = rng.normal(size=(size + FIELD_TERMS, 40)) / np.sqrt(np.diag(joint))[:, None]
    frame = FrameInformation(root @ root.T, rng.normal(size=size + FIELD_TERMS))
    variance = frame.matrix[:size, :size] + frame.matrix[:size] @ joint @ frame.matrix[:, :size]
    vector = np.linalg.cholesky(variance) @ np.array([1.0, -2.0, 0.5])
    found, dimensions = filtered._distance2(frame._replace(vector=np.concatenate([vector, frame.vector[size:]])))
    assert (found, dimensions) == (pytest.approx(5.25, rel=1e-6), 3)
    blind = frame.matrix.copy()
    blind[1], blind[:, 1] = 0.0, 0.0
    kept = [0, 2]
    variance = blind[:size, :size] + blind[:size] @ joint @ blind[:, :size]
    part = vector[kept] @ np.linalg.solve(variance[np.ix_(kept, kept)], vector[kept])
    vector[1] = 0.0
    found, dimensions = filtered._distance2(FrameInformation(blind, np.concatenate([vector, frame.vector[size:]])))
    assert (found, dimensions) == (pytest.approx(part, rel=1e-6), 2)


def test_a_star_seen_often_has_a_constant_error():
    """Its weight is that of an error of √n times the constant one at the n-th sighting."""
    settings = InFlightSettings(parameters=("f",), field_px=0.0, star_error_px=0.02)
    filtered, rng = LensFilter(WIDE, settings), np.random.default_rng(3)
    matrix, stars = new_sky(rng, WIDE, 12, 0.05)
    seen = 0.0
    for _ in range(4):
        rows = filtered.stars.rows(stars.catalog_id)
        np.testing.assert_allclose(filtered._effective_px(stars, rows), math.sqrt(0.05**2 + (1.0 + seen) * 0.02**2))
        assert filtered.update(matrix, stars).accepted
        seen = 0.99 * seen + 1.0
    assert filtered.noise_factor == 1.0
    filtered._chi2, filtered._freedom = 400.0, 100.0
    assert filtered.noise_factor == 2.0
    np.testing.assert_allclose(filtered._effective_px(stars, rows), math.sqrt(4.0 * 0.05**2 + (1.0 + seen) * 0.02**2))


def test_what_the_error_of_the_lens_is_worth_in_the_attitude():
    """Its covariance, and the square of what is known and not applied; zero before there is a frame."""
    filtered, rng = filter_after(true=lens(WIDE, ("f",), [1e-4]))
    missing = np.concatenate([filtered.change - filtered.applied, filtered.field.mean])
    moment = filtered._joint + np.outer(missing, missing)
    np.testing.assert_allclose(filtered._error_moment, moment, rtol=1e-12)
    assert np.abs(missing[:3] / filtered.sigma).max() > 0.1
    matrix, stars = new_sky(rng, WIDE, 20, 0.05, 9000)
    frame = lens_equations(filtered.camera, matrix, stars, filtered.names, field_columns(WIDE, stars.xy))
    expected = frame.attitude_by_lens @ moment @ frame.attitude_by_lens.T
    found = filtered.unused(matrix, stars, "why")
    np.testing.assert_allclose(found.attitude_covariance, expected, rtol=1e-6)
    assert filtered.covariance.shape == (3, 3)
    np.testing.assert_allclose(filtered.sigma, np.sqrt(np.diag(filtered._joint))[:3])


def test_a_frame_that_is_too_noisy_weighs_less():
    """Above the χ² of one in a thousand by the root of χ²/ν, which enlarges the stated errors for this frame."""
    settings = InFlightSettings(parameters=("f", "cx"), field_px=0.0, star_error_px=0.0)
    for ratio in (0.97, 1.03):
        filtered, rng = LensFilter(WIDE, settings), np.random.default_rng(6)
        matrix, stars = new_sky(rng, WIDE, 40, 0.05)
        limit = chi2_distribution.isf(1e-3, 77)
        frame = lens_equations(WIDE, matrix, stars, filtered.names, np.zeros((40, 2, 0)))
        chi2 = filtered._misfit(stars, frame)[0]
        # residuals of the frame that fit, scaled to a χ² beside the limit
        factor = math.sqrt(ratio * limit / chi2)
        scaled = replace(stars, sigma_px=stars.sigma_px / factor)
        frame = lens_equations(WIDE, matrix, scaled, filtered.names, np.zeros((40, 2, 0)))
        chi2 = filtered._misfit(scaled, frame)[0]
        found = filtered.update(matrix, scaled)
        assert found.used.all()
        assert (chi2 > limit) == (ratio > 1.0)
        expected = math.sqrt(chi2 / 77.0) if chi2 > limit else 1.0
        assert found.noise_factor == pytest.approx(expected, rel=1e-6)
        information = np.diag(filtered.initial_sigma**-2.0) + frame.information / expected**2
        np.testing.assert_allclose(filtered.filtered, np.linalg.inv(information), rtol=1e-6)
        # of χ² no more than the limit counts for the ratio of the errors
        assert filtered._chi2 == pytest.approx(min(chi2, limit), rel=1e-6)
        assert filtered._freedom == 77.0


def test_the_worst_stars_are_left_out_until_the_others_fit():
    """Half of those beyond the limit at a time, down to half of the stars and to four."""
    filtered, rng = filter_after(6)
    matrix, stars = new_sky(rng, WIDE, 20, 0.05, 9000)
    for bad in (1, 3, 6):
        wrong = replace(stars, xy=stars.xy.copy())
        wrong.xy[:bad, 0] += np.linspace(20.0, 40.0, bad)
        rows = filtered.stars.rows(wrong.catalog_id)
        used, frame = filtered._fitting(matrix, wrong, filtered._field_columns(wrong.xy), rows)
        assert not used[:bad].any()
        assert used[bad:].sum() >= 19 - bad
        assert len(frame.residual) == used.sum()
    torn = replace(stars, xy=stars.xy.copy())
    torn.xy[:12, 0] += np.geomspace(1.0, 500.0, 12)  # among which each is far from those below it
    used, frame = filtered._fitting(
        matrix, torn, filtered._field_columns(torn.xy), filtered.stars.rows(torn.catalog_id)
    )
    assert frame is None
    found = filtered.update(matrix, torn)
    assert (found.accepted, found.reason) == (False, "the residuals of too many stars do not fit")
    assert filtered.frames == 6


def test_errors_fade_over_two_thousand_residuals():
    settings = InFlightSettings(parameters=("f",), field_px=0.0, star_error_px=0.0)
    filtered, rng = LensFilter(WIDE, settings), np.random.default_rng(8)
    freedom = 0.0
    for k in range(3):
        assert filtered.update(*new_sky(rng, WIDE, 40, 0.05, 1000 * k)).accepted
        freedom = freedom * math.exp(-77.0 / 2000.0) + 77.0
        assert filtered._freedom == pytest.approx(freedom)


# ---------------------------------------------------------------------- the calibration around it
def test_a_calibration_passes_on_what_a_frame_shows():
    """The image only if it is of the camera's size; the error of the attitude of the last frame that has one."""
    calibration = InFlightCalibration(WIDE, InFlightSettings(shift_px=1.0), psf_width_px=0.8)
    rng = np.random.default_rng(9)
    matrix, stars = new_sky(rng, WIDE, 20, 0.05)
    assert not calibration.attitude_covariance.any()
    image = np.zeros((1024, 1024), np.float32)
    variance = calibration.psf.variance_px2
    calibration.update(5.0, Attitude.from_matrix(matrix), stars, GivenImage(np.zeros((9, 9))))
    assert calibration.defects._count.frames == 0
    assert calibration.psf.variance_px2 == variance  # the first frame has no time before it
    first = calibration.attitude_covariance
    np.testing.assert_array_equal(first, calibration.last.attitude_covariance)
    calibration.update(6.0, Attitude.from_matrix(matrix), stars, GivenImage(image))
    assert calibration.defects._count.frames == 1
    drift = calibration.settings.psf_width_drift_px_sqrt_h / 60.0
    assert calibration.psf.variance_px2 == pytest.approx(variance + drift**2)
    assert not calibration.last.accepted  # the stars have not moved
    second = calibration.attitude_covariance
    assert np.trace(second) < np.trace(first)
    few = stars.select(np.arange(20) < 3)
    turned = Rotation.from_rotvec([0.01, 0.0, 0.0]).as_matrix() @ matrix
    calibration.update(4.0, Attitude.from_matrix(turned), few)  # a clock that steps back lets nothing drift
    assert calibration.psf.variance_px2 == pytest.approx(variance + drift**2)
    np.testing.assert_array_equal(calibration.attitude_covariance, second)
    assert "fewer than 4 stars" in calibration.last.reason


@pytest.mark.parametrize("turn_px", [0.9, 1.1])
def test_frames_between_which_stars_moved_enough_are_used(turn_px):
    calibration = InFlightCalibration(WIDE, InFlightSettings(shift_px=1.0))
    rng = np.random.default_rng(10)
    matrix, stars = new_sky(rng, WIDE, 20, 0.05)
    assert calibration.update(0.0, Attitude.from_matrix(matrix), stars).accepted
    # about y, the motion in the middle of the image is f tan(angle); over the field the median is 1.07 times that
    turned = Rotation.from_rotvec([0.0, turn_px / 1.07 * WIDE.pixel_rad, 0.0]).as_matrix() @ matrix
    _, more = new_sky(rng, WIDE, 20, 0.05, 500)
    moved = replace(more, directions=WIDE.unproject(more.xy) @ turned)
    shift = calibration._shift_px(Attitude.from_matrix(matrix), Attitude.from_matrix(turned))
    points = np.stack(np.meshgrid(np.linspace(0, 1023, 4), np.linspace(0, 1023, 4)), axis=-1).reshape(-1, 2)
    moves = WIDE.project(WIDE.unproject(points) @ matrix @ turned.T) - points
    assert shift == pytest.approx(np.median(np.hypot(*moves.T)), rel=1e-9)
    found = calibration.update(1.0, Attitude.from_matrix(turned), moved)
    assert found.accepted is (shift >= 1.0)
    away = Attitude.from_matrix(Rotation.from_rotvec([2.0, 0.0, 0.0]).as_matrix() @ matrix)
    assert calibration._shift_px(Attitude.from_matrix(matrix), away) == math.inf
