"""Parts of the sky against geometry, published constants and plain sums: cells of faint stars, gaps of the map of
starlight, poles of planets, the hash of catalogue errors, counts of stars."""

import math

import numpy as np
import pytest

from simulator.sky import background, catalogue_errors, faint_stars, instants
from simulator.sky.apparent import largest_shift_rad
from simulator.sky.celestial_frames import GALACTIC
from simulator.sky.colours import population_giant_share, spectral_coordinates
from simulator.sky.extinction import extinction_over_av, relative_extinction
from simulator.sky.instants import RADIUS_KM
from simulator.sky.magnitudes import SATURN_POLE, URANUS_AXES_SQUARED, URANUS_POLE, moon_v, sun_v
from simulator.sky.parameters import SatelliteParameters, Sky
from simulator.sky.satellites import behind_earth, standard_magnitude, sunlit_share
from simulator.sky.star_counts import count_between, draw_magnitudes, light_between_s10
from startracker.geometry.attitude import direction_to_radec, radec_to_direction
from startracker.observer import Observer

SQUARE_DEGREES = 4.0 * math.pi * math.degrees(1.0) ** 2
EARTH_KM, SUN_KM = 6378.137, 1.495978707e8


# ---------------------------------------------------------------- faint stars
def test_cells_of_the_sky_are_about_four_degrees_wide_and_cover_it_once():
    cells = faint_stars._cells()
    west, east, south, north = cells.T
    assert faint_stars._square_degrees(cells).sum() == pytest.approx(SQUARE_DEGREES, rel=1e-12)
    bands = np.unique(south)
    assert np.degrees(np.arcsin(bands)) == pytest.approx(np.arange(-90.0, 90.0, 4.0), abs=1e-6)
    for low in bands:
        rows = south == low
        assert len(np.unique(north[rows])) == 1
        assert (west[rows][0], east[rows][-1]) == (0.0, pytest.approx(2.0 * math.pi))
        assert np.array_equal(west[rows][1:], east[rows][:-1])
        widest = math.sqrt(1.0 - min(abs(low), abs(north[rows][0])) ** 2)
        across_deg = np.degrees(east[rows] - west[rows]) * widest
        # three cells at the poles are 8.4° wide in their widest part, six in the next bands 4.2 %
        assert across_deg == pytest.approx(np.full(rows.sum(), 4.0), rel=0.05 if rows.sum() > 6 else 1.2)


def test_stars_near_a_direction_are_all_those_of_the_cells_within_the_radius():
    """Also over a pole and over the meridian; every cell of the sky is searched by hand."""
    sky = faint_stars.FaintSky(3, 9.0, 11.0)
    whole = np.concatenate([sky.cell(number) for number in range(len(sky._edges))])
    assert len(whole) == pytest.approx(sky._mean_count.sum(), abs=5.0 * math.sqrt(sky._mean_count.sum()))
    for ra_deg, dec_deg in ((0.1, 2.0), (120.0, 89.0), (300.0, -87.0)):
        centre = radec_to_direction(math.radians(ra_deg), math.radians(dec_deg))
        found = sky.near(centre, math.radians(5.0), 0.0)
        expected = whole[whole[:, :3] @ centre >= math.cos(math.radians(5.0))]
        assert len(found.v_mag) == len(expected) > 30
        assert {tuple(row) for row in found.direction} == {tuple(row[:3]) for row in expected}
        assert (found.v_mag.min() > 9.0, found.v_mag.max() <= 11.0) == (True, True)
    assert len(sky.near(centre, math.radians(5.0)).v_mag) >= len(found.v_mag)


def test_counts_and_light_of_stars_between_two_magnitudes():
    """Of the table 1,744 stars are brighter than V = 5 and 5,326 than 6; between them the logarithm is straight, and
    the light of a count N ∝ 10^(kV) is an integral in closed form."""
    assert count_between(5.0, 6.0) * SQUARE_DEGREES == pytest.approx(5326 - 1744, rel=1e-12)
    middle = 1744.0 * (5326.0 / 1744.0) ** 0.5
    assert count_between(5.0, 5.5) * SQUARE_DEGREES == pytest.approx(middle - 1744.0, rel=1e-12)
    slope = math.log(5326.0 / 1744.0)
    rate = slope - 0.4 * math.log(10.0)
    light = 1744.0 * slope * 10.0 ** (-0.4 * (5.0 - 10.0)) * math.expm1(rate) / rate
    assert light_between_s10(5.0, 6.0) * SQUARE_DEGREES == pytest.approx(light, rel=1e-4)  # steps of 0.02 mag
    drawn = draw_magnitudes(np.array([0.0, 0.5, 1.0]), 5.0, 6.0)
    half = math.log(0.5 * (1744.0 + 5326.0) / 1744.0) / slope
    assert drawn == pytest.approx([5.0, 5.0 + half, 6.0], abs=1e-12)


# ---------------------------------------------------------------- background
def test_a_map_is_closed_at_both_poles_and_at_the_meridian():
    ra, dec = np.array([0.0, 120.0, 240.0]), np.array([-60.0, 0.0, 60.0])
    table = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 9.0], [7.0, 8.0, 15.0]])
    longitudes, latitudes, closed = background._closed(ra, dec, table)
    assert longitudes.tolist() == [0.0, 120.0, 240.0, 360.0]
    assert latitudes.tolist() == [-90.0, -60.0, 0.0, 60.0, 90.0]
    assert closed[:, 0].tolist() == [4.0] * 4
    assert closed[:, -1].tolist() == [9.0] * 4
    assert np.array_equal(closed[:3, 1:-1], table)
    assert np.array_equal(closed[3], closed[0])


def test_gaps_of_the_starlight_are_filled_from_nodes_near_them_in_the_galaxy():
    """A weighted mean, Gaussian of 4° in |b| and 20° in the distance from the anticentre, of the nodes that were
    measured; those themselves are as published."""
    ra, dec, published = background._read("background_starlight.csv")
    filled = background._pioneer()[2]
    missing = np.isnan(published)
    assert missing.any()
    assert np.array_equal(filled[~missing], published[~missing])
    places = {}
    for i, j in np.ndindex(published.shape):
        direction = radec_to_direction(math.radians(ra[i]), math.radians(dec[j]))
        longitude, latitude = np.degrees(direction_to_radec(GALACTIC @ direction))
        places[i, j] = abs(float(longitude) - 180.0), abs(float(latitude))
    for i, j in np.argwhere(missing)[::7]:
        total = weights = 0.0
        for (k, m), (longitude, latitude) in places.items():
            if not missing[k, m]:
                weight = math.exp(
                    -0.5 * ((latitude - places[i, j][1]) / 4.0) ** 2 - 0.5 * ((longitude - places[i, j][0]) / 20.0) ** 2
                )
                total, weights = total + weight * published[k, m], weights + weight
        assert filled[i, j] == pytest.approx(total / weights, rel=1e-9)


def test_bilinear_interpolation_is_exact_for_products_of_lines():
    x, y = np.array([0.0, 10.0, 40.0]), np.array([-5.0, 0.0, 20.0])
    table = (2.0 + 3.0 * x)[:, None] * (1.0 - 0.5 * y)
    at_x, at_y = np.array([0.0, 3.0, 10.0, 25.0, 40.0]), np.array([-5.0, -1.0, 0.0, 7.0, 20.0])
    found = background._bilinear(x, y, table, at_x, at_y)
    assert found == pytest.approx((2.0 + 3.0 * at_x) * (1.0 - 0.5 * at_y), rel=1e-12)


# ---------------------------------------------------------------- bodies
def test_poles_and_figures_of_planets_are_those_of_the_iau():
    """Archinal et al. 2018: right ascension and declination of the poles, radii of Uranus in km."""
    for pole, ra_deg, dec_deg in ((SATURN_POLE, 40.589, 83.537), (URANUS_POLE, 257.311, -15.175)):
        assert pole == pytest.approx(radec_to_direction(math.radians(ra_deg), math.radians(dec_deg)), abs=2e-8)
    assert pytest.approx((24973.0 / 25559.0) ** 2, rel=1e-12) == URANUS_AXES_SQUARED


def test_the_sun_and_the_moon_fade_with_the_square_of_the_distance():
    assert sun_v([1.0, 10.0]) == pytest.approx([-26.74, -21.74])
    mean_au = 384_400.0 / 149_597_870.7
    assert moon_v(1.0, mean_au, 60.0) == pytest.approx(-12.73 + 0.026 * 60.0 + 4e-9 * 60.0**4, abs=1e-9)
    assert moon_v(1.0, 2.0 * mean_au, 0.0) - moon_v(1.0, mean_au, 0.0) == pytest.approx(5.0 * math.log10(2.0))
    assert moon_v(2.0, mean_au, 0.0) - moon_v(1.0, mean_au, 0.0) == pytest.approx(5.0 * math.log10(2.0))


def test_extinction_in_the_infrared_follows_its_power_law_and_ends_in_the_ultraviolet():
    """Cardelli, Clayton & Mathis 1989, eq. 2: a = 0.574 x^1.61, b = −0.527 x^1.61 below 1.1 µm⁻¹; at 303 nm the
    optical polynomials end."""
    x = np.array([0.5, 0.8, 1.05])
    assert extinction_over_av(1000.0 / x) == pytest.approx((0.574 - 0.527 / 3.1) * x**1.61, rel=1e-12)
    assert extinction_over_av(np.array([150.0, 250.0])) == pytest.approx(extinction_over_av(np.array([1000 / 3.3] * 2)))
    assert relative_extinction(np.array([1000.0 / 1.82]))[0] == pytest.approx(0.0, abs=1e-12)


# ---------------------------------------------------------------- satellites
def test_a_satellite_behind_the_earth_is_hidden_and_one_before_it_is_not():
    camera = np.array([EARTH_KM + 800.0, 0.0, 0.0])
    objects = {
        (-EARTH_KM - 800.0, 0.0, 0.0): True,  # on the other side
        (EARTH_KM + 400.0, 0.0, 0.0): False,  # below the camera
        (EARTH_KM + 5000.0, 0.0, 0.0): False,  # above it
        (0.0, 0.0, EARTH_KM + 30_000.0): False,  # beyond the horizon, in view
        (-20_000.0, EARTH_KM, 0.0): True,  # the line passes at 0.26 radii
        (-10_000.0, 40_000.0, 0.0): False,  # at 1.03 radii
    }
    found = behind_earth(np.array(list(objects)), camera)
    assert found.tolist() == list(objects.values())


def test_sunlight_behind_the_earth_fades_through_the_penumbra():
    """At 7,000 km behind the Earth the Sun's disk of 0.2666° touches the limb where the angle between their centres is
    the sum or the difference of the radii; the shares on both sides of half are symmetric to the curvature."""
    sun = np.array([SUN_KM, 0.0, 0.0])
    distance = 7000.0
    earth_rad, sun_rad = math.asin(EARTH_KM / distance), math.asin(695_700.0 / (SUN_KM + distance))

    def share(angle_rad):
        # the Sun at `angle_rad` from the Earth's centre as seen from the satellite; its distance makes it parallel
        place = distance * np.array([-math.cos(angle_rad), math.sin(angle_rad), 0.0])
        return float(sunlit_share(place[None], sun)[0])

    assert share(0.0) == share(earth_rad - 1.05 * sun_rad) == 0.0
    assert share(earth_rad + 1.05 * sun_rad) == share(2.0) == share(math.pi) == 1.0
    assert share(earth_rad) == pytest.approx(0.5, abs=0.02)
    for part in (-0.6, 0.6):
        # area of a disk beyond a straight line at `part` radii from its centre
        beyond = (math.acos(part) - part * math.sqrt(1.0 - part * part)) / math.pi
        assert share(earth_rad - part * sun_rad) == pytest.approx(beyond, abs=0.02)


@pytest.mark.parametrize("centre", ["Moon", "Mars"])
def test_the_shadow_of_a_centre_is_the_cylinder_behind_it(centre):
    """Where the ray to the Sun's centre passes within the radius, and only on the far side."""
    radius, sun = RADIUS_KM[centre], np.array([0.6, 0.0, 0.8])
    across = np.array([0.0, 1.0, 0.0])
    places = [
        (-3.0 * sun + 0.99 * across, True),
        (-3.0 * sun + 1.01 * across, False),
        (3.0 * sun + 0.5 * across, False),
        (-1.001 * sun, True),
        (-3.0 * sun - 0.99 * np.cross(sun, across), True),
        (-3.0 * sun - 1.01 * np.cross(sun, across), False),
        (1.5 * across, False),
    ]
    r_km = radius * np.array([place for place, _ in places])
    to_sun_km = 1e8 * np.tile(sun, (len(places), 1))
    assert instants._in_shadow(centre, r_km, to_sun_km).tolist() == [dark for _, dark in places]
    for other in ("Earth", "Sun", "Solar system barycentre"):  # by another rule, or none
        assert not instants._in_shadow(other, r_km, to_sun_km).any()


def test_the_standard_magnitude_of_a_diffuse_sphere():
    """2/3 A (a/d)² /π of the Sun's light at 90°; none without an albedo."""
    share = 2.0 / 3.0 * 0.2 * (0.5 / 1e6) ** 2 / math.pi
    assert standard_magnitude(1.0, 0.2) == pytest.approx(-26.74 - 2.5 * math.log10(share), abs=1e-9)
    assert standard_magnitude(2.0, 0.2) - standard_magnitude(1.0, 0.2) == pytest.approx(-5.0 * math.log10(2.0))
    assert standard_magnitude(1.0, 0.0) == standard_magnitude(0.0, 0.2) == math.inf


def test_the_largest_shift_of_a_star_contains_that_of_every_direction():
    """Aberration v/c, parallax of the nearest star and deflection at the Sun's limb; at least 30″ near the Earth, also
    where velocity or place are not known."""
    arcsec = math.radians(1.0 / 3600.0)
    nothing = Observer(2026.0, None, None)
    assert largest_shift_rad(nothing) == pytest.approx(30.0 * arcsec)
    assert largest_shift_rad(Observer(2026.0, np.array([0.0, 30.0, 0.0]), None)) == pytest.approx(30.0 * arcsec)
    fast = largest_shift_rad(Observer(2026.0, np.array([60.0, 0.0, 80.0]), None))
    assert 100.0 / 299_792.458 + 1.75 * arcsec < fast < 1.02 * (100.0 / 299_792.458 + 1.75 * arcsec)
    far = largest_shift_rad(Observer(2026.0, None, np.array([60.0, 80.0, 0.0])))
    assert 100.0 * 0.768 * arcsec + 1.75 * arcsec < far < 1.03 * (100.0 * 0.768 * arcsec + 1.75 * arcsec)
    both = largest_shift_rad(Observer(2026.0, np.array([0.0, 0.0, 100.0]), np.array([0.0, 100.0, 0.0])))
    assert both == pytest.approx(fast + far - 1.76 * arcsec, rel=1e-6)  # the deflection counts once


# ---------------------------------------------------------------- catalogue errors, defaults
def test_the_hash_is_splitmix64():
    """Its published outputs for the seed 1234567 (Vigna, xoshiro.di.unimi.it; Rosetta Code)."""
    with np.errstate(over="ignore"):
        states = np.uint64(1234567) + np.arange(1, 6, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    expected = [
        6457827717110365317,
        3203168211198807973,
        9817491932198370423,
        4593380528125082431,
        16408922859458223821,
    ]
    assert catalogue_errors._mixed(states).tolist() == expected


def test_deviates_of_stars_are_independent_normal_ones():
    """Four for each star: 40,000 stars, means and correlations within 5/√N, variances within 5 √(2/N)."""
    found = catalogue_errors._normal(np.arange(1, 40_001), np.uint64(77))
    assert found.shape == (4, 40_000)
    assert np.abs(found.mean(axis=1)).max() < 5.0 / 200.0
    assert np.abs(np.cov(found) - np.eye(4)).max() < 5.0 * math.sqrt(2.0 / 40_000)
    assert not np.array_equal(found, catalogue_errors._normal(np.arange(1, 40_001), np.uint64(78)))


def test_a_sky_by_default_is_complete_and_has_no_satellites():
    sky = Sky()
    assert (sky.proper_motion, sky.parallax, sky.light_deflection, sky.aberration) == (True,) * 4
    assert (sky.planets, sky.background, sky.earth, sky.phases) == (True,) * 4
    assert (sky.catalog, sky.magnitude_limit, sky.faint_magnitude_limit) == ("hipparcos", 9.0, None)
    assert (sky.background_s10, sky.background_model, sky.earth_albedo) == (75.0, "constant", 0.3)
    given = SatelliteParameters()
    assert (given.file, given.diameter_m, given.albedo, given.max_age_days) == (None, 1.0, 0.175, 30.0)


@pytest.mark.parametrize(
    ("text", "giant"),
    [
        ("K0III", 1.0), ("K0V", 0.0), ("sdK0", 0.0), ("G5Ib", 1.0), ("M2III", 12.0), ("M2", 12.0), ("M2V", 0.0),
        ("M", 1.0), ("M9III", 16.0), ("C5", 1.0), ("S4", 1.0), ("gM4", 14.0),
    ],
)  # fmt: skip
def test_a_class_of_luminosity_chooses_the_spectrum(text, giant):
    """1 for giants, 0 for dwarfs, 10 + subtype for M giants up to M6; types M, C and S without a class are giants, as
    dwarfs of these types are too faint for a catalogue."""
    b_v, found = spectral_coordinates(np.array([1.5]), np.array([text]))
    assert (b_v[0], found[0]) == (1.5, giant)


def test_without_a_class_the_share_is_that_of_the_colour_and_without_a_colour_it_is_that_of_the_type():
    """B−V of a G5 dwarf 0.68 (Pickles 1998: G5V), of a K5 giant 1.5; half a subtype between two is between them."""
    b_v, share = spectral_coordinates(
        np.array([0.95, np.nan, np.nan, np.nan, np.nan]), np.array(["K0", "G5V", "K5III", "", "WC"])
    )
    assert share[0] == population_giant_share(np.array([0.95]))[0] == pytest.approx(0.96)
    assert b_v[1:3] == pytest.approx([0.68, 1.5], abs=0.05)
    assert np.isnan(b_v[3:]).all()
    assert (share[1], share[2], share[3]) == (0.0, 1.0, 0.0)
