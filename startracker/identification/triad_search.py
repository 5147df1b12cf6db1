"""Triads of catalogue stars for every three image stars, tested and grouped (Yee 1999, sections 2.3.4.1 to 2.3.4.3).

One algorithm for every `Arithmetic`. The grouping may depend on the order of the triads, which the C export repeats. So
the order does not depend on how they were found: image triangles are in the order 1-2-3, 1-2-4, ..., and the triads of
one triangle in the order of the sub-catalogue indices of their first, then their second, then their third star.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from startracker._compiled import kernel
from startracker.core import IntArray
from startracker.identification.arithmetic import Arithmetic, Numbers
from startracker.identification.triad_tables import TriadTables

_PAIR_WORK, _TRIAD_WORK = 20.0, 2000.0
"""Operations per catalogue pair within a range, and per triad."""


@dataclass(frozen=True)
class TriadLimits:
    """Thresholds of the method; the defaults are those for the Vega image (Yee 1999, section 4.2.1).

    Parameters
    ----------
    separation_tolerance_deg : float or sequence of float
        Largest difference between a measured and a catalogued separation: one for all, or one for each pair of image
        stars in the order 1-2, 1-3, ..., 2-3, ...
    rotation_tolerance_deg : float
        Largest difference between the two rotations of a triad.
    enclosed_tolerance_deg : float or None
        Largest difference of an inner angle; None omits the test, as her program on the MC68360 does.
    grouping_tolerance_deg : float
        Largest difference of a triad's mean rotation from the running mean of its group.
    vote_number : int or None
        Fewest triads of a group that must name a catalogue star; None: depending on the number of image stars
        (`votes_needed`), as her section 5.2 recommends.
    combine_px : float
        Catalogue stars closer than this in the image are merged: her τ.
    three_stars : bool
        If only three stars are observed and one group is found, one vote is sufficient (her section 5.2).
    reprocess_multiples : bool
        Stars that are merged in the image are also merged in the triads before votes are counted, so that a triad which
        names one of them and another triad which names the other are not two votes (her section 5.2). False:
        frequencies are summed, as in her program.
    most_operations : int, optional
        Operations after which the search ends: pairs compared, and triads found (some 2,000 each).
    """

    separation_tolerance_deg: float | tuple[float, ...] = 0.15
    rotation_tolerance_deg: float = 5.0
    enclosed_tolerance_deg: float | None = 1.0
    grouping_tolerance_deg: float = 5.0
    vote_number: int | None = 2
    combine_px: float = 8.0
    three_stars: bool = False
    reprocess_multiples: bool = False
    most_operations: int | None = None

    def votes_needed(self, stars: int) -> int:
        """Fewest votes for a match among this number of image stars.

        A star is part of (n − 1)(n − 2)/2 of the triangles of n stars; a tenth of these must name it, at least two: 2
        for up to 7 stars, 3 for 8 or 9, 6 for 12.
        """
        if self.vote_number is not None:
            return self.vote_number
        return max(2, math.ceil((stars - 1) * (stars - 2) / 20.0))

    def pair_tolerances(self, arithmetic: Arithmetic, count: int) -> Numbers:
        """Tolerances (count,) of the pairs in the arithmetic's format."""
        fixed = self.separation_tolerance_deg
        each = fixed if isinstance(fixed, tuple) else (fixed,) * count
        return np.array([arithmetic.separation_of(value) for value in each])


@dataclass(frozen=True, eq=False)
class Triads:
    """Catalogue triads that passed every test, in the order in which they were found.

    Parameters
    ----------
    stars : int (T, 3)
        Image stars.
    catalog : int (T, 3)
        Index in the sub-catalogue of the star that each image star may be.
    rotations : (T, 2)
        Angles that rotate the vectors 1-2 and 1-3 of the image onto those of the catalogue, in the arithmetic's format.
    group : int (T,)
        Group of each triad, numbered from 0 in the order of their first members.
    group_rotations : (K,)
        Mean rotation of each group.
    operations : int
        Number of operations of the search.
    complete : bool
        False if the search was ended by `TriadLimits.most_operations`.
    """

    stars: IntArray
    catalog: IntArray
    rotations: Numbers
    group: IntArray
    group_rotations: Numbers
    operations: int = 0
    complete: bool = True

    def __len__(self) -> int:
        return len(self.group)

    @property
    def group_sizes(self) -> IntArray:
        """Number of triads in each group (K,)."""
        return np.bincount(self.group, minlength=len(self.group_rotations))


def image_pairs(count: int) -> tuple[IntArray, IntArray]:
    """Pairs i < j of `count` image stars in the order 1-2, 1-3, ..., 2-3, ..."""
    i, j = np.triu_indices(count, 1)
    return i.astype(np.int64), j.astype(np.int64)


class _Side(NamedTuple):
    """Catalogue pairs that one image pair may be, in both orientations: partners of each star, ascending."""

    begin: IntArray  # (stars + 1,) where each star's partners begin
    partner: IntArray


def _side(tables: TriadTables, low: int, high: int) -> _Side:
    first, second = tables.first[low:high], tables.second[low:high]
    stars = max(len(tables), 1)
    codes = np.sort(np.concatenate([first * stars + second, second * stars + first]))
    return _Side(np.searchsorted(codes, stars * np.arange(stars + 1)), codes % stars)


@kernel
def join_sides(one: _Side, two: _Side, three: _Side, work: float = math.inf) -> tuple[IntArray, float]:
    """Catalogue triads (K, 3), ascending, whose sides are among the pairs for the image's sides 1-2, 1-3 and 2-3.

    For each pair (a, b) of side 1-2, the partners of a in 1-3 and those of b in 2-3 are two ascending lists; an element
    common to both completes the triad. The search ends when `work` operations are used up; the number left, which is
    returned too, is then negative.
    """
    out = np.empty((64, 3), np.int64)
    count = 0
    for a in range(len(one.begin) - 1):
        for k in range(one.begin[a], one.begin[a + 1]):
            b = one.partner[k]
            p, q = two.begin[a], three.begin[b]
            work -= _PAIR_WORK + two.begin[a + 1] - p + three.begin[b + 1] - q
            if work < 0.0:
                return out[:count].copy(), work
            while p < two.begin[a + 1] and q < three.begin[b + 1]:
                if two.partner[p] < three.partner[q]:
                    p += 1
                elif two.partner[p] > three.partner[q]:
                    q += 1
                else:
                    if count == len(out):
                        out = np.concatenate((out, np.empty_like(out)))
                    out[count, 0], out[count, 1], out[count, 2] = a, b, two.partner[p]
                    count += 1
                    p += 1
                    q += 1
                    work -= _TRIAD_WORK
    return out[:count].copy(), work


def find_triads(
    image: Any, stars: int, separations: Numbers, tables: TriadTables, limits: TriadLimits
) -> tuple[Triads, IntArray]:
    """Every catalogue triad that some three image stars may be, grouped by rotation.

    Parameters
    ----------
    image : object
        Image stars in the form that the tables' arithmetic uses.
    stars : int
        Number of the image stars, the first ones, that form triangles.
    separations : (P,)
        Separations of these, in the order of `image_pairs`.
    tables : TriadTables
        The sub-catalogue.
    limits : TriadLimits
        Thresholds.

    Returns
    -------
    triads : Triads
    pair_counts : int (P,)
        Number of catalogue pairs found for each image pair.
    """
    arithmetic = tables.arithmetic
    low, high = tables.windows(separations, limits.pair_tolerances(arithmetic, len(separations)))
    i, j = image_pairs(stars)
    most = math.inf if limits.most_operations is None else float(limits.most_operations)
    work = most - _PAIR_WORK * float(np.sum(high - low))
    if work < 0.0:
        i, j, low, high = i[:0], j[:0], low[:0], high[:0]
    sides = {(int(p), int(q)): _side(tables, int(a), int(b)) for p, q, a, b in zip(i, j, low, high, strict=True)}
    rotation_tolerance = arithmetic.angle_of(limits.rotation_tolerance_deg)
    found = []
    for p, q, r in combinations(range(stars), 3):
        if work < 0.0:
            break
        catalog, work = join_sides(sides[p, q], sides[p, r], sides[q, r], work)
        if not len(catalog):
            continue
        seen = np.broadcast_to(np.array([p, q, r]), catalog.shape)
        rotations = np.stack([_rotations(arithmetic, image, tables.sky, seen, catalog, to) for to in (1, 2)], axis=1)
        keep = arithmetic.angles_agree(rotations[:, 0], rotations[:, 1], rotation_tolerance)
        seen, catalog, rotations = seen[keep], catalog[keep], rotations[keep]
        if limits.enclosed_tolerance_deg is not None and len(catalog):
            tolerance = arithmetic.angle_of(limits.enclosed_tolerance_deg)
            # All triads of one call belong to the same image triangle, so its inner angles are computed once.
            inner = arithmetic.image_enclosed(image, *seen[:1].T)
            agree = [
                arithmetic.angles_agree(ours, theirs, tolerance)
                for ours, theirs in zip(inner, arithmetic.catalog_enclosed(tables.sky, *catalog.T), strict=True)
            ]
            keep = np.logical_and.reduce(agree)
            seen, catalog, rotations = seen[keep], catalog[keep], rotations[keep]
        found.append((seen, catalog, rotations))
    none = np.empty((0, 3), dtype=np.int64)
    found.append((none, none, np.empty((0, 2), dtype=np.asarray(arithmetic.angle_of(0.0)).dtype)))
    seen, catalog, rotations = (np.concatenate(parts) for parts in zip(*found, strict=True))
    group, means = _grouped(arithmetic, rotations, limits)
    operations = 0 if limits.most_operations is None else int(min(most - work, most))
    return Triads(seen, catalog, rotations, group, means, operations, work >= 0.0), high - low


def _rotations(arithmetic: Arithmetic, image: Any, sky: Any, seen: IntArray, catalog: IntArray, to: int) -> Numbers:
    return arithmetic.rotations(
        arithmetic.catalog_directions(sky, catalog[:, 0], catalog[:, to]),
        arithmetic.image_directions(image, seen[:1, 0], seen[:1, to]),
    )


def _grouped(arithmetic: Arithmetic, rotations: Numbers, limits: TriadLimits) -> tuple[IntArray, Numbers]:
    mean = arithmetic.mean_rotations(rotations[:, 0], rotations[:, 1])
    tolerance = arithmetic.angle_of(limits.grouping_tolerance_deg)
    group, origin, total, count = group_rotations(mean, tolerance, arithmetic.full_turn)
    means = [arithmetic.group_mean(o, t, int(n)) for o, t, n in zip(origin, total, count, strict=True)]
    return group, np.array(means, dtype=mean.dtype)


@kernel
def group_rotations(mean: Numbers, tolerance: Any, full_turn: Any) -> tuple[IntArray, Numbers, Numbers, IntArray]:
    """Assign angles one by one to groups: to the first group whose mean is within the tolerance, or else to a new one.

    A group's mean is origin + total/count, where the origin is its first member. The condition |angle − mean| ≤
    tolerance is evaluated as |count (angle − origin) − total| ≤ tolerance × count, which needs no division and is the
    same for integers.

    Parameters
    ----------
    mean : (T,)
        Angles in [0, full_turn), floating point or integer.
    tolerance, full_turn : number
        Of the same type as the angles.

    Returns
    -------
    group : int (T,)
    origin, total : (K,)
        Origin of each group, and sum of its members' differences from it.
    count : int (K,)
    """
    n = len(mean)
    group = np.empty(n, np.int64)
    origin, total = np.empty_like(mean), np.empty_like(mean)
    count = np.zeros(n, np.int64)
    groups = 0
    for t in range(n):
        found = -1
        # A zero of the type of the angles.
        step = mean[t] - mean[t]
        for g in range(groups):
            step = mean[t] - origin[g]
            # Differences are taken on the side of the circle where the group's mean is.
            off = step * count[g] - total[g]
            if 2 * off >= full_turn * count[g]:
                step -= full_turn
            elif 2 * off < -full_turn * count[g]:
                step += full_turn
            if abs(step * count[g] - total[g]) <= tolerance * count[g]:
                found = g
                break
        if found < 0:
            found = groups
            groups += 1
            origin[found] = mean[t]
            total[found] = step - step
            step = total[found]
        group[t] = found
        total[found] += step
        count[found] += 1
    return group, origin[:groups].copy(), total[:groups].copy(), count[:groups].copy()
