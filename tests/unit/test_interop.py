"""astropy's quantities, times and coordinates and SciPy's rotations in and out of the public classes."""

import subprocess
import sys
from datetime import UTC, datetime

import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import Angle, EarthLocation, SkyCoord, get_body_barycentric_posvel
from astropy.time import Time
from astropy.utils import iers
from scipy.spatial.transform import Rotation

from simulator.mission.clock import Clock
from startracker import Attitude, InputError, Observer
from startracker.errors import FrameMismatchError
from startracker.identification.observed import as_prior
from startracker.observer import observer_of

ROTATIONS = Rotation.random(20, rng=3)


@pytest.mark.parametrize("k", range(20))
def test_rotations_turn_vectors_as_attitudes_do(k):
    attitude = Attitude.from_rotation(ROTATIONS[k])
    np.testing.assert_allclose(attitude.as_matrix(), ROTATIONS[k].as_matrix(), atol=1e-15)
    vectors = np.random.default_rng(k).normal(size=(5, 3))
    np.testing.assert_allclose(attitude.apply(vectors), ROTATIONS[k].apply(vectors), atol=1e-14)
    np.testing.assert_allclose(attitude.rotation.as_matrix(), attitude.as_matrix(), atol=1e-15)
    assert (attitude.source, attitude.target) == ("icrs", "camera")


def test_chains_of_rotations_are_those_of_attitudes():
    one, other = (Attitude.from_rotation(ROTATIONS[k], "icrs", "icrs") for k in (0, 1))
    np.testing.assert_allclose((one @ other).as_matrix(), (ROTATIONS[0] * ROTATIONS[1]).as_matrix(), atol=1e-15)


def test_a_boresight_in_any_frame_of_astropy():
    galactic = SkyCoord(l=133.0 * u.deg, b=-31.0 * u.deg, frame="galactic")
    attitude = Attitude.from_skycoord(galactic, roll_deg=25.0 * u.deg)
    assert attitude.skycoord.separation(galactic).arcsec < 1e-8
    assert attitude.roll_deg == pytest.approx(25.0, abs=1e-10)
    assert (attitude.skycoord.ra.deg, attitude.skycoord.dec.deg) == (attitude.ra_deg, attitude.dec_deg)
    with pytest.raises(FrameMismatchError, match="ICRS"):
        _ = Attitude(np.array([0, 0, 0, 1.0]), "body", "camera").skycoord


def test_angles_in_any_unit():
    plain = Attitude.from_radec_roll(45.0, -30.0, 10.0)
    assert plain.angle_to(Attitude.from_radec_roll(Angle("3h"), (-np.pi / 6) * u.rad, 600 * u.arcmin)) < 1e-15
    vector = np.array([0.1, -0.2, 0.3])
    turned = Attitude.from_rotation_vector(np.degrees(vector) * u.deg, "body", "camera")
    assert turned.angle_to(Attitude.from_rotation_vector(vector, "body", "camera")) < 1e-15
    with pytest.raises(InputError, match=r"RA is in 'km'; it must be in deg"):
        Attitude.from_radec_roll(3 * u.km, 0.0)


def test_an_observer_with_units():
    time = Time("2026-03-21T12:00:00", scale="utc")
    observer = Observer(time, [30.0e3, -1.0e3, 5.0] * u.m / u.s, [1.5e8, 0.0, -2.0e7] * u.km)
    # TT − UTC = 69.184 s
    assert observer.epoch_jyear == pytest.approx(
        2000.0 + ((time.utc.jd - 2451545.0) + 69.184 / 86400) / 365.25, rel=1e-13
    )
    np.testing.assert_allclose(observer.velocity_km_s, [30.0, -1.0, 0.005])
    np.testing.assert_allclose(observer.position_au, np.array([1.5e8, 0.0, -2.0e7]) / 149_597_870.7)
    assert abs(observer.time - time) < 10 * u.ms  # a Julian year of 16 digits
    with pytest.raises(InputError, match=r"velocity_km_s is in 'km'; it must be in km/s"):
        Observer(velocity_km_s=[30.0, 0.0, 0.0] * u.km)
    with pytest.raises(InputError, match="years or an astropy Time"):
        Observer(epoch_jyear=Time(["2026-01-01", "2026-01-02"]))


@pytest.mark.parametrize("date", ["1998-03-05T20:00:00", "2025-03-21T12:00:00"])
@pytest.mark.parametrize(("longitude", "latitude"), [(18.9, -33.9), (-106.6, 52.1), (0.0, 90.0)])
def test_an_observer_on_the_ground_moves_as_astropy_has_it(date, longitude, latitude):
    time, location = (
        Time(date, scale="utc"),
        EarthLocation.from_geodetic(longitude * u.deg, latitude * u.deg, 120 * u.m),
    )
    observer = Observer.on_earth(time, location)
    with iers.conf.set_temp("auto_download", False):
        earth, earth_velocity = get_body_barycentric_posvel("earth", time, ephemeris="builtin")
        place, velocity = location.get_gcrs_posvel(time)
    np.testing.assert_allclose(
        observer.velocity_km_s, (earth_velocity + velocity).xyz.to_value("km/s"), rtol=0, atol=1e-4
    )
    np.testing.assert_allclose(observer.position_au, (earth + place).xyz.to_value("AU"), rtol=0, atol=1e-8)
    assert observer.epoch_jyear == pytest.approx(float(time.tt.jyear), rel=1e-15)


def test_an_observer_on_the_ground_needs_a_time_and_a_location():
    with pytest.raises(InputError, match=r"one astropy Time and one astropy EarthLocation"):
        Observer.on_earth(2026.0, EarthLocation.from_geodetic(0 * u.deg, 0 * u.deg))
    with pytest.raises(InputError, match=r"one astropy Time and one astropy EarthLocation"):
        Observer.on_earth(Time("2026-01-01"), (18.9, -33.9))


def test_a_time_makes_an_observer():
    time = Time(2026.5, format="jyear", scale="tt")
    assert observer_of(None, time).epoch_jyear == pytest.approx(2026.5, rel=1e-15)
    assert observer_of(None, 2026.5).velocity_km_s is None
    assert observer_of(None, None) is None
    observer = Observer()
    assert observer_of(observer, None) is observer
    with pytest.raises(InputError, match="both give the epoch"):
        observer_of(observer, time)


def test_a_prior_may_be_a_rotation():
    prior = as_prior(ROTATIONS[3], 30 * u.arcmin)
    np.testing.assert_allclose(prior.attitude.as_matrix(), ROTATIONS[3].as_matrix(), atol=1e-15)
    assert prior == as_prior(prior.attitude, 0.5) or prior.radius_rad == as_prior(prior.attitude, 0.5).radius_rad
    with pytest.raises(InputError, match="single scipy Rotation"):
        as_prior(ROTATIONS, 1.0)
    with pytest.raises(InputError, match="prior_deg is in 's'"):
        as_prior(ROTATIONS[0], 3 * u.s)


def test_seconds_of_dates_and_quantities():
    clock = Clock(datetime(2016, 12, 31, 23, 59, tzinfo=UTC))
    assert clock.elapsed_s(12.5) == 12.5
    assert clock.elapsed_s(2 * u.min) == pytest.approx(120.0, rel=1e-15)
    # a leap second ended 2016: the minute has 61 seconds
    assert clock.elapsed_s(Time("2017-01-01T00:00:00", scale="utc")) == pytest.approx(61.0, abs=1e-9)


def test_plain_numbers_import_no_astropy():
    code = (
        "import sys, numpy as np\n"
        "from startracker import Attitude, Observer, StarTracker\n"
        "Attitude.from_radec_roll(1.0, 2.0, 3.0); Observer(2026.0, np.ones(3), np.ones(3))\n"
        "print([name for name in ('astropy', 'scipy') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "astropy" not in done.stdout
