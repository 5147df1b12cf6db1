"""The signal of a star in the thesis' camera: its five-band sum as coded and as it should be, and this product's.

Volts a pixel: U = K n t A ∫ E_λ λ/(hc) η dλ / P, with the volts K an electron makes, the pixels P that share the image,
and the irradiance E_λ ∝ 10^(−0.4 V). The thesis' script multiplies by λ, in µm, once more.
"""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulator.optics.curves import Curve, load_curve
from simulator.sky.library import HC_J_NM
from simulator.sky.photometry import Photometer, integrate
from simulator.sky.spectra import colour_sequence

__all__ = [
    "BANDS_UM",
    "IRRADIANCE_W_CM2_UM",
    "camera_mv",
    "irradiance_w_cm2_um",
    "thesis_mv",
]

FloatArray = NDArray[np.float64]

BANDS_UM = np.array([0.44, 0.55, 0.64, 0.79, 1.25])
IRRADIANCE_W_CM2_UM = np.array([6.6, 3.6, 2.25, 1.22, 0.292]) * 1e-12
"""Of an A0V star of V = 0 in these bands; the thesis' Appendix B."""

EFFICIENCY = np.array([0.2, 0.4, 0.5, 0.38, 0.05])
"""Quantum efficiency of the TC211 there; the thesis' Appendix B."""

RELATIVE_WIDTH = 0.1493
"""Δλ/λ of the bands. The thesis prints no widths; this one makes the sum as coded 5.405 mV, which is what its script
gives for V = 6.5, 12 cm, 0.5 s, and the same sum without the surplus λ is then 8.75 mV."""

MICROVOLT_PER_E = 1.4
"""Section 3.4.1, TC211."""

IMAGE_PIXELS = 25
SATURATION_MV = 450.0
"""Of the TC211 with antiblooming, section 3.4.3."""


@functools.cache
def _band_electrons_cm2_s(extra_lambda: bool) -> float:
    """Electrons cm⁻² s⁻¹ of V = 0 from the five bands, each a box of equal relative width."""
    total = 0.0
    for um, irradiance, efficiency in zip(BANDS_UM, IRRADIANCE_W_CM2_UM, EFFICIENCY, strict=True):
        edges_nm = um * 1e3 * np.array([1.0 - RELATIVE_WIDTH / 2, 1.0 + RELATIVE_WIDTH / 2])
        photons = irradiance * 1e-3 * um * 1e3 / HC_J_NM
        electrons = integrate(Curve(edges_nm, np.full(2, photons)), Curve(edges_nm, np.full(2, efficiency)))
        total += electrons * (um if extra_lambda else 1.0)
    return float(total)


def thesis_mv(
    v_mag: ArrayLike, aperture_m: ArrayLike = 0.12, exposure_s: ArrayLike = 0.5, *, extra_lambda: bool
) -> FloatArray:
    """Output voltage of each of 25 pixels, mV, by the thesis' five bands; not clipped at saturation.

    Parameters
    ----------
    v_mag : array
        Magnitude V of an A0V star.
    aperture_m, exposure_s : array
        Diameter of the lens, integration time; broadcast against `v_mag`.
    extra_lambda : bool
        As the thesis' script has it, with λ in µm once too often; or right.
    """
    return _millivolts(_band_electrons_cm2_s(extra_lambda), v_mag, aperture_m, exposure_s)


def camera_mv(
    v_mag: ArrayLike,
    aperture_m: ArrayLike = 0.12,
    exposure_s: ArrayLike = 0.5,
    *,
    b_v: float = 0.0,
    giant: float = 0.0,
) -> FloatArray:
    """The same with this product's spectra and the TC211's curve, a lens without losses.

    Parameters
    ----------
    v_mag, aperture_m, exposure_s : array
        As in `thesis_mv`.
    b_v, giant : float
        Colour and class of the star, as `simulator.sky.photometry.Photometer` takes them; A0V left out.
    """
    electrons = float(_photometer().electrons_per_s(0.0, b_v, giant))
    return _millivolts(electrons, v_mag, aperture_m, exposure_s)


@functools.cache
def _photometer() -> Photometer:
    return Photometer(Curve.flat(1.0) * load_curve("tc211", "quantum_efficiency"), 1.0)


def _millivolts(electrons_cm2_s: float, v_mag: ArrayLike, aperture_m: ArrayLike, exposure_s: ArrayLike) -> FloatArray:
    area_cm2 = math.pi * (np.asarray(aperture_m, dtype=float) * 50.0) ** 2
    electrons = electrons_cm2_s * area_cm2 * np.asarray(exposure_s) * 10.0 ** (-0.4 * np.asarray(v_mag, dtype=float))
    return np.asarray(electrons / IMAGE_PIXELS * MICROVOLT_PER_E * 1e-3)


def irradiance_w_cm2_um(wavelength_nm: FloatArray, v_mag: float, b_v: float, giant: float) -> FloatArray:
    """Spectral irradiance of a star, W cm⁻² µm⁻¹; (W,): photons × hc/λ.

    Parameters
    ----------
    wavelength_nm : (W,) array
        Wavelengths, nm.
    v_mag, b_v, giant : float
        Magnitude, colour and class, as `simulator.sky.spectra.colour_sequence` takes them.
    """
    photons = colour_sequence(wavelength_nm, np.array([b_v]), np.array([giant]))[0]
    return np.asarray(photons * HC_J_NM / wavelength_nm * 1e3 * 10.0 ** (-0.4 * v_mag))
