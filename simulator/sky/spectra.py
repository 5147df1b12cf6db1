"""Photon spectra of stars from V, B−V and luminosity class."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from simulator.constants import BOLTZMANN_J_K, DEFAULT_B_V
from simulator.optics.curves import load_curve
from simulator.sky.extinction import relative_extinction
from simulator.sky.library import HC_J_NM, Sequence, sequence
from simulator.sky.monotone import MonotoneCubic
from startracker.core import FloatArray

Spectrum = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]

V0_PHOTONS_S_CM2_NM = 9955.0
"""Photons of a V = 0 star, cm⁻² s⁻¹ nm⁻¹, at `V_EFFECTIVE_NM`; Bessell, Castelli & Plez 1998 (A&A 333, 231), table
A2."""

V_EFFECTIVE_NM = 545.0
"""Effective wavelength of V for an A0 star; the same table."""

SOLAR_B_V = 0.653
"""Colour of the Sun; Ramírez et al. 2012 (ApJ 752, 5)."""

B_V_RANGE = (-0.4, 3.0)
"""Colours outside are clipped to this range."""

LATE_GIANT = (10.0, 16.0)
"""`giant` of M0 to M6 giants, 10 + subtype; see `colour_sequence`."""

_C2_M_K = HC_J_NM * 1e-9 / BOLTZMANN_J_K  # hc/k; colour-science's default is rounded to 0.014388
V_GRID_NM = np.arange(470.0, 700.5, 0.5)


def colour_sequence(wavelength_nm: FloatArray, b_v: FloatArray, giant: ArrayLike = 0.0) -> FloatArray:
    """Photon flux density of V = 0 stars with the colours of real dwarfs and giants.

    Library spectra of each type (Pickles 1998, PASP 110, 863), adjusted to the published U−B, B−V, V−R and V−I of that
    type by a smooth factor (`simulator.sky.library`), form a sequence of dwarfs (B0 to M6; Mamajek 2018 after Pecaut &
    Mamajek 2013, ApJS 208, 9) and one of giants (G0 to K5; medians of the Bright Star Catalogue and Hipparcos; bluer
    ones as dwarfs). Between two types ln n_λ is a monotone cubic in B−V. Beyond the red end (2.0, 1.51) the last
    spectrum is reddened by interstellar dust (`simulator.sky.extinction`), as is the case for most such stars; beyond
    B0 it is that of B0. Giants from M0 to M6 have nearly the same B−V, but V−I from 1.7 to 3.4, and use the subtype.

    Parameters
    ----------
    wavelength_nm : (W,) array
        Wavelengths, nm; the library has 200 to 1300. Above 1300 nm n_λ ∝ λ⁻³ (Rayleigh–Jeans), below 200 nm it is 0.
    b_v : (N,) array
        Colours B−V; `DEFAULT_B_V` for NaN (unknown); clipped to `B_V_RANGE`.
    giant : float or (N,) array
        Fraction of the giant's spectrum, 0 (dwarf) to 1 (giant); 10 to 16: M giant of subtype 0 to 6 for any B−V.

    Returns
    -------
    (N, W) array
        Photons cm⁻² s⁻¹ nm⁻¹; the mean of F_λ over V is 3.628 × 10⁻⁹ erg cm⁻² s⁻¹ Å⁻¹, as in `blackbody`.

    Notes
    -----
    The synthetic magnitudes of an A0 star with V = 0 are 0 to within 0.005 with the zero points of Bessell, Castelli &
    Plez 1998; colours of types that were not imposed agree to 0.05 mag (0.1 beyond M0). The scatter of real stars about
    these sequences is about 0.03 mag in V−I at given B−V and class.
    """
    colour = _known(b_v)
    share = np.broadcast_to(np.asarray(giant, dtype=float), colour.shape)
    photons = np.zeros((len(colour), len(wavelength_nm)))
    # The spectrum of an intermediate class is the mean of dwarf and giant of the same colour, weighted by the class.
    late = share >= LATE_GIANT[0]
    weight = np.clip(np.where(late, 0.0, share), 0.0, 1.0)
    for name, part in (("dwarf", np.where(late, 0.0, 1.0 - weight)), ("giant", weight)):
        rows = part > 0.0
        if rows.any():
            photons[rows] += part[rows, None] * _along(sequence(name), colour[rows], wavelength_nm)
    if late.any():
        photons[late] = _along(sequence("late_giant"), np.clip(share[late], *LATE_GIANT) - LATE_GIANT[0], wavelength_nm)
    return photons


def _along(line: Sequence, key: FloatArray, wavelength_nm: FloatArray) -> FloatArray:
    """Spectra (N, W) of stars of V = 0 at coordinates `key` (N,) of a sequence."""
    inside = np.clip(key, line.key[0], line.key[-1])
    photons = np.exp(_interpolator(line)(inside))
    # The excess over the reddest colour is a colour excess E(B−V) of interstellar dust.
    beyond = key - line.key[-1]
    red = beyond > 0.0
    if red.any():
        photons[red] *= 10.0 ** (-0.4 * beyond[red, None] * relative_extinction(line.wavelength_nm))
    # The scaling to V = 0 comes after the reddening, which changes V.
    photons *= (V0_PHOTONS_S_CM2_NM / V_EFFECTIVE_NM / mean_v(line.wavelength_nm, photons))[:, None]
    return _resampled(line.wavelength_nm, photons, wavelength_nm)


@functools.cache
def _interpolator(line: Sequence) -> MonotoneCubic:
    # The floor avoids the logarithm of 0 where a library spectrum has no flux.
    return MonotoneCubic.through(line.key, np.log(np.maximum(line.photons, 1e-30)))


def mean_v(wavelength_nm: FloatArray, photons: FloatArray) -> FloatArray:
    """Mean of n_λ/λ, which is ∝ F_λ, over Bessell's V; photons (N, W)."""
    passband = load_curve("bessell_v", "passband")(V_GRID_NM)
    energy = _resampled(wavelength_nm, photons, V_GRID_NM) / V_GRID_NM
    return np.asarray(np.trapezoid(energy * passband, V_GRID_NM, axis=1) / np.trapezoid(passband, V_GRID_NM))


def _resampled(at_nm: FloatArray, photons: FloatArray, wavelength_nm: FloatArray) -> FloatArray:
    """Linear interpolation; λ⁻³ beyond the red end, zero beyond the blue one."""
    left = np.clip(np.searchsorted(at_nm, wavelength_nm, side="right") - 1, 0, len(at_nm) - 2)
    part = np.clip((wavelength_nm - at_nm[left]) / (at_nm[left + 1] - at_nm[left]), 0.0, 1.0)
    part_of_end = np.where(wavelength_nm > at_nm[-1], (at_nm[-1] / np.maximum(wavelength_nm, 1.0)) ** 3, 1.0)
    part_of_end = np.where(wavelength_nm < at_nm[0], 0.0, part_of_end)
    return np.asarray((photons[:, left] * (1.0 - part) + photons[:, left + 1] * part) * part_of_end)


def temperature_k(b_v: ArrayLike) -> FloatArray:
    """Effective temperature of a star from its colour, kelvin.

    T = 4600 (1/(0.92 (B−V) + 1.7) + 1/(0.92 (B−V) + 0.62)); Ballesteros 2012 (EPL 97, 34008), who fits black bodies
    to B−V. Accurate to about 5 % for unreddened stars from B−V = −0.3 to 1.6; colours are clipped to `B_V_RANGE`, and
    NaN (unknown) is replaced by `DEFAULT_B_V`.
    """
    colour = 0.92 * _known(b_v)
    return np.asarray(4600.0 * (1.0 / (colour + 1.7) + 1.0 / (colour + 0.62)))


def blackbody(wavelength_nm: FloatArray, b_v: FloatArray, giant: ArrayLike = 0.0) -> FloatArray:
    """Photon flux density of V = 0 stars as black bodies.

    The temperature follows from the colour (`temperature_k`), and the spectrum is Planck's law, scaled such that the
    mean energy flux over Bessell's V passband is that of the published zero point:
    ∫ F_λ S_V dλ / ∫ S_V dλ = 995.5 photons cm⁻² s⁻¹ Å⁻¹ × hc/545 nm = 3.628 × 10⁻⁹ erg cm⁻² s⁻¹ Å⁻¹.

    Parameters
    ----------
    wavelength_nm : (W,) array
        Wavelengths, nm.
    b_v : (N,) array
        Colours B−V; NaN where unknown.
    giant : float or (N,) array
        Luminosity class, not used here.

    Returns
    -------
    (N, W) array
        Photons cm⁻² s⁻¹ nm⁻¹.

    Notes
    -----
    V is exact. A black body has neither lines nor jumps: against the A0 fluxes of Bessell, Castelli & Plez 1998 it is
    12 % too faint in B, 11 % too bright in R and 22 % too bright in I. For cool stars (B−V > 1.6) with molecular bands
    it is only a rough approximation.
    """
    temperature = np.atleast_1d(temperature_k(b_v))
    photons = _planck_photons(wavelength_nm, temperature)
    mean = mean_v(V_GRID_NM, _planck_photons(V_GRID_NM, temperature))
    return np.asarray(photons * (V0_PHOTONS_S_CM2_NM / V_EFFECTIVE_NM / mean)[:, None])


def _known(b_v: ArrayLike) -> FloatArray:
    """Colours without NaN, clipped to `B_V_RANGE`."""
    colour = np.asarray(b_v, dtype=float)
    return np.asarray(np.clip(np.where(np.isnan(colour), DEFAULT_B_V, colour), *B_V_RANGE))


def _planck_photons(wavelength_nm: FloatArray, temperature: FloatArray) -> FloatArray:
    """Photon radiance of black bodies up to a common factor, (N, W)."""
    planck_law = _planck_law()
    radiance = np.stack([planck_law(wavelength_nm * 1e-9, float(t), c2=_C2_M_K).ravel() for t in temperature])
    return radiance * wavelength_nm * (1e-9 / HC_J_NM)


@functools.cache
def _planck_law() -> Callable[..., FloatArray]:
    from colour.colorimetry import planck_law  # takes a second to import, so only when needed

    law: Callable[..., FloatArray] = planck_law
    return law


SPECTRA: dict[str, Spectrum] = {"colour_sequence": colour_sequence, "blackbody": blackbody}
"""Families of spectra by name: (wavelength_nm (W,), b_v (N,), giant (N,)) → photons cm⁻² s⁻¹ nm⁻¹ (N, W) of V = 0
stars; `giant` as in `colour_sequence`."""
