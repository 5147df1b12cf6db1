"""Columns of the trials as arrays, read on demand, so that a million trials need not be in memory."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from simulator.study.trials.arrow import as_array, read_columns
from startracker.errors import BoresightError

CACHE_BYTES = 4_000_000
"""Memory of the cache of columns; the least recently used are dropped first."""


class Columns(Mapping[str, NDArray[Any]]):
    """Columns by name, each a read-only NumPy array; strings as arrays of objects.

    Parameters
    ----------
    source : pyarrow.Table or Path
        The trials, or their Parquet file.

    Raises
    ------
    KeyError
        For a missing column.
    BoresightError
        If the file has been changed.
    """

    def __init__(self, source: pa.Table | Path) -> None:
        self._source = source
        self._schema: pa.Schema = pq.read_schema(source) if isinstance(source, Path) else source.schema
        self._stamp = _stamp(source)
        self._cache: OrderedDict[str, NDArray[Any]] = OrderedDict()

    def __repr__(self) -> str:
        first = ", ".join(self._schema.names[:6])
        return f"Columns({len(self)} columns: {first}{', …' if len(self) > 6 else ''})"

    def __getitem__(self, name: str) -> NDArray[Any]:
        if name in self._cache:
            self._cache.move_to_end(name)
            return self._cache[name]
        if name not in self:
            raise KeyError(name)
        array = as_array(self._read(name))
        pa.default_memory_pool().release_unused()  # it retains tens of megabytes
        array.flags.writeable = False
        self._cache[name] = array
        while len(self._cache) > 1 and sum(_memory(kept) for kept in self._cache.values()) > CACHE_BYTES:
            self._cache.popitem(last=False)
        return array

    def __getstate__(self) -> dict[str, Any]:
        """Other processes read columns again instead of receiving them."""
        return self.__dict__ | {"_cache": OrderedDict()}

    def __iter__(self) -> Iterator[str]:
        return iter(self._schema.names)

    def __len__(self) -> int:
        return len(self._schema.names)

    def __contains__(self, name: object) -> bool:
        return name in self._schema.names

    def table(self) -> pa.Table:
        """All columns, in memory."""
        self._check()
        return read_columns(self._source) if isinstance(self._source, Path) else self._source

    def _read(self, name: str) -> pa.ChunkedArray:
        if not isinstance(self._source, Path):
            return self._source[name]
        self._check()
        strings = [name] if pa.types.is_string(self._schema.field(name).type) else []
        return read_columns(self._source, [name], strings)[name]

    def _check(self) -> None:
        if _stamp(self._source) != self._stamp:
            raise BoresightError(f"{self._source}: moved or changed since the study was loaded; load it again")


def _memory(array: NDArray[Any]) -> int:
    return array.nbytes * (10 if array.dtype == object else 1)  # a pointer, and at worst a separate string


def _stamp(source: pa.Table | Path) -> tuple[int, int] | None:
    if not isinstance(source, Path):
        return None
    try:
        status = source.stat()
    except OSError:
        return 0, 0
    return status.st_size, status.st_mtime_ns
