"""The chance that is told is the chance there is: random points get a small one as seldom as it says, or seldomer."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from startracker.catalog import load_catalog
from startracker.catalog.guide import GuideDatabase
from startracker.geometry.camera import Camera
from startracker.identification import Observed, adaptive
from startracker.identification.acceptance import verify
from startracker.identification.bayes_factor import (
    DISTRACTORS,
    SCALE_LOG_PRIOR,
    SCALES,
    SCATTERS_MAG,
    SEEN,
    largest_density,
)
from startracker.solution import Status


@pytest.mark.parametrize(("points", "frames"), [(5, 900), (7, 500)])
def test_random_points_get_a_small_chance_seldom(points, frames):
    """Of N frames of random points a share of at most x may be told a chance of x or less.

    The allowance is three standard deviations of that count, √(N x), upwards.
    """
    camera = Camera.from_fov(10.0, 512, 512)
    guide = GuideDatabase.build(load_catalog("hipparcos"), camera, 6.0)
    rng = np.random.default_rng(points)
    told = np.empty(frames)
    for frame in range(frames):
        xy = rng.uniform(-0.5, 511.5, (points, 2))
        flux = 10.0 ** (-0.4 * np.sort(guide.v_mag[rng.integers(0, len(guide), points)]))
        found = adaptive(Observed(camera.unproject(xy), flux, np.full(points, 0.15 * camera.pixel_rad)), guide)
        assert found.status is not Status.SOLVED
        told[frame] = found.log_false_alarm
    for chance in (0.05, 0.02, 0.005):
        count = int(np.sum(told <= math.log(chance)))
        assert count <= frames * chance + 3.0 * math.sqrt(frames * chance)
    assert (told < 0.0).any()  # nor is every one of them simply told that nothing was found


def test_the_density_of_the_evidence_is_below_its_bound():
    """Skies drawn from the hypothesis itself: attitude, depth, losses, distractors, errors by their prior weights.

    ln B at the true attitude, as a histogram of two-nat bins for each number of stars. A bin of expected count c is
    allowed 3.5 √c more: 7 groups of 28 bins each, of which one in 4000 may be that high.
    """
    camera = Camera.from_fov(10.0, 512, 512)
    guide = GuideDatabase.build(load_catalog("hipparcos"), camera, 6.0)
    rng = np.random.default_rng(77)
    drawn = []
    for matrix in Rotation.random(20000, rng=rng).as_matrix():
        index, _, xy = guide.in_field(matrix)
        if len(index) == 0:
            continue
        depth = int(rng.integers(1, len(index) + 1))
        seen = rng.random(depth) < rng.choice([p for p, _ in SEEN], p=[w for _, w in SEEN])
        index, xy = index[:depth][seen], xy[:depth][seen]
        distractors = rng.poisson(rng.choice([m for m, _ in DISTRACTORS], p=[w for _, w in DISTRACTORS]))
        n = len(index) + distractors
        if not 3 <= n < 30:
            continue
        error_px = 0.15 * rng.choice(SCALES, p=np.exp(SCALE_LOG_PRIOR))
        xy = np.concatenate([xy + error_px * rng.standard_normal(xy.shape), rng.uniform(-0.5, 511.5, (distractors, 2))])
        magnitude = guide.v_mag[index] + rng.choice(SCATTERS_MAG) * rng.standard_normal(len(index))
        magnitude = np.concatenate([magnitude, guide.v_mag[rng.integers(0, len(guide), distractors)]])
        order = np.argsort(magnitude)
        stars = Observed(
            camera.unproject(xy[order]), 10.0 ** (-0.4 * magnitude[order]), np.full(n, 0.15 * camera.pixel_rad)
        )
        found, _ = verify(matrix, stars, guide, 7.0)
        drawn.append((n, -99.0 if found is None else found.log_evidence))
    table = np.array(drawn)
    for low, high in ((3, 4), (4, 5), (5, 7), (7, 9), (9, 12), (12, 18), (18, 30)):
        values = table[(table[:, 0] >= low) & (table[:, 0] < high), 1]
        assert len(values) > 1000
        counts = np.histogram(values, np.arange(4.0, 60.0, 2.0))[0]
        bound = 2.0 * len(values) * largest_density(high - 1)
        assert counts.max() <= bound + 3.5 * math.sqrt(bound)
        assert counts.max() > 0.2 * bound  # nor is the bound far from what there is
