"""A physically based simulator of a star camera in orbit, and a Monte Carlo harness that measures its accuracy.

from simulator import Scenario, render, run
scenario = Scenario.load("scenarios/cubesat.yaml")
frame, truth = render(scenario, index=0)
study = run(scenario, trials=1000, seed=1)
"""

from __future__ import annotations

TYPE_CHECKING = False  # type checkers take the name as true; the import of typing takes longer than the rest
if TYPE_CHECKING:
    from typing import Any

    from simulator.frame import Frame, FrameTruth
    from simulator.renderer import Renderer, render
    from simulator.scenario import Scenario
    from simulator.study.run import Study, run

__all__ = ["Frame", "FrameTruth", "Renderer", "Scenario", "Study", "render", "run"]

_HOMES = {
    "Frame": "simulator.frame",
    "FrameTruth": "simulator.frame",
    "Renderer": "simulator.renderer",
    "Scenario": "simulator.scenario",
    "Study": "simulator.study.run",
    "render": "simulator.renderer",
    "run": "simulator.study.run",
}


def __getattr__(name: str) -> Any:
    """Load a public name on first use, which keeps the import fast."""
    if name not in _HOMES:
        raise AttributeError(f"module 'simulator' has no attribute '{name}'")
    from importlib import import_module

    value = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
