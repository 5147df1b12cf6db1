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

from startracker.arrays import IntArray
from startracker.flight.evidence import Sight
from startracker.flight.integers import rooted
from startracker.flight.search_plan import Search
from startracker.flight.search_tables import SearchTables

MOST_NEIGHBOURS, MOST_CANDIDATES = 16, 48
MOST_VOTES, MOST_KEPT, MOST_COUNT = 1024, 8192, 255
"""Votes that there is room for at a time, that are kept about a pole, and that are counted for a guide star."""
ABERRATION = 107
"""Relative error of a separation, as the pairs are those without aberration, 20 fraction bits."""
_LEAST_ERRORS = 3
_AREA_SHIFT = 30


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


class _Neighbours(NamedTuple):
    """Stars (L,) that vote: their number, and first and one beyond the last of the pairs."""

    star: IntArray
    low: IntArray
    high: IntArray


def separations(seen: Sight) -> Stars:
    """Chords and errors of all pairs of observed stars."""
    apart = seen.direction[:, None] - seen.direction[None]
    variance = seen.variance[:, None] + seen.variance[None]
    return Stars(rooted((apart * apart).sum(axis=-1)), rooted(variance))


def tolerance(chord: IntArray, error: IntArray, sides: int) -> IntArray:
    """Tolerance of a separation: `sides` standard errors (8 fraction bits), and aberration."""
    return np.asarray(((error * sides) >> 8) + ((chord * ABERRATION) >> 20))


def neighbours_of(pole: int, stars: Stars, search: Search, t: SearchTables) -> _Neighbours:
    """The nearest stars to a pole of those that vote, with the windows of guide pairs."""
    among = min(search.among, len(stars.chord))
    chord = stars.chord[pole, :among]
    allowed = tolerance(chord, stars.error[pole, :among], search.sides)
    useful = (np.arange(among) != pole) & (chord >= _LEAST_ERRORS * allowed) & (chord - allowed <= t.longest)
    star = np.flatnonzero(useful)
    star = star[np.argsort(chord[star], kind="stable")][: search.neighbours]
    last = len(t.bin_start) - 2
    low = np.minimum((chord[star] - allowed[star]) >> t.bin_shift, last)
    high = np.minimum((chord[star] + allowed[star]) >> t.bin_shift, last)
    return _Neighbours(star, t.bin_start[low], t.bin_start[high + 1])


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
    none = np.empty((0, 5), np.int64)
    near = neighbours_of(pole, stars, search, t)
    if len(near.star) < search.need:
        return Candidates(none, 0)
    votes = _votes(pole, near, seen, t)
    counts = np.minimum(np.bincount(votes[:, 2], minlength=len(t.guide)), MOST_COUNT)
    need = _enough(counts, search.need)
    looked = int((near.high - near.low).sum())
    steps, found, begin = len(t.guide) + 2 * looked, [none], 0
    total = np.cumsum(np.where(counts >= need, counts, 0))
    kept = 0
    while kept < int(total[-1]) and steps <= left:
        end = int(np.searchsorted(total, kept + MOST_VOTES, side="right"))
        kept = int(total[end - 1])
        some = votes[(counts[votes[:, 2]] >= need) & (votes[:, 2] >= begin) & (votes[:, 2] < end)]
        rows, compared = _agreeing(pole, some, near, seen, stars, search, t)
        found.append(rows)
        steps, begin = steps + 2 * looked + 4 * compared, end
    rows = np.concatenate(found)
    return Candidates(rows[np.argsort(-rows[:, 4], kind="stable")][:MOST_CANDIDATES], steps)


def _enough(counts: IntArray, need: int) -> int:
    """Fewest votes, at least `need`, of a guide star whose votes are kept, so that they are not too many."""
    number = np.bincount(counts, minlength=MOST_COUNT + 1)
    beyond = np.cumsum((number * np.arange(MOST_COUNT + 1))[::-1])[::-1]
    return int(np.flatnonzero(beyond[need:] <= MOST_KEPT)[0]) + need if beyond[-1] <= MOST_KEPT else MOST_COUNT + 1


def _votes(pole: int, near: _Neighbours, seen: Sight, t: SearchTables) -> IntArray:
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
    pole: int, votes: IntArray, near: _Neighbours, seen: Sight, stars: Stars, search: Search, t: SearchTables
) -> tuple[IntArray, int]:
    """Candidates (K, 5), the best of each guide star, ascending, and the votes compared."""
    order = np.argsort(votes[:, 2], kind="stable")
    sorted_ = votes[order]
    sorted_ = sorted_[np.arange(len(order)) - np.searchsorted(sorted_[:, 2], sorted_[:, 2]) < MOST_COUNT]
    x, y = _same_star(sorted_[:, 2])
    compared = len(x)
    other = sorted_[x, 0] != sorted_[y, 0]
    x, y = x[other], y[other]
    k, m = near.star[sorted_[x, 0]], near.star[sorted_[y, 0]]
    a, b, c = sorted_[x, 2], sorted_[x, 1], sorted_[y, 1]
    apart = t.guide[b] - t.guide[c]
    square, chord = (apart * apart).sum(axis=1), stars.chord[k, m]
    allowed = tolerance(chord, stars.error[k, m], search.sides)
    low, high = np.maximum(chord - allowed, 0), chord + allowed
    agree = (square >= low * low) & (square <= high * high)
    observed = _area(seen.direction[pole], seen.direction[k], seen.direction[m])
    known = _area(t.guide[a], t.guide[b], t.guide[c])
    thin = np.abs(observed) <= (allowed * chord) >> _AREA_SHIFT
    agree &= thin | ((observed > 0) == (known > 0))
    x, y = x[agree], y[agree]
    pairs = np.unique(np.stack([x, sorted_[y, 0]], axis=1), axis=0)  # a neighbour counts once
    agreeing = np.bincount(pairs[:, 0], minlength=len(sorted_)) + 1
    with_ = np.full(len(sorted_), -1, np.int64)
    with_[pairs[::-1, 0]] = pairs[::-1, 1]  # the nearest one that agrees
    good = np.flatnonzero(agreeing >= search.need)
    # of each guide star the vote with most agreeing ones, of equal ones that of the farthest neighbour
    best = good[np.lexsort((good, -sorted_[good, 0], -agreeing[good], sorted_[good, 2]))]
    best = best[np.unique(sorted_[best, 2], return_index=True)[1]]
    columns = near.star[sorted_[best, 0]], sorted_[best, 2], sorted_[best, 1], near.star[with_[best]], agreeing[best]
    return np.stack(columns, axis=1), compared


def _same_star(star: IntArray) -> tuple[IntArray, IntArray]:
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
