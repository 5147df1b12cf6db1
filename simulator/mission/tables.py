"""Tables of quantities over time with named columns, in CSV and Parquet."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from simulator.mission.clock import Clock
from simulator.mission.epochs import elapsed_s
from simulator.parquet import read_parquet
from startracker.core import FloatArray
from startracker.errors import InputError
from startracker.files import MESSAGE_BYTES, read_text

_TIMES = ("utc", "t_s")


class Rows(NamedTuple):
    """Rows of a table."""

    t_s: FloatArray
    """(N,): Seconds after the scenario's epoch, ascending."""
    values: FloatArray
    """(N, C): The requested columns."""
    positions: list[str]
    """File and line (CSV), or file and row (Parquet), for messages."""


class _Text(NamedTuple):
    """A table before its numbers are read."""

    header: list[str]
    rows: list[list[Any]]
    positions: list[str]
    first: str
    """Position of the header."""


def read_rows(path: Path, clock: Clock, columns: Sequence[str], optional: Sequence[str] = ()) -> Rows:
    """Rows of a table with a header.

    Its columns are ``utc`` (ISO 8601) or ``t_s`` (seconds after the scenario's epoch), and the requested ones; others
    are not read. In CSV, lines that start with ``#`` are comments. A file named ``*.parquet`` is read as Parquet.

    Parameters
    ----------
    path : Path
        The file.
    clock : Clock
        The scenario's clock.
    columns : sequence of str
        Columns that the table must have.
    optional : sequence of str
        Columns that follow them if the table has them all.

    Raises
    ------
    InputError
        With file and line: a missing column, a value that is not a finite number, fewer than two rows, or times that do
        not ascend.
    """
    text = _parquet(path) if path.suffix.lower() == ".parquet" else _csv(path)
    time = next((name for name in _TIMES if name in text.header), None)
    needed = columns if time else ("utc or t_s", *columns)
    missing = [name for name in needed if name not in text.header]
    if missing:
        raise InputError(f"{text.first}: columns are missing: {', '.join(missing)}")
    if len(text.rows) < 2:
        raise InputError(f"{path}: has fewer than two rows")
    # Optional columns are read together or not at all.
    wanted = [*columns, *(optional if set(optional) <= set(text.header) else ())]
    indices = [text.header.index(name) for name in wanted]
    values = np.empty((len(text.rows), len(wanted)))
    for k, (row, position) in enumerate(zip(text.rows, text.positions, strict=True)):
        if len(row) < len(text.header):
            raise InputError(f"{position}: {len(row)} of {len(text.header)} columns; is the file truncated?")
        values[k] = [_number(row[at], name, position) for at, name in zip(indices, wanted, strict=True)]
    at_time = text.header.index(str(time))
    times = [row[at_time] for row in text.rows]
    if time == "utc":
        t_s = elapsed_s(clock, [str(value) for value in times], "UTC", text.positions)
    else:
        t_s = np.array([_number(x, "t_s", position) for x, position in zip(times, text.positions, strict=True)])
    if (back := np.flatnonzero(np.diff(t_s) <= 0.0)).size:
        raise InputError(f"{text.positions[back[0] + 1]}: the time is not after the one before; sort the rows by time")
    return Rows(t_s, values, text.positions)


def _csv(path: Path) -> _Text:
    # Lines are parsed one by one, so that every row has its line number for messages.
    lines = [
        (n, line)
        for n, line in enumerate(read_text(path, MESSAGE_BYTES, "give a file of a table").splitlines(), 1)
        if _has_data(line)
    ]
    cells = [[cell.strip() for cell in next(csv.reader([line]))] for _, line in lines]
    positions = [f"{path}:{number}" for number, _ in lines]
    return _Text(cells[0] if cells else [], cells[1:], positions[1:], positions[0] if positions else f"{path}:1")


def _parquet(path: Path) -> _Text:
    columns = read_parquet(path)
    rows = [list(row) for row in zip(*columns.values(), strict=True)]
    return _Text(list(columns), rows, [f"{path}: row {number}" for number in range(len(rows))], str(path))


def _has_data(line: str) -> bool:
    return bool(line.strip()) and not line.lstrip().startswith("#")


def _number(text: Any, name: str, position: str) -> float:
    try:
        value = float(text)
    except (TypeError, ValueError):
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{position}: {name} is '{text}', which is not a finite number")
    return value
