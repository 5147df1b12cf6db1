"""Doses at the centre of a hollow sphere of aluminium.

Particles that arrive from all sides cross the wall on the shortest path and slow down continuously; the spectrum behind
a wall of thickness x (g/cm²) follows from the range R(E), as R(E behind) = R(E) − x. This is the geometry "centre of
aluminium spheres" of SHIELDOSE (Seltzer 1980, NBS TN 1116). Protons: nuclear reactions are neglected; the dependence of
the dose on depth agrees with SHIELDOSE-2 to 3 % from 1 to 20 mm. Electrons: scattering is represented by the
extrapolated range; the dose is 10 to 40 % below that of SHIELDOSE-2 from 1 to 4 mm. Bremsstrahlung, below 2 % of the
dose up to 5 mm, is neglected.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from simulator.environment import matter
from simulator.environment.spectrum import Spectrum
from startracker.core import FloatArray

_LEAST_PROTON_MEV, _LEAST_ELECTRON_MEV = 0.1, 0.04
"""Energies behind the shield below which particles are neglected."""
_POINTS = 1500
"""Points of the integral over energies."""


def shield_g_cm2(shield_mm: float) -> float:
    """Areal density of aluminium of a given thickness."""
    return shield_mm / matter.MM_PER_CM * matter.ALUMINIUM_G_CM3


def incident_proton_mev(behind_mev: FloatArray | float, shield_mm: float) -> FloatArray:
    """Energy in front of the shield of protons with given energies behind it."""
    return matter.proton_energy_mev(matter.proton_range_g_cm2(behind_mev) + shield_g_cm2(shield_mm))


def least_electron_mev(shield_mm: float) -> float:
    """Minimum energy of electrons that cross the shield."""
    return float(matter.electron_energy_mev(max(shield_g_cm2(shield_mm), 1e-4)))


def proton_dose_mev_g(
    spectrum: Spectrum, shield_mm: float, loss: Callable[[FloatArray], FloatArray] = matter.proton_stopping_silicon
) -> float:
    """Dose behind a shield, ∫ loss(E behind) φ(E) dE, MeV/g for a fluence (MeV/g/s for a flux) of protons.

    Parameters
    ----------
    spectrum : Spectrum
        Protons in front of the shield.
    shield_mm : float
        Thickness of aluminium.
    loss : callable
        Energy loss in the target, MeV cm²/g, by energy: the stopping power, or `matter.proton_niel_silicon`.
    """
    least = float(incident_proton_mev(_LEAST_PROTON_MEV, shield_mm))
    return _dose(spectrum, least, lambda energy: loss(_behind(energy, shield_mm)))


def electron_dose_mev_g(spectrum: Spectrum, shield_mm: float) -> float:
    """Ionising dose in silicon by electrons, MeV/g for a fluence; parameters as in `proton_dose_mev_g`."""
    thickness = shield_g_cm2(shield_mm)

    def loss(energy: FloatArray) -> FloatArray:
        # The residual range behind the shield gives the energy there, and the energy its loss in silicon.
        rest = np.maximum(matter.electron_range_g_cm2(energy) - thickness, 1e-9)
        return matter.electron_stopping(matter.electron_energy_mev(rest))

    least = float(matter.electron_energy_mev(matter.electron_range_g_cm2(_LEAST_ELECTRON_MEV) + thickness))
    return _dose(spectrum, least, loss)


def _behind(energy_mev: FloatArray, shield_mm: float) -> FloatArray:
    rest = matter.proton_range_g_cm2(energy_mev) - shield_g_cm2(shield_mm)
    return matter.proton_energy_mev(np.maximum(rest, 1e-9))


def _dose(spectrum: Spectrum, least_mev: float, loss: Callable[[FloatArray], FloatArray]) -> float:
    """Integral over the energies that cross the shield, with the finest steps at the lower end, where the particles
    almost stop and their energy loss varies most."""
    low, top = max(least_mev, float(spectrum.energy_mev[0])), float(spectrum.energy_mev[-1])
    if low >= top:
        return 0.0
    # Geometric steps of the energy above the limit; the first edge is then moved to the limit itself.
    edges = low * (1.0 + np.geomspace(1e-5, top / low - 1.0, _POINTS))
    edges[0] = low
    middle = np.sqrt(edges[1:] * edges[:-1])
    number = -np.diff(spectrum.integral(edges))  # particles between two energies
    return float(np.sum(number * loss(middle)))
