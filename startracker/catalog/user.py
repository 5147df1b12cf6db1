"""Catalogues that a user adds from files: columns by name, stored in the user's cache folder."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from hashlib import file_digest
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from startracker.catalog import cache, gaia
from startracker.catalog.hipparcos import load_hipparcos
from startracker.catalog.merging import merge_catalogs
from startracker.catalog.source import CatalogSource, SourceFile
from startracker.catalog.stars import StarCatalog
from startracker.catalog.tables import Columns, read_columns
from startracker.core import MAS_RAD, FloatArray
from startracker.errors import InputError

_NAME = re.compile(r"[a-z][a-z0-9_-]{0,39}")
FIRST_NUMBER = 1_000_001
"""Number of the first star of a table without usable numbers; Hipparcos' are below."""

USUAL_NAMES = {
    "ra": ("ra", "ra_icrs", "raj2000", "_raj2000", "ra_deg", "ramdeg"),
    "dec": ("dec", "de_icrs", "dec_icrs", "dej2000", "decj2000", "_dej2000", "dec_deg", "demdeg"),
    "v": ("v", "vmag", "v_mag", "mag_v", "johnson_v"),
    "b_v": ("b_v", "b-v", "bv"),
    "vt": ("vt", "vtmag", "mag_vt"),
    "bt": ("bt", "btmag", "mag_bt"),
    "g": ("g", "gmag", "phot_g_mean_mag", "g_mag"),
    "bp": ("bp", "bpmag", "phot_bp_mean_mag"),
    "rp": ("rp", "rpmag", "phot_rp_mean_mag"),
    "pm_ra": ("pm_ra", "pmra", "pmra_cosdec"),
    "pm_dec": ("pm_dec", "pmdec", "pmde"),
    "parallax": ("parallax", "plx"),
    "id": ("id", "source_id", "source", "gaia", "hip"),
}
"""Quantities, and the names under which their columns are recognised; case does not matter."""


@dataclass(frozen=True)
class TableOptions:
    """How a table of stars is read."""

    epoch_jyear: float | None = None
    """Julian epoch of the positions; None: J2000 for the star indices of Tycho-2, otherwise it must be given."""
    columns: Mapping[str, str] = field(default_factory=dict)
    """Column of a quantity (key of `USUAL_NAMES`), where it has another name. Right ascension and declination in
    degrees (ICRS), proper motions in milliarcseconds per year (RA multiplied by cos Dec), parallaxes in
    milliarcseconds."""
    sigma_mas: float = 100.0
    """Standard error of the positions at their epoch on one axis."""
    magnitude_limit: float = np.inf
    """Faintest V that is kept."""
    hipparcos: bool = True
    """Merge with Hipparcos: bright stars, parallaxes and names."""


def catalogs_folder() -> Path:
    """Folder of the catalogues that were added."""
    return cache.folder() / "catalogs"


def added_catalogs() -> dict[str, Callable[[], StarCatalog]]:
    """Loaders of the catalogues that were added, by name."""
    try:
        names = sorted(path.stem for path in catalogs_folder().glob("*.npz"))
    except OSError:
        return {}
    return {name: partial(load_added, name) for name in names}


def version_of(name: str) -> int | None:
    """Time at which a catalogue was added, ns; None for one that was not."""
    try:
        return (catalogs_folder() / f"{name}.npz").stat().st_mtime_ns
    except (OSError, ValueError):  # a name that no file can have
        return None


def load_added(name: str) -> StarCatalog:
    """A catalogue that was added.

    Raises
    ------
    InputError
        If its file is damaged.
    """
    found = cache.load(f"catalogs/{name}")
    if found is None:
        raise InputError(
            f"the catalogue '{name}' is damaged; remove it (boresight catalog remove {name}) and add it again"
        )
    return found


def add_catalog(
    name: str, files: Sequence[Path], options: TableOptions = TableOptions(), built_in: Sequence[str] = ()
) -> StarCatalog:
    """Read a catalogue from files and store it under a name, replacing an earlier one of this name.

    Parameters
    ----------
    name : str
        Lower-case letters, digits, hyphens and underscores.
    files : sequence of Path
        Tables of one catalogue (`read_columns`).
    options : TableOptions
        How they are read.
    built_in : sequence of str
        Names that cannot be used.

    Raises
    ------
    InputError
        For an unusable name, file or column, or if the folder cannot be written.
    """
    if not _NAME.fullmatch(name) or name in built_in:
        reserved = f", other than {', '.join(built_in)}" if built_in else ""
        raise InputError(f"'{name}': the name of a catalogue has letters a to z, digits, - and _{reserved}")
    if not files:
        raise InputError("give at least one file of the catalogue")
    parts = [_stars(path, name, options) for path in files]
    catalog = _joined(parts)
    own = tuple(SourceFile(path.name, _sha256(path)) for path in files)
    if options.hipparcos:
        hipparcos = load_hipparcos()
        catalog = merge_catalogs(catalog, hipparcos, options.sigma_mas * MAS_RAD)
        own += hipparcos.provenance.files
    kept = catalog.brighter_than(options.magnitude_limit)
    if not len(kept):
        raise InputError(f"{files[0]}: has no star with a position and a magnitude to V = {options.magnitude_limit:g}")
    plain = CatalogSource(name, len(kept), kept.epoch_jyear, kept.provenance.depth_v, own)
    kept = replace(kept, name=name, source=replace(plain, note=_note(kept)))
    try:
        catalogs_folder().mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{catalogs_folder()}: cannot be written ({error.strerror})") from error
    cache.store(f"catalogs/{name}", kept)
    stored = cache.load(f"catalogs/{name}")
    if stored is None or stored.source != kept.source:
        raise InputError(f"{catalogs_folder()}: cannot be written; make room there, or set BORESIGHT_CACHE")
    return kept


def remove_catalog(name: str) -> None:
    """Remove a catalogue that was added.

    Raises
    ------
    InputError
        If there is none of that name, or it cannot be removed.
    """
    if name not in added_catalogs():
        known = ", ".join(added_catalogs()) or "none"
        raise InputError(f"'{name}' is not one of the catalogues that were added ({known})")
    try:
        (catalogs_folder() / f"{name}.npz").unlink()
    except OSError as error:
        raise InputError(f"the catalogue '{name}' cannot be removed ({error.strerror})") from error


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return file_digest(file, "sha256").hexdigest()


def _note(catalog: StarCatalog) -> str:
    still = int(np.count_nonzero((catalog.pm_ra_rad_yr == 0.0) & (catalog.pm_dec_rad_yr == 0.0)))
    error = catalog.position_sigma_rad / MAS_RAD / 1000.0
    return f"{still:,} stars without proper motion; positions to {error:.2g}″ rms in 2026"


def _stars(path: Path, name: str, options: TableOptions) -> StarCatalog:
    """Stars of one file that have a position and a magnitude."""
    table = read_columns(path, options.columns)
    chosen = _chosen(path, table, options.columns)
    epoch = options.epoch_jyear
    if epoch is None:
        if "MAG_VT" not in table:
            raise InputError(f"{path}: give the epoch of its positions (--epoch 2016 for Gaia DR3, 2000 for Tycho-2)")
        epoch = 2000.0
    values = {quantity: _numbers(path, column, table) for quantity, column in chosen.items() if quantity != "id"}
    v_mag, b_v = _magnitudes(path, values)
    good = np.isfinite(values["ra"]) & np.isfinite(values["dec"]) & np.isfinite(v_mag)
    if np.any(np.abs(values["dec"][good]) > 90.0) or np.any(np.abs(values["ra"][good]) > 360.0):
        raise InputError(f"{path}: right ascensions and declinations must be in degrees")
    rows = np.flatnonzero(good)
    nothing = np.full(len(good), np.nan)
    pm_ra, pm_dec = (values.get(key, nothing)[rows] for key in ("pm_ra", "pm_dec"))
    unknown = ~(np.isfinite(pm_ra) & np.isfinite(pm_dec))
    drift_mas = np.where(unknown, gaia.MOTION_MAS_YR * abs(gaia.STATED_JYEAR - epoch), 0.0)
    sigma = np.hypot(options.sigma_mas, drift_mas) * MAS_RAD
    return StarCatalog.of_stars(
        name,
        epoch,
        sigma,
        id=_ids(table, chosen.get("id"), rows),
        ra_rad=np.radians(values["ra"][rows]) % (2.0 * np.pi),
        dec_rad=np.radians(values["dec"][rows]),
        pm_ra_rad_yr=np.where(unknown, 0.0, pm_ra) * MAS_RAD,
        pm_dec_rad_yr=np.where(unknown, 0.0, pm_dec) * MAS_RAD,
        parallax_rad=np.maximum(np.nan_to_num(values.get("parallax", nothing)[rows]), 0.0) * MAS_RAD,
        v_mag=v_mag[rows],
        b_v=b_v[rows],
    )


def _chosen(path: Path, table: Columns, given: Mapping[str, str]) -> dict[str, str]:
    """Column of each quantity that the table has."""
    unknown = [quantity for quantity in given if quantity not in USUAL_NAMES]
    if unknown:
        raise InputError(f"'{unknown[0]}' is not a quantity of a catalogue: {', '.join(USUAL_NAMES)}")
    folded = {column.casefold(): column for column in reversed(list(table))}
    chosen: dict[str, str] = {}
    for quantity, usual in USUAL_NAMES.items():
        if quantity in given:
            column = folded.get(given[quantity].casefold())
            if column is None:
                raise InputError(f"{path}: has no column '{given[quantity]}'; it has {_listed(table)}")
            chosen[quantity] = column
        else:
            found = [folded[name] for name in usual if name in folded]
            chosen |= {quantity: found[0]} if found else {}
    for quantity in ("ra", "dec"):
        if quantity not in chosen:
            raise InputError(
                f"{path}: which column is {quantity}? (--columns {quantity}=NAME); it has {_listed(table)}"
            )
    return chosen


def _listed(table: Columns) -> str:
    names = list(table)
    return ", ".join(names[:12]) + (" …" if len(names) > 12 else "")


def _numbers(path: Path, column: str, table: Columns) -> FloatArray:
    values = table[column]
    if values.dtype.kind not in "iuf":
        raise InputError(f"{path}: column {column} does not hold numbers")
    return values.astype(np.float64)


def _magnitudes(path: Path, values: Mapping[str, FloatArray]) -> tuple[FloatArray, FloatArray]:
    """V and B − V (N,) from the columns that there are: V, Tycho's VT and BT, or Gaia's G, BP and RP."""
    nothing = np.full(len(values["ra"]), np.nan)
    b_v = values.get("b_v", nothing)
    if "v" in values:
        return values["v"], b_v
    if "vt" in values:
        colour = values.get("bt", nothing) - values["vt"]
        # ESA 1997, vol. 1, eq. 1.3.20; 0.07 is the median of Hipparcos' stars (σ 0.09 mag) for those without BT.
        v_mag = values["vt"] - np.where(np.isfinite(colour), 0.090 * colour, 0.07)
        return v_mag, np.where(np.isfinite(b_v), b_v, 0.850 * colour)
    if "g" in values:
        colour = values.get("bp", nothing) - values.get("rp", nothing)
        own = gaia.johnson_b_v(colour)
        return gaia.johnson_v(values["g"], colour), np.where(np.isfinite(b_v), b_v, own)
    raise InputError(f"{path}: which column is the magnitude? (--columns v=NAME, or vt, bt; g, bp, rp)")


def _ids(table: Columns, column: str | None, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Numbers of the stars: those of the table if they are distinct and cannot be Hipparcos', otherwise by row."""
    own = FIRST_NUMBER + rows
    if column is None or table[column].dtype.kind not in "iu":
        return own
    given = table[column][rows].astype(np.int64)
    return given if len(np.unique(given)) == len(given) and (given > gaia.MOST_HIP).all() else own


def _joined(parts: Sequence[StarCatalog]) -> StarCatalog:
    """The stars of all files, each position once; numbers by row, which start again in each file, are made distinct."""
    if len(parts) == 1:
        return parts[0]
    columns = {name: np.concatenate([getattr(part, name) for part in parts]) for name in StarCatalog.columns()}
    positions = np.stack([columns["ra_rad"], columns["dec_rad"]], axis=1)
    _, first = np.unique(positions, axis=0, return_index=True)
    rows = np.sort(first)
    chosen: dict[str, Any] = {name: values[rows] for name, values in columns.items()}
    if len(np.unique(chosen["id"])) < len(rows):
        chosen["id"] = FIRST_NUMBER + np.arange(len(rows))
    return replace(parts[0], **chosen)
