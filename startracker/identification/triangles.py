"""Kernels that find triangles of observed stars in the sky, and check at once what each would mean.

For an observed triangle (i, j, k) with i opposite its longest side the guide pairs of the two shorter sides are looked
up in the sorted list and joined at i's star; the longest side, the sense of rotation and the brightnesses are checked
on the way. Each triangle left gives an attitude; where enough other observed stars then fall on guide stars, the
attitude is verified against all (`verification`).

Where the focal length may be off, all sides may be longer or shorter by one factor: the windows are wider by it, and
the sides must agree on the factor.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from startracker.catalog.sky_view import SkyView
from startracker.estimation.kernels import triple_product
from startracker.identification.marked_sky import mark_sky, no_marks, share_marked
from startracker.identification.other_stars import enough_hits, least_hits, look_beyond, no_others, pair_frame
from startracker.identification.search_state import Finds, Limits, Pairs, Stars
from startracker.identification.verification import (
    GATE_SIGMAS,
    fit_step,
    solve_symmetric,
    turned,
    verify_attitude,
)
from startracker.kernels import kernel, kernel_with
from startracker.sorting import median

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

PAIR_SIGMAS = 3.7
"""A true side is measured within this many standard errors: 2e-4 of them are lost, and there are other triangles."""
_MANY_FOUND, _USUAL_SIGMA = 200, 1.5
"""Triangles found after which the sky is marked, for stars of up to so many median errors."""
_LEVER = 1.5
ABERRATION = 1.02e-4
"""Of a separation, where the pairs are those without aberration."""
_VERIFY_FROM = 7.0
_POOR_FIT = 2.0
_WORTH_A_SECOND_LOOK = -5.0
_PAIR_WORK, _CANDIDATE_WORK, _LOOK_WORK = 4.0, 300.0, 50.0
"""Operations, each of about a nanosecond: of a guide pair looked at, of a triangle found in the sky, and of a further
star that is looked for there."""


@kernel_with(inline="always")
def chord_angle(a: FloatArray, b: FloatArray) -> float:
    """Angle between two unit vectors, rad, from their chord."""
    x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    return 2.0 * math.asin(min(0.5 * math.sqrt(x * x + y * y + z * z), 1.0))


@kernel
def _first_of_at_least(ascending: NDArray[np.float32], value: np.float32) -> int:
    """Index of the first number of at least a value, by halving; their count where there is none."""
    low, high = 0, len(ascending)
    while low < high:
        middle = (low + high) // 2
        if ascending[middle] < value:
            low = middle + 1
        else:
            high = middle
    return low


@kernel_with(inline="always")
def window(separation: NDArray[np.float32], low: float, high: float) -> tuple[int, int]:
    """First and one beyond the last of ascending separations within two limits."""
    return _first_of_at_least(separation, np.float32(low)), _first_of_at_least(separation, np.float32(high))


@kernel
def attitude_of_pair(b1: FloatArray, b2: FloatArray, r1: FloatArray, r2: FloatArray) -> FloatArray:
    """Attitude (3, 3) that takes the middle of two reference directions and their difference to the observed ones."""
    out = np.zeros((3, 3))
    seen, real = np.empty((3, 3)), np.empty((3, 3))
    pair_frame(b1, b2, seen)
    pair_frame(r1, r2, real)
    for row in range(3):
        for column in range(3):
            for axis in range(3):
                out[row, column] += seen[axis, row] * real[axis, column]
    return out


@kernel
def _attitude_of_three(b: FloatArray, r: FloatArray, sigma: FloatArray) -> FloatArray:
    """Attitude of three stars, the last two the farthest apart: from these two, then one step of least squares."""
    matrix: FloatArray = attitude_of_pair(b[1], b[2], r[1], r[2])
    predicted = np.zeros((3, 3))
    for star in range(3):
        for axis in range(3):
            for k in range(3):
                predicted[star, axis] += matrix[axis, k] * r[star, k]
    normal, right = fit_step(b, b, predicted, np.arange(3), sigma, 3)
    change = solve_symmetric(normal, right)
    if math.isfinite(change[0] + change[1] + change[2]):
        matrix = turned(matrix, change[0], change[1], change[2])
    return matrix


@kernel
def fits_prior(vector: FloatArray, guide: FloatArray, limits: Limits) -> bool:
    """Whether a guide star can be where an observed star is, by what is known beforehand."""
    if limits.prior_cosine < -1.0:
        return True
    cosine = 0.0
    for axis in range(3):
        row = limits.prior[axis]
        cosine += vector[axis] * (row[0] * guide[0] + row[1] * guide[1] + row[2] * guide[2])
    fits: bool = cosine >= limits.prior_cosine
    return fits


@kernel
def _known(matrix: FloatArray, finds: Finds, count: int, slack: float) -> bool:
    """Whether the attitude is one that was found already, within a rotation by `slack`."""
    least = 3.0 - slack * slack
    for row in range(count):
        trace = 0.0
        for i in range(3):
            for j in range(3):
                trace += matrix[i, j] * finds.matrix[row, i, j]
        if trace > least:
            return True
    return False


@kernel
def _keep(finds: Finds, count: int, found: tuple[float, FloatArray, float, float, int, IntArray, int]) -> int:
    """Write a hypothesis down, in the place of the worst where all are taken; the new number of hypotheses."""
    row = count
    if count == len(finds.log_b):
        row = 0
        for other in range(count):
            row = other if finds.log_b[other] < finds.log_b[row] else row
        if finds.log_b[row] >= found[0]:
            return count
    finds.log_b[row], finds.focal[row], finds.scale[row], finds.in_field[row] = found[0], found[2], found[3], found[4]
    for i in range(3):
        for j in range(3):
            finds.matrix[row, i, j] = found[1][i, j]
    for star in range(len(found[5])):
        finds.guide[row, star] = found[5][star]
    return min(count + 1, len(finds.log_b))


@kernel
def weigh_attitude(
    matrix: FloatArray, focal: float, stars: Stars, sky: SkyView, limits: Limits, finds: Finds, count: int
) -> tuple[int, int]:
    """Verify an attitude against all stars, unless it is known. New number of finds, and the operations."""
    if _known(matrix, finds, count, 3.0 * limits.scale * stars.sigma[0]):
        return count, 0
    scale = max(limits.scale, _VERIFY_FROM)
    free = limits.focal_range > 0.0
    found = verify_attitude(matrix, focal, stars, sky, scale, free)
    work = found[6]
    if not free and found[0] > _WORTH_A_SECOND_LOOK and found[3] > _POOR_FIT:
        other = verify_attitude(found[1], 0.0, stars, sky, scale, True)
        work += other[6]
        if other[0] > found[0] + 3.0:
            found = other
    if found[0] > _WORTH_A_SECOND_LOOK:
        count = _keep(finds, count, found)
    return count, work


@kernel
def _weigh_triangle(
    obs: IntArray, gid: IntArray, focal: float, stars: Stars, sky: SkyView, limits: Limits, finds: Finds, count: int
) -> tuple[int, int]:
    """Verify what a triangle means against all stars. New number of finds, and the operations."""
    b, r = np.empty((3, 3)), np.empty((3, 3))
    s = np.empty(3)
    for k in range(3):
        b[k] = stars.vectors[obs[k]]
        if limits.focal_range > 0.0:
            b[k] += focal * stars.slopes[obs[k]]
        r[k], s[k] = sky.directions[gid[k]], stars.sigma[obs[k]]
    weighed: tuple[int, int] = weigh_attitude(_attitude_of_three(b, r, s), focal, stars, sky, limits, finds, count)
    return weighed


@kernel_with(inline="always")
def _room(scratch: NDArray[np.int32], size: int) -> NDArray[np.int32]:
    """The same array, or a longer one where it has no room for one more than `size`."""
    return scratch if len(scratch) > size else np.empty(2 * size + 1, np.int32)


@kernel
def triangle_costs(triples: IntArray, vectors: FloatArray, least_rad: float) -> FloatArray:
    """Sum of the two shorter sides (T,), rad; 2π more where the longest is below `least_rad`."""
    out = np.empty(len(triples))
    for t in range(len(triples)):
        a, b, c = vectors[triples[t, 0]], vectors[triples[t, 1]], vectors[triples[t, 2]]
        ab, bc, ca = chord_angle(a, b), chord_angle(b, c), chord_angle(c, a)
        longest = max(ab, bc, ca)
        out[t] = ab + bc + ca - longest + (2.0 * math.pi if longest < least_rad else 0.0)
    return out


@kernel
def search_triangles(
    triples: IntArray, stars: Stars, sky: SkyView, pairs: Pairs, limits: Limits, finds: Finds, count: int
) -> tuple[int, int, int, float]:
    """Look up triangles of observed stars one after the other.

    Parameters
    ----------
    triples : (T, 3)
        Observed stars.
    stars, sky, pairs, limits
        What was seen, what there is, and what may be done.
    finds, count
        Hypotheses so far, added to.

    Returns
    -------
    number of hypotheses, triangles looked up, triangles found in the sky, operations.
    """
    head = np.full(len(sky.directions), -1, np.int32)
    following = np.empty(0, np.int32)
    partner = np.empty(0, np.int32)
    at_i, at_j = np.empty(0, np.int32), np.empty(0, np.int32)
    obs, gid = np.empty(3, np.int64), np.empty(3, np.int64)
    others, marks, marked = no_others(), no_marks(), 0.0
    gate = GATE_SIGMAS * limits.scale
    density = len(sky.directions) / (4.0 * math.pi)
    work, done, found, sure = 0.0, 0, 0, False
    wide = limits.focal_range
    for t in range(len(triples)):
        if sure or work > limits.work:
            break
        if found > _MANY_FOUND and marks.reach2 < 0.0:
            marks = mark_sky(sky.directions, _LEVER * _USUAL_SIGMA * gate * median(stars.sigma.copy()))
            marked = share_marked(marks)
            work += _PAIR_WORK * len(sky.directions)
        done += 1
        i, j, k = triples[t]
        # i opposite the longest side
        ij = chord_angle(stars.vectors[i], stars.vectors[j])
        ik = chord_angle(stars.vectors[i], stars.vectors[k])
        jk = chord_angle(stars.vectors[j], stars.vectors[k])
        if ij > jk and ij >= ik:
            i, k, ij, jk = k, i, jk, ij
        elif ik > jk:
            i, j, ik, jk = j, i, jk, ik
        if ik > ij:  # the shorter of the two fills the table
            j, k, ij, ik = k, j, ik, ij
        sigma = limits.scale * PAIR_SIGMAS
        t_ij = sigma * math.hypot(stars.sigma[i], stars.sigma[j]) + ABERRATION * ij
        t_ik = sigma * math.hypot(stars.sigma[i], stars.sigma[k]) + ABERRATION * ik
        t_jk = sigma * math.hypot(stars.sigma[j], stars.sigma[k]) + ABERRATION * jk
        if min(ij - t_ij, ik - t_ik) <= 0.0:
            continue
        low_ik, high_ik = window(pairs.separation, (ik - t_ik) / (1.0 + wide), (ik + t_ik) / (1.0 - wide))
        low_ij, high_ij = window(pairs.separation, (ij - t_ij) / (1.0 + wide), (ij + t_ij) / (1.0 - wide))
        cos_low = math.cos(min((jk + t_jk) / (1.0 - wide), math.pi))
        cos_high = math.cos(max((jk - t_jk) / (1.0 + wide), 0.0))
        seen = triple_product(stars.vectors[i], stars.vectors[j], stars.vectors[k])
        # below this the sense of a thin triangle is noise
        thin = t_jk * math.sin(jk)
        m_ij = stars.magnitude[i] - stars.magnitude[j]
        m_ik = stars.magnitude[i] - stars.magnitude[k]
        size = 2 * (high_ik - low_ik)
        following, partner = _room(following, size), _room(partner, size)
        looked = look_beyond(j, k, i, stars, gate, others)
        mean = 0.0
        for star in range(looked):
            mean += math.pi * others.gate2[star] * density
        need = min(least_hits(mean, limits.chance_hits), looked)
        filled = 0
        for p in range(low_ik, high_ik):
            a, c = pairs.first[p], pairs.second[p]
            fainter = sky.v_mag[a] - sky.v_mag[c]
            # no branches: which way round a pair fits is not to be foreseen
            known, fits = head[a], not abs(m_ik - fainter) > limits.magnitude_tolerance
            following[filled], partner[filled] = known, c
            head[a] = filled if fits else known
            filled += fits
            known, fits = head[c], not abs(m_ik + fainter) > limits.magnitude_tolerance
            following[filled], partner[filled] = known, a
            head[c] = filled if fits else known
            filled += fits
        work += _PAIR_WORK * (size + high_ij - low_ij)
        at_i, at_j, joined = _room(at_i, 2 * (high_ij - low_ij)), _room(at_j, 2 * (high_ij - low_ij)), 0
        for p in range(low_ij, high_ij):
            a, b = pairs.first[p], pairs.second[p]
            fainter = sky.v_mag[a] - sky.v_mag[b]
            at_i[joined], at_j[joined] = a, b
            joined += (head[a] >= 0) & (not abs(m_ij - fainter) > limits.magnitude_tolerance)
            at_i[joined], at_j[joined] = b, a
            joined += (head[b] >= 0) & (not abs(m_ij + fainter) > limits.magnitude_tolerance)
        for p in range(joined):
            a, b = at_i[p], at_j[p]
            at = head[a]
            x, y, z = sky.directions[b, 0], sky.directions[b, 1], sky.directions[b, 2]
            while at >= 0:
                c, at = partner[at], following[at]
                work += _PAIR_WORK
                cosine = x * sky.directions[c, 0] + y * sky.directions[c, 1] + z * sky.directions[c, 2]
                if not cos_low <= cosine <= cos_high or b == c:
                    continue
                v, u, w = sky.directions[a], sky.directions[b], sky.directions[c]
                real = triple_product(v, u, w)
                if seen * real <= 0.0 and abs(seen) > thin:
                    continue
                focal = 0.0
                if wide > 0.0:
                    r_ij, r_ik = math.log(ij / chord_angle(v, u)), math.log(ik / chord_angle(v, w))
                    r_jk = math.log(jk / chord_angle(u, w))
                    if (
                        abs(r_ij - r_jk) > t_ij / ij + t_jk / jk
                        or abs(r_ik - r_jk) > t_ik / ik + t_jk / jk
                        or abs(r_ij - r_ik) > t_ij / ij + t_ik / ik
                    ):
                        continue
                    focal = (r_ij * ij + r_ik * ik + r_jk * jk) / (ij + ik + jk)
                if not (
                    fits_prior(stars.vectors[i], v, limits)
                    and fits_prior(stars.vectors[j], u, limits)
                    and fits_prior(stars.vectors[k], w, limits)
                ):
                    continue
                found += 1
                work += _CANDIDATE_WORK + _LOOK_WORK * marked * looked
                if not enough_hits(u, w, 1.0 - focal, others, looked, need, sky, marks):
                    continue
                obs[0], obs[1], obs[2] = i, j, k
                gid[0], gid[1], gid[2] = a, b, c
                before = count
                count, cost = _weigh_triangle(obs, gid, focal, stars, sky, limits, finds, count)
                work += cost
                for row in range(count if count > before else 0):
                    sure = sure or finds.log_b[row] > limits.sure
                if sure:
                    at = -1
            if sure or work > limits.work:
                break
        for p in range(low_ik, high_ik):
            head[pairs.first[p]] = -1
            head[pairs.second[p]] = -1
    return count, done, found, work
