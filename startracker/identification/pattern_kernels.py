"""Kernels of the pattern search: image patterns in order of brightness, their bins, and what they lead to."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker.catalog.sky_view import SkyView
from startracker.catalog.voxels import star_within
from startracker.identification.pattern_geometry import correspondence, pattern_attitude
from startracker.identification.pattern_table import (
    BINS,
    EMPTY,
    SIZE_STEPS,
    PatternTable,
    chord,
    home_slot,
    sorted_edges,
)
from startracker.kernels import kernel

__all__ = ["PatternFinds", "Plan", "lookup_shape", "next_set", "search_patterns"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SIGMAS = 2.3
"""Half width of the tolerance in standard errors of an edge: of many patterns some may be missed."""
DRIFT = 1e-4
"""What aberration changes of edges and ratios, at most."""
WIDEST = 0.04
"""Tolerance of a ratio beyond which a pattern is too small to be looked up."""
_MOST_LOOKED = 24
_GATE_SIGMAS = 5.0
_SURE_SHAPE = 3.0
_FOCAL_SIGMAS = 4.0
_SET_COST, _PROBE_COST, _CHECK_COST, _HITS_COST = 40.0, 4.0, 60.0, 2500.0


class Plan(NamedTuple):
    """Limits of one search.

    Parameters
    ----------
    multiple : float
        Of the stated errors.
    focal_range : float
        Largest relative error of the focal length.
    most : int
        Stars, brightest first, that make patterns.
    work : float
        Nanoseconds at most, about.
    passing, strong : float
        ln of the chance of a candidate's hits below which it is kept, and below which the search stops to verify it.
    prior : (3, 3)
        Attitude known beforehand.
    prior_cosine : float
        Of the largest rotation away from it; −2: there is no prior.
    """

    multiple: float
    focal_range: float
    most: int
    work: float
    passing: float
    strong: float
    prior: FloatArray
    prior_cosine: float


class PatternFinds(NamedTuple):
    """Candidates: ln of the chance of their hits (H,), attitude (H, 3, 3), factor of the focal length (H,)."""

    score: FloatArray
    matrix: FloatArray
    focal: FloatArray


@kernel
def next_set(stars: IntArray) -> None:
    """Go on to the next set of four (ascending), the faintest star changing last, so that the brightest come first."""
    for i in range(4):
        if i == 3 or stars[i] + 1 < stars[i + 1]:
            stars[i] += 1
            for j in range(i):
                stars[j] = j
            return


@kernel
def lookup_shape(
    edges: FloatArray, tolerance: float, focal_range: float, table: PatternTable, found: IntArray
) -> tuple[int, int]:
    """Slots of the patterns that may agree with six ascending edges (6,), from all bins within the tolerance.

    Parameters
    ----------
    edges : (6,)
        Ascending chords.
    tolerance : float
        Of each ratio.
    focal_range : float
        The largest edges agree within this and the tolerance.
    table : PatternTable
    found : (M,)
        Gets the slots.

    Returns
    -------
    How many were found, and how many slots were looked at.
    """
    low, high, at = np.empty(5, np.int64), np.empty(5, np.int64), np.empty(5, np.int64)
    for k in range(5):
        ratio = edges[k] / edges[5]
        low[k] = min(max(int((ratio - tolerance) * BINS), 0), BINS - 1)
        high[k] = max(min(int((ratio + tolerance) * BINS), BINS - 1), low[k])
        at[k] = low[k]
    per_size = SIZE_STEPS / table.largest
    slack = focal_range + tolerance
    smallest, biggest = edges[5] * (1.0 - slack) * per_size - 1.0, edges[5] * (1.0 + slack) * per_size + 1.0
    slots = len(table.keys)
    count, looked = 0, 0
    while True:
        if at[0] <= at[1] <= at[2] <= at[3] <= at[4]:
            key = (((at[0] * BINS + at[1]) * BINS + at[2]) * BINS + at[3]) * BINS + at[4]
            slot = home_slot(key, slots)
            while table.keys[slot] != EMPTY:
                looked += 1
                if table.keys[slot] == key and smallest <= table.sizes[slot] <= biggest and count < len(found):
                    found[count] = slot
                    count += 1
                slot = slot + 1 if slot + 1 < slots else 0
            looked += 1
        k = 4
        while k >= 0 and at[k] == high[k]:
            at[k] = low[k]
            k -= 1
        if k < 0:
            return count, looked
        at[k] += 1


@kernel
def _zoomed(vectors: FloatArray, factor: float) -> FloatArray:
    """Directions with their angle to the axis divided by a factor: what a focal length that much longer sees."""
    out = np.empty_like(vectors)
    for i in range(len(vectors)):
        x, y, z = vectors[i, 0], vectors[i, 1], vectors[i, 2]
        across = math.hypot(x, y)
        angle = math.atan2(across, z) / factor
        ratio = math.sin(angle) / across if across > 1e-12 else 1.0
        out[i, 0], out[i, 1], out[i, 2] = x * ratio, y * ratio, math.cos(angle)
    return out


@kernel
def _log_chance(hits: int, looked: int, share: float) -> float:
    """ln of Chernoff's bound on so many hits of so many stars, each with probability `share` (Poisson)."""
    mean = max(looked * share, 1e-12)
    return hits * math.log(mean / hits) + hits - mean if hits > mean else 0.0


@kernel
def _hits(
    matrix: FloatArray, vectors: FloatArray, gate: FloatArray, a: int, b: int, c: int, d: int, sky: SkyView
) -> tuple[int, int]:
    """How many of the brightest stars but a, b, c, d have a guide star in their gate, and how many were looked at."""
    hits, looked = 0, 0
    for i in range(len(vectors)):
        if i in (a, b, c, d):
            continue
        if looked == _MOST_LOOKED:
            break
        v = vectors[i]
        x = matrix[0, 0] * v[0] + matrix[1, 0] * v[1] + matrix[2, 0] * v[2]
        y = matrix[0, 1] * v[0] + matrix[1, 1] * v[1] + matrix[2, 1] * v[2]
        z = matrix[0, 2] * v[0] + matrix[1, 2] * v[1] + matrix[2, 2] * v[2]
        if star_within(x, y, z, gate[i] ** 2, sky.directions, sky.grid):
            hits += 1
        looked += 1
    return hits, looked


@kernel
def _guides(slot: int, table: PatternTable, sky: SkyView, out: FloatArray) -> None:
    """Directions (4, 3) of a pattern's guide stars."""
    for i in range(4):
        star = table.members[table.stars[slot, i]]
        for axis in range(3):
            out[i, axis] = sky.directions[star, axis]


@kernel
def _is_known(matrix: FloatArray, known: FloatArray, least_cosine: float) -> bool:
    """Whether an attitude is one of those (K, 3, 3), within a rotation of some cosine."""
    closest = -1.0
    for m in range(len(known)):
        closest = max(closest, _cosine_between(matrix, known[m]))
    return closest > least_cosine


@kernel
def search_patterns(
    vectors: FloatArray,
    sigma: FloatArray,
    table: PatternTable,
    sky: SkyView,
    plan: Plan,
    stars: IntArray,
    known: FloatArray,
    finds: PatternFinds,
) -> tuple[int, int, float]:
    """Look image patterns up, from the set `stars` on, until a strong candidate is met or the work is done.

    Parameters
    ----------
    vectors, sigma : (N, 3), (N,)
        Observed stars, brightest first.
    stars : (4,)
        The set to begin with; moved on.
    known : (K, 3, 3)
        Attitudes that are verified already, passed over.
    finds : PatternFinds
        Gets the best candidates.

    Returns
    -------
    Candidates found, patterns looked up, work left over (0 or less: used up; the sets may be, too).
    """
    most = min(plan.most, len(vectors))
    edge = np.empty((most, most))
    for i in range(most):
        for j in range(i):
            edge[i, j] = edge[j, i] = chord(vectors[i], vectors[j])
    edges, order, found = np.empty(6), np.empty(4, np.int64), np.empty(512, np.int64)
    mine, theirs, zoomed, ordered = np.empty((4, 3)), np.empty((4, 3)), np.empty((4, 3)), np.empty((4, 3))
    gate = _GATE_SIGMAS * plan.multiple * sigma
    count, patterns, work = 0, 0, plan.work
    while stars[3] < most and work > 0.0:
        a, b, c, d = stars[0], stars[1], stars[2], stars[3]
        next_set(stars)
        work -= _SET_COST
        sorted_edges(edge[a, b], edge[a, c], edge[a, d], edge[b, c], edge[b, d], edge[c, d], edges)
        error = math.sqrt(2.0) * plan.multiple * max(sigma[a], sigma[b], sigma[c], sigma[d])
        tolerance = SIGMAS * error * 1.2 / edges[5] + DRIFT
        if not (np.isfinite(edges).all() and tolerance < WIDEST and edges[0] > 2.0 * error):
            continue
        patterns += 1
        candidates, looked = lookup_shape(edges, tolerance, plan.focal_range, table, found)
        work -= _PROBE_COST * looked + _CHECK_COST * candidates
        mine[0], mine[1], mine[2], mine[3] = vectors[a], vectors[b], vectors[c], vectors[d]
        for k in range(candidates):
            _guides(found[k], table, sky, theirs)
            limit = SIGMAS * error + DRIFT * edges[5]
            scale = correspondence(mine, theirs, limit, _SURE_SHAPE * error * edges[5], order)
            if scale == 0.0 or abs(scale - 1.0) > plan.focal_range + tolerance:
                continue
            work -= _HITS_COST
            focal = scale if abs(scale - 1.0) > _FOCAL_SIGMAS * error / (2.0 * edges[5]) else 1.0
            seen = vectors if focal == 1.0 else _zoomed(vectors, focal)
            for i, star in enumerate((a, b, c, d)):
                for axis in range(3):
                    zoomed[i, axis] = seen[star, axis]
                    ordered[i, axis] = theirs[order[i], axis]
            matrix = pattern_attitude(zoomed, ordered)
            if plan.prior_cosine > -1.5 and _cosine_between(matrix, plan.prior) < plan.prior_cosine:
                continue
            if _is_known(matrix, known, math.cos(8.0 * gate[d])):
                continue
            hits, others = _hits(matrix, seen, gate, a, b, c, d, sky)
            score = _log_chance(hits, others, 0.25 * gate[d] ** 2 * len(sky.directions))
            if score > plan.passing:
                continue
            count = _keep(finds, count, score, matrix, focal)
            if score < plan.strong:
                return count, patterns, work
    return count, patterns, work


@kernel
def _cosine_between(matrix: FloatArray, other: FloatArray) -> float:
    """Cosine of the rotation between two attitudes."""
    trace = 0.0
    for i in range(3):
        for j in range(3):
            trace += matrix[i, j] * other[i, j]
    return 0.5 * (trace - 1.0)


@kernel
def _keep(finds: PatternFinds, count: int, score: float, matrix: FloatArray, focal: float) -> int:
    """Add a candidate; where there is no room the worst gives way. An attitude that repeats one keeps the better."""
    at = count
    for k in range(count):
        if _cosine_between(matrix, finds.matrix[k]) > 0.99999:
            if finds.score[k] <= score:
                return count
            at = k
            break
    else:
        if count == len(finds.score):
            at = int(np.argmax(finds.score))
            if finds.score[at] <= score:
                return count
    finds.score[at], finds.matrix[at], finds.focal[at] = score, matrix, focal
    return max(count, at + 1)
