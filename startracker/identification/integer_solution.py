"""Centroids to attitude in integers: triads, votes, plate constants (Yee 1999, chapters 2 and 3).

What she left to floating point, the attitude, is in 64-bit integers here. The C that `startracker.fixed_point.export_c`
writes gives the same answers bit for bit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker.fixed_point.arithmetic import FixedArithmetic
from startracker.fixed_point.attitude import NotSolved, PlateAttitude, plate_attitude
from startracker.fixed_point.formats import FixedPointOverflow, integers
from startracker.identification.triad_search import TriadLimits
from startracker.identification.triad_tables import TriadTables
from startracker.identification.triad_votes import GroupMatch, match_triads

__all__ = [
    "MAX_STARS",
    "MAX_TRIADS",
    "STATUSES",
    "IntegerSolution",
    "IntegerStatus",
    "integer_tables",
    "solve_integers",
]

IntegerStatus = Literal["solved", "too_few_stars", "no_match", "no_attitude", "overflow", "too_many_triads"]
STATUSES: tuple[IntegerStatus, ...] = (
    "solved",
    "too_few_stars",
    "no_match",
    "no_attitude",
    "overflow",
    "too_many_triads",
)
"""In the order of the C export's numbers."""
MAX_STARS = 12
"""Brightest stars that are matched, as in the thesis."""
MAX_TRIADS = 4096
"""Triads that the C export has room for."""


@dataclass(frozen=True, eq=False)
class IntegerSolution:
    """Answer of the integer tracker.

    Parameters
    ----------
    status : str
        One of `STATUSES`.
    reason : str
        In words.
    numbers : int array, shape (N,)
        Catalogue number of each star used, plus 10,000 where several are one in the image; 0 where unmatched.
    triads : int
        Triads of the group that won.
    attitude : PlateAttitude or None
        When solved.
    """

    status: IntegerStatus
    reason: str
    numbers: NDArray[np.int64]
    triads: int = 0
    attitude: PlateAttitude | None = None


def integer_tables(
    star_id: ArrayLike, ra_deg: ArrayLike, dec_deg: ArrayLike, v_mag: ArrayLike, max_separation_deg: float
) -> TriadTables:
    """Databases in integers: those of `TriadTables.build`, with the order of brightness in place of magnitudes.

    Raises
    ------
    InputError, FixedPointOverflow
        As there; a largest separation of 32° or more.
    """
    tables = TriadTables.build(FixedArithmetic(), star_id, ra_deg, dec_deg, v_mag, max_separation_deg)
    rank = np.empty(len(tables), dtype=np.int64)
    rank[np.lexsort((np.arange(len(tables)), tables.v_mag))] = np.arange(len(tables))
    return replace(tables, v_mag=rank)  # type: ignore[arg-type]  # only ever compared


def solve_integers(
    tables: TriadTables, xy_px: ArrayLike, scale_deg: ArrayLike, limits: TriadLimits | None = None
) -> IntegerSolution:
    """Identify stars by triads and find the attitude, after the tables in integers only.

    Parameters
    ----------
    tables : TriadTables
        Of `integer_tables`.
    xy_px : array_like, shape (N, 2)
        Centroids, brightest first, x right and y up from the image's centre: pixels, or integers of 10.22. The first
        12 are used.
    scale_deg : array_like, shape (2,)
        Degrees a pixel, or integers of 12.20.
    limits : TriadLimits, optional
        Thresholds.

    Returns
    -------
    IntegerSolution
        Overflow and failure are statuses.

    Raises
    ------
    TypeError
        Tables that hold floating point.
    """
    integers(tables.v_mag)
    integers(tables.separation)
    xy = np.asarray(xy_px).reshape(-1, 2)[:MAX_STARS]
    nobody = np.zeros(len(xy), dtype=np.int64)
    if len(xy) < 3:
        return IntegerSolution("too_few_stars", f"{len(xy)} stars seen, 3 are needed", nobody)
    try:
        image = tables.arithmetic.image(xy, scale_deg)
        match = match_triads(tables, image.xy, image.scale_deg, limits)
        if len(match.triads) > MAX_TRIADS:
            reason = f"{len(match.triads)} triads passed the tests; there is room for {MAX_TRIADS}"
            return IntegerSolution("too_many_triads", reason, nobody)
        best = match.best()
        if best is None:
            return IntegerSolution("no_match", "no group of triads names three stars", nobody)
        numbers = np.array([vote.number(tables) if vote else 0 for vote in best.matches], dtype=np.int64)
        size = int(match.triads.group_sizes[best.group])
        return _with_attitude(tables, image.xy, best, numbers, size)
    except FixedPointOverflow as overflow:
        return IntegerSolution("overflow", str(overflow), nobody)


def _with_attitude(
    tables: TriadTables, xy: NDArray[np.int64], best: GroupMatch, numbers: NDArray[np.int64], size: int
) -> IntegerSolution:
    seen, catalog = best.pairs.T
    try:
        attitude = plate_attitude(xy[seen], tables.sky.directions[catalog])
    except NotSolved as why:
        return IntegerSolution("no_attitude", str(why), numbers, size)
    return IntegerSolution("solved", f"{len(seen)} stars matched", numbers, size, attitude)
