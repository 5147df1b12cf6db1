"""Tables of stars in files: CSV, Parquet, FITS, and star indices of astrometry.net."""

from __future__ import annotations

import csv
import gzip
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from startracker.core import FloatArray
from startracker.errors import InputError
from startracker.files import MEGABYTE, check_file
from startracker.geometry.attitude import direction_to_radec

TABLE_BYTES = 4_000 * MEGABYTE
"""Largest table of stars: some 30 million."""
_HINT = "give a table of stars as CSV, Parquet or FITS"
_UNITS = {"ra": "deg", "dec": "deg", "pm_ra": "mas/yr", "pm_dec": "mas/yr", "parallax": "mas"}
_MISSING = ["", "null", "NULL", "NaN", "nan", "--"]
_DELIMITERS = ",;\t|"

Columns = dict[str, NDArray[Any]]


def read_columns(path: Path, names: Mapping[str, str] | None = None) -> Columns:
    """Columns of a table by name.

    Parameters
    ----------
    path : Path
        ``.csv``, ``.tsv`` or ``.txt`` (also ``.gz``) with a line of names, ``.parquet``, or ``.fits``.
    names : mapping, optional
        Column of each quantity (``ra``, ``dec``, ``pm_ra`` …); of a FITS table these are converted to degrees and
        milliarcseconds (per year) if it states units.

    Raises
    ------
    InputError
        If the file cannot be read or is not such a table.
    """
    check_file(path, TABLE_BYTES, _HINT)
    suffixes = [suffix.lower() for suffix in path.suffixes]
    kind = suffixes[-2] if suffixes[-1:] == [".gz"] and len(suffixes) > 1 else "".join(suffixes[-1:])
    try:
        if kind in (".csv", ".tsv", ".txt", ".dat"):
            return _csv(path)
        if kind in (".parquet", ".pq"):
            return _parquet(path)
        if kind in (".fits", ".fit", ".fts"):
            return _fits(path, names or {})
    except InputError:
        raise
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}); {_HINT}") from error
    except Exception as error:  # libraries raise their own kinds for damaged files
        raise InputError(f"{path}: is not a table that can be read ({_first_line(error)}); {_HINT}") from error
    raise InputError(f"{path}: the suffix says no known format; {_HINT}")


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0][:160]


def _csv(path: Path) -> Columns:
    """Columns of a CSV file; lines before the names that begin with # are left out, and so is the one of units of
    VizieR's tables."""
    import pyarrow.csv as pa_csv

    skipped, header = 0, ""
    opener = gzip.open if path.suffix.lower() == ".gz" else open
    with opener(path, "rt", encoding="utf-8", newline="") as lines:
        for header in lines:
            if header.strip() and not header.startswith("#"):
                break
            skipped += 1
    delimiter = max(_DELIMITERS, key=header.count)
    names = [name.strip() for name in next(csv.reader([header.strip()], delimiter=delimiter))]
    table = pa_csv.read_csv(
        path,
        read_options=pa_csv.ReadOptions(skip_rows=skipped + 1, column_names=names),
        parse_options=pa_csv.ParseOptions(delimiter=delimiter),
        convert_options=pa_csv.ConvertOptions(null_values=_MISSING, strings_can_be_null=True),
    )
    return _of_arrow(table)


def _parquet(path: Path) -> Columns:
    import pyarrow.parquet as pq

    return _of_arrow(pq.read_table(path))


def _of_arrow(table: Any) -> Columns:
    import pyarrow as pa

    columns: Columns = {}
    for name, column in zip(table.column_names, table.columns, strict=True):
        if pa.types.is_null(column.type):
            columns[name] = np.full(len(column), np.nan)
        elif pa.types.is_integer(column.type) and not column.null_count:
            columns[name] = np.asarray(column.to_numpy())
        elif pa.types.is_integer(column.type) or pa.types.is_floating(column.type):
            columns[name] = np.asarray(column.cast(pa.float64(), safe=False).fill_null(np.nan).to_numpy())
        elif pa.types.is_string(column.type) or pa.types.is_large_string(column.type):
            columns[name] = np.array(column.fill_null("").to_pylist(), dtype=np.str_)
    return columns


def _fits(path: Path, names: Mapping[str, str]) -> Columns:
    """Columns of the first table of a FITS file, converted by its units; a star index has its own layout."""
    from astropy.io import fits
    from astropy.table import Table

    with fits.open(path, memmap=True) as units:
        layout = {unit.columns.names[0]: unit.fileinfo() for unit in units[1:] if getattr(unit, "columns", None)}
        if "kdtree_data_stars" in layout:
            rows = {name: int(units[1 + k].header["NAXIS2"]) for k, name in enumerate(layout)}
            return _star_index(path, {name: info["datLoc"] for name, info in layout.items()}, rows)
        tables = [k for k, unit in enumerate(units) if isinstance(unit, (fits.BinTableHDU, fits.TableHDU))]
        if not tables:
            raise InputError(f"{path}: has no table; {_HINT}")
        table = Table.read(units[tables[0]])
    quantities = {name.casefold(): quantity for quantity, name in names.items()}
    columns: Columns = {}
    for name in table.colnames:
        column, wanted = table[name], _UNITS.get(quantities.get(name.casefold(), ""))
        if column.ndim != 1:
            continue
        if wanted and column.unit is not None:
            try:
                column = column.quantity.to(wanted)
            except Exception as error:
                raise InputError(f"{path}: column {name} is in {column.unit}, not in {wanted}") from error
        values = np.ma.filled(column, np.nan) if np.ma.isMaskedArray(column) and column.dtype.kind == "f" else column
        columns[name] = np.asarray(values).astype(np.asarray(values).dtype.newbyteorder("="))
    return columns


def _star_index(path: Path, starts: Mapping[str, int], rows: Mapping[str, int]) -> Columns:
    """Positions and tagged columns of an index of astrometry.net: right ascension and declination in degrees.

    The star tree stores unit vectors as three unsigned 32-bit numbers x, the vector being x / scale + low; low, high
    (three numbers each) and scale are its range. The numbers have the byte order of the machine that made the file,
    which its header states; FITS columns with the trees' row order may follow, such as MAG_VT.

    Source: the comments in the files' own headers (astrometry.net 0.75).
    """
    from astropy.io import fits

    with path.open("rb") as file:
        data = np.memmap(file, np.uint8, mode="r")
    count = rows["kdtree_data_stars"]
    if starts["kdtree_data_stars"] + 12 * count > len(data):
        raise InputError(f"{path}: is truncated; fetch it again")
    # The header holds the number 0x01020304 as the machine stored it.
    order = "<" if str(fits.getheader(path).get("ENDIAN", "")).startswith("04") else ">"
    scale = _raw(data, starts["kdtree_range_stars"], f"{order}f8", 7)
    stored = _raw(data, starts["kdtree_data_stars"], f"{order}u4", 3 * count).reshape(-1, 3)
    vectors: FloatArray = stored / scale[6] + scale[:3]
    if np.abs(np.linalg.norm(vectors, axis=1) - 1.0).max(initial=0.0) > 1e-6:
        raise InputError(f"{path}: its star tree does not hold unit vectors of 32 bits; {_HINT}")
    ra, dec = direction_to_radec(vectors)
    columns: Columns = {"ra": np.degrees(ra), "dec": np.degrees(dec)}
    for name, start in starts.items():
        if rows.get(name) == count and name.upper().startswith("MAG"):
            columns[name] = _raw(data, start, ">f4", count).astype(np.float64)
    return columns


def _raw(data: NDArray[np.uint8], start: int, kind: str, count: int) -> NDArray[Any]:
    size = np.dtype(kind).itemsize * count
    return np.frombuffer(data[start : start + size].tobytes(), kind)
