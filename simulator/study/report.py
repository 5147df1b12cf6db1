"""The report: one self-contained HTML page, the answer in its first lines."""

from __future__ import annotations

import base64
import html
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from simulator.scenario import Scenario
from simulator.study import plots
from simulator.study.statistics import AXES, BODY_AXES, deg_text
from simulator.study.trial import TrialRunner, solve_frame
from startracker.catalog import load_catalog

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_TEMPLATE = Path(__file__).with_name("report.html.j2")


def report_html(scenario: Scenario, summary: dict[str, Any], columns: dict[str, NDArray[Any]]) -> str:
    """Whole report as one page: no script, no link to anything outside it.

    Parameters
    ----------
    scenario : Scenario
        What was run.
    summary : dict
        As in ``summary.json``; where it says that the run was interrupted, the report says so too.
    columns : dict of arrays
        As in ``trials.parquet``.
    """
    from jinja2 import Environment, StrictUndefined

    specification = {axis: getattr(scenario.specification, f"{axis}_deg") for axis in BODY_AXES}
    example = _example_index(columns)
    runner = TrialRunner(scenario)
    frame, _ = runner.renderer.frame(example)
    figures = [
        (
            "Attitude errors",
            plots.error_histograms(columns, specification),
            "Errors of all solved trials: body axes above, camera axes below. σ is the root mean square about zero.",
        ),
        (
            "Errors against the number of stars",
            plots.error_against_stars(columns),
            "Each point a trial; squares the rms of the trials with that many stars.",
        ),
        (
            "Where the camera looked",
            plots.sky_path(columns, load_catalog(scenario.sky.catalog)),
            "Boresights of the trials (sinusoidal, or Sanson–Flamsteed, projection; ICRS).",
        ),
        (
            f"Frame of trial {example}",
            plots.solved_image(frame.image, solve_frame(runner.tracker, frame)),
            f"Made again by: boresight render {scenario.source_name} --index {example} --seed {scenario.seed}",
        ),
    ]
    unsolved = [
        (int(columns["index"][i]), str(columns["utc"][i]), str(columns["status"][i]), str(columns["reason"][i]))
        for i in np.flatnonzero((columns["status"] != "solved") | columns["wrong"])[:20]
    ]
    template = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    ).from_string(_TEMPLATE.read_text(encoding="utf-8"))
    return template.render(
        scenario=scenario,
        summary=summary,
        verdicts=[
            {
                "axis": axis,
                "title": plots.TITLES[axis],
                **summary["specification"][axis],
                "margin": _margin(summary["specification"][axis]),
            }
            for axis in BODY_AXES
        ],
        met=all(summary["specification"][axis]["met"] for axis in BODY_AXES) and summary["wrong"] == 0,
        axes=[(plots.TITLES[axis], summary["errors_deg"][axis]) for axis in AXES],
        figures=[(title, _embed(figure), note) for title, figure, note in figures],
        unsolved=unsolved,
        resolved=scenario.to_yaml(),
        deg=deg_text,
        escape=html.escape,
    )


def _margin(entry: dict[str, Any]) -> float | None:
    return entry["specified_deg"] / entry["three_sigma_deg"] if entry["three_sigma_deg"] else None


def _example_index(columns: dict[str, Any]) -> int:
    """A trial as most are: solved, with the median number of stars; the first where none is solved."""
    solved = np.flatnonzero(columns["status"] == "solved")
    if not len(solved):
        return int(columns["index"][0])
    stars = columns["stars_matched"][solved]
    return int(columns["index"][solved[np.argmin(np.abs(stars - np.median(stars)))]])


def _embed(figure: Figure) -> str:
    return "data:image/png;base64," + base64.b64encode(plots.save_bytes(figure)).decode("ascii")
