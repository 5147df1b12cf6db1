"""The report: one self-contained HTML page, with the answer in its first lines; for PDF see
`simulator.study.report.pdf`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from simulator.study.html_page import TONES, drawn, render_page
from simulator.study.report.content import Content, content_of
from simulator.study.report.drawing import drawn_apart
from simulator.study.report.figures import Panels, panels
from simulator.study.specification.requirements import specification_of
from simulator.study.style import Panel
from startracker.catalog import load_catalog

if TYPE_CHECKING:
    from simulator.scenario import Scenario
    from simulator.study.trials.trial import TrialRunner


@dataclass(frozen=True)
class Report:
    """Text and figures of a report, before layout."""

    name: str
    description: str
    """Of the scenario."""
    summary: Mapping[str, Any]
    """Its ``summary.json``."""
    content: Content
    """Text and tables."""
    panels: Panels
    """Figures of the statistics."""
    frames: list[tuple[Panel, int]]
    """Example frames and the indices of their trials."""
    resolved: str
    """The scenario as YAML."""


def build_report(
    scenario: Scenario,
    summary: Mapping[str, Any],
    columns: Mapping[str, NDArray[Any]],
    *,
    runner: TrialRunner | None = None,
    budget: Mapping[str, Any] | None = None,
) -> Report:
    """Content of a report.

    Parameters
    ----------
    scenario : Scenario
        The scenario.
    summary : mapping
        As in ``summary.json``; the report also states if the run was interrupted.
    columns : mapping of arrays
        As in ``trials.parquet``.
    runner : TrialRunner, optional
        The runner of the run, which is reused for the example frames.
    budget : mapping, optional
        As in ``budget.json``.
    """
    from simulator.study.report.frames import frame_panels  # with the renderer, not loaded where pages are drawn

    specification = specification_of(scenario)
    return Report(
        scenario.name,
        scenario.description,
        summary,
        content_of(scenario, summary, columns, budget),
        panels(columns, specification, load_catalog(scenario.sky.catalog)),
        frame_panels(scenario, columns, specification, runner),
        scenario.to_yaml(),
    )


def html_of(report: Report) -> str:
    """The report as one page without scripts or external links, in light and dark, for desktop, phone and print."""
    return render_page(
        "report/report.html.j2",
        name=report.name,
        description=report.description,
        summary=report.summary,
        content=report.content,
        tone=TONES[report.content.answer.state],
        errors=[drawn(panel, f"e{i}") for i, panel in enumerate(report.panels.errors)],
        trends=[drawn(panel, f"t{i}") for i, panel in enumerate(report.panels.trends)],
        wide=[drawn(panel, f"w{i}") for i, panel in enumerate(report.panels.wide)],
        frames=[drawn(panel, f"f{i}", f"trial-{index}") for i, (panel, index) in enumerate(report.frames)],
        resolved=report.resolved,
    )


def report_html(
    scenario: Scenario,
    summary: Mapping[str, Any],
    columns: Mapping[str, NDArray[Any]],
    *,
    runner: TrialRunner | None = None,
) -> str:
    """`build_report` and `html_of` in one, drawn in a separate process."""
    return drawn_apart(html_of, build_report(scenario, summary, columns, runner=runner))
