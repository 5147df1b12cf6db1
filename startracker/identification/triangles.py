"""Kernels that find triangles of observed stars among the guide stars.

For an observed triangle (i, j, k) with i opposite its longest side, the guide pairs of the two shorter sides are looked
up in the sorted list and joined at the star of i; the longest side, the orientation and the brightnesses are checked as
well. The two stars of the longest side are the candidate, which the other stars confirm (`other_stars`).

If the focal length may be wrong, all sides may be longer or shorter by a common factor: the ranges are wider by it, and
the sides must agree on the factor.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker._compiled import kernel, kernel_part
from startracker.core import FloatArray, Int32Array, IntArray
from startracker.geometry.linalg import triple_product
from startracker.identification.search_state import Candidates, Guides, Limits, Pairs, Stars
from startracker.sorting import order_of

PAIR_SIGMAS = 3.7
"""Standard errors within which a true side is measured: 2e-4 of them are lost, and there are other triangles."""
ABERRATION = 1.02e-4
"""Relative error of a separation, because guide pairs do not include aberration."""
_BRIGHT = 9
_LEAST_SIDE = 0.12
"""Least longest side, as a share of the field's diagonal."""
_PAIR_WORK = 4.0
"""Operations, each of about a nanosecond, per guide pair examined."""


class _Triangle(NamedTuple):
    """An observed triangle.

    Its stars, with i opposite the longest side and i–k the shorter of the others; its sides and their tolerances, rad.
    """

    i: int
    j: int
    k: int
    ij: float
    ik: float
    jk: float
    error_ij: float
    error_ik: float
    error_jk: float


@kernel_part
def chord_angle(a: FloatArray, b: FloatArray) -> float:
    """Angle between two unit vectors, rad, from their chord, which is accurate for small angles."""
    x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    return 2.0 * math.asin(min(0.5 * math.sqrt(x * x + y * y + z * z), 1.0))


@kernel
def _first_of_at_least(ascending: NDArray[np.float32], value: np.float32) -> int:
    """Index of the first number that is at least `value`, by bisection; the length of the array if there is none."""
    low, high = 0, len(ascending)
    while low < high:
        middle = (low + high) // 2
        if ascending[middle] < value:
            low = middle + 1
        else:
            high = middle
    return low


@kernel_part
def window(separation: NDArray[np.float32], low: float, high: float) -> tuple[int, int]:
    """Half-open range of ascending separations between two limits."""
    return _first_of_at_least(separation, np.float32(low)), _first_of_at_least(separation, np.float32(high))


@kernel
def fits_prior(vector: FloatArray, guide: FloatArray, limits: Limits) -> bool:
    """Whether the prior allows a guide star at the direction of an observed star."""
    if limits.prior_cosine < -1.0:
        return True
    cosine = 0.0
    for axis in range(3):
        row = limits.prior[axis]
        cosine += vector[axis] * (row[0] * guide[0] + row[1] * guide[1] + row[2] * guide[2])
    fits: bool = cosine >= limits.prior_cosine
    return fits


@kernel
def first_triangles(vectors: FloatArray, diagonal_rad: float, count: int) -> IntArray:
    """Triangles (T, 3) of the brightest nine stars (N, 3), in the order in which they are searched fastest.

    The shorter the two shorter sides, the fewer guide pairs have their length, and the less often small triangles agree
    by chance. Triangles that are very small for a field of this diagonal determine the attitude poorly and come last.
    """
    n, at = min(len(vectors), _BRIGHT), 0
    total = n * (n - 1) * (n - 2) // 6
    triples, cost, order = np.empty((total, 3), np.int64), np.empty(total), np.empty(total, np.int64)
    side = np.empty((n, n))
    for k in range(n):
        for i in range(k):
            side[i, k] = chord_angle(vectors[i], vectors[k])
    for k in range(2, n):
        for i in range(k - 1):
            for j in range(i + 1, k):
                longest = max(side[i, j], side[j, k], side[i, k])
                cost[at] = side[i, j] + side[j, k] + side[i, k] - longest
                if longest < _LEAST_SIDE * diagonal_rad:
                    # Larger than any sum of two sides, so that these triangles come last.
                    cost[at] += 2.0 * math.pi
                triples[at, 0], triples[at, 1], triples[at, 2] = i, j, k
                at += 1
    order_of(cost, order)
    out = np.empty((min(count, total), 3), np.int64)
    for t in range(len(out)):
        for corner in range(3):
            out[t, corner] = triples[order[t], corner]
    return out


@kernel
def _triangle(triple: IntArray, stars: Stars, scale: float) -> _Triangle:
    i, j, k = triple
    ij = chord_angle(stars.vectors[i], stars.vectors[j])
    ik = chord_angle(stars.vectors[i], stars.vectors[k])
    jk = chord_angle(stars.vectors[j], stars.vectors[k])
    # Renumber the stars so that j–k is the longest side and i–k the shortest.
    if ij > jk and ij >= ik:
        i, k, ij, jk = k, i, jk, ij
    elif ik > jk:
        i, j, ik, jk = j, i, jk, ik
    if ik > ij:
        j, k, ij, ik = k, j, ik, ij
    sigma = scale * PAIR_SIGMAS
    error_ij = sigma * math.hypot(stars.sigma[i], stars.sigma[j]) + ABERRATION * ij
    error_ik = sigma * math.hypot(stars.sigma[i], stars.sigma[k]) + ABERRATION * ik
    error_jk = sigma * math.hypot(stars.sigma[j], stars.sigma[k]) + ABERRATION * jk
    return _Triangle(i, j, k, ij, ik, jk, error_ij, error_ik, error_jk)


@kernel
def _chained(
    pairs: Pairs, low: int, high: int, fainter_by: float, v_mag: FloatArray, tolerance: float, head: Int32Array
) -> tuple[Int32Array, Int32Array]:
    """Partners of each guide star in a range of pairs, as chains that begin at `head` (G,): the next link, the
    partner."""
    following, partner = np.empty(2 * (high - low) + 1, np.int32), np.empty(2 * (high - low) + 1, np.int32)
    filled = 0
    for p in range(low, high):
        a, b = pairs.first[p], pairs.second[p]
        step = v_mag[a] - v_mag[b]
        # Without branches, because the orientation in which a pair fits is unpredictable.
        known, fits = head[a], not abs(fainter_by - step) > tolerance
        following[filled], partner[filled] = known, b
        head[a] = filled if fits else known
        filled += fits
        known, fits = head[b], not abs(fainter_by + step) > tolerance
        following[filled], partner[filled] = known, a
        head[b] = filled if fits else known
        filled += fits
    return following, partner


@kernel_part
def _joined(
    pairs: Pairs, low: int, high: int, fainter_by: float, v_mag: FloatArray, tolerance: float, head: Int32Array
) -> tuple[Int32Array, Int32Array]:
    """Both stars of those pairs, in either orientation, whose first star has a chain at `head`."""
    at_i, at_j, count = np.empty(2 * (high - low) + 1, np.int32), np.empty(2 * (high - low) + 1, np.int32), 0
    for p in range(low, high):
        a, b = pairs.first[p], pairs.second[p]
        step = v_mag[a] - v_mag[b]
        # Each pair is written and counted only if it fits, which avoids unpredictable branches.
        at_i[count], at_j[count] = a, b
        count += (head[a] >= 0) & (not abs(fainter_by - step) > tolerance)
        at_i[count], at_j[count] = b, a
        count += (head[b] >= 0) & (not abs(fainter_by + step) > tolerance)
    return at_i[:count], at_j[:count]


@kernel_part
def _links(at: Int32Array, head: Int32Array, following: Int32Array) -> int:
    """Total number of links of the chains at some guide stars."""
    count = 0
    for star in at:
        link = head[star]
        while link >= 0:
            count, link = count + 1, following[link]
    return count


@kernel_part
def _with_room(found: Candidates, count: int, most: int) -> tuple[Int32Array, FloatArray]:
    """Copy of the first `count` candidates in arrays with room for `most`.

    Arrays that grew within the loops would be reference-counted at each step.
    """
    rows, focal = found
    if most > len(focal):
        rows, focal = np.empty((most, 5), np.int32), np.empty(most)
        for k in range(count):
            focal[k] = found.focal[k]
            for column in range(5):
                rows[k, column] = found.stars[k, column]
    return rows, focal


@kernel_part
def _focal_of(t: _Triangle, v: FloatArray, u: FloatArray, w: FloatArray) -> float:
    """ln of the focal-length factor by which a guide triangle has the observed size; NaN if its sides do not agree on
    one."""
    ij, ik = math.log(t.ij / chord_angle(v, u)), math.log(t.ik / chord_angle(v, w))
    jk = math.log(t.jk / chord_angle(u, w))
    error_ij, error_ik, error_jk = t.error_ij / t.ij, t.error_ik / t.ik, t.error_jk / t.jk
    if abs(ij - jk) > error_ij + error_jk or abs(ik - jk) > error_ik + error_jk or abs(ij - ik) > error_ij + error_ik:
        return math.nan
    return (ij * t.ij + ik * t.ik + jk * t.jk) / (t.ij + t.ik + t.jk)


@kernel
def _add_similar(
    t: _Triangle,
    stars: Stars,
    sky: Guides,
    pairs: Pairs,
    limits: Limits,
    head: Int32Array,
    found: Candidates,
    count: int,
) -> tuple[Int32Array, FloatArray, int, float]:
    """Add the guide triangles that an observed triangle may be; returns the arrays, the new number, and operations."""
    # Range of the true separations if the focal length differs from its nominal value by up to `focal_range`.
    shorter, longer = 1.0 / (1.0 + limits.focal_range), 1.0 / (1.0 - limits.focal_range)
    low_ik, high_ik = window(pairs.separation, (t.ik - t.error_ik) * shorter, (t.ik + t.error_ik) * longer)
    low_ij, high_ij = window(pairs.separation, (t.ij - t.error_ij) * shorter, (t.ij + t.error_ij) * longer)
    work = _PAIR_WORK * (2 * (high_ik - low_ik) + high_ij - low_ij)
    cos_low = math.cos(min((t.jk + t.error_jk) * longer, math.pi))
    cos_high = math.cos(max((t.jk - t.error_jk) * shorter, 0.0))
    seen = triple_product(stars.vectors[t.i], stars.vectors[t.j], stars.vectors[t.k])
    thin = t.error_jk * math.sin(t.jk)  # below this, the orientation is noise
    i_to_j, i_to_k = stars.magnitude[t.i] - stars.magnitude[t.j], stars.magnitude[t.i] - stars.magnitude[t.k]
    following, partner = _chained(pairs, low_ik, high_ik, i_to_k, sky.v_mag, limits.magnitude_tolerance, head)
    at_i, at_j = _joined(pairs, low_ij, high_ij, i_to_j, sky.v_mag, limits.magnitude_tolerance, head)
    rows, focal = _with_room(found, count, count + _links(at_i, head, following))
    for p in range(len(at_i)):
        a, b, link = at_i[p], at_j[p], head[at_i[p]]
        x, y, z = sky.directions[b, 0], sky.directions[b, 1], sky.directions[b, 2]
        while link >= 0:
            c, link = partner[link], following[link]
            work += _PAIR_WORK
            cosine = x * sky.directions[c, 0] + y * sky.directions[c, 1] + z * sky.directions[c, 2]
            if not cos_low <= cosine <= cos_high or c == b:
                continue
            v, u, w = sky.directions[a], sky.directions[b], sky.directions[c]
            # The orientation must agree unless noise may have changed it.
            if seen * triple_product(v, u, w) <= 0.0 and abs(seen) > thin:
                continue
            factor = _focal_of(t, v, u, w) if limits.focal_range > 0.0 else 0.0
            if math.isnan(factor) or not fits_prior(stars.vectors[t.i], v, limits):
                continue
            if not (fits_prior(stars.vectors[t.j], u, limits) and fits_prior(stars.vectors[t.k], w, limits)):
                continue
            row = rows[count]
            row[0], row[1], row[2], row[3], row[4], focal[count] = t.j, t.k, b, c, t.i, factor
            count += 1
        if work > limits.work:
            break
    # Only the chains that may have been begun are cleared, at less cost than all of `head`.
    for p in range(low_ik, high_ik):
        head[pairs.first[p]] = -1
        head[pairs.second[p]] = -1
    return rows, focal, count, work


@kernel
def similar_triangles(
    triples: IntArray, stars: Stars, sky: Guides, pairs: Pairs, limits: Limits, head: Int32Array
) -> tuple[Candidates, float]:
    """Guide triangles that triples (T, 3) of observed stars may be.

    Parameters
    ----------
    head : (G,)
        Scratch: all −1 on entry and on return.

    Returns
    -------
    The two stars of the longest side with their guide stars, and the third observed star; operations.
    """
    rows, focal, count, work = np.empty((0, 5), np.int32), np.empty(0), np.int64(0), 0.0
    for number in range(len(triples)):
        t = _triangle(triples[number], stars, limits.scale)
        if min(t.ij - t.error_ij, t.ik - t.error_ik) > 0.0 and work <= limits.work:
            rows, focal, count, cost = _add_similar(t, stars, sky, pairs, limits, head, Candidates(rows, focal), count)
            work += cost
    return Candidates(rows[:count], focal[:count]), work
