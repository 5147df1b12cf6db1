"""Displacements of star images from the positions of the calibrated camera, in pixels.

Calibration residual
    The error that remains after a calibration: a smooth random field d(x, y), a sum of Legendre polynomials over the
    detector,

        d = Σ c_mn √(2m + 1) P_m(u) √(2n + 1) P_n(v),   m + n ≤ order,   u, v from −1 to 1 across the detector,

    with Gaussian coefficients of equal variance on both axes. All terms that a calibration fits are projected out: any
    affine map (principal point, focal lengths, rotation, skew), the tilt of the camera, the radial terms r² to r⁶, and
    the tangential ones (Brown 1966, Photogrammetric Engineering 32, 444). The remainder is scaled to exactly the
    stated rms.
Lateral colour
    A radius that depends on the wavelength, r' = r (1 + a (λ − λ₀)), linear in both: the primary lateral colour of a
    lens (Welford 1986, *Aberrations of Optical Systems*, section 10.3). A star is displaced according to its mean
    wavelength; the blur of its image due to the width of its spectrum is neglected.
Centroid curve
    A measured periodic error of the sub-pixel position, x' = x + A sin 2πx on each axis, as for pixels with a symmetric
    response (Anderson & King 2000, PASP 112, 1360).

The sky is rendered with these displacements, but the frame has the camera without them, so that they are errors for the
tracker. Disks of bodies are displaced as a whole; other extended light (the sky and the Earth) is not.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import leggauss, legvander

from startracker.core import FloatArray
from startracker.display import changed_fields
from startracker.geometry.camera import Camera

C_LINE_NM, F_LINE_NM = 656.27, 486.13
"""Fraunhofer lines between which lateral colour is stated, hydrogen α and β."""

_ABSORBED_DEGREE = 7
"""Highest degree of the terms that a calibration fits: r⁶ times the position."""
_GRID = 33
_MARGIN = 1.5
"""Points per axis on which the largest residual is searched, and a factor for maxima between them."""
_BAND_NM = 500.0
"""Upper limit of the difference between mean wavelengths of stars."""


@dataclass(frozen=True)
class CalibrationResidual:
    """Smooth error of the calibrated camera model, drawn once for each camera from the seed."""

    rms_px: float = 0.0
    """Root mean square over the detector on one axis; 0: none."""
    order: int = 5
    """Highest degree of its polynomials; higher degrees give finer structure."""

    __repr__ = changed_fields


@dataclass(frozen=True)
class LateralColour:
    """Lateral chromatic aberration: the scale of the image depends on the wavelength."""

    corner_px: float = 0.0
    """Distance of the red C line (656 nm) beyond the blue F line (486 nm) in the image corners, proportional to the
    radius and to the wavelength; 0: none."""
    reference_b_v: float = 0.6
    """Colour of the stars for which the camera is calibrated, which are not displaced."""

    __repr__ = changed_fields


@dataclass(frozen=True, eq=False)
class Displacement:
    """Displacement of star images on one detector.

    Parameters
    ----------
    camera : Camera
        The true camera.
    residual : (2, N, N) array, optional
        Legendre coefficients along columns and rows (`draw_residual`).
    colour_per_nm : float
        Relative change of the scale of the image per nanometre.
    reference_nm : float
        Wavelength that is not displaced.
    curve_px : float
        Amplitude of the centroid curve.
    """

    camera: Camera
    residual: FloatArray | None = None
    colour_per_nm: float = 0.0
    reference_nm: float = 0.0
    curve_px: float = 0.0

    @classmethod
    def of(
        cls, camera: Camera, residual: FloatArray | None, colour: LateralColour, reference_nm: float, curve_px: float
    ) -> Displacement:
        """Displacement from the parameters of a lens; `reference_nm` is the mean wavelength of its reference stars."""
        corner_px = 0.5 * math.hypot(camera.width, camera.height)
        return cls(camera, residual, colour.corner_px / (C_LINE_NM - F_LINE_NM) / corner_px, reference_nm, curve_px)

    @property
    def is_off(self) -> bool:
        """Whether no image is displaced."""
        return self.residual is None and self.colour_per_nm == 0.0 and self.curve_px == 0.0

    @property
    def coloured(self) -> bool:
        """Whether the displacement depends on the wavelength."""
        return self.colour_per_nm != 0.0

    @functools.cached_property
    def most_px(self) -> float:
        """Upper limit of a displacement, for the margin around the detector."""
        most = math.sqrt(2.0) * abs(self.curve_px)
        most += abs(self.colour_per_nm) * _BAND_NM * math.hypot(self.camera.width, self.camera.height)
        if self.residual is not None:
            ends = np.linspace(-1.0, 1.0, _GRID)
            field = _field(self.residual, *(a.ravel() for a in np.meshgrid(ends, ends)))
            most += _MARGIN * float(np.hypot(*field.T).max())
        return most

    def moved(self, xy: FloatArray, wavelength_nm: FloatArray) -> FloatArray:
        """Displaced positions; the same array if the displacement is off.

        Parameters
        ----------
        xy : (N, 2) or (N, K, 2) array
            Pixels of stars, or of their paths; NaN remains NaN.
        wavelength_nm : (N,) array
            Mean wavelengths of their electrons; used if `coloured`.
        """
        if self.is_off:
            return xy
        camera, moved = self.camera, np.zeros_like(xy)
        if self.coloured:
            scale = self.colour_per_nm * (wavelength_nm - self.reference_nm)
            moved += scale.reshape(-1, *[1] * (xy.ndim - 1)) * (xy - (camera.cx, camera.cy))
        if self.residual is not None:
            size = np.array([camera.width, camera.height])
            # −1 to 1 from the outer edge of the first pixel, at −0.5, to that of the last one. Outside the detector the
            # residual is that of the edge, as polynomials diverge there.
            u, v = np.moveaxis(np.clip((2.0 * xy + 1.0) / size - 1.0, -1.0, 1.0), -1, 0)
            moved += _field(self.residual, u, v)
        if self.curve_px:
            moved += self.curve_px * np.sin(2.0 * np.pi * xy)
        return np.asarray(xy + moved)


def draw_residual(camera: Camera, parameters: CalibrationResidual, rng: np.random.Generator) -> FloatArray | None:
    """Legendre coefficients (2, N, N) of a calibration residual, for degrees along columns and rows; None if it is off.

    Parameters
    ----------
    camera : Camera
        The calibrated camera.
    parameters : CalibrationResidual
        Its rms and order.
    rng : Generator
        Random stream of the camera.
    """
    if parameters.rms_px == 0.0:
        return None
    degree = max(parameters.order, _ABSORBED_DEGREE)
    m, n = np.meshgrid(np.arange(degree + 1), np.arange(degree + 1), indexing="ij")
    # The terms that a calibration fits span a subspace of the coefficients; a QR decomposition gives an orthonormal
    # basis of it, and the projection onto the basis is subtracted.
    drawn = np.where(m + n <= parameters.order, rng.standard_normal((2, degree + 1, degree + 1)), 0.0)
    absorbed = np.linalg.qr(_absorbed(camera, degree).reshape(-1, 2 * (degree + 1) ** 2).T)[0]
    left = drawn.ravel() - absorbed @ (absorbed.T @ drawn.ravel())
    # The polynomials are normalised, so the sum of the squares of the coefficients is the mean square over the detector
    # of both axes together.
    left *= parameters.rms_px * math.sqrt(2.0 / float(left @ left))
    return np.asarray(left.reshape(drawn.shape))


def _absorbed(camera: Camera, degree: int) -> FloatArray:
    """Coefficients (13, 2, N, N) of the displacements that a calibration fits, by Gauss–Legendre quadrature."""
    nodes, weights = leggauss(degree + 2)  # exact up to twice the degree
    u, v = np.meshgrid(nodes, nodes, indexing="ij")
    # Normalised image coordinates of the nodes, in which the terms of a lens model are defined.
    x = (0.5 * ((u + 1.0) * camera.width - 1.0) - camera.cx) / camera.fx
    y = (0.5 * ((v + 1.0) * camera.height - 1.0) - camera.cy) / camera.fy
    square, zero, one = x * x + y * y, np.zeros_like(x), np.ones_like(x)
    terms = [(one, zero), (zero, one), (x, zero), (y, zero), (zero, x), (zero, y)]
    terms += [(square**power * x, square**power * y) for power in (1, 2, 3)]
    # Tangential distortion, and the tilt of the camera about its two axes.
    terms += [(2.0 * x * y, square + 2.0 * y * y), (square + 2.0 * x * x, 2.0 * x * y), (x * x, x * y), (x * y, y * y)]
    along = _normalised(nodes, degree) * (0.5 * weights)[:, None]
    focal = np.array([camera.fx, camera.fy])
    return np.asarray(np.einsum("tcij,c,im,jn->tcmn", np.array(terms), focal, along, along))


def _field(coefficients: FloatArray, u: FloatArray, v: FloatArray) -> FloatArray:
    """Displacements (..., 2) at points (...) from −1 to 1 across the detector."""
    degree = coefficients.shape[1] - 1
    return np.asarray(
        np.einsum("cmn,...m,...n->...c", coefficients, _normalised(u, degree), _normalised(v, degree), optimize=True)
    )


def _normalised(u: FloatArray, degree: int) -> FloatArray:
    """Legendre polynomials (..., N) with a mean square of 1 from −1 to 1."""
    return np.asarray(legvander(u, degree) * np.sqrt(2.0 * np.arange(degree + 1) + 1.0))
