"""Kernels of tracking: predicted positions of guide stars, their match with observed stars, and its evidence.

All vectors are unit vectors in the camera frame. With p the predicted direction of a guide star and δ the attitude
error (rotation vector, camera axes, prior covariance P), the star is observed at p + p × δ. Along two unit vectors u
and v = p × u perpendicular to p this displacement is (−v·δ, u·δ), with the covariance from P plus the centroid variance
σ².
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from startracker._compiled import kernel, kernel_part
from startracker.catalog.sky_view import SkyView, in_shape, stars_in_cone
from startracker.core import FloatArray, IntArray
from startracker.estimation.directions import fit_turn
from startracker.geometry.linalg import cross, inverse, rotate_back, rotated, transform
from startracker.observer import aberrated
from startracker.sorting import order_of, sort


@kernel
def log_assignments(gain: FloatArray, rank: IntArray, n: int, in_field: int) -> float:
    """ln of the likelihood ratio of matches, averaged over the detection limit and the number of true stars.

    The brightest D guide stars of the field are detectable, with equal probability for D from 1 to K; M of the n
    observed stars are true, with equal probability for M from 0 to min(n, D) and for all assignments: 1/C(n, M) and (D
    − M)!/D!. Of the matches within a depth only the best M are used; the others would increase the result.

    Parameters
    ----------
    gain : (m,)
        ln of the density of each match times the area, in descending order.
    rank : (m,)
        Rank of its guide star by brightness, from 0.
    n, in_field : int
        Observed stars, and guide stars expected, K.
    """
    total, highest = 0.0, -math.inf
    for depth in range(1, in_field + 1):
        value, cumulative, m = 0.0, 0.0, 0
        for k in range(len(gain)):
            if rank[k] >= depth:
                continue
            m += 1
            # the match, minus ln of (D − M + 1) possible guide stars, and of C(n, M) / C(n, M − 1)
            cumulative += gain[k] - math.log(depth - m + 1) - math.log((n - m + 1) / m)
            value = max(value, cumulative)
        value -= math.log(min(n, depth) + 1.0)
        if value > highest:
            total = total * math.exp(highest - value) + 1.0
            highest = value
        else:
            total += math.exp(value - highest)
    return highest + math.log(total / in_field)


@kernel
def log_evidence(
    observed: FloatArray,
    sigma: FloatArray,
    predicted: FloatArray,
    index: IntArray,
    precision: FloatArray,
    turn: FloatArray,
    information: FloatArray,
    area: float,
) -> float:
    """ln B of a match: see `startracker.tracking.matching.track`, for the names of the arguments."""
    loss, rank, order = np.empty(len(index)), np.empty_like(index), np.empty_like(index)
    moved, count, prior = np.empty_like(predicted), 0, 0.0
    transform(rotated(np.eye(3), turn[0], turn[1], turn[2]), predicted, moved)
    for i in range(len(index)):
        if index[i] >= 0:
            p = moved[index[i]]
            d2 = (observed[i, 0] - p[0]) ** 2 + (observed[i, 1] - p[1]) ** 2 + (observed[i, 2] - p[2]) ** 2
            loss[count] = 0.5 * d2 / sigma[i] ** 2 - math.log(area / (2.0 * math.pi * sigma[i] ** 2))
            rank[count] = index[i]
            count += 1
    if count == 0:
        return -math.inf
    order_of(loss[:count], order)
    gain, ranks = np.empty(count), np.empty(count, np.int64)
    for m in range(count):
        gain[m], ranks[m] = -loss[order[m]], rank[order[m]]
    for r in range(3):
        for c in range(3):
            prior += turn[r] * precision[r, c] * turn[c]
    narrowing: float = inverse(precision + information, 3)[1] - inverse(precision, 3)[1]
    matches: float = log_assignments(gain, ranks, len(observed), len(predicted))
    return matches - 0.5 * (prior + narrowing)


GATE2 = 18.4
"""Limit of the squared Mahalanobis distance of a star, which is exceeded with probability 1e-4 (χ², two axes)."""
KEEP2 = 13.7
"""The same for the final match: a residual beyond 3.7 standard errors has probability 1e-3."""
_TIGHT2 = 1.5
_MOST_STARTS = 400
_ROUNDS = 8


@kernel
def expected_stars(
    matrix: FloatArray, sky: SkyView, beta: FloatArray, most: int
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Guide stars on the image at an attitude, in apparent directions for a moving observer; brightest first, at most
    `most`.

    Parameters
    ----------
    matrix : (3, 3)
        ICRS to camera.
    sky : SkyView
        Guide stars, without aberration.
    beta : (3,)
        The observer's velocity relative to that of light (`startracker.observer.aberrate`).

    Returns
    -------
    index (K,), apparent directions (K, 3) in ICRS axes, and in camera axes (K, 3).
    """
    b2 = beta[0] ** 2 + beta[1] ** 2 + beta[2] ** 2
    x, y, z = rotate_back(matrix, sky.shape.axes[2])
    # aberration can move a star into the field by up to β
    widest = math.cos(min(math.acos(sky.shape.widest_cosine) + 1.1 * math.sqrt(b2), math.pi))
    near = stars_in_cone(x, y, z, widest, sky.directions, sky.grid)
    sort(near)
    size = min(most, len(near))
    index = np.empty(size, np.int64)
    seen, predicted = np.empty((size, 3)), np.empty((size, 3))
    count = 0
    for star in near:
        if count == most:
            break
        g = sky.directions[star]
        gx, gy, gz = g[0], g[1], g[2]
        if b2 > 0.0:
            gx, gy, gz = aberrated(gx, gy, gz, (beta[0], beta[1], beta[2]))
        u = matrix[0, 0] * gx + matrix[0, 1] * gy + matrix[0, 2] * gz
        v = matrix[1, 0] * gx + matrix[1, 1] * gy + matrix[1, 2] * gz
        w = matrix[2, 0] * gx + matrix[2, 1] * gy + matrix[2, 2] * gz
        if in_shape(u, v, w, sky.shape):
            index[count] = star
            seen[count, 0], seen[count, 1], seen[count, 2] = gx, gy, gz
            predicted[count, 0], predicted[count, 1], predicted[count, 2] = u, v, w
            count += 1
    return index[:count], seen[:count], predicted[:count]


class Spread(NamedTuple):
    """Unit vectors u, v (K, 3) perpendicular to predicted directions, and the covariance of the stars along them (K, 3:
    uu, uv, vv)."""

    u: FloatArray
    v: FloatArray
    covariance: FloatArray


class Match(NamedTuple):
    """Predicted star of each observed one or −1, and squared Mahalanobis distance, (N,); observed star of each
    predicted one, (K,)."""

    partner: IntArray
    distance2: FloatArray
    owner: IntArray


@kernel_part
def tangent(p: FloatArray, u: FloatArray, v: FloatArray) -> None:
    """Two unit vectors perpendicular to a unit vector p, written to u and v = p × u."""
    if abs(p[0]) < 0.7:
        length = math.sqrt(p[1] ** 2 + p[2] ** 2)
        u[0], u[1], u[2] = 0.0, p[2] / length, -p[1] / length
    else:
        length = math.sqrt(p[0] ** 2 + p[2] ** 2)
        u[0], u[1], u[2] = -p[2] / length, 0.0, p[0] / length
    v[0], v[1], v[2] = cross(p, u)


@kernel
def spreads(predicted: FloatArray, covariance: FloatArray) -> Spread:
    """Covariance of predicted directions (K, 3) for the covariance (3, 3) of the attitude."""
    k = len(predicted)
    us, vs, out = np.empty((k, 3)), np.empty((k, 3)), np.empty((k, 3))
    for n in range(k):
        tangent(predicted[n], us[n], vs[n])
        uu, uv, vv = 0.0, 0.0, 0.0
        for i in range(3):
            for j in range(3):
                uu += us[n, i] * covariance[i, j] * us[n, j]
                uv += us[n, i] * covariance[i, j] * vs[n, j]
                vv += vs[n, i] * covariance[i, j] * vs[n, j]
        # along u the star moves by −v·δ, along v by u·δ
        out[n, 0], out[n, 1], out[n, 2] = vv, -uv, uu
    return Spread(us, vs, out)


@kernel_part
def _apart(
    observed: FloatArray, predicted: FloatArray, spread: Spread, k: int, s2: float
) -> tuple[float, float, float]:
    """Squared Mahalanobis distance of a star of variance `s2` from the predicted one `k`, and its displacement along u
    and v."""
    x, y, z = observed[0] - predicted[0], observed[1] - predicted[1], observed[2] - predicted[2]
    a = spread.u[k, 0] * x + spread.u[k, 1] * y + spread.u[k, 2] * z
    b = spread.v[k, 0] * x + spread.v[k, 1] * y + spread.v[k, 2] * z
    uu, uv, vv = spread.covariance[k, 0] + s2, spread.covariance[k, 1], spread.covariance[k, 2] + s2
    return (a * a * vv - 2.0 * a * b * uv + b * b * uu) / (uu * vv - uv * uv), a, b


@kernel
def match_gated(
    observed: FloatArray, sigma: FloatArray, predicted: FloatArray, spread: Spread, gate2: float, match: Match
) -> int:
    """Nearest predicted star of each observed one by Mahalanobis distance, one to one; returns the number of matches.

    Written to `match`. If two observed stars are nearest to the same predicted star, the nearer one is matched.
    """
    index, distance2, owner = match
    owner[:] = -1
    count, largest = 0, 0.0
    for k in range(len(predicted)):
        largest = max(largest, spread.covariance[k, 0] + spread.covariance[k, 2])
    for i in range(len(observed)):
        index[i], distance2[i] = -1, np.inf
        s2 = sigma[i] ** 2
        reach2 = gate2 * (largest + s2)
        best, at = gate2, -1
        for k in range(len(predicted)):
            far = 0.0
            for axis in range(3):
                far += (observed[i, axis] - predicted[k, axis]) ** 2
            if far > reach2:
                continue
            d2, _, _ = _apart(observed[i], predicted[k], spread, k, s2)
            if d2 < best:
                best, at = d2, k
        if at < 0:
            continue
        rival = owner[at]
        if rival >= 0:
            if distance2[rival] <= best:
                continue
            index[rival], distance2[rival] = -1, np.inf
            count -= 1
        owner[at], index[i], distance2[i] = i, at, best
        count += 1
    return count


@kernel
def track(
    observed: FloatArray, sigma: FloatArray, predicted: FloatArray, covariance: FloatArray, area: float
) -> tuple[IntArray, FloatArray, FloatArray, float]:
    """Match observed stars with predicted ones, and compute the evidence against chance.

    All stars are displaced by the same rotation. If the prediction is so uncertain that a gate may contain several
    stars, each pair within its gate proposes a rotation (the most probable one for that star alone), and the one with
    the most matches is used. Rotation and matches within 3.7 standard errors are then iterated until convergence.

    The evidence is the Bayes factor of `startracker.identification.bayes_factor` for an attitude of known covariance:
    ln B = −½ δᵀ P⁻¹ δ − ½ ln |1 + P N| + ln of the averaged assignments, with N the information of the stars. As the
    mean of B over random stars is one, they reach ln B = t with a probability of at most e⁻ᵗ.

    Parameters
    ----------
    observed, sigma : (N, 3), (N,)
        Directions and their standard errors on one axis, rad.
    predicted, covariance : (K, 3), (3, 3)
        Predicted directions, brightest first, camera frame; covariance of the predicted attitude, rad².
    area : float
        Solid angle searched for stars, sr.

    Returns
    -------
    predicted star of each observed one or −1 (N,), δ (3,), its posterior covariance (3, 3), ln B (−inf without
    matches).
    """
    n, k = len(observed), len(predicted)
    match = Match(np.full(n, -1), np.full(n, np.inf), np.full(k, -1))
    turn, moved = np.zeros(3), predicted.copy()
    nothing = match.partner, np.zeros(3), covariance, -math.inf
    if n == 0 or k == 0:
        return nothing
    precision, _ = inverse(covariance, 3)
    spread, smallest = spreads(predicted, covariance), np.min(sigma)
    if match_gated(observed, sigma, predicted, spread, GATE2, match) == 0:
        return nothing
    # a gate that is wide because of the prediction may contain the wrong star
    if np.max(spread.covariance[:, 0] + spread.covariance[:, 2]) > _TIGHT2 * smallest**2:
        turn = _consensus(observed, sigma, predicted, covariance, spread)
        posterior, _ = inverse(precision + np.eye(3) / (4.0 * smallest**2), 3)
    else:
        turn, posterior, _ = fit_turn(observed, sigma, predicted, match.partner, precision, turn)
    last, information = np.full(n, -2), precision
    for round_ in range(_ROUNDS):
        transform(rotated(np.eye(3), turn[0], turn[1], turn[2]), predicted, moved)
        spread = spreads(moved, posterior)
        if match_gated(observed, sigma, moved, spread, GATE2 if round_ == 0 else KEEP2, match) == 0:
            return match.partner, -turn, covariance, -math.inf
        same = True
        for i in range(n):
            same = same and match.partner[i] == last[i]
            last[i] = match.partner[i]
        turn, posterior, information = fit_turn(observed, sigma, predicted, match.partner, precision, turn)
        if same:
            break
    evidence = log_evidence(observed, sigma, predicted, match.partner, precision, turn, information, area)
    return match.partner, -turn, posterior, evidence


@kernel
def _consensus(
    observed: FloatArray, sigma: FloatArray, predicted: FloatArray, covariance: FloatArray, spread: Spread
) -> FloatArray:
    """The rotation (3,) with the most matches, of those proposed by single pairs within their gates."""
    n, k = len(observed), len(predicted)
    moved, match = np.empty_like(predicted), Match(np.empty(n, np.int64), np.empty(n), np.empty(k, np.int64))
    best_turn, best, starts = np.zeros(3), -np.inf, 0
    turn, left = np.empty(3), np.empty((3, 3))
    for j in range(k):
        for i in range(n):
            s2 = sigma[i] ** 2
            d2, a, b = _apart(observed[i], predicted[j], spread, j, s2)
            cosine = observed[i, 0] * predicted[j, 0] + observed[i, 1] * predicted[j, 1]
            cosine += observed[i, 2] * predicted[j, 2]
            if d2 > GATE2 or cosine < 0.5:
                continue
            starts += 1
            if starts > _MOST_STARTS:
                return best_turn
            _turn_of_one(covariance, spread, j, s2, (a, b), turn, left)
            transform(rotated(np.eye(3), turn[0], turn[1], turn[2]), predicted, moved)
            after = spreads(moved, left)
            count = match_gated(observed, sigma, moved, after, GATE2, match)
            # the weight of a match decreases with the logarithm of the area of its gate
            score = 1e-3 * count
            for m in range(n):
                if match.partner[m] >= 0:
                    room, w2 = after.covariance[match.partner[m]], sigma[m] ** 2
                    area = (room[0] + w2) * (room[2] + w2) - room[1] ** 2
                    score += max(0.0, -0.5 * match.distance2[m] - 0.5 * math.log(area / (w2 * w2)) + 0.5 * GATE2)
            if score > best:
                best, best_turn = score, turn.copy()
    return best_turn


@kernel_part
def _turn_of_one(
    covariance: FloatArray,
    spread: Spread,
    k: int,
    s2: float,
    away: tuple[float, float],
    turn: FloatArray,
    left: FloatArray,
) -> None:
    """Kalman update with one star displaced by `away` along u and v: rotation vector (3,) and updated covariance (3,
    3), written to `turn` and `left`. H = (v, −u)."""
    uu, uv, vv = spread.covariance[k, 0] + s2, spread.covariance[k, 1], spread.covariance[k, 2] + s2
    determinant, cu, cv = uu * vv - uv * uv, np.zeros(3), np.zeros(3)
    for r in range(3):
        for c in range(3):
            cu[r] += covariance[r, c] * spread.v[k, c]
            cv[r] -= covariance[r, c] * spread.u[k, c]
    for r in range(3):
        gain_a, gain_b = (cu[r] * vv - cv[r] * uv) / determinant, (cv[r] * uu - cu[r] * uv) / determinant
        turn[r] = gain_a * away[0] + gain_b * away[1]
        for c in range(3):
            left[r, c] = covariance[r, c] - gain_a * cu[c] - gain_b * cv[c]
