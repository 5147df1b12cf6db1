"""``boresight datasheet``: progress on a terminal, the answer in a few lines, the files."""

from __future__ import annotations

from pathlib import Path

from simulator.checks import load_scenario
from simulator.cli.checks import at_least, processes
from simulator.cli.requests import DatasheetRequest
from simulator.cli.terminal import open_console, print_table, progress_bar
from simulator.cli.verdicts import print_judgement
from simulator.study.datasheet.run import RESULT_FILES, datasheet
from simulator.study.datasheet.tables import accuracy_table
from simulator.study.datasheet.tasks import PARTS_FOLDER, Interrupted


def main(request: DatasheetRequest) -> int:
    """Measure the datasheet; exit status 0, or 130 where it was interrupted."""
    at_least(0, seed=request.seed)
    values = list(request.set_values or ())
    scenario = load_scenario(request.scenario, values, seed=request.seed)
    end_of_life = None
    if request.eol_set:
        end_of_life = load_scenario(request.scenario, [*values, *request.eol_set], seed=request.seed)
    folder = request.out or Path("out") / f"{scenario.name}-datasheet"
    try:
        with progress_bar(f"{scenario.name}: datasheet", "tasks") as progress:
            sheet = datasheet(
                scenario,
                end_of_life=end_of_life,
                quick=request.quick,
                workers=processes(request.workers, None, 1_000_000),
                out=folder,
                force=request.force,
                progress=progress,
            )
    except Interrupted:
        print(f"Interrupted: the finished tasks are kept in {folder / PARTS_FOLDER}; the same command continues.")
        return 130
    console = open_console()
    for column in sheet.columns:
        table = accuracy_table(column)
        print_table(console, f"{scenario.name}, {column.life}", table.headings, table.rows, block=3)
        print_judgement(column.judgement, console)
    print(f"{folder}: {', '.join(RESULT_FILES)}")
    return 0
