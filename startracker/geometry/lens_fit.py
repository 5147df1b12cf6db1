"""Joint fit of a camera and the attitudes of its images, by weighted least squares on pixel positions.

Unknowns: the camera's parameters (`startracker.geometry.lens.PARAMETERS`), a rotation vector per image and, optionally,
two parameters per image for differential atmospheric refraction. Gauss–Newton with analytic derivatives and step
halving; weak priors (`startracker.geometry.lens.prior_of`) are additional observations.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from startracker.core import FloatArray
from startracker.geometry.attitude import rotation_vector_to_matrix
from startracker.geometry.camera import Camera
from startracker.geometry.lens import by_turn, change_lens, is_one_to_one, prior_of, sensitivity, value_of

_TOGETHER = (("cx", "cy"), ("aspect",), ("p1", "p2"))
"""Parameters that are included or excluded together; radial ones are excluded from the highest power down."""
REFRACTION_SIGMA = 5e-4
"""Prior of the stretch by refraction: 58.3″ tan²z / 2, at zenith distances up to about 60°."""


@dataclass(frozen=True, eq=False)
class Matches:
    """Stars of one image with their catalogue directions."""

    xy: FloatArray
    """Measured, pixels, (M, 2)."""
    directions: FloatArray
    """Apparent unit vectors, ICRS axes, (M, 3)."""
    sigma_px: FloatArray
    """Standard error on one axis, (M,)."""


@dataclass(frozen=True, eq=False)
class JointFit:
    """Result of the joint fit to the stars of all images."""

    camera: Camera
    matrices: list[FloatArray]
    """ICRS to camera, one per image, each (3, 3)."""
    stretches: FloatArray
    """Differential refraction of each image, see `stretch`, (I, 2); zero where not fitted."""
    names: tuple[str, ...]
    """Parameters of the camera that were fitted."""
    covariance: FloatArray
    """Covariance of these, the rotation vectors and the stretches, in this order, (P, P); with stated errors, including
    priors."""
    chi2: float
    penalty: float
    """χ² of the residuals, and of the deviations of the parameters from their priors."""
    residuals: list[FloatArray]
    """Measured minus predicted, pixels, each (M, 2)."""

    @property
    def stars(self) -> int:
        """Number of stars of all images."""
        return sum(len(r) for r in self.residuals)

    @property
    def freedom(self) -> int:
        """Degrees of freedom."""
        return max(2 * self.stars - len(self.covariance), 1)


def stretch(vectors: FloatArray, amounts: FloatArray) -> FloatArray:
    """Vectors (M, 3) with atmospheric refraction over a field to first order: x → x (1 + a) + b y, y → y (1 − a) + b x.

    Refraction R = κ tan z (κ = 58.3″) compresses the sky by κ sec²z along the vertical and by κ across it. The mean of
    both is equivalent to a change of the focal length; half their difference, κ tan²z / 2 = |(a, b)|, is fitted. The
    remainder is R''/2 = κ sec²z tan z times the square of the distance from the centre: 0.9″ for 4° at an altitude of
    40°.
    """
    a, b = amounts
    turned = vectors.copy()
    turned[:, 0] += a * vectors[:, 0] + b * vectors[:, 1]
    turned[:, 1] += b * vectors[:, 0] - a * vectors[:, 1]
    return turned


def fit_jointly(
    camera: Camera,
    matrices: list[FloatArray],
    matches: list[Matches],
    names: tuple[str, ...],
    stretches: FloatArray | None = None,
    *,
    with_refraction: bool = False,
    enough: float = 1e-9,
) -> JointFit | None:
    """Least squares from a start accurate to a few pixels; None if no invertible lens model fits.

    Parameters
    ----------
    camera, matrices, stretches
        Starting values.
    matches : list of Matches
        One per image.
    names : tuple of str
        Free parameters, of `startracker.geometry.lens.PARAMETERS`; the others remain as in `camera`.
    with_refraction : bool
        Whether each image has its own stretch.
    enough : float
        Gain in χ² below which the iteration ends: the distance to the minimum is then at most √enough standard errors.
    """
    state = _State(camera, list(matrices), np.zeros((len(matches), 2)) if stretches is None else stretches)
    chi2, penalty = _cost(state, matches, names, with_refraction)
    normal = np.empty((0, 0))
    for _ in range(30):
        normal, gradient = _normal_equations(state, matches, names, with_refraction)
        try:
            step = np.asarray(np.linalg.solve(normal, gradient), dtype=np.float64)
        except np.linalg.LinAlgError:
            return None
        if not np.isfinite(step).all():
            return None
        # The step is halved until the lens is one-to-one and the cost does not increase.
        for _ in range(12):
            moved = _moved(state, names, step, with_refraction)
            if is_one_to_one(moved.camera):
                new_chi2, new_penalty = _cost(moved, matches, names, with_refraction)
                if new_chi2 + new_penalty <= (chi2 + penalty) * (1.0 + 1e-12) + 1e-12:
                    break
            step *= 0.5
        else:
            break
        gain = chi2 + penalty - new_chi2 - new_penalty
        state, chi2, penalty = moved, new_chi2, new_penalty
        if gain < enough * max(1.0, chi2 / max(2 * sum(len(m.xy) for m in matches), 1)):
            break
    if not np.isfinite(chi2):
        return None
    # The matrix is that before the last step, which was too short to change it.
    try:
        covariance = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    except np.linalg.LinAlgError:
        return None
    residuals = [m.xy - _predict(state, i, m) for i, m in enumerate(matches)]
    return JointFit(state.camera, state.matrices, state.stretches, names, covariance, chi2, penalty, residuals)


def rescaled(fit: JointFit, matches: list[Matches], *, with_refraction: bool) -> FloatArray:
    """Covariance with the stars' errors multiplied by √(χ²/ν), and unchanged priors."""
    normal, _ = rescaled_equations(fit, matches, None, with_refraction=with_refraction)
    return np.asarray(np.linalg.inv(normal))


def rescaled_equations(
    fit: JointFit, matches: list[Matches], fields: Sequence[FloatArray] | None, *, with_refraction: bool
) -> tuple[FloatArray, FloatArray]:
    """Normal matrix and right-hand side at the result of a fit, with the errors of `rescaled`.

    Further unknowns, whose displacements (M, 2, C) of the stars of each image are `fields`, come after all others.
    """
    inflation = np.sqrt(fit.chi2 / fit.freedom)
    wider = [replace(m, sigma_px=m.sigma_px * inflation) for m in matches]
    state = _State(fit.camera, fit.matrices, fit.stretches)
    return _normal_equations(state, wider, fit.names, with_refraction, fields)


def noise_floor(residuals: FloatArray, variance_px2: FloatArray, fitted: int = 0) -> float:
    """Additional noise on one axis, px, for which the median normalised residual has its expected value.

    Parameters
    ----------
    residuals : (M, 2)
        Pixels.
    variance_px2 : (M,)
        Variance of the centroids on one axis.
    fitted : int
        Number of parameters fitted to these residuals.
    """
    squares = np.sum(residuals**2, axis=1)
    # The median of χ² with two degrees of freedom is 2 ln 2; the fit reduces it by its share of the degrees of freedom.
    wanted = 2.0 * math.log(2.0) * (1.0 - min(fitted / (2.0 * len(squares)), 0.9))
    if np.median(squares / variance_px2) <= wanted:
        return 0.0
    # If the upper limit were the only variance, the median would have the expected value.
    low, high = 0.0, float(np.median(squares)) / wanted
    for _ in range(16):
        middle = 0.5 * (low + high)
        if np.median(squares / (variance_px2 + middle)) > wanted:
            low = middle
        else:
            high = middle
    return math.sqrt(high)


def significant(full: JointFit) -> tuple[str, ...]:
    """Significant parameters: the combination with the minimum of χ²/s² + ln(observations) · number of parameters.

    Schwarz's criterion (1978, Ann. Stat. 6, 461) with s² = χ²/ν of the full fit. Excluding parameters increases χ² by
    dᵀ C⁻¹ d, with d their differences from the values of `plain` and C their block of the covariance (Wald's test),
    which is exact if the model is linear over these differences.
    """
    scale2, price = max(full.chi2 / full.freedom, 1e-12), math.log(2.0 * full.stars)
    distance = np.array([value_of(n, full.camera) - prior_of(n, full.camera)[0] for n in full.names])
    groups = [g for g in _TOGETHER if set(g) <= set(full.names)]
    best, chosen = math.inf, full.names
    for kept in subsets(full.names, groups):
        index = [k for k, n in enumerate(full.names) if n not in kept]
        rise = 0.0
        if index:
            d = distance[index]
            rise = float(d @ np.linalg.solve(full.covariance[np.ix_(index, index)], d)) / scale2
        cost = rise - price * len(index)
        if cost < best:
            best, chosen = cost, kept
    return chosen


def subsets(names: tuple[str, ...], groups: Sequence[tuple[str, ...]]) -> Iterator[tuple[str, ...]]:
    """Combinations of parameters: the members of a group together, radial terms up to some power, all others always."""
    radial = [n for n in names if n[0] == "k"]
    for order in range(len(radial) + 1):
        for kept in itertools.product((False, True), repeat=len(groups)):
            out = set(radial[order:]) | {n for g, keep in zip(groups, kept, strict=True) if not keep for n in g}
            yield tuple(n for n in names if n not in out)


@dataclass(frozen=True, eq=False)
class _State:
    camera: Camera
    matrices: list[FloatArray]
    stretches: FloatArray


def _predict(state: _State, image: int, matches: Matches) -> FloatArray:
    return state.camera.project(stretch(matches.directions @ state.matrices[image].T, state.stretches[image]))


def _cost(state: _State, matches: list[Matches], names: tuple[str, ...], with_refraction: bool) -> tuple[float, float]:
    chi2 = 0.0
    for i, m in enumerate(matches):
        chi2 += float(np.sum(((m.xy - _predict(state, i, m)) / m.sigma_px[:, None]) ** 2))
    penalty = sum(((value_of(n, state.camera) - prior_of(n, state.camera)[0]) / s) ** 2 for n, s in _held(names, state))
    if with_refraction:
        penalty += float(np.sum((state.stretches / REFRACTION_SIGMA) ** 2))
    return (chi2 if np.isfinite(chi2) else np.inf), penalty


def _held(names: tuple[str, ...], state: _State) -> list[tuple[str, float]]:
    sigmas = [(name, prior_of(name, state.camera)[1]) for name in names]
    return [(name, sigma) for name, sigma in sigmas if np.isfinite(sigma)]


def image_equations(
    camera: Camera,
    matrix: FloatArray,
    stars: Matches,
    names: tuple[str, ...],
    amounts: FloatArray | None = None,
    *,
    with_refraction: bool = False,
    field: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Normal matrix and right-hand side of one Gauss–Newton step over the stars of an image, without priors.

    Unknowns: the parameters `names` of the camera, the rotation vector, with refraction its `amounts` (2,), see
    `stretch`, and the coefficients of the displacements `field` (M, 2, C), pixels, if given.
    """
    vectors = stars.directions @ matrix.T
    if amounts is not None:
        vectors = stretch(vectors, amounts)
    pixels, moves, by_vector = sensitivity(camera, vectors)
    # The effect of the stretch on the rotation, 1e-3, is negligible for a step.
    columns = [np.stack([moves[name] for name in names], axis=2), by_turn(by_vector, vectors)]
    if with_refraction:
        x, y = vectors[:, :2].T
        zero = np.zeros_like(x)
        by_amount = np.stack([np.stack([x, -y, zero], axis=1), np.stack([y, x, zero], axis=1)], axis=2)
        columns.append(by_vector @ by_amount)
    if field is not None:
        columns.append(field)
    weight = np.repeat(1.0 / stars.sigma_px, 2)
    jacobian = np.concatenate(columns, axis=2).reshape(len(weight), -1) * weight[:, None]
    return jacobian.T @ jacobian, jacobian.T @ ((stars.xy - pixels).ravel() * weight)


def _normal_equations(
    state: _State,
    matches: list[Matches],
    names: tuple[str, ...],
    with_refraction: bool,
    fields: Sequence[FloatArray] | None = None,
) -> tuple[FloatArray, FloatArray]:
    lens, images = len(names), len(matches)
    last = lens + (5 if with_refraction else 3) * images
    size = last + (fields[0].shape[2] if fields else 0)
    normal, gradient = np.zeros((size, size)), np.zeros(size)
    for i, m in enumerate(matches):
        # Unknowns in this order: lens, rotation vectors of all images, stretches of all images, further unknowns.
        at = [np.arange(lens), lens + 3 * i + np.arange(3)]
        if with_refraction:
            at.append(lens + 3 * images + 2 * i + np.arange(2))
        at.append(np.arange(last, size))
        where, given = np.concatenate(at), (state.camera, state.matrices[i], m, names, state.stretches[i])
        field = fields[i] if fields else None
        of_image, right = image_equations(*given, with_refraction=with_refraction, field=field)
        normal[np.ix_(where, where)] += of_image
        gradient[where] += right
    for name, sigma in _held(names, state):
        # A prior is a further observation, of the parameter itself.
        k = names.index(name)
        normal[k, k] += 1.0 / sigma**2
        gradient[k] -= (value_of(name, state.camera) - prior_of(name, state.camera)[0]) / sigma**2
    if with_refraction:
        tail = np.arange(lens + 3 * images, last)
        normal[tail, tail] += 1.0 / REFRACTION_SIGMA**2
        gradient[tail] -= state.stretches.ravel() / REFRACTION_SIGMA**2
    return normal, gradient


def _moved(state: _State, names: tuple[str, ...], step: FloatArray, with_refraction: bool) -> _State:
    lens, images = len(names), len(state.matrices)
    camera = change_lens(state.camera, dict(zip(names, step[:lens].tolist(), strict=True)))
    turns = step[lens : lens + 3 * images].reshape(images, 3)
    matrices = [rotation_vector_to_matrix(turn) @ matrix for turn, matrix in zip(turns, state.matrices, strict=True)]
    stretches = state.stretches
    if with_refraction:
        stretches = stretches + step[lens + 3 * images :].reshape(images, 2)
    return _State(camera, matrices, stretches)
