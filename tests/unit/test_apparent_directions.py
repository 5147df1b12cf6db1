"""Kernels for directions on the sky and positions on the image, compared with NumPy."""

import numpy as np
import pytest

from startracker.catalog import load_catalog
from startracker.catalog.guide import GuideDatabase
from startracker.catalog.sky_view import apparent_directions
from startracker.core import SPEED_OF_LIGHT_KM_S
from startracker.geometry.camera import Camera
from startracker.geometry.distortion import Distortion, undistort
from startracker.inputs import SAME_STAR_PX, usable_centroids
from startracker.observer import Observer, aberrate


@pytest.mark.parametrize("parity", [1, -1])
@pytest.mark.parametrize("lens", [Distortion(), Distortion(k1=-0.2, k2=0.05, p1=1e-3, p2=-2e-3, k3=0.01)])
def test_directions_of_pixels_are_those_of_the_formula(lens, parity):
    camera = Camera(900.0, 880.0, 250.0, 200.0, 512, 420, lens, parity)
    xy = np.random.default_rng(1).uniform(-10.0, 520.0, (500, 2))
    plane = np.stack([parity * (xy[:, 0] - 250.0) / 900.0, (xy[:, 1] - 200.0) / 880.0], axis=1)
    if lens.k1:
        plane = undistort(plane, lens.as_array())
    expected = np.concatenate([plane, np.ones((500, 1))], axis=1)
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(camera.unproject(xy), expected, rtol=0, atol=2e-16)


def test_stars_are_moved_and_aberrated_as_the_catalogue_says():
    catalog = load_catalog("hipparcos").brighter_than(6.0)
    place, velocity, epoch = np.array([0.3, -0.9, -0.4]), np.array([-20.0, 17.0, 9.0]), 2026.4
    start, motion = (np.ascontiguousarray(axes.T) for axes in catalog.space_motion())
    years = epoch - catalog.epoch_jyear
    beta = velocity / SPEED_OF_LIGHT_KM_S
    found = apparent_directions(start, motion, catalog.parallax_rad, years, place, beta)
    expected = aberrate(catalog.directions(epoch, place), velocity)
    np.testing.assert_allclose(found, expected, rtol=0, atol=5e-16)
    still = apparent_directions(start, motion, catalog.parallax_rad, 0.0, np.zeros(3), np.zeros(3))
    np.testing.assert_allclose(still, start.T, rtol=0, atol=5e-16)


def test_cones_hold_the_fastest_stars_long_after_the_grid_was_made():
    camera = Camera.from_fov(10.0, 512, 512)
    guide = GuideDatabase.build(load_catalog("hipparcos"), camera, 6.5)
    assert len(guide.view.grid.members) == len(guide)  # of the catalogue's epoch
    seen = guide.apparent_to(Observer(2041.25, np.array([15.0, 20.0, -10.0]), np.array([0.5, 0.8, 0.3])))
    moved = np.linalg.norm(seen.directions - guide.directions, axis=1)
    fastest = np.argsort(-moved)[:20]
    assert moved[fastest[0]] > 1e-3
    rng = np.random.default_rng(2)
    for star in fastest:
        for radius in (1e-4, 0.01, 0.1):
            # near the rim, from all sides
            axis = seen.directions[star] + rng.normal(size=3) * radius * 0.5
            axis /= np.linalg.norm(axis)
            cosine = seen.directions @ axis
            assert seen.in_cone(axis, radius).tolist() == np.flatnonzero(cosine >= np.cos(radius)).tolist()


def test_of_centroids_too_near_the_first_stays():
    rng = np.random.default_rng(3)
    xy = rng.uniform(0.0, 12.0, (60, 2))
    kept, _, _ = usable_centroids(xy, None, 512, 512)
    apart = np.abs(xy[:, None] - xy[None, :]).max(axis=2) < SAME_STAR_PX
    expected = [i for i in range(len(xy)) if not apart[i, :i].any()]
    assert kept.tolist() == xy[expected].tolist()
    assert len(expected) < len(xy)
