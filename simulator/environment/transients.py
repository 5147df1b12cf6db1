"""Particles that cross the detector at a position: the local flux behind the shield, in groups of similar ionisation.

An isotropic omnidirectional flux F crosses a plane, from both sides, at the rate F/2 per area. Trapped protons are
grouped by their energy behind the shield; the mean charge per micrometre of a group follows from its stopping power.
`CosmicRays.charge_e_um` is the most probable charge, whose ratio to the mean is taken from minimum-ionising particles,
80 to 80 + 26.2 e⁻/µm (`simulator.detector.cosmic_rays`). Protons that would stop in the silicon are treated as if they
crossed it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from simulator.detector.cosmic_rays import PAIR_ENERGY_EV
from simulator.detector.parameters import CosmicRays
from simulator.environment import matter, shield
from simulator.environment.galactic import GalacticCosmicRays, proton_rigidity_gv
from simulator.environment.parameters import Environment
from simulator.environment.trapped import ELECTRON_MEV, TrappedBelts
from simulator.mission.clock import Clock
from simulator.mission.frames import itrs_km
from startracker.core import FloatArray

BEHIND_MEV = np.array([0.5, 5.0, 15.0, 40.0, 100.0, 400.0])
"""Limits of the groups of trapped protons, by energy behind the shield."""
MIP_E_UM, HELIUM_CHARGE_RATIO = 80.0, 4.0
"""Most probable charge of a fast singly charged particle, and that of helium relative to it, z²."""
_MEAN_OVER_MOST_PROBABLE = 1.0 + 26.2 / MIP_E_UM
PLANE_SHARE = 0.5
"""Rate of crossings per area relative to the omnidirectional flux."""


class LocalFlux(NamedTuple):
    """Rates through a detector's surface at N positions, particles/cm²/s of area."""

    galactic_protons: FloatArray
    """(N,): Protons of galactic cosmic rays."""
    galactic_helium: FloatArray
    """(N,): Helium nuclei of galactic cosmic rays."""
    trapped_protons: FloatArray
    """(N, groups): By energy behind the shield."""
    trapped_electrons: FloatArray
    """(N,): Electrons that cross the shield."""

    @property
    def total(self) -> FloatArray:
        """(N,): All particles."""
        trapped: FloatArray = self.trapped_protons.sum(axis=1) + self.trapped_electrons
        return self.galactic_protons + self.galactic_helium + trapped


def proton_charge_e_um(energy_mev: FloatArray) -> FloatArray:
    """Most probable charge per micrometre of silicon of protons, electrons/µm."""
    # MeV cm²/g × g/cm³ = MeV/cm; 1e6 eV per MeV, 1e-4 cm per µm.
    loss_ev_um = matter.proton_stopping_silicon(energy_mev) * matter.SILICON_G_CM3 * 1e6 * 1e-4
    return np.asarray(loss_ev_um / PAIR_ENERGY_EV / _MEAN_OVER_MOST_PROBABLE)


class Transients:
    """Particles at the positions of a spacecraft, with prepared models.

    Raises
    ------
    InputError
        If the package of the trapped particles is not installed.
    """

    def __init__(self, environment: Environment, clock: Clock) -> None:
        self._clock = clock
        estimate = environment.estimate
        self._belts = TrappedBelts(environment.solar, estimate) if environment.trapped != "none" else None
        self._galactic = GalacticCosmicRays(environment.solar, estimate) if environment.galactic else None
        # Energies before the shield, limited to the range of the map, which ends at 400 MeV.
        self._proton_mev = np.minimum(shield.incident_proton_mev(BEHIND_MEV, environment.shield_mm), 400.0)
        least = shield.least_electron_mev(environment.shield_mm)
        self._electron_mev = np.array([max(least, ELECTRON_MEV[0])]) if least < ELECTRON_MEV[-1] else np.empty(0)
        self._least_gv = float(proton_rigidity_gv(self._proton_mev[0]))
        self._charges = proton_charge_e_um(np.sqrt(BEHIND_MEV[1:] * BEHIND_MEV[:-1]))

    def flux(self, t_s: FloatArray, r_km: FloatArray) -> LocalFlux:
        """Rates at N positions, from times (N,), seconds after the epoch, and GCRS positions (N, 3), km."""
        positions = itrs_km(self._clock, t_s, r_km)
        protons = helium = electrons = np.zeros(len(t_s))  # never modified in place, so one array serves all three
        trapped = np.zeros((len(t_s), len(BEHIND_MEV) - 1))
        if self._galactic is not None:
            protons, helium = self._galactic.flux_cm2_s(positions, self._least_gv)
        if self._belts is not None:
            year = float(self._clock.jyear(float(np.mean(t_s))))
            above, crossing = self._belts.fluxes(positions, year, self._proton_mev, self._electron_mev)
            trapped = np.maximum(-np.diff(above, axis=1), 0.0)
            electrons = crossing.sum(axis=1)  # the sum over one energy, or over none behind a thick shield
        return LocalFlux(*(PLANE_SHARE * rate for rate in (protons, helium, trapped, electrons)))

    def particles(self, t_s: float, r_km: FloatArray, depth_um: float) -> tuple[CosmicRays, ...]:
        """Groups of particles at one position, for a collection depth of the detector; empty groups are omitted."""
        here = self.flux(np.array([t_s]), np.asarray(r_km)[None])
        # Fast electrons and cosmic-ray protons ionise alike, and form one group.
        groups = [
            (here.galactic_protons[0] + here.trapped_electrons[0], MIP_E_UM),
            (here.galactic_helium[0], MIP_E_UM * HELIUM_CHARGE_RATIO),
            *zip(here.trapped_protons[0], self._charges, strict=True),
        ]
        return tuple(CosmicRays(float(rate), depth_um, float(charge)) for rate, charge in groups if rate > 0)
