"""Blocks of instants: the same numbers whatever was asked for before, and those of single instants."""

from dataclasses import fields

import numpy as np
import pytest

from simulator.build import build_scenes
from simulator.scenario import Scenario
from simulator.scene import BLOCK_TRIALS, GivenState
from simulator.sky.earth import unhidden
from simulator.sky.ephemeris import observe
from simulator.sky.instants import Instants, solar_system, sun_position_au

INDICES = (0, 1, BLOCK_TRIALS - 1, BLOCK_TRIALS, 5 * BLOCK_TRIALS + 7)


def numbers(instant):
    """All numbers of an instant, as bytes."""
    columns = [getattr(instant.bodies, column.name) for column in fields(instant.bodies) if column.name != "name"]
    observer = instant.observer
    columns += [instant.r_km, instant.v_km_s, observer.position_au, observer.velocity_km_s, instant.sun_au]
    columns += [instant.t_s, observer.epoch_jyear, instant.orbit_argument_deg]
    columns += [instant.latitude_deg, instant.longitude_deg, instant.sunlit]
    return [np.asarray(column).tobytes() for column in columns]


@pytest.mark.parametrize("name", ["cubesat_ideal", "oedipus"])
def test_a_trial_has_the_same_numbers_in_any_order(name):
    scenario = Scenario.load(name)
    forwards, backwards = build_scenes(scenario), build_scenes(scenario)
    one = {index: numbers(forwards.instant(index)) for index in INDICES}
    other = {index: numbers(backwards.instant(index)) for index in reversed(INDICES)}
    assert one == other


@pytest.mark.parametrize("propagator", ["j2", "sgp4"])
def test_a_block_is_its_instants_one_by_one(propagator):
    scenario = Scenario.load("cubesat_ideal", overrides=[f"orbit.propagator={propagator}"])
    orbit = build_scenes(scenario).orbit
    t_s = np.linspace(0.0, 3e7, 17)
    block = Instants.of(orbit, t_s, scenario.sky)
    for k, t in enumerate(t_s.tolist()):
        here = block.at(k)
        r_km, v_km_s = orbit.state(t)
        # 1 µm of 1e4 km and 0.1 m of 1 au: rounding, and that of dates in days (1e-16 of 350 d is 3 ns, 0.1 mm)
        np.testing.assert_allclose(here.r_km, r_km, rtol=0, atol=1e-9)
        observer = observe(orbit.clock, t, r_km, v_km_s)
        np.testing.assert_allclose(here.observer.position_au, observer.position_au, rtol=0, atol=1e-14)
        np.testing.assert_allclose(here.observer.velocity_km_s, observer.velocity_km_s, rtol=0, atol=1e-11)
        np.testing.assert_allclose(here.sun_au, sun_position_au(orbit.clock, t), rtol=0, atol=1e-14)
        bodies = solar_system(orbit.clock, t, observer, scenario.sky)
        # light time to 1e-12 d, in which Mercury moves 5 mm at 0.6 au
        np.testing.assert_allclose(here.bodies.direction, bodies.direction, rtol=0, atol=1e-13)
        np.testing.assert_allclose(here.bodies.v_mag, bodies.v_mag, rtol=0, atol=1e-12)
        np.testing.assert_allclose(here.bodies.angular_radius_rad, bodies.angular_radius_rad, rtol=1e-12)


def test_the_shadow_is_that_of_the_penumbra_drawn():
    scenario = Scenario.load("cubesat_ideal", overrides=["orbit.ltan_h=12", "sky.earth=true"])
    orbit = build_scenes(scenario).orbit
    block = Instants.of(orbit, np.linspace(0.0, orbit.period_s, 400), scenario.sky)
    free = []
    for k in range(400):
        here = block.at(k)
        to_sun = here.sun_au - here.observer.position_au
        free.append(unhidden(here.bodies, here.r_km, to_sun / np.linalg.norm(to_sun), scenario.sky)[-1])
    # the Sun's centre is hidden where less than half of its disk is free, but for the 20″ of aberration, 1/47 of its
    # radius, and 7 km between the equatorial and the mean radius of the Earth, 0.1°, a third of it
    np.testing.assert_array_equal(np.array(free)[block.sunlit] > 0.1, True)
    np.testing.assert_array_equal(np.array(free)[~block.sunlit] < 0.9, True)
    # a circle of 7178 km in the plane of the Sun (24° off it at most): 2 arcsin(R/r) of 360° at the longest
    assert 0.3 < np.mean(~block.sunlit) < np.arcsin(6378.137 / np.linalg.norm(block.r_km[0])) / np.pi + 0.01


def test_planned_times_are_those_of_the_frames():
    scenario = Scenario.load("cubesat_ideal")
    planned, alone = build_scenes(scenario), build_scenes(scenario)
    planned.plan([10.0, 20.0, 30.0])
    stream = np.random.default_rng
    one, other = (
        scenes.scene(0, lambda stage: stream(1), 0.1, 0.1, GivenState(at_s=20.0)) for scenes in (planned, alone)
    )
    assert one.t_s == other.t_s == 20.0
    np.testing.assert_allclose(one.r_km, other.r_km, rtol=0, atol=1e-9)
    np.testing.assert_allclose(one.bodies.direction, other.bodies.direction, rtol=0, atol=1e-13)


def test_without_planets_there_are_none():
    scenario = Scenario.load("cubesat_ideal", overrides=["sky.planets=false"])
    assert len(build_scenes(scenario).instant(3).bodies) == 0
