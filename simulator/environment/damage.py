"""Damage of detector and glass by a dose.

Displacement damage in the depleted silicon of a pixel generates dark current. Its mean is the universal damage factor
of Srour & Lo (2000) × dose × depleted volume; it comes from single interactions, whose number in a pixel has a Poisson
distribution and whose dark currents are exponentially distributed (Belloir et al. 2016), so that a few pixels become
hot. Part of the centres switch between two levels (random telegraph signal). In a CCD the defects also trap charge
during the transfer. Ionisation darkens glass by Beer's law with an absorption proportional to the dose; no
wavelength dependence is modelled, though blue light suffers most.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from simulator.constants import BOLTZMANN_J_K, ELEMENTARY_CHARGE_C
from simulator.detector.parameters import DisplacementDamage, RandomTelegraph
from simulator.environment.coefficients import Estimate, coefficient
from simulator.environment.dose import Dose
from simulator.environment.parameters import Environment

ZERO_CELSIUS_K = 273.15
_DAMAGE_FACTOR_K = 300.0
_TELEGRAPH_K = 295.15
_UM3_PER_CM3 = 1e12
_MEV_PER_TEV = 1e6


@dataclass(frozen=True)
class Pixel:
    """Properties of a detector on which its damage depends."""

    area_um2: float
    """Area of a pixel."""
    reference_c: float
    """Temperature to which dark currents refer."""
    transfers_charge: bool
    """Whether it is a CCD."""


@dataclass(frozen=True)
class Damage:
    """Ageing of a camera, added to the parameters of the new one."""

    detector_dose: Dose
    """Dose behind `Environment.shield_mm`."""
    glass_dose: Dose
    """Dose behind `Environment.glass_shield_mm`."""
    dark_current_e_s: float
    """Increase of every pixel's dark current by ionising dose."""
    displacement: DisplacementDamage
    """Dark current by displacement damage."""
    telegraph: RandomTelegraph
    """Random telegraph pixels by displacement damage."""
    cti_parallel: float
    """Increase of the parallel charge-transfer inefficiency."""
    cti_serial: float
    """Increase of the serial charge-transfer inefficiency."""
    transmission: float
    """Transmission of the darkened glass relative to that of the new one."""

    @property
    def mean_dark_e_s(self) -> float:
        """Mean increase of the dark current at the reference temperature, of all pixels and mechanisms."""
        # Random telegraph pixels contribute only while they are in the upper level.
        moving = self.telegraph.pixel_fraction * self.telegraph.dark_e_s * self.telegraph.high_share
        return self.dark_current_e_s + self.displacement.mean_e_s + moving


def arrhenius(temperature_k: float, reference_k: float, energy_ev: float) -> float:
    """Ratio of thermal generation at two temperatures, exp(−E/k (1/T − 1/T₀))."""
    per_k = ELEMENTARY_CHARGE_C / BOLTZMANN_J_K * energy_ev  # E/k in kelvin
    return math.exp(per_k * (1.0 / reference_k - 1.0 / temperature_k))


def displacement_dark_e_s(dose_mev_g: float, volume_um3: float, temperature_c: float, estimate: Estimate) -> float:
    """Mean dark current of a depleted volume after displacement damage, electrons/s."""
    factor = coefficient("dark_damage_factor", estimate) * coefficient("annealing", estimate)
    warmth = arrhenius(temperature_c + ZERO_CELSIUS_K, _DAMAGE_FACTOR_K, coefficient("dark_activation", estimate))
    return factor * warmth * dose_mev_g * volume_um3 / _UM3_PER_CM3


def glass_transmission(kind: str, dose_krad: float, path_mm: float, estimate: Estimate) -> float:
    """Transmission of irradiated glass relative to the new one; 1 for ``none``."""
    if kind == "none":
        return 1.0
    return math.exp(-coefficient(f"glass_{kind}", estimate) * dose_krad * path_mm / 10.0)


def damage(detector_dose: Dose, glass_dose: Dose, pixel: Pixel, environment: Environment) -> Damage:
    """Damage of a camera by the doses of its detector and its glass."""
    # Interactions and mean dark current are both proportional to dose and depleted volume; their ratio is the mean
    # current of one interaction. Only CCDs transfer charge.
    estimate, dose_mev_g = environment.estimate, detector_dose.displacement_mev_g
    volume_um3 = pixel.area_um2 * environment.depletion_um
    mean_e_s = displacement_dark_e_s(dose_mev_g, volume_um3, pixel.reference_c, estimate)
    interactions = dose_mev_g / _MEV_PER_TEV * volume_um3 / coefficient("dose_per_interaction", estimate)
    telegraph = _telegraph(dose_mev_g, volume_um3, pixel.reference_c, estimate)
    moving_e_s = telegraph.pixel_fraction * telegraph.dark_e_s * telegraph.high_share
    # The damage factor is the mean of all dark current, of which the random telegraph pixels are a part.
    steady_e_s = max(mean_e_s - moving_e_s, 0.0)
    parallel = coefficient("transfer_damage", estimate) * dose_mev_g / _MEV_PER_TEV if pixel.transfers_charge else 0.0
    return Damage(
        detector_dose=detector_dose,
        glass_dose=glass_dose,
        dark_current_e_s=environment.dark_per_krad_e_s * detector_dose.ionising_krad,
        displacement=DisplacementDamage(interactions, steady_e_s / interactions if interactions > 0 else 0.0),
        telegraph=telegraph,
        cti_parallel=parallel,
        cti_serial=coefficient("serial_transfer_share", estimate) * parallel,
        transmission=glass_transmission(
            environment.glass, glass_dose.ionising_krad, environment.glass_path_mm, estimate
        ),
    )


def _telegraph(dose_mev_g: float, volume_um3: float, reference_c: float, estimate: Estimate) -> RandomTelegraph:
    """Random telegraph pixels: those with at least one centre, whose number per pixel has a Poisson distribution."""
    centres = coefficient("telegraph_centres", estimate) * dose_mev_g * volume_um3 / _UM3_PER_CM3
    warmth = arrhenius(reference_c + ZERO_CELSIUS_K, _TELEGRAPH_K, coefficient("dark_activation", estimate))
    return RandomTelegraph(
        pixel_fraction=-math.expm1(-centres),
        dark_e_s=coefficient("telegraph_amplitude", estimate) * warmth,
        low_s=coefficient("telegraph_low_time", estimate),
        high_s=coefficient("telegraph_high_time", estimate),
    )
