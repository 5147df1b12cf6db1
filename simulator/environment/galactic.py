"""Galactic cosmic rays near the Earth: protons and helium in the force-field approximation, with the cut-off of a
dipole.

The local interstellar spectrum and its modulation follow Usoskin et al. 2005 (JGR 110, A12108,
after Burger et al. 2000); helium is 5 % of the particles at the same energy per nucleon. A particle reaches a position
if its rigidity exceeds Störmer's vertical cut-off of the tilted centred dipole, R_c = 14.9 GV cos⁴λ / (r/R)² (Smart &
Shea 2005, Adv. Space Res. 36, 2012). The Earth hides the directions below its horizon. Neglected: the penumbra, the
dependence of the cut-off on direction, albedo particles, and nuclei heavier than helium (1 % of the number).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from simulator.constants import EARTH_RADIUS_KM
from simulator.environment.coefficients import Estimate, coefficient
from startracker.core import FloatArray

PROTON_GEV = 0.938272
NUCLEON_GEV = 0.9315
MODULATION_MV = {"min": 400.0, "max": 1000.0}
"""Modulation potential of Usoskin et al. for a typical solar minimum and maximum; 300 to 1200 MV in single months."""
CUTOFF_GV = 14.9
DIPOLE_AXIS = np.array(
    [
        math.cos(math.radians(80.65)) * math.cos(math.radians(-72.68)),
        math.cos(math.radians(80.65)) * math.sin(math.radians(-72.68)),
        math.sin(math.radians(80.65)),
    ]
)
"""Geomagnetic north pole in the Earth-fixed frame (latitude 80.65°, longitude −72.68°), IGRF-13, 2020."""


class Nucleus(NamedTuple):
    """Kind of cosmic ray."""

    mass_number: int
    """Number of nucleons."""
    charge: int
    """Charge in elementary charges."""
    share: float
    """Number relative to protons at the same energy per nucleon outside the heliosphere."""


PROTON, HELIUM = Nucleus(1, 1, 1.0), Nucleus(4, 2, 0.05)

_GRID_GEV = np.geomspace(0.01, 1000.0, 1201)


def intensity(kind: Nucleus, energy_gev: ArrayLike, modulation_mv: float) -> FloatArray:
    """Particles/(m² s sr) per GeV per nucleon at the Earth's orbit, outside the magnetosphere.

    Parameters
    ----------
    kind : Nucleus
        `PROTON` or `HELIUM`.
    energy_gev : array
        Kinetic energy per nucleon, above 0.1 GeV (the approximation loses its meaning below).
    modulation_mv : float
        Modulation potential φ.
    """
    energy = np.asarray(energy_gev, dtype=float)
    # In the force-field approximation a particle has lost the energy φ Z/A per nucleon on its way to the Earth.
    outside = energy + modulation_mv * 1e-3 * kind.charge / kind.mass_number
    rest = 2.0 * PROTON_GEV
    momentum = np.sqrt(outside * (outside + rest))
    interstellar = 1.9e4 * momentum**-2.78 / (1.0 + 0.4866 * momentum**-2.51)
    return np.asarray(kind.share * interstellar * energy * (energy + rest) / (outside * (outside + rest)))


def cutoff_gv(itrs_km: FloatArray) -> FloatArray:
    """Vertical cut-off rigidity at positions (N, 3) in the Earth's frame, GV, (N,)."""
    radius = np.linalg.norm(itrs_km, axis=-1)
    sin_latitude = (itrs_km @ DIPOLE_AXIS) / radius
    cutoff: FloatArray = CUTOFF_GV * (1.0 - sin_latitude**2) ** 2 * (EARTH_RADIUS_KM / radius) ** 2
    return cutoff


def visible_share(radius_km: ArrayLike) -> FloatArray:
    """Fraction of all directions that the Earth does not hide, at a distance from its centre."""
    ratio = EARTH_RADIUS_KM / np.asarray(radius_km, dtype=float)
    return 0.5 * (1.0 + np.sqrt(1.0 - ratio**2))


class GalacticCosmicRays:
    """Flux of galactic cosmic rays at positions, prepared for one solar activity."""

    def __init__(self, solar: str, estimate: Estimate = "nominal") -> None:
        modulation_mv = MODULATION_MV[solar]
        factor = coefficient("galactic_flux", estimate) * coefficient("galactic_secondaries", estimate)
        factor *= 4.0 * math.pi * 1e-4  # all directions; m² to cm²
        self._above: list[tuple[FloatArray, FloatArray]] = []
        for kind in (PROTON, HELIUM):
            density = factor * intensity(kind, _GRID_GEV, modulation_mv)
            steps = 0.5 * (density[1:] + density[:-1]) * np.diff(_GRID_GEV)
            # The flux above each energy is accumulated from the top, where it is small, to keep its digits.
            above = np.append(np.cumsum(steps[::-1])[::-1], 0.0)
            # Rigidity is momentum per charge; the grid is in energy per nucleon.
            rest = PROTON_GEV if kind is PROTON else NUCLEON_GEV
            momentum = np.sqrt(_GRID_GEV * (_GRID_GEV + 2.0 * rest)) * kind.mass_number / kind.charge
            self._above.append((momentum, above))

    def flux_cm2_s(self, itrs_km: FloatArray, least_gv: float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Omnidirectional flux of protons and of helium, particles/cm²/s, (N,) each.

        Parameters
        ----------
        itrs_km : (N, 3) array
            Positions in the rotating frame of the Earth.
        least_gv : float
            Rigidity that is needed to cross the shield.
        """
        seen = visible_share(np.linalg.norm(itrs_km, axis=-1))
        rigidity = np.maximum(cutoff_gv(itrs_km), least_gv)
        protons, helium = (seen * np.interp(rigidity, *table) for table in self._above)
        return protons, helium

    def transmission(self, itrs_km: FloatArray, rigidity_gv: ArrayLike) -> FloatArray:
        """Fraction of positions and directions that particles of rigidities (R,) reach from outside, (R,)."""
        seen = visible_share(np.linalg.norm(itrs_km, axis=-1))
        open_ = cutoff_gv(itrs_km) < np.asarray(rigidity_gv, dtype=float)[..., None]
        return np.asarray(np.mean(open_ * seen, axis=-1))


def proton_rigidity_gv(energy_mev: ArrayLike) -> FloatArray:
    """Rigidity of protons of a kinetic energy, GV."""
    energy = np.asarray(energy_mev, dtype=float) * 1e-3
    return np.sqrt(energy * (energy + 2.0 * PROTON_GEV))
