"""Order and limits of the searches of a flight build's identification.

The default's are those of `startracker.identification.adaptive`: a few brightest stars under the stated errors and
under larger ones; if that leaves a doubt, every star as the pole, under wider and wider assumptions. Those of the
triads are as in `startracker.identification.triads`: all triangles of the brightest stars within 4, 12 and 40 standard
errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from startracker.core import IntArray


class Search(NamedTuple):
    """One search.

    Parameters
    ----------
    poles : int
        Brightest stars that are taken as the pole.
    among, neighbours : int
        Brightest stars that may vote; how many of the nearest of them do.
    need : int
        Neighbours that must agree.
    sides : int
        Tolerance of a separation in standard errors, 8 fraction bits.
    gate2 : int
        Square of the gate of the confirming stars, in units of the stated variance, 8 fraction bits.
    gates : int
        Row of `verifying.GATES`.
    chance : int
        Row of `SearchTables.needed`.
    enough : int
        Confirming stars that are enough if so many occur by chance in 1 of 10,000 candidates; 0: `chance` alone.
    stated : int
        1: of the stated errors; 0: of larger ones.
    steps : int
        After which it ends.
    """

    poles: int
    among: int
    neighbours: int
    need: int
    sides: int
    gate2: int
    gates: int
    chance: int
    enough: int
    stated: int
    steps: int


def _search(
    counts: tuple[int, int, int, int], sigmas: float, scale: float, gates: int, chance: int, enough: int, steps: int
) -> Search:
    sides, gate2 = round(256.0 * sigmas * scale), round(256.0 * (4.5 * scale) ** 2)
    return Search(*counts, sides, gate2, gates, chance, enough, int(scale < 3.0), steps)


QUICK = 2
"""Of the searches, those of the brightest stars; an attitude accepted with a margin then ends the identification."""
SEARCHES = (
    _search((6, 12, 8, 2), 3.7, 2.2, 0, 0, 0, 2_000_000),
    _search((3, 9, 6, 2), 3.7, 7.0, 0, 1, 0, 1_000_000),
    _search((60, 60, 16, 3), 2.6, 2.2, 0, 0, 2, 14_000_000),
    _search((25, 60, 12, 3), 2.6, 7.0, 0, 1, 2, 3_000_000),
    _search((25, 60, 16, 4), 2.6, 16.0, 1, 2, 2, 3_000_000),
)


TRIAD_SCALES = (1, 3, 10)
"""Multiples of the stated errors (`startracker.identification.acceptance.SCALES`)."""
_TRIAD_STEPS = (6_000_000, 8_000_000, 8_000_000)


def triad_searches(stars: int, fixed: bool = False) -> tuple[Search, ...]:
    """Searches for the triads of so many brightest stars, each of which is the first of its triangles in turn; a single
    one if the tolerance of separations is fixed."""
    counts = stars, stars, stars - 1, 2
    if fixed:
        return (_search(counts, 1.0, TRIAD_SCALES[-1], 1, 0, 0, sum(_TRIAD_STEPS))._replace(sides=256, stated=1),)
    return tuple(
        _search(counts, 4.0, scale, int(scale > 7), 0, 0, steps)._replace(stated=1)
        for scale, steps in zip(TRIAD_SCALES, _TRIAD_STEPS, strict=True)
    )


def search_rows(searches: Sequence[Search]) -> IntArray:
    """Searches as rows of integers, as the C has them."""
    return np.array(searches, dtype=np.int64)
