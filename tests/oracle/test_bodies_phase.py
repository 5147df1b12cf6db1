"""Moon and planets with a phase, against closed forms, the kernel for points, and a published position angle.

Sources: Lester, McCall & Tatum 1979 (JRASC 73, 233): disk-integrated Lommel–Seeliger and Lambert phase laws; centre of
light of a half-lit Lambert sphere 3π/16 R (elementary integral); Meeus 1998, *Astronomical Algorithms*, example 48.a
(position angle of the Moon's bright limb 285.0°, quoted from memory); Allen: full Moon V = −12.73. Tolerances: the
electrons to 1e-3 as asked for; shapes as the docstring of `draw_body` has them.
"""

import math

import numpy as np
import pytest

from simulator.optics.bodies import LAWS, LitDisk, add_lit_disk, draw_body, sun_angle_rad
from simulator.optics.disk import add_disk
from simulator.optics.psf import build_psf
from simulator.optics.psf_model import PsfModel
from simulator.optics.splat import render_stars
from startracker.geometry.attitude import Attitude, radec_to_direction
from startracker.geometry.camera import Camera

GAUSSIAN = build_psf(PsfModel(sigma_px=0.9), 1.4, (5.5, 5.5))
AIRY = build_psf(PsfModel(model="airy"), 8.0, (5.5, 5.5))
ONE = np.ones(1)
DISK = LitDisk(20.0, 20.0, 0.7, 0.3)


def drawn(radius, fraction, angle=0.0, law="lommel_seeliger", psf=GAUSSIAN, size=400, centre=(200.3, 199.6)):
    image = np.zeros((size, size))
    draw_body(image, [centre], ONE, 1e8, LitDisk(radius, radius, fraction, angle, LAWS[law]), psf)
    return image


@pytest.mark.parametrize("psf", [GAUSSIAN, AIRY], ids=["gaussian", "airy"])
@pytest.mark.parametrize("radius", [1.6, 5.0, 20.6, 90.0])
@pytest.mark.parametrize("fraction", [1.0, 0.5, 0.05, 0.003])
def test_all_electrons_are_drawn(psf, radius, fraction):
    image = drawn(radius, fraction, 0.7, psf=psf)
    lost_in_wings = 0.0 if psf is GAUSSIAN else 2e-3  # 2 λN/(π² r) of an Airy pattern lies beyond r = 100 pixels
    assert image.sum() == pytest.approx(1e8, rel=1e-3 + lost_in_wings)
    assert (image >= 0.0).all()


def test_a_body_that_enters_the_image_is_drawn_from_then_on():
    """Three of four moments count where the first is far outside or has no position; nothing where all are."""
    disk, weights = LitDisk(5.0, 5.0, 1.0, 0.0), np.array([0.4, 0.3, 0.2, 0.1])
    path = np.array([[0.0, 0.0], [20.0, 30.0], [25.0, 30.0], [30.0, 30.0]])
    expected = np.zeros((60, 60))
    draw_body(expected, path[1:], weights[1:], 1e6, disk, GAUSSIAN)
    assert expected.sum() == pytest.approx(0.6e6, rel=1e-3)
    for outside in ([-4000.0, 30.0], [30.0, 5000.0], [math.nan, 30.0]):
        path[0] = outside
        image = np.zeros((60, 60))
        draw_body(image, path, weights, 1e6, disk, GAUSSIAN)
        np.testing.assert_allclose(image, expected, rtol=1e-12, atol=1e-9)
        nothing = np.zeros((60, 60))
        draw_body(nothing, path[:1], weights[:1], 1e6, disk, GAUSSIAN)
        assert not nothing.any()
    for no_light, unlit in ((0.0, disk), (1e6, disk._replace(illuminated_fraction=0.0))):
        draw_body(nothing, path[1:], weights[1:], no_light, unlit, GAUSSIAN)
        assert not nothing.any()


def integral(law, cosine, samples=16, radius=150.0):
    """Mean brightness law over the disk by the kernel, from its brightest possible value 1 at the sub-solar point."""
    image = np.zeros((320, 320))
    disk = LitDisk(radius, radius, (1.0 + cosine) / 2.0, 0.0, LAWS[law])
    add_lit_disk(image, np.array([[160.0, 160.0]]), ONE, disk, samples)
    return image


def test_counted_lit_pixels_are_the_illuminated_fraction():
    for fraction in (0.1, 0.25, 0.5, 0.75, 0.9):
        image = integral("lambert", 2 * fraction - 1)
        # pixels of the rim count whole: one in 150 too many around
        assert (image > 0).sum() / (math.pi * 150.0**2) == pytest.approx(fraction, abs=0.012)


def test_centre_of_light_of_a_half_lit_lambert_sphere():
    image = integral("lambert", 0.0)
    x = (image.sum(axis=0) @ np.arange(320)) - 160.0
    y = (image.sum(axis=1) @ np.arange(320)) - 160.0
    assert x / 150.0 == pytest.approx(3 * math.pi / 16, abs=1e-4)
    assert y == pytest.approx(0.0, abs=1e-9)


def test_brightness_over_the_disk_is_the_law():
    # share of the light of the pixel in the middle of the disk, against the law over its integral
    alpha = math.radians(60.0)
    lambert = math.cos(alpha) / (2 / 3 * (math.sin(alpha) + (math.pi - alpha) * math.cos(alpha)))
    seeliger = (math.cos(alpha) / (math.cos(alpha) + 1.0)) / (
        math.pi / 2 * (1 - math.sin(alpha / 2) * math.tan(alpha / 2) * math.log(1 / math.tan(alpha / 4)))
    )
    for law, expected in (("lambert", lambert), ("lommel_seeliger", seeliger)):
        assert integral(law, math.cos(alpha))[160, 160] * 150.0**2 == pytest.approx(expected, rel=1e-3)


def test_full_moon_is_an_even_disk():
    image, disk = integral("lommel_seeliger", 1.0), np.zeros((320, 320))
    add_disk(disk, (160.0, 160.0), 150.0, 1.0)
    assert np.abs(image - disk).max() < 0.03 * disk.max()  # a rim pixel from 16 × 16 samples: half a column of them
    assert np.abs(image - disk).sum() < 1e-3


@pytest.mark.parametrize("psf", [GAUSSIAN, AIRY], ids=["gaussian", "airy"])
@pytest.mark.parametrize("radius", [2.2, 6.0])
def test_small_disk_is_the_sum_of_its_points(psf, radius):
    fraction, angle, n = 0.6, 2.1, 901
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(-1, 1, n), np.linspace(-1, 1, n)))
    cosine = 2 * fraction - 1
    mu = np.sqrt(np.maximum(1 - u * u - v * v, 0.0))
    mu_0 = math.sqrt(1 - cosine**2) * (u * math.cos(angle) + v * math.sin(angle)) + mu * cosine
    light = np.where((mu > 0) & (mu_0 > 0), mu_0, 0.0)
    points = np.stack([30.3 + radius * u, 29.6 + radius * v], axis=1)[light > 0]
    weight = light[light > 0] / light.sum() * 1e8
    expected = render_stars((60, 60), points, ONE, weight, psf)
    image = drawn(radius, fraction, angle, "lambert", psf, 60, (30.3, 29.6))
    assert np.abs(image - expected).max() < (1e-3 if psf is GAUSSIAN else 3e-3) * expected.max()


def test_light_of_a_disk_off_the_image_and_of_one_in_motion():
    whole, part = np.zeros((300, 300)), np.zeros((100, 100))
    draw_body(whole, [[95.0, 150.0]], ONE, 1e8, DISK, GAUSSIAN)
    draw_body(part, [[95.0 - 100.0, 50.0]], ONE, 1e8, DISK, GAUSSIAN)
    assert np.allclose(whole[100:200, 100:200], part, atol=1e-6 * whole.max())
    path = np.array([[90.0, 150.0], [97.0, 151.0], [104.0, 152.0], [math.nan, math.nan]])
    weights = np.array([0.2, 0.3, 0.4, 0.1])
    moving, still = np.zeros((300, 300)), np.zeros((300, 300))
    draw_body(moving, path, weights, 1e8, DISK, GAUSSIAN)
    for place, weight in zip(path[:3], weights[:3], strict=True):
        draw_body(still, [place], ONE, 1e8 * weight, DISK, GAUSSIAN)
    assert np.allclose(moving, still, atol=3e-3 * still.max())
    assert moving.sum() == pytest.approx(0.9e8, rel=1e-3)


def test_nothing_to_draw():
    image = np.zeros((50, 50))
    for path, electrons, fraction in (
        ([[math.nan, math.nan]], 1e8, 1.0),
        ([[25.0, 25.0]], 0.0, 1.0),
        ([[25.0, 25.0]], 1e8, 0.0),
        ([[900.0, 25.0]], 1e3, 1.0),
    ):
        draw_body(image, path, ONE, electrons, LitDisk(10.0, 10.0, fraction, 0.0), GAUSSIAN)
    assert (image == 0.0).all()


def test_position_angle_of_the_bright_limb():
    moon = radec_to_direction(math.radians(134.6885), math.radians(13.7684))
    sun = radec_to_direction(math.radians(20.6579), math.radians(8.6964))
    camera = Camera.from_fov(5.0, 500, 500)
    for roll in (0.0, 77.0):
        angle = sun_angle_rad(camera, Attitude.from_radec_roll(134.6885, 13.7684, roll), moon, sun)
        # up (−y) is at position angle `roll`, east to its left (−x)
        position_angle = math.degrees(math.atan2(-math.cos(angle), -math.sin(angle))) + roll
        assert position_angle % 360.0 == pytest.approx(285.0, abs=0.1)


@pytest.mark.parametrize("parity", [1, -1])
def test_light_comes_from_the_suns_side_of_the_image(parity):
    # great circles are straight lines of a pinhole's image
    camera = Camera(800.0, 1000.0, 511.5, 383.5, 1024, 768, parity=parity)
    attitude = Attitude.from_radec_roll(40.0, 20.0, 25.0)
    moon, sun = (attitude.inverse.apply(v / np.linalg.norm(v)) for v in np.array([[0.2, 0.1, 1.0], [-0.4, 0.3, 1.0]]))
    dx, dy = (camera.project(attitude.apply(sun)) - camera.project(attitude.apply(moon)))[0] / (800.0, 1000.0)
    assert sun_angle_rad(camera, attitude, moon, sun) == pytest.approx(math.atan2(dy, dx), abs=1e-3)
    image = np.zeros((768, 1024))
    place = camera.project(attitude.apply(moon))
    draw_body(image, place, ONE, 1e8, LitDisk(16.0, 20.0, 0.4, math.atan2(dy, dx)), GAUSSIAN)
    centroid = np.array([image.sum(axis=0) @ np.arange(1024), image.sum(axis=1) @ np.arange(768)]) / 1e8
    shift = (centroid - place[0]) / (800.0, 1000.0)
    assert math.atan2(shift[1], shift[0]) == pytest.approx(math.atan2(dy, dx), abs=1e-2)
    assert np.hypot(*shift) * 1000.0 > 5.0


def test_surface_brightness_of_the_full_moon():
    # −12.73 over a disk of 31.09′ (384,400 km): 3.4 mag/arcsec² in each pixel; peak pixels of a 20-pixel disk
    image = drawn(20.0, 1.0)
    pixel_arcsec = 31.09 * 60.0 / 40.0
    share = image[200, 200] / 1e8
    v = -12.73 - 2.5 * math.log10(share) + 2.5 * math.log10(pixel_arcsec**2)
    assert v == pytest.approx(3.4, abs=0.1)
