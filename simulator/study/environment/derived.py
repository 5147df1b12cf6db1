"""Derived values of a detector that its environment has aged, as comments below a scenario."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.build import build_damage, build_detector
from simulator.scenario import Scenario

PERCENTILES = (50.0, 99.0, 99.9)
"""Of the dark current over the pixels: the last ones are those of hot pixels."""


def aged_lines(scenario: Scenario) -> list[str]:
    """Dark current of the scenario's device, new and aged, and its other damage.

    Raises
    ------
    InputError
        If the package of the trapped particles is not installed.
    """
    environment, detector = scenario.environment, scenario.detector
    aged, damage = build_detector(scenario), build_damage(scenario)
    new = build_detector(scenario.changed({"environment.age_years": 0.0}))
    shield = f"{environment.age_years:g} years behind {environment.shield_mm:g} mm of aluminium"
    dose, telegraph = damage.detector_dose, aged.pattern.telegraph
    moving, parameters = 0 if telegraph is None else len(telegraph.pixels), aged.parameters
    return [
        f"after {shield} ({environment.estimate} estimate), detector at {detector.temperature_c:g} °C:",
        f"dose: {dose.ionising_krad:.3g} krad ionising, {dose.displacement_mev_g:.3g} MeV/g displacement",
        f"dark current, electrons/s a pixel: {_dark_text(aged.pattern.dark_e_s)}",
        f"of the new detector: {_dark_text(new.pattern.dark_e_s)}",
        f"random telegraph pixels: {moving} of {detector.width * detector.height}",
        f"charge lost a transfer: {parameters.cti_parallel:.2g} parallel, {parameters.cti_serial:.2g} serial",
        f"transmission of the glass: {damage.transmission:.3f} of the new",
    ]


def _dark_text(dark_e_s: NDArray[Any] | float) -> str:
    levels = np.percentile(dark_e_s, PERCENTILES)
    parts = [f"{level:.3g} at {percent:g} %" for percent, level in zip(PERCENTILES, levels, strict=True)]
    return f"mean {np.mean(dark_e_s):.3g}, percentiles {', '.join(parts)}"
