from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from simulator.mission.clock import Clock
from simulator.sky.apparent import SkyIndex, apparent_directions
from simulator.sky.ephemeris import observe
from simulator.sky.instants import sun_position_au
from simulator.sky.parameters import Sky
from startracker.catalog import load_catalog
from startracker.core import ARCSEC_RAD
from startracker.observer import Observer

SECTION = Sky()


@pytest.fixture(scope="module")
def index():
    return SkyIndex(load_catalog("hipparcos").brighter_than(7.5))


def view(index, direction, radius_rad, observer, sun):
    """The stars near a direction, and where each appears."""
    rows = index.near(direction, radius_rad, observer.epoch_jyear)
    return index.catalog.select(rows), index.apparent(rows, observer, sun, SECTION)


@pytest.fixture(scope="module")
def sight():
    clock = Clock(datetime(2049, 9, 1, tzinfo=UTC))
    return observe(clock, 0.0, [0.0, 7178.0, 0.0], [7.45, 0.0, 0.0]), sun_position_au(clock, 0.0)


@pytest.mark.parametrize("radius_deg", [0.5, 7.0, 60.0, 180.0])
@pytest.mark.parametrize("ra_dec_deg", [(0.0, 0.0), (359.99, 8.6), (120.0, 90.0), (10.0, -90.0), (201.0, -35.0)])
def test_no_star_of_a_field_is_missed(index, sight, radius_deg, ra_dec_deg):
    observer, sun = sight
    ra, dec = np.radians(ra_dec_deg)
    centre = np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    everywhere = apparent_directions(index.catalog, observer, sun, SECTION)
    inside = (
        everywhere @ centre >= np.cos(np.radians(radius_deg)) if radius_deg < 180 else np.ones(len(everywhere), bool)
    )
    stars, directions = view(index, centre, np.radians(radius_deg), observer, sun)
    assert set(index.catalog.id[inside].tolist()) <= set(stars.id.tolist())
    # and hardly one too many: all lie within the widened radius
    reach = np.radians(radius_deg) + 60 * ARCSEC_RAD + 1.2 * 60 * index._fastest_rad_yr
    assert np.all(directions @ centre >= np.cos(min(reach, np.pi)) - 1e-12)
    rows = np.searchsorted(index.near(centre, np.radians(radius_deg), observer.epoch_jyear), np.flatnonzero(inside))
    np.testing.assert_array_equal(directions[rows], everywhere[inside])


def test_a_fast_star_is_found_where_it_has_gone():
    catalog = load_catalog("hipparcos")
    barnard = catalog.select(np.flatnonzero(catalog.id == 87937))
    index = SkyIndex(barnard)
    there = barnard.directions(2200.0)[0]
    assert len(index.near(there, 1e-6, 2200.0)) == 1
    assert len(index.near(there, 1e-6, 1991.25)) == 0


def test_a_star_is_found_where_aberration_puts_it():
    catalog = load_catalog("hipparcos")
    vega = catalog.select(np.flatnonzero(catalog.id == 91262))
    index = SkyIndex(vega)
    # at the catalogue's own epoch nothing but aberration moves it: 25″ at 36 km/s
    observer = Observer(epoch_jyear=1991.25, velocity_km_s=np.array([36.0, 0.0, 0.0]), position_au=np.zeros(3))
    (there,) = apparent_directions(vega, observer, None, SECTION)
    assert np.linalg.norm(there - vega.directions(1991.25)[0]) > 20 * ARCSEC_RAD
    stars, _ = view(index, there, 1e-6, observer, None)
    assert stars.id.tolist() == [91262]


def test_switches_and_what_an_observer_lacks(index, sight):
    observer, sun = sight
    catalog = index.catalog
    off = Sky(proper_motion=False, parallax=False, light_deflection=False, aberration=False)
    np.testing.assert_array_equal(apparent_directions(catalog, observer, sun, off), catalog.directions(1991.25))

    def moved(section, sun_au=sun):
        return np.linalg.norm(
            apparent_directions(catalog, observer, sun_au, section) - catalog.directions(1991.25), axis=1
        )

    # the largest parallax of hip2.dat is that of α Cen B, 0.797″, and the Sun's farthest observer 1.02 au away
    one = {
        "proper_motion": (0.5, 600.0),
        "parallax": (0.05, 0.815),
        "light_deflection": (0.004, 1.8),
        "aberration": (20, 27),
    }
    for switch, (least, most) in one.items():
        shift = moved(replace(off, **{switch: True})) / ARCSEC_RAD
        assert least < shift.max() < most, switch
    # without a Sun, or an observer that knows no place and no speed, the effects are left out
    assert np.all(moved(replace(off, light_deflection=True), None) == 0.0)
    blind = Observer(epoch_jyear=1991.25)
    np.testing.assert_allclose(
        apparent_directions(catalog, blind, sun, SECTION), catalog.directions(1991.25), rtol=0, atol=1e-16
    )


def test_directions_are_unit_vectors_and_the_catalogue_is_left_alone(index, sight):
    before = index.catalog.ra_rad.copy()
    out = apparent_directions(index.catalog, *sight, SECTION)
    np.testing.assert_allclose(np.linalg.norm(out, axis=1), 1.0, atol=4e-16)
    np.testing.assert_array_equal(index.catalog.ra_rad, before)


def test_an_empty_sky():
    index = SkyIndex(load_catalog("bsc5").brighter_than(-5.0))
    stars, directions = view(index, np.array([1.0, 0.0, 0.0]), 0.1, Observer(), None)
    assert len(stars) == 0
    assert directions.shape == (0, 3)
