"""Diffuse sky against published figures and astropy.

Sources: Leinert et al. 1998 (A&AS 127, 1: table 16, 60 S10 at the pole, 1 S10 = 27.78 mag arcsec⁻²); the HST/STIS
Instrument Handbook, section 6.5, table 6.2 (V mag arcsec⁻² of the zodiacal light, printed to 0.1: tolerance 0.2, since
its spectrum is a little redder than the Sun's, and 0.1 once the mean difference is out); astropy's ecliptic and
galactic frames (0.1″: the frame bias and the poles' definitions differ by 0.02″); the catalogue itself, summed
star by star.
"""

import math

import numpy as np
import pytest
from astropy.coordinates import BarycentricMeanEcliptic, SkyCoord

from simulator.sky.background import (
    ECLIPTIC,
    GALACTIC,
    background_map,
    diffuse_sky_s10,
    sky_brightness_s10,
    starlight_s10,
    zodiacal_s10,
)
from simulator.sky.parameters import Sky
from startracker.catalog import load_catalog
from startracker.geometry.attitude import Attitude, radec_to_direction
from startracker.geometry.camera import Camera
from startracker.geometry.distortion import Distortion

SUN = radec_to_direction(math.radians(200.0), math.radians(-8.3))
SECTION = Sky(background_model="leinert1998")


def helioecliptic(longitude_deg, latitude_deg, sun=SUN):
    """ICRS direction at an ecliptic longitude from the Sun's and an ecliptic latitude."""
    at = ECLIPTIC @ sun
    longitude = math.atan2(at[1], at[0]) + np.radians(longitude_deg)
    return np.atleast_2d(radec_to_direction(longitude, np.radians(latitude_deg))) @ ECLIPTIC


def mag(s10):
    return 27.78 - 2.5 * np.log10(s10)


def sphere(n):
    k = np.arange(n) + 0.5
    z = 1.0 - 2.0 * k / n
    azimuth = k * math.pi * (3.0 - math.sqrt(5.0))
    return np.stack([np.sqrt(1 - z * z) * np.cos(azimuth), np.sqrt(1 - z * z) * np.sin(azimuth), z], axis=1)


def test_frames_are_astropys():
    directions = sphere(200)
    sky = SkyCoord(directions, representation_type="cartesian", frame="icrs")
    galactic = sky.galactic.cartesian.xyz.value.T
    assert np.abs(directions @ GALACTIC.T - galactic).max() < math.radians(0.1 / 3600.0)
    ecliptic = sky.transform_to(BarycentricMeanEcliptic(equinox="J2000")).cartesian.xyz.value.T
    assert np.abs(directions @ ECLIPTIC.T - ecliptic).max() < math.radians(0.1 / 3600.0)


@pytest.mark.parametrize(
    ("longitude", "latitude", "s10"),
    [
        (90, 0, 202),
        (-90, 0, 202),
        (180, 0, 180),
        (60, 45, 105),
        (30, -5, 1460),
        (15, 0, 9000),
        (0, 15, 2450),
        (120, 60, 60),
        (135, 75, 57),
        (-45, 25, 228),
        (75, 90, 60),
        (75, -90, 60),
    ],
)
def test_table_entries(longitude, latitude, s10):
    # at a node the bilinear form returns the entry; 1e-6: turning to ICRS and back
    assert zodiacal_s10(helioecliptic(longitude, latitude), SUN)[0] == pytest.approx(s10, rel=1e-6)


def test_zodiacal_light_as_the_hubble_handbook_has_it():
    latitudes = [0, 15, 30, 45, 60, 75, 90]
    ours = mag(zodiacal_s10(np.concatenate([helioecliptic(90, b) for b in latitudes]), SUN))
    handbook = np.array([21.9, 22.2, 22.6, 22.9, 23.1, 23.2, 23.2])
    assert np.abs(ours - handbook).max() < 0.2
    assert np.abs(ours - handbook - (ours - handbook).mean()).max() < 0.1
    assert mag(zodiacal_s10(helioecliptic(50, 0), SUN)[0]) == pytest.approx(20.9, abs=0.1)
    # "varies by only a factor of about three throughout most of the sky"
    whole = zodiacal_s10(sphere(4000), SUN)
    low, high = np.quantile(whole, [0.02, 0.75])
    assert 2.0 < high / low < 4.0


def test_zodiacal_light_rises_towards_the_sun_and_has_a_counterglow():
    along = zodiacal_s10(np.concatenate([helioecliptic(x, 0.0) for x in range(181)]), SUN)
    assert (np.diff(along[:136]) < 0).all()
    assert along[180] > along[140] * 1.2
    assert np.isfinite(along).all()


def test_starlight_shows_the_galaxy():
    centre = np.atleast_2d(GALACTIC[0])
    poles = np.stack([GALACTIC[2], -GALACTIC[2]])
    assert 500 < starlight_s10(centre, "hipparcos", 6.5)[0] < 1400
    # Leinert et al. 1998, section 10: 20 to 40 S10 at the poles with the bright stars out
    assert ((starlight_s10(poles, "hipparcos", 6.5) > 20) & (starlight_s10(poles, "hipparcos", 6.5) < 45)).all()
    magellanic = radec_to_direction(math.radians(80.0), math.radians(-70.0))
    beside = radec_to_direction(math.radians(80.0), math.radians(-55.0))
    cloud, sky = starlight_s10(np.stack([magellanic, beside]), "hipparcos", 6.5)
    assert cloud > 3 * sky


def test_drawn_stars_are_not_counted_twice():
    # what the diffuse light loses between two limits over the whole sky is the light of the catalogue's stars between
    # them; 5 %: nodes of the map are not spread evenly over the sky
    directions = sphere(20000)
    square_degrees = 4 * math.pi / math.radians(1) ** 2
    stars = load_catalog("hipparcos")
    for faint, bright in ((9.0, 6.5), (6.5, 4.0)):
        lost = (starlight_s10(directions, "hipparcos", bright) - starlight_s10(directions, "hipparcos", faint)).mean()
        between = stars.v_mag[(stars.v_mag > bright) & (stars.v_mag <= faint)]
        assert lost * square_degrees == pytest.approx((10 ** (-0.4 * (between - 10.0))).sum(), rel=0.05)


def test_sum_far_from_ecliptic_and_milky_way_is_near_the_usual_75():
    # "zodiacal light about 60 S10 far from the ecliptic, scattered starlight about 15": ours keeps the unresolved
    # stars as well
    directions = sphere(20000)
    quiet = directions[(np.abs(directions @ GALACTIC[2]) > 0.8) & (np.abs(directions @ ECLIPTIC[2]) > 0.7)]
    away = quiet[quiet @ SUN < 0.3]
    assert 75 < np.median(sky_brightness_s10(away, SUN, SECTION)) < 110


def test_constant_and_off():
    directions = sphere(10)
    assert (sky_brightness_s10(directions, SUN, Sky(background_s10=33.0)) == 33.0).all()
    assert (sky_brightness_s10(directions, SUN, Sky(background=False)) == 0.0).all()
    r_km = np.array([0.0, 0.0, -7178.0])
    assert diffuse_sky_s10(CAMERA, LOOKING, r_km, SUN, Sky()) == 75.0
    assert diffuse_sky_s10(CAMERA, LOOKING, r_km, SUN, Sky(background=False)) == 0.0


CAMERA = Camera(900.0, 1000.0, 160.0, 120.0, 331, 250, Distortion(k1=-0.05))
LOOKING = Attitude.from_radec_roll(283.0, 11.0, 40.0)


def test_map_is_the_sky_at_each_pixel():
    # the tables' own nodes are 4° and more apart: a grid of 32 pixels (2°) bends them by less than 3 %
    image = background_map(CAMERA, LOOKING, SUN, SECTION)
    assert image.shape == (250, 331)
    rng = np.random.default_rng(5)
    x, y = rng.integers(0, 331, 200), rng.integers(0, 250, 200)
    seen = LOOKING.inverse.apply(CAMERA.unproject(np.stack([x, y], axis=1)))
    assert np.allclose(image[y, x], sky_brightness_s10(seen, SUN, SECTION), rtol=0.03)
    exact = background_map(CAMERA, LOOKING, SUN, SECTION, grid_px=1)
    assert np.allclose(exact[y, x], sky_brightness_s10(seen, SUN, SECTION), rtol=1e-9)
