"""Whether the observed stars beyond a candidate fall on guide stars, with the candidate where it was found.

They are taken along in the frame of the candidate's two stars. By chance few of them do, so that their number decides
what is worth a verification.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker.catalog.sky_view import SkyView
from startracker.catalog.voxels import star_within
from startracker.identification.marked_sky import Marks, is_marked
from startracker.identification.search_state import Candidates, Stars
from startracker.kernels import kernel

__all__ = ["Confirmation", "Others", "enough_hits", "least_hits", "look_beyond", "next_confirmed", "no_others"]

FloatArray = NDArray[np.float64]

_MANY_HITS = 100.0
_LOOK_AT = 48
_RARE = 1e-4


class Others(NamedTuple):
    """Observed stars beyond a candidate's own, to be looked for in the sky, and what that takes.

    Parameters
    ----------
    along : (3, 48)
        Coordinates along a pair's middle, its difference, and across both.
    gate2 : (48,)
        Square of the distance up to which a guide star is one's own.
    near : uint8 (48,)
        Scratch: whether a guide star may be there.
    frame : (3, 3)
        Scratch.
    """

    along: FloatArray
    gate2: FloatArray
    near: NDArray[np.uint8]
    frame: FloatArray


class Confirmation(NamedTuple):
    """How many other stars must confirm a candidate, and what looking costs.

    Parameters
    ----------
    gate : float
        Distance to a guide star, in stated errors, at most.
    chance : float
        How often so many may be hit by chance, at most.
    enough : int
        Hits that are enough where they come by chance in 1 of 10,000 at most, even if that is more often.
    marks : Marks
        Where no guide star is near.
    candidate_work, look_work : float
        Operations of a candidate and of each further star.
    """

    gate: float
    chance: float
    enough: int
    marks: Marks
    candidate_work: float
    look_work: float


@kernel
def pair_frame(p: FloatArray, q: FloatArray, frame: FloatArray) -> None:
    """Rows of `frame` (3, 3): the middle of two directions, their difference, and the normal to both."""
    sx, sy, sz = p[0] + q[0], p[1] + q[1], p[2] + q[2]
    dx, dy, dz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    # the sum and the difference of unit vectors are at right angles
    s, d = 1.0 / math.sqrt(sx * sx + sy * sy + sz * sz), 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
    sx, sy, sz, dx, dy, dz = sx * s, sy * s, sz * s, dx * d, dy * d, dz * d
    frame[0, 0], frame[0, 1], frame[0, 2] = sx, sy, sz
    frame[1, 0], frame[1, 1], frame[1, 2] = dx, dy, dz
    frame[2, 0], frame[2, 1], frame[2, 2] = sy * dz - sz * dy, sz * dx - sx * dz, sx * dy - sy * dx


@kernel
def no_others() -> Others:
    """Room for them."""
    n = _LOOK_AT
    return Others(np.empty((3, n)), np.empty(n), np.empty(n, np.uint8), np.empty((3, 3)))


@kernel
def look_beyond(j: int, k: int, i: int, stars: Stars, gate: float, others: Others) -> int:
    """Fill in the brightest other stars in the frame of the pair j, k; how many, at gates of so many sigma.

    The pair's middle errs by half the variance of one star, and its bearing the more the closer the two are.
    """
    frame, u, w = others.frame, stars.vectors[j], stars.vectors[k]
    pair_frame(u, w, frame)
    shared = stars.sigma[j] ** 2 + stars.sigma[k] ** 2
    apart2 = (u[0] - w[0]) ** 2 + (u[1] - w[1]) ** 2 + (u[2] - w[2]) ** 2
    count = 0
    for star in range(len(stars.vectors)):
        if count == _LOOK_AT:
            break
        if star == i or star == j or star == k:  # noqa: PLR1714, SIM109  # a tuple costs 0.3 s of compiling
            continue
        x, y, z = stars.vectors[star, 0], stars.vectors[star, 1], stars.vectors[star, 2]
        for axis in range(3):
            others.along[axis, count] = frame[axis, 0] * x + frame[axis, 1] * y + frame[axis, 2] * z
        away2 = others.along[1, count] ** 2 + others.along[2, count] ** 2
        others.gate2[count] = gate * gate * (stars.sigma[star] ** 2 + shared * (0.25 + away2 / apart2))
        count += 1
    return count


@kernel
def enough_hits(
    u: FloatArray, w: FloatArray, shrink: float, others: Others, looked: int, need: int, sky: SkyView, marks: Marks
) -> bool:
    """Whether enough of the other stars fall on guide stars when the pair is where `u` and `w` are."""
    if need == 0:
        return True
    frame, near, marked, possible = others.frame, others.near, marks.reach2 > 0.0, looked
    pair_frame(u, w, frame)
    a, b, c = frame[0, 0], frame[1, 0], frame[2, 0]
    d, e, f = frame[0, 1], frame[1, 1], frame[2, 1]
    g, h, i = frame[0, 2], frame[1, 2], frame[2, 2]
    if marked:
        possible = 0
        for star in range(looked):  # no branches: several stars at a time
            p, q, r = others.along[0, star], others.along[1, star] * shrink, others.along[2, star] * shrink
            x, y, z = p * a + q * b + r * c, p * d + q * e + r * f, p * g + q * h + r * i
            near[star] = is_marked(x, y, z, marks) | (others.gate2[star] > marks.reach2)
            possible += near[star]
    hits = 0
    for star in range(looked):
        if hits + possible < need:
            return False
        if marked and not near[star]:
            continue
        possible -= 1
        p, q, r = others.along[0, star], others.along[1, star] * shrink, others.along[2, star] * shrink
        x, y, z = p * a + q * b + r * c, p * d + q * e + r * f, p * g + q * h + r * i
        if star_within(x, y, z, others.gate2[star], sky.directions, sky.grid):
            hits += 1
            if hits >= need:
                return True
    return False


@kernel
def least_hits(mean: float, chance: float) -> int:
    """Fewest hits that come by chance with a probability of at most `chance` where `mean` come on average (Poisson)."""
    if mean > _MANY_HITS:  # e^−mean would vanish; a normal distribution's far end instead
        return int(mean + 5.0 * math.sqrt(mean)) + 1
    term, tail, hits = math.exp(-mean), 1.0, 0
    while tail > chance:
        tail -= term
        hits += 1
        term *= mean / hits
    return hits


@kernel
def _attitude_of_pair(
    stars: Stars, j: int, k: int, focal: float, u: FloatArray, w: FloatArray, scratch: FloatArray
) -> FloatArray:
    """Attitude (3, 3) that takes the middle of two guide directions and their difference to two observed stars'."""
    out, ends = np.zeros((3, 3)), np.empty((2, 3))
    for axis in range(3):
        ends[0, axis] = stars.vectors[j, axis] + focal * stars.slopes[j, axis]
        ends[1, axis] = stars.vectors[k, axis] + focal * stars.slopes[k, axis]
    seen = np.empty((3, 3))
    pair_frame(ends[0], ends[1], seen)
    pair_frame(u, w, scratch)
    for row in range(3):
        for column in range(3):
            for axis in range(3):
                out[row, column] += seen[axis, row] * scratch[axis, column]
    return out


@kernel
def next_confirmed(
    candidates: Candidates, start: int, stars: Stars, sky: SkyView, confirmation: Confirmation, work: float
) -> tuple[int, FloatArray, float]:
    """First of the candidates from `start` on that enough other stars confirm.

    Parameters
    ----------
    work : float
        Operations after which to give up.

    Returns
    -------
    Its number, that of the candidates where there is none; its attitude (3, 3); operations.
    """
    others, looked, need, taken, last = no_others(), 0, 0, 0.0, -1
    for c in range(start, len(candidates.focal)):
        row, before = candidates.stars[c], candidates.stars[max(last, 0)]
        j, k, u, w = row[0], row[1], sky.directions[row[2]], sky.directions[row[3]]
        if last < 0 or j != before[0] or k != before[1] or row[4] != before[4]:
            looked, last = look_beyond(j, k, row[4], stars, confirmation.gate, others), c
            mean = 0.0
            for star in range(looked):
                mean += 0.25 * others.gate2[star] * len(sky.directions)
            rare = min(least_hits(mean, _RARE), confirmation.enough)
            need = min(max(least_hits(mean, confirmation.chance), rare), looked)
        taken += confirmation.candidate_work + confirmation.look_work * looked
        if enough_hits(u, w, 1.0 - candidates.focal[c], others, looked, need, sky, confirmation.marks):
            return c, _attitude_of_pair(stars, j, k, candidates.focal[c], u, w, others.frame), taken
        if taken > work:
            break
    return len(candidates.focal), others.frame, taken
