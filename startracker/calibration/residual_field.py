"""The distortion that the parameters of the lens do not describe: a smooth displacement of the image.

The displacement is Σ_k c_k φ_k(x, y), with products of Legendre polynomials φ_k up to the fourth degree on each axis.
Constant terms and a rotation are part of the attitude, and a change of scale is the focal length; they are left out.
The coefficients are constant in time, independent, and have the same standard deviation, for which the displacement has
the rms value a on each axis.

The filter of the lens is computed for c = 0, and its dependence on c is followed exactly (bias-separated filter;
Friedland 1969, IEEE Trans. Automatic Control 14, 359): with the Jacobians H of the lens p and F of the coefficients c
of a frame, the attitude marginalised, the gain P⁺ of the frame and T = ∂p̂/∂c, the innovation r has the derivative
U = F + H T, and

    T ← T − P⁺ Hᵀ W U,    Λ ← Λ + Uᵀ S⁻¹ U,    η ← η + Uᵀ S⁻¹ r,    S⁻¹ = W − W H P⁺ Hᵀ W

are the derivative after the frame and the information on c of all frames. For a given a the estimate of c is
(Λ + D⁻¹)⁻¹ η with the prior variances D, the lens is p̂ + T ĉ, and its covariance P + T C Tᵀ. The value of a is unknown;
its likelihood follows from the same Λ and η,

    ln L(a) = −½ ln |1 + D Λ| + ½ ηᵀ (Λ + D⁻¹)⁻¹ η,

and the estimate is the mean over a, with equal prior probability for each factor of two (Bayesian model averaging;
Hoeting et al. 1999, Statistical Science 14, 382).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.polynomial.legendre import legvander

from startracker.core import FloatArray
from startracker.geometry.camera import Camera

_DEGREE = 4
"""Highest degree of the displacement. Of a sine with one period over the image 3 to 9 % remain; the remainder of
shorter periods differs from star to star, and is noise for the lens."""
_OCTAVES = 11
"""Number of values of a, each half of the one before, from the largest one."""


class FrameInformation(NamedTuple):
    """Information of a frame on the lens (P) and the coefficients (C), for residuals of the current estimates."""

    matrix: FloatArray
    """Shape (P + C, P + C)."""
    vector: FloatArray
    """Shape (P + C,)."""


def field_columns(camera: Camera, xy: FloatArray) -> FloatArray:
    """Displacements φ_k (M, 2, C) of positions (M, 2) in the image of a camera.

    Each has a mean square of 1 over the image on one axis.
    """
    size = np.array([camera.width, camera.height])
    x, y = (2.0 * (xy - (size - 1) / 2.0) / size).T
    # Legendre polynomials of degree n have the mean square 1 / (2 n + 1) over [−1, 1].
    along, down = (legvander(t, _DEGREE) * np.sqrt(2.0 * np.arange(_DEGREE + 1) + 1.0) for t in (x, y))
    products = [along[:, i] * down[:, n - i] for n in range(2, _DEGREE + 1) for i in range(n + 1)]
    # Of the linear terms, only the two shears: scale and rotation belong to the focal length and the attitude.
    columns = [np.stack([along[:, 1], -down[:, 1]], axis=1), np.stack([down[:, 1], along[:, 1]], axis=1)]
    for term in products:
        nothing = np.zeros_like(term)
        columns += [np.stack([term, nothing], axis=1), np.stack([nothing, term], axis=1)]
    return np.stack(columns, axis=2)


FIELD_TERMS = 2 + 2 * sum(n + 1 for n in range(2, _DEGREE + 1))
"""Number C of coefficients."""


class ResidualField:
    """Recursive estimate of the coefficients of the residual distortion.

    Parameters
    ----------
    parameters : int
        Number P of parameters of the lens.
    most_px : float
        Largest rms value of the displacement on each axis, px; 0 disables the estimate.
    """

    def __init__(self, parameters: int, most_px: float) -> None:
        self.terms = FIELD_TERMS if most_px > 0.0 else 0
        self._sizes_px = (most_px or 1.0) * 0.5 ** np.arange(_OCTAVES)
        self._parameters = parameters
        self.forget()

    def forget(self) -> None:
        """Discard all information."""
        self.by_field: FloatArray = np.zeros((self._parameters, self.terms))
        """T (P, C): derivative of the lens estimated for c = 0."""
        self.information: FloatArray = np.zeros((self.terms, self.terms))
        """Λ (C, C)."""
        self.vector: FloatArray = np.zeros(self.terms)
        """η (C,)."""
        self._estimate()

    @property
    def rms_px(self) -> float:
        """Estimated rms value of the displacement on each axis, px."""
        return math.sqrt(max(float(np.trace(self.moment)), 0.0) / 2.0) if self.terms else 0.0

    @property
    def moment(self) -> FloatArray:
        """Second moment (C, C) of the coefficients: covariance plus the square of the estimate."""
        return np.asarray(self.covariance + np.outer(self.mean, self.mean))

    def joint(self, lens: FloatArray) -> FloatArray:
        """Covariance (P + C, P + C) of lens and coefficients, from the lens' own (P, P) for known coefficients."""
        crossed = self.by_field @ self.covariance
        return np.block([[lens + crossed @ self.by_field.T, crossed], [crossed.T, self.covariance]])

    def without(self, frame: FrameInformation) -> FloatArray:
        """Vector (P + C,) of a frame for residuals relative to the lens estimated for c = 0 and no displacement."""
        change = np.concatenate([self.by_field @ self.mean, self.mean])
        return np.asarray(frame.vector + frame.matrix @ change)

    def update(self, frame: FrameInformation, gain: FloatArray) -> None:
        """Update with a frame, with the covariance P⁺ (P, P) of the lens for known coefficients after it."""
        size, vector = self._parameters, self.without(frame)
        of_lens, crossed, own = frame.matrix[:size, :size], frame.matrix[:size, size:], frame.matrix[size:, size:]
        by_field = crossed + of_lens @ self.by_field
        added = own + crossed.T @ self.by_field + self.by_field.T @ by_field - by_field.T @ gain @ by_field
        self.information = self.information + 0.5 * (added + added.T)
        self.vector = self.vector + vector[size:] + self.by_field.T @ vector[:size] - by_field.T @ gain @ vector[:size]
        self.by_field = self.by_field - gain @ by_field
        self._estimate()

    def _estimate(self) -> None:
        """Mean and covariance of the coefficients, averaged over all rms values."""
        prior_px2 = 2.0 * self._sizes_px**2 / max(self.terms, 1)
        inverse = self.information + np.eye(self.terms) / prior_px2[:, None, None]
        covariances = np.linalg.inv(inverse)
        means = covariances @ self.vector
        log_determinant = np.linalg.slogdet(inverse)[1] + self.terms * np.log(prior_px2)
        log_likelihood = 0.5 * (means @ self.vector - log_determinant)
        weight = np.exp(log_likelihood - log_likelihood.max())
        weight /= weight.sum()
        self.mean: FloatArray = weight @ means
        """Estimate ĉ (C,), pixels."""
        beside = (means - self.mean) * np.sqrt(weight)[:, None]
        self.covariance: FloatArray = np.tensordot(weight, covariances, 1) + beside.T @ beside
        """Its covariance (C, C)."""
