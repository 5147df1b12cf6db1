"""Frames of the report: the best, the median and the worst trial, and one that was not solved, rendered again."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.scenario import Scenario
from simulator.study.axes import AXES
from simulator.study.pictures import draw_solution, shades_of, title_of
from simulator.study.report.content import render_command
from simulator.study.specification.requirements import Specification
from simulator.study.style import Panel
from simulator.study.trials.trial import TrialRunner, solve_frame

Columns = Mapping[str, NDArray[Any]]


def chosen_trials(columns: Columns, specification: Specification) -> list[tuple[str, int]]:
    """Selected trials, as (description, index).

    The best, the median and the worst by the largest error relative to its specification, and the
    first unsolved one.
    """
    index = np.asarray(columns["index"])
    solved = np.asarray(columns["status"]) == "solved"
    found = []
    if solved.any():
        share = specification.worst_share({axis: columns[f"error_{axis}_deg"][solved] for axis in AXES})
        order = index[solved][np.argsort(share, kind="stable")]
        found = [("best", int(order[0])), ("median", int(order[(len(order) - 1) // 2])), ("worst", int(order[-1]))]
    if not solved.all():
        found.append(("first not solved", int(index[~solved][0])))
    return found


def frame_panels(
    scenario: Scenario, columns: Columns, specification: Specification, runner: TrialRunner | None = None
) -> dict[int, Panel]:
    """Panels of the selected trials by their indices; each frame is rendered and solved again, as in the run.

    Parameters
    ----------
    runner : TrialRunner, optional
        The runner of the run; by default a new one.
    """
    runner = runner or TrialRunner(scenario)
    made: dict[int, Panel] = {}
    for what, index in chosen_trials(columns, specification):
        if index in made:  # a frame may be selected twice if there are few trials
            continue
        frame = runner.renderer.frame(index)[0]  # the truth, a floating-point image, is released at once
        solution = solve_frame(runner.tracker, frame)
        height, width = frame.image.shape
        made[index] = Panel(
            f"Trial {index}, the {what}",
            "",
            functools.partial(
                draw_solution,
                shades=shades_of(frame.image, 512),
                solution=solution,
                title=title_of(solution),  # here, as its kernels are loaded
                names=8,
            ),
            height_in=4.2 * min(1.3, height / width) + 0.35,
            anchor=f"trial-{index}",
            command=render_command(str(index)),
        )
    return made
