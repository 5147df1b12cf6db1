"""Candidates of one observed star, the pole, by votes of its neighbours (Padgett & Kreutz-Delgado 1997), in integers.

Every guide pair as long as the separation of the pole from a neighbour is a vote for both of its stars. A first pass
counts the neighbours that vote for each guide star; a second one keeps the votes for those with enough of them. Two
votes for a guide star agree if the third side of their triangle is as long as observed, and the triangle has the
same sense. With two votes that agree this is the triangle of Mortari et al. 2004; more of them are its confirmation.

Memory is bounded: a byte a guide star, and `MOST_VOTES` votes: if there are more, further passes keep those for the
other guide stars, and if there are too many for these, more votes are required. The C (`c/tracker_votes.c`) performs
the same operations.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker.core import IntArray
from startracker.fixed_point.square_root import rooted
from startracker.flight.evidence import Sight
from startracker.flight.search_plan import Search
from startracker.flight.search_tables import SearchTables

MOST_CANDIDATES = 48
MOST_VOTES, MOST_COUNT = 1024, 255
"""Votes that there is room for at a time, and that are counted for a guide star."""
ABERRATION = 107
"""Relative error of a separation, as the pairs are those without aberration, 20 fraction bits."""
_LEAST_ERRORS = 3
_AREA_SHIFT = 30


Triangles = tuple[IntArray, IntArray, IntArray]


class Stars(NamedTuple):
    """Separations of the observed stars.

    Parameters
    ----------
    chord, error : (N, N)
        Chords, and their standard errors, 2.30.
    """

    chord: IntArray
    error: IntArray


class Candidates(NamedTuple):
    """Guide stars that pole and neighbour may be, those with most agreeing votes first.

    Parameters
    ----------
    rows : (K, 5)
        The neighbour, the guide stars of the pole and of the neighbour, another neighbour that agrees, and how many.
    steps : int
    """

    rows: IntArray
    steps: int


class Neighbours(NamedTuple):
    """Stars (L,) that vote: their number, and first and one beyond the last of the pairs."""

    star: IntArray
    low: IntArray
    high: IntArray


def separations(seen: Sight, t: SearchTables) -> Stars:
    """Chords and errors of all pairs of observed stars; for triads with a fixed tolerance, that tolerance."""
    apart = seen.direction[:, None] - seen.direction[None]
    variance = seen.variance[:, None] + seen.variance[None]
    error = rooted(variance)
    if t.triads is not None and t.triads.fixed:
        error = np.full_like(error, t.triads.fixed)
    return Stars(rooted((apart * apart).sum(axis=-1)), error)


def tolerance(chord: IntArray, error: IntArray, sides: int) -> IntArray:
    """Tolerance of a separation: `sides` standard errors (8 fraction bits), and aberration."""
    return np.asarray(((error * sides) >> 8) + ((chord * ABERRATION) >> 20))


def neighbours_of(pole: int, first: int, stars: Stars, search: Search, t: SearchTables) -> Neighbours:
    """The nearest stars to a pole of those that vote, from star number `first` on, with the windows of guide pairs."""
    among = min(search.among, len(stars.chord))
    chord = stars.chord[pole, :among]
    allowed = tolerance(chord, stars.error[pole, :among], search.sides)
    number = np.arange(among)
    useful = (number != pole) & (number >= first) & (chord >= _LEAST_ERRORS * allowed) & (chord - allowed <= t.longest)
    star = np.flatnonzero(useful)
    star = star[np.argsort(chord[star], kind="stable")][: search.neighbours]
    last = len(t.bin_start) - 2
    low = np.minimum((chord[star] - allowed[star]) >> t.bin_shift, last)
    high = np.minimum((chord[star] + allowed[star]) >> t.bin_shift, last)
    return Neighbours(star, t.bin_start[low], t.bin_start[high + 1])


class Ballot:
    """Votes about a pole, a part of the guide stars at a time.

    Parameters
    ----------
    pole : int
    near : Neighbours
    seen : Sight
    need : int
        Fewest votes of a guide star whose votes are kept.
    t : SearchTables

    Attributes
    ----------
    looked : int
        Pairs of all windows.
    """

    def __init__(self, pole: int, near: Neighbours, seen: Sight, need: int, t: SearchTables) -> None:
        self._votes = _votes(pole, near, seen, t)
        self._counts = np.minimum(np.bincount(self._votes[:, 2], minlength=len(t.guide)), MOST_COUNT)
        self._need = _enough(self._counts, need, t.most_kept)
        self._total = np.cumsum(np.where(self._counts >= self._need, self._counts, 0))
        self._kept = self._begin = 0
        self.looked = int((near.high - near.low).sum())

    def part(self) -> IntArray | None:
        """Votes (V, 3) for the next guide stars, by ascending guide star, each as in `_votes`; None: none is left."""
        if self._kept >= int(self._total[-1]):
            return None
        end = int(np.searchsorted(self._total, self._kept + MOST_VOTES, side="right"))
        self._kept = int(self._total[end - 1])
        star, votes = self._votes[:, 2], self._votes
        some = votes[(self._counts[star] >= self._need) & (star >= self._begin) & (star < end)]
        self._begin = end
        part = some[np.argsort(some[:, 2], kind="stable")]
        return part[np.arange(len(part)) - np.searchsorted(part[:, 2], part[:, 2]) < MOST_COUNT]


def vote_about(pole: int, seen: Sight, stars: Stars, search: Search, left: int, t: SearchTables) -> Candidates:
    """Guide stars that an observed star and one of its neighbours may be.

    Parameters
    ----------
    pole : int
    seen, stars : Sight, Stars
    search : Search
    left : int
        Steps after which no further pass is begun.
    t : SearchTables
    """
    found = [np.empty((0, 5), np.int64)]
    near = neighbours_of(pole, 0, stars, search, t)
    if len(near.star) < search.need:
        return Candidates(found[0], 0)
    ballot = Ballot(pole, near, seen, search.need, t)
    steps = len(t.guide) + 2 * ballot.looked
    while steps <= left and (votes := ballot.part()) is not None:
        rows, compared = _agreeing(pole, votes, near, seen, stars, search, t)
        found.append(rows)
        steps += 2 * ballot.looked + 4 * compared
    rows = np.concatenate(found)
    return Candidates(rows[np.argsort(-rows[:, 4], kind="stable")][:MOST_CANDIDATES], steps)


def _enough(counts: IntArray, need: int, most: int) -> int:
    """Fewest votes, at least `need`, of a guide star whose votes are kept, so that they are `most` or fewer."""
    number = np.bincount(counts, minlength=MOST_COUNT + 1)
    beyond = np.cumsum((number * np.arange(MOST_COUNT + 1))[::-1])[::-1]
    return int(np.flatnonzero(beyond[need:] <= most)[0]) + need if beyond[-1] <= most else MOST_COUNT + 1


def _votes(pole: int, near: Neighbours, seen: Sight, t: SearchTables) -> IntArray:
    """Votes (V, 3) in the order of the neighbours and pairs: the neighbour's number among them, its guide star, and
    that of the pole; only those whose difference in brightness is possible."""
    parts = []
    for k, star in enumerate(near.star.tolist()):
        low, high = int(near.low[k]), int(near.high[k])
        a = np.stack([t.first[low:high], t.second[low:high]], axis=1).ravel()
        b = np.stack([t.second[low:high], t.first[low:high]], axis=1).ravel()
        fits = np.ones(len(a), np.bool_)
        if seen.brightness:
            fainter = int(seen.magnitude[pole] - seen.magnitude[star])
            fits = np.abs(fainter - (t.magnitude[a] - t.magnitude[b])) <= t.magnitude_tolerance
        parts.append(np.stack([np.full(int(fits.sum()), k), b[fits], a[fits]], axis=1))
    return np.concatenate(parts)


def _agreeing(
    pole: int, votes: IntArray, near: Neighbours, seen: Sight, stars: Stars, search: Search, t: SearchTables
) -> tuple[IntArray, int]:
    """Candidates (K, 5), the best of each guide star, ascending, and the votes compared."""
    x, y = same_star(votes[:, 2])
    compared = len(x)
    other = votes[x, 0] != votes[y, 0]
    x, y = x[other], y[other]
    k, m = near.star[votes[x, 0]], near.star[votes[y, 0]]
    a, b, c = votes[x, 2], votes[x, 1], votes[y, 1]
    agree = triangles_agree((np.full(len(k), pole), k, m), (a, b, c), seen, stars, search, t)
    x, y = x[agree], y[agree]
    pairs = np.unique(np.stack([x, votes[y, 0]], axis=1), axis=0)  # a neighbour counts once
    agreeing = np.bincount(pairs[:, 0], minlength=len(votes)) + 1
    with_ = np.full(len(votes), -1, np.int64)
    with_[pairs[::-1, 0]] = pairs[::-1, 1]  # the nearest one that agrees
    good = np.flatnonzero(agreeing >= search.need)
    # of each guide star the vote with most agreeing ones, of equal ones that of the farthest neighbour
    best = good[np.lexsort((good, -votes[good, 0], -agreeing[good], votes[good, 2]))]
    best = best[np.unique(votes[best, 2], return_index=True)[1]]
    columns = near.star[votes[best, 0]], votes[best, 2], votes[best, 1], near.star[with_[best]], agreeing[best]
    return np.stack(columns, axis=1), compared


def triangles_agree(
    star: Triangles, guide: Triangles, seen: Sight, stars: Stars, search: Search, t: SearchTables
) -> NDArray[np.bool_]:
    """Mask (T,) of triangles of stars and of guide stars whose third sides, and sense, agree."""
    _, k, m = star
    p, q, r = (t.guide[corner] for corner in guide)
    chord = stars.chord[k, m]
    allowed = tolerance(chord, stars.error[k, m], search.sides)
    observed, known = _area(*(seen.direction[corner] for corner in star)), _area(p, q, r)
    thin = np.abs(observed) <= (allowed * chord) >> _AREA_SHIFT
    return np.asarray(as_long(q - r, k, m, stars, search) & (thin | ((observed > 0) == (known > 0))))


def as_long(apart: IntArray, i: IntArray, j: IntArray, stars: Stars, search: Search) -> NDArray[np.bool_]:
    """Mask (T,) of differences (T, 3) of guide stars that are as long as the chords of pairs of stars."""
    square, chord = (apart * apart).sum(axis=1), stars.chord[i, j]
    allowed = tolerance(chord, stars.error[i, j], search.sides)
    low, high = np.maximum(chord - allowed, 0), chord + allowed
    return np.asarray((square >= low * low) & (square <= high * high))


def same_star(star: IntArray) -> tuple[IntArray, IntArray]:
    """All ordered pairs of different entries of an ascending array that are equal."""
    size = np.unique(star, return_counts=True)[1]
    begin = np.repeat(np.cumsum(size) - size, size)
    of = np.repeat(size, size)
    x = np.repeat(np.arange(len(star)), of)
    y = np.repeat(begin, of) + np.arange(len(x)) - np.repeat(np.cumsum(of) - of, of)
    return x[x != y], y[x != y]


def _area(p: IntArray, q: IntArray, r: IntArray) -> IntArray:
    """Twice the area of spherical triangles (…, 3), positive if counted about the outward normal, 2⁻³⁰."""
    u, v = q - p, r - p
    i, j = [1, 2, 0], [2, 0, 1]
    normal = (u[..., i] * v[..., j] - u[..., j] * v[..., i]) >> _AREA_SHIFT
    return np.asarray((normal * np.broadcast_to(p, normal.shape)).sum(axis=-1) >> 30)
