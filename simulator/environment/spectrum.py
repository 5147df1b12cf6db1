"""Integral spectrum of particles: their number above each energy."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from startracker.core import FloatArray

_TINY = 1e-30  # relative to the first number; stands for 0 where a logarithm is needed


class Spectrum(NamedTuple):
    """Omnidirectional flux, particles/cm²/s, or fluence, particles/cm², above each of E ascending energies."""

    energy_mev: FloatArray
    """(E,): Ascending."""
    above: FloatArray
    """(E,): Particles above each energy, falling with energy; there are none above the last energy."""

    def integral(self, energy_mev: ArrayLike) -> FloatArray:
        """Particles above energies: a power law between the points, zero above the last, constant below the first."""
        energy = np.asarray(energy_mev, dtype=float)
        least = max(float(self.above[0]) * _TINY, np.finfo(float).tiny)
        log = np.interp(np.log(energy), np.log(self.energy_mev), np.log(np.maximum(self.above, least)))
        number = np.where(energy > self.energy_mev[-1], 0.0, np.exp(log))
        return np.where(number <= 2.0 * least, 0.0, number)  # the stand-in for 0 becomes 0 again

    def times(self, factor: float) -> Spectrum:
        """The same spectrum with all numbers multiplied."""
        return Spectrum(self.energy_mev, self.above * factor)
