"""Kernels of the match groups: mark, collect, validate. Arrays in, arrays out.

A match group belongs to one (observed star, guide star) couple, its kernel; its members are the couples that stand at
the right separation from it. Couples are coded ``observed · G + guide``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from startracker.kernels import kernel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
WordArray = NDArray[np.uint64]

MAX_MEMBERS = 400


@kernel
def popcount(word: np.uint64) -> int:
    """Number of set bits of a 64-bit word."""
    count = 0
    while word != np.uint64(0):
        word &= word - np.uint64(1)
        count += 1
    return count


@kernel
def mark(
    i_obs: IntArray,
    j_obs: IntArray,
    low: IntArray,
    high: IntArray,
    first: IntArray,
    second: IntArray,
    magnitude: FloatArray,
    v_mag: FloatArray,
    tolerance_mag: float,
    allowed: BoolArray,
    partners: WordArray,
) -> None:
    """Set, for each couple, the bits of the observed stars that support it.

    Parameters
    ----------
    i_obs, j_obs : (P,)
        Observed stars of each observed pair.
    low, high : (P,)
        Window of each in the guide pairs.
    first, second : (L,)
        Guide stars of each guide pair.
    magnitude, v_mag : (N,), (G,)
        Observed and catalogued; only their differences within a pair are compared, so that no zero point is needed.
    allowed : (N, G) bool, or (0, 0)
        Couples that a prior lets through; empty: all.
    partners : (N, G) uint64
        Result, added to.
    """
    restricted = allowed.shape[0] > 0
    one = np.uint64(1)
    for p in range(i_obs.shape[0]):
        i, j = i_obs[p], j_obs[p]
        brighter = magnitude[i] - magnitude[j]
        bit_i, bit_j = one << np.uint64(i), one << np.uint64(j)
        for k in range(low[p], high[p]):
            a, b = first[k], second[k]
            step = v_mag[a] - v_mag[b]
            if abs(brighter - step) <= tolerance_mag and (not restricted or (allowed[i, a] and allowed[j, b])):
                partners[i, a] |= bit_j
                partners[j, b] |= bit_i
            if abs(brighter + step) <= tolerance_mag and (not restricted or (allowed[i, b] and allowed[j, a])):
                partners[i, b] |= bit_j
                partners[j, a] |= bit_i


@kernel
def group_sizes(partners: WordArray) -> IntArray:
    """Stars in each match group (N, G), kernel included; zero for none."""
    sizes = np.zeros(partners.shape, np.int64)
    for i in range(partners.shape[0]):
        for g in range(partners.shape[1]):
            if partners[i, g] != np.uint64(0):
                sizes[i, g] = popcount(partners[i, g]) + 1
    return sizes


@kernel
def collect(
    i_obs: IntArray,
    j_obs: IntArray,
    low: IntArray,
    high: IntArray,
    first: IntArray,
    second: IntArray,
    magnitude: FloatArray,
    v_mag: FloatArray,
    tolerance_mag: float,
    allowed: BoolArray,
    group: IntArray,
    count: int,
) -> tuple[IntArray, IntArray]:
    """Members of the groups kept, as rows of a sparse table: ``members[start[k]:start[k + 1]]`` for group k.

    `group` (N, G) numbers the groups kept, −1 for those discarded, which are left out as members too ("all match
    groups that are associated with any discarded match group are also removed"). Other parameters as in `mark`.
    """
    restricted = allowed.shape[0] > 0
    width = group.shape[1]
    start = np.zeros(count + 1, np.int64)
    members = np.empty(0, np.int64)
    filled = np.zeros(count, np.int64)
    for sweep in range(2):  # first count, then fill
        for p in range(i_obs.shape[0]):
            i, j = i_obs[p], j_obs[p]
            brighter = magnitude[i] - magnitude[j]
            for k in range(low[p], high[p]):
                for turn in range(2):
                    a, b = (first[k], second[k]) if turn == 0 else (second[k], first[k])
                    kernel, other = group[i, a], group[j, b]
                    if kernel < 0 or other < 0 or not abs(brighter - (v_mag[a] - v_mag[b])) <= tolerance_mag:
                        continue
                    if restricted and not (allowed[i, a] and allowed[j, b]):
                        continue
                    if sweep == 0:
                        start[kernel + 1] += 1
                        start[other + 1] += 1
                    else:
                        members[start[kernel] + filled[kernel]] = j * width + b
                        members[start[other] + filled[other]] = i * width + a
                        filled[kernel] += 1
                        filled[other] += 1
        if sweep == 0:
            start = np.cumsum(start)
            members = np.empty(start[count], np.int64)
    return start, members


@kernel
def _det(a: FloatArray, b: FloatArray, c: FloatArray) -> float:
    x, y, z = b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]
    product: float = a[0] * x + a[1] * y + a[2] * z
    return product


@kernel
def validate(
    kernel_obs: IntArray,
    kernel_guide: IntArray,
    start: IntArray,
    members: IntArray,
    vectors: FloatArray,
    directions: FloatArray,
    cos_low: FloatArray,
    cos_high: FloatArray,
    mirror_floor: FloatArray,
    min_stars: int,
) -> tuple[IntArray, FloatArray, IntArray]:
    """Mutual validation and mirror test: within each group the largest set whose members all support each other.

    Two members support each other when they are different observed and guide stars, stand at the right separation,
    and the triangle with the kernel turns the same way round in the image and in the sky. Greedy, from each member as
    the seed, partners with most support first; ties go to the smaller sum of squared separation errors.

    Parameters
    ----------
    kernel_obs, kernel_guide : (K,)
        Kernel of each group.
    start, members : from `collect`.
    vectors, directions : (N, 3), (G, 3)
        Unit vectors observed and of the guide stars.
    cos_low, cos_high : (N, N)
        Range of the cosine of the guide stars' separation for each observed pair.
    mirror_floor : (N, N)
        Triple product above which the sense of the triangle with that base can be told from noise.
    min_stars : int
        Smaller groups are not looked for.

    Returns
    -------
    size (K,), rss (K,) of the separations' errors (rad), guide star of each observed star or −1 (K, N).
    """
    groups, n, width = len(kernel_obs), vectors.shape[0], directions.shape[0]
    size = np.zeros(groups, np.int64)
    rss = np.full(groups, np.inf)
    found = np.full((groups, n), -1, np.int64)
    support = np.zeros((MAX_MEMBERS, MAX_MEMBERS), np.bool_)
    obs = np.empty(MAX_MEMBERS, np.int64)
    gid = np.empty(MAX_MEMBERS, np.int64)
    degree = np.empty(MAX_MEMBERS, np.int64)
    clique = np.empty(n, np.int64)
    for group in range(groups):
        o0, g0 = kernel_obs[group], kernel_guide[group]
        count = min(start[group + 1] - start[group], MAX_MEMBERS)
        if count + 1 < min_stars:
            continue
        for m in range(count):
            code = members[start[group] + m]
            obs[m], gid[m] = code // width, code % width
            degree[m] = 0
            support[m, m] = False
        for a in range(count):
            for b in range(a + 1, count):
                agree = False
                if obs[a] != obs[b] and gid[a] != gid[b]:
                    u, w = directions[gid[a]], directions[gid[b]]
                    cosine = u[0] * w[0] + u[1] * w[1] + u[2] * w[2]
                    if cos_low[obs[a], obs[b]] <= cosine <= cos_high[obs[a], obs[b]]:
                        seen = _det(vectors[o0], vectors[obs[a]], vectors[obs[b]])
                        real = _det(directions[g0], u, w)
                        agree = seen * real > 0.0 or abs(seen) < mirror_floor[obs[a], obs[b]]
                support[a, b] = agree
                support[b, a] = agree
                if agree:
                    degree[a] += 1
                    degree[b] += 1
        order = np.argsort(-degree[:count], kind="mergesort")
        for seed in order:
            if degree[seed] + 2 < max(min_stars, size[group]):
                break
            clique[0] = seed
            length = 1
            for m in order:
                if length >= n:
                    break
                fits = m != seed
                for c in range(length):
                    if not support[m, clique[c]]:
                        fits = False
                        break
                if fits:
                    clique[length] = m
                    length += 1
            if length + 1 < max(min_stars, size[group]):
                continue
            total = 0.0
            for a in range(-1, length):
                oa, ga = (o0, g0) if a < 0 else (obs[clique[a]], gid[clique[a]])
                for b in range(a + 1, length):
                    ob, gb = obs[clique[b]], gid[clique[b]]
                    seen_chord, real_chord = 0.0, 0.0
                    for axis in range(3):
                        seen_chord += (vectors[oa, axis] - vectors[ob, axis]) ** 2
                        real_chord += (directions[ga, axis] - directions[gb, axis]) ** 2
                    total += (np.sqrt(seen_chord) - np.sqrt(real_chord)) ** 2
            if length + 1 > size[group] or total < rss[group]:
                size[group], rss[group] = length + 1, total
                found[group, :] = -1
                found[group, o0] = g0
                for a in range(length):
                    found[group, obs[clique[a]]] = gid[clique[a]]
    return size, np.sqrt(rss), found
