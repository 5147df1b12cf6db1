"""``boresight datasheet``: measurement at the beginning and at the end of life, and its files."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

from simulator.scenario import Scenario
from simulator.study.datasheet.accuracy import measure_accuracy
from simulator.study.datasheet.dependence import residuals, robustness, temperature
from simulator.study.datasheet.performance import acquisition, exclusion, rates, tracking
from simulator.study.datasheet.result import Column, Datasheet
from simulator.study.datasheet.sheet import FULL, QUICK, Amounts
from simulator.study.datasheet.sky import availability, sky_coverage
from simulator.study.datasheet.tasks import PARTS_FOLDER, TaskRunner
from simulator.study.datasheet.timing import computing_time, timing
from simulator.study.result_files import json_text, write_files
from simulator.study.results_folder import Identity, results_folder, scenario_sha256
from simulator.study.specification.measured import judge_frames

RESULT_FILES = ("datasheet.json", "datasheet.html", "datasheet.pdf", "datasheet.timing.json")
"""Files of a datasheet. All but the last are the same bytes on any machine with the same libraries, and on any number
of workers; the last contains measured computing times."""


def measure(life: str, scenario: Scenario, runner: TaskRunner, amounts: Amounts) -> Column:
    """All values of one stage of life."""
    accuracy = measure_accuracy(scenario, runner, amounts.fields, amounts.trials)
    greatest, rate_points = rates(scenario, runner, amounts)
    conditions = [temperature(scenario, runner, amounts), *robustness(scenario, runner, amounts)]
    sections = {
        "accuracy": accuracy.quantities,
        "residuals": residuals(scenario, runner, amounts),
        "rate_limit": [greatest],
        "acquisition": acquisition(scenario, runner, amounts),
        "tracking": tracking(scenario, runner, amounts, greatest.estimate.value),
        "sky": sky_coverage(scenario, amounts) + exclusion(scenario, runner, amounts),
        "timing": timing(scenario),
    }
    points = {"rates": rate_points} | availability(accuracy.trials)
    return Column(life, scenario, sections, conditions, points, accuracy, judge_frames(scenario, accuracy.trials))


def datasheet(
    scenario: Scenario,
    *,
    end_of_life: Scenario | None = None,
    quick: bool = False,
    workers: int = 1,
    out: Path | None = None,
    force: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> Datasheet:
    """Measure a datasheet, and write its files.

    Parameters
    ----------
    scenario : Scenario
        The camera and its mission.
    end_of_life : Scenario, optional
        The same at the end of life. By default an end of life is stated if the scenario's camera is aged by its
        environment (``environment.age_years``): the beginning of life is then the scenario at the age of zero.
    quick : bool
        A first look with fewer frames.
    workers : int
        Processes on this machine; the results do not depend on their number.
    out : Path, optional
        Folder for `RESULT_FILES`; None: nothing is written.
    force : bool
        Replace results of another scenario in `out`.
    progress : callable, optional
        Called with (finished tasks, known tasks).

    Raises
    ------
    InputError
        For an unwritable folder, other results in it, or invalid values.
    Interrupted
        After Ctrl-C; finished tasks in `out` are used by the next call.
    """
    amounts = QUICK if quick else FULL
    stages = stages_of(scenario, end_of_life)
    sha256 = scenario_sha256(scenario, datasheet=True, stages=[scenario_sha256(stage) for _, stage in stages])
    identity = Identity("datasheet", scenario.name, scenario.seed, sha256, {"trials": amounts.trials})
    if out is None:
        return _measured(stages, amounts, identity, workers, None, progress)
    with results_folder(out, identity, force=force) as folder:
        sheet = _measured(stages, amounts, identity, workers, folder / PARTS_FOLDER, progress)
        _write(sheet, folder)
    return sheet


def stages_of(scenario: Scenario, end_of_life: Scenario | None = None) -> list[tuple[str, Scenario]]:
    """Beginning of life, and end of life if it is given or if the environment has aged the camera."""
    if end_of_life is not None:
        return [("BOL", scenario), ("EOL", end_of_life)]
    if scenario.environment.has_damage:
        return [("BOL", scenario.changed({"environment.age_years": 0.0})), ("EOL", scenario)]
    return [("BOL", scenario)]


def _measured(
    stages: list[tuple[str, Scenario]],
    amounts: Amounts,
    identity: Identity,
    workers: int,
    parts: Path | None,
    progress: Callable[[int, int], None] | None,
) -> Datasheet:
    with TaskRunner(workers, parts, progress) as runner:
        columns = [measure(life, stage, runner, amounts) for life, stage in stages]
    return Datasheet(stages[0][1], columns, amounts, identity)


def _write(sheet: Datasheet, folder: Path) -> None:
    from simulator.study.datasheet.page import datasheet_files

    page, pdf = datasheet_files(sheet)
    files: dict[str, str | bytes] = {
        "datasheet.html": page,
        "datasheet.pdf": pdf,
        "datasheet.timing.json": json_text(computing_time(sheet.scenario)),
        "datasheet.json": json_text(sheet.to_dict()),  # last: it identifies the results
    }
    write_files(folder, files)
    shutil.rmtree(folder / PARTS_FOLDER, ignore_errors=True)
