"""Attitude of the matched stars by every estimator: what the fit of the field finds is passed on to each."""

import math

import numpy as np
import pytest

from startracker import Attitude, Camera, StarTracker, estimation
from startracker.centroid.result import Measured
from startracker.estimation import plate_constants
from startracker.estimation.refine import refine
from startracker.observer import unknown_aberration

CAMERA = Camera.from_fov(12.0, 512, 512)
TRUTH = Attitude.from_radec_roll(83.0, -1.0, 20.0)


@pytest.fixture(scope="module")
def guide():
    return StarTracker(CAMERA, magnitude_limit=6.5).guide


def stars_of(guide):
    """Numbers of the guide stars on the image and their exact pixels."""
    index, _, xy = guide.in_field(TRUTH.as_matrix())
    inside = CAMERA.contains(xy)
    return index[inside], xy[inside]


@pytest.mark.parametrize("name", estimation.METHODS)
def test_a_focal_length_that_the_field_shows_turns_no_estimator(guide, name):
    """A camera 0.1 % longer than its calibration, and stars in one half: uncorrected, they move by 0.13 px."""
    index, xy = stars_of(guide)
    centre = np.array([CAMERA.cx, CAMERA.cy])
    half = xy[:, 0] > CAMERA.cx
    stretched = centre + 1.001 * (xy[half] - centre)
    shift_px = (stretched - xy[half])[:, 0].mean()
    pairs = np.column_stack([np.arange(half.sum()), index[half]])
    stars = Measured(stretched, None, np.full(len(pairs), 0.005**2))
    assert len(pairs) > 8
    found = refine(pairs, stars, CAMERA, guide, estimation.METHODS[name])
    error = np.abs(TRUTH.rotation_vector_to(Attitude.from_matrix(found.matrix)))
    # the prior of the focal length, 0.05 %, holds back less than a tenth of the shift
    assert error[:2].max() < 0.1 * shift_px * CAMERA.pixel_rad


def test_the_last_star_that_may_be_left_is_fitted_again(guide):
    """Four stars, of which one image is in two pieces on both sides of its position: their mean is fitted, though no
    more than the four stars that are needed fit."""
    index, xy = stars_of(guide)
    chosen = np.argsort(np.hypot(*(xy - xy.mean(axis=0)).T))[[-1, -3, -5, -8]]
    pieces = np.vstack([xy[chosen], xy[chosen[0]]])
    pieces[[0, 4], 0] += [-0.2, 0.2]
    pairs = np.column_stack([np.arange(4), index[chosen]])
    stars = Measured(pieces, None, np.full(5, 0.3**2))
    found = refine(pairs, stars, CAMERA, guide, estimation.field_fit)
    # exact but for rounding; 0.2 px of one of four stars turn it by 0.05 px, 2e-5 rad
    assert math.degrees(TRUTH.angle_to(Attitude.from_matrix(found.matrix))) * 3600 < 0.01


@pytest.mark.parametrize("blends", [3, 6, 8])
def test_blends_stay_out_where_the_evidence_for_them_is_decisive(guide, blends):
    """Of 20 stars known to 0.015 px some are displaced by 1 px: more than any field has, and still not the errors of
    all, as 12 stars or more agree to 0.015 px. Fitted with the rest they turn the camera by 1 px √blends / 20."""
    index, xy = stars_of(guide)
    chosen = np.argsort(guide.v_mag[index])[:20]
    assert len(chosen) == 20
    rng = np.random.default_rng(blends)
    seen = xy[chosen] + 0.015 * rng.normal(size=(20, 2))
    angle = rng.uniform(0.0, 2.0 * np.pi, blends)
    displaced = rng.permutation(20)[:blends]
    seen[displaced] += np.column_stack([np.cos(angle), np.sin(angle)])
    pairs = np.column_stack([np.arange(20), index[chosen]])
    found = refine(pairs, Measured(seen, None, np.full(20, 0.015**2)), CAMERA, guide, estimation.field_fit)
    error = TRUTH.rotation_vector_to(Attitude.from_matrix(found.matrix))
    # 0.015 px / √12 across, over both axes, four times
    assert np.hypot(*error[:2]) < 4.0 * 0.015 * np.sqrt(2.0 / 12.0) * CAMERA.pixel_rad
    used = found.pairs[found.used, 0]
    assert np.intersect1d(used, displaced).size == 0
    assert len(used) >= 20 - blends - 1


def test_plate_constants_of_stars_on_a_line_have_the_covariance_of_their_derivatives():
    """Against the estimator's own derivatives by every star's two shifts, for a wide line that is not symmetric."""
    along = np.radians([-30.0, -24.0, -2.0, 1.0, 5.0, 9.0, 33.0])
    observed = np.column_stack([np.sin(along), np.zeros(7), np.cos(along)])
    turned = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])  # neither axis of the plane lies along it
    observed = observed @ turned.T
    sigma = 1e-4 * np.array([1.0, 2.0, 1.0, 3.0, 1.0, 2.0, 1.0])
    found = plate_constants(observed, observed, sigma)
    step, total = 1e-6, np.zeros((3, 3))
    for star, direction in enumerate(observed):
        first = np.cross(direction, [0.36, -0.48, 0.8])
        first /= np.linalg.norm(first)
        for axis in (first, np.cross(direction, first)):
            ends = []
            for sign in (1.0, -1.0):
                moved = observed.copy()
                moved[star] += sign * step * axis
                ends.append(Attitude.from_matrix(plate_constants(moved, observed, sigma).matrix))
            slope = ends[1].rotation_vector_to(ends[0]) / (2.0 * step)
            total += sigma[star] ** 2 * np.outer(slope, slope)
    # central differences of 1e-6 rad: relative error about 1e-6² / extent² and rounding 1e-16/1e-6
    assert np.allclose(found.covariance, total, rtol=1e-5, atol=1e-7 * np.trace(total))


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("name", estimation.METHODS)
def test_the_stated_covariance_of_every_estimator_contains_its_errors(guide, name, known):
    """Mean normalised error squared of 120 lists of the five brightest stars of a field. It is 3 for a consistent
    covariance, with four standard errors of 4 √(6/120); errors known from the residuals of five stars alone (F(3, 7)
    instead of χ²) and the systematic part that the fit allows for make it smaller."""
    tracker = StarTracker(CAMERA, magnitude_limit=6.5, estimator=name)
    squares = []
    for index in range(120):
        rng = np.random.default_rng(index)
        truth = Attitude.from_radec_roll(rng.uniform(0, 360), rng.uniform(-60, 60), rng.uniform(0, 360))
        stars, _, xy = guide.in_field(truth.as_matrix())
        inside = CAMERA.contains(xy)
        flux, xy = 10.0 ** (-0.4 * guide.v_mag[stars][inside])[:5], xy[inside][:5]
        seen = xy + 0.1 * rng.normal(size=xy.shape)
        solution = tracker.solve_centroids(seen, flux, sigma_px=0.1 if known else None, prior=truth, prior_deg=0.2)
        if solution.solved:
            error = truth.rotation_vector_to(solution.attitude)
            own = solution.covariance - unknown_aberration(solution.attitude.as_matrix())
            squares.append(error @ np.linalg.solve(own, error))
    assert len(squares) > 100
    assert 0.8 < np.mean(squares) < 3.0 + 4.0 * math.sqrt(6.0 / len(squares))
