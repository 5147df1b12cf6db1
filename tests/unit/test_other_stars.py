"""The occupancy map against the stars themselves, and matches counted with its help and without."""

import math

import numpy as np
import pytest
from scipy.spatial import cKDTree

from startracker.catalog import load_catalog
from startracker.catalog.guide import GuideDatabase
from startracker.estimation.directions import focal_slopes
from startracker.geometry.camera import Camera
from startracker.identification.bayes_factor import count_table
from startracker.identification.other_stars import (
    NO_OCCUPANCY,
    enough_matches,
    is_occupied,
    occupancy_map,
    other_stars,
    room,
)
from startracker.identification.search_state import Stars


@pytest.fixture(scope="module")
def sky():
    return GuideDatabase.build(load_catalog("hipparcos"), Camera.from_fov(10.0, 512, 512), 6.5).view


def sphere(count, seed):
    v = np.random.default_rng(seed).standard_normal((count, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


@pytest.mark.parametrize("reach", [1e-4, 1e-3, 1e-2])
def test_a_direction_near_a_guide_star_is_always_marked(sky, reach):
    occupancy = occupancy_map(sky.directions, reach)
    rng = np.random.default_rng(7)
    stars = sky.directions[rng.integers(len(sky.directions), size=20000)]
    away = stars + 0.9999 * reach * sphere(20000, 8)  # on the rim, on all sides
    assert all(is_occupied(x, y, z, occupancy) for x, y, z in away)


def test_few_directions_far_from_guide_stars_are_marked(sky):
    """Cells of three reaches that a star's box touches: each 4/3 of a cell along an axis, (4/3 · 3 · reach)² of the sky
    across, and a fortieth for hashes that meet; twice as much is allowed."""
    reach = 1e-3
    occupancy, positions = occupancy_map(sky.directions, reach), sphere(20000, 9)
    far = cKDTree(sky.directions).query(positions)[0] > reach
    share = np.mean([is_occupied(x, y, z, occupancy) for x, y, z in positions[far]])
    touched = len(sky.directions) * (4.0 * reach) ** 2 / (4.0 * math.pi)
    assert share < 2.0 * (touched + 0.025)


@pytest.mark.parametrize("sigma_max", [1.0, 6.0])
def test_the_map_changes_no_answer(sky, sigma_max):
    """Of positions drawn at random and of true ones, with stars beyond the reach of the map and without."""
    rng = np.random.default_rng(3)
    camera = Camera.from_fov(10.0, 512, 512)
    vectors = camera.unproject(rng.uniform(0.0, 511.0, (30, 2)))
    sigma = 5e-5 * rng.uniform(0.5, sigma_max, 30)
    unknown, even = np.full(30, np.nan), np.zeros((1, 30))
    stars = Stars(vectors, focal_slopes(vectors), sigma, unknown, count_table(30, 70), even)
    others, gate = room(), 20.0
    looked = other_stars(0, 1, 2, stars, gate, others)
    occupancy = occupancy_map(sky.directions, 1.5 * gate * float(np.median(sigma)))
    pairs = rng.integers(len(sky.directions), size=(3000, 2))
    ends = sky.directions[pairs[pairs[:, 0] != pairs[:, 1]]]
    answers = np.array(
        [[enough_matches(u, w, 1.0, others, looked, 1, sky, m) for m in (NO_OCCUPANCY, occupancy)] for u, w in ends]
    )
    assert np.array_equal(answers[:, 0], answers[:, 1])
    assert 0.02 < answers.mean() < 0.98
