"""Vignetting, ghosts and the warm lens against exact formulas and brute force.

cos⁴: Reiss 1945; a pixel's solid angle by its corners is off the law at its centre by the square of a pixel, 1e-6 here.
Two circles: by counting points of a fine lattice, 2,000 across: 1e-3. Solid angles add up to Girard's for the field.
"""

import math
from dataclasses import replace

import numpy as np
import pytest

from simulator.optics.ghosts import Ghost, ghost_sources
from simulator.optics.illumination import Vignetting, illumination_map, relative_illumination, star_illumination
from simulator.optics.thermal import true_camera
from simulator.renderer import Renderer
from simulator.scenario import Scenario
from startracker.geometry.camera import Camera
from startracker.geometry.distortion import Distortion

CAMERA = Camera.from_fov(60.0, 401, 301)


def off_axis(camera):
    grid = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1).reshape(-1, 2)
    return np.arccos(camera.unproject(grid)[:, 2]).reshape(camera.height, camera.width)


def test_cos4_for_the_sky_and_cos_for_stars():
    theta = off_axis(CAMERA)
    section = Vignetting(natural=True)
    np.testing.assert_allclose(illumination_map(CAMERA, section), np.cos(theta) ** 4, rtol=1e-5)
    assert illumination_map(CAMERA, section)[150, 200] == pytest.approx(1.0, abs=1e-5)
    np.testing.assert_allclose(relative_illumination(CAMERA, section, theta), np.cos(theta), rtol=1e-12)
    v = CAMERA.unproject([[0.0, 0.0], [200.0, 150.0]])
    np.testing.assert_allclose(star_illumination(CAMERA, section, 3.0 * v), v[:, 2], rtol=1e-12)


def test_without_vignetting_the_sky_falls_with_the_solid_angle_of_a_pixel():
    """A pixel sees less of the sky towards the edge, whatever the lens transmits: cos³ θ; stars lose nothing."""
    section = Vignetting()
    assert section.is_off
    np.testing.assert_allclose(illumination_map(CAMERA, section), np.cos(off_axis(CAMERA)) ** 3, rtol=1e-5)
    assert relative_illumination(CAMERA, section, 0.5) == 1.0
    for other in ({"natural": True}, {"mechanical_end_deg": 20.0}, {"polynomial": (0.0, 0.0, 0.1)}):
        assert not Vignetting(**other).is_off


@pytest.mark.parametrize(
    "camera",
    [
        CAMERA,
        Camera(350.0, 320.0, 180.0, 170.0, 401, 301, Distortion(k1=-0.15, k2=0.02)),
        Camera(200.0, 200.0, 200.0, 150.0, 401, 301, Distortion(k1=-0.02), projection="fisheye"),
        Camera(200.0, 200.0, 200.0, 150.0, 401, 301, projection="equisolid"),
    ],
)
def test_solid_angles_add_up_to_that_of_the_field(camera):
    """map / cos θ · Ω(0) is the solid angle of each pixel; the sum is that inside the image's outline, by a line
    integral ∮ (1 − cos θ) dφ over 4,000 points a side."""
    theta = off_axis(camera)
    solid = illumination_map(camera, Vignetting(natural=True)) / np.cos(theta) / (camera.fx * camera.fy)
    w, h, s = camera.width - 0.5, camera.height - 0.5, np.linspace(0.0, 1.0, 4001)[:-1]
    x = np.concatenate([s * (w + 0.5) - 0.5, np.full(4000, w), w - s * (w + 0.5), np.full(4000, -0.5)])
    y = np.concatenate([np.full(4000, -0.5), s * (h + 0.5) - 0.5, np.full(4000, h), h - s * (h + 0.5)])
    v = camera.unproject(np.stack([x, y], axis=1))
    v = np.concatenate([v, v[:1]])
    turn = np.diff(np.unwrap(np.arctan2(v[:, 1], v[:, 0])))
    height = 1.0 - v[:, 2]
    assert solid.sum() == pytest.approx(float(np.sum(turn * (height[1:] + height[:-1]) / 2.0)), rel=2e-5)


WIDE = {"optics.focal_length_mm": 6.9, "optics.aperture_mm": 5.0}


@pytest.mark.parametrize("lens", [{}, {"optics.distortion.k1": -0.3}, WIDE | {"optics.distortion.k1": 0.0}])
def test_even_sky_of_a_frame(lens):
    """Electrons of a constant sky in the pixels of a frame: photons a steradian times the solid angle of the pixel, by
    L'Huilier's theorem for the two triangles between the directions of its corners (1e-7 of rounding in them)."""
    options = {"sky.earth": "false", "sky.planets": "false", "sky.magnitude_limit": -1.4, "study.sampling": "sky"}
    scenario = Scenario.load("cubesat_ideal", [f"{key}={value}" for key, value in (options | lens).items()])
    renderer = Renderer(scenario)
    truth = renderer.frame(0)[1]
    assert len(truth.sources) == 0
    camera, s10 = renderer.camera, scenario.sky.background_s10
    at_axis = renderer.focal_plane.photometer.background_e_s_pixel(s10, 1.0) * scenario.detector.exposure_s
    assert truth.mean_electrons.shape == (1024, 1024)
    for x, y in ((0, 0), (1023, 0), (700, 512), (3, 901)):
        corners = camera.unproject(
            [[x + dx, y + dy] for dx, dy in ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))]
        )
        solid = triangle_sr(*corners[:3]) + triangle_sr(corners[0], *corners[2:])
        assert truth.mean_electrons[y, x] == pytest.approx(at_axis * solid, rel=1e-5)
    if camera.distortion.is_zero:  # cos³ θ at the corner: 0.65 of the middle
        tangent = math.hypot(511.5, 511.5) / camera.fx
        relative = truth.mean_electrons[0, 0] / truth.mean_electrons[511, 511]
        assert relative == pytest.approx((1.0 + tangent**2) ** -1.5, rel=1e-4)


def triangle_sr(a, b, c):
    """Spherical excess by L'Huilier's theorem."""
    sides = [2.0 * math.asin(np.linalg.norm(p - q) / 2.0) for p, q in ((b, c), (c, a), (a, b))]
    half = sum(sides) / 2.0
    product = math.tan(half / 2.0) * math.prod(math.tan((half - side) / 2.0) for side in sides)
    return 4.0 * math.atan(math.sqrt(product))


def test_pixels_without_direction_see_no_sky():
    """A camera whose model ends inside the image is computed pixel by pixel: the same where there is a direction."""
    ended = Camera(100.0, 100.0, 199.5, 199.5, 400, 400, Distortion(k1=-1 / 6), projection="fisheye")
    whole = replace(ended, width=200, height=200, cx=99.5, cy=99.5)
    share = illumination_map(ended, Vignetting())
    assert share[0, 0] == 0.0
    np.testing.assert_allclose(share[100:300, 100:300], illumination_map(whole, Vignetting()), rtol=1e-6)


def test_equal_area_projection_has_equal_pixels():
    camera = Camera(200.0, 200.0, 200.0, 150.0, 401, 301, projection="equisolid")
    solid = illumination_map(camera, Vignetting(natural=True)) / np.cos(off_axis(camera))
    np.testing.assert_allclose(solid, 1.0, rtol=2e-5)


@pytest.mark.parametrize(("start", "end"), [(0.0, 25.0), (10.0, 28.0), (20.0, 22.0)])
def test_mechanical_vignetting_is_the_overlap_of_two_circles(start, end):
    section = Vignetting(mechanical_start_deg=start, mechanical_end_deg=end)
    a, b = math.tan(math.radians(start)), math.tan(math.radians(end))
    big = (b + a) / (b - a)
    axis = (np.arange(2000) + 0.5) / 1000.0 - 1.0
    x, y = np.meshgrid(axis, axis)
    pupil = x**2 + y**2 <= 1.0
    for share in (-0.2, 0.0, 0.1, 0.5, 0.9, 1.0, 1.2):
        theta_deg = max(start + share * (end - start), 0.0)
        d = 2.0 * math.tan(math.radians(theta_deg)) / (b - a)
        counted = (pupil & ((x - d) ** 2 + y**2 <= big**2)).sum() / pupil.sum()
        found = relative_illumination(CAMERA, section, math.radians(theta_deg))
        assert found == pytest.approx(counted, abs=1e-3)
    assert relative_illumination(CAMERA, section, math.radians(start * 0.99)) == 1.0
    assert relative_illumination(CAMERA, section, math.radians(end + 1.0)) == 0.0


def test_polynomial_and_products():
    section = Vignetting(natural=True, polynomial=(-0.4, 0.1, 0.05), mechanical_end_deg=40.0)
    theta, rho = math.radians(20.0), math.tan(math.radians(20.0))
    alone = Vignetting(mechanical_end_deg=40.0)
    expected = math.cos(theta) * (1 - 0.4 * rho**2 + 0.1 * rho**4 + 0.05 * rho**6)
    expected *= float(relative_illumination(CAMERA, alone, theta))
    assert relative_illumination(CAMERA, section, theta) == pytest.approx(expected, rel=1e-12)
    assert relative_illumination(CAMERA, Vignetting(polynomial=(-9.0, 0, 0)), theta) == 0.0
    assert relative_illumination(CAMERA, section, [math.nan, 0.0]).tolist() == [0.0, 1.0]
    fish = Camera.from_fov(170.0, 400, 400, projection="equidistant")
    assert relative_illumination(fish, Vignetting(polynomial=(-0.1, 0, 0)), 1.5) == pytest.approx(1 - 0.225)
    # a circular image in a square frame: what lies outside the model's end is dark
    ended = Camera(100.0, 100.0, 199.5, 199.5, 400, 400, Distortion(k1=-1 / 6), projection="fisheye")
    assert illumination_map(ended, Vignetting(natural=True))[0, 0] == 0.0


# ---------------------------------------------------------------- ghosts
def test_ghosts_stand_through_the_principal_point():
    camera = Camera(500.0, 500.0, 100.0, 80.0, 201, 161)
    ghosts = (
        Ghost(flux=1e-4, scale=-0.6, radius_px=12.0),
        Ghost(flux=1e-3, scale=2.0, radius_px=3.0),
    )
    # the last stands off the image by more than a ghost reaches, the one before it is faint
    xy = np.array([[50.0, 80.0], [100.0, 80.0], [np.nan, 1.0], [200.0, 160.0], [400.0, 80.0]])
    places, light, radius = ghost_sources(camera, xy, np.array([1e6, 1e6, 1e6, 10.0, 1e6]), ghosts)
    np.testing.assert_allclose(places, [[130.0, 80.0], [100.0, 80.0], [0.0, 80.0], [100.0, 80.0]])
    np.testing.assert_allclose(light, [100.0, 100.0, 1000.0, 1000.0])
    assert radius.tolist() == [12.0, 12.0, 3.0, 3.0]
    assert [len(part) for part in ghost_sources(camera, xy, np.full(5, 1e6), ())] == [0, 0, 0]


# ---------------------------------------------------------------- temperature
def test_a_warm_lens_is_longer():
    camera = Camera(2000.0, 1900.0, 511.5, 500.0, 1024, 1024, Distortion(k1=-0.05))
    assert true_camera(camera, 0.0, 0.0) is camera
    assert true_camera(camera, 20.0, 0.0) is camera
    warm = true_camera(camera, 20.0, -50.0)
    assert (warm.fx, warm.fy) == pytest.approx((2000.0 * 0.999, 1900.0 * 0.999), rel=1e-15)
    assert (warm.cx, warm.distortion) == (camera.cx, camera.distortion)
    # the image shrinks about the principal point by that factor, distortion and all
    star = camera.unproject([[900.0, 200.0]])
    shift = warm.project(star) - [511.5, 500.0]
    np.testing.assert_allclose(shift, [[(900.0 - 511.5) * 0.999, (200.0 - 500.0) * 0.999]], rtol=1e-12)
