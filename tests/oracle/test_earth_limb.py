"""The Earth in the field, against Skyfield's line and sphere, closed forms and published figures.

Sources: Skyfield (`skyfield.geometry`), an independent intersection of a line and a sphere; the phase law of a
Lambert sphere (Russell 1916, ApJ 43, 173): (2/3) A (R/d)² [sin α + (π − α) cos α]/π of the Sun's light; the Sun's
V = −26.74 (Cox 2000). Tolerance 3e-3 where a disk is summed
from 160,000 pieces.
"""

import math
from pathlib import Path

import numpy as np
import pytest
from skyfield.geometry import intersect_line_and_sphere

from simulator.constants import EARTH_RADIUS_KM
from simulator.renderer import Renderer
from simulator.scenario import Scenario
from simulator.sky.background import diffuse_sky_s10
from simulator.sky.earth import (
    SCALE_HEIGHT_KM,
    angular_radius_rad,
    earth_in_field,
    earth_radiance_map,
    earth_s10,
    has_disk,
    occulted,
    stray_sources,
)
from simulator.sky.instants import EARTH_DISK_KM, Bodies
from simulator.sky.parameters import Sky
from startracker.geometry.attitude import Attitude, direction_to_radec
from startracker.geometry.camera import Camera

SCENARIOS = sorted((Path(__file__).parents[2] / "scenarios").glob("*.yaml"))
R_KM = np.array([7178.137, 0.0, 0.0])
RNG = np.random.default_rng(11)


def unit(v):
    return np.asarray(v, float) / np.linalg.norm(v)


def at_tangent_height(h_km, distance_km=7178.137):
    """Direction from R_KM whose line passes the Earth at this height, in the x–y plane."""
    angle = math.asin((EARTH_RADIUS_KM + h_km) / distance_km)
    return np.array([-math.cos(angle), math.sin(angle), 0.0])


def test_horizon_of_800_km():
    # Wertz & Larson 1999, *Space Mission Analysis and Design*, inside cover: Earth angular radius 62.69° at 800 km
    assert math.degrees(angular_radius_rad(R_KM)) == pytest.approx(62.69, abs=0.01)


def test_occultation_is_skyfields():
    directions = RNG.normal(size=(500, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for r_km in (R_KM, np.array([2000.0, -6000.0, 3500.0]), np.array([42164.0, 0.0, 0.0])):
        near, _ = intersect_line_and_sphere(directions.T, -r_km[:, None], EARTH_RADIUS_KM)
        expected = np.nan_to_num(near, nan=-1.0) > 0.0
        assert (occulted(directions, r_km) == expected).all()


def test_ground_below_the_sun():
    sun = unit(R_KM)
    # 0.3 × Sun / π a steradian, in mag/arcsec²: −26.74 − 2.5 log₁₀(0.3/π) + 2.5 log₁₀(arcsec² in a steradian)
    expected = -26.74 - 2.5 * math.log10(0.3 / math.pi) + 2.5 * math.log10((180 * 3600 / math.pi) ** 2)
    assert 27.78 - 2.5 * math.log10(earth_s10(-sun, R_KM, sun)[0]) == pytest.approx(expected, abs=0.005)
    # 60° from the Sun half as bright, at and beyond the terminator nothing
    slant = unit([math.cos(math.pi / 3), math.sin(math.pi / 3), 0.0])
    assert earth_s10(-sun, R_KM, slant)[0] == pytest.approx(0.5 * earth_s10(-sun, R_KM, sun)[0], rel=1e-12)
    assert earth_s10(-sun, R_KM, -sun)[0] == 0.0


@pytest.mark.parametrize("phase_deg", [0.0, 30.0, 60.0, 90.0, 120.0, 150.0])
def test_whole_disk_from_afar_is_a_lambert_sphere(phase_deg):
    alpha = math.radians(phase_deg)
    distance = 5e7
    sun = np.array([math.cos(alpha), math.sin(alpha), 0.0])
    bodies = sun_alone(sun)
    _, _, v_mag = stray_sources(bodies, np.array([distance, 0.0, 0.0]), Sky(), rings=400, sectors=400)
    law = 2 / 3 * (math.sin(alpha) + (math.pi - alpha) * math.cos(alpha)) / math.pi
    expected = 10 ** (0.4 * 26.74) * 0.3 * law * (EARTH_RADIUS_KM / distance) ** 2
    total = (10 ** (-0.4 * v_mag[1:])).sum()  # the first is the Sun itself
    assert total == pytest.approx(expected, rel=3e-3)


def sun_alone(direction):
    one = np.ones(1)
    return Bodies(np.array(["Sun"]), direction[None], one, -26.74 * one, 0.0047 * one, one, 0.65 * one)


def test_default_pieces_are_fine_enough():
    sun = unit([0.3, 1.0, 0.2])
    coarse, fine = (
        (10 ** (-0.4 * stray_sources(sun_alone(sun), R_KM, Sky(), *n)[2][1:])).sum() for n in ((24, 48), (400, 400))
    )
    assert coarse == pytest.approx(fine, rel=2e-2)


def test_limb_falls_off_with_the_scale_height():
    sun = unit([0.0, 1.0, 0.0])
    heights = np.array([60.0, 68.0])
    low, high = earth_s10(np.stack([at_tangent_height(h) for h in heights]), R_KM, sun)
    # where the depth is small (2e-3 here) it falls by e every scale height
    assert low / high == pytest.approx(math.e ** (8.0 / SCALE_HEIGHT_KM), rel=0.01)
    just_above, just_below = earth_s10(np.stack([at_tangent_height(h) for h in (0.01, -0.01)]), R_KM, sun)
    assert 0.2 < just_above / just_below < 5.0  # air and ground join without a step of orders of magnitude
    assert earth_s10(at_tangent_height(181.0), R_KM, sun)[0] == 0.0


def test_sun_lights_high_air_beyond_the_terminator():
    # Sun 6° below the horizon of the tangent point: by geometry air is lit above R (1/cos 6° − 1) = 35.1 km
    heights = np.array([30.0, 34.0, 37.0, 60.0])
    for height, lit in zip(heights, (False, False, True, True), strict=True):
        line = at_tangent_height(height)
        vertical = unit(R_KM + line * -(R_KM @ line))
        sideways = np.cross(vertical, line)
        sun = -math.sin(math.radians(6.0)) * vertical + math.cos(math.radians(6.0)) * sideways
        assert (earth_s10(line, R_KM, sun)[0] > 0.0) == lit
    # and the ground there is dark
    ground = at_tangent_height(-0.001)
    assert earth_s10(ground, R_KM, sun)[0] == 0.0


def test_density_of_the_air_is_the_standard_atmospheres():
    # US Standard Atmosphere 1976: 0.01841, 1.027e-3 and 1.846e-5 kg/m³ at 30, 50, 80 km; 1.225 at the ground
    for height, density in ((30.0, 0.01841), (50.0, 1.027e-3), (80.0, 1.846e-5)):
        assert math.exp(-height / SCALE_HEIGHT_KM) == pytest.approx(density / 1.225, rel=0.2)


def test_map_hides_the_sky_and_shines():
    camera = Camera.from_fov(20.0, 200, 160)
    sun = unit([0.2, 1.0, 0.1])
    limb = at_tangent_height(0.0)
    ra, dec = (math.degrees(a) for a in direction_to_radec(limb))
    attitude = Attitude.from_radec_roll(ra, dec, 0.0)
    section = Sky()
    s10, hidden = earth_radiance_map(camera, attitude, R_KM, sun, section)
    assert 0.3 < hidden.mean() < 0.7
    total = diffuse_sky_s10(camera, attitude, R_KM, sun, section)
    assert (total[~hidden & (s10 == 0.0)] == 75.0).all()
    assert (total[hidden] > 1e8).all()
    night = diffuse_sky_s10(camera, attitude, R_KM, -sun, section)
    assert (night[hidden] == 0.0).all()
    assert diffuse_sky_s10(camera, attitude, R_KM, sun, Sky(earth=False)) == 75.0
    assert diffuse_sky_s10(camera, attitude.inverse.inverse, -R_KM, sun, section) == 75.0


def test_the_sun_is_not_seen_through_the_earth():
    bodies = sun_alone(-unit(R_KM))
    assert "Sun" not in stray_sources(bodies, R_KM, Sky())[0]
    assert "Sun" in stray_sources(bodies, R_KM, Sky(earth=False))[0]
    assert "Sun" in stray_sources(sun_alone(unit([0.0, 1.0, 0.0])), R_KM, Sky())[0]


@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.stem)
def test_shipped_scenarios_never_see_the_earth(path):
    renderer = Renderer(Scenario.load(path))
    for index in range(30):
        scene = renderer.scene(index)
        attitude, section = scene.pointing.camera, renderer.scenario.sky
        assert not (section.earth and earth_in_field(renderer.camera, attitude, scene.r_km))  # xybion.yaml has none
        assert diffuse_sky_s10(renderer.camera, attitude, scene.r_km, scene.sun_direction, section) == 75.0


def test_the_earth_is_in_the_field_when_only_its_air_is():
    """A field whose edge reaches 100 km above the ground sees the limb, and one whose edge is 200 km above nothing: the
    air ends at 180 km (`ATMOSPHERE_TOP_KM`)."""
    camera = Camera.from_fov(10.0, 400, 400)
    for edge_km, seen in ((-50.0, True), (100.0, True), (175.0, True), (185.0, False), (400.0, False)):
        edge = math.asin((EARTH_RADIUS_KM + edge_km) / 7178.137)
        away = edge + camera.half_diagonal_rad  # from the nadir, −x
        boresight = np.array([-math.cos(away), math.sin(away), 0.0])
        attitude = Attitude.from_radec_roll(*np.degrees(direction_to_radec(boresight)), 0.0)
        assert earth_in_field(camera, attitude, R_KM) == seen, edge_km


@pytest.mark.parametrize(
    ("distance_km", "drawn"), [(7000.0, True), (EARTH_DISK_KM - 1.0, True), (EARTH_DISK_KM, False)]
)
def test_the_earth_is_drawn_once(distance_km, drawn):
    """As a disk with surface and limb up to `EARTH_DISK_KM`, and beyond as one of the bodies."""
    assert has_disk(Sky(earth=True), np.array([0.0, -distance_km, 0.0])) == drawn
    assert not has_disk(Sky(earth=False), np.array([0.0, -distance_km, 0.0]))
