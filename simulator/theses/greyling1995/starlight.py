"""The signal of a star in the camera of the thesis: its five-band sum as coded and corrected, and the product's result.

Volts per pixel: U = K n t A ∫ E_λ λ/(hc) η dλ / P, with K volts per electron, P the number of pixels of the image, and
the irradiance E_λ ∝ 10^(−0.4 V). The first script of `ccdmag.m` in the thesis has an additional factor λ, in µm; a
second one in the same listing does not.
"""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import ArrayLike

from simulator.optics.curves import Curve, load_curve
from simulator.sky.library import HC_J_NM
from simulator.sky.photometry import Photometer
from simulator.sky.spectra import colour_sequence
from startracker.arrays import FloatArray

BANDS_UM = np.array([0.44, 0.55, 0.64, 0.79, 1.25])
IRRADIANCE_W_CM2_UM = np.array([6.6, 3.6, 2.25, 1.22, 0.292]) * 1e-12
"""Irradiance of an A0V star of V = 0 in these bands; Appendix B of the thesis."""

EFFICIENCY = np.array([0.2, 0.4, 0.5, 0.38, 0.05])
"""Quantum efficiency of the TC211 in these bands; Appendix B of the thesis."""

WIDTHS_UM = np.array([0.10, 0.11, 0.09, 0.15, 0.46])
"""Δλ of the bands in `ccdmag.m`: each extends down to the previous band, and the first is 0.1 µm wide."""

CHARGE_C, GAIN, CAPACITANCE_F = 1.6e-19, 0.7, 0.1e-12
VOLT_PER_E = CHARGE_C * GAIN / CAPACITANCE_F
"""(3.7) with the typical values printed below it, as in `ccdmag.m`: 1.12 µV per electron."""

PROTOTYPE_VOLT_PER_E = 1.4e-6
"""Areas of the TC211: section 3.4.1, Fig. 3.15, and the second script of `ccdmag.m`."""

IMAGE_PIXELS = 25
SATURATION_MV = 450.0
"""Value of the TC211 with antiblooming, section 3.4.3."""

PLANCK_J_S, LIGHT_M_S = 6.626e-34, 3e8
"""As in `ccdmag.m`; 0.07 % from current values."""

SECOND_EFFICIENCY = np.array([0.1, 0.28, 0.4, 0.38, 0.05])
SECOND_PIXELS = 10
"""Values of the second script in the listing of `ccdmag.m`."""


def _band_electrons_cm2_s(efficiency: FloatArray, *, extra_lambda: bool) -> float:
    """Electrons cm⁻² s⁻¹ of V = 0 from the five bands: Σ E_λ λ/(hc) η Δλ."""
    photons = IRRADIANCE_W_CM2_UM * BANDS_UM * 1e-6 / (PLANCK_J_S * LIGHT_M_S)
    electrons = photons * efficiency * WIDTHS_UM * (BANDS_UM if extra_lambda else 1.0)
    return float(electrons.sum())


def thesis_mv(
    v_mag: ArrayLike,
    aperture_m: ArrayLike = 0.12,
    exposure_s: ArrayLike = 0.5,
    *,
    extra_lambda: bool,
    volt_per_e: float = VOLT_PER_E,
) -> FloatArray:
    """Output voltage of each of 25 pixels for an A0V star, mV, by the first script of `ccdmag.m`; not clipped.

    Arrays are broadcast; `aperture_m` is the diameter of the lens. `extra_lambda`: as in the script, with an additional
    factor λ in µm, or without.
    """
    electrons = _band_electrons_cm2_s(EFFICIENCY, extra_lambda=extra_lambda)
    return _millivolts(electrons, v_mag, aperture_m, exposure_s, volt_per_e)


def second_script_mv(v_mag: ArrayLike, aperture_m: ArrayLike = 0.12, exposure_s: ArrayLike = 0.5) -> FloatArray:
    """Output voltage of each of 10 pixels, mV, by the second script: other efficiencies, 1.4 µV, no additional factor
    λ."""
    electrons = _band_electrons_cm2_s(SECOND_EFFICIENCY, extra_lambda=False)
    return _millivolts(electrons, v_mag, aperture_m, exposure_s, PROTOTYPE_VOLT_PER_E, SECOND_PIXELS)


def camera_mv(
    v_mag: ArrayLike,
    aperture_m: ArrayLike = 0.12,
    exposure_s: ArrayLike = 0.5,
    *,
    b_v: float = 0.0,
    giant: float = 0.0,
    volt_per_e: float = VOLT_PER_E,
) -> FloatArray:
    """The same with the product's spectra, for a colour and class as in `Photometer` and the curve of the TC211,
    without losses."""
    electrons = float(_photometer().electrons_per_s(0.0, b_v, giant))
    return _millivolts(electrons, v_mag, aperture_m, exposure_s, volt_per_e)


@functools.cache
def _photometer() -> Photometer:
    return Photometer(Curve.flat(1.0) * load_curve("tc211", "quantum_efficiency"), 1.0)


def _millivolts(
    electrons_cm2_s: float,
    v_mag: ArrayLike,
    aperture_m: ArrayLike,
    exposure_s: ArrayLike,
    volt_per_e: float,
    pixels: int = IMAGE_PIXELS,
) -> FloatArray:
    area_cm2 = math.pi * (np.asarray(aperture_m, dtype=float) * 50.0) ** 2
    electrons = electrons_cm2_s * area_cm2 * np.asarray(exposure_s) * 10.0 ** (-0.4 * np.asarray(v_mag, dtype=float))
    return np.asarray(electrons / pixels * volt_per_e * 1e3)


def irradiance_w_cm2_um(wavelength_nm: FloatArray, v_mag: float, b_v: float, giant: float) -> FloatArray:
    """Spectral irradiance (W,) of a star of a colour and class, W cm⁻² µm⁻¹: photons × hc/λ."""
    photons = colour_sequence(wavelength_nm, np.array([b_v]), np.array([giant]))[0]
    return np.asarray(photons * HC_J_NM / wavelength_nm * 1e3 * 10.0 ** (-0.4 * v_mag))
