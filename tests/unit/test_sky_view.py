"""The grid of stars and the outline of a field against looking at every star."""

import math

import numpy as np
import pytest

from startracker.catalog.sky_view import field_shape, in_shape, star_within, stars_in_cone, voxel_grid
from startracker.geometry.camera import Camera
from startracker.geometry.distortion import Distortion

CAMERAS = {
    "narrow": Camera.from_fov(3.0, 512, 512),
    "wide": Camera.from_fov(60.0, 640, 480),
    "mirrored and off its centre": Camera(900.0, 880.0, 100.0, 500.0, 800, 600, parity=-1),
    "barrel": Camera(700.0, 700.0, 400.0, 300.0, 800, 600, Distortion(k1=-0.2, k2=0.03)),
    "fisheye": Camera(300.0, 300.0, 399.5, 299.5, 800, 600, projection="equidistant"),
}


def unit_vectors(rng, count):
    v = rng.standard_normal((count, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


@pytest.mark.parametrize("count", [3, 500, 20000])
def test_cones_and_neighbours_are_those_of_brute_force(count):
    rng = np.random.default_rng(count)
    stars = unit_vectors(rng, count)
    grid = voxel_grid(stars)
    for axis, radius in zip(unit_vectors(rng, 60), rng.uniform(0.001, 0.7, 60), strict=True):
        cosine = stars @ axis
        found = np.sort(stars_in_cone(*axis, math.cos(radius), stars, grid))
        assert np.array_equal(found, np.flatnonzero(cosine >= math.cos(radius)))
        chord2 = np.sum((stars - axis) ** 2, axis=1)
        gate = rng.uniform(0.2, 3.0) * chord2.min()
        assert star_within(*axis, gate, stars, grid) == bool((chord2 <= gate).any())


def test_poles_and_axes_of_the_grid_are_no_special_places():
    stars = np.concatenate([np.eye(3), -np.eye(3)])
    grid = voxel_grid(stars)
    for k, star in enumerate(stars):
        assert stars_in_cone(*star, math.cos(0.1), stars, grid).tolist() == [k]
        assert star_within(*star, 1e-12, stars, grid)


def test_stars_moved_by_aberration_are_still_found():
    rng = np.random.default_rng(3)
    stars = unit_vectors(rng, 5000)
    grid = voxel_grid(stars)
    moved = stars + 1.3e-4 * unit_vectors(rng, 5000)  # 26″
    moved /= np.linalg.norm(moved, axis=1, keepdims=True)
    for k in range(500):
        assert star_within(*moved[k], 1e-14, moved, grid)


@pytest.mark.parametrize("name", CAMERAS)
def test_the_outline_is_the_image(name):
    camera = CAMERAS[name]
    rng = np.random.default_rng(1)
    vectors = unit_vectors(rng, 60000)
    vectors = vectors[vectors[:, 2] > math.cos(camera.half_diagonal_rad + 0.02)]
    if len(vectors) < 500:  # a narrow field: more of the sky around it
        spread = rng.uniform(-1.2, 1.2, (5000, 2)) * camera.half_diagonal_rad
        vectors = np.concatenate([spread, np.ones((5000, 1))], axis=1)
        vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    shape = field_shape(camera, margin_px=0.0)
    inside = np.array([in_shape(*v, shape) for v in vectors])
    angle = np.arccos(vectors[:, 2])
    pixels = camera.project(vectors)
    real = camera.contains(pixels) & (angle <= camera.half_diagonal_rad)
    # interpolation over half a degree of azimuth cuts a corner by at most a pixel or two
    width = np.minimum.reduce(
        [pixels[:, 0] + 0.5, camera.width - 0.5 - pixels[:, 0], pixels[:, 1] + 0.5, camera.height - 0.5 - pixels[:, 1]]
    )
    near_rim = np.abs(width) < 0.006 * camera.width
    assert 0.01 < real.mean() < 0.99
    assert np.array_equal(inside[~near_rim], real[~near_rim])
