"""Every search ends after so many operations, and says so; the operations are the same each time."""

import math
import time

import numpy as np
import pytest

from benchmarks.adversarial import make
from startracker import Attitude, Camera, IdentificationSettings, StarTracker, Status, solve_unknown_fov
from startracker.identification import METHODS
from startracker.inputs import SAME_STAR_PX, _first_of_each, usable_centroids
from startracker.sorting import order_of_columns

CAMERA = Camera.from_fov(10.0, 512, 512)


@pytest.mark.parametrize("identifier", METHODS)
def test_every_method_ends_at_its_limit_and_says_so(identifier):
    rng = np.random.default_rng(5)
    xy, flux = rng.uniform(0.0, 511.0, (40, 2)), rng.uniform(0.1, 1.0, 40)
    limit = 3_000_000
    settings = IdentificationSettings(max_operations=limit)
    tracker = StarTracker(CAMERA, magnitude_limit=6.0, identifier=identifier, identification=settings)
    solution = tracker.solve_centroids(xy, flux)
    assert solution.status is Status.SEARCH_LIMIT
    assert "max_operations 3e+06" in solution.reason
    # the step that reaches the limit is ended: a window of pairs, or a verification
    assert 0 < solution.operations < 2.0 * limit
    assert tracker.solve_centroids(xy, flux).operations == solution.operations
    around = tracker.solve_centroids(xy, flux, prior=Attitude.from_radec_roll(10.0, 20.0, 30.0))
    assert not around.solved
    assert around.operations < 4.0 * limit


@pytest.mark.parametrize("identifier", sorted(METHODS))
def test_a_usual_field_needs_a_small_part_of_the_limit(identifier):
    tracker = StarTracker(CAMERA, magnitude_limit=6.0, identifier=identifier)
    attitude = Attitude.from_radec_roll(85.0, -2.0, 123.0)
    index, _, xy = tracker.guide.in_field(attitude.as_matrix())
    solution = tracker.solve_centroids(xy, 10.0 ** (-0.4 * tracker.guide.v_mag[index]))
    assert solution.solved, solution.reason
    assert 0 < solution.operations < 0.1 * tracker.identification.max_operations
    assert solution.log_false_alarm < math.log(1e-7)


def test_a_free_focal_length_ends_at_its_limit():
    xy, flux = make("uniform", "10deg", 1, 7)
    settings = IdentificationSettings(max_operations_free_scale=1_000_000)
    solution = solve_unknown_fov(xy, 512, 512, flux=flux, identification=settings)
    assert solution.status is Status.SEARCH_LIMIT
    assert 0 < solution.operations < 3_000_000


def test_a_crowded_frame_in_a_narrow_field_is_refused_in_bounded_time():
    """200 false of 211 points, 5 degrees, to V = 8: the search that once took ten minutes."""
    camera = Camera.from_fov(5.0, 512, 512)
    tracker = StarTracker(camera, magnitude_limit=8.0)
    rng = np.random.default_rng(2)
    index, _, xy = tracker.guide.in_field(Attitude.from_radec_roll(200.0, 60.0, 10.0).as_matrix())
    magnitude = np.concatenate([tracker.guide.v_mag[index][:11], rng.uniform(4.0, 8.0, 200)])
    order = np.argsort(magnitude)
    points = np.concatenate([xy[:11], rng.uniform(0.0, 511.0, (200, 2))])[order]
    tracker.solve_centroids(points[:5])  # kernels and pairs
    started = time.process_time()
    solution = tracker.solve_centroids(points, 10.0 ** (-0.4 * magnitude[order]))
    assert solution.operations <= 1.1 * tracker.identification.max_operations
    assert time.process_time() - started < 20.0
    assert solution.status in (Status.SOLVED, Status.NO_MATCH, Status.SEARCH_LIMIT)
    if solution.solved:
        assert math.degrees(Attitude.from_radec_roll(200.0, 60.0, 10.0).angle_to(solution.attitude)) < 0.1


def test_long_lists_are_cut_to_the_brightest():
    """30,000 points once took all memory there is; the true stars are the brightest here, and found."""
    tracker = StarTracker(CAMERA, magnitude_limit=6.5)
    attitude = Attitude.from_radec_roll(85.0, -2.0, 123.0)
    index, _, xy = tracker.guide.in_field(attitude.as_matrix())
    rng = np.random.default_rng(3)
    points = np.concatenate([xy, rng.uniform(0.0, 511.0, (30_000, 2))])
    flux = np.concatenate([10.0 ** (-0.4 * tracker.guide.v_mag[index]), np.full(30_000, 1e-5)])
    solution = tracker.solve_centroids(points, flux)
    assert solution.solved, solution.reason
    assert math.degrees(attitude.angle_to(solution.attitude)) < 0.05
    assert any("max_centroids" in step.text for step in solution.steps)
    assert not tracker.solve_centroids(points[len(xy) :], flux[len(xy) :]).solved
    assert not solve_unknown_fov(points[len(xy) :], 512, 512, flux=flux[len(xy) :], fov_deg=10.0).solved


def test_a_star_found_twice_is_one():
    rng = np.random.default_rng(4)
    points = rng.uniform(0.0, 60.0, (1500, 2))
    near = np.abs(points[:, None] - points[None]).max(axis=2) < SAME_STAR_PX
    expected = ~np.tril(near, -1).any(axis=1)
    np.testing.assert_array_equal(_first_of_each(points), expected)
    kept, _, _ = usable_centroids(points, None, CAMERA.width, CAMERA.height)
    np.testing.assert_array_equal(kept, points[expected])


@pytest.mark.parametrize("count", [0, 1, 2, 7, 60, 500])
def test_columns_are_sorted_as_by_numpy(count):
    keys = np.random.default_rng(count).integers(0, 4, (3, count)).astype(float)
    np.testing.assert_array_equal(order_of_columns(keys), np.lexsort(keys[::-1]))
