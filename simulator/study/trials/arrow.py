"""Tables of Arrow from rows, and columns as NumPy arrays.

PyArrow imports pandas for its own conversions if it is installed, which takes 36 MB in every process. Columns of
numbers, truth values and strings are therefore exchanged as buffers of Arrow; all others are left to PyArrow.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import DTypeLike, NDArray

from startracker.errors import InputError

_FLOATS = {"halffloat": "float16", "float": "float32", "double": "float64"}
"""Names of Arrow's floating-point types in NumPy; those of integers are equal."""


def table_of(rows: Sequence[dict[str, Any]]) -> pa.Table:
    """Table with the columns of the first row, as `pyarrow.Table.from_pylist`."""
    names = list(rows[0]) if rows else []
    return pa.Table.from_arrays([as_column([row.get(name) for row in rows]) for name in names], names)


def as_column(values: Sequence[Any]) -> pa.Array:
    """Python values as an Arrow array of the type that PyArrow infers; None is null."""
    kinds = set(map(type, values)) - {type(None)}
    if not kinds:
        return pa.nulls(len(values))
    known = [value is not None for value in values]
    valid = None if all(known) else _bits(known)
    if kinds == {bool}:
        return pa.Array.from_buffers(pa.bool_(), len(values), [valid, _bits(map(bool, values))])
    if kinds == {int}:
        return _numbers(values, valid, pa.int64(), np.int64)
    if kinds <= {int, float}:
        return _numbers(values, valid, pa.float64(), np.float64)
    if kinds == {str}:
        encoded = [(value or "").encode() for value in values]
        ends = np.cumsum([0, *map(len, encoded)])
        if ends[-1] < np.iinfo(np.int32).max:
            buffers = [valid, pa.py_buffer(ends.astype(np.int32)), pa.py_buffer(b"".join(encoded))]
            return pa.Array.from_buffers(pa.string(), len(values), buffers)
    return pa.array(values)


def _numbers(values: Iterable[Any], valid: pa.Buffer | None, kind: pa.DataType, dtype: DTypeLike) -> pa.Array:
    numbers = np.array([0 if value is None else value for value in values], dtype=dtype)
    return pa.Array.from_buffers(kind, len(numbers), [valid, pa.py_buffer(numbers)])


def _bits(flags: Iterable[bool]) -> pa.Buffer:
    return pa.py_buffer(np.packbits(list(flags), bitorder="little"))


def as_array(column: pa.ChunkedArray) -> NDArray[Any]:
    """A column as an array; equal strings are one object."""
    if pa.types.is_string(column.type):
        column = column.dictionary_encode()
    convert: Callable[[pa.Array], NDArray[Any]] | None = None
    if column.null_count:
        if pa.types.is_dictionary(column.type):
            return np.array(column.to_pylist(), dtype=object)
    elif pa.types.is_dictionary(column.type):
        convert = _strings
    elif pa.types.is_boolean(column.type):
        convert = _truth_values
    elif pa.types.is_integer(column.type) or pa.types.is_floating(column.type):
        convert = _plain
    if convert is None or not column.num_chunks:
        return np.array(column.to_numpy())
    return np.concatenate([convert(chunk) for chunk in column.chunks])


def _plain(chunk: pa.Array) -> NDArray[Any]:
    name = str(chunk.type)  # not its to_pandas_dtype, for which older versions of PyArrow need pandas
    dtype = np.dtype(_FLOATS.get(name, name))
    return np.frombuffer(chunk.buffers()[1], dtype)[chunk.offset :][: len(chunk)]


def _truth_values(chunk: pa.Array) -> NDArray[Any]:
    bits = np.unpackbits(np.frombuffer(chunk.buffers()[1], np.uint8), bitorder="little")
    return bits[chunk.offset :][: len(chunk)].astype(bool)


def _strings(chunk: pa.DictionaryArray) -> NDArray[Any]:
    values = np.array(chunk.dictionary.to_pylist(), dtype=object)
    return np.asarray(values[_plain(chunk.indices)])


def read_columns(
    file: Path, columns: list[str] | None = None, read_dictionary: Sequence[str] = (), optional: Sequence[str] = ()
) -> pa.Table:
    """Columns of a Parquet file, and those of `optional` that it has; those of `read_dictionary` with each distinct
    value once.

    Raises
    ------
    pyarrow.ArrowException, OSError
        If the file cannot be read.
    InputError
        If a column is missing.
    """
    with pq.ParquetFile(file, read_dictionary=list(read_dictionary)) as opened:
        missing = [name for name in columns or () if name not in opened.schema_arrow.names]
        if missing:
            raise InputError(f"{file}: the column '{missing[0]}' is missing; was it written by another version?")
        if columns is not None:
            columns = [*columns, *(name for name in optional if name in opened.schema_arrow.names)]
        table = opened.read(columns=columns)
    return table if columns is None else table.select(columns)
