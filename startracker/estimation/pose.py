"""Attitude and covariance of a field, with errors of the stated covariances and of the camera estimated from residuals.

Measured minus predicted positions of M identified stars, in pixels, are modelled as

    r_i = J_i θ + B_i u + e_i,   e_i ~ N(0, s² (C_i + τ² T)),   u ~ N(0, Λ)

θ is the rotation vector of the attitude's correction, J_i = ∂(x, y)/∂θ; C_i is the stated covariance of the centroid.
Unknowns in addition to the noise:

s²
    factor of all variances: scaled inverse χ² with `TRUSTED` degrees of freedom about 1 for stated errors, Jeffreys'
    prior 1/s² otherwise;
τ
    systematic error, equal for faint and bright stars (image shapes that differ from the centroider's, blends,
    catalogue), on a grid of multiples of the median stated error; zero with a probability from the misfit of the
    brightest star images (`image_errors`). T, of trace 2, is I unless the residuals are significantly larger along one
    direction, as for undersampled images with coma;
u
    smooth displacements B_i over the image: the focal length; two shears (with focal length and rotation any affine map
    of the image, as caused by rotation during a rolling readout); and columns given by the caller (`predicted_pixels`).

For a given τ and a given set of columns the model is linear, and its posterior is known in closed form (O'Hagan &
Forster 2004, *Kendall's Advanced Theory of Statistics 2B*, chapter 11). With V = diag(C_i + τ² T), H = [J B],
N = Hᵀ V⁻¹ H + Λ⁻¹, χ² = rᵀ V⁻¹ r − rᵀ V⁻¹ H N⁻¹ Hᵀ V⁻¹ r, ν = 2M − 3 and n the degrees of freedom of the prior of s²:

    mean        N⁻¹ Hᵀ V⁻¹ r
    covariance  N⁻¹ (n + χ²)/(n + ν − 2), that of a t distribution
    evidence    Γ((n + ν)/2)/Γ(n/2) n^(n/2) π^(−ν/2) |V|^(−1/2) |Λ|^(−1/2) |N|^(−1/2) (n + χ²)^(−(n + ν)/2)

The models are averaged with their evidence (Hoeting et al. 1999, Statistical Science 14, 382): the covariance is the
mean of theirs plus the scatter of their means. Without significant deviations the plain model has nearly all the
weight, and the result is the weighted least-squares fit with its usual covariance P = [Σ Jᵀ C⁻¹ J]⁻¹; significant
deviations are fitted, and increase the covariance by their remaining uncertainty.

A shear by w of the columns against the rows, x += 2 w y, is half a shear (x, y) += w (y, x) and half a rotation by w,
which does not appear in residuals; therefore w² is added to the variance about the boresight.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from startracker._compiled import kernel, kernel_part
from startracker.core import FloatArray
from startracker.estimation.image_errors import AS_ASSUMED
from startracker.geometry.linalg import inverse
from startracker.sorting import median

TRUSTED = 20.0
"""Degrees of freedom of the stated errors: the prior uncertainty of their common factor is 1/√(2 · 20) = 16 %."""
_OCTAVES = 0.5 * np.arange(19)
SYSTEMATIC = np.concatenate((np.zeros(1), 0.2 * 2.0**_OCTAVES))
"""Values of τ in units of the median stated error."""
_FALLING = 0.75**_OCTAVES
_PRIOR_OF_SYSTEMATIC = np.log(np.concatenate((np.ones(1), _FALLING / _FALLING.sum())))
"""Prior of each value given that τ is nonzero; large values are less probable, as three stars hardly determine it."""
FOCAL_SIGMA, SHEAR_SIGMA = 5e-4, 1e-3
"""Prior relative error of a calibrated focal length and of a shear, if present."""
FREE_FOCAL_SIGMA = 1e-2
"""Prior relative error of the focal length if the frame indicates a large one."""
UNKNOWN_FLOOR_PX = 0.003
"""Minimum error of centroids without stated errors, which may agree by chance or be rounded."""
_PRIOR_OF_MODELS = np.log(np.array([0.6, 0.3, 0.1]))
"""Models: camera as calibrated; focal length free; focal length and shears free."""
_LEAST_ELONGATION = 9.0
"""Significance limit of the systematic error: square over variance, exceeded by noise with probability 1/90."""
_MOST_ELONGATION = 0.95
_FARTHEST_SQUARE = 9.0


class Linearised(NamedTuple):
    """Stars of one field, linearised about an initial attitude."""

    residual: FloatArray
    """Measured minus predicted, pixels, (M, 2)."""
    slopes: FloatArray
    """`startracker.geometry.image_map.pixel_slopes`, (M, 2, 3)."""
    offset: FloatArray
    """Predicted positions relative to the principal point, (M, 2), which scale with the focal length."""
    covariance: FloatArray
    """Stated covariance, pixels², (M, 2, 2)."""
    extra: FloatArray
    extra_sigma: FloatArray
    """Displacements that are always fitted, (M, 2, E), and prior standard deviations of their amplitudes, (E,)."""
    as_assumed: float = AS_ASSUMED
    """Prior probability of no τ (`probability_as_assumed`)."""


class Pose(NamedTuple):
    """Fit of one field."""

    turn: FloatArray
    """Rotation vector θ that corrects the attitude, (3,): v → v − θ × v in the camera."""
    covariance: FloatArray
    """Covariance of the rotation vector, rad², (3, 3)."""
    camera_part: FloatArray
    """Part of it due to the unknowns of the camera, (3, 3)."""
    sigma_px: FloatArray
    """Standard error of each star on one axis, including systematic part and factor, (M,)."""
    systematic_px2: float
    """Mean of s² τ²."""
    factor: float
    """Mean of s²."""
    unknowns: FloatArray
    unknowns_variance: FloatArray
    """Amplitudes of the caller's columns, relative correction of the focal length, shears (`displacements`), and their
    variances, (E + 3,)."""
    log_evidence: float
    """ln of the evidence of all models together, comparable with that of some of the same stars if their errors are
    stated, and otherwise with that of the same stars."""
    chi2: float
    """χ² of the first model without systematic error: of the residuals and stated errors."""


@kernel
def _columns(stars: Linearised) -> FloatArray:
    """H (M, 2, 6 + E): rotation, the caller's columns, focal length, shears."""
    slopes, extra, offset = stars.slopes, stars.extra, stars.offset
    known = extra.shape[2]
    out = np.empty((len(offset), 2, 6 + known))
    for n in range(len(offset)):
        for axis in range(2):
            for k in range(3 + known):
                out[n, axis, k] = slopes[n, axis, k] if k < 3 else extra[n, axis, k - 3]
            out[n, axis, 3 + known] = offset[n, axis]
            out[n, axis, 4 + known] = -offset[n, axis] if axis else offset[n, axis]
            out[n, axis, 5 + known] = offset[n, 1 - axis]
    return out


@kernel_part
def _prior_sigma(extra_sigma: FloatArray, first: int) -> FloatArray:
    """Prior standard deviations of each model's unknowns except the rotation, (3, 6 + E)."""
    known = len(extra_sigma)
    out = np.empty((3, 6 + known))
    for model in range(3):
        for k in range(6 + known):
            out[model, k] = extra_sigma[k - 3] if 3 <= k < 3 + known else SHEAR_SIGMA
        out[model, 3 + known] = FOCAL_SIGMA if model == 1 and first == 0 else FREE_FOCAL_SIGMA
    return out


@kernel
def displacements(offset: FloatArray, extra: FloatArray, unknowns: FloatArray) -> FloatArray:
    """Displacements (M, 2) of stars by the unknowns of the camera (`Pose.unknowns`), pixels; see `Linearised`."""
    known, moved = extra.shape[2], np.empty_like(offset)
    focal, one, two = unknowns[known], unknowns[known + 1], unknowns[known + 2]
    for n in range(len(offset)):
        x, y = offset[n, 0], offset[n, 1]
        moved[n, 0], moved[n, 1] = x * (focal + one) + y * two, x * two + y * (focal - one)
        for k in range(known):
            for axis in range(2):
                moved[n, axis] += extra[n, axis, k] * unknowns[k]
    return moved


def fit_pose(stars: Linearised, trusted: float, first: int, models: int, rounds: int) -> Pose:
    """Average of all models of the module's docstring, weighted by evidence.

    Parameters
    ----------
    stars : Linearised
    trusted : float
        Degrees of freedom of the stated errors; 0: unknown errors, of which only the ratios are given, and no τ.
    first : int
        First model: 0 if the camera may be as calibrated, 1 if the focal length is always fitted.
    models : int
        Number of models: 3, or 2 if the caller's columns already include shears.
    rounds : int
        1; or 2, if errors are unknown: they are scaled in place, to the mean square residual, then to the first fit's.
    """
    columns, isotropic, covariance = _columns(stars), np.eye(2), stars.covariance
    if rounds > 1:
        covariance *= max(float(np.mean(stars.residual**2)), UNKNOWN_FLOOR_PX**2)
    pose: Pose = _fit_models(stars, columns, trusted, first, models, isotropic)
    for _ in range(rounds - 1):
        covariance *= pose.factor
        pose = _fit_models(stars, columns, trusted, first, models, isotropic)
    if trusted == 0.0 or pose.systematic_px2 == 0.0:
        return pose
    shape = _shape_of_systematic(stars.residual, columns, pose)
    if np.array_equal(shape, isotropic):
        return pose
    elongated: Pose = _fit_models(stars, columns, trusted, first, models, shape)
    return elongated


@kernel
def _shape_of_systematic(residual: FloatArray, columns: FloatArray, pose: Pose) -> FloatArray:
    """T (2, 2) of trace 2, in which the systematic error has the covariance τ² T.

    With z = r/σ of the fit with T = I and g the systematic fraction of a star's variance, E[z zᵀ] = I + g (T − I):
    least squares for the two elements of T − I, each with variance 1/Σ g². They are zero if not significant, and
    otherwise reduced, so that T is continuous in the residuals.
    """
    a, b, information = 0.0, 0.0, 0.0
    for n in range(len(residual)):
        x, y = residual[n, 0], residual[n, 1]
        for k in range(columns.shape[2]):
            amplitude = pose.turn[k] if k < 3 else pose.unknowns[k - 3]
            x, y = x - columns[n, 0, k] * amplitude, y - columns[n, 1, k] * amplitude
        variance = pose.sigma_px[n] ** 2
        share = pose.systematic_px2 / variance
        # A single outlier must not determine the shape.
        square = max(x * x + y * y, 1e-300) / variance
        share_of_one = share * min(1.0, _FARTHEST_SQUARE / square) / variance
        a, b = a + share_of_one * 0.5 * (x * x - y * y), b + share_of_one * x * y
        information += share * share
    shape = np.empty((2, 2))
    shape[0, 0], shape[0, 1], shape[1, 0], shape[1, 1] = 1.0, 0.0, 0.0, 1.0
    size = math.hypot(a, b) / information
    if size * size * information > _LEAST_ELONGATION:
        size_kept = min(size * (1.0 - (_LEAST_ELONGATION / (size * size * information)) ** 2), _MOST_ELONGATION)
        a, b = a * size_kept / (size * information), b * size_kept / (size * information)
        shape[0, 0], shape[0, 1], shape[1, 0], shape[1, 1] = 1.0 + a, b, b, 1.0 - a
    return shape


@kernel
def _fit_models(
    stars: Linearised, columns: FloatArray, trusted: float, first: int, models: int, shape: FloatArray
) -> Pose:
    """`fit_pose` with the systematic error's covariance τ² `shape`."""
    stated = stars.covariance
    prior_sigma = _prior_sigma(stars.extra_sigma, first)
    trace, to_sort = np.empty(len(columns)), np.empty(len(columns))
    for n in range(len(columns)):
        trace[n] = to_sort[n] = 0.5 * (stated[n, 0, 0] + stated[n, 1, 1])
    unit = median(to_sort)
    weight, scale, mean, every, plain = _fit_each_model(
        stars, columns, prior_sigma, trusted, first, models, unit, shape
    )
    power = max(trusted + 2.0 * len(columns) - 3.0 - (2.0 if trusted > 0.0 else 0.0), 1.0)
    chi2 = scale[0, first] * power - trusted
    pose: Pose = _averaged(weight, scale, mean, every, plain, trace, unit, chi2)
    return pose


@kernel
def _weighted_sums(
    stars: Linearised, columns: FloatArray, systematic: FloatArray, normal: FloatArray, right: FloatArray
) -> tuple[float, float]:
    """Hᵀ V⁻¹ H and Hᵀ V⁻¹ r, written to `normal` and `right`; rᵀ V⁻¹ r and ln |V|. V has a systematic part (2, 2)."""
    normal[:], right[:] = 0.0, 0.0
    total, log_det, last, log_last = 0.0, 0.0, 1.0, 0.0
    for n in range(len(stars.residual)):
        a, c = stars.covariance[n, 0, 0] + systematic[0, 0], stars.covariance[n, 1, 1] + systematic[1, 1]
        b = stars.covariance[n, 0, 1] + systematic[0, 1]
        det = a * c - b * b
        wa, wb, wc = c / det, -b / det, a / det
        if det != last:  # mostly that of the star before
            last, log_last = det, math.log(det)
        log_det += log_last
        x, y = stars.residual[n, 0], stars.residual[n, 1]
        total += x * (wa * x + wb * y) + y * (wb * x + wc * y)
        for i in range(len(right)):
            u = wa * columns[n, 0, i] + wb * columns[n, 1, i]
            v = wb * columns[n, 0, i] + wc * columns[n, 1, i]
            right[i] += u * x + v * y
            for j in range(i + 1):
                normal[i, j] += u * columns[n, 0, j] + v * columns[n, 1, j]
    return total, log_det


@kernel
def _fit_each_model(
    stars: Linearised,
    columns: FloatArray,
    prior_sigma: FloatArray,
    trusted: float,
    first: int,
    models: int,
    unit: float,
    shape: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """All models, with the systematic error's covariance τ² `shape`: logarithms of their weights and scales
    (grid, 3), means (grid, 3, 6 + E) and covariances of all unknowns, and covariances (grid, 3, 3) of rotations alone.

    `prior_sigma` is that of `_prior_sigma`.
    """
    widest, known = columns.shape[2], columns.shape[2] - 6
    freedom = 2.0 * len(columns) - 3.0
    grid = len(SYSTEMATIC) if trusted > 0.0 else 1
    weight, scale = np.full((grid, 3), -np.inf), np.zeros((grid, 3))
    mean, every = np.zeros((grid, 3, widest)), np.zeros((grid, 3, widest, widest))
    plain, normal, right = np.zeros((grid, 3, 3)), np.empty((widest, widest)), np.empty(widest)
    added, flat = np.empty((widest, widest)), np.empty((2, 2))
    # This constant is the same for all models, but not for fits of fewer stars.
    constant = 0.0
    if trusted > 0.0:
        constant = math.lgamma(0.5 * (trusted + freedom)) - math.lgamma(0.5 * trusted)
        constant += 0.5 * (trusted * math.log(trusted) - freedom * math.log(math.pi))
    for t in range(grid):
        for i in range(2):
            for j in range(2):
                flat[i, j] = SYSTEMATIC[t] ** 2 * unit * shape[i, j]
        total, log_det = _weighted_sums(stars, columns, flat, normal, right)
        rotation, log_rotation = inverse(normal, np.int64(3))
        for i in range(3):
            for j in range(3):
                plain[t, i, j] = rotation[i, j]
        for m in range(first, models):
            size = (3 + known, 4 + known, 6 + known)[m]
            log_width = 0.0
            for i in range(size):
                for j in range(i + 1):
                    added[i, j] = normal[i, j]
            for k in range(3, size):
                added[k, k] += 1.0 / prior_sigma[m, k] ** 2
                log_width += 2.0 * math.log(prior_sigma[m, k])
            covariance, log_normal = inverse(added, size) if size > 3 else (rotation, log_rotation)
            if not math.isfinite(log_normal):
                continue
            chi2 = total
            for i in range(size):
                for j in range(size):
                    every[t, m, i, j] = covariance[i, j]
                    mean[t, m, i] += covariance[i, j] * right[j]
                chi2 -= mean[t, m, i] * right[i]
            power, chi2 = trusted + freedom, max(chi2, 1e-12)
            if trusted > 0.0:
                # the covariance of a t distribution is larger than its squared scale
                scale[t, m] = (trusted + chi2) / (power - 2.0)
            else:
                scale[t, m] = max(chi2 / max(freedom, 1.0), UNKNOWN_FLOOR_PX**2 / unit)
            log_data = log_det + log_normal + log_width + power * math.log(trusted + chi2)
            probable = stars.as_assumed if t == 0 else 1.0 - stars.as_assumed
            log_prior = _PRIOR_OF_MODELS[m] + _PRIOR_OF_SYSTEMATIC[t] + math.log(probable)
            weight[t, m] = constant + log_prior - 0.5 * log_data
    return weight, scale, mean, every, plain


@kernel
def _averaged(
    weight: FloatArray,
    scale: FloatArray,
    mean: FloatArray,
    every: FloatArray,
    plain: FloatArray,
    trace: FloatArray,
    unit: float,
    chi2: float,
) -> Pose:
    """Moments of the mixture; weights (grid, 3) are given as logarithms. `chi2` is that of `Pose`."""
    highest, total = -np.inf, 0.0
    for t in range(weight.shape[0]):
        for m in range(3):
            highest = max(highest, weight[t, m])
    for t in range(weight.shape[0]):
        for m in range(3):
            weight[t, m] = math.exp(weight[t, m] - highest)
            total += weight[t, m]
    centre = np.zeros(mean.shape[2])
    factor = systematic = 0.0
    for t in range(weight.shape[0]):
        for m in range(3):
            weight[t, m] /= total
            for i in range(len(centre)):
                centre[i] += weight[t, m] * mean[t, m, i]
            factor += weight[t, m] * scale[t, m]
            systematic += weight[t, m] * scale[t, m] * SYSTEMATIC[t] ** 2 * unit
    covariance, without, variance = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(len(centre))
    for t in range(weight.shape[0]):
        for m in range(3):
            share = weight[t, m]
            if share == 0.0:
                continue
            for i in range(3):
                for j in range(3):
                    away = (mean[t, m, i] - centre[i]) * (mean[t, m, j] - centre[j])
                    covariance[i, j] += share * (scale[t, m] * every[t, m, i, j] + away)
                    without[i, j] += share * scale[t, m] * plain[t, i, j]
            for i in range(len(centre)):
                variance[i] += share * (scale[t, m] * every[t, m, i, i] + (mean[t, m, i] - centre[i]) ** 2)
            last = len(centre) - 1
            covariance[2, 2] += share * mean[t, m, last] ** 2
    sigma = np.empty(len(trace))
    for n in range(len(trace)):
        sigma[n] = math.sqrt(factor * trace[n] + systematic)
    for i in range(3):
        for j in range(3):
            without[i, j] = covariance[i, j] - without[i, j]
    evidence = highest + math.log(total)
    return Pose(centre[:3], covariance, without, sigma, systematic, factor, centre[3:], variance[3:], evidence, chi2)
