import numpy as np
import pytest

from startracker.catalog import StarCatalog, load_catalog, merge_doubles
from startracker.core import ARCSEC_RAD
from startracker.errors import InputError


def brute_force(catalog, separation_rad):
    """Groups as sets of rows, by plain flooding over all pairs of angles."""
    u = catalog.directions(catalog.epoch_jyear)
    cross = np.linalg.norm(np.cross(u[:, None], u[None]), axis=2)
    near = np.arctan2(cross, u @ u.T) <= separation_rad
    left, groups = set(range(len(u))), []
    while left:
        group, edge = set(), {left.pop()}
        while edge:
            group |= edge
            edge = set(np.flatnonzero(near[list(edge)].any(axis=0)).tolist()) - group
        groups.append(sorted(group))
        left -= group
    return sorted(groups)


def field_of_stars(rng, n, width_rad):
    return StarCatalog(
        name="random",
        epoch_jyear=2000.0,
        id=np.arange(100, 100 + n),
        # across RA 0, close to the pole on one side
        ra_rad=rng.uniform(-width_rad, width_rad, n) % (2 * np.pi),
        dec_rad=rng.uniform(-width_rad, width_rad, n),
        pm_ra_rad_yr=rng.normal(0, 1e-6, n),
        pm_dec_rad_yr=rng.normal(0, 1e-6, n),
        parallax_rad=rng.uniform(0, 1e-7, n),
        radial_velocity_km_s=rng.normal(0, 30, n),
        v_mag=rng.uniform(0, 7, n),
        b_v=rng.normal(0.6, 0.4, n),
        spectral_type=np.array([f"T{k}" for k in range(n)]),
        star_name=np.array([f"N{k}" for k in range(n)]),
        variable=np.arange(n) % 4 == 0,
    )


@pytest.mark.parametrize("separation_deg", [0.05, 0.3, 1.0])
def test_groups_and_their_means_against_brute_force(separation_deg):
    catalog = field_of_stars(np.random.default_rng(3), 250, 0.1)
    separation = np.radians(separation_deg)
    merged = merge_doubles(catalog, separation)
    groups = brute_force(catalog, separation)
    assert max(len(group) for group in groups) > (1 if separation_deg < 0.1 else 2)
    assert len(merged) == len(groups)
    flux = 10 ** (-0.4 * catalog.v_mag)
    u = catalog.directions(2000.0)
    rows = {int(number): k for k, number in enumerate(merged.id)}
    for group in groups:
        head = group[int(np.argmax(flux[group]))]
        k = rows[int(catalog.id[head])]
        weights = flux[group] / flux[group].sum()
        centre = weights @ u[group]
        assert merged.v_mag[k] == pytest.approx(-2.5 * np.log10(flux[group].sum()), abs=1e-12)
        np.testing.assert_allclose(merged.directions(2000.0)[k], centre / np.linalg.norm(centre), atol=1e-14)
        assert merged.pm_dec_rad_yr[k] == pytest.approx(weights @ catalog.pm_dec_rad_yr[group], abs=1e-18)
        assert merged.parallax_rad[k] == pytest.approx(weights @ catalog.parallax_rad[group], abs=1e-18)
        assert (merged.star_name[k], merged.spectral_type[k]) == (catalog.star_name[head], catalog.spectral_type[head])
        assert merged.b_v[k] == catalog.b_v[head]
        assert merged.variable[k] == any(catalog.variable[group])
    # single stars stay as they are, and the order is the catalogue's
    assert np.all(np.diff(merged.id) > 0)


def test_chains_are_merged_into_one():
    catalog = field_of_stars(np.random.default_rng(1), 4, 0.1)
    columns = {column: getattr(catalog, column) for column in StarCatalog.columns()}
    columns |= {"ra_rad": np.array([0.0, 8.0, 16.0, 60.0]) * ARCSEC_RAD, "dec_rad": np.zeros(4)}
    columns["v_mag"] = np.array([3.0, 5.0, 2.0, 4.0])
    merged = merge_doubles(StarCatalog("chain", 2000.0, **columns), 10 * ARCSEC_RAD)
    assert merged.id.tolist() == [102, 103]


def test_nothing_to_merge_gives_the_catalogue_back():
    catalog = load_catalog("bsc5")
    assert merge_doubles(catalog.select(np.arange(0)), 0.01).id.size == 0
    assert merge_doubles(catalog.select(np.array([0, 1])), 1e-6).id.tolist() == catalog.id[:2].tolist()


def test_the_bright_star_catalogue_has_162_pairs_closer_than_the_thesis_limit():
    # README of the catalogue: 162 pairs closer than 0.039°, 75 closer than 10″, 14 at the same place
    catalog = load_catalog("bsc5")
    from scipy.spatial import cKDTree

    tree = cKDTree(catalog.directions(2000.0))
    pairs = [len(tree.query_pairs(2 * np.sin(np.radians(s) / 2))) for s in (0.039, 10 / 3600, 1e-9)]
    assert pairs == [162, 75, 14]
    merged = [len(catalog) - len(merge_doubles(catalog, np.radians(s))) for s in (0.039, 10 / 3600, 1e-9)]
    # three stars all near each other are three pairs but lose two
    assert 150 < merged[0] <= 162
    assert 70 < merged[1] <= 75
    assert 12 <= merged[2] <= 14


def test_light_is_conserved():
    catalog = load_catalog("hipparcos")
    merged = merge_doubles(catalog, np.radians(0.04))
    assert np.sum(10 ** (-0.4 * merged.v_mag)) == pytest.approx(np.sum(10 ** (-0.4 * catalog.v_mag)), rel=1e-12)


@pytest.mark.parametrize("separation", [-1e-9, 0.2, np.nan, np.inf])
def test_a_separation_that_cannot_be(separation):
    with pytest.raises(InputError, match="separation of doubles"):
        merge_doubles(load_catalog("bsc5"), separation)
