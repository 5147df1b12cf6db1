"""The store of finished trials: Parquet parts named by the indices they hold, few and whole at any moment.

Each finished block is written at once as ``START-STOP-CHECKSUM.parquet``, beside and moved into place. Small parts that
touch are merged into larger ones as the run goes on: the merged part is in place before its members go, and a part
whose trials another one holds too is dropped, so that a kill between the two loses and doubles nothing. A part whose
contents no longer match its checksum is set aside, and its trials are missing again.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import re
import shutil
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from simulator.paths import make_folder, open_atomically, write_atomically
from simulator.scenario import Scenario
from simulator.study.result_files import parquet_bytes
from simulator.study.results_folder import (
    IDENTITY_FILE,
    Identity,
    refuse_other,
    scenario_sha256,
    unfinished_identity,
)
from simulator.study.trials.checked_files import fault_of, file_sha256, set_aside, write_checked
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

_NAME = re.compile(r"(\d+)-(\d+)-([0-9a-f]{16})\.parquet")

Key = tuple[int, int]
"""First index, and last + 1."""


def run_identity(scenario: Scenario, trials: int) -> Identity:
    """Identity of a Monte Carlo run of so many trials."""
    return Identity("run", scenario.name, scenario.seed, scenario_sha256(scenario), {"trials": trials})


class PartStore:
    """Finished trials of one scenario, in a folder or in memory.

    Parameters
    ----------
    scenario : Scenario
        Whose trials they are; their number may differ.
    folder : Path, optional
        Folder of the results; none: in memory.
    resume : bool
        Take over the trials of a finished run in `folder` too, not only the parts of an unfinished one.
    force : bool
        Discard what is in `folder`.

    Attributes
    ----------
    notes : list of str
        A sentence for every damaged file that was found.

    Raises
    ------
    InputError
        For another scenario's parts, or a folder that cannot be written.
    """

    def __init__(self, scenario: Scenario, folder: Path | None, resume: bool, force: bool = False) -> None:
        self.identity = run_identity(scenario, scenario.study.trials)
        self.folder = folder / PARTS_FOLDER if folder else None
        self.notes: list[str] = []
        self._parts: dict[Key, Path | pa.Table] = {}
        self._finished_checksum = ""
        self._unmerged = 0
        if folder is None or self.folder is None:
            return
        if force:
            discard_parts(folder)
        make_folder(self.folder)
        unfinished = unfinished_identity(self.folder, "run")
        if unfinished is not None and unfinished.sha256 != self.key:
            refuse_other(folder, unfinished, self.identity, "unfinished trials")
        with nothing_lost():
            write_atomically(self.folder / IDENTITY_FILE, json.dumps({"identity": self.identity.to_dict()}))
        self._load()
        if resume:
            self._take_over(folder)
        self._unmerged = len(self._parts)

    @property
    def key(self) -> str:
        """SHA-256 that distinguishes these trials from those of another scenario, seed or version."""
        return self.identity.sha256

    def _load(self) -> None:
        assert self.folder is not None
        for litter in self.folder.glob(".*"):
            litter.unlink()
        found: dict[Key, Path] = {}
        for path in sorted(self.folder.glob("[0-9]*.parquet")):
            name = _NAME.fullmatch(path.name)
            if fault := fault_of(path) if name else "is no part of this version":
                self._set_aside(path, fault)
            elif name:
                found[int(name[1]), int(name[2])] = path
        end = 0
        for (start, stop), path in sorted(found.items(), key=lambda item: (item[0][0], -item[0][1])):
            if start >= end:
                self._parts[start, stop] = path
                end = stop
            else:  # a member of a merged part, left by a kill before it went
                path.unlink()

    def _take_over(self, folder: Path) -> None:
        """Take over the trials of a finished run of this scenario."""
        finished = folder / TRIALS_FILE
        trials = self._finished_trials(finished)
        within = [key for key in self._parts if key[0] < trials]
        # parts that reach across its end come of a run that began anew
        if self.missing(trials) and all(stop <= trials for _, stop in within):
            for key in within:
                part = self._parts.pop(key)
                assert isinstance(part, Path)
                part.unlink()
            self._parts[0, trials] = finished

    def _finished_trials(self, path: Path) -> int:
        """Number of trials of an earlier run's results; 0 where they are another scenario's, or damaged."""
        if not path.exists():
            return 0
        try:
            summary = json.loads((path.parent / "summary.json").read_text(encoding="utf-8"))
            self._finished_checksum = str(summary["trials_sha256"])
        except (OSError, ValueError, KeyError, TypeError):
            return 0
        if fault := fault_of(path, self._finished_checksum):
            # a run that was killed while its results were moved into place: the parts have all of its trials
            if not (self.folder and (self.folder / TRIALS_FILE).exists()):
                self._set_aside(path, fault)
            return 0
        with pq.ParquetFile(path) as file:
            return file.metadata.num_rows if (file.schema_arrow.metadata or {}).get(KEY) == self.key.encode() else 0

    def refuse_fewer(self, trials: int) -> None:
        """Refuse a run that would discard unfinished trials beyond its own.

        Raises
        ------
        InputError
            Where parts hold more than the first `trials` trials.
        """
        if self.folder is None:
            return
        own = [stop for (_, stop), part in self._parts.items() if isinstance(part, Path) and part.parent == self.folder]
        if own and max(own) > trials:
            old, new = (replace(self.identity, amounts={"trials": number}) for number in (max(own), trials))
            refuse_other(self.folder.parent, old, new, "unfinished trials")

    def check(self, keys: Iterable[Key] | None = None) -> bool:
        """Whether every part, or those of `keys`, is as it was written; those that are not are set aside."""
        some = self._parts if keys is None else keys
        files = {key: part for key in some if isinstance(part := self._parts[key], Path)}
        faults = {
            key: fault_of(part, None if part.parent == self.folder else self._finished_checksum)
            for key, part in files.items()
        }
        for key, fault in faults.items():
            if fault:
                del self._parts[key]
                self._set_aside(files[key], fault)
        return not any(faults.values())

    def _set_aside(self, path: Path, fault: str) -> None:
        assert self.folder is not None
        self.notes.append(set_aside(path, fault, self.folder.parent))

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
        self._keep(key, table, durable=False)
        self._unmerged += 1
        if self._unmerged >= MERGE_EVERY:
            self._merge()
            self._unmerged = 0

    def _keep(self, key: Key, table: pa.Table, *, durable: bool) -> None:
        """Write trials as a part with its checksum in its name."""
        assert self.folder is not None
        data = parquet_bytes(table, row_group_size=ROW_GROUP_TRIALS)
        with nothing_lost():
            self._parts[key] = write_checked(self.folder, f"{key[0]:09d}-{key[1]:09d}", data, durable=durable)

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

    def write(self, path: Path, trials: int) -> str:
        """Write the trials below `trials` to one Parquet file, a row group in memory at a time; its SHA-256.

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
        return file_sha256(path)

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
        if not self.check(keys):
            return
        tables = [table for key in keys for table in self._read(key, keys[-1][1])]
        members = [self._parts.pop(key) for key in keys]
        self._keep((keys[0][0], keys[-1][1]), pa.concat_tables(tables, promote_options="permissive"), durable=True)
        for member in members:
            assert isinstance(member, Path)
            member.unlink(missing_ok=True)


@contextlib.contextmanager
def nothing_lost() -> Iterator[None]:
    """What cannot be written says that nothing finished is lost."""
    try:
        yield
    except InputError as error:
        reason = str(error).removesuffix("; choose another path")
        raise InputError(
            f"{reason}; the finished trials are kept: make room there and run again with --resume"
        ) from error


def discard_parts(folder: Path) -> None:
    """Remove the blocks of a finished run, once its results have replaced them."""
    shutil.rmtree(folder / PARTS_FOLDER, ignore_errors=True)


def _cast(table: pa.Table, schema: pa.Schema) -> pa.Table:
    names = set(table.column_names)
    columns = [
        table[field.name].cast(field.type) if field.name in names else pa.nulls(table.num_rows, field.type)
        for field in schema
    ]
    return pa.table(columns, schema=schema)
