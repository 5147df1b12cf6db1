"""Tables from rows and columns as arrays, compared with the conversions of PyArrow."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from simulator.study.trials.arrow import as_array, as_column, read_columns, table_of
from startracker.errors import InputError

COLUMNS = {
    "whole": [3, -(2**40), 0, 7, 1, 2, 5, 8, 9, 4],
    "whole_or_none": [3, None, 0, 7, 1, 2, None, 8, 9, 4],
    "real": [0.1, float("nan"), float("inf"), -0.0, 1e300, 5.0, 6.0, 7.0, 8.0, 9.0],
    "mixed": [1, 2.5, None, 4, 5, 6, 7, 8, 9, 10],
    "true": [True, False, True, True, False, False, True, False, True, True],
    "true_or_none": [True, None, True, True, False, False, True, False, True, None],
    "text": ["a", "", "öß", "a", "星", "b", "a", "", "c", "b"],
    "text_or_none": ["a", None, "öß", "a", "星", None, "a", "", "c", "b"],
    "nothing": [None] * 10,
    "list": [[1, 2], [], [3], None, [4], [5], [6], [7], [8], [9]],
}
ROWS = [dict(zip(COLUMNS, row, strict=True)) for row in zip(*COLUMNS.values(), strict=True)]


def test_table_is_that_of_pyarrow() -> None:
    table, expected = table_of(ROWS), pa.Table.from_pylist(ROWS)
    table.validate(full=True)
    assert table.schema == expected.schema
    for name in COLUMNS:
        assert repr(table[name].to_pylist()) == repr(expected[name].to_pylist())
    assert table_of([]).equals(pa.Table.from_pylist([]))
    assert as_column([np.float32(1.5)]).equals(pa.array([np.float32(1.5)]))


@pytest.mark.parametrize("name", [name for name in COLUMNS if name != "list"])
def test_array_is_that_of_pyarrow(name: str, tmp_path: Path) -> None:
    expected = pa.Table.from_pylist(ROWS)
    pq.write_table(expected, tmp_path / "rows.parquet", row_group_size=3)
    read, coded = read_columns(tmp_path / "rows.parquet"), read_columns(tmp_path / "rows.parquet", [name], [name])
    for column in (expected[name], expected[name].slice(3, 6), read[name], read[name].slice(2, 7)):
        ours, theirs = as_array(column), np.array(column.to_numpy())
        assert ours.dtype == theirs.dtype
        np.testing.assert_array_equal(ours, theirs)
    if name.startswith("text"):
        np.testing.assert_array_equal(as_array(coded[name]), np.array(COLUMNS[name], dtype=object))


def test_missing_column_is_named(tmp_path: Path) -> None:
    pq.write_table(table_of(ROWS), tmp_path / "rows.parquet")
    assert read_columns(tmp_path / "rows.parquet", ["real", "whole"]).column_names == ["real", "whole"]
    with pytest.raises(InputError, match="the column 'absent' is missing"):
        read_columns(tmp_path / "rows.parquet", ["absent"])


def test_pandas_is_not_imported(tmp_path: Path) -> None:
    pytest.importorskip("pandas")
    script = f"""
import sys
from pathlib import Path
import pyarrow.parquet as pq
from simulator.study.trials.columns import Columns
from simulator.study.trials.arrow import table_of
file = Path({str(tmp_path / "rows.parquet")!r})
rows = [{{"n": 1, "x": 0.5, "ok": True, "status": "solved"}}, {{"n": 2, "x": 1.5, "ok": False, "status": "solved"}}]
pq.write_table(table_of(rows), file)
found = Columns(file)
assert [found[name].tolist() for name in found] == [[1, 2], [0.5, 1.5], [True, False], ["solved", "solved"]]
assert "pandas" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", script], check=True)
