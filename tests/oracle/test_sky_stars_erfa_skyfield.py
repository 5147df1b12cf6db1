"""Apparent directions of stars against ERFA, astropy and Skyfield.

1,000 stars (Barnard's, 61 Cygni, α Centauri and Kapteyn's among them) at 20 epochs from 1995 to 2035, seen from a low
orbit. Three paths that share no code with ours: ERFA's own astrometry (``pmpx``, ``ldsun``, ``ab``; pyerfa 2.0.1.5),
astropy's ICRS → GCRS with an observer's position and velocity (astropy 8.0, DE421), Skyfield's ``observe`` and
``apparent`` (1.55, DE421). Tolerances stand beside each test.
"""

from datetime import UTC, datetime, timedelta
from importlib.resources import files

import erfa
import numpy as np
import pytest

from simulator.mission.clock import Clock
from simulator.sky.apparent import apparent_directions, bend_by_sun
from simulator.sky.ephemeris import observe
from simulator.sky.instants import solar_system, sun_position_au
from simulator.sky.parameters import Sky
from startracker.catalog import load_catalog
from startracker.core import ARCSEC_RAD, AU_KM, MAS_RAD
from startracker.observer import aberrate

NEAR_AND_FAST = [87937, 104214, 104217, 71683, 71681, 24186]
EPOCHS = [datetime(1995, 1, 11, 7, tzinfo=UTC) + timedelta(days=768.7 * k) for k in range(20)]
DE421 = str(files("skyfield_data") / "data" / "de421.bsp")


@pytest.fixture(scope="module")
def stars():
    catalog = load_catalog("hipparcos")
    rng = np.random.default_rng(20260321)
    rows = np.flatnonzero(np.isin(catalog.id, NEAR_AND_FAST))
    more = rng.choice(np.flatnonzero(catalog.v_mag < 9.0), 1000 - len(rows), replace=False)
    chosen = catalog.select(np.unique(np.concatenate([rows, more])))
    assert set(NEAR_AND_FAST) <= set(chosen.id.tolist())
    # radial velocities as measured, so that the perspective term is not zero where it matters
    velocity = chosen.radial_velocity_km_s.copy()
    velocity[chosen.id == 87937] = -110.6
    velocity[chosen.id == 24186] = 245.2
    columns = {column: getattr(chosen, column) for column in type(chosen).columns()}
    return type(chosen)(chosen.name, chosen.epoch_jyear, **(columns | {"radial_velocity_km_s": velocity}))


def spacecraft(k):
    """Some state in a circular orbit of 7178 km."""
    angle, tilt = 0.9 * k, 0.3 * k
    out = np.array([np.cos(angle), np.sin(angle) * np.cos(tilt), np.sin(angle) * np.sin(tilt)])
    along = np.array([-np.sin(angle), np.cos(angle) * np.cos(tilt), np.cos(angle) * np.sin(tilt)])
    return 7178.0 * out, 7.452 * along


def angles(one, other):
    return 2 * np.arcsin(np.linalg.norm(one - other, axis=-1) / 2)


@pytest.mark.parametrize("k", range(20))
def test_erfa(stars, k):
    clock = Clock(EPOCHS[k])
    observer = observe(clock, 0.0, *spacecraft(k))
    sun = sun_position_au(clock, 0.0)
    ours = apparent_directions(stars, observer, sun, Sky())

    years = observer.epoch_jyear - stars.epoch_jyear
    theirs = erfa.pmpx(
        stars.ra_rad,
        stars.dec_rad,
        stars.pm_ra_rad_yr / np.cos(stars.dec_rad),
        stars.pm_dec_rad_yr,
        stars.parallax_rad / ARCSEC_RAD,
        stars.radial_velocity_km_s,
        years,
        observer.position_au,
    )
    from_sun = observer.position_au - sun
    distance = np.linalg.norm(from_sun)
    theirs = erfa.ldsun(theirs, from_sun / distance, distance)
    beta = observer.velocity_km_s / 299792.458
    theirs = erfa.ab(theirs, beta, distance, np.sqrt(1 - beta @ beta))
    # 1 µas: eraAb adds the Sun's potential, 0.4 µas at 1 au, which ours leaves out
    assert np.max(angles(ours, theirs)) < 1e-3 * MAS_RAD


@pytest.mark.parametrize("k", range(0, 20, 4))
def test_astropy(stars, k):
    from astropy import units as u
    from astropy.coordinates import GCRS, ICRS, CartesianRepresentation, SkyCoord, solar_system_ephemeris
    from astropy.time import Time

    clock = Clock(EPOCHS[k])
    r_km, v_km_s = spacecraft(k)
    observer = observe(clock, 0.0, r_km, v_km_s)
    ours = apparent_directions(stars, observer, sun_position_au(clock, 0.0), Sky())
    # the place at the epoch from the barycentre, a matter of catalogues (Rømer delay included); parallax as distance
    years = observer.epoch_jyear - stars.epoch_jyear + (stars.directions(1991.25) @ observer.position_au) * 1.58e-5
    way, motion = stars.space_motion()
    way = way + years[:, None] * motion
    distance = np.where(stars.parallax_rad > 0, ARCSEC_RAD / np.maximum(stars.parallax_rad, 1e-15), 1e9)
    at_epoch = way * distance[:, None] * u.pc
    with solar_system_ephemeris.set(DE421):
        frame = GCRS(
            obstime=Time(*clock.tt_jd(0.0), format="jd", scale="tt"),
            obsgeoloc=CartesianRepresentation(r_km * u.km),
            obsgeovel=CartesianRepresentation(v_km_s * u.km / u.s),
        )
        gcrs = SkyCoord(ICRS(CartesianRepresentation(at_epoch.T))).transform_to(frame)
    theirs = gcrs.represent_as("unitspherical").to_cartesian().xyz.value.T
    # 0.01 mas: 0.4 µas as for ERFA, the Earth's velocity that astropy has from the ephemeris by another TDB, and
    # 1e-8 AU rounding; astropy bends light by the Sun alone, as ours
    assert np.max(angles(ours, theirs)) < 0.01 * MAS_RAD


@pytest.mark.parametrize("k", range(20))
def test_skyfield(stars, k):
    from skyfield.api import Star, load
    from skyfield.jpllib import SpiceKernel
    from skyfield.vectorlib import VectorFunction

    r_km, v_km_s = spacecraft(k)

    class Craft(VectorFunction):
        center, target, center_name, target_name = 399, -900, "earth", "craft"

        def _at(self, t):
            velocity = v_km_s * 86400 / AU_KM
            return r_km / AU_KM, velocity, r_km / AU_KM, None

    clock = Clock(EPOCHS[k])
    observer = observe(clock, 0.0, r_km, v_km_s)
    ours = apparent_directions(stars, observer, sun_position_au(clock, 0.0), Sky())
    t = load.timescale(builtin=True).tt_jd(*clock.tt_jd(0.0))
    # Skyfield, like NOVAS, divides the motion by 1 − v/c, true motion a unit of emission time, but steps it by the time
    # of observation; catalogues give it by the time of observation (ESA SP-1200, eq. 1.2.10; ERFA's pmpx and starpm
    # agree). For Kapteyn's star that is 7 mas a year; multiplied out here.
    doppler = 1.0 - stars.radial_velocity_km_s / 299792.458
    star = Star(
        ra_hours=np.degrees(stars.ra_rad) / 15,
        dec_degrees=np.degrees(stars.dec_rad),
        ra_mas_per_year=stars.pm_ra_rad_yr / MAS_RAD * doppler,
        dec_mas_per_year=stars.pm_dec_rad_yr / MAS_RAD * doppler,
        parallax_mas=stars.parallax_rad / MAS_RAD,
        radial_km_per_s=stars.radial_velocity_km_s,
        epoch=2451545.0 + (1991.25 - 2000.0) * 365.25,
    )
    kernel = SpiceKernel(DE421)
    try:
        place = (kernel["earth"] + Craft()).at(t).observe(star).apparent()
    finally:
        kernel.close()
    theirs = place.xyz.au.T / np.linalg.norm(place.xyz.au.T, axis=1, keepdims=True)
    # Skyfield bends light by Jupiter and Saturn as well (above 0.5 mas within 12′ and 4′ of them: no such stars are
    # compared) and by the Earth (0.6 mas at its limb, 0.3 mas at right angles to its centre for this height).
    clear = np.ones(len(stars), dtype=bool)
    bodies = solar_system(clock, 0.0, observer, Sky())
    for name in ("Jupiter", "Saturn"):
        clear &= angles(ours, bodies.direction[bodies.name == name][0]) > np.radians(0.25)
    assert clear.sum() > 990
    assert np.max(angles(ours, theirs)[clear]) < 1.0 * MAS_RAD
    # what is left is the Earth's bending: away from the Earth it is gone
    away = clear & (ours @ r_km / 7178.0 > 0.9)
    assert np.max(angles(ours, theirs)[away]) < 0.1 * MAS_RAD


def test_space_motion_against_erfas_rigorous_one(stars):
    # starpm follows the light's way at both ends (Stumpff 1985); straight motion, as Hipparcos defines it, must agree
    # over t = 44 years to 0.5 mas: at distance d the light time's second order is ½ v² t² / (c d), 2e-5 years or
    # 0.2 mas for Kapteyn's star (160 km/s across, 3.9 pc), and starpm's special-relativistic terms are as large
    near = stars.select(np.flatnonzero(np.isin(stars.id, NEAR_AND_FAST)))
    day1, day2 = 2400000.5, 48348.5625
    ra, dec, *_ = erfa.pmsafe(
        near.ra_rad,
        near.dec_rad,
        near.pm_ra_rad_yr / np.cos(near.dec_rad),
        near.pm_dec_rad_yr,
        near.parallax_rad / ARCSEC_RAD,
        near.radial_velocity_km_s,
        day1,
        day2,
        day1,
        day2 + 44 * 365.25,
    )
    theirs = np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=1)
    assert np.max(angles(near.directions(1991.25 + 44), theirs)) < 0.5 * MAS_RAD


def test_barnards_star_moves_as_published():
    # van Leeuwen 2007: 10.36″ a year at 1991.25; 1.28 mas a year more each year (perspective, −110.5 km/s), 24 years
    # later in the middle of 1995 to 2035
    catalog = load_catalog("hipparcos")
    barnard = catalog.select(np.flatnonzero(catalog.id == 87937))
    moved = angles(barnard.directions(2035.0), barnard.directions(1995.0))[0] / ARCSEC_RAD
    assert moved == pytest.approx(40 * (np.hypot(0.79858, 10.32812) + 23.75 * 0.00128), abs=0.02)


def test_aberration_against_erfa():
    rng = np.random.default_rng(5)
    directions = rng.normal(size=(500, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for speed in (8.0, 30.0, 38.0, 3000.0):
        velocity = rng.normal(size=3)
        velocity *= speed / np.linalg.norm(velocity)
        beta = velocity / 299792.458
        # a Sun 1e9 au away takes eraAb's gravitational term with it
        theirs = erfa.ab(directions, beta, 1e9, np.sqrt(1 - beta @ beta))
        np.testing.assert_allclose(aberrate(directions, velocity), theirs, atol=5e-15)


def test_size_of_each_effect():
    # textbook sizes: aberration 20.5″ (annual) and up to 5.1″ (orbit, 7.45 km/s), deflection 1.75″ at the limb and
    # 4.07 mas at a right angle (Explanatory Supplement, 3rd ed., section 7.2)
    clock = Clock(datetime(2026, 3, 21, 12, tzinfo=UTC))
    observer = observe(clock, 0.0, [7178.0, 0.0, 0.0], [0.0, 7.452, 0.0])
    speed = np.linalg.norm(observer.velocity_km_s)
    across = np.cross(observer.velocity_km_s, [0.0, 0.0, 1.0])
    across = (across / np.linalg.norm(across))[None]
    shift = angles(aberrate(across, observer.velocity_km_s), across)[0] / ARCSEC_RAD
    assert shift == pytest.approx(speed / 299792.458 / ARCSEC_RAD, abs=1e-3)
    assert np.degrees(np.arcsin(7.452 / 299792.458)) * 3600 == pytest.approx(5.13, abs=0.01)
    from_sun = np.array([1.0, 0.0, 0.0])
    limb = 695_700.0 / AU_KM
    for angle, expected_mas in [(np.pi / 2, 4.07), (limb, 1750.0), (np.pi, 0.0)]:
        u = np.array([[-np.cos(angle), np.sin(angle), 0.0]])
        bent = bend_by_sun(u, from_sun)
        assert angles(bent, u)[0] / MAS_RAD == pytest.approx(expected_mas, rel=3e-3, abs=1e-6)
        # away from the Sun
        assert bent[0] @ [-1.0, 0.0, 0.0] <= u[0] @ [-1.0, 0.0, 0.0]
