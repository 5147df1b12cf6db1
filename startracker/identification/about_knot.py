"""Attitudes around a knot of stars, whose direction is right: roll and focal length are searched for again.

A knot of stars, such as the Pleiades, fixes the direction of its centre, but neither the roll nor the focal length. If
the attitude found from it leaves the bright stars elsewhere unexplained, one more star is sufficient: if the centre of
the knot and an observed star are paired with guide stars, their separation gives the focal length, and then the roll
follows. Each bright star away from the knot is paired with all bright guide stars at the same separation, within
`MOST_FOCAL_ERROR`. Correct pairings agree in one attitude and one focal length, and those on which most agree are
verified against all stars.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from startracker.catalog.guide import GuideDatabase
from startracker.catalog.sky_view import stars_in_cone
from startracker.core import BoolArray, FloatArray, IntArray
from startracker.estimation.directions import focal_slopes
from startracker.identification.acceptance import HypothesisPool, accepts, power_of_ten, tried_scales
from startracker.identification.observed import Identification, Observed
from startracker.identification.verification import FEWEST_FOR_FOCAL, FOCAL_SIGMA, GATE_SIGMAS
from startracker.settings import IdentificationSettings
from startracker.solution import Status

MOST_FOCAL_ERROR = 3.0 * FOCAL_SIGMA
"""Largest |ln f| that is tried: three of the standard deviations that the verification assumes."""
_BRIGHTEST = 16
"""Number of observed stars that are paired with guide stars."""
_MOST_PAIRINGS = 24
"""Number of guide stars with which each of them is paired."""
_AWAY = 0.25
"""Separation from the knot, as a share of the field's half diagonal, above which a star determines roll and focal
length."""
_MOST_VERIFIED = 8
_FIRST_GATE = 2.0 * GATE_SIGMAS
"""Gate of the verification, in multiples of its scale and of the standard errors."""


class _Pairings(NamedTuple):
    """Attitudes (K, 3, 3), ln f (K,) and observed stars (K,) of the pairings of one star with one guide star."""

    matrix: FloatArray
    log_focal: FloatArray
    star: IntArray


def about_knot(
    found: Identification, observed: Observed, guide: GuideDatabase, settings: IdentificationSettings
) -> Identification:
    """Find the attitude that explains the stars around a knot, after the one from the knot itself was rejected.

    Parameters
    ----------
    found : Identification
        The rejected identification, solved. It is a rival: another attitude is accepted only if it is likelier than
        this one by the allowed chance, including the number of attitudes that were verified.
    observed, guide, settings
        As for an identifier.

    Returns
    -------
    Identification
        Its operations include the rejected search.
    """
    pool = HypothesisPool(settings, stars=len(observed), operations=found.operations)
    scale, verified = tried_scales(observed, guide)[-1], 0
    if len(observed) >= FEWEST_FOR_FOCAL:
        pairings = _pairings(found.pairs, observed, guide)
        tolerance = _FIRST_GATE * scale * float(np.median(observed.sigma_rad)) / guide.half_diagonal_rad
        for k in _most_supported(pairings, tolerance):
            pool.check(pairings.matrix[k], observed, guide, scale, math.exp(pairings.log_focal[k]))
            verified += 1
    pool.note(f"{verified} attitudes about the matched stars, with other rolls and focal lengths, were verified")
    again = pool.outcome(observed)
    if again.status is not Status.SOLVED:
        return again
    chance = again.log_false_alarm - found.log_false_alarm + math.log(verified)
    reason = f"{again.reason}; {power_of_ten(chance)} against another attitude about the same stars, which was refused"
    status = Status.SOLVED if accepts(chance, settings) else Status.AMBIGUOUS
    pairs = again.pairs if status is Status.SOLVED else again.pairs[:0]
    return replace(again, status=status, reason=reason, pairs=pairs, log_false_alarm=chance)


def _pairings(pairs: IntArray, observed: Observed, guide: GuideDatabase) -> _Pairings:
    """Attitudes from the centre of the matched stars and each bright star away from it."""
    knot = pairs[_inner_half(observed.vectors[pairs[:, 0]])]
    slopes = focal_slopes(np.ascontiguousarray(observed.vectors, dtype=np.float64))
    at, slope = observed.vectors[knot[:, 0]].mean(axis=0), slopes[knot[:, 0]].mean(axis=0)
    centre = _unit(guide.directions[knot[:, 1]].mean(axis=0))
    # Angles between the centre and the stars for the shortest and the longest focal length; linear in ln f between
    # them.
    ends = np.array([-MOST_FOCAL_ERROR, MOST_FOCAL_ERROR])
    seen = observed.vectors[None] + ends[:, None, None] * slopes[None]
    angle = np.array([_angle(_unit(at + end * slope), _unit(stars)) for end, stars in zip(ends, seen, strict=True)])
    away = np.flatnonzero(angle.min(axis=0) > _AWAY * guide.half_diagonal_rad)[:_BRIGHTEST]
    widest = float(np.max(angle[:, away], initial=0.0))
    near = np.sort(stars_in_cone(*centre.tolist(), math.cos(widest), guide.directions, guide.grid))  # brightest first
    separation = _angle(centre, guide.directions[near])
    star, called = [], []
    for n in away.tolist():
        low, high = angle[:, n].min(), angle[:, n].max()
        ring = np.flatnonzero((separation >= low) & (separation <= high))[:_MOST_PAIRINGS]
        star.append(np.full(len(ring), n))
        called.append(ring)
    stars, rows = (np.concatenate([np.empty(0, np.int64), *parts]) for parts in (star, called))
    span = angle[1, stars] - angle[0, stars]
    log_focal = ends[0] + (ends[1] - ends[0]) * (separation[rows] - angle[0, stars]) / span
    # An attitude maps the frame of two guide directions onto the frame of the two observed ones.
    one = _axes(at + log_focal[:, None] * slope, observed.vectors[stars] + log_focal[:, None] * slopes[stars])
    other = _axes(np.broadcast_to(centre, (len(rows), 3)), guide.directions[near[rows]])
    return _Pairings(np.swapaxes(one, 1, 2) @ other, log_focal, stars)


def _inner_half(vectors: FloatArray) -> IntArray:
    """Indices of the half of the matched stars (M, 3) nearest to their median, at least two.

    These are the stars of the knot; the others are matched by chance if roll and focal length are wrong.
    """
    away = np.linalg.norm(vectors - np.median(vectors, axis=0), axis=1)
    return np.argsort(away, kind="stable")[: max(2, (len(vectors) + 1) // 2)]


def _most_supported(pairings: _Pairings, tolerance: float) -> list[int]:
    """Indices of the pairings with which most pairings of other stars agree, at most `_MOST_VERIFIED`.

    They agree if both the rotation angle, rad, and the difference in ln f are below `tolerance`. Of pairings that agree
    with each other, one is returned.
    """
    rows = pairings.matrix.reshape(-1, 9)
    # The trace of the relative rotation of two attitudes is 1 + 2 cos(angle), and the sum of the products of their
    # elements.
    cosine = 0.5 * (rows @ rows.T - 1.0)
    agrees: BoolArray = (cosine > math.cos(tolerance)) & (
        np.abs(pairings.log_focal[:, None] - pairings.log_focal[None]) < tolerance
    )
    votes = np.count_nonzero(agrees & (pairings.star[:, None] != pairings.star[None]), axis=1)
    chosen: list[int] = []
    for k in np.argsort(-votes, kind="stable").tolist():
        if votes[k] == 0 or len(chosen) == _MOST_VERIFIED:
            break
        if not agrees[k, chosen].any():
            chosen.append(k)
    return chosen


def _unit(vectors: FloatArray) -> FloatArray:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def _angle(one: FloatArray, others: FloatArray) -> FloatArray:
    """Angles (N,) between a unit vector and others (N, 3), rad."""
    return np.asarray(2.0 * np.arcsin(np.minimum(0.5 * np.linalg.norm(others - one, axis=1), 1.0)))


def _axes(first: FloatArray, second: FloatArray) -> FloatArray:
    """Right-handed axes (K, 3, 3), in rows: along the first vectors, in the plane of both, normal to it."""
    x = _unit(first)
    z = _unit(np.cross(x, second))
    return np.stack([x, np.cross(z, x), z], axis=1)
