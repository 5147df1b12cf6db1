"""Radiation averaged over an orbit, and its dose behind a shield."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simulator.constants import SECONDS_PER_YEAR
from simulator.environment import matter, shield, solar
from simulator.environment.coefficients import coefficient
from simulator.environment.galactic import GalacticCosmicRays, proton_rigidity_gv
from simulator.environment.parameters import Environment
from simulator.environment.spectrum import Spectrum
from simulator.environment.trapped import ELECTRON_MEV, PROTON_MEV, TrappedBelts
from simulator.mission.frames import itrs_km
from simulator.mission.trajectory import Trajectory, geocentric
from startracker.core import FloatArray

SAMPLES, SAMPLED_DAYS = 6000, 30.03
"""Positions of the mean, every 7 minutes over a month, so that every longitude is crossed at every latitude. Three
times as many change the dose by less than 1 %."""


@dataclass(frozen=True, eq=False)
class OrbitRadiation:
    """Mean radiation along an orbit, outside the spacecraft."""

    protons: Spectrum
    """Trapped protons: flux averaged over the orbit, particles/cm²/s."""
    electrons: Spectrum
    """Trapped electrons: flux averaged over the orbit, particles/cm²/s."""
    solar_share: FloatArray
    """Fraction of time and directions in which solar protons arrive, at the energies of `solar.EVENT_MEV`."""


@dataclass(frozen=True)
class Dose:
    """Dose in silicon."""

    protons_krad: float
    """Ionising dose by trapped protons."""
    electrons_krad: float
    """Ionising dose by trapped electrons."""
    solar_krad: float
    """Ionising dose by solar protons."""
    displacement_mev_g: float
    """Displacement damage dose by trapped and solar protons."""

    @property
    def ionising_krad(self) -> float:
        """Total ionising dose."""
        return self.protons_krad + self.electrons_krad + self.solar_krad


def orbit_positions(orbit: Trajectory, samples: int = SAMPLES) -> tuple[FloatArray, FloatArray]:
    """Times (N,), seconds after the epoch, and positions (N, 3), km, in the Earth-fixed frame.

    The times are distributed over `SAMPLED_DAYS` days, or over the part of them that a trajectory from a file covers.
    """
    first_s, last_s = max(orbit.span_s[0], 0.0), min(orbit.span_s[1], SAMPLED_DAYS * 86_400.0)
    t_s = np.linspace(first_s, last_s, samples, endpoint=False, dtype=np.float64)
    return t_s, itrs_km(orbit.clock, t_s, geocentric(orbit, t_s).r_km)


def orbit_radiation(orbit: Trajectory, environment: Environment, samples: int = SAMPLES) -> OrbitRadiation:
    """Mean radiation along an orbit, by the nominal models.

    Raises
    ------
    InputError
        If the package of the trapped particles is not installed.
    """
    t_s, positions = orbit_positions(orbit, samples)
    year = float(orbit.clock.jyear(float(t_s[-1]) / 2))  # the field drifts too slowly to matter within a month
    protons = Spectrum(PROTON_MEV, np.zeros(len(PROTON_MEV)))
    electrons = Spectrum(ELECTRON_MEV, np.zeros(len(ELECTRON_MEV)))
    if environment.trapped != "none":
        belts = TrappedBelts(environment.solar)
        protons, electrons = belts.mean_spectra(positions, year)
    # Solar protons come from outside, so the geomagnetic cut-off decides which of them reach the orbit.
    rigidity_gv = proton_rigidity_gv(solar.EVENT_MEV)
    return OrbitRadiation(
        protons, electrons, GalacticCosmicRays(environment.solar).transmission(positions, rigidity_gv)
    )


def dose(radiation: OrbitRadiation, environment: Environment, shield_mm: float, years: float) -> Dose:
    """Dose behind a shield in a number of years. The number of solar events is that of the whole age and is not
    multiplied by the years."""
    seconds = years * SECONDS_PER_YEAR
    krad = matter.RAD_PER_MEV_G * 1e-3
    protons = radiation.protons.times(seconds * coefficient("trapped_protons", environment.estimate))
    electrons = radiation.electrons.times(seconds * coefficient("trapped_electrons", environment.estimate))
    events = solar.reaching(solar.event_fluence(environment.solar_proton_events), radiation.solar_share)
    niel = coefficient("niel_scale", environment.estimate)
    return Dose(
        protons_krad=krad * shield.proton_dose_mev_g(protons, shield_mm),
        electrons_krad=krad * shield.electron_dose_mev_g(electrons, shield_mm),
        solar_krad=krad * shield.proton_dose_mev_g(events, shield_mm),
        # Trapped electrons are neglected here: their non-ionising energy loss is far below that of protons.
        displacement_mev_g=niel
        * sum(
            shield.proton_dose_mev_g(spectrum, shield_mm, matter.proton_niel_silicon) for spectrum in (protons, events)
        ),
    )
