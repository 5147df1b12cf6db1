"""Complete a precise catalogue with the data and the missing stars of the Bright Star Catalogue.

The two catalogues are matched one to one. An unmatched bright star is either the companion of a matched star, with
which the precise catalogue combines it in one entry (nothing to add), or it is missing there (added).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from startracker.catalog.stars import StarCatalog
from startracker.core import ARCSEC_RAD, FloatArray, IntArray

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
    brightness, colour, position and motion are those of `precise`. A star is variable if either catalogue says so.
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
    return replace(precise, **joined)


def _missing(bright: StarCatalog, precise: StarCatalog, found: IntArray) -> NDArray[np.bool_]:
    """Mask of stars of `bright` that `precise` has neither as an entry nor combined in the entry of another star."""
    star, entry, distance = _neighbours(bright, precise)
    light = np.zeros(len(precise))  # of the matched star alone, on the scale of `bright`
    has = found >= 0
    light[found[has]] = 10.0 ** (-0.4 * bright.v_mag[has])
    missing = ~has
    for k in np.flatnonzero(missing[star]):
        if light[entry[k]] == 0.0:
            continue
        alone = -2.5 * np.log10(light[entry[k]])
        together = -2.5 * np.log10(light[entry[k]] + 10.0 ** (-0.4 * bright.v_mag[star[k]]))
        of_both = abs(precise.v_mag[entry[k]] - together) < abs(precise.v_mag[entry[k]] - alone)
        if distance[k] < _CERTAIN_ARCSEC or of_both:
            missing[star[k]] = False
    return missing


def _neighbours(bright: StarCatalog, precise: StarCatalog) -> tuple[IntArray, IntArray, FloatArray]:
    """All pairs within the search radius at the epoch of `bright`: indices and separation, arcseconds."""
    u, w = bright.directions(bright.epoch_jyear), precise.directions(bright.epoch_jyear)
    near = cKDTree(u).sparse_distance_matrix(cKDTree(w), _SEARCH_ARCSEC * ARCSEC_RAD, output_type="ndarray")
    near = near[np.lexsort((near["j"], near["i"]))]
    return near["i"].astype(np.int64), near["j"].astype(np.int64), near["v"] / ARCSEC_RAD
