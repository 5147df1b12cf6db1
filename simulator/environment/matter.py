"""Slowing down of protons and electrons in aluminium and silicon, and displacement damage in silicon.

Between the points of the tables all columns are power laws (linear in logarithms).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from startracker.core import FloatArray

ALUMINIUM_G_CM3 = 2.699
SILICON_G_CM3 = 2.329
MM_PER_CM = 10.0
RAD_PER_MEV_G = 1.602_176_634e-8
"""1 rad = 100 erg/g."""

# Columns: MeV; aluminium, MeV cm²/g and g/cm²; silicon, MeV cm²/g and MeV cm²/g (see below).
_PROTONS = np.array(
    [
        (0.1, 395.5, 3.602e-4, 284.2, 0.4798),
        (0.2, 333.0, 6.325e-4, 281.3, 0.268),
        (0.5, 207.8, 1.818e-3, 191.3, 0.11999),
        (1, 143.7, 4.783e-3, 131.3, 0.063442),
        (2, 93.13, 1.366e-2, 86.58, 0.033142),
        (3, 70.80, 2.612e-2, 66.53, 0.022565),
        (5, 49.43, 6.058e-2, 46.99, 0.014754),
        (7, 38.70, 0.1067, 37.02, 0.011642),
        (10, 29.69, 0.1961, 28.56, 0.0094037),
        (15, 21.83, 0.3953, 21.10, 0.0077203),
        (20, 17.50, 0.6529, 16.97, 0.0067586),
        (30, 12.80, 1.331, 12.45, 0.0055935),
        (40, 10.25, 2.211, 9.994, 0.0048988),
        (50, 8.632, 3.279, 8.433, 0.0044102),
        (60, 7.513, 4.524, 7.348, 0.0040246),
        (80, 6.054, 7.512, 5.932, 0.0034243),
        (100, 5.141, 11.11, 5.043, 0.0029757),
        (150, 3.870, 22.49, 3.801, 0.0022803),
        (200, 3.207, 36.78, 3.153, 0.0019291),
        (300, 2.526, 72.38, 2.485, 0.0016326),
        (400, 2.182, 115.2, 2.147, 0.0015217),
        (600, 1.845, 216.0, 1.814, 0.0014375),
        (1000, 1.600, 451.9, 1.574, 0.0013607),
        (2000, 1.481, 1111.0, 1.456, 0.0013677),
        (10000, 1.626, 6287.0, 1.601, 0.0011364),
    ]
)
"""Kinetic energy; stopping power and range in aluminium, stopping power in silicon (NIST PSTAR: Berger et al., NISTIR
4999; ICRU 49); non-ionising energy loss in silicon (SR-NIEL calculator, Boschini et al., sr-niel.org)."""


class Medium(NamedTuple):
    """Parameters of the collisions of electrons with a medium: ICRU 37, with the density correction in the form of
    Sternheimer, Berger & Seltzer 1984 (At. Data Nucl. Data Tables 30, 261)."""

    charge_over_mass: float
    """Z/A, mol/g."""
    excitation_ev: float
    """Mean excitation energy I."""
    minus_c: float
    """Sternheimer's −C."""
    a: float
    """Sternheimer's a."""
    exponent: float
    """Sternheimer's exponent, m or k."""
    x_low: float
    """Sternheimer's x₀, below which a conductor has the density effect δ(x₀) 10^(2 (x − x₀))."""
    x_high: float
    """Sternheimer's x₁, above which the density effect is linear in x."""
    delta_low: float
    """Sternheimer's δ(x₀)."""


ALUMINIUM = Medium(0.48181, 166.0, 4.2395, 0.08024, 3.6345, 0.1708, 3.0127, 0.12)
SILICON = Medium(0.49848, 173.0, 4.4351, 0.14921, 3.2546, 0.2014, 2.8715, 0.14)

_ELECTRON_MEV = 0.510_998_95
_COLLISION_MEV_CM2_G = 0.153_537
"""2π r_e² m_e c² N_A."""


def _power_law(x: ArrayLike, points: FloatArray, values: FloatArray) -> FloatArray:
    # Linear in logarithms, which is a power law between two points.
    return np.asarray(np.exp(np.interp(np.log(x), np.log(points), np.log(values))))


def proton_range_g_cm2(energy_mev: ArrayLike) -> FloatArray:
    """Range of protons in aluminium, g/cm², 0.1 to 10,000 MeV (continuous slowing down)."""
    return _power_law(energy_mev, _PROTONS[:, 0], _PROTONS[:, 2])


def proton_energy_mev(range_g_cm2: ArrayLike) -> FloatArray:
    """Energy of protons with a given range in aluminium, the inverse of `proton_range_g_cm2`."""
    return _power_law(range_g_cm2, _PROTONS[:, 2], _PROTONS[:, 0])


def proton_stopping_silicon(energy_mev: ArrayLike) -> FloatArray:
    """Stopping power of silicon for protons, MeV cm²/g."""
    return _power_law(energy_mev, _PROTONS[:, 0], _PROTONS[:, 3])


def proton_niel_silicon(energy_mev: ArrayLike) -> FloatArray:
    """Non-ionising energy loss of protons in silicon, MeV cm²/g, by SR-NIEL."""
    return _power_law(energy_mev, _PROTONS[:, 0], _PROTONS[:, 4])


def electron_stopping(energy_mev: ArrayLike, medium: Medium = SILICON) -> FloatArray:
    """Collision stopping power for electrons, MeV cm²/g, 0.01 to 1000 MeV.

    Bethe's formula for electrons (ICRU 37, eq. 2.4; Berger & Seltzer 1982, NBSIR 82-2550), with which NIST's ESTAR is
    computed: S/ρ = k Z/A /β² [ln(T/I)² + ln(1 + τ/2) + (1 − β²)(1 + τ²/8 − (2τ + 1) ln 2) − δ], τ = T/m_e c².

    Parameters
    ----------
    energy_mev : array
        Kinetic energy T.
    medium : Medium
    """
    energy = np.asarray(energy_mev, dtype=float)
    tau = energy / _ELECTRON_MEV
    beta2 = tau * (tau + 2.0) / (tau + 1.0) ** 2
    shape = (1.0 - beta2) * (1.0 + tau**2 / 8.0 - (2.0 * tau + 1.0) * math.log(2.0))
    logarithm = 2.0 * np.log(energy / (medium.excitation_ev * 1e-6)) + np.log1p(0.5 * tau)
    density = _density_effect(np.log10(tau * (tau + 2.0)) / 2.0, medium)
    return np.asarray(
        _COLLISION_MEV_CM2_G * medium.charge_over_mass / beta2 * (logarithm + shape - density), dtype=float
    )


def _density_effect(x: FloatArray, medium: Medium) -> FloatArray:
    """Sternheimer's δ at x = log₁₀ βγ."""
    rising = 2.0 * math.log(10.0) * x - medium.minus_c
    bend = medium.a * np.maximum(medium.x_high - x, 0.0) ** medium.exponent
    low = medium.delta_low * 10.0 ** (2.0 * (x - medium.x_low))
    return np.where(x < medium.x_low, low, rising + bend)


_KATZ_PENFOLD_MEV = np.geomspace(0.01, 10.0, 301)


def electron_range_g_cm2(energy_mev: ArrayLike) -> FloatArray:
    """Extrapolated range of electrons in aluminium, g/cm², 0.01 to 10 MeV (Katz & Penfold 1952, Rev. Mod. Phys. 24,
    28): 0.412 E^(1.265 − 0.0954 ln E) up to 2.5 MeV, 0.530 E − 0.106 above."""
    energy = np.asarray(energy_mev, dtype=float)
    low = 0.412 * energy ** (1.265 - 0.0954 * np.log(energy))
    return np.where(energy <= 2.5, low, 0.530 * energy - 0.106)


def electron_energy_mev(range_g_cm2: ArrayLike) -> FloatArray:
    """Energy of electrons with a given extrapolated range in aluminium."""
    return _power_law(range_g_cm2, electron_range_g_cm2(_KATZ_PENFOLD_MEV), _KATZ_PENFOLD_MEV)
