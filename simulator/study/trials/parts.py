"""The store of finished trials: Parquet parts named by the indices they hold, few and whole at any moment.

Each finished block is written at once as ``START-STOP.parquet``, beside and moved into place. Small parts that touch
are merged into larger ones as the run goes on: the merged part is in place before its members go, and a part whose
trials another one holds too is dropped, so that a kill between the two loses and doubles nothing.
"""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from simulator.paths import make_folder, open_atomically, write_atomically
from simulator.scenario import Scenario
from startracker._version import __version__
from startracker.errors import InputError

PARTS_FOLDER = ".trials-parts"
TRIALS_FILE = "trials.parquet"
MERGE_EVERY = 50
"""Parts that may come before those that touch are merged."""
MERGED_TRIALS = 50_000
"""Trials of a merged part at most: as many are in memory while it is made."""
ROW_GROUP_TRIALS = 10_000
"""Trials of a row group of ``trials.parquet``: the same whatever the parts."""
KEY = b"boresight.scenario.sha256"
"""Where ``trials.parquet`` says whose trials it holds."""

Key = tuple[int, int]
"""First index, and last + 1."""


class PartStore:
    """Finished trials of one scenario, in a folder or in memory.

    Parameters
    ----------
    scenario : Scenario
        Whose trials they are; their number may differ.
    folder : Path, optional
        Folder of the results; none: in memory.
    resume : bool
        Take over what is in `folder`: parts of an unfinished run, and the trials of a finished one. Parts that cannot
        be read are deleted, so that their trials are run again.

    Raises
    ------
    InputError
        For a resume from another scenario's parts, or a folder that cannot be written.
    """

    def __init__(self, scenario: Scenario, folder: Path | None, resume: bool) -> None:
        # more trials of the same scenario may join those that are done
        same = scenario.with_values(trials=1).fingerprint()
        self.key = hashlib.sha256(f"{__version__}\n{same}".encode()).hexdigest()
        self.folder = folder / PARTS_FOLDER if folder else None
        self._parts: dict[Key, Path | pa.Table] = {}
        self._unmerged = 0
        if folder is None or self.folder is None:
            return
        key_file = self.folder / "scenario.sha256"
        if not resume or not key_file.exists():
            shutil.rmtree(self.folder, ignore_errors=True)
            make_folder(self.folder)
            with nothing_lost():
                write_atomically(key_file, self.key)
        elif key_file.read_text(encoding="utf-8") != self.key:
            raise InputError(
                f"{folder}: its unfinished trials are of another scenario, seed or version; "
                "run without --resume, or choose another --out"
            )
        if resume:
            self._load(folder / TRIALS_FILE)

    def _load(self, finished: Path) -> None:
        assert self.folder is not None
        for litter in self.folder.glob(".*"):
            litter.unlink()
        found: dict[Key, Path] = {}
        for path in self.folder.glob("[0-9]*-[0-9]*.parquet"):
            start, stop = (int(number) for number in path.stem.split("-"))
            if _is_whole(path, start, stop):
                found[start, stop] = path
            else:
                path.unlink()
        end = 0
        for (start, stop), path in sorted(found.items(), key=lambda item: (item[0][0], -item[0][1])):
            if start >= end:
                self._parts[start, stop] = path
                end = stop
            else:  # a member of a merged part, left by a kill before it went
                path.unlink()
        trials = _trials_of(finished, self.key)
        within = [key for key in self._parts if key[0] < trials]
        # parts that reach across its end come of a run that began anew
        if self.missing(trials) and all(stop <= trials for _, stop in within):
            for key in within:
                found[key].unlink()
                del self._parts[key]
            self._parts[0, trials] = finished
        self._unmerged = len(self._parts)

    def missing(self, trials: int) -> list[range]:
        """Indices below `trials` that no part has, as ranges in ascending order."""
        edges = [(start, stop) for start, stop in sorted(self._parts) if start < trials]
        gaps = itertools.pairwise([(0, 0), *edges, (trials, trials)])
        return [range(left, right) for (_, left), (right, _) in gaps if left < right]

    def put(self, block: range, table: pa.Table) -> None:
        """Keep a finished block.

        Raises
        ------
        InputError
            When the disk is full or the folder is gone; what was kept before stays.
        """
        key = (block.start, block.stop)
        if self.folder is None:
            self._parts[key] = table
            return
        sink = pa.BufferOutputStream()
        pq.write_table(table, sink)
        path = self._path(key)
        with nothing_lost():
            write_atomically(path, sink.getvalue().to_pybytes(), durable=False)
        self._parts[key] = path
        self._unmerged += 1
        if self._unmerged >= MERGE_EVERY:
            self._merge()
            self._unmerged = 0

    def schema(self) -> pa.Schema:
        """Columns that hold every part: an integer column meets a real one as real numbers."""
        schemas = [
            pq.read_schema(part) if isinstance(part, Path) else part.schema
            for part in (self._parts[key] for key in sorted(self._parts))
        ]
        plain = [schema.remove_metadata() for schema in schemas]
        return pa.unify_schemas(plain, promote_options="permissive") if plain else pa.schema([("index", pa.int64())])

    def row_groups(self, trials: int) -> Iterator[pa.Table]:
        """The trials below `trials` by index, `ROW_GROUP_TRIALS` at a time; the cut does not depend on the parts."""
        schema = self.schema()
        kept: list[pa.Table] = []
        rows = 0
        for key in sorted(self._parts):
            for table in self._read(key, trials):
                kept.append(_cast(table, schema))
                rows += table.num_rows
                while rows >= ROW_GROUP_TRIALS:
                    whole = pa.concat_tables(kept)
                    yield whole.slice(0, ROW_GROUP_TRIALS).combine_chunks()
                    kept = [whole.slice(ROW_GROUP_TRIALS)]
                    rows -= ROW_GROUP_TRIALS
        if rows:
            yield pa.concat_tables(kept).combine_chunks()

    def write(self, path: Path, trials: int) -> None:
        """Write the trials below `trials` to one Parquet file, a row group in memory at a time.

        Raises
        ------
        InputError
            When it cannot be written.
        """
        schema = self.schema().with_metadata({KEY: self.key.encode()})
        with open_atomically(path) as stream, pq.ParquetWriter(stream, schema, compression="zstd") as writer:
            for table in self.row_groups(trials):
                writer.write_table(table.cast(schema), row_group_size=ROW_GROUP_TRIALS)
        pa.default_memory_pool().release_unused()

    def table(self, trials: int) -> pa.Table:
        """The trials below `trials`, in memory."""
        return pa.concat_tables([self.schema().empty_table(), *self.row_groups(trials)]).combine_chunks()

    def _read(self, key: Key, trials: int) -> Iterator[pa.Table]:
        part, left = self._parts[key], max(0, min(key[1], trials) - key[0])
        if not isinstance(part, Path):
            yield part.slice(0, left)
            return
        with pq.ParquetFile(part, pre_buffer=False) as file:
            for batch in file.iter_batches(ROW_GROUP_TRIALS):
                if left > 0:
                    yield pa.Table.from_batches([batch]).slice(0, left)
                left -= batch.num_rows

    def _path(self, key: Key) -> Path:
        assert self.folder is not None
        return self.folder / f"{key[0]:09d}-{key[1]:09d}.parquet"

    def _merge(self) -> None:
        """Merge parts that touch, a part with the smaller ones after it, so that each trial is rewritten few times."""
        groups: list[list[Key]] = []
        for key in sorted(self._parts, reverse=True):
            group = groups[-1] if groups else []
            rows = group[0][1] - group[-1][0] if group else 0
            size = key[1] - key[0]
            own = self._parts[key]
            touches = bool(group) and key[1] == group[-1][0] and isinstance(own, Path) and own.parent == self.folder
            if touches and size <= max(rows, MERGED_TRIALS // 100) and size + rows <= MERGED_TRIALS:
                group.append(key)
            else:
                groups.append([key])
        for group in groups:
            if len(group) > 1:
                self._merge_group(sorted(group))

    def _merge_group(self, keys: list[Key]) -> None:
        merged = (keys[0][0], keys[-1][1])
        tables = [table for key in keys for table in self._read(key, merged[1])]
        path = self._path(merged)
        with nothing_lost(), open_atomically(path) as stream:
            pq.write_table(
                pa.concat_tables(tables, promote_options="permissive"), stream, row_group_size=ROW_GROUP_TRIALS
            )
        members = [self._parts.pop(key) for key in keys]
        self._parts[merged] = path
        for member in members:
            assert isinstance(member, Path)
            member.unlink(missing_ok=True)


@contextlib.contextmanager
def nothing_lost() -> Iterator[None]:
    """What cannot be written says that nothing finished is lost."""
    try:
        yield
    except InputError as error:
        reason = str(error).removesuffix("; choose another place")
        raise InputError(
            f"{reason}; the finished trials are kept: make room there and run again with --resume"
        ) from error


def discard_parts(folder: Path) -> None:
    """Remove the blocks of a finished run, once its results stand in their place."""
    shutil.rmtree(folder / PARTS_FOLDER, ignore_errors=True)


def _is_whole(path: Path, start: int, stop: int) -> bool:
    """Whether a part can be read and holds the trials that its name says."""
    try:
        index = pq.read_table(path, columns=["index"])["index"].to_numpy()
    except (OSError, pa.ArrowException, KeyError):
        return False
    return np.array_equal(index, np.arange(start, stop))


def _trials_of(path: Path, key: str) -> int:
    """Number of trials, from the first on, of an earlier run's results; 0 where they are another scenario's."""
    try:
        metadata = pq.read_schema(path).metadata or {}
        if metadata.get(KEY) != key.encode():
            return 0
        index = pq.read_table(path, columns=["index"])["index"].to_numpy()
    except (OSError, pa.ArrowException, KeyError):
        return 0
    return len(index) if np.array_equal(index, np.arange(len(index))) else 0


def _cast(table: pa.Table, schema: pa.Schema) -> pa.Table:
    names = set(table.column_names)
    columns = [
        table[field.name].cast(field.type) if field.name in names else pa.nulls(table.num_rows, field.type)
        for field in schema
    ]
    return pa.table(columns, schema=schema)
