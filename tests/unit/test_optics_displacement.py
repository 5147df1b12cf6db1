"""Limits of the displacement of star images: each effect alone against a dense sum, and what lies outside."""

import math

import numpy as np
import pytest

from simulator.optics.displacement import (
    C_LINE_NM,
    F_LINE_NM,
    CalibrationResidual,
    Displacement,
    LateralColour,
    draw_residual,
)
from startracker.geometry.camera import Camera

# the principal point is a corner of the first pixel, and so the farthest point of the detector is a whole diagonal away
CAMERA = Camera(4545.0, 4000.0, -0.5, -0.5, 1024, 800)


def largest(displacement, beyond_px=0.0):
    """Largest displacement over a grid that begins and ends at the outer edges of the detector, or beyond them."""
    x, y = (np.linspace(-0.5 - beyond_px, side - 0.5 + beyond_px, 201) for side in (CAMERA.width, CAMERA.height))
    xy = np.stack([a.ravel() for a in np.meshgrid(x, y)], axis=1)
    return np.hypot(*(displacement.moved(xy, np.zeros(len(xy))) - xy).T).max()


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_limit_of_a_residual_holds_outside_too_and_is_no_more_than_half_above(seed):
    field = draw_residual(CAMERA, CalibrationResidual(0.05, 5), np.random.default_rng(seed))
    found = Displacement(CAMERA, field)
    most = largest(found)
    assert largest(found, 300.0) <= most * (1.0 + 1e-9)
    assert 1.45 * most < found.most_px <= 1.5 * most * (1.0 + 1e-9)  # 3 % of a grid of 33 points that miss the maximum


def test_outside_the_detector_the_residual_is_that_of_the_edge():
    field = draw_residual(CAMERA, CalibrationResidual(0.05, 5), np.random.default_rng(4))
    found = Displacement(CAMERA, field)
    outside = np.array([[-70.0, 300.0], [2000.0, 300.0], [300.0, -0.6], [300.0, 900.0], [-9.0, 900.0]])
    edge = np.array([[-0.5, 300.0], [1023.5, 300.0], [300.0, -0.5], [300.0, 799.5], [-0.5, 799.5]])
    none = np.zeros(5)
    assert found.moved(outside, none) - outside == pytest.approx(found.moved(edge, none) - edge, abs=1e-12)


def test_the_limit_of_lateral_colour_is_that_of_500_nm_at_the_farthest_corner():
    """0.3 px between C and F at half the diagonal; 500 nm beyond the reference and the whole diagonal."""
    found = Displacement.of(CAMERA, None, LateralColour(0.3), 600.0, 0.0)
    corner = np.array([[1023.5, 799.5]])
    moved = found.moved(corner, np.array([1100.0])) - corner
    assert np.hypot(*moved[0]) == pytest.approx(0.3 * 2.0 * 500.0 / (C_LINE_NM - F_LINE_NM), rel=1e-12)
    assert found.most_px == pytest.approx(np.hypot(*moved[0]), rel=1e-12)
    bluer = Displacement.of(CAMERA, None, LateralColour(-0.3), 600.0, 0.0)
    assert bluer.most_px == found.most_px


@pytest.mark.parametrize("curve_px", [0.02, -0.02])
def test_the_limit_of_a_centroid_curve_is_that_of_both_axes(curve_px):
    found = Displacement(CAMERA, curve_px=curve_px)
    quarter = np.array([[10.25, 20.75]])
    moved = found.moved(quarter, np.zeros(1)) - quarter
    assert moved[0] == pytest.approx([curve_px, -curve_px], abs=1e-12)
    assert found.most_px == pytest.approx(math.sqrt(2.0) * abs(curve_px), rel=1e-12)


def test_limits_add_up_and_nothing_moves_where_all_are_off():
    off = Displacement(CAMERA)
    assert off.is_off
    assert not off.coloured
    assert off.most_px == 0.0
    field = draw_residual(CAMERA, CalibrationResidual(0.05), np.random.default_rng(1))
    parts = [
        Displacement(CAMERA, residual=field),
        Displacement(CAMERA, colour_per_nm=1e-6, reference_nm=600.0),
        Displacement(CAMERA, curve_px=0.02),
    ]
    assert [part.is_off for part in parts] == [False] * 3
    assert [part.coloured for part in parts] == [False, True, False]
    together = Displacement(CAMERA, field, 1e-6, 600.0, 0.02)
    assert together.most_px == pytest.approx(sum(part.most_px for part in parts), rel=1e-12)
    xy, wavelength_nm = np.array([[100.3, 200.1], [700.0, 640.0]]), np.array([480.0, 720.0])
    shifts = sum(part.moved(xy, wavelength_nm) - xy for part in parts)
    assert together.moved(xy, wavelength_nm) - xy == pytest.approx(shifts, abs=1e-12)


def test_paths_are_displaced_like_stars():
    """Positions (N, K, 2), each star with its own wavelength."""
    found = Displacement(CAMERA, colour_per_nm=1e-5, reference_nm=600.0, curve_px=0.02)
    paths = np.random.default_rng(5).uniform(0.0, 700.0, (3, 4, 2))
    wavelength_nm = np.array([450.0, 600.0, 800.0])
    expected = np.stack([found.moved(paths[:, k], wavelength_nm) for k in range(4)], axis=1)
    assert found.moved(paths, wavelength_nm) == pytest.approx(expected, abs=1e-12)


def test_no_residual_draws_nothing():
    rng = np.random.default_rng(3)
    assert draw_residual(CAMERA, CalibrationResidual(0.0), rng) is None
    assert rng.random() == np.random.default_rng(3).random()
