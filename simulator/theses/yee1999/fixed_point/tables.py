"""Tables of the integer program, computed once in floating point and stored as integers (Yee 1999, section 3.3)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from simulator.theses.yee1999.fixed_point.formats import ANGLE, COSINE, SEPARATION, Format, integers
from startracker.flight.integers import Integers


@lru_cache
def cosine_table(angle: Format = SEPARATION, cosine: Format = COSINE) -> Integers:
    """cos x for every x ≥ 0 of the format of angles, degrees; the index is x.

    2^(M₁+N₁−1) entries, truncated: 32,768 of 1.15 for angles of 6.10.
    """
    x = np.radians(angle.decode(np.arange(angle.largest + 1)))
    return _frozen(cosine.encode(np.cos(x)))


@lru_cache
def arccosine_table(angle: Format = SEPARATION, cosine: Format = COSINE) -> tuple[Integers, int]:
    """Arccosines, degrees, of every y of the format of cosines whose arccosine fits the format of angles.

    Returns
    -------
    table : int array
        In the format of angles, rounded to nearest.
    discarded : int
        Number of the smallest y that have no entry: the index is y − discarded. 27,789 for 6.10 and 1.15, which leaves
        4,980 entries.
    """
    y = cosine.decode(np.arange(cosine.one + 1))
    scaled = np.rint(np.ldexp(np.degrees(np.arccos(y)), angle.fraction_bits))
    discarded = int(np.count_nonzero(scaled > angle.largest))
    return _frozen(scaled[discarded:].astype(np.int64)), discarded


@lru_cache
def quadrant_table(angle: Format = ANGLE, cosine: Format = COSINE) -> Integers:
    """Arccosines of the first quadrant, degrees, for the rotation-angle test: the index is y (section 3.3.2)."""
    y = cosine.decode(np.arange(cosine.one + 1))
    return _frozen(angle.encode(np.degrees(np.arccos(y)), rounded=True))


@dataclass(frozen=True, eq=False)
class EnclosedTable:
    """Yee's database of enclosed angles (section 3.3.3): six 16-bit words for each triangle."""

    stars: Integers
    """Indices i < j < k of the stars, ascending, (T, 3)."""
    angles: Integers
    """Inner angles at these stars, degrees of 10.6, truncated, (T, 3)."""

    @property
    def bytes(self) -> int:
        """Memory in bytes."""
        return 2 * (self.stars.size + self.angles.size)


def enclosed_table(vectors: ArrayLike, first: ArrayLike, second: ArrayLike) -> EnclosedTable:
    """Enclosed angles of every triangle whose three sides are among the given pairs.

    cos A = (cos a − cos b cos c) / (sin b sin c) (eq. 3.1), computed with half angles, which are accurate for narrow
    triangles: tan²(A/2) = sin(s−b) sin(s−c) / (sin s sin(s−a)), s = (a + b + c)/2.

    Parameters
    ----------
    vectors : array_like, shape (G, 3)
        Unit vectors of the stars.
    first, second : array_like of int, shape (P,)
        Pairs, `first` < `second`.
    """
    points, i, j = np.asarray(vectors, dtype=np.float64), integers(first), integers(second)
    order = np.lexsort((j, i))
    stars = _triangles(i[order], j[order], len(points))
    corners = points[stars]
    chords = np.stack(
        [np.linalg.norm(corners[:, p] - corners[:, q], axis=1) for p, q in ((1, 2), (0, 2), (0, 1))], axis=1
    )
    sides = 2.0 * np.arcsin(np.minimum(chords / 2.0, 1.0))
    s = sides.sum(axis=1, keepdims=True) / 2.0
    less, whole = np.maximum(np.sin(s - sides), 0.0), np.sin(s)
    others = less[:, [1, 2, 0]] * less[:, [2, 0, 1]]
    degrees = np.degrees(2.0 * np.arctan2(np.sqrt(others), np.sqrt(whole * less)))
    return EnclosedTable(stars, ANGLE.encode(degrees))


def _triangles(first: Integers, second: Integers, count: int) -> Integers:
    """Triangles (T, 3), ascending, from pairs sorted by first and then second star."""
    start = np.searchsorted(first, np.arange(count + 1))
    # each pair i < j is continued by the pairs j < k, one after the other
    many = start[second + 1] - start[second]
    pair = np.repeat(np.arange(len(first)), many)
    further = np.arange(len(pair)) - np.repeat(np.cumsum(many) - many - start[second], many)
    stars = np.stack([first[pair], second[pair], second[further]], axis=1)
    closed = np.isin(stars[:, 0] * count + stars[:, 2], first * count + second)
    return stars[closed]


def _frozen(table: Integers) -> Integers:
    table.flags.writeable = False
    return table
