"""Catalogues that a user adds from files of every format."""

from __future__ import annotations

import gzip
import hashlib
import io

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from astropy.io import fits
from astropy.table import Table

from simulator.cli.application import run_application
from simulator.scenario import Scenario
from simulator.study.flight.design import flight_design
from startracker import load_catalog
from startracker.catalog import known_catalogs
from startracker.catalog.tables import read_columns
from startracker.catalog.user import FIRST_NUMBER, TableOptions, add_catalog, remove_catalog
from startracker.core import ARCSEC_RAD, MAS_RAD
from startracker.errors import InputError

STARS = {
    "source_id": np.array([10**18, 10**18 + 7, 10**18 + 3]),
    "RA": np.array([10.0, 123.456789012345, 350.0]),
    "Dec": np.array([-89.5, 12.25, 45.0]),
    "pmRA": np.array([12.5, np.nan, -100.0]),
    "pmDE": np.array([-3.0, np.nan, 50.0]),
    "Plx": np.array([5.0, -1.0, 20.0]),
    "Vmag": np.array([11.0, 9.5, 10.25]),
}
PLAIN = TableOptions(epoch_jyear=2016.0, sigma_mas=1.0, hipparcos=False)


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("BORESIGHT_CACHE", str(tmp_path / "cache"))


def csv_text(delimiter=","):
    rows = zip(*STARS.values(), strict=True)
    lines = [delimiter.join("" if np.isnan(value) else repr(value.item()) for value in row) for row in rows]
    return "\n".join(["# made by hand", delimiter.join(STARS), *lines]) + "\n"


def written(folder, suffix):
    """The same three stars in a file of each format."""
    path = folder / f"mine{suffix}"
    if suffix == ".parquet":
        pq.write_table(pa.table(STARS), path)
    elif suffix == ".fits":
        Table(STARS).write(path)
    elif suffix == ".csv.gz":
        path.write_bytes(gzip.compress(csv_text().encode()))
    else:
        path.write_text(csv_text({".csv": ",", ".tsv": "\t", ".txt": ";"}[suffix]))
    return path


@pytest.mark.parametrize("suffix", [".csv", ".tsv", ".txt", ".csv.gz", ".parquet", ".fits"])
def test_every_format_gives_the_same_stars(tmp_path, suffix):
    path = written(tmp_path, suffix)
    add_catalog("mine", [path], PLAIN)
    catalog = load_catalog("mine")
    assert catalog.id.tolist() == [10**18 + 7, 10**18 + 3, 10**18]  # brightest first
    assert catalog.v_mag.tolist() == [9.5, 10.25, 11.0]
    assert np.degrees(catalog.ra_rad).tolist() == pytest.approx([123.456789012345, 350.0, 10.0], abs=1e-13)
    assert np.degrees(catalog.dec_rad).tolist() == pytest.approx([12.25, 45.0, -89.5], abs=1e-13)
    assert (catalog.pm_ra_rad_yr / MAS_RAD).tolist() == pytest.approx([0.0, -100.0, 12.5])
    assert (catalog.parallax_rad / MAS_RAD).tolist() == pytest.approx([0.0, 20.0, 5.0])
    # 26 mas per year over 10.5 years for the star without proper motion, and the stated error for the others
    assert (catalog.star_sigma_rad / MAS_RAD).tolist() == pytest.approx([273.0, 1.0, 1.0], rel=1e-4)
    source = catalog.provenance
    assert (source.name, source.stars, source.epoch_jyear) == ("mine", 3, 2016.0)
    assert source.files[0].name == path.name
    assert source.files[0].sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert source.note.startswith("1 stars without proper motion")


def test_units_of_a_fits_table_are_converted(tmp_path):
    table = Table({"RA": [1.0], "Dec": [0.5], "pmRA": [0.1], "pmDE": [0.2], "Vmag": [9.0]})
    for name, unit in {"RA": "rad", "Dec": "rad", "pmRA": "arcsec / yr", "pmDE": "arcsec / yr"}.items():
        table[name].unit = unit
    table.write(tmp_path / "units.fits")
    names = {"ra": "RA", "dec": "Dec", "pm_ra": "pmRA", "pm_dec": "pmDE"}
    add_catalog("units", [tmp_path / "units.fits"], TableOptions(2016.0, names, hipparcos=False))
    catalog = load_catalog("units")
    assert (catalog.ra_rad[0], catalog.dec_rad[0]) == pytest.approx((1.0, 0.5))
    assert (catalog.pm_ra_rad_yr[0], catalog.pm_dec_rad_yr[0]) == pytest.approx((0.1 * ARCSEC_RAD, 0.2 * ARCSEC_RAD))
    table["RA"].unit = "m"
    table.write(tmp_path / "metres.fits")
    with pytest.raises(InputError, match=r"column RA is in m, not in deg"):
        add_catalog("metres", [tmp_path / "metres.fits"], TableOptions(2016.0, names, hipparcos=False))


@pytest.mark.parametrize(
    ("columns", "v_mag", "b_v"),
    [
        ({"V": 9.0, "B-V": 0.6}, 9.0, 0.6),
        # ESA 1997, eq. 1.3.20: V = VT − 0.090 (BT − VT), B − V = 0.850 (BT − VT)
        ({"VTmag": 9.0, "BTmag": 10.0}, 8.91, 0.85),
        ({"VTmag": 9.0}, 8.93, np.nan),
        # the Sun's colour
        ({"phot_g_mean_mag": 9.0, "phot_bp_mean_mag": 9.32, "phot_rp_mean_mag": 8.5}, 9.15, 0.653),
        ({"phot_g_mean_mag": 9.0}, 9.275, np.nan),
    ],
)
def test_v_and_colour_from_the_bands_that_there_are(tmp_path, columns, v_mag, b_v):
    pq.write_table(
        pa.table({"ra": [1.0], "dec": [2.0]} | {name: [value] for name, value in columns.items()}),
        tmp_path / "t.parquet",
    )
    add_catalog("bands", [tmp_path / "t.parquet"], PLAIN)
    catalog = load_catalog("bands")
    assert catalog.v_mag[0] == pytest.approx(v_mag, abs=0.01)
    assert catalog.b_v[0] == pytest.approx(b_v, abs=0.01, nan_ok=True)
    assert catalog.id.tolist() == [FIRST_NUMBER]


# ------------------------------------------------------------------ indices of astrometry.net
def star_index(vectors, v_t, order="<"):
    """A star index with what is read of it, in the layout of astrometry.net 0.75."""
    scale = (2.0**32 - 1.0) / 2.0
    stored = np.rint((vectors + 1.0) * scale).astype(f"{order}u4")
    bounds = np.array([-1.0] * 3 + [1.0] * 3 + [scale], dtype=f"{order}f8")

    def raw(name, array):
        width = array.dtype.itemsize * (array.shape[1] if array.ndim > 1 else 1)
        column = np.frombuffer(array.tobytes(), dtype=[(name, f"V{width}")])
        unit = fits.BinTableHDU.from_columns([fits.Column(name, f"{width}A", array=np.full(len(column), "x" * width))])
        unit.data = None
        return unit.header, column.tobytes()

    primary = fits.PrimaryHDU()
    primary.header["ENDIAN"] = "04:03:02:01" if order == "<" else "01:02:03:04"
    data = io.BytesIO()
    primary.writeto(data)
    for name, array in (
        ("kdtree_range_stars", bounds),
        ("kdtree_data_stars", stored),
        ("MAG_VT", np.asarray(v_t, dtype=">f4")),
    ):
        header, content = raw(name, array)
        header["NAXIS2"] = len(array)
        if name == "MAG_VT":
            header["TFORM1"] = "1E"
        data.write(header.tostring().encode() + content + b"\0" * (-len(content) % 2880))
    return data.getvalue()


@pytest.mark.parametrize("order", ["<", ">"])
def test_star_indices_of_astrometry_net(tmp_path, order):
    rng = np.random.default_rng(4)
    vectors = rng.normal(size=(20, 3))
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    v_t = np.linspace(8.0, 12.0, 20)
    (tmp_path / "a.fits").write_bytes(star_index(vectors[:15], v_t[:15], order))
    (tmp_path / "b.fits").write_bytes(star_index(vectors[10:], v_t[10:], order))
    options = TableOptions(sigma_mas=60.0, hipparcos=False)
    add_catalog("tycho", [tmp_path / "a.fits", tmp_path / "b.fits"], options)
    catalog = load_catalog("tycho")
    assert catalog.epoch_jyear == 2000.0  # mean positions of Tycho-2
    assert len(catalog) == 20  # those of both files once
    assert len(np.unique(catalog.id)) == 20
    np.testing.assert_allclose(catalog.v_mag, v_t - 0.07, atol=1e-6)
    # 32 bits: 2.3e-10 on each axis
    np.testing.assert_allclose(catalog.directions(2000.0), vectors, atol=5e-10)
    (tmp_path / "short.fits").write_bytes(star_index(vectors, v_t, order)[:-5000])
    with pytest.raises(InputError, match=r"short\.fits: is (truncated|not a table that can be read)"):
        read_columns(tmp_path / "short.fits")


def test_positions_of_other_numbers_than_unit_vectors_are_refused(tmp_path):
    (tmp_path / "flat.fits").write_bytes(star_index(np.full((4, 3), 0.1), np.full(4, 9.0)))
    with pytest.raises(InputError, match="does not hold unit vectors"):
        read_columns(tmp_path / "flat.fits")


# ------------------------------------------------------------------ merged with Hipparcos
def test_the_stars_of_hipparcos_appear_once(tmp_path):
    """Three of Hipparcos' stars with Gaia's positions, and one that it lacks."""
    hipparcos = load_catalog("hipparcos").at_epoch(2016.0)
    rows = [int(np.flatnonzero(hipparcos.id == number)[0]) for number in (11767, 32349, 70890)]
    ra, dec = (np.degrees(column[rows]) for column in (hipparcos.ra_rad, hipparcos.dec_rad))
    table = pa.table({"ra": [*ra, 200.0], "dec": [*dec, -30.0], "v": [*hipparcos.v_mag[rows], 12.0]})
    pq.write_table(table, tmp_path / "four.parquet")
    add_catalog("four", [tmp_path / "four.parquet"], TableOptions(2016.0, sigma_mas=1.0))
    catalog = load_catalog("four")
    assert len(catalog) == len(hipparcos) + 1
    added = catalog.select(catalog.id >= FIRST_NUMBER)
    assert added.v_mag.tolist() == [12.0]
    assert [file.name.rpartition(" ")[2] for file in catalog.provenance.files] == [
        "four.parquet",
        "hip2.dat",
        "bsc5.dat",
    ]
    # positions of 0.1″ improve no star of Hipparcos
    add_catalog("rough", [tmp_path / "four.parquet"], TableOptions(2016.0, sigma_mas=100.0))
    order = np.argsort(load_catalog("rough").id)
    np.testing.assert_array_equal(load_catalog("rough").ra_rad[order][:-1], hipparcos.ra_rad[np.argsort(hipparcos.id)])


def test_a_flight_build_refuses_numbers_that_its_tables_do_not_hold(tmp_path):
    bright = load_catalog("hipparcos").brighter_than(6.5)
    table = {"id": bright.id + 10**12, "ra": np.degrees(bright.ra_rad), "dec": np.degrees(bright.dec_rad)}
    pq.write_table(pa.table(table | {"v": bright.v_mag}), tmp_path / "numbers.parquet")
    add_catalog("numbers", [tmp_path / "numbers.parquet"], PLAIN)
    with pytest.raises(InputError, match=r"the catalogue numbers has star numbers of more than 32 bits"):
        flight_design(Scenario.load("cubesat", ["tracker.catalog=numbers", "sky.faint_magnitude_limit=null"]))


# ------------------------------------------------------------------ names, and mistakes
def test_a_catalogue_can_be_replaced_and_removed(tmp_path):
    path = written(tmp_path, ".csv")
    add_catalog("mine", [path], PLAIN)
    assert len(load_catalog("mine")) == 3
    assert "mine" in known_catalogs()
    add_catalog("mine", [path], TableOptions(2016.0, hipparcos=False, magnitude_limit=10.0))
    assert len(load_catalog("mine")) == 1
    scenario = Scenario.load("cubesat", ["sky.catalog=mine", "tracker.catalog=mine"])
    assert scenario.sky.catalog == "mine"
    remove_catalog("mine")
    with pytest.raises(InputError, match="'mine' is not one of the catalogs"):
        load_catalog("mine")
    with pytest.raises(InputError, match=r"'mine' is not one of the catalogues that were added \(none\)"):
        remove_catalog("mine")


def test_a_damaged_catalogue_says_what_to_do(tmp_path):
    add_catalog("mine", [written(tmp_path, ".csv")], PLAIN)
    (tmp_path / "cache" / "catalogs" / "mine.npz").write_bytes(b"junk")
    with pytest.raises(
        InputError, match=r"the catalogue 'mine' is damaged; remove it \(boresight catalog remove mine\)"
    ):
        load_catalog("mine")


@pytest.mark.parametrize(
    ("text", "options", "says"),
    [
        ("ra,dec,V\n1,2,9\n", TableOptions(hipparcos=False), "give the epoch of its positions"),
        ("ra,de,V\n1,2,9\n", PLAIN, "which column is dec"),
        ("ra,dec,W\n1,2,9\n", PLAIN, "which column is the magnitude"),
        ("ra,dec,V\n1,2,bright\n", PLAIN, "column V does not hold numbers"),
        ("ra,dec,V\n1,95,9\n", PLAIN, "must be in degrees"),
        ("ra,dec,V\n1,2,\n", PLAIN, "no star with a position and a magnitude"),
        ("ra,dec,V\n1,2,3,4\n", PLAIN, "is not a table that can be read"),
        ("", PLAIN, "is not a table that can be read"),
        ("ra,dec,V\n1,2,9\n", TableOptions(2016.0, {"v": "Vmag"}), "has no column 'Vmag'; it has ra, dec, V"),
        ("ra,dec,V\n1,2,9\n", TableOptions(2016.0, {"w": "V"}), "'w' is not a quantity of a catalogue"),
    ],
)
def test_what_cannot_be_read_is_one_clear_line(tmp_path, text, options, says):
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(InputError) as raised:
        add_catalog("mine", [tmp_path / "t.csv"], options)
    assert says in str(raised.value)
    assert "\n" not in str(raised.value)


def test_files_that_are_no_tables(tmp_path):
    fits.PrimaryHDU(np.zeros((4, 4))).writeto(tmp_path / "image.fits")
    (tmp_path / "junk.parquet").write_bytes(b"PAR1 junk")
    (tmp_path / "stars.xyz").write_text("1 2 3")
    for name, says in {
        "image.fits": "has no table",
        "junk.parquet": "is not a table that can be read",
        "stars.xyz": "the suffix says no known format",
        "gone.csv": "cannot be read",
    }.items():
        with pytest.raises(InputError, match=says) as raised:
            read_columns(tmp_path / name)
        assert "\n" not in str(raised.value)


@pytest.mark.parametrize("name", ["hipparcos", "Mine", "../mine", "", "9lives"])
def test_names_that_cannot_be_used(tmp_path, name):
    with pytest.raises(InputError, match="the name of a catalogue has letters a to z"):
        add_catalog(name, [written(tmp_path, ".csv")], PLAIN, ("bsc5", "hipparcos"))


def test_a_folder_that_cannot_be_written(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("BORESIGHT_CACHE", str(tmp_path / "file"))
    with pytest.raises(InputError, match="cannot be written"):
        add_catalog("mine", [written(tmp_path, ".csv")], PLAIN)


def test_the_commands(tmp_path, capsys):
    path = written(tmp_path, ".csv")
    assert run_application(["catalog", "list"]) == 0
    assert "added: none" in capsys.readouterr().out
    given = ["--columns", "v = Vmag, id=source_id", "--epoch", "2016", "--sigma-mas", "1", "--no-hipparcos"]
    assert run_application(["catalog", "add", str(path), *given]) == 0
    added = capsys.readouterr().out
    assert added.startswith("catalogue mine: 3 stars, epoch J2016, most at V = ")
    assert run_application(["catalog", "list"]) == 0
    listed = capsys.readouterr().out
    assert "built in: bsc5, gaia, hipparcos" in listed
    assert added.strip() in listed
    assert run_application(["catalog", "add", str(path), "--columns", "v"]) == 2
    assert "--columns: write QUANTITY=COLUMN" in capsys.readouterr().err
    assert run_application(["catalog", "remove", "mine"]) == 0
    assert run_application(["catalog", "remove", "mine"]) == 2
    assert "is not one of the catalogues that were added" in capsys.readouterr().err
