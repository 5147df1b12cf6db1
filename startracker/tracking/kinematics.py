"""Kernels of the filter: propagation of attitude and rate errors with exact process noise, and updates.

With ω the rate in camera axes and δθ, δr the errors of attitude and of the rate, δθ' = −ω × δθ + δr and δr' = white
noise. For constant ω there are closed forms: with K = [ω×] all integrals are polynomials in I, K, K².
"""

from __future__ import annotations

import math

import numpy as np

from startracker._compiled import kernel, kernel_part
from startracker.core import FloatArray
from startracker.estimation.directions import normal_equations
from startracker.geometry.linalg import factorise, substitute, transform

_SMALL = 0.03
"""Angle of a step, rad, below which series are used, as the closed forms lose precision."""
BLIND = 1e-12
"""Relative limit of the information about an axis, below which it is rounding error: a single star gives no roll."""


@kernel
def transition(rate: FloatArray, dt: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Φ, ∫Φ, ∫∫Φ and ∫ (∫Φ)(∫Φ)ᵀ over a step at a constant rate, each (3, 3).

    Φ = exp(−K t). Markley & Crassidis 2014, section 6.2.4, gives the first two; the noise integrals are usually given
    for ω t ≪ 1 (Farrenkopf 1978), here exactly.

    Parameters
    ----------
    rate : (3,)
        rad/s, in camera axes.
    dt : float
        Step, s.
    """
    x, y, z = rate[0], rate[1], rate[2]
    w2 = x * x + y * y + z * z
    w = math.sqrt(w2)
    a = w * dt
    a2 = a * a
    # s1, c1, d1, f1, e1 are the factors of the integrals below. Their closed forms lose all digits by cancellation when
    # the angle of the step is small, so that their Taylor series are used there.
    if a < _SMALL:
        s1 = dt * (1.0 - a2 / 6.0 + a2 * a2 / 120.0)
        c1 = dt**2 * (0.5 - a2 / 24.0 + a2 * a2 / 720.0)
        d1 = dt**3 * (1.0 / 6.0 - a2 / 120.0 + a2 * a2 / 5040.0)
        f1 = dt**4 * (1.0 / 24.0 - a2 / 720.0 + a2 * a2 / 40320.0)
        e1 = dt**5 * (1.0 / 60.0 - a2 / 2520.0 + a2 * a2 / 181440.0)
    else:
        s1 = math.sin(a) / w
        c1 = (1.0 - math.cos(a)) / w2
        d1 = (dt - s1) / w2
        f1 = (0.5 * dt**2 - c1) / w2
        e1 = (dt**3 / 3.0 - 2.0 * d1) / w2
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    # K², as ω ωᵀ − ω² I.
    square = np.array([[x * x - w2, x * y, x * z], [x * y, y * y - w2, y * z], [x * z, y * z, z * z - w2]])
    one = np.eye(3)
    phi = one - s1 * cross + c1 * square
    psi = dt * one - c1 * cross + d1 * square
    twice = 0.5 * dt**2 * one - d1 * cross + f1 * square
    squared = dt**3 / 3.0 * one + e1 * square
    return phi, psi, twice, squared


@kernel
def turn_quaternion(quat: FloatArray, vector: FloatArray) -> FloatArray:
    """Unit quaternion (x, y, z, w) of the frame `quat` rotated by a rotation vector in its own axes."""
    x2, y2, z2 = vector[0], vector[1], vector[2]
    angle = math.sqrt(x2 * x2 + y2 * y2 + z2 * z2)
    share = 0.5 - angle**2 / 48.0 if angle < 1e-4 else math.sin(0.5 * angle) / angle
    w2 = math.cos(0.5 * angle)
    x2, y2, z2 = share * x2, share * y2, share * z2
    x1, y1, z1, w1 = quat[0], quat[1], quat[2], quat[3]
    out = np.array(
        [
            w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
            w1 * y2 + y1 * w2 + z1 * x2 - x1 * z2,
            w1 * z2 + z1 * w2 + x1 * y2 - y1 * x2,
            w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
        ]
    )
    return out / math.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2 + out[3] ** 2)


@kernel
def propagate(
    quat: FloatArray,
    covariance: FloatArray,
    rate: FloatArray,
    dt: float,
    sign: float,
    angle_psd: float,
    rate_psd: float,
    extra_psd: float,
) -> tuple[FloatArray, FloatArray]:
    """Quaternion and covariance (n, n) after a step at a constant rate; n is 6, or 9 with a gyro's scale factors, or
    more with further states that are constant.

    An error δk of the scale factors acts as a bias of ω ∘ δk: δθ' = −ω × δθ − δb − ω ∘ δk, to first order in k
    (Pittelkau 2001, J. Guidance 24, 1187). The scale factors themselves are constant.

    Parameters
    ----------
    sign : float
        +1 if the second state is the rate, −1 if it is the bias subtracted from a measured rate.
    angle_psd, rate_psd, extra_psd : float
        White noise of the derivative of the angle, rad²/s, of that of the second state, rad²/s³, and of a rate that is
        constant but not a state, rad²/s³.
    """
    phi, psi, twice, squared = transition(rate, dt)
    full = np.eye(len(covariance))
    full[:3, :3] = phi
    full[:3, 3:6] = sign * psi
    if len(covariance) > 6:
        # A scale factor acts as a bias that is proportional to the rate about its own axis: the columns of ∫Φ times ω.
        full[:3, 6:9] = sign * psi * rate
    out = full @ covariance @ full.T
    for i in range(3):
        out[i, i] += angle_psd * dt
        out[3 + i, 3 + i] += rate_psd * dt
        for j in range(3):
            out[i, j] += (rate_psd + extra_psd) * squared[i, j]
            out[i, 3 + j] += sign * rate_psd * twice[i, j]
            out[3 + j, i] += sign * rate_psd * twice[i, j]
    return turn_quaternion(quat, rate * dt), 0.5 * (out + out.T)


@kernel
def correct(
    covariance: FloatArray, axes: FloatArray, innovation: FloatArray, noise: FloatArray
) -> tuple[float, FloatArray, FloatArray, FloatArray]:
    """Kalman update with a measurement of the attitude error along some axes, in Joseph form.

    Parameters
    ----------
    covariance : (n, n)
    axes : (m, 3) or (m, n)
        The measurement is axes · δθ + noise; with n columns it also depends on the other states.
    innovation, noise : (m,), (m, m)
        Measurement, and its covariance.

    Returns
    -------
    Squared Mahalanobis distance νᵀ S⁻¹ ν, correction (n,), updated covariance (n, n), and the innovation in camera axes
    whitened by the Cholesky factor of S, (3,); NaN unless there are three axes. The distance is NaN, which is within no
    gate, if S is not positive definite.
    """
    h = np.zeros((len(innovation), len(covariance)))
    h[:, : axes.shape[1]] = axes
    crossed = h @ covariance
    spread = crossed @ h.T + noise
    m, white = len(innovation), np.full(3, np.nan)
    factor, weighed, gain = spread.copy(), innovation.copy(), crossed.T.copy()
    if not factorise(factor, m):
        return np.nan, np.zeros(len(covariance)), covariance.copy(), white
    substitute(factor, m, weighed)
    for i in range(len(gain)):
        substitute(factor, m, gain[i])
    # Joseph's form keeps the covariance positive definite where (I − K H) P would lose that to rounding.
    left = np.eye(len(covariance)) - gain @ h
    out = left @ covariance @ left.T + gain @ noise @ gain.T
    if m == 3:
        turn = h[:, :3].copy()
        white = _whitened(turn.T @ spread @ turn, turn.T @ innovation)
    return float(np.sum(innovation * weighed)), gain @ innovation, 0.5 * (out + out.T), white


@kernel_part
def _whitened(spread: FloatArray, vector: FloatArray) -> FloatArray:
    """L⁻¹ of a vector (3,) with L Lᵀ its covariance (3, 3), L lower triangular; NaN if it is not positive definite."""
    out = np.full(3, np.nan)
    if factorise(spread, 3):
        for i in range(3):
            out[i] = vector[i]
            for j in range(i):
                out[i] -= spread[i, j] * out[j]
            out[i] /= spread[i, i]
    return out


@kernel
def vector_measurement(
    quat: FloatArray, delta: FloatArray, observed: FloatArray, reference: FloatArray, sigma: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Attitude error measured by directions: axes (m, 3), error along them (m,), covariance (m, m).

    With p = A r the prediction, b − p = p × δθ + noise across p (QUEST's measurement model, Shuster & Oh 1981). The
    information of M directions is the normal matrix Σ (I − p pᵀ)/σ² and its right-hand side Σ (b × p)/σ²; along the
    eigenvectors of the matrix they are three independent measurements, or two for a single star.

    Parameters
    ----------
    quat : (4,)
        Attitude to which errors refer.
    delta : (3,)
        Error at which b is linearised.
    observed, reference, sigma : (M, 3), (M, 3), (M,)
    """
    x, y, z, w = turn_quaternion(quat, delta)
    matrix = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)],
            [2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)],
            [2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    predicted = np.empty_like(reference)
    transform(matrix, reference, predicted)
    information, right = normal_equations(observed, observed, predicted, np.arange(len(observed)), sigma, 3)
    # An axis without information, the roll about a single star, would have an infinite variance; it is left out.
    values, vectors = np.linalg.eigh(information)
    first = 0
    while values[first] <= BLIND * values[2]:
        first += 1
    m = 3 - first
    axes, innovation, noise = np.zeros((m, 3)), np.zeros(m), np.zeros((m, m))
    for k in range(m):
        value = values[first + k]
        noise[k, k] = 1.0 / value
        for i in range(3):
            axes[k, i] = vectors[i, first + k]
            innovation[k] += axes[k, i] * (delta[i] - right[i] / value)
    return axes, innovation, noise
