"""What a user writes: the schema, its loading with line-numbered errors, and its physics."""

from simulator.scenario.errors import Location, Problem, ScenarioError
from simulator.scenario.files import find_scenario
from simulator.scenario.load import Scenario
from simulator.scenario.schema import ScenarioModel

__all__ = ["Location", "Problem", "Scenario", "ScenarioError", "ScenarioModel", "find_scenario"]
