"""Positions of planets on pictures against astropy's own ephemeris routines (ERFA's plan94 and epv00, no DE421).

Tolerance: plan94 is good to 70″ (Mars, Jupiter, Saturn; Simon et al. 1994), and the picture's directions omit light
deflection: 0.03°.
"""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import get_body_barycentric, get_body_barycentric_posvel, solar_system_ephemeris
from astropy.time import Time

from startracker import InputError, Observer
from startracker.catalog.bodies import body_directions


@pytest.mark.parametrize("year", [1997.25, 2015.1, 2026.5])
@pytest.mark.parametrize("name", ["Mercury", "Venus", "Mars", "Jupiter", "Saturn", "Uranus", "Neptune", "Sun"])
def test_directions(name, year):
    time = Time(year, format="jyear", scale="tt")
    with solar_system_ephemeris.set("builtin"):
        earth = get_body_barycentric("earth", time).xyz.to_value(u.au)
        light_days = 0.0
        for _ in range(3):
            offset = get_body_barycentric(name.lower(), time - light_days * u.day).xyz.to_value(u.au) - earth
            light_days = np.linalg.norm(offset) * 499.005 / 86400.0
    found = body_directions(Observer(year))[name]
    assert np.degrees(np.arccos(min(1.0, found @ offset / np.linalg.norm(offset)))) < 0.03


def test_the_observer_on_the_earth_moves_with_it():
    time = Time("2026-07-01T22:00:00", scale="utc")
    observer = Observer.on_earth(time)
    assert observer.epoch_jyear == pytest.approx(time.tt.jyear, abs=1e-9)
    with solar_system_ephemeris.set("builtin"):
        velocity = get_body_barycentric_posvel("earth", time)[1].xyz.to_value(u.km / u.s)
    np.testing.assert_allclose(observer.velocity_km_s, velocity, atol=1e-3)


def test_the_moon_needs_a_position_and_dates_have_limits():
    assert "Moon" not in body_directions(Observer(2026.5))
    assert "Moon" in body_directions(Observer(2026.5, position_au=np.array([0.1, -0.9, -0.4])))
    with pytest.raises(InputError, match="1899-07-29 to 2053-10-09"):
        body_directions(Observer(2080.0))
