"""Kernels of tracking: where the guide stars should be, which observed star is which, and whether that can be chance.

All is done with unit vectors in the camera frame. With p a guide star's predicted direction and δ the attitude's error
(rotation vector, camera axes, covariance P beforehand), the star is seen at p + p × δ; across p along two unit vectors
u and v = p × u that is (−v·δ, u·δ), whose covariance is what P gives plus the centroid's σ².
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from startracker.catalog.field_shape import in_shape
from startracker.catalog.sky_view import SkyView
from startracker.catalog.voxels import stars_in_cone
from startracker.identification.verification import turned
from startracker.kernels import kernel
from startracker.tracking.evidence import log_evidence, turn_places

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

GATE2 = 18.4
"""Squared Mahalanobis distance of a star on the image that a good one exceeds with probability 1e-4 (χ², two axes)."""
KEEP2 = 13.7
"""The same for the final match: a residual beyond 3.7 standard errors has probability 1e-3."""
_TIGHT2 = 1.5
_MOST_STARTS = 400
_ROUNDS = 8


@kernel
def expected_stars(
    matrix: FloatArray, sky: SkyView, beta: FloatArray, most: int
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Guide stars on the image at an attitude, as a moving observer sees them; brightest first, at most `most`.

    Parameters
    ----------
    matrix : (3, 3)
        ICRS to camera.
    sky : SkyView
        Its directions without aberration.
    beta : (3,)
        The observer's velocity over that of light (`startracker.observer.aberrate`).

    Returns
    -------
    index (K,), directions seen (K, 3) in ICRS axes, and in the camera's (K, 3).
    """
    axis = sky.shape.axes[2]
    b2 = beta[0] ** 2 + beta[1] ** 2 + beta[2] ** 2
    inverse_gamma = math.sqrt(1.0 - b2)
    x = matrix[0, 0] * axis[0] + matrix[1, 0] * axis[1] + matrix[2, 0] * axis[2]
    y = matrix[0, 1] * axis[0] + matrix[1, 1] * axis[1] + matrix[2, 1] * axis[2]
    z = matrix[0, 2] * axis[0] + matrix[1, 2] * axis[1] + matrix[2, 2] * axis[2]
    # aberration can bring a star in from outside by as much as β
    widest = math.cos(min(math.acos(sky.shape.widest_cosine) + 1.1 * math.sqrt(b2), math.pi))
    near = np.sort(stars_in_cone(x, y, z, widest, sky.directions, sky.grid))
    size = min(most, len(near))
    index = np.empty(size, np.int64)
    seen, places = np.empty((size, 3)), np.empty((size, 3))
    count = 0
    for star in near:
        if count == most:
            break
        g = sky.directions[star]
        gx, gy, gz = g[0], g[1], g[2]
        if b2 > 0.0:
            along = gx * beta[0] + gy * beta[1] + gz * beta[2]
            share = 1.0 + along / (1.0 + inverse_gamma)
            gx = gx * inverse_gamma + beta[0] * share
            gy = gy * inverse_gamma + beta[1] * share
            gz = gz * inverse_gamma + beta[2] * share
            length = math.sqrt(gx * gx + gy * gy + gz * gz)
            gx, gy, gz = gx / length, gy / length, gz / length
        u = matrix[0, 0] * gx + matrix[0, 1] * gy + matrix[0, 2] * gz
        v = matrix[1, 0] * gx + matrix[1, 1] * gy + matrix[1, 2] * gz
        w = matrix[2, 0] * gx + matrix[2, 1] * gy + matrix[2, 2] * gz
        if in_shape(u, v, w, sky.shape):
            index[count] = star
            seen[count, 0], seen[count, 1], seen[count, 2] = gx, gy, gz
            places[count, 0], places[count, 1], places[count, 2] = u, v, w
            count += 1
    return index[:count], seen[:count], places[:count]


@kernel
def tangent(p: FloatArray, u: FloatArray, v: FloatArray) -> None:
    """Two unit vectors across a unit vector p, written to u and v = p × u."""
    if abs(p[0]) < 0.7:
        length = math.sqrt(p[1] ** 2 + p[2] ** 2)
        u[0], u[1], u[2] = 0.0, p[2] / length, -p[1] / length
    else:
        length = math.sqrt(p[0] ** 2 + p[2] ** 2)
        u[0], u[1], u[2] = -p[2] / length, 0.0, p[0] / length
    v[0] = p[1] * u[2] - p[2] * u[1]
    v[1] = p[2] * u[0] - p[0] * u[2]
    v[2] = p[0] * u[1] - p[1] * u[0]


@kernel
def spreads(places: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Tangents u, v (K, 3) of predicted directions, and the covariance (K, 3: uu, uv, vv) of the stars across them."""
    k = len(places)
    us, vs, out = np.empty((k, 3)), np.empty((k, 3)), np.empty((k, 3))
    for n in range(k):
        tangent(places[n], us[n], vs[n])
        uu, uv, vv = 0.0, 0.0, 0.0
        for i in range(3):
            for j in range(3):
                uu += us[n, i] * covariance[i, j] * us[n, j]
                uv += us[n, i] * covariance[i, j] * vs[n, j]
                vv += vs[n, i] * covariance[i, j] * vs[n, j]
        # along u the star moves by −v·δ, along v by u·δ
        out[n, 0], out[n, 1], out[n, 2] = vv, -uv, uu
    return us, vs, out


@kernel
def match_gated(
    observed: FloatArray,
    sigma: FloatArray,
    places: FloatArray,
    us: FloatArray,
    vs: FloatArray,
    spread: FloatArray,
    gate2: float,
    index: IntArray,
    distance2: FloatArray,
    owner: IntArray,
) -> int:
    """Nearest predicted star of each observed one by Mahalanobis distance, each used once; how many have one.

    `index` (N,) gets the predicted star or −1, `distance2` (N,) the squared distance; `owner` (K,) is scratch. Where
    two observed stars claim one predicted star the nearer keeps it.
    """
    owner[:] = -1
    count = 0
    largest = 0.0
    for k in range(len(places)):
        largest = max(largest, spread[k, 0] + spread[k, 2])
    for i in range(len(observed)):
        index[i], distance2[i] = -1, np.inf
        s2 = sigma[i] ** 2
        reach2 = gate2 * (largest + s2)
        best, at = gate2, -1
        for k in range(len(places)):
            x = observed[i, 0] - places[k, 0]
            far = x * x
            if far > reach2:
                continue
            y = observed[i, 1] - places[k, 1]
            far += y * y
            if far > reach2:
                continue
            z = observed[i, 2] - places[k, 2]
            if far + z * z > reach2:
                continue
            a = us[k, 0] * x + us[k, 1] * y + us[k, 2] * z
            b = vs[k, 0] * x + vs[k, 1] * y + vs[k, 2] * z
            uu, uv, vv = spread[k, 0] + s2, spread[k, 1], spread[k, 2] + s2
            d2 = (a * a * vv - 2.0 * a * b * uv + b * b * uu) / (uu * vv - uv * uv)
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
def inverse_3(m: FloatArray) -> FloatArray:
    """Inverse of a symmetric (3, 3) matrix."""
    out = np.empty((3, 3))
    out[0, 0] = m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1]
    out[0, 1] = m[0, 2] * m[2, 1] - m[0, 1] * m[2, 2]
    out[0, 2] = m[0, 1] * m[1, 2] - m[0, 2] * m[1, 1]
    out[1, 1] = m[0, 0] * m[2, 2] - m[0, 2] * m[2, 0]
    out[1, 2] = m[0, 2] * m[1, 0] - m[0, 0] * m[1, 2]
    out[2, 2] = m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0]
    out[1, 0], out[2, 0], out[2, 1] = out[0, 1], out[0, 2], out[1, 2]
    out /= m[0, 0] * out[0, 0] + m[0, 1] * out[1, 0] + m[0, 2] * out[2, 0]
    return out


@kernel
def _fit(
    observed: FloatArray,
    sigma: FloatArray,
    places: FloatArray,
    index: IntArray,
    precision: FloatArray,
    delta: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Most probable error (3,), its covariance (3, 3), and the stars' own information, from matched stars."""
    moved = np.empty_like(places)
    information = np.zeros((3, 3))
    covariance = precision
    for _ in range(3):
        turn_places(turned(np.eye(3), -delta[0], -delta[1], -delta[2]), places, moved)
        information = np.zeros((3, 3))
        right = np.zeros(3)
        for i in range(len(observed)):
            if index[i] < 0:
                continue
            p, b, w = moved[index[i]], observed[i], 1.0 / sigma[i] ** 2
            for r in range(3):
                information[r, r] += w
                for c in range(3):
                    information[r, c] -= w * p[r] * p[c]
            right[0] += w * (b[1] * p[2] - b[2] * p[1])
            right[1] += w * (b[2] * p[0] - b[0] * p[2])
            right[2] += w * (b[0] * p[1] - b[1] * p[0])
        covariance = inverse_3(information + precision)
        largest = 0.0
        step = np.zeros(3)
        for r in range(3):
            for c in range(3):
                pull = precision[c, 0] * delta[0] + precision[c, 1] * delta[1] + precision[c, 2] * delta[2]
                step[r] += covariance[r, c] * (right[c] - pull)
            largest = max(largest, abs(step[r]))
        for r in range(3):
            delta[r] += step[r]
        if largest < 1e-9:
            break
    return delta, covariance, information


@kernel
def track(
    observed: FloatArray, sigma: FloatArray, places: FloatArray, covariance: FloatArray, area: float
) -> tuple[IntArray, FloatArray, FloatArray, float]:
    """Match observed stars with predicted ones, and weigh whether chance would do as well.

    All stars are off by the same rotation. Where the prediction is so uncertain that a gate can hold several stars,
    each pair within its gate proposes a rotation, the most probable one of that star alone, and the one under which
    most stars fit is followed. Then, until nothing changes: the most probable rotation, and the match within 3.7
    standard errors of it.

    The evidence is the Bayes factor of `startracker.identification.bayes_factor` for an attitude of known covariance:
    ln B = −½ δᵀ P⁻¹ δ − ½ ln |1 + P N| + ln of the averaged assignments, with N the stars' information. As its mean
    over random stars is one, they reach ln B = t with a probability of e⁻ᵗ at most.

    Parameters
    ----------
    observed, sigma : (N, 3), (N,)
        Directions and their standard errors on one axis, rad.
    places : (K, 3)
        Predicted directions, brightest first, camera frame.
    covariance : (3, 3)
        Of the predicted attitude, rad².
    area : float
        Solid angle in which stars were looked for, sr.

    Returns
    -------
    predicted star of each observed one or −1 (N,), δ (3,), its covariance given prediction and stars (3, 3), ln B
    (−inf where nothing matches).
    """
    n, k = len(observed), len(places)
    index = np.full(n, -1, np.int64)
    delta = np.zeros(3)
    if n == 0 or k == 0:
        return index, delta, covariance, -math.inf
    distance2 = np.empty(n)
    owner = np.empty(k, np.int64)
    precision = inverse_3(covariance)
    us, vs, spread = spreads(places, covariance)
    count = match_gated(observed, sigma, places, us, vs, spread, GATE2, index, distance2, owner)
    if count == 0:
        return index, delta, covariance, -math.inf
    widest = 0.0
    for j in range(k):
        widest = max(widest, spread[j, 0] + spread[j, 2])
    smallest = np.min(sigma)
    # a gate that the prediction rather than the centroid makes wide may hold the wrong star
    if widest > _TIGHT2 * smallest**2:
        delta = _consensus(observed, sigma, places, covariance, us, vs, spread)
    moved = np.empty_like(places)
    last = np.full(n, -2, np.int64)
    posterior = covariance
    if widest <= _TIGHT2 * smallest**2:
        delta, posterior, _ = _fit(observed, sigma, places, index, precision, delta)
    else:
        posterior = inverse_3(precision + np.eye(3) / (4.0 * smallest**2))
    information = np.zeros((3, 3))
    for round_ in range(_ROUNDS):
        turn_places(turned(np.eye(3), -delta[0], -delta[1], -delta[2]), places, moved)
        us, vs, spread = spreads(moved, posterior)
        gate2 = GATE2 if round_ == 0 else KEEP2
        count = match_gated(observed, sigma, moved, us, vs, spread, gate2, index, distance2, owner)
        if count == 0:
            return index, delta, covariance, -math.inf
        same = True
        for i in range(n):
            if index[i] != last[i]:
                same = False
                break
        delta, posterior, information = _fit(observed, sigma, places, index, precision, delta)
        if same:
            break
        last[:] = index
    return (
        index,
        delta,
        posterior,
        log_evidence(observed, sigma, places, index, covariance, precision, delta, information, area),
    )


@kernel
def _consensus(
    observed: FloatArray,
    sigma: FloatArray,
    places: FloatArray,
    covariance: FloatArray,
    us: FloatArray,
    vs: FloatArray,
    spread: FloatArray,
) -> FloatArray:
    """The rotation (3,), of those that one pair of stars within its gate proposes, under which the most stars fit."""
    n, k = len(observed), len(places)
    moved = np.empty_like(places)
    index, distance2, owner = np.empty(n, np.int64), np.empty(n), np.empty(k, np.int64)
    best_delta = np.zeros(3)
    best = -np.inf
    starts = 0
    delta, left = np.empty(3), np.empty((3, 3))
    cu, cv = np.empty(3), np.empty(3)
    for j in range(k):
        for i in range(n):
            e0 = observed[i, 0] - places[j, 0]
            e1 = observed[i, 1] - places[j, 1]
            e2 = observed[i, 2] - places[j, 2]
            a = us[j, 0] * e0 + us[j, 1] * e1 + us[j, 2] * e2
            b = vs[j, 0] * e0 + vs[j, 1] * e1 + vs[j, 2] * e2
            s2 = sigma[i] ** 2
            uu, uv, vv = spread[j, 0] + s2, spread[j, 1], spread[j, 2] + s2
            determinant = uu * vv - uv * uv
            d2 = (a * a * vv - 2.0 * a * b * uv + b * b * uu) / determinant
            if d2 > GATE2 or e0 * e0 + e1 * e1 + e2 * e2 > 1.0:
                continue
            starts += 1
            if starts > _MOST_STARTS:
                return best_delta
            # Kalman update with this star alone: H = (−v, u)
            for r in range(3):
                cu[r], cv[r] = 0.0, 0.0
                for c in range(3):
                    cu[r] -= covariance[r, c] * vs[j, c]
                    cv[r] += covariance[r, c] * us[j, c]
            for r in range(3):
                gain_a = (cu[r] * vv - cv[r] * uv) / determinant
                gain_b = (cv[r] * uu - cu[r] * uv) / determinant
                delta[r] = gain_a * a + gain_b * b
                for c in range(3):
                    left[r, c] = covariance[r, c] - gain_a * cu[c] - gain_b * cv[c]
            turn_places(turned(np.eye(3), -delta[0], -delta[1], -delta[2]), places, moved)
            u2, v2, after = spreads(moved, left)
            count = match_gated(observed, sigma, moved, u2, v2, after, GATE2, index, distance2, owner)
            # a wide gate is easily met: what a match is worth falls with the logarithm of its area
            score = 0.0
            for m in range(n):
                if index[m] >= 0:
                    q = index[m]
                    w2 = sigma[m] ** 2
                    room = (after[q, 0] + w2) * (after[q, 2] + w2) - after[q, 1] ** 2
                    score += max(0.0, -0.5 * distance2[m] - 0.5 * math.log(room / (w2 * w2)) + 0.5 * GATE2)
            score += 1e-3 * count
            if score > best:
                best = score
                best_delta = delta.copy()
    return best_delta
