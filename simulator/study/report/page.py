"""The page of a run, with the answer in its first lines."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from simulator.study.pages.drawing import drawn_apart
from simulator.study.pages.html import html_of
from simulator.study.pages.page import Figures, Page, Section, Words, paragraph, sections, soft
from simulator.study.pages.parts import provenance
from simulator.study.report.content import (
    accuracy_table,
    answer_of,
    budget_table,
    method_text,
    notes_of,
    outliers_table,
    render_command,
)
from simulator.study.report.figures import panels
from simulator.study.specification.requirements import specification_of
from startracker.catalog import load_catalog

if TYPE_CHECKING:
    from simulator.scenario import Scenario
    from simulator.study.trials.trial import TrialRunner


def report_page(
    scenario: Scenario,
    summary: Mapping[str, Any],
    columns: Mapping[str, NDArray[Any]],
    *,
    runner: TrialRunner | None = None,
    budget: Mapping[str, Any] | None = None,
) -> Page:
    """Content of the page of a run.

    Parameters
    ----------
    scenario : Scenario
        The scenario.
    summary : mapping
        As in ``summary.json``; the page also states if the run was interrupted.
    columns : mapping of arrays
        As in ``trials.parquet``.
    runner : TrialRunner, optional
        The runner of the run, which is reused for the example frames.
    budget : mapping, optional
        As in ``budget.json``.
    """
    # with the renderer, not loaded where pages are drawn
    from simulator.study.report.frames import frame_panels
    from simulator.study.specification.measured import judge_frames

    specification, judged = specification_of(scenario), judge_frames(scenario, columns)
    found = panels(columns, specification, load_catalog(scenario.sky.catalog))
    frames = frame_panels(scenario, columns, specification, runner)
    anchors = {str(index): panel.anchor for index, panel in frames.items()}
    frames_note = "Images with the results of the tracker: squares mark detections, circles identified stars."
    versions = ", ".join(f"{name} {number}" for name, number in summary["versions"].items())
    return Page(
        heading=f"{scenario.name}: study of {summary['trials']} trials",
        description=scenario.description,
        provenance=provenance({"name": scenario.name, **summary}, scenario.fingerprint()),
        answer=answer_of(judged, summary, columns, budget).blocks,
        verdict=judged.state,
        notes=notes_of(summary),
        sections=sections(
            Section("Accuracy", (accuracy_table(summary), Figures(tuple(found.errors)))),
            Section("Dependence of the error", (Figures(tuple(found.trends)),)) if found.trends else None,
            Section("Error budget", (budget_table(budget),)) if budget else None,
            Section("Time and sky", (Figures(tuple(found.wide)),)),
            Section("Frames", (soft(frames_note), Figures(tuple(frames.values()), 2))),
            Section(
                "Outliers", (outliers_table(summary, columns, anchors), paragraph(Words(render_command(), "code")))
            ),
            Section("Method", (paragraph(method_text(scenario, summary)), soft(f"{versions}."))),
        ),
        scenario=scenario.to_yaml(),
    )


def report_html(
    scenario: Scenario,
    summary: Mapping[str, Any],
    columns: Mapping[str, NDArray[Any]],
    *,
    runner: TrialRunner | None = None,
) -> str:
    """The page of a run as HTML, drawn in a separate process."""
    return drawn_apart(html_of, report_page(scenario, summary, columns, runner=runner))
