"""Update rate and latency. What the scenario fixes is part of the datasheet; computing times, which depend on the
machine and vary from run to run, are kept apart."""

from __future__ import annotations

import platform
from typing import Any

import numpy as np

from simulator.scenario import Scenario
from simulator.study.datasheet.sheet import Estimate, Quantity
from simulator.study.trials.trial import TrialRunner

TIMED_TRIALS = 20
"""Trials whose computing time is measured, after one for warming up."""


def timing(scenario: Scenario) -> list[Quantity]:
    """Update rate, integration time, and latency from mid-exposure to the end of readout."""
    detector = scenario.detector
    lines_s = detector.height * detector.line_time_us * 1e-6
    if detector.shutter == "global":
        readout_s, rule = 0.0, "half the exposure; the scenario has no readout time for a global shutter"
    else:
        readout_s, rule = lines_s, f"half the exposure and {detector.height} lines of {detector.line_time_us:g} µs"
    fixed = (
        ("update_rate", "Update rate", 1.0 / scenario.sequence.step_s, "Hz", "sequence.step_s"),
        ("integration_time", "Integration time", detector.exposure_s, "s", "detector.exposure_s"),
        ("latency_to_readout", "Mid-exposure to end of readout", 0.5 * detector.exposure_s + readout_s, "s", rule),
    )
    return [
        Quantity(name, title, Estimate(value, value, value), unit, method=f"fixed by the scenario: {method}")
        for name, title, value, unit, method in fixed
    ]


def computing_time(scenario: Scenario) -> dict[str, Any]:
    """Measured time of the solution of a frame on this machine, milliseconds, and the latency with it, seconds."""
    runner = TrialRunner(scenario)
    runner.run(0)
    times = np.array([runner.run(1 + k)["solve_ms"] for k in range(TIMED_TRIALS)])
    to_readout = timing(scenario)[-1].estimate.value
    assert to_readout is not None
    median, worst = float(np.median(times)), float(times.max())
    return {
        "note": "measured on this machine; not part of the reproducible datasheet",
        "machine": platform.machine(),
        "processor": platform.processor(),
        "python": platform.python_version(),
        "trials": TIMED_TRIALS,
        "solve_ms": {"median": median, "largest": worst},
        "latency_s": {"median": to_readout + 1e-3 * median, "largest": to_readout + 1e-3 * worst},
    }
