"""Dependence of error and availability on conditions: temperature, false stars, radiation, defective pixels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from simulator.scenario import Scenario
from simulator.scenario.fields import flatten
from simulator.study.axes import CAMERA_AXES
from simulator.study.datasheet.sheet import (
    LEVELS,
    Amounts,
    Estimate,
    Quantity,
    cross_square_deg2,
    mean_of,
    proportion,
    rms_of,
    upper_limit,
)
from simulator.study.datasheet.tasks import TRIALS_PER_TASK, Task, TaskRunner
from simulator.study.datasheet.words import TERMS
from startracker.core import ARCSEC_PER_DEG, Columns

TEMPERATURE_STEPS_K = (-20.0, 0.0, 20.0, 40.0)
"""Temperatures of the detector relative to the scenario's."""

THERMAL_STEP_K = 10.0
"""Change of the temperature of the lens for the thermo-elastic error."""

FALSE_STARS = (0, 5, 20, 50)
PARTICLES_CM2_S = (0.0, 10.0, 100.0, 1000.0)
HOT_FRACTIONS = (0.0, 1e-3, 1e-2, 5e-2)
"""Values at which robustness is stated, in addition to the scenario's own. The largest fluxes of trapped protons in a
low orbit are some 1,100 cm⁻² s⁻¹ (arXiv:2006.00909)."""

DEFAULT_HOT_E_S = 5000.0
"""Mean dark current of the added hot pixels of a scenario without any."""

THERMAL_KEYS = ("optics.thermal.expansion_ppm_k", "optics.thermal.decentring_um_k")
"""Keys that make the image depend on the temperature of the lens."""


class Series(NamedTuple):
    """Errors and availability against one condition."""

    name: str
    title: str
    unit: str
    points: list[dict[str, Any]]
    """``value`` of the condition; ``available``, ``cross_rms_arcsec`` and ``about_rms_arcsec``, each with interval."""


def temperature(scenario: Scenario, runner: TaskRunner, amounts: Amounts) -> Series:
    """Error against the temperature of the detector."""
    values = [scenario.detector.temperature_c + step for step in TEMPERATURE_STEPS_K]
    cases = [scenario.changed({"detector.temperature_c": value}) for value in values]
    return _series(runner, "temperature", "Detector at", "°C", values, cases, amounts)


def robustness(scenario: Scenario, runner: TaskRunner, amounts: Amounts) -> list[Series]:
    """Error and availability against false stars, particles and hot pixels."""
    found = runner.run([Task(scenario, "with_false_stars", (0, amounts.per_point, n)) for n in FALSE_STARS])
    points = [_point(float(n), columns, scenario.seed) for n, columns in zip(FALSE_STARS, found, strict=True)]
    background = scenario.detector.cosmic_rays.rate_cm2_s
    fluxes = [background + more for more in PARTICLES_CM2_S]
    hot = [min(scenario.detector.hot_pixel_fraction + more, 1.0) for more in HOT_FRACTIONS]
    fluxed = [scenario.changed({"detector.cosmic_rays.rate_cm2_s": flux}) for flux in fluxes]
    dark_e_s = scenario.detector.hot_pixel_dark_e_s or DEFAULT_HOT_E_S
    spoilt = [
        scenario.changed({"detector.hot_pixel_fraction": share, "detector.hot_pixel_dark_e_s": dark_e_s})
        for share in hot
    ]
    return [
        Series("false_stars", "False stars:", "", points),
        _series(runner, "particles", "Charged particles", "cm⁻² s⁻¹", fluxes, fluxed, amounts),
        _series(runner, "hot_pixels", "Fraction of hot pixels", "", hot, spoilt, amounts),
    ]


def residuals(scenario: Scenario, runner: TaskRunner, amounts: Amounts) -> list[Quantity]:
    """Residual of the aberration and thermo-elastic error, by axis."""
    count = amounts.per_point
    no_deflection = scenario.changed({"sky.light_deflection": False})  # which the tracker does not correct
    errors = runner.run([Task(no_deflection, "model_residuals", (0, count))])[0]["error_deg"] * ARCSEC_PER_DEG
    term = TERMS["aberration"]
    method = f"{term.method}; {count} fields, position and velocity of the spacecraft known exactly"
    quantities = []
    for k, axis in enumerate(CAMERA_AXES):
        named = partial(Quantity, unit="arcsec", axis=axis, interpretation=term.interpretation, method=method)
        rms = rms_of(errors[:, k], scenario.seed)
        quantities.append(named("aberration_residual_rms", f"{term.title}, rms", rms))
        quantities += [
            named("aberration_residual", term.title, upper_limit(errors[:, k], level), level=level) for level in LEVELS
        ]
    # at least a whole task, whose trials at the scenario's own temperature are those of the measurement error
    pairs = min(max(count, TRIALS_PER_TASK), amounts.trials)
    return quantities + _thermo_elastic(scenario, runner, pairs) + _mounting(scenario)


def _mounting(scenario: Scenario) -> list[Quantity]:
    """Thermo-elastic motion of the mounting around the orbit, by the scenario's amplitudes; none without it."""
    given, term = scenario.pointing.thermo_elastic, TERMS["thermo_elastic"]
    if not any(given.amplitude_arcsec):
        return []
    method = (
        "amplitudes of the scenario (pointing.thermo_elastic), divided by √2; an error of the body's attitude alone"
    )
    sizes = [abs(amplitude) / math.sqrt(2.0) for amplitude in given.amplitude_arcsec]
    return [
        Quantity(
            "thermo_elastic_mounting_rms",
            f"{term.title} of the mounting, rms",
            Estimate(size, size, size),
            unit="arcsec",
            axis=axis,
            interpretation=term.interpretation,
            method=method,
        )
        for size, axis in zip(sizes, CAMERA_AXES, strict=True)
    ]


def _thermo_elastic(scenario: Scenario, runner: TaskRunner, count: int) -> list[Quantity]:
    """Mean difference of the errors of the same trials with a lens warmer by `THERMAL_STEP_K`."""
    term, flat = TERMS["thermo_elastic"], flatten(scenario)
    words: dict[str, Any] = {"unit": "arcsec", "interpretation": term.interpretation}
    title = f"{term.title} of {THERMAL_STEP_K:g} K"
    if not any(np.any(flat[key]) for key in THERMAL_KEYS):
        method = "none: the scenario's lens does not change with temperature (optics.thermal)"
        return [
            Quantity("thermo_elastic_mean", title, Estimate(0.0, 0.0, 0.0), axis=axis, method=method, **words)
            for axis in CAMERA_AXES
        ]
    warmer = scenario.changed({"optics.thermal.temperature_c": scenario.optics.thermal.temperature_c + THERMAL_STEP_K})
    before, after = runner.trials(scenario, count), runner.trials(warmer, count)
    # by the stars: the tracker's covariance does not contain this change
    both = np.logical_and.reduce([found["solved"] & (found["stars_misidentified"] == 0) for found in (before, after)])
    quantities = []
    for axis in CAMERA_AXES:
        change = (after[f"error_{axis}_deg"] - before[f"error_{axis}_deg"])[both] * ARCSEC_PER_DEG
        method = f"{term.method}; {len(change)} pairs of trials"
        size = mean_of(change, scenario.seed)
        quantities.append(Quantity("thermo_elastic_mean", title, size, axis=axis, method=method, **words))
    return quantities


def _series(
    runner: TaskRunner,
    name: str,
    title: str,
    unit: str,
    values: Sequence[float],
    cases: Sequence[Scenario],
    amounts: Amounts,
) -> Series:
    """Trials of each case."""
    found = runner.run([Task(case, "trials", (0, amounts.per_point)) for case in cases])
    points = [_point(value, columns, case.seed) for value, columns, case in zip(values, found, cases, strict=True)]
    return Series(name, title, unit, points)


def _point(value: float, columns: Columns, seed: int) -> dict[str, Any]:
    """Availability, and rms of the correct attitudes, at one value of the condition."""
    right = columns["right"]
    across = np.sqrt(cross_square_deg2(columns))[right]
    return {
        "value": float(value),
        "available": list(proportion(right)),
        "cross_rms_arcsec": list(rms_of(across * ARCSEC_PER_DEG, seed)),
        "about_rms_arcsec": list(rms_of(columns["error_about_boresight_deg"][right] * ARCSEC_PER_DEG, seed)),
        "method": f"{int(np.sum(right))} correct of {len(right)} trials",
    }
