"""Kernel that checks an attitude against every observed star: match, refit, weigh.

The fit is Gauss–Newton in the rotation vector δ (and ε = Δ ln f, where the focal length is free): with b the observed
and p = R g the predicted unit vectors, b − p = δ × p − ε ∂b/∂ln f. For a pinhole ∂b/∂ln f = b_z (e_z − b_z b), of
length sin θ cos θ.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from startracker.catalog.field_shape import in_shape
from startracker.catalog.sky_view import SkyView
from startracker.catalog.voxels import stars_in_cone
from startracker.identification.bayes_factor import WEIGHINGS, log_bayes_factor, log_magnitude_ratios
from startracker.identification.clustering_null import clustering_price
from startracker.identification.search_state import Stars
from startracker.kernels import kernel
from startracker.sorting import sort

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

GATE_SIGMAS = 4.5
FOCAL_SIGMA = 0.01
"""Standard deviation of ln f beforehand, where the focal length is fitted: 2 % is two of these."""
MOST_EXTRA = 10
OVERHEAD = 10_000
"""Operations of a verification besides those that grow with the numbers of stars."""
_NARROWING = 3.0
_NARROWEST = 0.8
_ROUNDS = 5


@kernel
def focal_slopes(vectors: FloatArray) -> FloatArray:
    """∂b/∂ln f (N, 3) of unit vectors (N, 3) in the frame of a pinhole camera."""
    out = np.empty_like(vectors)
    for i in range(len(vectors)):
        z = vectors[i, 2]
        out[i, 0], out[i, 1], out[i, 2] = -z * z * vectors[i, 0], -z * z * vectors[i, 1], z * (1.0 - z * z)
    return out


@kernel
def turned(matrix: FloatArray, x: float, y: float, z: float) -> FloatArray:
    """exp([v]×) · matrix for a rotation vector v = (x, y, z), Rodrigues."""
    angle = math.sqrt(x * x + y * y + z * z)
    if angle == 0.0:
        return matrix.copy()
    s, c = math.sin(angle) / angle, (1.0 - math.cos(angle)) / (angle * angle)
    out = np.empty((3, 3))
    for k in range(3):
        p, q, r = matrix[0, k], matrix[1, k], matrix[2, k]
        u, v, w = y * r - z * q, z * p - x * r, x * q - y * p
        out[0, k] = p + s * u + c * (y * w - z * v)
        out[1, k] = q + s * v + c * (z * u - x * w)
        out[2, k] = r + s * w + c * (x * v - y * u)
    return out


@kernel
def solve_symmetric(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solution (n,) of a small positive definite system by Gaussian elimination; NaN where there is none."""
    n = len(right)
    a, x = matrix.copy(), right.copy()
    for i in range(n):
        if not a[i, i] > 1e-300:
            x[:] = np.nan
            return x
        for j in range(i + 1, n):
            factor = a[j, i] / a[i, i]
            for k in range(i, n):
                a[j, k] -= factor * a[i, k]
            x[j] -= factor * x[i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= a[i, k] * x[k]
        x[i] /= a[i, i]
    return x


@kernel
def guides_in_field(matrix: FloatArray, sky: SkyView, most: int) -> IntArray:
    """Guide stars on the image at an attitude, brightest first, at most `most`."""
    axis = sky.shape.axes[2]
    x = matrix[0, 0] * axis[0] + matrix[1, 0] * axis[1] + matrix[2, 0] * axis[2]
    y = matrix[0, 1] * axis[0] + matrix[1, 1] * axis[1] + matrix[2, 1] * axis[2]
    z = matrix[0, 2] * axis[0] + matrix[1, 2] * axis[1] + matrix[2, 2] * axis[2]
    near = stars_in_cone(x, y, z, sky.shape.widest_cosine, sky.directions, sky.grid)
    out = np.empty(len(near), np.int64)
    count = 0
    for star in near:
        g = sky.directions[star]
        u = matrix[0, 0] * g[0] + matrix[0, 1] * g[1] + matrix[0, 2] * g[2]
        v = matrix[1, 0] * g[0] + matrix[1, 1] * g[1] + matrix[1, 2] * g[2]
        w = matrix[2, 0] * g[0] + matrix[2, 1] * g[1] + matrix[2, 2] * g[2]
        if in_shape(u, v, w, sky.shape):
            out[count] = star
            count += 1
    sort(out[:count])
    return out[: min(count, most)]


@kernel
def match_nearest(
    points: FloatArray, places: FloatArray, gate: FloatArray, index: IntArray, distance: FloatArray, owner: IntArray
) -> int:
    """Nearest place (K, D) of each point (N, D) within its gate (N,), each place used once; how many have one.

    Where two points claim one place the one nearer in units of its gate keeps it. `index` (N,) gets the place or −1,
    `distance` (N,) the distance or inf; `owner` (K,) is scratch.
    """
    owner[: len(places)] = -1
    count = 0
    across = np.empty((2, len(places)))  # column by column, for several places at a time
    for j in range(len(places)):
        across[0, j], across[1, j] = places[j, 0], places[j, 1]
    for i in range(len(points)):
        index[i], distance[i] = -1, np.inf
        best, at = gate[i] ** 2, -1
        x, y = points[i, 0], points[i, 1]
        near = 0
        for j in range(len(places)):
            near += (across[0, j] - x) ** 2 + (across[1, j] - y) ** 2 <= best
        if near == 0:
            continue
        for j in range(len(places)):
            d = places[j, 0] - x
            d2 = d * d
            if d2 > best:
                continue
            d = places[j, 1] - y
            d2 += d * d
            for axis in range(2, points.shape[1]):
                d = places[j, axis] - points[i, axis]
                d2 += d * d
            if d2 <= best:
                best, at = d2, j
        if at < 0:
            continue
        away, rival = math.sqrt(best), owner[at]
        if rival >= 0:
            if distance[rival] / gate[rival] <= away / gate[i]:
                continue
            index[rival], distance[rival] = -1, np.inf
            count -= 1
        owner[at], index[i], distance[i] = i, at, away
        count += 1
    return count


@kernel
def fit_step(
    observed: FloatArray, slopes: FloatArray, predicted: FloatArray, index: IntArray, sigma: FloatArray, unknowns: int
) -> tuple[FloatArray, FloatArray]:
    """Normal matrix (unknowns, unknowns) and right-hand side of one Gauss–Newton step over the matched stars."""
    normal = np.zeros((unknowns, unknowns))
    right = np.zeros(unknowns)
    for i in range(len(observed)):
        if index[i] < 0:
            continue
        w = 1.0 / sigma[i] ** 2
        px, py, pz = predicted[index[i], 0], predicted[index[i], 1], predicted[index[i], 2]
        ex, ey, ez = observed[i, 0] - px, observed[i, 1] - py, observed[i, 2] - pz
        normal[0, 0] += w * (1.0 - px * px)
        normal[1, 1] += w * (1.0 - py * py)
        normal[2, 2] += w * (1.0 - pz * pz)
        normal[0, 1] -= w * px * py
        normal[0, 2] -= w * px * pz
        normal[1, 2] -= w * py * pz
        right[0] += w * (py * ez - pz * ey)
        right[1] += w * (pz * ex - px * ez)
        right[2] += w * (px * ey - py * ex)
        if unknowns == 4:
            dx, dy, dz = slopes[i, 0], slopes[i, 1], slopes[i, 2]
            normal[0, 3] -= w * (py * dz - pz * dy)
            normal[1, 3] -= w * (pz * dx - px * dz)
            normal[2, 3] -= w * (px * dy - py * dx)
            normal[3, 3] += w * (dx * dx + dy * dy + dz * dz)
            right[3] -= w * (dx * ex + dy * ey + dz * ez)
    for i in range(unknowns):
        for j in range(i):
            normal[i, j] = normal[j, i]
    return normal, right


@kernel
def _same(one: IntArray, other: IntArray) -> bool:
    """Whether two arrays of a length are equal."""
    differ = 0
    for k in range(len(one)):
        differ += one[k] != other[k]
    return differ == 0


@kernel
def verify_attitude(
    matrix: FloatArray, focal: float, stars: Stars, sky: SkyView, scale: float, free_focal: bool
) -> tuple[float, FloatArray, float, float, int, IntArray, int]:
    """Match, refit until it stands still, weigh; at `scale` times the stated errors, then at narrower gates.

    Parameters
    ----------
    matrix, focal : (3, 3), float
        ICRS to camera and ln of the focal length's factor, to start from.
    stars : Stars
        Observed; magnitudes NaN where they are not to count.
    sky : SkyView
    scale : float
        Of the first gate, which is 4.5 times this times the stated errors.
    free_focal : bool
        Whether ln f is fitted too, 0 ± `FOCAL_SIGMA` beforehand.

    Returns
    -------
    ln B (−inf: fewer than three stars agree), attitude (3, 3), ln of the focal length's factor, multiple of the stated
    errors that fits best, guide stars in the field, guide star of each observed star or −1 (N,), operations (stars
    compared with guide stars, and terms of the Bayes factor).
    """
    vectors, slopes, sigma = stars.vectors, stars.slopes, stars.sigma
    n, operations = len(vectors), OVERHEAD
    unknowns = 4 if free_focal else 3
    field = guides_in_field(matrix, sky, 2 * n + MOST_EXTRA)
    best, best_matrix, best_focal, best_scale = -math.inf, matrix, 0.0, scale
    best_index = np.full(n, -1, np.int64)
    if len(field) < 3:
        return best, best_matrix, best_focal, best_scale, len(field), best_index, operations
    reference = np.empty((len(field), 3))
    v_mag = np.empty(len(field))
    for k in range(len(field)):
        for axis in range(3):
            reference[k, axis] = sky.directions[field[k], axis]
        v_mag[k] = sky.v_mag[field[k]]
    predicted = np.empty((len(field), 3))
    observed = vectors.copy()
    index, last, weighed = np.empty(n, np.int64), np.empty(n, np.int64), np.full(n, -2, np.int64)
    distance = np.empty(n)
    owner = np.empty(len(field), np.int64)
    gate = np.empty(n)
    current = matrix
    if focal != 0.0:
        observed += focal * slopes
    step = scale
    while True:
        last[:] = -2
        count = 0
        for round_ in range(_ROUNDS):
            for k in range(len(field)):
                for axis in range(3):
                    predicted[k, axis] = (
                        current[axis, 0] * reference[k, 0]
                        + current[axis, 1] * reference[k, 1]
                        + current[axis, 2] * reference[k, 2]
                    )
            # a first match from few stars' attitude may be off by more far away from them
            widen = 2.0 if round_ == 0 and step == scale else 1.0
            for i in range(n):
                gate[i] = GATE_SIGMAS * step * sigma[i] * widen
            count = match_nearest(observed, predicted, gate, index, distance, owner)
            operations += n * len(field)
            if count < 3:
                break
            if _same(index, last):
                break
            for i in range(n):
                last[i] = index[i]
            normal, right = fit_step(observed, slopes, predicted, index, sigma, unknowns)
            normal /= step * step
            right /= step * step
            if free_focal:
                normal[3, 3] += 1.0 / FOCAL_SIGMA**2
                right[3] -= focal / FOCAL_SIGMA**2
            change = solve_symmetric(normal, right)
            if not math.isfinite(change[0]) or abs(change[0]) + abs(change[1]) + abs(change[2]) > 0.2:
                count = 0
                break
            current = turned(current, change[0], change[1], change[2])
            if free_focal:
                focal += change[3]
                for i in range(n):
                    for axis in range(3):
                        observed[i, axis] = vectors[i, axis] + focal * slopes[i, axis]
        if count < 3:
            break
        if not free_focal and _same(index, weighed):  # a narrower gate that drops none changes nothing
            if step <= _NARROWEST:
                break
            step = max(step / _NARROWING, _NARROWEST)
            continue
        for i in range(n):
            weighed[i] = index[i]
        # the last fit's own residuals
        for k in range(len(field)):
            for axis in range(3):
                predicted[k, axis] = (
                    current[axis, 0] * reference[k, 0]
                    + current[axis, 1] * reference[k, 1]
                    + current[axis, 2] * reference[k, 2]
                )
        for i in range(n):
            if index[i] >= 0:
                k = index[i]
                distance[i] = math.sqrt(
                    (observed[i, 0] - predicted[k, 0]) ** 2
                    + (observed[i, 1] - predicted[k, 1]) ** 2
                    + (observed[i, 2] - predicted[k, 2]) ** 2
                )
        information, _ = fit_step(observed, slopes, predicted, index, sigma, unknowns)
        ratios = log_magnitude_ratios(stars.magnitude, index, v_mag)
        value, fitting = log_bayes_factor(
            distance, index, sigma, information, ratios, len(field), sky.area, FOCAL_SIGMA, stars.counts
        )
        value -= clustering_price(stars.excess, index)
        operations += WEIGHINGS * count * len(field)
        if value > best:
            best, best_matrix, best_focal, best_scale = value, current, focal, fitting
            for i in range(n):
                best_index[i] = field[index[i]] if index[i] >= 0 else -1
        if step <= _NARROWEST:
            break
        step = max(step / _NARROWING, _NARROWEST)
    return best, best_matrix, best_focal, best_scale, len(field), best_index, operations
