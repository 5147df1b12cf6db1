"""What a fit of the attitude starts from: usable centroids, and predicted stars with what displaces them."""

import math

import numpy as np
import pytest

from startracker import Attitude, Camera, StarTracker
from startracker.errors import InputError
from startracker.estimation.association import EXTRA_SIGMA, Displaced, predicted_pixels
from startracker.estimation.directions import fit_pairs
from startracker.estimation.refine import _first_fit
from startracker.estimation.wahba import fit_rotation
from startracker.inputs import SAME_STAR_PX, stated_variance, usable_centroids

CAMERA = Camera.from_fov(12.0, 100, 80)


# ---------------------------------------------------------------------- centroids
def test_usable_centroids_are_finite_and_on_the_image():
    xy = np.array(
        [
            *([-0.5, 40.0], [-0.51, 40.0], [99.49, 10.0], [99.5, 10.0], [5.0, -0.5]),
            *([5.0, -0.51], [8.0, 79.49], [8.0, 79.5], [math.nan, 3.0], [3.0, math.inf]),
        ]
    )
    points, flux, rows = usable_centroids(xy, None, CAMERA.width, CAMERA.height)
    assert rows.tolist() == [0, 2, 4, 6]
    assert flux is None
    np.testing.assert_array_equal(points, xy[rows])


def test_the_brightest_come_first_and_unknown_fluxes_last():
    """A flux that is not positive and finite is half the faintest; ties are broken by y and then x."""
    xy = np.array([[10.0, 10.0], [20.0, 10.0], [30.0, 10.0], [40.0, 10.0], [50.0, 5.0], [60.0, 10.0], [6.0, 10.0]])
    flux = [5.0, math.nan, 8.0, -1.0, 5.0, math.inf, 5.0]
    points, signal, rows = usable_centroids(xy, flux, CAMERA.width, CAMERA.height)
    assert rows.tolist() == [2, 4, 6, 0, 1, 3, 5]
    assert signal.tolist() == [8.0, 5.0, 5.0, 5.0, 2.5, 2.5, 2.5]
    np.testing.assert_array_equal(points, xy[rows])
    order = np.random.default_rng(1).permutation(7)
    again = usable_centroids(xy[order], np.array(flux)[order], CAMERA.width, CAMERA.height)
    np.testing.assert_array_equal(again[0], points)
    np.testing.assert_array_equal(order[again[2]], rows)
    # without any positive flux they are as given
    points, signal, rows = usable_centroids(xy, np.zeros(7), CAMERA.width, CAMERA.height)
    assert signal is None
    assert rows.tolist() == list(range(7))
    assert usable_centroids(xy, flux, CAMERA.width, CAMERA.height)[1].tolist() == [8.0, 5.0, 5.0, 5.0, 2.5, 2.5, 2.5]


def test_of_duplicates_the_brightest_stays():
    """Closer on both axes than the limit, also to one that is left out itself."""
    near, far = SAME_STAR_PX - 0.01, SAME_STAR_PX + 0.01
    xy = np.array(
        [[10.0, 10.0], [10.0 + near, 10.0 - near], [10.0 + far, 10.0], [10.0, 10.0 + far], [10.0 - near, 10.0]]
    )
    _, flux, rows = usable_centroids(xy, [5.0, 4.0, 3.0, 2.0, 9.0], CAMERA.width, CAMERA.height)
    assert rows.tolist() == [4, 3]
    assert flux.tolist() == [9.0, 2.0]
    _, _, rows = usable_centroids(xy[[0, 2, 3]], [5.0, 3.0, 2.0], CAMERA.width, CAMERA.height)
    assert rows.tolist() == [0, 1, 2]
    _, _, rows = usable_centroids(xy[:2], None, CAMERA.width, CAMERA.height)
    assert rows.tolist() == [0]


def test_shapes_that_do_not_fit():
    for xy, flux, message in (
        (np.zeros((3, 3)), None, r"shape \(N, 2\), columns x and y; got \(3, 3\)"),
        (np.zeros(4), None, r"got \(4,\)"),
        (np.zeros((3, 2)), [1.0], "there are 3 centroids, but 1 fluxes"),
        ([["a", "b"]], None, "must be numbers"),
    ):
        with pytest.raises(InputError, match=message):
            usable_centroids(xy, flux, CAMERA.width, CAMERA.height)
    assert usable_centroids([], None, CAMERA.width, CAMERA.height)[0].shape == (0, 2)


def test_stated_errors_belong_to_their_centroids():
    rows = np.array([2, 0])
    assert stated_variance(None, 3, rows) is None
    assert stated_variance(0.5, 3, rows).tolist() == [0.25, 0.25]
    assert stated_variance([1.0, 2.0, 3.0], 3, rows).tolist() == [9.0, 1.0]
    assert stated_variance([], 0, np.empty(0, int)).tolist() == []
    for bad in (0.0, -1.0, math.nan, math.inf, [1.0, 0.0, 1.0], [1.0, math.nan, 1.0], [1.0, math.inf, 1.0]):
        with pytest.raises(InputError, match="positive and finite"):
            stated_variance(bad, 3, rows)
    with pytest.raises(InputError, match=r"3 centroids, but sigma_px has the shape \(2,\)"):
        stated_variance([1.0, 2.0], 3, rows)


# ---------------------------------------------------------------------- predicted stars
@pytest.mark.parametrize("rolls", [False, True])
@pytest.mark.parametrize("moves", [False, True])
@pytest.mark.parametrize("scales", [False, True])
def test_displacements_of_stars_are_derivatives_of_their_pixels(rolls, moves, scales):
    """By a rotation of the camera in proportion to the row's time, by a year of space motion, and by scale."""
    camera = Camera(2000.0, 2100.0, 480.0, 400.0, 1000, 800, row_time_s=2e-5)
    guide = StarTracker(camera, magnitude_limit=6.5).guide
    attitude = Attitude.from_radec_roll(83.0, -1.0, 20.0).as_matrix()
    index, _, positions = guide.in_field(attitude)
    motion = guide.motion_axes
    displaced = Displaced(rolls, moves, scales)
    pixels, offset, slopes, extra = predicted_pixels(
        index, attitude, guide.directions, motion, camera.image_map, 2e-5, displaced
    )
    np.testing.assert_allclose(pixels, positions, atol=1e-9)
    np.testing.assert_allclose(offset, positions - [480.0, 400.0], atol=1e-9)
    vectors = guide.directions[index] @ attitude.T
    for axis in range(3):
        turn = np.zeros(3)
        turn[axis] = 1e-6
        ends = [camera.project(vectors - sign * np.cross(turn, vectors)) for sign in (1.0, -1.0)]
        np.testing.assert_allclose(slopes[:, :, axis], (ends[0] - ends[1]) / 2e-6, rtol=1e-6, atol=1e-3)
    expected = []
    if rolls:
        time_s = (positions[:, 1] - 399.5) * 2e-5
        expected += [slopes[:, :, k] * time_s[:, None] for k in range(3)]
    if moves:
        across = motion[:, index].T
        across = across - np.sum(across * guide.directions[index], axis=1)[:, None] * guide.directions[index]
        step = 1.0
        ends = [camera.project((guide.directions[index] + sign * step * across) @ attitude.T) for sign in (1.0, -1.0)]
        expected.append((ends[0] - ends[1]) / (2.0 * step))
    if scales:
        expected.append(offset)
    assert extra.shape == (len(index), 2, len(expected))
    assert EXTRA_SIGMA[displaced].shape == (len(expected),)
    for k, column in enumerate(expected):
        np.testing.assert_allclose(extra[:, :, k], column, rtol=1e-6, atol=1e-9)


def test_a_first_attitude_that_does_not_converge_is_the_best_rotation():
    """Newton's step from two stars of a pattern that does not match is too long; Markley's rotation needs no start."""
    rng = np.random.default_rng(6)
    seen, known = (
        directions / np.linalg.norm(directions, axis=1)[:, None] for directions in rng.normal(size=(2, 5, 3))
    )
    pairs, sigma = np.column_stack([np.arange(5), np.arange(5)]), rng.uniform(0.5, 2.0, 5)
    matrix, reference = fit_pairs(pairs, seen, known, sigma, np.zeros((3, 3)))
    assert math.isnan(matrix[0, 0])
    found, again = _first_fit(pairs, seen, known, sigma, np.zeros((3, 3)))
    np.testing.assert_array_equal(again, reference)
    np.testing.assert_allclose(found @ found.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(found, fit_rotation(seen, known, sigma**-2.0), atol=1e-12)
    turn = Attitude.from_rotation_vector([0.1, -0.2, 0.3], "icrs", "camera").as_matrix()
    near, _ = _first_fit(pairs, known @ turn.T, known, sigma, np.zeros((3, 3)))
    np.testing.assert_allclose(near, turn, atol=1e-9)
