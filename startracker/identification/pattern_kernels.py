"""Kernels of the pattern search: image patterns in order of brightness, their bins, and the resulting candidates."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from startracker._compiled import kernel, kernel_part
from startracker.catalog.sky_view import SkyView, star_within
from startracker.core import FloatArray, IntArray
from startracker.estimation.directions import normal_equations, pair_rotation
from startracker.geometry.linalg import chord, rotate_back, rotated, solve, transform, triple_product
from startracker.identification.pattern_table import BINS, EMPTY, SIZE_STEPS, PatternTable, home_slot, sorted_edges
from startracker.identification.verification import is_known, rotation_cosine

SIGMAS = 2.3
"""Half width of the tolerance in standard errors of an edge: some of many patterns may be missed."""
DRIFT = 1e-4
"""Largest relative change of edges and ratios by aberration."""
WIDEST = 0.04
"""Tolerance of a ratio above which a pattern is too small to be looked up."""
_MOST_LOOKED = 24
_GATE_SIGMAS = 5.0
_SURE_SHAPE = 3.0
_FOCAL_SIGMAS = 4.0
_PERMUTATIONS = np.array(
    [[a, b, c, 6 - a - b - c] for a in range(4) for b in range(4) for c in range(4) if len({a, b, c}) == 3]
)
_SET_COST, _PROBE_COST, _CHECK_COST, _MATCH_COST = 40.0, 4.0, 60.0, 2500.0


class Plan(NamedTuple):
    """Limits of one search.

    Parameters
    ----------
    multiple : float
        Multiple of the stated errors.
    focal_range : float
        Largest relative error of the focal length.
    most : int
        Number of the brightest stars that form patterns.
    work : float
        Largest number of operations, of about a nanosecond each.
    passing, strong : float
        ln of the chance of a candidate's matches below which it is recorded, and below which it is verified at once.
    prior : (3, 3)
        A priori attitude.
    prior_cosine : float
        Cosine of the largest rotation away from it; −2 if there is no prior.
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
    """Candidates: ln of the chance of their matches (H,), attitude (H, 3, 3), factor of the focal length (H,)."""

    score: FloatArray
    matrix: FloatArray
    focal: FloatArray


@kernel_part
def next_set(stars: IntArray) -> None:
    """Advance to the next set of four (ascending); the faintest star changes last, so that the brightest come first."""
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
    """Slots of the patterns that may agree with six ascending edges, from all bins within the tolerance.

    Parameters
    ----------
    edges : (6,)
        Chords, ascending.
    tolerance : float
        Tolerance of each ratio.
    focal_range : float
        The largest edges agree within this and the tolerance.
    table : PatternTable
    found : (M,)
        Receives the slots.

    Returns
    -------
    Number of slots found, and number of slots that were read.
    """
    low, high, at = np.empty(5, np.int64), np.empty(5, np.int64), np.empty(5, np.int64)
    for k in range(5):
        ratio = edges[k] / edges[5]
        low[k] = min(max(int((ratio - tolerance) * BINS), 0), BINS - 1)
        high[k] = max(min(int((ratio + tolerance) * BINS), BINS - 1), low[k])
        at[k] = low[k]
    per_size = SIZE_STEPS / table.largest
    slack = focal_range + tolerance
    # Sizes in the table are rounded to whole steps; one step of margin on each side allows for it.
    smallest, biggest = edges[5] * (1.0 - slack) * per_size - 1.0, edges[5] * (1.0 + slack) * per_size + 1.0
    slots = len(table.keys)
    count, looked = 0, 0
    # Loops over all combinations of the five bins like an odometer; only ascending ratios occur in the table.
    while True:
        if at[0] <= at[1] <= at[2] <= at[3] <= at[4]:
            key = (((at[0] * BINS + at[1]) * BINS + at[2]) * BINS + at[3]) * BINS + at[4]
            slot = home_slot(key, slots)
            # Open addressing with linear probing: patterns of the same key follow up to an empty slot.
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
def correspondence(
    observed: FloatArray, reference: FloatArray, tolerance: float, sense: float, order: IntArray
) -> float:
    """Correspondence between a catalogue pattern (4, 3) and an observed one (4, 3), independent of scale.

    Of the 24 permutations, the one whose six edges all agree within the tolerance, with the smallest sum of squares, is
    written to `order` (4,). Mirror images are rejected: the largest of the four triangles must have the same
    orientation in both patterns, unless noise can change that orientation.

    Parameters
    ----------
    tolerance : float
        Tolerance of each edge.
    sense : float
        Least triple product (twice a triangle's area) whose sign is significant.

    Returns
    -------
    Ratio of the observed edges to the catalogue's; 0 if no permutation agrees.
    """
    mine, theirs = np.empty((4, 4)), np.empty((4, 4))
    total, other = 0.0, 0.0
    for i in range(4):
        for j in range(i):
            mine[i, j] = mine[j, i] = chord(observed[i], observed[j])
            theirs[i, j] = theirs[j, i] = chord(reference[i], reference[j])
            total += mine[i, j]
            other += theirs[i, j]
    scale = total / other
    best, best_order = np.inf, -1
    for p in range(24):
        rss = 0.0
        fits = True
        for i in range(4):
            for j in range(i):
                difference = abs(mine[i, j] - scale * theirs[_PERMUTATIONS[p, i], _PERMUTATIONS[p, j]])
                if difference > tolerance:
                    fits = False
                    break
                rss += difference * difference
            if not fits:
                break
        if fits and rss < best:
            best, best_order = rss, p
    if best_order < 0:
        return 0.0
    order[:] = _PERMUTATIONS[best_order]
    largest, mirrored = 0.0, False
    # The triangle of the three stars other than `left_out`.
    for left_out in range(4):
        a, b, c = (1 if left_out == 0 else 0), (2 if left_out <= 1 else 1), (3 if left_out <= 2 else 2)
        seen = triple_product(observed[a], observed[b], observed[c])
        if abs(seen) > largest:
            largest = abs(seen)
            mirrored = seen * triple_product(reference[order[a]], reference[order[b]], reference[order[c]]) < 0.0
    return 0.0 if mirrored and largest > sense else scale


@kernel
def pattern_attitude(observed: FloatArray, reference: FloatArray) -> FloatArray:
    """Least-squares rotation (3, 3) from reference to observed unit vectors, for about four pairs.

    The starting value comes from the two with the greatest separation; three Gauss–Newton steps follow.
    """
    n = len(observed)
    longest, a, b = -1.0, 0, 1
    for i in range(n):
        for j in range(i):
            d = chord(observed[i], observed[j])
            if d > longest:
                longest, a, b = d, j, i
    matrix: FloatArray = pair_rotation(observed, reference, a, b)
    predicted, every, sigma = np.empty((n, 3)), np.arange(n), np.ones(n)
    for _ in range(3):
        transform(matrix, reference, predicted)
        change = solve(*normal_equations(observed, observed, predicted, every, sigma, 3))
        matrix = rotated(matrix, change[0], change[1], change[2])
    return matrix


@kernel_part
def _zoomed(vectors: FloatArray, factor: float) -> FloatArray:
    """Directions with their angle to the axis divided by a factor, as for a focal length that is larger by this
    factor."""
    out = np.empty_like(vectors)
    for i in range(len(vectors)):
        x, y, z = vectors[i, 0], vectors[i, 1], vectors[i, 2]
        across = math.hypot(x, y)
        angle = math.atan2(across, z) / factor
        ratio = math.sin(angle) / across if across > 1e-12 else 1.0
        out[i, 0], out[i, 1], out[i, 2] = x * ratio, y * ratio, math.cos(angle)
    return out


@kernel_part
def _log_chance(matches: int, looked: int, share: float) -> float:
    """ln of Chernoff's bound on at least `matches` of `looked` stars matching, each with probability `share`
    (Poisson)."""
    mean = max(looked * share, 1e-12)
    return matches * math.log(mean / matches) + matches - mean if matches > mean else 0.0


@kernel_part
def _matches(
    matrix: FloatArray, vectors: FloatArray, gate: FloatArray, a: int, b: int, c: int, d: int, sky: SkyView
) -> tuple[int, int]:
    """Number of the brightest stars except a, b, c, d with a guide star in their gate, and number of stars examined."""
    matches, looked = 0, 0
    for i in range(len(vectors)):
        if i in (a, b, c, d):
            continue
        if looked == _MOST_LOOKED:
            break
        x, y, z = rotate_back(matrix, vectors[i])
        if star_within(x, y, z, gate[i] ** 2, sky.directions, sky.grid):
            matches += 1
        looked += 1
    return matches, looked


@kernel_part
def _guides(slot: int, table: PatternTable, sky: SkyView, out: FloatArray) -> None:
    """Directions (4, 3) of a pattern's guide stars."""
    for i in range(4):
        star = table.members[table.stars[slot, i]]
        for axis in range(3):
            out[i, axis] = sky.directions[star, axis]


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
    """Look up image patterns, from the set `stars` on, until a strong candidate is found or the work is used up.

    Parameters
    ----------
    vectors, sigma : (N, 3), (N,)
        Observed stars, brightest first.
    stars : (4,)
        The set to begin with; advanced in place.
    known : (K, 3, 3)
        Attitudes that have been verified already, which are skipped.
    finds : PatternFinds
        Receives the best candidates.

    Returns
    -------
    Number of candidates, number of patterns looked up, work left over (0 or less if it is used up).
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
        # An edge has the errors of two stars; the largest error of the four is assumed for all edges.
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
            work -= _MATCH_COST
            # A ratio that noise may explain is treated as 1, so that the stated focal length is used.
            focal = scale if abs(scale - 1.0) > _FOCAL_SIGMAS * error / (2.0 * edges[5]) else 1.0
            seen = vectors if focal == 1.0 else _zoomed(vectors, focal)
            for i, star in enumerate((a, b, c, d)):
                for axis in range(3):
                    zoomed[i, axis] = seen[star, axis]
                    ordered[i, axis] = theirs[order[i], axis]
            matrix = pattern_attitude(zoomed, ordered)
            if plan.prior_cosine > -1.5 and rotation_cosine(matrix, plan.prior) < plan.prior_cosine:
                continue
            if is_known(matrix, known, math.cos(8.0 * gate[d])):
                continue
            matches, others = _matches(matrix, seen, gate, a, b, c, d, sky)
            # The gate covers π gate² of the 4π of the sky: a quarter of its square times the number of guide stars.
            score = _log_chance(matches, others, 0.25 * gate[d] ** 2 * len(sky.directions))
            if score > plan.passing:
                continue
            count = _keep(finds, count, score, matrix, focal)
            if score < plan.strong:
                return count, patterns, work
    return count, patterns, work


@kernel
def _keep(finds: PatternFinds, count: int, score: float, matrix: FloatArray, focal: float) -> int:
    """Add a candidate, replacing the worst if there is no room; of two equal attitudes the better is used."""
    at = count
    for k in range(count):
        if rotation_cosine(matrix, finds.matrix[k]) > 0.99999:
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
