"""Exclusion angles of a coverage study, and where each of them comes from."""

from __future__ import annotations

from collections.abc import Mapping

from simulator.scenario import Scenario
from simulator.scenario.fields import all_keys
from simulator.study.coverage.boresights import Boresights, Exclusion

BODIES = ("sun", "moon", "earth")


def exclusion_of(scenario: Scenario, given: Mapping[str, float | None] | None = None) -> Exclusion:
    """Exclusion angles, and the source of each that is not zero: given, else those of the specification, else those of
    the baffle, if the scenario has one.

    Parameters
    ----------
    scenario : Scenario
        The scenario.
    given : mapping, optional
        Angle by body, degrees; None: that of the scenario.
    """
    angles, sources = {}, {}
    defaults = {key.path: key.default for key in all_keys()}
    for body in BODIES:
        path = f"optics.baffle.{body}_exclusion_deg"
        specified = getattr(scenario.specification, f"{body}_exclusion_deg")
        of_baffle = (
            0.0 if scenario.optics.baffle.pst is None else getattr(scenario.optics.baffle, f"{body}_exclusion_deg")
        )
        chosen = (given or {}).get(body)
        if chosen is not None:
            angle, source = chosen, f"--{body}-deg"
        elif specified is not None:
            angle, source = specified, f"specification.{body}_exclusion_deg"
        else:
            angle, source = of_baffle, f"{path}, {'the default' if of_baffle == defaults[path] else 'as set'}"
        angles[f"{body}_deg"] = angle
        if angle > 0.0:
            sources[body] = source
    return Exclusion(**angles, sources=sources)


def everything_excluded(looks: Boresights, exclusion: Exclusion) -> str:
    """Sentence with the angles that exclude every attitude: those that do so alone, otherwise all."""
    alone = [body for body, broken in looks.excluded.items() if broken.all()]
    return "everything is excluded by " + " and ".join(
        exclusion.sources.get(body, body) for body in alone or looks.excluded
    )


def exclusion_text(body: str, angle_deg: float, source: str) -> str:
    """An exclusion angle and where it comes from: ``within 25° of its limb (optics.baffle.earth_exclusion_deg, …)``."""
    return f"within {angle_deg:g}° of its {'limb' if body == 'earth' else 'centre'} ({source})"
