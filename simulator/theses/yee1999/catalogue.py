"""The catalogue of the thesis, its sub-catalogues, and its printed tables."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from startracker.catalog import load_catalog
from startracker.core import FloatArray, IntArray
from startracker.errors import InputError
from startracker.files import included_lines
from startracker.identification.arithmetic import Arithmetic, FloatArithmetic
from startracker.identification.triad_tables import TriadTables

EDITIONS = (4, 5)
"""Editions of the Bright Star Catalogue: the 4th of the thesis, and the included 5th."""

_RA_STEP_DEG = 15.0 * 0.1 / 3600.0
_DEC_STEP_DEG = 1.0 / 3600.0
_DEC_CHANGED = (168, 542, 7851)
"""HR numbers whose declination differs by 1″ in the 4th edition: larger for the first two by Table 2.1; no table of the
extract has the sign for the third, which is assumed to be the same."""


@dataclass(frozen=True, eq=False)
class SubCatalog:
    """Stars of a section of the sky (Yee 1999, section 2.3.3.1), in the order of their numbers: positions of equinox
    and epoch 2000, without proper motion, as in the thesis; each (G,)."""

    hr: IntArray
    ra_deg: FloatArray
    dec_deg: FloatArray
    v_mag: FloatArray

    def __len__(self) -> int:
        return len(self.hr)

    @property
    def sky_deg(self) -> FloatArray:
        """Right ascension and declination (G, 2)."""
        return np.column_stack([self.ra_deg, self.dec_deg])

    def indices(self, numbers: list[int]) -> IntArray:
        """Indices of HR numbers.

        Raises
        ------
        InputError
            If a number is missing in the sub-catalogue.
        """
        at = np.searchsorted(self.hr, numbers)
        missing = [n for n, index in zip(numbers, at, strict=True) if index >= len(self) or self.hr[index] != n]
        if missing:
            raise InputError(f"the sub-catalogue does not contain HR {', '.join(map(str, missing))}")
        return at.astype(np.int64)

    def tables(self, max_separation_deg: float, arithmetic: Arithmetic | None = None) -> TriadTables:
        """Pair database up to the maximum separation, by default in floating point."""
        return TriadTables.build(
            arithmetic or FloatArithmetic(), self.hr, self.ra_deg, self.dec_deg, self.v_mag, max_separation_deg
        )


@lru_cache(maxsize=8)
def sub_catalog(
    edition: int = 4, magnitude_limit: float = 6.0, dec_min_deg: float = 30.0, dec_max_deg: float = 90.0
) -> SubCatalog:
    """Stars of the Bright Star Catalogue down to a magnitude V, between two declinations (inclusive). Edition 5 is the
    included one. Edition 4 has right ascensions smaller by 0.1 s, and declinations of three stars larger by 1″, which
    reproduces the 4th edition for the stars of the thesis; it was rounded differently and is not available itself.

    Raises
    ------
    InputError
        For another edition, or fewer than three stars.
    """
    if edition not in EDITIONS:
        raise InputError(f"--edition: must be 4 or 5, not {edition}")
    catalog = load_catalog("bsc5")
    ra, dec = np.degrees(catalog.ra_rad), np.degrees(catalog.dec_rad)
    if edition == 4:
        ra = (ra - _RA_STEP_DEG) % 360.0
        dec = dec + _DEC_STEP_DEG * np.isin(catalog.id, _DEC_CHANGED)
    inside = (catalog.v_mag <= magnitude_limit) & (dec >= dec_min_deg) & (dec <= dec_max_deg)
    keep = np.flatnonzero(inside)[np.argsort(catalog.id[inside])]
    if len(keep) < 3:
        raise InputError(
            f"the catalogue has {len(keep)} stars with V ≤ {magnitude_limit:g} at declinations {dec_min_deg:g}° to "
            f"{dec_max_deg:g}°; at least three are needed"
        )
    return SubCatalog(catalog.id[keep], ra[keep], dec[keep], catalog.v_mag[keep])


def file_of(table: str) -> str:
    """Name of a table's file: "Table 4.1" is in ``table_4_1``."""
    return table.lower().replace(" ", "_").replace(".", "_")


def printed_rows(name: str) -> list[dict[str, str]]:
    """Rows of a printed table of the thesis, by column; the first line of the file gives its source."""
    return list(csv.DictReader(included_lines("simulator.theses.yee1999", f"{name}.csv")))
