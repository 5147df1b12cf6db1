"""Radiation of a scenario's orbit: particles through the detector, dose by shield, and damage with age."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from simulator.build import build_damage, build_orbit, orbit_radiation_of
from simulator.environment.coefficients import COEFFICIENTS, Estimate
from simulator.environment.damage import Damage
from simulator.environment.dose import SAMPLED_DAYS, Dose, dose, orbit_positions
from simulator.environment.parameters import Environment
from simulator.environment.transients import LocalFlux, Transients
from simulator.mission.frames import ground_track_deg
from simulator.mission.trajectory import Trajectory, geocentric
from simulator.scenario import Scenario
from startracker._version import __version__
from startracker.core import FloatArray
from startracker.display import fields_repr
from startracker.errors import InputError

ESTIMATES: tuple[Estimate, ...] = ("low", "nominal", "high")
SHIELDS_MM = (1.0, 2.0, 3.0, 4.0, 5.0, 7.0, 10.0, 15.0, 20.0)
"""Thinner shields let pass solar protons below the spectrum of the events."""
DEFAULT_AGE_YEARS = 5.0
"""Age of the tables if the scenario's camera is new."""
ANOMALY_CM2_S = 10.0
"""Trapped protons through the detector above which the spacecraft is counted as in the South Atlantic Anomaly."""
_DAY_S, _STEP_S = 86_400.0, 30.0
_AGES = 11


class Track(NamedTuple):
    """Particles at instants of the orbit."""

    t_s: FloatArray
    latitude_deg: FloatArray
    longitude_deg: FloatArray
    """(N,): Seconds after the epoch; ground track."""
    flux: LocalFlux
    """Particles through the detector's surface, /cm²/s."""


@dataclass(frozen=True, eq=False)
class EnvironmentSurvey:
    """Radiation environment of a scenario."""

    name: str
    """Name of the scenario."""
    environment: Environment
    """Its parameters, with the age of the tables."""
    day: Track
    """The first day, every 30 seconds."""
    month: Track
    """A month, at the instants of the mean."""
    frame_cm2_s: float
    """Area of the detector times the exposure time: a flux times this is the mean number of particles in a frame."""
    shields: dict[float, Dose]
    """Dose at the end of the age by thickness of aluminium, mm."""
    ages: FloatArray
    """(A,): Years of the ageing curves."""
    ageing: dict[Estimate, list[Damage]]
    """Damage at these ages for each estimate of the coefficients."""

    __repr__ = fields_repr

    def at_age(self, estimate: Estimate = "nominal") -> Damage:
        """Damage at the end of the age."""
        return self.ageing[estimate][-1]

    def anomaly(self) -> dict[str, float]:
        """Passes through the South Atlantic Anomaly in the first day, and the time spent in it."""
        inside = self.day.flux.trapped_protons.sum(axis=1) > ANOMALY_CM2_S
        entries = int(np.count_nonzero(inside[1:] & ~inside[:-1])) + int(inside[0])
        return {"passes": entries, "share_of_time": float(np.mean(inside))}

    def summary(self) -> dict[str, Any]:
        """What ``environment.json`` holds."""
        flux = self.month.flux
        kinds = {
            "galactic": flux.galactic_protons + flux.galactic_helium,
            "trapped_protons": flux.trapped_protons.sum(axis=1),
            "trapped_electrons": flux.trapped_electrons,
            "total": flux.total,
        }
        return {
            "name": self.name,
            "version": __version__,
            "environment": asdict(self.environment),
            "positions": len(flux.total),
            "days": SAMPLED_DAYS,
            "flux_cm2_s": {
                kind: {"mean": float(v.mean()), "median": float(np.median(v)), "max": float(v.max())}
                for kind, v in kinds.items()
            },
            "particles_per_frame": {
                kind: {"median": float(np.median(v)) * self.frame_cm2_s, "max": float(v.max()) * self.frame_cm2_s}
                for kind, v in kinds.items()
            },
            "anomaly_first_day": self.anomaly() | {"above_cm2_s": ANOMALY_CM2_S},
            "dose_by_shield_mm": {
                f"{mm:g}": asdict(value) | {"ionising_krad": value.ionising_krad} for mm, value in self.shields.items()
            },
            "ageing": {
                estimate: [{"years": float(age), **_damage_values(d)} for age, d in zip(self.ages, rows, strict=True)]
                for estimate, rows in self.ageing.items()
            },
            "coefficients": [asdict(coefficient) for coefficient in COEFFICIENTS.values()],
        }

    def to_table(self) -> pa.Table:
        """The first day, a row per instant: ``environment.parquet``."""
        day, flux = self.day, self.day.flux
        return pa.table(
            {
                "t_s": day.t_s,
                "latitude_deg": day.latitude_deg,
                "longitude_deg": day.longitude_deg,
                "galactic_cm2_s": flux.galactic_protons + flux.galactic_helium,
                "trapped_protons_cm2_s": flux.trapped_protons.sum(axis=1),
                "trapped_electrons_cm2_s": flux.trapped_electrons,
            }
        )


def survey(scenario: Scenario) -> EnvironmentSurvey:
    """Radiation environment of a scenario.

    Raises
    ------
    InputError
        If the scenario's environment has no particles, or their package is not installed.
    """
    asked = scenario.environment
    if asked.trapped == "none" and not asked.galactic:
        raise InputError(
            f"{scenario.name}: environment.trapped is none and environment.galactic is false; "
            "add --set environment.trapped=ap8 --set environment.galactic=true"
        )
    environment = replace(asked, transients=True, age_years=asked.age_years or DEFAULT_AGE_YEARS)
    orbit, detector = build_orbit(scenario), scenario.detector
    transients = Transients(environment, orbit.clock)
    radiation = orbit_radiation_of(scenario, environment)
    ages = np.linspace(0.0, environment.age_years, _AGES)
    pitch_x, pitch_y = detector.pitch_um
    return EnvironmentSurvey(
        name=scenario.name,
        environment=environment,
        day=_track(transients, orbit, np.arange(max(orbit.span_s[0], 0.0), min(orbit.span_s[1], _DAY_S), _STEP_S)),
        month=_track(transients, orbit, orbit_positions(orbit)[0]),
        frame_cm2_s=detector.width * pitch_x * detector.height * pitch_y * 1e-8 * detector.exposure_s,
        shields={mm: dose(radiation, environment, mm, environment.age_years) for mm in SHIELDS_MM},
        ages=ages,
        ageing={estimate: _ageing(scenario, replace(environment, estimate=estimate), ages) for estimate in ESTIMATES},
    )


def _track(transients: Transients, orbit: Trajectory, t_s: FloatArray) -> Track:
    r_km = geocentric(orbit, t_s).r_km
    return Track(t_s, *ground_track_deg(orbit.clock, t_s, r_km), transients.flux(t_s, r_km))


def _ageing(scenario: Scenario, environment: Environment, ages: FloatArray) -> list[Damage]:
    """Damage at each age; the solar events of the scenario are spread evenly over it."""
    events = environment.solar_proton_events / environment.age_years
    rows = (replace(environment, age_years=float(age), solar_proton_events=events * float(age)) for age in ages)
    return [build_damage(scenario, row) for row in rows]


def _damage_values(aged: Damage) -> dict[str, float]:
    return {
        "ionising_krad": aged.detector_dose.ionising_krad,
        "displacement_mev_g": aged.detector_dose.displacement_mev_g,
        "mean_dark_e_s": aged.mean_dark_e_s,
        "interactions_per_pixel": aged.displacement.interactions_per_pixel,
        "dark_per_interaction_e_s": aged.displacement.dark_e_s,
        "telegraph_fraction": aged.telegraph.pixel_fraction,
        "telegraph_dark_e_s": aged.telegraph.dark_e_s,
        "cti_parallel": aged.cti_parallel,
        "glass_krad": aged.glass_dose.ionising_krad,
        "transmission": aged.transmission,
    }
