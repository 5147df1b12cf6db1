"""Identification by pyramids (Mortari, Samaan, Bruccoleri & Junkins 2004, Navigation 51, 171).

1. Triangles of observed stars in the smart order (i, i + dj, i + dj + dk), which abandons a false star quickly.
2. The range of guide pairs for each side, from the k-vector; the guide triangles that close and have the same
   orientation.
3. A fourth star at the right separations from all three corners confirms a triangle; rivals are ranked by their number.
4. The attitude of the triangle with most confirming stars is verified against all stars of the field and accepted by
   probability (`acceptance`); the paper uses the expected frequency of random pyramids.

Errors as stated are assumed first, then 3 and 10 times those; first with a few triangles each, then with more.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from startracker._compiled import kernel, kernel_part
from startracker.catalog.guide import GuideDatabase, PairList
from startracker.catalog.sky_view import SkyView, stars_in_cone
from startracker.core import FloatArray, IntArray
from startracker.estimation.directions import pair_rotation
from startracker.geometry.linalg import chord, rotate_back, triple_product
from startracker.identification.acceptance import SCALES, HypothesisPool, too_few, tried_scales
from startracker.identification.observed import Identification, Observed, Prior
from startracker.identification.pairs import KVector, find_range, k_vector, pair_tolerance, separation
from startracker.settings import IdentificationSettings, PyramidSettings
from startracker.solution import Status

_ROUNDS = ((60, 3, 500_000), (400, 2, 500_000), (100_000, 1, 500_000))
"""For each round: the number of triangles at which it ends, the number of stars that must confirm one, and the number
of steps for each scale."""
_MOST_TRIPLED = 64
"""Largest number of stars that form triangles, whatever the settings: 42,000 triangles."""
_STEP_WORK = 10
"""Operations per step."""
_MOST_CHECKED = 12  # confirmed triangles checked in a round at one scale
_INDEXES: WeakKeyDictionary[PairList, KVector] = WeakKeyDictionary()
_MOST_FINDS = 6
"""Number of triangles of guide stars, best confirmed first, that are recorded for one observed triangle."""
_GATE_SIGMAS = 4.5
_ABERRATION = 1.1e-4  # rad per radian of separation, with some margin for rounding
_MOST_CONFIRMING = 24
_MOST_SILENT = 8  # stars examined without success after which a triangle is rejected
# Least height of a triangle, in standard errors: below it, orientation and roll are undetermined.
_SLENDEREST = 4.0


def pyramid(
    observed: Observed,
    guide: GuideDatabase,
    settings: IdentificationSettings | None = None,
    prior: Prior | None = None,
) -> Identification:
    """Identify observed stars, lost in space or around a prior attitude.

    Parameters
    ----------
    observed : Observed
        Brightest first; the `settings.max_stars` brightest form triangles, all are used in confirmation and
        verification. Magnitudes are used in the verification only.
    guide : GuideDatabase
        Guide stars in apparent directions for the observer.
    settings : PyramidSettings
        `separation_tolerance_deg`, `min_stars`, `max_stars`, `false_alarm_rate`.
    prior : Prior, optional
        Restricts the guide pairs to what the prior allows.

    Returns
    -------
    Identification
        Status, reason and pairs. Never raises for what was observed.
    """
    settings = PyramidSettings.of(settings)
    least = max(settings.min_stars, 3)
    if len(observed) < least:
        return too_few(observed, least)
    pool = HypothesisPool(settings, prior, len(observed))
    n = min(len(observed), settings.max_stars, _MOST_TRIPLED)
    triples = smart_triples(n)
    table, view = _guide_pairs(guide, prior), guide.view
    fixed = settings.separation_tolerance_deg is not None
    # A tolerance in degrees does not depend on the stated errors. One search is then enough, with the widest gate of
    # the verification, which narrows it by itself (`verify`).
    scales = SCALES[-1:] if fixed else tried_scales(observed, guide)
    seen = {scale: _seen(observed, n, settings, scale) for scale in scales}
    for most, confirming, budget in _ROUNDS:
        stop, needed = min(most, len(triples)), max(1, min(confirming, len(observed) - 3))
        for scale in scales:
            reached, checked, best = 0, 0, 0
            left = min(budget, pool.left // _STEP_WORK)
            pool.cut_short = pool.cut_short or left <= 0
            while reached < stop and left > 0 and checked < _MOST_CHECKED:
                found = search_pyramids(seen[scale], triples[:stop], reached, table, view, needed, left)
                reached, finds, matrices, confirmed, after = found
                pool.operations += _STEP_WORK * (left - after)
                left = after
                for f in range(finds):
                    if confirmed[f] < best - 1:  # what is confirmed by fewer cannot compete
                        break
                    best = max(best, int(confirmed[f]))
                    checked += 1
                    pool.check(matrices[f], observed, guide, scale)
                if finds and pool.decided:
                    return pool.outcome(observed)
            pool.note(
                f"pyramids within {scale:g} stated errors: {reached} of {len(triples)} triangles, "
                + (f"the best confirmed by {best} further stars" if best else "none confirmed by a fourth star")
            )
        verdict = pool.outcome(observed)
        if verdict.status is Status.SOLVED or pool.cut_short:
            break
    return verdict


@lru_cache(maxsize=128)
def smart_triples(n: int) -> IntArray:
    """All triples (T, 3) of n stars in the order (i, i + dj, i + dj + dk), where i changes fastest, then dk, then dj.

    Successive triples share few stars, so that one false star spoils few of them in a row (Mortari et al. 2004).
    """
    dj, dk, i = np.indices((n, n, n)).reshape(3, -1)
    triples = np.stack([i, i + dj, i + dj + dk], axis=1)
    return triples[(dj > 0) & (dk > 0) & (triples[:, 2] < n)]


def _guide_pairs(guide: GuideDatabase, prior: Prior | None) -> GuidePairs:
    """Pairs of the whole sky, or around a prior attitude."""
    pairs = guide.pairs if prior is None else guide.pairs_near(prior.attitude.boresight, prior.radius_rad)
    index = _INDEXES.get(pairs)
    if index is None:
        index = _INDEXES[pairs] = k_vector(pairs.separation_rad.astype(np.float64))
    return GuidePairs(pairs.first, pairs.second, index, np.full(len(guide), -1, dtype=np.int64))


def _seen(observed: Observed, n: int, settings: PyramidSettings, scale: float) -> Seen:
    """Stars, separations and tolerances at a multiple of the stated errors."""
    vectors = np.ascontiguousarray(observed.vectors, dtype=np.float64)
    sigma = np.ascontiguousarray(observed.sigma_rad, dtype=np.float64) * scale
    i, j = np.indices((n, n)).reshape(2, -1)
    apart = separation(vectors[i], vectors[j])
    fixed = settings.separation_tolerance_deg
    tolerance = pair_tolerance(sigma, i, j, apart, None if fixed is None else math.radians(fixed))
    return Seen(vectors, sigma, apart.reshape(n, n), tolerance.reshape(n, n))


# ---------------------------------------------------------------------- kernels
class Seen(NamedTuple):
    """Observed stars in the form that kernels read.

    Parameters
    ----------
    vectors : (N, 3)
    sigma : (N,)
        Assumed standard errors, rad.
    separation, tolerance : (n, n)
        Separations and tolerances of the stars that form triangles, rad.
    """

    vectors: FloatArray
    sigma: FloatArray
    separation: FloatArray
    tolerance: FloatArray


@kernel
def _confirming(
    seen: Seen, sky: SkyView, rotation: FloatArray, corners: IntArray, guides: IntArray, wanted: int
) -> tuple[int, int]:
    """Number of further observed stars at the right separations from all three corners of a guide triangle, and steps.

    The three pair lists intersect at the star that lies where the triangle's attitude predicts it. It is looked up
    there, and the separations are checked afterwards.
    """
    matches, looked, steps = 0, 0, 0
    apart, limit = np.empty(3), np.empty(3)
    three = seen.sigma[corners[0]] + seen.sigma[corners[1]] + seen.sigma[corners[2]]
    shortest = min(
        seen.separation[corners[0], corners[1]],
        seen.separation[corners[0], corners[2]],
        seen.separation[corners[1], corners[2]],
    )
    for e in range(len(seen.vectors)):
        if e == corners[0] or e == corners[1] or e == corners[2]:
            continue
        if looked >= wanted:
            break
        looked += 1
        if matches == 0 and looked > _MOST_SILENT:
            break
        v = seen.vectors[e]
        far = 0.0
        for m in range(3):
            apart[m] = chord(v, seen.vectors[corners[m]])
            limit[m] = _GATE_SIGMAS * math.hypot(seen.sigma[e], seen.sigma[corners[m]]) + _ABERRATION * apart[m]
            far = max(far, apart[m])
        # The roll from the triangle has an error of the stars' errors over its side, which is large for distant stars.
        gate = _GATE_SIGMAS * (seen.sigma[e] + three / 3.0 * (1.0 + far / shortest))
        x, y, z = rotate_back(rotation, v)
        steps += 2
        for star in stars_in_cone(x, y, z, 1.0 - 0.5 * gate * gate, sky.directions, sky.grid):
            steps += 1
            right = star != guides[0] and star != guides[1] and star != guides[2]
            for m in range(3):
                # A difference of chords is at most that of the angles.
                if not right or abs(chord(sky.directions[star], sky.directions[guides[m]]) - apart[m]) > limit[m]:
                    right = False
                    break
            if right:
                matches += 1
                break
    return matches, steps


class GuidePairs(NamedTuple):
    """Guide stars (L,) of each pair in the order of their k-vector, and a scratch array (G,) that is all −1 between
    uses."""

    first: NDArray[np.int32]
    second: NDArray[np.int32]
    vector: KVector
    head: IntArray


class _Finds(NamedTuple):
    """Confirmed triangles, best first: attitudes (_MOST_FINDS, 3, 3), numbers of confirming stars, and their count
    (1,)."""

    matrix: FloatArray
    confirmed: IntArray
    found: IntArray


@kernel_part
def _partners(pairs: GuidePairs, low: int, high: int) -> tuple[IntArray, IntArray]:
    """Partners of each guide star in a range of pairs, as chains that begin at its `head`: the next link, the
    partner."""
    chain, partner = np.empty(2 * (high - low), np.int64), np.empty(2 * (high - low), np.int64)
    count = 0
    for p in range(low, high):
        a, b = pairs.first[p], pairs.second[p]
        partner[count], chain[count], pairs.head[a] = b, pairs.head[a], count
        partner[count + 1], chain[count + 1], pairs.head[b] = a, pairs.head[b], count + 1
        count += 2
    return chain, partner


@kernel_part
def _keep(finds: _Finds, rotation: FloatArray, matches: int) -> None:
    """Insert a confirmed triangle in descending order of matches, if there is room."""
    slot = min(finds.found[0], _MOST_FINDS - 1)
    if finds.found[0] == _MOST_FINDS and matches <= finds.confirmed[slot]:
        return
    while slot > 0 and finds.confirmed[slot - 1] < matches:
        finds.confirmed[slot], finds.matrix[slot] = finds.confirmed[slot - 1], finds.matrix[slot - 1]
        slot -= 1
    finds.confirmed[slot], finds.matrix[slot] = matches, rotation
    finds.found[0] = min(finds.found[0] + 1, _MOST_FINDS)


@kernel_part
def _laid_on(observed: FloatArray, reference: FloatArray, sides: FloatArray) -> FloatArray:
    """Attitude (3, 3) of a triangle from its longest side; `sides` are those of i–j, i–k and j–k."""
    one, other = 1, 2
    if sides[0] >= max(sides[1], sides[2]):
        one, other = 0, 1
    elif sides[1] >= sides[2]:
        one = 0
    rotation: FloatArray = pair_rotation(observed, reference, one, other)
    return rotation


@kernel
def _triangle(
    seen: Seen, corners: IntArray, pairs: GuidePairs, sky: SkyView, least: int, budget: int, finds: _Finds
) -> int:
    """Find the guide triangles that an observed one may be and that fourth stars confirm; returns the budget left."""
    i, j, k = corners
    sides = np.array([seen.separation[i, j], seen.separation[i, k], seen.separation[j, k]])
    observed, reference, guides = np.empty((3, 3)), np.empty((3, 3)), np.empty(3, np.int64)
    for m in range(3):
        observed[m] = seen.vectors[corners[m]]
    sense = triple_product(observed[0], observed[1], observed[2])
    if abs(sense) < _SLENDEREST * max(seen.sigma[i], seen.sigma[j], seen.sigma[k]) * max(sides[0], sides[1], sides[2]):
        return budget
    low_ij, high_ij = find_range(pairs.vector, sides[0] - seen.tolerance[i, j], sides[0] + seen.tolerance[i, j])
    low_ik, high_ik = find_range(pairs.vector, sides[1] - seen.tolerance[i, k], sides[1] + seen.tolerance[i, k])
    budget -= high_ij - low_ij + high_ik - low_ik
    chain, partner = _partners(pairs, low_ij, high_ij)
    # The third side is compared by squared chords, which need no inverse function.
    shortest_jk = 4.0 * math.sin(0.5 * max(sides[2] - seen.tolerance[j, k], 0.0)) ** 2
    longest_jk = 4.0 * math.sin(0.5 * min(sides[2] + seen.tolerance[j, k], math.pi)) ** 2
    for p in range(low_ik, high_ik):
        if budget <= 0:  # what was found so far counts
            break
        for turn in range(2):
            a, c = (pairs.first[p], pairs.second[p]) if turn == 0 else (pairs.second[p], pairs.first[p])
            link = pairs.head[a]
            while link >= 0 and budget > 0:
                b, link = partner[link], chain[link]
                budget -= 1
                chord = 0.0
                for axis in range(3):
                    chord += (sky.directions[b, axis] - sky.directions[c, axis]) ** 2
                if b == c or not shortest_jk <= chord <= longest_jk:
                    continue
                if triple_product(sky.directions[a], sky.directions[b], sky.directions[c]) * sense <= 0.0:
                    continue
                guides[0], guides[1], guides[2] = a, b, c
                for m in range(3):
                    reference[m] = sky.directions[guides[m]]
                rotation = _laid_on(observed, reference, sides)
                matches, steps = _confirming(seen, sky, rotation, corners, guides, _MOST_CONFIRMING)
                budget -= steps + 20
                if matches >= least:
                    _keep(finds, rotation, matches)
    for p in range(low_ij, high_ij):
        pairs.head[pairs.first[p]] = pairs.head[pairs.second[p]] = -1
    return budget


@kernel
def search_pyramids(
    seen: Seen, triples: IntArray, start: int, pairs: GuidePairs, sky: SkyView, least: int, budget: int
) -> tuple[int, int, FloatArray, IntArray, int]:
    """Search the triples (T, 3) from `start` until one has a triangle of guide stars that a fourth star confirms.

    Parameters
    ----------
    least : int
        Number of confirming stars that a triangle must have.
    budget : int
        Number of steps (pairs and triangles examined) after which the search ends.

    Returns
    -------
    Triple to continue from; number of finds; their attitudes (_MOST_FINDS, 3, 3); confirming stars of each, most first;
    budget left. Without finds, none was confirmed or the budget is used up.
    """
    finds = _Finds(np.empty((_MOST_FINDS, 3, 3)), np.zeros(_MOST_FINDS, np.int64), np.zeros(1, np.int64))
    t = start
    while t < len(triples) and budget > 0 and finds.found[0] == 0:
        budget = _triangle(seen, triples[t], pairs, sky, least, budget, finds)
        t += 1
    return t, finds.found[0], finds.matrix, finds.confirmed, budget
