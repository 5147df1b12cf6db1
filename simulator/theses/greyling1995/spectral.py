"""Spectral responses of the eye and of the CCD (Greyling 1995, Figs. 2.2, 3.10 and 3.11)."""

from __future__ import annotations

import numpy as np

from simulator.optics.curves import load_curve
from simulator.sky.library import HC_J_NM
from simulator.theses.greyling1995.starlight import BANDS_UM, EFFICIENCY, SECOND_EFFICIENCY
from simulator.theses.tables import Values
from startracker.arrays import FloatArray

WAVELENGTH_NM: FloatArray = np.arange(360.0, 1251.0)
CHARGE_C = 1.602176634e-19


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
    return np.asarray(ccd_efficiency(wavelength_nm, name) * CHARGE_C * wavelength_nm / HC_J_NM)


def _peak_nm(values: FloatArray) -> float:
    return float(WAVELENGTH_NM[int(np.argmax(values))])


def values() -> Values:
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
        "second_photons": 0.5 * (CHARGE_C * WAVELENGTH_NM / HC_J_NM),
    }
