"""Merge a deep catalogue with Hipparcos: the same stars matched at a common epoch, doubles included."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from startracker.catalog.stars import StarCatalog, rms
from startracker.core import ARCSEC_RAD, MAS_RAD, FloatArray, IntArray
from startracker.geometry.attitude import radec_to_direction

_CERTAIN_ARCSEC = 0.3
"""Pairs this close are the same star whatever their brightness: long-period variables differ by magnitudes."""
_NEAR = (3.0, 1.5)
_FAR = (10.0, 0.5)
"""Arcseconds and magnitudes within which a pair is the same star. Orbits and wrong proper motions displace some stars
by arcseconds; an unrelated star of like brightness lies within 10″ of one star in ten thousand."""
_ARCSEC_PER_MAG = 0.5
"""Weight of a difference in brightness relative to one in position."""
_COMPANION_ARCSEC = 10.0
"""Stars of the deep catalogue this close to one that both have belong to it: 35 of these 2,800 are there by chance."""
_SAME_MOTION_ARCSEC = 0.15
"""Up to this difference of the positions, the proper motion is corrected by it: the errors of Hipparcos' positions and
proper motions explain it. Beyond, an orbit or a photocentre may, and the proper motion is that of Hipparcos."""
_USEFUL_MAS_YR = 1.0
_BOTH_ARCSEC, _COMPANION_SIGMA_ARCSEC = 0.01, 0.06


def merge_catalogs(deep: StarCatalog, bright: StarCatalog, positions_rad: float = 0.0) -> StarCatalog:
    """Stars of both catalogues, each once, at the epoch of `deep`.

    Stars are matched one to one by their positions at that epoch, with the space motion of `bright`, and by brightness.

    - A star of both has the position of `deep`, and everything else of `bright`. Its proper motion is taken from `deep`
      if known (not zero), otherwise from `bright`, corrected by the difference of both positions divided by the years
      between the catalogues, if that is below 0.15″. If the error of the positions of `deep` over these years is more
      than 1 mas per year, the errors of Hipparcos' proper motions, all values are those of `bright`.
    - A star of `bright` alone is moved to the epoch of `deep`.
    - A star of `deep` alone within 10″ of a star of both is taken as its companion, with its proper motion and
      parallax, if its own proper motion is unknown (zero).
    - V and B − V of a star of both are taken from `deep` if its V in `bright` includes the light of its companions.

    Parameters
    ----------
    deep : StarCatalog
        Accurate positions; V and B − V in the system of `bright`.
    bright : StarCatalog
        Complete for bright stars, with proper motions.
    positions_rad : float
        Error of the positions of `deep` at its epoch on one axis.
    """
    years = deep.epoch_jyear - bright.epoch_jyear
    moved = bright.at_epoch(deep.epoch_jyear)
    rows, others, distance = _neighbours(deep, moved)
    found = match(rows, others, distance, moved, deep)
    has = np.flatnonzero(found >= 0)
    alone = np.setdiff1d(np.arange(len(deep)), found[has])
    companion = _companions(rows, others, found, len(deep))
    columns = {column: getattr(moved, column).copy() for column in StarCatalog.columns()}
    if positions_rad < _USEFUL_MAS_YR * MAS_RAD * abs(years):
        _take_positions(columns, deep, moved, found, years)
    _separate_light(columns, deep, found, companion)
    added = {column: getattr(deep, column)[alone] for column in columns}
    _follow(added, columns, deep, alone, companion)
    joined: dict[str, Any] = {name: np.concatenate([columns[name], added[name]]) for name in columns}
    return replace(deep, position_sigma_rad=rms(joined["star_sigma_rad"]), source=None, **joined)


def match(rows: IntArray, others: IntArray, distance: FloatArray, bright: StarCatalog, deep: StarCatalog) -> IntArray:
    """Index (B,) into `deep` of each star of `bright`, −1 for none; each star of `deep` is matched at most once.

    The candidates are pairs of rows of both with their distances, arcseconds; they are matched in the order of distance
    + 0.5″ per magnitude.
    """
    magnitudes = np.abs(bright.v_mag[rows] - deep.v_mag[others])
    plausible = distance < _CERTAIN_ARCSEC
    for widest, difference in (_NEAR, _FAR):
        plausible |= (distance < widest) & (magnitudes < difference)
    found = np.full(len(bright), -1, dtype=np.int64)
    taken = np.zeros(len(deep), dtype=bool)
    order = np.argsort(distance + _ARCSEC_PER_MAG * magnitudes, kind="stable")
    for k in order[plausible[order]].tolist():
        if found[rows[k]] < 0 and not taken[others[k]]:
            found[rows[k]] = others[k]
            taken[others[k]] = True
    return found


def _neighbours(deep: StarCatalog, moved: StarCatalog) -> tuple[IntArray, IntArray, FloatArray]:
    """All pairs up to 10″: rows of `moved` and of `deep`, and their distances, arcseconds."""
    one, other = (radec_to_direction(catalog.ra_rad, catalog.dec_rad) for catalog in (moved, deep))
    reach = max(_FAR[0], _COMPANION_ARCSEC) * ARCSEC_RAD
    near = cKDTree(one).sparse_distance_matrix(cKDTree(other), reach, output_type="ndarray")
    near = near[np.lexsort((near["j"], near["i"]))]  # scipy does not specify the order of the pairs
    return near["i"].astype(np.int64), near["j"].astype(np.int64), near["v"] / ARCSEC_RAD


def _companions(rows: IntArray, others: IntArray, found: IntArray, count: int) -> IntArray:
    """Row in the bright catalogue of the matched star to which each star of the deep one belongs, (D,); −1 for none."""
    taken = np.zeros(count, dtype=bool)
    taken[found[found >= 0]] = True
    belongs = np.flatnonzero((found[rows] >= 0) & ~taken[others])
    companion = np.full(count, -1, dtype=np.int64)
    companion[others[belongs]] = rows[belongs]
    return companion


def _take_positions(
    columns: dict[str, NDArray[Any]], deep: StarCatalog, moved: StarCatalog, found: IntArray, years: float
) -> None:
    """Positions of `deep` for the stars of both, their errors, and proper motions corrected by both positions."""
    has = np.flatnonzero(found >= 0)
    entry = found[has]
    east = np.remainder(deep.ra_rad[entry] - moved.ra_rad[has] + np.pi, 2.0 * np.pi) - np.pi
    east *= np.cos(deep.dec_rad[entry])
    north = deep.dec_rad[entry] - moved.dec_rad[has]
    apart = np.hypot(east, north) / ARCSEC_RAD
    same = apart < _SAME_MOTION_ARCSEC
    known = (deep.pm_ra_rad_yr[entry] != 0.0) | (deep.pm_dec_rad_yr[entry] != 0.0)
    columns["ra_rad"][has], columns["dec_rad"][has] = deep.ra_rad[entry], deep.dec_rad[entry]
    for name, off in (("pm_ra_rad_yr", east), ("pm_dec_rad_yr", north)):
        corrected = columns[name][has] + np.where(same, off / years, 0.0)
        columns[name][has] = np.where(known, getattr(deep, name)[entry], corrected)
    # A difference that is not proper motion continues to grow, by 10 years of the 25.
    sigma = np.where(same, _BOTH_ARCSEC, 0.4 * apart) * ARCSEC_RAD
    columns["star_sigma_rad"][has] = np.where(known, deep.star_sigma_rad[entry], sigma)


def _separate_light(columns: dict[str, NDArray[Any]], deep: StarCatalog, found: IntArray, companion: IntArray) -> None:
    """V and B − V of the deep catalogue for stars whose bright entry has the light of their companions as well."""
    extra = np.flatnonzero(companion >= 0)
    light = np.zeros(len(found))
    np.add.at(light, companion[extra], 10.0 ** (-0.4 * deep.v_mag[extra]))
    several = np.flatnonzero(light > 0.0)
    own = deep.v_mag[found[several]]
    together = -2.5 * np.log10(10.0 ** (-0.4 * own) + light[several])
    given = columns["v_mag"][several]
    combined = np.abs(given - together) < np.abs(given - own)
    rows = several[combined]
    for name in ("v_mag", "b_v"):
        columns[name][rows] = getattr(deep, name)[found[rows]]


def _follow(
    added: dict[str, NDArray[Any]],
    columns: dict[str, NDArray[Any]],
    deep: StarCatalog,
    alone: IntArray,
    companion: IntArray,
) -> None:
    """Motion and parallax of their primaries for companions of unknown motion; changes `added`."""
    unknown = (deep.pm_ra_rad_yr[alone] == 0.0) & (deep.pm_dec_rad_yr[alone] == 0.0)
    follows = np.flatnonzero((companion[alone] >= 0) & unknown)
    primary = companion[alone[follows]]
    for name in ("pm_ra_rad_yr", "pm_dec_rad_yr", "parallax_rad", "radial_velocity_km_s"):
        added[name] = added[name].copy()
        added[name][follows] = columns[name][primary]
    added["star_sigma_rad"] = added["star_sigma_rad"].copy()
    added["star_sigma_rad"][follows] = _COMPANION_SIGMA_ARCSEC * ARCSEC_RAD
