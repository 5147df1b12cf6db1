"""The scenario: schema, loading with line-numbered errors, physical plausibility."""

from simulator.scenario.errors import Location, Problem, ScenarioError
from simulator.scenario.files import find_scenario
from simulator.scenario.load import Scenario
from simulator.scenario.schema import ScenarioModel

__all__ = ["Location", "Problem", "Scenario", "ScenarioError", "ScenarioModel", "find_scenario"]


def __dir__() -> list[str]:
    return sorted(__all__)
