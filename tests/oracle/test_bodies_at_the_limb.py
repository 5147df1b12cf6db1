"""Sun and Moon cut by the Earth's limb: segments, the penumbra of Montenbruck & Gill, sums over points of disks.

Light went out at once when the centre set: up to half a Moon too much or too little.
"""

import math
from dataclasses import replace

import numpy as np
import pytest

from simulator.exposure import Exposure
from simulator.optics.bodies import LitDisk, draw_body, share_before_limb
from simulator.optics.psf import build_psf
from simulator.optics.psf_model import PsfModel
from simulator.renderer import Renderer
from simulator.scenario import Scenario
from simulator.sky.earth import angular_radius_rad, occulted, stray_sources, unhidden
from simulator.sky.instants import Bodies
from simulator.sky.parameters import Sky

R_KM = np.array([7178.0, 0.0, 0.0])


def bodies(height, radius_rad, lit=1.0, name="Moon", r_km=R_KM):
    """The Sun far off and a body `height` of its radii above the horizon."""
    away = angular_radius_rad(r_km) + height * radius_rad
    nadir = -r_km / np.linalg.norm(r_km)
    direction = nadir * math.cos(away) + np.array([0.0, math.sin(away), 0.0])
    one = np.ones(1)
    return Bodies(np.array([name]), direction[None], one, 0 * one, radius_rad * one, lit * one, 0.9 * one)


def points_of_disk(centre, radius_rad, count=801):
    """Directions on a disk as small circles about its centre have them, and their coordinates on it in radii."""
    axis = (np.arange(count) + 0.5) / count * 2.0 - 1.0
    x, y = (a.ravel() for a in np.meshgrid(axis, axis))
    inside = np.hypot(x, y) < 1.0
    x, y = x[inside], y[inside]
    first = np.cross(centre, [0.0, 0.0, 1.0])
    first /= np.linalg.norm(first)
    second = np.cross(centre, first)
    r = np.hypot(x, y)
    across = (x[:, None] * first + y[:, None] * second) / np.maximum(r, 1e-12)[:, None]
    return np.cos(r * radius_rad)[:, None] * centre + np.sin(r * radius_rad)[:, None] * across, x, y, first


@pytest.mark.parametrize("height", [-1.5, -0.95, -0.4, 0.0, 0.3, 0.8, 1.2])
@pytest.mark.parametrize("r_km", [R_KM, np.array([42_164.0, 0.0, 0.0])])
def test_share_of_the_sun_is_a_segment_and_the_published_penumbra(height, r_km):
    a = 0.2666 * math.pi / 180
    sun = bodies(height, a, name="Sun", r_km=r_km)
    share = unhidden(sun, r_km, sun.direction[0], Sky())[0]
    s = max(min(height, 1.0), -1.0)
    segment = 1.0 - (math.acos(s) - s * math.sqrt(1.0 - s * s)) / math.pi
    # the limb is not a straight line: ½ a cot ρ radii at the rim, 0.1 % from 800 km, 1.5 % from the geostationary orbit
    assert share == pytest.approx(segment, abs=2e-3 if r_km[0] < 1e4 else 8e-3)
    # shadow function of Montenbruck & Gill 2000, Satellite Orbits, chapter 3: overlap of two circles a and b, c apart
    b = math.tan(angular_radius_rad(r_km))  # the circle on the sphere that curves alike
    c = b + height * a
    if abs(height) < 1.0:
        x = (c * c + a * a - b * b) / (2.0 * c)
        y = math.sqrt(a * a - x * x)
        hidden = a * a * math.acos(x / a) + b * b * math.acos((c - x) / b) - c * y
        assert share == pytest.approx(1.0 - hidden / (math.pi * a * a), abs=5e-4)
    # points of the disk on the sphere
    seen, *_ = points_of_disk(sun.direction[0], a)
    assert share == pytest.approx(1.0 - occulted(seen, r_km).mean(), abs=1e-3)


@pytest.mark.parametrize("angle", [0.0, 1.0, 2.5, math.pi])
@pytest.mark.parametrize("law", ["lommel_seeliger", "lambert"])
def test_share_of_a_crescent(angle, law):
    count, lit, offset, curvature = 1500, 0.3, -0.2, 0.03
    axis = (np.arange(count) + 0.5) / count * 2.0 - 1.0
    x, y = np.meshgrid(axis, axis)
    mu = np.sqrt(np.maximum(1.0 - x**2 - y**2, 0.0))
    mu_0 = np.maximum(x * math.sqrt(1.0 - (2 * lit - 1) ** 2) + mu * (2 * lit - 1), 0.0) * (mu > 0.0)
    light = mu_0 if law == "lambert" else mu_0 / np.maximum(mu_0 + mu, 1e-9)
    t, p = x * math.cos(angle) + y * math.sin(angle), y * math.cos(angle) - x * math.sin(angle)
    expected = light[t < offset + curvature / 2.0 * p**2].sum() / light.sum()
    assert share_before_limb(offset, curvature, angle, lit, law) == pytest.approx(expected, abs=1e-3)


def test_a_disk_is_drawn_up_to_the_limb():
    """What is left has the brightness that it had, and beyond the limb there is nothing but what the PSF spreads."""
    psf = build_psf(PsfModel(sigma_px=0.8), 2.0, (10.0, 10.0))
    whole, cut = np.zeros((2, 121, 121))
    limb, place = (0.25, 0.002, 0.7), np.array([[60.2, 59.7]])
    share = share_before_limb(limb[0], limb[1], limb[2] - 2.0, 0.8, "lommel_seeliger")
    draw_body(whole, place, np.ones(1), 1e7, LitDisk(40.0, 40.0, 0.8, 2.0), psf)
    draw_body(cut, place, np.ones(1), 1e7 * share, LitDisk(40.0, 40.0, 0.8, 2.0, limb=limb), psf)
    assert cut.sum() == pytest.approx(1e7 * share, rel=2e-3)
    rows, columns = np.mgrid[:121, :121]
    x, y = (columns - 60.2) / 40.0, (rows - 59.7) / 40.0
    t, p = x * math.cos(0.7) + y * math.sin(0.7), y * math.cos(0.7) - x * math.sin(0.7)
    beyond = (t - limb[0] - 0.5 * limb[1] * p**2) * 40.0  # pixels
    assert np.abs(cut - whole)[beyond < -5.0].max() < 2e-3 * whole.max()
    assert cut[beyond > 5.0].max() < 1e-5 * whole.max()


@pytest.mark.parametrize("height", [-0.6, 0.0, 0.7])
def test_the_moon_of_a_frame_is_cut(height):
    """A scenario's Moon with the spacecraft where the limb runs over it: its electrons, and where they are."""
    base = ["study.sampling=mission_year", "pointing.target=Moon", "sky.magnitude_limit=-2", "sky.background=false"]
    scenario = Scenario.load(
        "cubesat_ideal", [*base, "detector.width=256", "detector.height=256", "detector.exposure_s=0.001"]
    )
    renderer = Renderer(scenario)
    plane, camera = renderer.focal_plane, renderer.camera
    scene = renderer.scene(0)
    moon = scene.bodies.select(np.flatnonzero(scene.bodies.name == "Moon"))
    centre, radius = moon.direction[0], float(moon.angular_radius_rad[0])
    away = angular_radius_rad(R_KM) + height * radius
    aside = np.cross(centre, [0.3, 0.5, 0.2])
    nadir = centre * math.cos(away) + aside / np.linalg.norm(aside) * math.sin(away)
    scene = replace(scene, bodies=moon, r_km=-7178.0 * nadir)
    exposure = Exposure(0.0, 0.001)
    alone = plane.expose(replace(scene, bodies=moon.select(np.zeros(0, np.int64))), exposure)
    light = plane.expose(scene, exposure)
    share = unhidden(moon, scene.r_km, scene.sun_direction, plane.sky)[0]
    assert 0.02 < share < 0.98
    rate = plane.photometer.body_electrons_per_s(moon.name, moon.v_mag)[0] * scenario.detector.exposure_s
    assert light.sources.electrons[light.sources.kind == "moon"] == pytest.approx([rate * share], rel=1e-9)
    image = light.mean_e - alone.mean_e
    assert image.sum() == pytest.approx(rate * share, rel=5e-3)
    x, y = np.meshgrid(np.arange(256.0), np.arange(256.0))
    seen = scene.pointing.camera.inverse.apply(camera.unproject(np.stack([x.ravel(), y.ravel()], axis=1)))
    depth = angular_radius_rad(R_KM) - np.arccos(np.clip(seen @ nadir, -1.0, 1.0))  # before the Earth
    hidden = (depth > 5.0 * camera.pixel_rad).reshape(256, 256)
    assert hidden.sum() > 1000
    assert np.abs(image[hidden]).max() < 1e-4 * image.max()


def test_stray_light_dies_away_through_the_penumbra():
    a = math.radians(0.2666)
    magnitudes = []
    for height in (1.5, 0.9, 0.0, -0.9, -1.1):
        sun = bodies(height, a, name="Sun")
        names, _, v_mag = stray_sources(sun, R_KM, Sky())
        magnitudes.append(float(v_mag[names == "Sun"][0]) if "Sun" in names else math.inf)
    assert magnitudes[0] == 0.0
    assert magnitudes[2] == pytest.approx(2.5 * math.log10(2.0), abs=0.01)
    assert magnitudes == sorted(magnitudes)
    assert 3.5 < magnitudes[3] < 5.0
    assert magnitudes[4] == math.inf
