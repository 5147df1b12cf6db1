"""Kernels of the match groups: mark, collect, validate.

A match group belongs to one couple (observed star, guide star), its kernel; its members are the couples at the right
separation from it. Couples are coded as ``observed · G + guide``.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker._compiled import kernel, kernel_part
from startracker.core import BoolArray, FloatArray, IntArray
from startracker.geometry.linalg import triple_product

WordArray = NDArray[np.uint64]

MAX_MEMBERS = 400


class Windows(NamedTuple):
    """Observed pairs, each with its range of guide pairs of similar separation.

    Parameters
    ----------
    i, j : (P,)
        Observed stars of each observed pair.
    low, high : (P,)
        Half-open range of each in the guide pairs.
    first, second : (L,)
        Guide stars of each guide pair.
    magnitude, v_mag : (N,), (G,)
        Observed and catalogued magnitudes; only their differences within a pair are compared, which needs no zero
        point.
    tolerance_mag : float
    allowed : (N, G) bool, or (0, 0)
        Couples that a prior allows; if empty, all.
    """

    i: IntArray
    j: IntArray
    low: IntArray
    high: IntArray
    first: NDArray[np.int32]
    second: NDArray[np.int32]
    magnitude: FloatArray
    v_mag: FloatArray
    tolerance_mag: float
    allowed: BoolArray


class Groups(NamedTuple):
    """Match groups that are not discarded: observed and guide star (K,) of each kernel, and its members.

    The members of group k are ``members[start[k]:start[k + 1]]``.
    """

    observed: IntArray
    guide: IntArray
    start: IntArray
    members: IntArray


class Shapes(NamedTuple):
    """Geometry by which the members of a group are compared.

    Parameters
    ----------
    vectors, directions : (N, 3), (G, 3)
        Unit vectors observed and of the guide stars.
    cos_low, cos_high : (N, N)
        Range of the cosine of the guide stars' separation for each observed pair, from the tolerance.
    mirror_floor : (N, N)
        Triple product above which the orientation of the triangle with that base is significant.
    """

    vectors: FloatArray
    directions: FloatArray
    cos_low: FloatArray
    cos_high: FloatArray
    mirror_floor: FloatArray


class _Group(NamedTuple):
    """Scratch arrays: observed and guide star of each member, number of supporting members, support matrix, and the
    members in descending order of support."""

    observed: IntArray
    guide: IntArray
    degree: IntArray
    support: BoolArray
    order: IntArray


@kernel_part
def _agree(w: Windows, brighter: float, i: int, a: int, j: int, b: int) -> bool:
    """Whether the brightnesses of two couples agree and a prior allows both."""
    fits: bool = abs(brighter - (w.v_mag[a] - w.v_mag[b])) <= w.tolerance_mag
    return fits and (len(w.allowed) == 0 or (w.allowed[i, a] and w.allowed[j, b]))


@kernel
def mark(w: Windows, partners: WordArray) -> None:
    """Set, for each couple (N, G), the bits of the observed stars that support it."""
    one = np.uint64(1)
    for p in range(len(w.i)):
        i, j, brighter = w.i[p], w.j[p], w.magnitude[w.i[p]] - w.magnitude[w.j[p]]
        # One bit of a 64-bit word for each observed star.
        bit_i, bit_j = one << np.uint64(i), one << np.uint64(j)
        for k in range(w.low[p], w.high[p]):
            # A guide pair can match an observed pair in either order.
            for turn in range(2):
                a, b = (w.first[k], w.second[k]) if turn == 0 else (w.second[k], w.first[k])
                if _agree(w, brighter, i, a, j, b):
                    partners[i, a] |= bit_j
                    partners[j, b] |= bit_i


def group_sizes(partners: WordArray) -> IntArray:
    """Number of stars in each match group (N, G) including the kernel; zero for none."""
    supporting = np.bitwise_count(partners).astype(np.int64)
    return np.where(supporting > 0, supporting + 1, 0)


@kernel
def collect(w: Windows, group: IntArray, count: int) -> tuple[IntArray, IntArray]:
    """Members of the groups, as rows of a sparse table: ``members[start[k]:start[k + 1]]`` for group k.

    `group` (N, G) numbers the groups, −1 for those discarded, which are excluded as members too ("all match groups that
    are associated with any discarded match group are also removed").
    """
    width = group.shape[1]
    start, filled, members = np.zeros(count + 1, np.int64), np.zeros(count, np.int64), np.empty(0, np.int64)
    for sweep in range(2):  # first count, then fill
        for p in range(len(w.i)):
            i, j, brighter = w.i[p], w.j[p], w.magnitude[w.i[p]] - w.magnitude[w.j[p]]
            for k in range(w.low[p], w.high[p]):
                for turn in range(2):
                    a, b = (w.first[k], w.second[k]) if turn == 0 else (w.second[k], w.first[k])
                    kernel, other = group[i, a], group[j, b]
                    if kernel < 0 or other < 0 or not _agree(w, brighter, i, a, j, b):
                        continue
                    if sweep == 1:
                        members[start[kernel] + filled[kernel]] = j * width + b
                        members[start[other] + filled[other]] = i * width + a
                    filled[kernel] += 1
                    filled[other] += 1
        for k in range(count if sweep == 0 else 0):
            start[k + 1] = start[k] + filled[k]
            filled[k] = 0
        if sweep == 0:
            members = np.empty(start[count], np.int64)
    return start, members


@kernel
def _fill(group: _Group, count: int, seen: IntArray, shapes: Shapes) -> None:
    """Determine which members of a group support each other, given the kernel's observed and guide star `seen` (2,)."""
    obs, gid = group.observed, group.guide
    for a in range(count):
        group.degree[a], group.support[a, a] = 0, False
    for a in range(count):
        for b in range(a + 1, count):
            agree = False
            if obs[a] != obs[b] and gid[a] != gid[b]:
                u, w = shapes.directions[gid[a]], shapes.directions[gid[b]]
                cosine = u[0] * w[0] + u[1] * w[1] + u[2] * w[2]
                if shapes.cos_low[obs[a], obs[b]] <= cosine <= shapes.cos_high[obs[a], obs[b]]:
                    turn = triple_product(shapes.vectors[seen[0]], shapes.vectors[obs[a]], shapes.vectors[obs[b]])
                    real = triple_product(shapes.directions[seen[1]], u, w)
                    # Orientations that noise may have changed are not compared.
                    agree = turn * real > 0.0 or abs(turn) < shapes.mirror_floor[obs[a], obs[b]]
            group.support[a, b] = group.support[b, a] = agree
            group.degree[a] += agree
            group.degree[b] += agree
    # Insertion sort in descending order of support, stable.
    for last in range(count):
        at = last
        while at > 0 and group.degree[last] > group.degree[group.order[at - 1]]:
            group.order[at] = group.order[at - 1]
            at -= 1
        group.order[at] = last


@kernel_part
def _clique(group: _Group, count: int, seed: int, clique: IntArray) -> int:
    """Grow a set of members that all support each other from a seed, best supported first; returns its size."""
    clique[0], length = seed, 1
    for at in range(count):
        m = group.order[at]
        fits = m != seed and length < len(clique)
        for c in range(length):
            fits = fits and group.support[m, clique[c]]
        if fits:
            clique[length] = m
            length += 1
    return length


@kernel_part
def _square_sum(pairs: IntArray, shapes: Shapes) -> float:
    """Sum of the squared differences of chords between couples (M, 2), rad²."""
    total = 0.0
    for a in range(len(pairs)):
        for b in range(a + 1, len(pairs)):
            seen, real = 0.0, 0.0
            for axis in range(3):
                seen += (shapes.vectors[pairs[a, 0], axis] - shapes.vectors[pairs[b, 0], axis]) ** 2
                real += (shapes.directions[pairs[a, 1], axis] - shapes.directions[pairs[b, 1], axis]) ** 2
            total += (math.sqrt(seen) - math.sqrt(real)) ** 2
    return total


@kernel
def validate(groups: Groups, shapes: Shapes, min_stars: int) -> tuple[IntArray, FloatArray, IntArray]:
    """Mutual validation and mirror test: in each group, the largest set of members that all support each other.

    Two members support each other if they are different observed and guide stars, have the right separation, and form a
    triangle with the kernel of the same orientation in the image and in the sky. The search is greedy: from each member
    as the seed, members are added in the order of their support; ties are resolved by the smaller sum of squared errors
    of separation. Groups of fewer than `min_stars` are not searched for.

    Returns
    -------
    size (K,), rss (K,) of the separations' errors (rad), guide star of each observed star or −1 (K, N).
    """
    count_of, n, width = len(groups.observed), len(shapes.vectors), len(shapes.directions)
    size, rss, found = np.zeros(count_of, np.int64), np.full(count_of, np.inf), np.full((count_of, n), -1, np.int64)
    most = MAX_MEMBERS
    group = _Group(
        np.empty(most, np.int64),
        np.empty(most, np.int64),
        np.empty(most, np.int64),
        np.zeros((most, most), np.bool_),
        np.empty(most, np.int64),
    )
    clique, pairs = np.empty(n, np.int64), np.empty((n + 1, 2), np.int64)
    for g in range(count_of):
        count = min(groups.start[g + 1] - groups.start[g], most)
        if count + 1 < min_stars:
            continue
        pairs[0, 0], pairs[0, 1] = groups.observed[g], groups.guide[g]
        for m in range(count):
            # `collect` stores a couple as one number: observed star times `width` plus guide star.
            code = groups.members[groups.start[g] + m]
            group.observed[m], group.guide[m] = code // width, code % width
        _fill(group, count, pairs[0], shapes)
        for at in range(count):
            seed = group.order[at]
            # The rest have even less support and cannot form a larger group.
            if group.degree[seed] + 2 < max(min_stars, size[g]):
                break
            length = _clique(group, count, seed, clique) + 1
            if length < max(min_stars, size[g]):
                continue
            for m in range(1, length):
                pairs[m, 0], pairs[m, 1] = group.observed[clique[m - 1]], group.guide[clique[m - 1]]
            total = _square_sum(pairs[:length], shapes)
            if length > size[g] or total < rss[g]:
                size[g], rss[g] = length, total
                found[g, :] = -1
                for m in range(length):
                    found[g, pairs[m, 0]] = pairs[m, 1]
    return size, np.sqrt(rss), found
