"""The sky of spacecraft away from the Earth: aberration, parallax and deflection against ERFA, the Earth as a planet
against Skyfield, eclipses by the Moon against the formula of a circular orbit."""

import math

import erfa
import numpy as np
import pytest
from skyfield.api import load
from skyfield.magnitudelib import planetary_magnitude
from skyfield.vectorlib import VectorFunction

from simulator import Renderer, Scenario
from simulator.build import build_scenes
from simulator.light import hidden_stars
from simulator.mission.trajectory import centre_state
from simulator.scene import GivenState
from simulator.sky.apparent import apparent_directions, largest_shift_rad
from simulator.sky.instants import Instants
from startracker.catalog import load_catalog
from startracker.core import AU_KM, MAS_RAD
from startracker.ephemeris import de421
from startracker.errors import InputError
from startracker.geometry.attitude import direction_to_radec

DAY_S = 86_400.0
TIMESCALE = load.timescale(builtin=True)
LUNAR = [
    "orbit.centre=Moon",
    "orbit.elements={semi_major_axis_km: 1837.4, inclination_deg: 90}",
    "study.sampling=orbit",
    "pointing.mounting=zenith",
]


@pytest.mark.parametrize(
    "orbit",
    [
        [],  # cruise.yaml, 22 km/s
        ["orbit.elements.semi_major_axis_km=5e7", "orbit.elements.eccentricity=0.8"],  # to 0.07 au, 130 km/s
        ["orbit.elements.semi_major_axis_km=4.5e9", "orbit.elements.eccentricity=0.0"],  # 30 au: a parallax of 23″
    ],
    ids=["cruise", "close to the Sun", "far from it"],
)
def test_stars_from_a_heliocentric_orbit_against_erfa(orbit):
    """ERFA's chain for an observer in space, ``apcs`` and ``atciq``; its aberration has a term in the Sun's potential
    that ours lacks: 2 GM/(c² r) β, 0.4 µas at 1 au, at 0.07 au with 130 km/s 25 µas; light deflected there up to the
    first order in both."""
    scenes = build_scenes(Scenario.load("cruise", overrides=orbit))
    t_s = np.array([0.0, 40.0, 100.0]) * DAY_S
    instants = Instants.of(scenes.orbit, t_s, scenes.parameters.sky)
    catalog = load_catalog("hipparcos").brighter_than(4.5)
    for k, t in enumerate(t_s):
        now = instants.at(k)
        found = apparent_directions(catalog, now.observer, now.sun_au, scenes.parameters.sky)
        earth, sun = (centre_state(name, scenes.clock, float(t)) for name in ("Earth", "Sun"))
        r_km, v_km_s = scenes.orbit.state(float(t))
        np.testing.assert_allclose(now.observer.position_au, (sun.r_km + r_km) / AU_KM, rtol=0, atol=1e-13)
        np.testing.assert_allclose(now.observer.velocity_km_s, sun.v_km_s + v_km_s, rtol=0, atol=1e-10)
        pv = np.zeros((), dtype=erfa.dt_pv)
        pv["p"], pv["v"] = now.r_km * 1e3, now.v_km_s * 1e3
        ebpv = np.zeros((), dtype=erfa.dt_pv)
        ebpv["p"], ebpv["v"] = earth.r_km / AU_KM, earth.v_km_s / AU_KM * DAY_S
        astrom = erfa.ufunc.apcs(*scenes.clock.tt_jd(float(t)), pv, ebpv, (earth.r_km - sun.r_km) / AU_KM)
        cos_dec = np.cos(catalog.dec_rad)
        ra, dec = erfa.ufunc.atciq(
            catalog.ra_rad,
            catalog.dec_rad,
            catalog.pm_ra_rad_yr / cos_dec,
            catalog.pm_dec_rad_yr,
            catalog.parallax_rad / MAS_RAD / 1e3,
            catalog.radial_velocity_km_s,
            moved_to_catalogue_epoch(astrom, catalog.epoch_jyear),
        )
        expected = erfa.ufunc.s2c(ra, dec)
        away = np.arccos(found @ now_to_sun(now)) > math.radians(2.0)  # beyond the corona, where ERFA's limiter is
        distance_au = np.linalg.norm(now.observer.position_au - now.sun_au)
        beta = np.linalg.norm(now.observer.velocity_km_s) / 299_792.458
        potential_rad = 2.0 * 1.476_625 / AU_KM / distance_au * beta
        off = np.linalg.norm(found - expected, axis=1)[away]
        assert off.max() < 1.5 * potential_rad + 2e-3 * MAS_RAD
        # the search for the stars of a field allows for all of it
        shifts = np.linalg.norm(found - catalog.space_motion()[0], axis=1)[away]
        largest = largest_shift_rad(now.observer) + 50.0 * np.abs(catalog.pm_dec_rad_yr).max() * 2.0
        assert shifts.max() < largest


def now_to_sun(now):
    to_sun = now.sun_au - now.observer.position_au
    return to_sun / np.linalg.norm(to_sun)


def moved_to_catalogue_epoch(astrom, epoch_jyear):
    """ERFA counts space motion from J2000, the catalogue from its own epoch."""
    moved = astrom.copy()
    moved["pmt"] += 2000.0 - epoch_jyear
    return moved


class Craft(VectorFunction):
    """A spacecraft for Skyfield."""

    center, target = 399, -42

    def __init__(self, r_km, v_km_s):
        self.r_au, self.v_au_d = r_km / AU_KM, v_km_s / AU_KM * DAY_S

    def _at(self, t):
        return self.r_au, self.v_au_d, self.r_au, None


def test_the_earth_is_a_planet_from_afar():
    """Direction against Skyfield's apparent one: deflection by the planets, which we leave out, is below 1 mas for the
    Earth; the magnitude with its barycentre for the Sun: 0.03 mag."""
    scenes = build_scenes(Scenario.load("cruise"))
    t_s = np.array([0.0, 50.0, 150.0, 300.0]) * DAY_S
    instants = Instants.of(scenes.orbit, t_s, scenes.parameters.sky)
    for k in range(len(t_s)):
        now = instants.at(k)
        (row,) = np.flatnonzero(now.bodies.name == "Earth")
        time = TIMESCALE.tt_jd(*scenes.clock.tt_jd(float(t_s[k])))
        seen = (de421()["earth"] + Craft(now.r_km, now.v_km_s)).at(time).observe(de421()["earth"])
        expected = seen.apparent().xyz.au
        expected = expected / np.linalg.norm(expected)
        assert np.linalg.norm(now.bodies.direction[row] - expected) < MAS_RAD
        assert now.bodies.v_mag[row] == pytest.approx(planetary_magnitude(seen), abs=0.03)
        assert now.bodies.angular_radius_rad[row] == pytest.approx(6378.137 / seen.distance().km, rel=1e-6)
        assert now.sunlit


def test_no_earth_in_the_field_where_there_is_none():
    """Looking at the Earth from afar a frame has one more body and no surface; within a million km no body of that
    name, but the surface."""
    renderer = Renderer(Scenario.load("cruise", overrides=["pointing.target=Earth"]))
    frame, truth = renderer.frame(0)
    row = np.flatnonzero(truth.sources.name == "Earth")
    assert len(row) == 1
    x, y = truth.sources.xy[row[0]]
    assert math.hypot(x - 511.5, y - 511.5) * renderer.camera.pixel_rad < math.radians(1.8)  # error_deg on two axes
    around = frame.image[int(y) - 4 : int(y) + 5, int(x) - 4 : int(x) + 5]
    assert around.max() > 10 * np.median(frame.image)
    assert np.median(frame.image) < 80  # black level 60, no lit surface
    with pytest.raises(InputError, match="within a million km it is not a body of the sky"):
        Renderer(Scenario.load("cubesat_ideal", overrides=["pointing.target=Earth"])).frame(0)


def test_stars_behind_the_moon_and_its_shadow():
    renderer = Renderer(Scenario.load("cubesat_ideal", overrides=LUNAR))
    scenes = renderer.scenes
    _, truth = renderer.frame(0)
    assert (truth.sources.electrons[truth.sources.is_star] > 0).sum() > 20
    period = scenes.orbit.period_s
    assert period == pytest.approx(2 * math.pi * math.sqrt(1837.4**3 / 4902.8), rel=1e-6)
    t_s = np.linspace(0.0, period, 4000, endpoint=False)
    instants = Instants.of(scenes.orbit, t_s, scenes.parameters.sky)
    # fraction in a cylindrical shadow: arccos(√(h² + 2 R h) / (a cos β)) / π (Wertz & Larson 1999, section 5.1)
    normal = np.cross(instants.r_centre_km[0], instants.v_centre_km_s[0])
    beta = math.asin(now_to_sun(instants.at(0)) @ normal / np.linalg.norm(normal))
    expected = math.acos(math.sqrt(1837.4**2 - 1737.4**2) / 1837.4 / math.cos(beta)) / math.pi
    assert 1.0 - instants.sunlit.mean() == pytest.approx(
        expected, abs=1e-3
    )  # two edges in 4000 steps, the Sun's motion
    # half of the sky is below: what is in the Moon's direction is hidden, whatever the camera
    directions = np.random.default_rng(1).normal(size=(2000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    down = -instants.r_centre_km[0] / 1837.4
    below = directions @ down > math.sqrt(1.0 - (1737.4 / 1837.4) ** 2)
    scene = scenes.scene(0, lambda stage: np.random.default_rng(1), 0.1, 0.0, GivenState(at_s=0.0))
    # aberration and light time move the Moon by less than 1″
    np.testing.assert_array_equal(hidden_stars(scene, directions, scenes.parameters.sky), below)


def test_a_near_surface_in_the_field_is_refused():
    overrides = [*LUNAR[:3], "pointing.mounting=forward"]  # the limb is 19° below the horizontal, and the camera tilts
    Renderer(Scenario.load("cubesat_ideal", overrides=overrides)).frame(0)
    with pytest.raises(InputError, match=r"Moon, 71° in radius, is in the field; near surfaces .* are not rendered"):
        Renderer(Scenario.load("cubesat_ideal", overrides=[*overrides, "pointing.offset_deg=[0,-25,0]"])).frame(0)


def test_local_level_refers_to_the_centre():
    scenes = build_scenes(Scenario.load("cruise", overrides=["pointing.error_deg=0"]))
    scene = scenes.scene(3, lambda stage: np.random.default_rng(1), 0.1, 0.2)
    down = scene.pointing.body.inverse.apply(np.array([0.0, 0.0, 1.0]))
    assert down @ scene.sun_direction == pytest.approx(1.0, abs=1e-9)  # sun_direction is geometric
    ra, _ = direction_to_radec(scene.pointing.camera.boresight)
    assert math.isfinite(ra)


def test_a_month_near_the_second_lagrange_point():
    """Seen from L2 the Earth is a body close to the Sun, 0.24° in radius, mostly dark, and the frame is solved as any
    other; the spacecraft stays near the Sun–Earth line for a month."""
    scenario = Scenario.load("cubesat_ideal")
    earth, sun = (centre_state(name, build_scenes(scenario).clock, 0.0) for name in ("Earth", "Sun"))
    away = (earth.r_km - sun.r_km) / np.linalg.norm(earth.r_km - sun.r_km)
    # at rest in the frame that turns with the Earth, 200,000 km off the ecliptic
    position, velocity = 1.5e6 * away + [0.0, 0.0, 2e5], 0.01 * (earth.v_km_s - sun.v_km_s)
    values = {"orbit.state.position_km": tuple(position), "orbit.state.velocity_km_s": tuple(velocity)}
    renderer = Renderer(scenario.changed(values | {"pointing.mounting": "zenith", "study.sampling": "sky"}))
    t_s = np.linspace(0.0, 30.0, 10) * DAY_S
    instants = Instants.of(renderer.scenes.orbit, t_s, renderer.scenes.parameters.sky)
    for k in range(10):
        now = instants.at(k)
        (row,) = np.flatnonzero(now.bodies.name == "Earth")
        distance = np.linalg.norm(now.r_km)
        assert 1.2e6 < distance < 1.8e6
        assert now.bodies.angular_radius_rad[row] == pytest.approx(math.asin(6378.137 / distance), rel=1e-4)
        assert now.bodies.illuminated_fraction[row] < 0.02
        assert now.bodies.direction[row] @ now_to_sun(now) > math.cos(math.radians(15.0))
        assert now.sunlit
    _, truth = renderer.frame(0)
    assert truth.sources.is_star.sum() > 20
