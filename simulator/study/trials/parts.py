"""Store of finished trials: Parquet parts named by their indices, complete at any moment.

Each finished block is written atomically as ``START-STOP-CHECKSUM.parquet``. Small adjacent parts are merged during the
run: the merged part is written before its members are deleted, and a part whose trials are contained in another one is
dropped, so that a kill in between neither loses nor duplicates trials. A part that does not match its checksum is moved
aside, and its trials are computed again.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import re
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
    remove_unfinished,
    scenario_sha256,
    unfinished_identity,
)
from simulator.study.trials.checked_files import fault_of, file_sha256, set_aside, write_checked
from startracker.errors import InputError

PARTS_FOLDER = ".trials-parts"
TRIALS_FILE = "trials.parquet"
MERGE_EVERY = 50
"""Number of parts before adjacent ones are merged."""
MERGED_TRIALS = 50_000
"""Maximum number of trials of a merged part, which are in memory during the merge."""
ROW_GROUP_TRIALS = 10_000
"""Trials per row group of ``trials.parquet``, independent of the parts."""
KEY = b"boresight.scenario.sha256"
"""Metadata key of the identity in ``trials.parquet``."""

_NAME = re.compile(r"(\d+)-(\d+)-([0-9a-f]{16})\.parquet")

Key = tuple[int, int]
"""First index, and last index + 1."""


def run_identity(scenario: Scenario, trials: int) -> Identity:
    """Identity of a Monte Carlo run with a number of trials."""
    return Identity("run", scenario.name, scenario.seed, scenario_sha256(scenario), {"trials": trials})


class PartStore:
    """Finished trials of one scenario, in a folder or in memory.

    Parameters
    ----------
    scenario : Scenario
        Scenario of the trials; their number may differ.
    folder : Path, optional
        Folder of the results; None: in memory.
    resume : bool
        Also reuse the trials of a finished run in `folder`, not only the parts of an unfinished one.
    force : bool
        Discard the content of `folder`.

    Attributes
    ----------
    notes : list of str
        A message for every damaged file.

    Raises
    ------
    InputError
        For parts of another scenario, or a folder that cannot be written.
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
        """SHA-256 of scenario, seed and version of these trials."""
        return self.identity.sha256

    def _load(self) -> None:
        assert self.folder is not None
        for litter in self.folder.glob(".*"):
            litter.unlink()
        found: dict[Key, Path] = {}
        for path in sorted(self.folder.glob("[0-9]*.parquet")):
            name = _NAME.fullmatch(path.name)
            if fault := fault_of(path) if name else "is not a part of this version":
                self._set_aside(path, fault)
            elif name:
                found[int(name[1]), int(name[2])] = path
        end = 0
        for (start, stop), path in sorted(found.items(), key=lambda item: (item[0][0], -item[0][1])):
            if start >= end:
                self._parts[start, stop] = path
                end = stop
            else:  # a member of a merged part that was not deleted because of a kill
                path.unlink()

    def _take_over(self, folder: Path) -> None:
        """Reuse the trials of a finished run of this scenario."""
        finished = folder / TRIALS_FILE
        trials = self._finished_trials(finished)
        within = [key for key in self._parts if key[0] < trials]
        # parts beyond its end are from a new run
        if self.missing(trials) and all(stop <= trials for _, stop in within):
            for key in within:
                part = self._parts.pop(key)
                assert isinstance(part, Path)
                part.unlink()
            self._parts[0, trials] = finished

    def _finished_trials(self, path: Path) -> int:
        """Number of trials in the results of an earlier run; 0 if they are of another scenario or damaged."""
        if not path.exists():
            return 0
        try:
            summary = json.loads((path.parent / "summary.json").read_text(encoding="utf-8"))
            self._finished_checksum = str(summary["trials_sha256"])
        except (OSError, ValueError, KeyError, TypeError):
            return 0
        if fault := fault_of(path, self._finished_checksum):
            # a run killed while its results were moved: the parts contain all of its trials
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
            If parts contain trials beyond the first `trials`.
        """
        if self.folder is None:
            return
        own = [stop for (_, stop), part in self._parts.items() if isinstance(part, Path) and part.parent == self.folder]
        if own and max(own) > trials:
            old, new = (replace(self.identity, amounts={"trials": number}) for number in (max(own), trials))
            refuse_other(self.folder.parent, old, new, "unfinished trials")

    def check(self, keys: Iterable[Key] | None = None) -> bool:
        """Whether all parts, or those of `keys`, are intact; damaged ones are moved aside."""
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
        """Indices below `trials` without a part, as ranges in ascending order."""
        edges = [(start, stop) for start, stop in sorted(self._parts) if start < trials]
        gaps = itertools.pairwise([(0, 0), *edges, (trials, trials)])
        return [range(left, right) for (_, left), (right, _) in gaps if left < right]

    def put(self, block: range, table: pa.Table) -> None:
        """Store a finished block.

        Raises
        ------
        InputError
            If the disk is full or the folder is missing; earlier blocks are kept.
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
        """Write trials as a part, with the checksum in its name."""
        assert self.folder is not None
        data = parquet_bytes(table, row_group_size=ROW_GROUP_TRIALS)
        with nothing_lost():
            self._parts[key] = write_checked(self.folder, f"{key[0]:09d}-{key[1]:09d}", data, durable=durable)

    def schema(self) -> pa.Schema:
        """Common columns of all parts; integer and floating-point columns become floating point."""
        schemas = [
            pq.read_schema(part) if isinstance(part, Path) else part.schema
            for part in (self._parts[key] for key in sorted(self._parts))
        ]
        plain = [schema.remove_metadata() for schema in schemas]
        return pa.unify_schemas(plain, promote_options="permissive") if plain else pa.schema([("index", pa.int64())])

    def row_groups(self, trials: int) -> Iterator[pa.Table]:
        """The trials below `trials` by index, `ROW_GROUP_TRIALS` at a time, independent of the parts."""
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
        """Write the trials below `trials` to a Parquet file, with one row group in memory at a time; returns its
        SHA-256.

        Raises
        ------
        InputError
            If it cannot be written.
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
        """Merge adjacent parts, each with the smaller ones after it, so that each trial is rewritten only a few
        times."""
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
    """Add to write errors that finished trials are kept."""
    try:
        yield
    except InputError as error:
        reason = str(error).removesuffix("; choose another path")
        raise InputError(
            f"{reason}; finished trials are kept: free some disk space and run again with --resume"
        ) from error


def discard_parts(folder: Path) -> None:
    """Remove the blocks of a finished run after its results are written."""
    remove_unfinished(folder / PARTS_FOLDER)


def _cast(table: pa.Table, schema: pa.Schema) -> pa.Table:
    names = set(table.column_names)
    columns = [
        table[field.name].cast(field.type) if field.name in names else pa.nulls(table.num_rows, field.type)
        for field in schema
    ]
    return pa.table(columns, schema=schema)
