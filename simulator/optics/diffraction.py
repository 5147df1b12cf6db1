"""Wavefronts of a lens as functions of wavelength and field position, and their images integrated over pixels."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from simulator.optics import pupil
from simulator.optics.psf_model import FieldAberrations, PsfModel
from simulator.optics.psf_table import pixel_matrix, sample_grid
from simulator.optics.zernike import NOLL
from startracker.core import FloatArray


def defocus_waves(shift_um: float, f_number: float, wavelength_nm: float) -> float:
    """Zernike defocus (waves rms) of a detector at a distance δ from the focus.

    The wavefront at the edge of the pupil is W₀₂₀ = δ/(8N²) (Born & Wolf, § 8.8; paraxial, with a relative error of
    about 1/(16N²)), and W₀₂₀ρ² is W₀₂₀/(2√3) of Noll's Z4 = √3(2ρ² − 1) plus piston. δ is positive if the detector is
    behind the focus.
    """
    return shift_um / (8.0 * f_number**2) / (wavelength_nm * 1e-3) / (2.0 * math.sqrt(3.0))


def axial_coefficients(psf_model: PsfModel, f_number: float) -> FloatArray:
    """Zernike coefficients (Noll 1 … 11), waves rms at `wavelength_nm`, at the centre of the field."""
    coefficients = np.zeros(pupil.TERMS)
    for name, index in NOLL.items():
        coefficients[index - 1] = getattr(psf_model.zernike_waves, name)
    coefficients[NOLL["defocus"] - 1] += defocus_waves(psf_model.defocus_um, f_number, psf_model.wavelength_nm)
    return coefficients


def field_coefficients(field: FieldAberrations, h: ArrayLike, azimuth_rad: ArrayLike) -> FloatArray:
    """Zernike coefficients of the aberrations that grow with the field, waves rms.

    Third-order aberrations (Welford 1986, Aberrations of Optical Systems, § 7): coma ∝ h along the radius, c h √8
    (3ρ³ − 2ρ) cos(θ − φ); astigmatism ∝ h² about the radius, a h² √6 ρ² cos 2(θ − φ); and field curvature, a
    defocus ∝ h².

    Parameters
    ----------
    field : FieldAberrations
        Values at the corners, h = 1.
    h, azimuth_rad : (...) arrays
        Distance from the image centre relative to that of the corners, and azimuth from +x (columns) to +y (rows).

    Returns
    -------
    (..., 11) array
    """
    h, azimuth_rad = np.asarray(h, dtype=float), np.asarray(azimuth_rad, dtype=float)
    coefficients = np.zeros((*h.shape, pupil.TERMS))
    coefficients[..., NOLL["coma_x"] - 1] = field.coma_waves * h * np.cos(azimuth_rad)
    coefficients[..., NOLL["coma_y"] - 1] = field.coma_waves * h * np.sin(azimuth_rad)
    coefficients[..., NOLL["astigmatism"] - 1] = field.astigmatism_waves * h**2 * np.cos(2.0 * azimuth_rad)
    coefficients[..., NOLL["astigmatism_oblique"] - 1] = field.astigmatism_waves * h**2 * np.sin(2.0 * azimuth_rad)
    coefficients[..., NOLL["defocus"] - 1] = field.curvature_waves * h**2
    return coefficients


def mirrored(coefficients: FloatArray, swap: bool, sign_x: int, sign_y: int) -> FloatArray:
    """Zernike coefficients (11,) of W(±x, ±y) or, swapped, W(±y, ±x), with `sign_x` the sign of x and `sign_y` that of
    y."""
    # Index j − 1 holds Noll's Z_j. Each reflection exchanges sine and cosine terms, or changes their signs.
    c = coefficients.copy()
    if swap:  # θ → π/2 − θ
        c[[1, 2, 6, 7]] = c[[2, 1, 7, 6]]
        c[5], c[8], c[9] = -c[5], -c[9], -c[8]
    if sign_x < 0:  # θ → π − θ
        c[[1, 4, 7, 9]] *= -1.0
    if sign_y < 0:  # θ → −θ
        c[[2, 4, 6, 8]] *= -1.0
    return c


def spread_px(waves: FloatArray, lambda_n_px: FloatArray, obscuration: float) -> float:
    """Radius of the geometric image about its centroid, pixels along columns: the largest over the K wavelengths.

    `waves` (K, T) are Zernike coefficients, `lambda_n_px` (K,) the values of λN in pixels.
    """
    radius = 0.0
    for coefficients, scale in zip(waves, lambda_n_px, strict=True):
        shift = 2.0 * float(np.hypot(*pupil.mean_slope(coefficients[None], obscuration)[0]))
        radius = max(radius, float(scale) * (pupil.geometric_radius(coefficients) + shift))
    return radius


class Images:
    """Monochromatic images of a point on a common grid, and their sums integrated over pixels.

    Parameters
    ----------
    waves : (K, T) array
        Zernike coefficients for each wavelength, in waves rms of that wavelength.
    lambda_n_px : (K,) array
        λN at each wavelength, pixels along columns.
    obscuration : float
        Central obscuration, fraction of the diameter.
    aspect : float
        Pitch along columns over pitch along rows.
    diffusion_px : float
        Standard deviation of the charge diffusion, pixels along columns.
    contrast : float
        Contrast of the response across a pixel (`simulator.optics.pixel_response`).
    half_px : int
        Half width of the stamp, pixels (columns and rows).
    """

    def __init__(
        self,
        waves: FloatArray,
        lambda_n_px: FloatArray,
        obscuration: float,
        aspect: float,
        diffusion_px: float,
        contrast: float,
        half_px: int,
    ) -> None:
        self.aspect, self.diffusion_px, self.contrast = aspect, diffusion_px, contrast
        # All wavelengths are sampled on the grid of the shortest, so that their sum is a sum of arrays. The division by
        # λN² converts the intensity per (λN)² to that per square pixel.
        self.finest = float(lambda_n_px.min())
        self.samples = sample_grid((half_px + 1.0) * max(1.0, 1.0 / aspect) + 4.0 * diffusion_px, self.finest)
        self.light = np.array(
            [
                pupil.intensity(coefficients, self.samples / scale, self.samples / scale, obscuration)[0] / scale**2
                for coefficients, scale in zip(waves, lambda_n_px, strict=True)
            ]
        )

    def matrices(
        self, offsets_px: FloatArray, origin_px: tuple[float, float] = (0.0, 0.0)
    ) -> tuple[FloatArray, FloatArray]:
        """Matrices that integrate over pixels at these offsets from `origin_px` along columns and along rows; the
        geometric centroid is at (0, 0)."""
        x, y = (offsets_px + origin for origin in origin_px)
        along_x = pixel_matrix(x, self.samples, self.finest, self.diffusion_px, 1.0, self.contrast)
        if self.aspect == 1.0 and origin_px[0] == origin_px[1]:
            return along_x, along_x
        size = 1.0 / self.aspect  # pitch along rows in units of that along columns
        return along_x, pixel_matrix(y * size, self.samples, self.finest, self.diffusion_px, size, self.contrast)

    def shares(self, weights: FloatArray, along_x: FloatArray, along_y: FloatArray) -> FloatArray:
        """Fraction of the light in pixels at the offsets of the matrices, (rows, columns), for a spectrum (K,)."""
        return np.asarray(along_y @ np.tensordot(weights, self.light, 1) @ along_x.T)
