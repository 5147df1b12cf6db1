"""A measured datasheet, and its content as ``datasheet.json``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from simulator.scenario import Scenario
from simulator.study.datasheet.accuracy import Accuracy
from simulator.study.datasheet.dependence import Series
from simulator.study.datasheet.scan import CUT_PERIOD_PX
from simulator.study.datasheet.sheet import Amounts, Quantity
from simulator.study.datasheet.words import INTERPRETATIONS, STANDARD, TERMS
from simulator.study.results_folder import Identity, scenario_sha256
from simulator.study.specification.verdicts import Judgement
from startracker._version import __version__


@dataclass(frozen=True)
class Column:
    """One stage of life."""

    life: str
    """``BOL`` or ``EOL``."""
    scenario: Scenario
    """The scenario at this stage."""
    sections: dict[str, list[Quantity]]
    """Values by section: accuracy, residuals, rate_limit, acquisition, tracking, sky, timing."""
    series: list[Series]
    """Errors and availability against conditions."""
    points: dict[str, list[dict[str, Any]]]
    """Points of the plots: rates, orbit, year, stars."""
    accuracy: Accuracy
    """Classes, with their spectra."""
    judgement: Judgement
    """Verdict on the specification, from the trials."""

    def to_dict(self) -> dict[str, Any]:
        """As in ``datasheet.json``."""
        spectra, found = self.accuracy.separated.spectra, self.accuracy.separated
        return {
            "life": self.life,
            "scenario_sha256": scenario_sha256(self.scenario),
            "specification": self.judgement.by_name(),
            "verdict": self.judgement.to_dict(),
            "sections": {name: [q.to_dict() for q in group] for name, group in self.sections.items()},
            "series": {series.name: series.points for series in self.series} | self.points,
            "scan": {
                "fields": found.fields,
                "fields_left_out": found.left_out,
                "frames": self.accuracy.geometry.frames,
                "step_px": self.accuracy.geometry.step_px,
                "cut_period_px": CUT_PERIOD_PX,
            },
            "spectra_arcsec2_px": {name: getattr(spectra, name).tolist() for name in spectra._fields},
        }


@dataclass(frozen=True)
class Datasheet:
    """A whole datasheet."""

    scenario: Scenario
    """The scenario at the beginning of life."""
    columns: list[Column]
    """Beginning of life, and end of life if there is one."""
    amounts: Amounts
    """Numbers of frames."""
    identity: Identity
    """Inputs."""

    def to_dict(self) -> dict[str, Any]:
        """As in ``datasheet.json``."""
        return {
            "name": self.scenario.name,
            "description": self.scenario.description,
            "seed": self.scenario.seed,
            "version": __version__,
            "identity": self.identity.to_dict(),
            "standard": STANDARD,
            "terms": {name: term._asdict() for name, term in TERMS.items()},
            "interpretations": INTERPRETATIONS,
            "amounts": self.amounts.to_dict(),
            "columns": [column.to_dict() for column in self.columns],
        }
