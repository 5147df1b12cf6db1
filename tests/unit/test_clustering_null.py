"""The density of crowded points, and what a match of such points is worth."""

import math

import numpy as np
import pytest

from startracker import Attitude, Camera, StarTracker
from startracker.identification.clustering_null import WIDTHS, clustering_price, log_excess_density


def by_hand(points, area):
    d2 = np.sum((points[:, None] - points[None]) ** 2, axis=2)
    extent2 = np.sum(points.var(axis=0))
    rows = []
    for width in range(WIDTHS):
        h2 = extent2 / 4.0**width
        kernel = 1.0 / (math.pi * h2 * (1.0 + d2 / h2) ** 2)
        np.fill_diagonal(kernel, 0.0)
        rows.append(kernel.sum(axis=1) / (len(points) - 1))
    rows.append(np.mean(rows, axis=0))
    return np.log(0.9 * area * np.array(rows) + 0.1)


@pytest.mark.parametrize("axes", [2, 3])
def test_the_kernel_is_the_sum_by_hand(axes):
    points = np.random.default_rng(axes).uniform(0.0, 100.0, (15, axes))
    np.testing.assert_allclose(log_excess_density(points, 1e4), by_hand(points, 1e4), rtol=1e-12)


def test_points_at_one_position_or_alone_have_no_density():
    assert not log_excess_density(np.full((7, 2), 3.0), 1.0).any()
    assert not log_excess_density(np.zeros((1, 2)), 1.0).any()


def test_even_points_cost_little_and_a_clump_much():
    rng = np.random.default_rng(1)
    everything = np.arange(30)
    even = [clustering_price(log_excess_density(rng.uniform(0, 1000, (30, 2)), 1e6), everything) for _ in range(200)]
    assert np.median(even) < 1.0
    assert np.mean(np.array(even) > 10.0) < 0.05
    clump = [
        clustering_price(log_excess_density(30 * rng.standard_normal((30, 2)), 1e6), everything) for _ in range(20)
    ]
    # the density at a Gaussian's points is 1/(4π σ²) on average, e^4.5 times the even one
    assert min(clump) > 30 * 2.5


@pytest.mark.parametrize(("ra_deg", "dec_deg"), [(56.9, 24.1), (66.7, 15.9), (130.1, 19.7), (83.8, -5.4)])
@pytest.mark.parametrize("fov_deg", [10.0, 15.0])
def test_true_fields_with_an_open_cluster_are_still_solved(ra_deg, dec_deg, fov_deg):
    """Pleiades, Hyades, Praesepe and the sword of Orion, in the middle of the field and near its corner."""
    camera = Camera.from_fov(fov_deg, 1024, 1024)
    tracker = StarTracker(camera, magnitude_limit=6.5)
    rng = np.random.default_rng(3)
    for off_deg in (0.0, 0.35 * fov_deg):
        attitude = Attitude.from_radec_roll(ra_deg + off_deg, dec_deg + 0.3 * off_deg, rng.uniform(0, 360))
        index, _, xy = tracker.guide.in_field(attitude.as_matrix())
        kept = rng.random(len(index)) > 0.2
        flux = 10.0 ** (-0.4 * tracker.guide.v_mag[index[kept]])
        solution = tracker.solve_centroids(xy[kept] + 0.2 * rng.standard_normal((kept.sum(), 2)), flux)
        assert solution.solved, solution.reason
        assert math.degrees(attitude.angle_to(solution.attitude)) < 0.02
