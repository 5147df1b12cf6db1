"""``boresight validate``, ``show`` and ``schema``. Each returns the exit status."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from simulator.scenario import Scenario


def validate(paths: Sequence[str | Path]) -> int:
    """Check scenario files: a line "… : ok" each on standard output, or every mistake on standard error.

    A scenario that loads is built as for a run, so that what ``run`` refuses is refused here.

    Returns
    -------
    int
        0 when all are right, 2 when one is not.
    """
    from simulator.checks import load_scenario
    from simulator.scenario import ScenarioError
    from simulator.study.runnable import refuse_unrunnable

    status = 0
    for path in paths:
        try:
            scenario = load_scenario(path)
            refuse_unrunnable(scenario)
        except ScenarioError as error:
            print(error, file=sys.stderr)
            status = 2
            continue
        print(f"{path}: ok")
        for reason in scenario.unphysical:
            print(f"{path}: unphysical, but allowed: {reason}")
    return status


def show(path: str | Path, set_: Sequence[str] | None = None) -> int:
    """Print a scenario with every default spelled out and every key explained; it loads again to an equal one.

    Beside each value that is not a default stands where it is written: in which file of the chain of bases, and in
    which line. Below it, as comments, the values that follow from the age of the camera.

    Returns
    -------
    int
        0, or 2 with every mistake on standard error.
    """
    from simulator.checks import load_scenario
    from simulator.scenario import ScenarioError
    from simulator.scenario.output import scenario_yaml

    try:
        scenario = load_scenario(path, set_)
    except ScenarioError as error:
        print(error, file=sys.stderr)
        return 2
    print(scenario_yaml(scenario, origins=scenario.origins()), end="")
    if scenario.environment.has_damage:
        print("", *(f"# {line}" for line in _derived_lines(scenario)), sep="\n")
    return 0


def _derived_lines(scenario: Scenario) -> list[str]:
    """Values of the detector after the radiation of its age, or the reason why they are not known here."""
    from simulator.study.environment.derived import aged_lines
    from startracker.errors import InputError

    try:
        return ["Derived values:", *aged_lines(scenario)]
    except InputError as error:  # an optional package that is not installed
        return [f"Derived values: {error}"]


def schema() -> int:
    """Print the JSON schema of a scenario file, for editors.

    Returns
    -------
    int
        0.
    """
    print(schema_text(), end="")
    return 0


def schema_text() -> str:
    """The JSON schema as it is committed in ``scenarios/schema.json``."""
    import json

    from simulator.scenario.output import json_schema

    return json.dumps(json_schema(), indent=2, ensure_ascii=False) + "\n"
