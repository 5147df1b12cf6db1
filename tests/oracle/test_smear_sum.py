"""Smear against brute force: 1,000-step sums (4,000 for sharp images), and astropy-free rotation by scipy's Rotation.

The smeared image of ours is within 1e-4 of the peak of the sum. The sum itself (midpoints) is within (step/σ)²/24 of
the integral: at 47 px and σ = 0.35 in 4,000 steps 5e-5 at the ends of the streak, less elsewhere.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from simulator.optics.psf import build_psf
from simulator.optics.psf_model import PsfModel
from simulator.optics.smear import exposure_nodes, star_paths
from simulator.optics.splat import render_stars
from startracker.geometry.camera import Camera
from startracker.geometry.distortion import Distortion

PSFS = [
    ("gaussian", {"sigma_px": 1.2}),
    ("gaussian", {"sigma_px": 0.35}),
    ("airy", {"first_dark_ring_px": 2.0}),
    ("airy", {"first_dark_ring_px": 0.5}),
]


@pytest.mark.parametrize(("model", "width"), PSFS)
@pytest.mark.parametrize("streak", [0.01, 0.1, 0.7, 2.0, 8.0, 47.0])
def test_straight_streaks(model, width, streak):
    psf = build_psf(PsfModel(model=model, **width), 2.0, (10.0, 10.0))
    half = streak / 2 * np.array([0.8, 0.6])
    middle = np.array([31.7, 32.2])
    nodes, weights = exposure_nodes(streak, psf.feature_px)
    ours = render_stars((64, 64), (middle + nodes[:, None] * half)[None], weights, [1e4], psf)
    steps = 1000 if streak < 10 else 4000
    t = 2 * (np.arange(steps) + 0.5) / steps - 1
    brute = render_stars((64, 64), (middle + t[:, None] * half)[None], np.full(steps, 1 / steps), [1e4], psf)
    assert np.abs(ours - brute).max() < 1e-4 * brute.max()


@pytest.mark.parametrize("rate_deg_s", [(0, 0, 30.0), (4.0, -7.0, 0.0), (3.0, 2.0, -20.0)])
def test_paths_against_scipy_rotations(rate_deg_s):
    """v(t) = R(−ω t) v: exact to rounding, arcs for a roll about the boresight included."""
    camera = Camera(2000.0, 2000.0, 511.5, 511.5, 1024, 1024, Distortion(k1=-0.05, k2=0.01))
    pixels = np.array([[100.0, 900.0], [511.5, 511.5], [1000.0, 512.0]])
    rate = np.radians(rate_deg_s)
    xy, weights = star_paths(camera, camera.unproject(pixels), rate, 0.2, 1.0)
    nodes, again = exposure_nodes_of(len(weights))
    # by NumPy; the weights sum to 1, and 40-digit arithmetic shows both to be right to 4e-15 of that for 62 points
    np.testing.assert_allclose(weights, again, rtol=0.0, atol=1e-14)
    for k, t in enumerate(nodes * 0.1):
        turned = Rotation.from_rotvec(-rate * t).apply(camera.unproject(pixels))
        np.testing.assert_allclose(xy[:, k], camera.project(turned), atol=1e-8)


def exposure_nodes_of(count):
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return nodes, weights / 2


def test_roll_draws_arcs_about_the_principal_point():
    camera = Camera.from_fov(10.0, 512, 512)
    star = camera.unproject(np.array([[455.5, 255.5]]))
    xy, _ = star_paths(camera, star, [0, 0, np.radians(90.0)], 1.0, 1.0)
    radius = np.hypot(xy[0, :, 0] - 255.5, xy[0, :, 1] - 255.5)
    np.testing.assert_allclose(radius, 200.0, atol=1e-9)
    # a camera that turns from x towards y sees the stars go from y towards x
    assert xy[0, 0, 1] > 255.5 > xy[0, -1, 1]


def test_direction_of_drift():
    """Turning about +y takes the boresight towards +x, so stars go towards −x."""
    camera = Camera.from_fov(10.0, 512, 512)
    xy, _ = star_paths(camera, np.array([[0.0, 0.0, 1.0]]), [0, np.radians(1.0), 0], 0.5, 1.0)
    assert xy[0, -1, 0] < xy[0, 0, 0]
    np.testing.assert_allclose(xy[0, :, 1], 255.5, atol=1e-9)


def test_a_long_streak_across_the_frame():
    """10°/s over 0.1 s on 1,000 px a degree: 1,000 px; every pixel of the streak's inside gets the same light."""
    focal = 1000.0 / np.radians(1.0)
    camera = Camera(focal, focal, 599.5, 20.0, 1200, 41)
    psf = build_psf(PsfModel(sigma_px=0.8), 2.0, (10.0, 10.0))
    rate = [0, np.radians(10.0), 0]
    xy, weights = star_paths(camera, np.array([[0.0, 0.0, 1.0]]), rate, 0.1, psf.feature_px)
    image = render_stars((41, 1200), xy, weights, [1e6], psf)
    row = image.sum(axis=0)
    assert image.sum() == pytest.approx(1e6, rel=1e-6)
    # the density on the image falls as 1 − θ² from the middle by 8e-5 at 0.5°, the projection's own stretch
    np.testing.assert_allclose(row[110:1090], 1000.0, rtol=2e-4)


def test_nodes():
    for streak in (0.0, 0.3, 5.0, 400.0, 5000.0):
        nodes, weights = exposure_nodes(streak)
        assert weights.sum() == pytest.approx(1.0, abs=1e-12)
        assert (weights > 0).all()
        assert (np.diff(nodes) > 0).all()
        assert (weights * nodes**2).sum() == pytest.approx(1 / 3 if streak else 0.0, abs=1e-12)
    assert len(exposure_nodes(0.0)[0]) == 1
    assert len(exposure_nodes(100.0)[0]) > len(exposure_nodes(10.0)[0])


def test_no_rate_is_one_moment_and_stars_far_outside_are_left_out():
    camera = Camera.from_fov(10.0, 512, 512)
    xy, weights = star_paths(
        camera, np.array([[0, 0, 1.0], [0, 0, -1.0], [1.0, 0, 0], [0.5, 0, 0.866]]), [0, 0, 0], 1.0
    )
    assert weights.tolist() == [1.0]
    np.testing.assert_allclose(xy[0, 0], [255.5, 255.5])
    assert np.isnan(xy[1:]).all()


def test_margin_follows_wide_bodies():
    camera = Camera.from_fov(10.0, 512, 512)
    far = camera.unproject(np.array([[800.0, 255.5]]))
    assert np.isnan(star_paths(camera, far, [0, 0, 0], 1.0)[0]).all()
    assert star_paths(camera, far, [0, 0, 0], 1.0, margin_px=400.0)[0][0, 0, 0] == pytest.approx(800.0)


def test_no_stars():
    xy, weights = star_paths(Camera.from_fov(10.0, 512, 512), np.empty((0, 3)), [0.1, 0, 0], 1.0)
    assert xy.shape == (0, 1, 2)
    assert weights.sum() == 1.0
