"""A physically based simulator of a star camera in orbit, and a Monte Carlo harness that measures its accuracy.

Example::

    from simulator import Scenario, render, run

    scenario = Scenario.load("scenarios/cubesat.yaml")
    frame, truth = render(scenario, index=0)
    study = run(scenario, trials=1000, seed=1)
"""

from __future__ import annotations

# Type checkers treat this name as true whatever its value. Importing it from typing would take longer than the rest of
# this module.
TYPE_CHECKING = False
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
    globals()[name] = value  # the next access finds the name and does not call this function again
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
