"""Spectra of stars: photons of every wavelength from a star of known V and B−V."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulator.constants import BOLTZMANN_J_K, PLANCK_J_S
from simulator.optics.curves import load_curve
from startracker.constants import SPEED_OF_LIGHT_KM_S

FloatArray = NDArray[np.float64]
Spectrum = Callable[[FloatArray, FloatArray], FloatArray]

V0_PHOTONS_S_CM2_NM = 9955.0
"""Photons of a V = 0 star, cm⁻² s⁻¹ nm⁻¹, at `V_EFFECTIVE_NM`; Bessell, Castelli & Plez 1998 (A&A 333, 231), table
A2."""

V_EFFECTIVE_NM = 545.0
"""Effective wavelength of V for an A0 star; the same table."""

DEFAULT_B_V = 0.6
"""Colour of a star whose B−V is not known: about the median of stars brighter than V = 9."""

SOLAR_B_V = 0.653
"""Colour of the Sun; Ramírez et al. 2012 (ApJ 752, 5)."""

B_V_RANGE = (-0.4, 3.0)
"""Colours outside are taken for the nearer end."""

_HC_J_NM = PLANCK_J_S * SPEED_OF_LIGHT_KM_S * 1e3 * 1e9
_C2_M_K = _HC_J_NM * 1e-9 / BOLTZMANN_J_K  # colour-science's default is rounded to 0.014388
_GRID_NM = np.arange(470.0, 700.5, 0.5)


def temperature_k(b_v: ArrayLike) -> FloatArray:
    """Effective temperature of a star from its colour, kelvin.

    T = 4600 (1/(0.92 (B−V) + 1.7) + 1/(0.92 (B−V) + 0.62)); Ballesteros 2012 (EPL 97, 34008), who fits black bodies
    to B−V. Good to some 5 % for unreddened stars from B−V = −0.3 to 1.6; colours are kept within `B_V_RANGE`, and one
    that is not known (NaN) counts as `DEFAULT_B_V`.
    """
    colour = np.asarray(b_v, dtype=float)
    colour = 0.92 * np.clip(np.where(np.isnan(colour), DEFAULT_B_V, colour), *B_V_RANGE)
    return 4600.0 * (1.0 / (colour + 1.7) + 1.0 / (colour + 0.62))


def blackbody(wavelength_nm: FloatArray, b_v: FloatArray) -> FloatArray:
    """Photon flux density of V = 0 stars that shine as black bodies.

    The temperature is that of the colour (`temperature_k`), the shape Planck's law, the scale such that the mean of the
    energy flux over Bessell's V passband is that of the published zero point:
    ∫ F_λ S_V dλ / ∫ S_V dλ = 995.5 photons cm⁻² s⁻¹ Å⁻¹ × hc/545 nm = 3.628 × 10⁻⁹ erg cm⁻² s⁻¹ Å⁻¹.

    Parameters
    ----------
    wavelength_nm : (W,) array
        Wavelengths, nm.
    b_v : (N,) array
        Colours B−V; NaN where unknown.

    Returns
    -------
    (N, W) array
        Photons cm⁻² s⁻¹ nm⁻¹.

    Notes
    -----
    V is exact. A black body has neither lines nor jumps: against the A0 fluxes of Bessell, Castelli & Plez 1998 it is
    12 % faint in B, 11 % bright in R and 22 % bright in I. Cool stars (B−V > 1.6), whose light goes into molecular
    bands, are a rough guess.
    """
    temperature = np.atleast_1d(temperature_k(b_v))
    photons = _planck_photons(wavelength_nm, temperature)
    passband = load_curve("bessell_v", "passband")(_GRID_NM)
    energy = _planck_photons(_GRID_NM, temperature) / _GRID_NM  # ∝ F_λ: a photon carries hc/λ
    mean = np.trapezoid(energy * passband, _GRID_NM, axis=1) / np.trapezoid(passband, _GRID_NM)
    return np.asarray(photons * (V0_PHOTONS_S_CM2_NM / V_EFFECTIVE_NM / mean)[:, None])


def _planck_photons(wavelength_nm: FloatArray, temperature: FloatArray) -> FloatArray:
    """Photon radiance of black bodies up to a common factor, (N, W)."""
    planck_law = _planck_law()
    radiance = np.stack([planck_law(wavelength_nm * 1e-9, float(t), c2=_C2_M_K).ravel() for t in temperature])
    return radiance * wavelength_nm * (1e-9 / _HC_J_NM)


@functools.cache
def _planck_law() -> Callable[..., FloatArray]:
    from colour.colorimetry import planck_law  # a second to import: only who makes spectra waits for it

    return planck_law  # type: ignore[no-any-return]


SPECTRA: dict[str, Spectrum] = {"blackbody": blackbody}
"""Families of spectra by name: (wavelength_nm (W,), b_v (N,)) → photons cm⁻² s⁻¹ nm⁻¹ (N, W) of V = 0 stars."""
