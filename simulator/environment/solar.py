"""Protons of anomalously large solar proton events (King 1974, J. Spacecraft Rockets 11, 401).

The fluence of one event above an energy E is 7.9 × 10⁹ exp((30 − E) / 26.5) protons/cm², E in MeV, which is that of the
event of August 1972. King's model predicts zero to a few such events in a solar cycle; their number is a parameter of
the scenario.
"""

from __future__ import annotations

import numpy as np

from simulator.environment.spectrum import Spectrum
from startracker.core import FloatArray

EVENT_MEV = np.array([10, 15, 20, 25, 30, 40, 50, 60, 70, 80, 90, 100, 125, 150, 200.0])
"""Energies of the spectrum: 10 to 200 MeV, beyond which the exponential is not supported."""


def event_fluence(events: float) -> Spectrum:
    """Fluence of a number of events outside the magnetosphere, protons/cm² above each energy."""
    return Spectrum(EVENT_MEV, events * 7.9e9 * np.exp((30.0 - EVENT_MEV) / 26.5))


def reaching(fluence: Spectrum, transmission: FloatArray) -> Spectrum:
    """Fluence of solar protons that reaches an orbit.

    Parameters
    ----------
    fluence : Spectrum
        Outside the magnetosphere.
    transmission : (E,) array
        Fraction of time and directions in which protons of each energy arrive.

    Notes
    -----
    Protons between two energies arrive with the mean of the fractions at both.
    """
    # Particles in each interval of energy are attenuated, and their sum from above is the new integral spectrum.
    between = -np.diff(fluence.above) * 0.5 * (transmission[1:] + transmission[:-1])
    last = fluence.above[-1] * transmission[-1]
    return Spectrum(fluence.energy_mev, np.append(np.cumsum(between[::-1])[::-1] + last, last))
