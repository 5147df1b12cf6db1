"""Files of a sweep: a dataset of all trials, the table of points, the plots and the page."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from simulator.paths import make_folder, open_atomically, write_atomically
from simulator.scenario import Scenario
from simulator.scenario.grid import SweptKey
from simulator.scenario.output import cell
from simulator.study.point_statistics import OUTCOME_COLUMNS, TRIAL_COLUMNS, point_statistics
from simulator.study.result_files import parquet_bytes
from simulator.study.specification.measured import JUDGED_COLUMNS, judge_frames
from simulator.study.trials.arrow import as_column, read_columns
from simulator.study.trials.checked_files import write_checked
from simulator.study.trials.columns import Columns

RESULT_FILES = ("sweep.parquet", "points.csv", "sweep.json", "sweep.html", "plots")

Row = tuple[int, tuple[Any, ...], str | None]
"""Number of a point, its values, and the reason if it is refused."""


def point_files(folder: Path) -> dict[int, Path]:
    """Files of finished points, ``POINT-CHECKSUM.parquet``, by the point's number."""
    found = {int(path.stem.split("-")[0]): path for path in folder.glob("[0-9]*-*.parquet")}
    return dict(sorted(found.items()))


def write_point(swept: Sequence[SweptKey], values: Sequence[Any], index: int, trials: pa.Table, kept: Path) -> None:
    """Store the trials of a point, preceded by columns of its number and values."""
    n = trials.num_rows
    columns: dict[str, pa.Array] = {"point": as_column([index] * n).cast(pa.int32())}
    for axis, value in zip(swept, values, strict=True):
        if axis.numeric:
            columns[axis.path] = as_column([value] * n).cast(pa.int64() if axis.whole else pa.float64())
        else:
            columns[axis.path] = as_column([str(cell(value))] * n)
    for name in trials.column_names:
        columns[name] = trials[name]
    write_checked(kept, f"{index:06d}", parquet_bytes(pa.table(columns), compression="zstd"))


def write_results(
    table: dict[str, Any],
    paths: list[str],
    rows: list[Row],
    kept: Path,
    folder: Path,
    scenarios: Mapping[int, Scenario],
) -> None:
    """Write all files of a sweep atomically; the statistics of the points are added to `table`.

    Parameters
    ----------
    table : dict
        Content of ``sweep.json`` except the points.
    paths : list of str
        Swept keys.
    rows : list
        All points.
    kept : Path
        Folder of the finished points.
    folder : Path
        Folder of the results.
    scenarios : mapping
        Scenario of each possible point by its number; its specification is judged.
    """
    from simulator.study.pages.html import html_of
    from simulator.study.sweep.page import sweep_page
    from simulator.study.sweep.plots import sweep_figures

    files = point_files(kept)
    join(list(files.values()), folder / "sweep.parquet")
    table["points"] = []
    for index, values, refused in rows:
        shown = {path: cell(value) for path, value in zip(paths, values, strict=True)}
        point: dict[str, Any] = {"point": index, "values": shown, "status": "done", "reason": ""}
        if refused is not None:
            point |= {"status": "refused", "reason": refused}
        elif index in files:
            columns = Columns(read_columns(files[index], [*TRIAL_COLUMNS, *OUTCOME_COLUMNS, *JUDGED_COLUMNS]))
            judged = judge_frames(scenarios[index], columns)
            point |= {"statistics": point_statistics(columns, table["seed"], judged), "verdict": judged.to_dict()}
        else:
            point["status"] = "not run"
        table["points"].append(point)
    write_atomically(folder / "points.csv", points_csv(table))
    write_atomically(folder / "sweep.json", json.dumps(table, indent=1, allow_nan=False, ensure_ascii=False) + "\n")
    pictures = make_folder(folder / "plots")
    figures = sweep_figures(table)
    for figure in figures:
        write_atomically(pictures / f"{figure.name}.png", figure.png())
    write_atomically(folder / "sweep.html", html_of(sweep_page(table, figures)))


def join(files: list[Path], target: Path) -> None:
    """Point files as one dataset with one row group each; only one of them is in memory at a time."""
    # a column without values in a point has no type there
    schema = pa.unify_schemas([pq.read_schema(file) for file in files], promote_options="permissive")
    with open_atomically(target) as stream, pq.ParquetWriter(stream, schema, compression="zstd") as writer:
        for file in files:
            part = read_columns(file)
            whole = pa.concat_tables([part, schema.empty_table()], promote_options="permissive")
            writer.write_table(whole.select(schema.names).cast(schema), row_group_size=max(1, whole.num_rows))


def points_csv(table: dict[str, Any]) -> str:
    """One line per point: number, values, status, reason and statistics; empty if there are none."""
    paths = [axis["path"] for axis in table["swept"]]
    names = next(list(point["statistics"]) for point in table["points"] if "statistics" in point)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["point", *paths, "status", "reason", *names])
    for point in table["points"]:
        statistics = point.get("statistics", {})
        writer.writerow(
            [
                point["point"],
                *(point["values"][path] for path in paths),
                point["status"],
                point["reason"],
                *("" if statistics.get(name) is None else statistics[name] for name in names),
            ]
        )
    return text.getvalue()
