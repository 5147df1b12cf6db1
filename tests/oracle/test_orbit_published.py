"""Orbit against published figures, against DE421's Sun, and against Skyfield's precession and SGP4.

Sources: the project's reference figures for the 800 km orbit (a = 7178 km: i = 98.6025°, Keplerian period 100.87 min,
nodal rate 0.98565° a day, nadir rate 0.0595°/s); Meeus 1998, *Astronomical Algorithms*, eq. 25.2; Skyfield 1.55 with
DE421 and its own precession-nutation and TEME frame; python-sgp4 2.27. Each tolerance is derived where it stands.
"""

import math
from datetime import UTC, datetime
from importlib.resources import files

import numpy as np
import pytest
from sgp4.api import WGS84, Satrec
from sgp4.exporter import export_tle
from skyfield.api import EarthSatellite, load, load_file

from simulator.constants import EARTH_J2, EARTH_RADIUS_KM
from simulator.mission.clock import Clock
from simulator.mission.frames import ground_track_deg, itrs_km, raan_of_local_time, to_frame, true_of_date
from simulator.mission.orbit import _satellite, build_orbit
from simulator.mission.parameters import OrbitParameters
from simulator.mission.secular import mean_motion

EPOCH = datetime(2026, 3, 21, 12, tzinfo=UTC)
DAY_S = 86_400.0
YEAR_S = 365.2422 * DAY_S
THESIS_ALTITUDE_KM = 7178.0 - EARTH_RADIUS_KM  # the figures take 6378 km for the Earth's radius
EARTH_J3 = -2.532_656e-6  # EGM96, unnormalised; Vallado 2013, table D-5

TIMESCALE = load.timescale(builtin=True)


@pytest.fixture(scope="module")
def ephemeris():
    kernel = load_file(str(files("skyfield_data") / "data" / "de421.bsp"))
    yield kernel
    kernel.close()


def sky_times(clock, t_s):
    jd1, jd2 = clock.tt_jd(np.asarray(t_s, dtype=float))
    return TIMESCALE.tt_jd(jd1, jd2)


# ---------------------------------------------------------------- figures, to the digits printed
def test_reference_figures_of_the_800_km_orbit():
    orbit = build_orbit(OrbitParameters(altitude_km=THESIS_ALTITUDE_KM), EPOCH)
    keplerian = mean_motion(7178.0)
    assert math.degrees(orbit.inclination_rad) == pytest.approx(98.6025, abs=0.5e-4)
    assert 2 * math.pi / keplerian / 60 == pytest.approx(100.87, abs=0.5e-2)
    assert math.degrees(orbit.nodal_rate_rad_s) * DAY_S == pytest.approx(0.98565, abs=0.5e-5)
    assert math.degrees(keplerian) == pytest.approx(0.0595, abs=0.5e-4)
    # The nodal period is longer by (3/4) J2 (R/a)² (8 sin² i − 6) = 0.117 % at i = 98.6°: 100.99 min
    assert orbit.period_s / 60 == pytest.approx(100.99, abs=0.5e-2)


def test_altitude_is_above_the_equatorial_radius():
    # d(cos i)/cos i = 7/2 da/a: the 137 m between 7178 and 7178.137 km raise the inclination by 0.00058°
    orbit = build_orbit(OrbitParameters(altitude_km=800.0), EPOCH)
    assert math.degrees(orbit.inclination_rad) == pytest.approx(98.6025 + 0.00058, abs=0.7e-4)


@pytest.mark.parametrize(
    ("altitude_km", "inclination_deg"),
    # Landsat 7 Science Data Users Handbook: 705 km, 98.2°; NOAA KLM User's Guide: 870 km, 98.9° (nominal; the mean
    # altitude counts from the ellipsoid, some km from ours, 0.04° in 10 km)
    [(705.0, 98.2), (870.0, 98.9)],
)
def test_inclination_of_flown_sun_synchronous_orbits(altitude_km, inclination_deg):
    orbit = build_orbit(OrbitParameters(altitude_km=altitude_km), EPOCH)
    assert math.degrees(orbit.inclination_rad) == pytest.approx(inclination_deg, abs=0.1)  # printed to 0.1°


# ---------------------------------------------------------------- the mean Sun
def test_node_of_local_noon_is_the_mean_sun():
    # Meeus' mean longitude of the Sun: referred to the mean equinox (up to 17.6″ off the true one in right ascension)
    # and without aberration (20.5″), which the mean Sun of time-keeping has. 40″ altogether, 2.7 s of time.
    for year in (1990, 2026, 2050):
        clock = Clock(datetime(year, 8, 1, 5, tzinfo=UTC))
        centuries = (clock.jyear(0.0) - 2000.0) / 100.0
        mean_longitude = 280.46646 + 36000.76983 * centuries + 0.0003032 * centuries**2
        difference = (math.degrees(raan_of_local_time(clock, 12.0)) - mean_longitude + 180.0) % 360.0 - 180.0
        assert abs(difference) * 3600 < 40.0


def test_local_time_against_skyfields_sidereal_time():
    # local mean solar time = UT1 + (Ω − GAST)/15; |UT1 − UTC| < 0.9 s moves the mean Sun by 0.04″, sidereal times 1 mas
    for ltan_h in (0.0, 6.0, 13.25, 22.5):
        orbit = build_orbit(OrbitParameters(ltan_h=ltan_h), EPOCH)
        t = sky_times(orbit.clock, 0.0)
        ut1_h = (t.ut1 - 0.5) % 1.0 * 24.0
        local_h = (ut1_h + math.degrees(orbit.raan_rad(0.0)) / 15.0 - t.gast) % 24.0
        # t.ut1 in one float is good to 40 µs of time
        assert abs((local_h - ltan_h + 12) % 24 - 12) * 3600 < 0.04 / 15 + 1e-4


def test_sun_synchronism_over_two_years_against_de421(ephemeris):
    # Apparent local time of the node less the mean one is the equation of time. Its harmonics (amplitudes 7.7 and
    # 9.9 min) vanish in the mean over a year; what stays is the nutation of the true equinox, against which node and
    # Sun are both counted but of which the mean Sun knows nothing (≤ 17.6″ = 1.2 s at the epoch, and as much in the
    # year's mean): 2.4 s. From one year to the next the mean moves by no more than the nutation's change, 1.2 s.
    orbit = build_orbit(OrbitParameters(), EPOCH)
    earth, sun = ephemeris["earth"], ephemeris["sun"]
    means = []
    for year in range(2):
        t_s = (year + (np.arange(366) + 0.5) / 366) * YEAR_S
        ra, _, _ = earth.at(sky_times(orbit.clock, t_s)).observe(sun).apparent().radec(epoch="date")
        local = (12.0 + np.degrees(orbit.raan_rad(t_s)) / 15.0 - ra.hours) % 24.0
        assert 14.2 < np.ptp(local) * 30 < 16.4  # the equation of time itself: −14.2 to +16.4 min
        means.append(local.mean() * 3600)
    assert abs(means[0] - 22.5 * 3600) < 2.4
    assert abs(means[1] - means[0]) < 1.2


# ---------------------------------------------------------------- frames and the circle
def test_true_of_date_against_skyfield():
    # Two implementations of IAU 2006/2000A; Skyfield truncates nothing but adds 2000A's terms to P03 precession without
    # ERFA's small adjustment of the nutation (J2 rate, 10 µas) and with its own frame bias: 1 mas = 4.85e-9 rad
    clock = Clock(EPOCH)
    t_s = np.linspace(-20, 20, 9) * YEAR_S
    expected = np.moveaxis(sky_times(clock, t_s).M, -1, 0)
    assert np.abs(true_of_date(clock, t_s) - expected).max() < 4.85e-9


def test_state_is_a_circle_about_the_true_pole():
    orbit = build_orbit(OrbitParameters(), EPOCH)
    t_s = np.linspace(0, YEAR_S, 97)
    r, v = orbit.state(t_s)
    matrix = true_of_date(orbit.clock, t_s)
    # exact up to rounding: 1e-16 of 3e4 rad of accumulated angle, 7178 km
    np.testing.assert_allclose(np.linalg.norm(r, axis=1), 7178.137, rtol=1e-13)
    np.testing.assert_allclose(np.sum(r * v, axis=1), 0.0, atol=1e-9)
    normal = np.einsum("nij,nj->ni", matrix, np.cross(r, v))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    np.testing.assert_allclose(normal[:, 2], math.cos(orbit.inclination_rad), atol=1e-13)
    node = np.arctan2(normal[:, 0], -normal[:, 1])
    np.testing.assert_allclose(np.exp(1j * node), np.exp(1j * orbit.raan_rad(t_s)), atol=1e-12)


def test_velocity_is_the_derivative_of_position():
    # central difference over ±1 s: a n³ h² / 6 = 1.3e-6 km/s; across the orbit Ω̇ sin i a = 1.41e-3 km/s is left out
    orbit = build_orbit(OrbitParameters(), EPOCH)
    t_s = np.linspace(0, orbit.period_s, 40)
    r, v = orbit.state(t_s)
    difference = (orbit.state(t_s + 1)[0] - orbit.state(t_s - 1)[0]) / 2 - v
    normal = np.cross(r, v) / np.linalg.norm(np.cross(r, v), axis=1, keepdims=True)
    across = np.sum(difference * normal, axis=1)
    in_plane = difference - across[:, None] * normal
    assert np.linalg.norm(in_plane, axis=1).max() < 1.5e-6
    left_out = orbit.nodal_rate_rad_s * math.sin(orbit.inclination_rad) * 7178.137
    assert np.abs(across).max() == pytest.approx(left_out, rel=5e-3)  # 40 points: cos(2π/80) = 0.997


@pytest.mark.parametrize("propagator", ["j2", "sgp4"])
def test_period_is_from_node_to_node(propagator):
    orbit = build_orbit(OrbitParameters(propagator=propagator), EPOCH)
    # Back to the equator going north: the short-period terms are the same at each node. Interpolating z linearly over
    # 0.5 s bends by a n² h²/8 = 0.2 m; SGP4's long-period terms stand still with e = 0. 1 ms a turn is 0.4 km in all.
    times = np.array([0.0, 50 * orbit.period_s])
    crossings = []
    for start in times:
        t_s = start + np.linspace(-60, 60, 241)
        r, _ = orbit.state(t_s)
        z = np.einsum("nij,nj->ni", true_of_date(orbit.clock, t_s), r)[:, 2]
        crossings.append(np.interp(0.0, z, t_s))
    assert (crossings[1] - crossings[0]) / 50 == pytest.approx(orbit.period_s, abs=1e-3)


def test_ground_track_against_skyfield_and_astropy():
    from astropy import units as u
    from astropy.coordinates import GCRS, ITRS, CartesianRepresentation
    from astropy.time import Time
    from astropy.utils import iers
    from skyfield.api import wgs84
    from skyfield.positionlib import Geocentric

    orbit = build_orbit(OrbitParameters(inclination_deg=63.4), EPOCH)
    t_s = np.linspace(0.0, DAY_S, 50)
    r_km, _ = orbit.state(t_s)
    latitude, longitude = ground_track_deg(orbit.clock, t_s, r_km)
    point = wgs84.subpoint_of(Geocentric(r_km.T / 149_597_870.7, t=sky_times(orbit.clock, t_s)))
    with iers.conf.set_temp("auto_download", False), iers.conf.set_temp("iers_degraded_accuracy", "ignore"):
        time = Time(*orbit.clock.tt_jd(t_s), format="jd", scale="tt")
        place = GCRS(CartesianRepresentation(r_km.T * u.km), obstime=time).transform_to(ITRS(obstime=time))
    there = place.earth_location.to_geodetic("WGS84")
    # Skyfield's ITRS has the same table of UT1 and no polar motion either: 1 mas. Astropy's has IERS bulletin A, whose
    # UT1 may differ by 10 ms from the forecast of the table (0.15″), and the pole, within 0.6″ of ours
    pole = 0.6 * math.tan(math.radians(63.6))
    for theirs, slack in (
        ((point.latitude.degrees, point.longitude.degrees), (0.001, 0.003)),
        ((there.lat.deg, there.lon.wrap_at("180d").deg), (0.6, 0.2 + pole)),
    ):
        np.testing.assert_allclose(latitude, theirs[0], rtol=0, atol=slack[0] / 3600)
        off = (longitude - theirs[1] + 180.0) % 360.0 - 180.0
        assert np.abs(off).max() < slack[1] / 3600
    in_itrf = (to_frame("itrf", orbit.clock, t_s) @ r_km[..., None])[..., 0]
    np.testing.assert_array_equal(itrs_km(orbit.clock, t_s, r_km), in_itrf)


# ---------------------------------------------------------------- SGP4
def test_sgp4_through_skyfield_from_a_written_tle():
    """A TLE's digits round node, inclination and anomaly to 0.5e-4° (6.3 m each at 7178 km; the first two and the third
    are square to each other or sum along the orbit by cos i: 10 m), the mean motion to 0.5e-8 a day (0.2 m in a day).
    Precession-nutation differs by under 1 mas (3.5 cm)."""
    section = OrbitParameters(
        inclination_deg=98.6, raan_deg=157.5, argument_of_latitude_deg=40.0, propagator="sgp4", altitude_km=800
    )
    orbit = build_orbit(section, EPOCH)
    satellite = Satrec()
    t0 = sky_times(orbit.clock, 0.0)
    node = math.radians(157.5 - (t0.gast - t0.gmst) * 15.0)  # from the true to SGP4's mean equinox, by Skyfield
    kozai = _satellite(orbit.elements, orbit.clock).no_kozai
    epoch_days = (EPOCH - datetime(1949, 12, 31, tzinfo=UTC)).total_seconds() / DAY_S
    elements = (0.0, 0.0, 0.0, 0.0, 0.0, math.radians(98.6), math.radians(40.0), kozai, node)
    satellite.sgp4init(WGS84, "i", 1, epoch_days, *elements)
    lines = export_tle(satellite)
    by_skyfield = EarthSatellite.from_satrec(Satrec.twoline2rv(*lines, WGS84), TIMESCALE)
    t_s = np.linspace(0.0, DAY_S, 60)
    state = by_skyfield.at(sky_times(orbit.clock, t_s))
    r, v = orbit.state(t_s)
    assert np.linalg.norm(r - state.position.km.T, axis=1).max() < 0.010
    assert np.linalg.norm(v - state.velocity.km_per_s.T, axis=1).max() < 0.010 * 1.1e-3 * 1.5


@pytest.mark.parametrize("inclination_deg", ["auto", 51.6, 28.5])
def test_sgp4_recovers_brouwers_semi_major_axis(inclination_deg):
    orbit = build_orbit(OrbitParameters(propagator="sgp4", inclination_deg=inclination_deg), EPOCH)
    semi_major = _satellite(orbit.elements, orbit.clock).am * EARTH_RADIUS_KM
    # SGP4's own WGS 84 has μ = 398600.5: at the same mean motion its axis is longer by (0.0582/398600)/3 = 4.9e-8
    assert semi_major == pytest.approx(7178.137 * (1 + 4.87e-8), rel=2e-9)


@pytest.mark.parametrize("section", [{}, {"inclination_deg": 51.6, "altitude_km": 420.0}, {"altitude_km": 1400.0}])
def test_j2_and_sgp4_differ_by_the_terms_that_j2_leaves_out(section):
    """First-order amplitudes for e = 0 (Hoots & Roehrich 1980, section 6; Kozai 1959), with g = J2 (R/a)²:

    radius    a g (3/4 |3 cos² i − 1| + 1/4 sin² i) + a e₃,   e₃ = |J3| R sin i / (2 J2 a), forced by J3
    along     a (2 e₃ + g (|7 cos² i − 1| / 8 + 3/4 cos² i))
    across    a g · 3/4 |cos i| sin i

    and secularly, in a day, second order in J2 and J4 (1.4 J2²): 3 g² n t along, and 2 g² n t across.
    """
    j2, sgp4 = (build_orbit(OrbitParameters(**section, propagator=name), EPOCH) for name in ("j2", "sgp4"))
    t_s = np.linspace(0.0, DAY_S, 500)
    (r, v), (other, _) = j2.state(t_s), sgp4.state(t_s)
    radial = r / np.linalg.norm(r, axis=1, keepdims=True)
    along = v / np.linalg.norm(v, axis=1, keepdims=True)
    a = j2.elements.semi_major_axis_km
    g = EARTH_J2 * (EARTH_RADIUS_KM / a) ** 2
    cos_i, sin_i = math.cos(j2.inclination_rad), math.sin(j2.inclination_rad)
    forced = abs(EARTH_J3) * EARTH_RADIUS_KM * sin_i / (2 * EARTH_J2 * a)
    drift = g**2 * mean_motion(a) * DAY_S
    bounds = a * np.array(
        [
            g * (0.75 * abs(3 * cos_i**2 - 1) + 0.25 * sin_i**2) + forced,
            2 * forced + g * (abs(7 * cos_i**2 - 1) / 8 + 0.75 * cos_i**2) + 3 * drift,
            0.75 * g * abs(cos_i) * sin_i + 2 * drift,
        ]
    )
    difference = np.stack(
        [np.sum((other - r) * axis, axis=1) for axis in (radial, along, np.cross(radial, along))], axis=1
    )
    worst = np.abs(difference).max(axis=0)
    # 1 %: products of first-order terms, and displacements of 15 km taken as straight (15²/2/7000 = 0.02 km)
    assert np.all(worst < 1.01 * bounds + 0.02)
    assert np.all(worst > 0.3 * bounds)  # and the terms are really there
