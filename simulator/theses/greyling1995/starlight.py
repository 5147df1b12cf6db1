"""The signal of a star in the camera of the thesis: its five-band sum as coded and corrected, and the product's result.

Volts per pixel: U = K n t A ∫ E_λ λ/(hc) η dλ / P, with K volts per electron, P the number of pixels of the image, and
the irradiance E_λ ∝ 10^(−0.4 V). The first script of `ccdmag.m` in the thesis has an additional factor λ, in µm; a
second one in the same listing does not. At the end the spectral responses of eye and CCD (Figs. 2.2, 3.10, 3.11).
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
from simulator.theses.tables import Values
from startracker.core import FloatArray

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


WAVELENGTH_NM: FloatArray = np.arange(360.0, 1251.0)
ELEMENTARY_CHARGE_C = 1.602176634e-19


def eye_response(wavelength_nm: FloatArray = WAVELENGTH_NM, *, night: bool = False) -> FloatArray:
    """Luminous efficiency (W,) of the eye, 1 at the peak, photopic (CIE 1924) or at night scotopic (CIE 1951); 0
    outside the table."""
    from colour.colorimetry import SDS_LEFS_PHOTOPIC, SDS_LEFS_SCOTOPIC

    day_table = SDS_LEFS_PHOTOPIC["CIE 1924 Photopic Standard Observer"]
    table = SDS_LEFS_SCOTOPIC["CIE 1951 Scotopic Standard Observer"] if night else day_table
    return np.asarray(np.interp(wavelength_nm, table.wavelengths, table.values, left=0.0, right=0.0))


def ccd_efficiency(wavelength_nm: FloatArray = WAVELENGTH_NM, name: str = "tc211") -> FloatArray:
    """Quantum efficiency (W,) of a detector of the product's library, electrons per photon."""
    return np.asarray(load_curve(name, "quantum_efficiency")(wavelength_nm), dtype=float)


def ccd_response_a_w(wavelength_nm: FloatArray = WAVELENGTH_NM, name: str = "tc211") -> FloatArray:
    """Response (W,), amperes per watt: R = η q λ / (h c)."""
    return np.asarray(ccd_efficiency(wavelength_nm, name) * ELEMENTARY_CHARGE_C * wavelength_nm / HC_J_NM)


def _peak_nm(values: FloatArray) -> float:
    return float(WAVELENGTH_NM[int(np.argmax(values))])


def spectral_values() -> Values:
    """The curves, their peaks, and the longest wavelength at which the TC211's response is half of its peak."""
    eye, tc211, ccd44 = eye_response(), ccd_response_a_w(), ccd_response_a_w(name="ccd44_82")
    return {
        "eye_peak_nm": _peak_nm(eye),
        "response_peak_nm": _peak_nm(tc211),
        "ccd44_peak_nm": _peak_nm(ccd44),
        "half_nm": float(WAVELENGTH_NM[np.flatnonzero(tc211 >= 0.5 * tc211.max())[-1]]),
        "efficiency_peak_um": 1e-3 * _peak_nm(ccd_efficiency()),
        "um": WAVELENGTH_NM / 1e3,
        "eye": eye,
        "tc211": tc211,
        "relative": {"tc211": tc211 / tc211.max(), "ccd44": ccd44 / ccd44.max()},
        "efficiency_percent": 100.0 * ccd_efficiency(),
        "bands_um": BANDS_UM,
        "script_percents": (100.0 * EFFICIENCY, 100.0 * SECOND_EFFICIENCY),
        "second_photons": 0.5 * (ELEMENTARY_CHARGE_C * WAVELENGTH_NM / HC_J_NM),
    }
