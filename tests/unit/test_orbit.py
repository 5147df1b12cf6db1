"""Orbit: what the section may say, shapes, and what a process pool needs of it."""

import math
import pickle
from datetime import UTC, datetime

import numpy as np
import pytest

from simulator.constants import EARTH_GM_KM3_S2, EARTH_J2, EARTH_RADIUS_KM
from simulator.mission.orbit import PROPAGATORS, CircularElements, Orbit, _kozai_mean_motion, build_orbit
from simulator.mission.parameters import OrbitParameters
from startracker.errors import InputError

EPOCH = datetime(2026, 3, 21, 12, tzinfo=UTC)


@pytest.mark.parametrize(
    ("section", "message"),
    [
        ({"raan_deg": 10.0, "ltan_h": 12.0}, r"raan_deg and ltan_h both"),
        ({"altitude_km": 6000.0}, r"no sun-synchronous inclination at 6000 km.*below 5974 km"),
        ({"altitude_km": -6400.0}, r"altitude_km: no orbit around the Earth at -6400 km"),
        ({"altitude_km": -3200.0, "inclination_deg": 98.6}, r"no orbit around the Earth"),
        ({"altitude_km": 1.5e6, "inclination_deg": 98.6}, r"no orbit around the Earth.*918622 km"),
    ],
)
def test_orbits_that_cannot_be(section, message):
    with pytest.raises(InputError, match=message):
        build_orbit(OrbitParameters(**section), EPOCH)


def test_limit_of_sun_synchronism_is_where_the_inclination_reaches_180_degrees():
    orbit = build_orbit(OrbitParameters(altitude_km=5973.0), EPOCH)
    assert 178.0 < math.degrees(orbit.inclination_rad) < 180.0


def test_sgp4_below_the_surface_says_so():
    orbit = build_orbit(OrbitParameters(altitude_km=-100.0, inclination_deg=98.6, propagator="sgp4"), EPOCH)
    with pytest.raises(InputError, match=r"SGP4 cannot propagate this orbit.*decayed"):
        orbit.state(0.0)


def test_unknown_propagator_is_named():
    section = OrbitParameters(propagator="sgp8")
    with pytest.raises(InputError, match=r"'sgp8' is not one of the propagators: j2, sgp4; did you mean 'sgp4'"):
        build_orbit(section, EPOCH)


@pytest.mark.parametrize("propagator", PROPAGATORS)
def test_node_and_latitude_are_taken_as_given(propagator):
    section = OrbitParameters(
        raan_deg=-20.0, argument_of_latitude_deg=400.0, propagator=propagator, inclination_deg=60.0
    )
    orbit = build_orbit(section, EPOCH)
    assert math.degrees(orbit.raan_rad(0.0)) == pytest.approx(340.0, abs=1e-9)
    assert math.degrees(orbit.inclination_rad) == pytest.approx(60.0, abs=1e-12)
    assert orbit.elements.argument_of_latitude_rad == pytest.approx(math.radians(40.0))


@pytest.mark.parametrize("propagator", PROPAGATORS)
def test_instants_alone_and_together(propagator):
    orbit = build_orbit(OrbitParameters(propagator=propagator), EPOCH)
    assert isinstance(orbit, Orbit)
    t_s = np.array([[0.0, 17.25, 5e5], [1e6, -1e6, 3e7]])
    r, v = orbit.state(t_s)
    nodes = orbit.raan_rad(t_s)
    assert r.shape == v.shape == (2, 3, 3)
    assert nodes.shape == (2, 3)
    for index in np.ndindex(2, 3):
        alone = orbit.state(float(t_s[index]))
        assert alone[0].shape == alone[1].shape == (3,)
        np.testing.assert_allclose(alone[0], r[index], rtol=0, atol=1e-8)
        np.testing.assert_allclose(alone[1], v[index], rtol=0, atol=1e-11)
        assert orbit.raan_rad(float(t_s[index])) == pytest.approx(nodes[index], abs=1e-12)
    assert isinstance(orbit.raan_rad(1.0), float)
    assert np.array_equal(t_s, [[0.0, 17.25, 5e5], [1e6, -1e6, 3e7]])
    assert orbit.state(np.zeros(0))[0].shape == (0, 3)


@pytest.mark.parametrize("propagator", PROPAGATORS)
def test_pickled_orbit_gives_the_same_states_to_the_bit(propagator):
    orbit = build_orbit(OrbitParameters(propagator=propagator), EPOCH)
    before = orbit.state(1e6)
    copy = pickle.loads(pickle.dumps(orbit))
    assert copy == orbit
    assert np.array_equal(copy.state(1e6), before)
    assert copy.period_s == orbit.period_s


@pytest.mark.parametrize("propagator", PROPAGATORS)
def test_a_leap_second_moves_nothing(propagator):
    # two epochs a leap second apart in label, 2 s apart in truth: states 2 s apart, as in any other night
    section = OrbitParameters(propagator=propagator, raan_deg=10.0)
    orbit = build_orbit(section, datetime(2016, 12, 31, 23, 59, 59, tzinfo=UTC))
    r, v = orbit.state(np.array([0.0, 1.0, 2.0]))
    steps = np.linalg.norm(np.diff(r, axis=0), axis=1)
    speed = np.linalg.norm(v, axis=1).mean()
    np.testing.assert_allclose(steps, speed, rtol=1e-5)  # chord against arc 5e-8, eccentricity of SGP4 1e-3 × 1e-3


def test_high_orbit_goes_through_the_deep_space_branch():
    section = {"altitude_km": 20_000.0, "inclination_deg": 55.0, "raan_deg": 30.0}
    j2, sgp4 = (build_orbit(OrbitParameters(**section, propagator=name), EPOCH) for name in PROPAGATORS)
    # Sun and Moon move a semi-synchronous orbit by some km a day
    assert np.linalg.norm(j2.state(3600.0)[0] - sgp4.state(3600.0)[0]) < 20.0


@pytest.mark.parametrize(("altitude_km", "inclination_deg"), [(300.0, 0.0), (300.0, 90.0), (1400.0, 28.5)])
def test_the_first_step_of_sgp4_gives_brouwer_s_mean_motion_back(altitude_km, inclination_deg):
    """Hoots & Roehrich 1980, section 6: n₀'' = n₀ / (1 + δ₀), a₀ = a₁ (1 − δ₁/3 − δ₁² − 134/81 δ₁³). To 2e-14, some
    roundings; the smallest term is 3e-12 of the mean motion at the equator."""
    elements = CircularElements(EARTH_RADIUS_KM + altitude_km, math.radians(inclination_deg), 0.3, 0.2)
    kozai = _kozai_mean_motion(elements)
    brouwer = math.sqrt(EARTH_GM_KM3_S2 / elements.semi_major_axis_km**3)
    a1 = (EARTH_GM_KM3_S2 / kozai**2) ** (1.0 / 3.0) / EARTH_RADIUS_KM
    k2 = 0.5 * EARTH_J2
    shape = 3.0 * math.cos(elements.inclination_rad) ** 2 - 1.0
    delta1 = 1.5 * k2 / a1**2 * shape
    a0 = a1 * (1.0 - delta1 / 3.0 - delta1**2 - 134.0 / 81.0 * delta1**3)
    assert kozai / (1.0 + 1.5 * k2 / a0**2 * shape) == pytest.approx(brouwer, rel=2e-14, abs=0.0)
