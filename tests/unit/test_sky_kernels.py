"""Stars, bodies and photometry against plain NumPy that does the same, star by star and body by body, and jplephem.

Tolerances are rounding, a few units in the last place.
"""

import itertools
import math
from datetime import UTC, datetime
from importlib.resources import files

import erfa
import numpy as np
import pytest

from simulator.constants import DEFAULT_B_V, RADIUS_KM
from simulator.mission.clock import Clock
from simulator.optics.curves import Curve
from simulator.sky.apparent import SkyIndex, apparent_directions
from simulator.sky.colours import population_giant_share
from simulator.sky.ephemeris import observe, sky_time
from simulator.sky.instants import solar_system, sun_position_au
from simulator.sky.parameters import Sky
from simulator.sky.photometry import Photometer
from simulator.sky.spectra import B_V_RANGE, LATE_GIANT
from startracker.catalog import load_catalog
from startracker.core import ARCSEC_RAD, AU_KM, SPEED_OF_LIGHT_KM_S
from startracker.observer import aberrate

ROUNDING = 4e-16


@pytest.fixture(scope="module")
def kernel():
    from jplephem.spk import SPK

    kernel = SPK.open(str(files("skyfield_data") / "data" / "de421.bsp"))
    yield kernel
    kernel.close()


ROUTES = {"Mercury": (1, 199), "Venus": (2, 299), "Mars": (4, 499), "Moon": (3, 301), "Sun": (10,)}
ROUTES |= {"Jupiter": (5,), "Saturn": (6,), "Uranus": (7,), "Neptune": (8,)}


def by_jplephem(kernel, name, jd):
    """Barycentric position, km: the sum over the ephemeris' segments from centre to centre."""
    return sum(kernel[pair].compute(*jd) for pair in itertools.pairwise((0, *ROUTES[name])))


def plain_directions(catalog, observer, sun_au, section):
    """Space motion, parallax, deflection by ERFA, aberration, on whole columns."""
    u, motion = catalog.space_motion()
    position = observer.position_au
    if section.proper_motion:
        light_time = AU_KM / SPEED_OF_LIGHT_KM_S / (86_400.0 * 365.25)
        years = observer.epoch_jyear - catalog.epoch_jyear + (u @ position) * light_time
        u = u + years[:, None] * motion
    if section.parallax:
        u = u - catalog.parallax_rad[:, None] * position
    u = u / np.linalg.norm(u, axis=1, keepdims=True)
    if section.light_deflection:
        away = position - sun_au
        distance = float(np.linalg.norm(away))
        u = erfa.ufunc.ldsun(u, away / distance, distance)
    return aberrate(u, observer.velocity_km_s) if section.aberration else u


@pytest.fixture(scope="module")
def index():
    return SkyIndex(load_catalog("hipparcos").brighter_than(7.0))


@pytest.mark.parametrize("year", [1996, 2026, 2051])
@pytest.mark.parametrize("off", [None, "proper_motion", "parallax", "light_deflection", "aberration"])
def test_apparent_places_are_those_of_whole_columns(index, year, off):
    clock = Clock(datetime(year, 6, 21, 5, tzinfo=UTC))
    observer, sun = observe(clock, 0.0, [0.0, 7178.0, 0.0], [7.45, 0.0, 0.0]), sun_position_au(clock, 0.0)
    section = Sky() if off is None else Sky(**{off: False})
    expected = plain_directions(index.catalog, observer, sun, section)
    np.testing.assert_allclose(apparent_directions(index.catalog, observer, sun, section), expected, atol=ROUNDING)
    rows = index.near(expected[17], 0.3, observer.epoch_jyear)
    assert 10 < len(rows) < len(expected)
    np.testing.assert_allclose(index.apparent(rows, observer, sun, section), expected[rows], atol=ROUNDING)


@pytest.mark.parametrize("radius_rad", [1e-6, 0.01, 0.15, 1.0, math.pi])
def test_stars_of_a_field_are_those_of_a_tree(index, radius_rad):
    from scipy.spatial import cKDTree

    tree = cKDTree(index.catalog.space_motion()[0])
    epoch = index.catalog.epoch_jyear  # nothing but the 30″ of aberration and parallax widens the field
    chord = 2.0 * math.sin(min(radius_rad + 30.0 * ARCSEC_RAD, math.pi) / 2.0) * (1.0 + 1e-12)
    centres = np.random.default_rng(1).normal(size=(50, 3))
    axes = np.concatenate([np.eye(3), -np.eye(3)])  # on the cells' own edges
    for centre in np.concatenate([axes, centres / np.linalg.norm(centres, axis=1, keepdims=True)]):
        expected = tree.query_ball_point(centre, chord, return_sorted=True)
        np.testing.assert_array_equal(index.near(centre, radius_rad, epoch), np.array(expected, dtype=np.int64))


@pytest.mark.parametrize("day", range(0, 3650, 365))
def test_bodies_are_those_that_jplephem_and_erfa_make(kernel, day):
    clock = Clock(datetime(2020, 2, 1, tzinfo=UTC))
    t_s = 86_400.0 * day
    observer = observe(clock, t_s, [7178.0, 0.0, 0.0], [0.0, 7.45, 0.0])
    bodies = solar_system(clock, t_s, observer, Sky())
    time, here = sky_time(clock, t_s), observer.position_au
    jd = (time.whole, time.tdb_fraction)
    sun = by_jplephem(kernel, "Sun", jd) / AU_KM
    assert set(bodies.name) == set(RADIUS_KM) - {"Earth"}  # which is a body from afar only
    for k, target in enumerate(bodies.name.tolist()):
        delay = 0.0
        for _ in range(6):
            seen = by_jplephem(kernel, target, (jd[0], jd[1] - delay)) / AU_KM - here
            delay = float(np.linalg.norm(seen)) * AU_KM / SPEED_OF_LIGHT_KM_S / 86_400.0
        distance = float(np.linalg.norm(seen))
        direction = seen / distance
        if target != "Sun":
            from_sun, away = seen + here - sun, here - sun
            em = float(np.linalg.norm(away))
            direction = erfa.ufunc.ld(1.0, direction, from_sun / np.linalg.norm(from_sun), away / em, em, 1e-9)
        direction = aberrate(direction[None] / np.linalg.norm(direction), observer.velocity_km_s)[0]
        # Skyfield iterates the light time to 1e-12 d, 86 ns, in which a planet moves 5 mm: 1e-11 rad for the Moon
        moved = 60.0 * 86e-9 / (distance * AU_KM)
        np.testing.assert_allclose(bodies.direction[k], direction, rtol=0, atol=1e-12 + moved)
        assert bodies.distance_au[k] == pytest.approx(distance, rel=1e-12 + moved)


def plain_lookup(tables, colour, giant, grids):
    """The photometer's tables at one star, by `numpy.interp`."""
    colour = DEFAULT_B_V if math.isnan(colour) else min(max(colour, B_V_RANGE[0]), B_V_RANGE[1])
    share = float(population_giant_share(np.array(colour))) if math.isnan(giant) else giant
    if share >= LATE_GIANT[0]:
        return np.array([np.interp(share, grids[1], table) for table in tables[2].T])
    share = min(max(share, 0.0), 1.0)
    dwarfs, giants = (np.array([np.interp(colour, grids[0], column) for column in table.T]) for table in tables[:2])
    return dwarfs * (1.0 - share) + giants * share


def test_electrons_are_those_of_interpolated_tables():
    from simulator.sky import photometry

    photometer = Photometer(Curve.flat(0.5), 2.0)
    b_v = [-0.4, -0.39, 0.0, 0.65, 1.234, 2.2, 5.0, math.nan, 1.6, 1.6, 1.6, 0.8, 0.8]
    giant = [0.0, 1.0, math.nan, 0.0, 0.3, 1.0, 0.0, math.nan, 10.0, 13.37, 16.0, -0.5, 1.5]
    grids = (photometry._B_V_GRID, photometry._LATE_GRID)
    edges = [300.0, 500.0, 650.0, 1100.0]
    photometer.bin_weights([0.0], edges)  # makes the tables
    for tables, found in (
        ([table[:, None] for table in photometer._rate], photometer.electrons_per_s(0.0, b_v, giant)[:, None]),
        (photometer._bins[tuple(edges)], photometer.bin_weights(b_v, edges, giant)),
    ):
        expected = np.array([plain_lookup(tables, *star, grids) for star in zip(b_v, giant, strict=True)])
        if found.shape[1] > 1:
            expected /= expected.sum(axis=1, keepdims=True)
        np.testing.assert_allclose(found, expected, rtol=1e-12)
    # left out, the class is the population's; scalars and broadcasts go through the same tables
    np.testing.assert_array_equal(
        photometer.electrons_per_s(0.0, b_v), photometer.electrons_per_s(0.0, b_v, np.full(len(b_v), math.nan))
    )
    assert photometer.electrons_per_s(0.0, 0.65, 0.0) == photometer.electrons_per_s(0.0, b_v, giant)[3]
    assert photometer.electrons_per_s(0.0, 0.65, [0.0, 1.0]).shape == (2,)
