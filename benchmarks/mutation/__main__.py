"""``python -m benchmarks.mutation``: plant faults one at a time, run the tests of their area, count those noticed."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import datetime
import functools
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Container, Iterable
from dataclasses import dataclass
from pathlib import Path

from benchmarks.mutation.areas import AREAS, Area
from benchmarks.mutation.faults import Fault, faults_of
from benchmarks.mutation.plan import Plan, Planner
from benchmarks.mutation.recording import VARIABLE
from benchmarks.mutation.references import References
from simulator.study.statistics import wilson_interval

ROOT = Path(__file__).resolve().parents[2]
KNOWN_EQUIVALENT = Path(__file__).with_name("equivalent.txt")
"""Faults that change nothing which a user can observe: ``path | line of the source | before → after | reason``."""
_PACKAGES = ("simulator", "startracker")
_SLOWER = 4.0
"""A fault whose tests take this many times longer is noticed: it is an endless loop."""
_PASSED, _NOT_FOUND = 0, 4
"""Exit statuses of pytest."""
_CODE = ("*.nb[ic]", "*.sources")
"""Files of the kernels' machine code, and of the digests of the sources that it was compiled from, without which the
packages discard it."""


def code_files(root: Path) -> list[Path]:
    """Machine code in the packages of a checkout, and its digests."""
    return [path for package in _PACKAGES for pattern in _CODE for path in (root / package).rglob(pattern)]


class Copy:
    """A copy of the checkout in which faults are planted, with the caches of the kernels."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.output = folder, folder / "tests.log"
        listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True, text=True)
        for name in filter(None, listed.stdout.split("\0")):
            if (ROOT / name).is_file():
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(ROOT / name, folder / name)
        for path in code_files(ROOT):
            target = folder / path.relative_to(ROOT)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(path, target)

    def passes(self, tests: Iterable[str], limit_s: float, record: Path | None = None) -> bool:
        """Whether the tests pass within a time; tests that are killed, by the system or by a crash, do not.

        With `record`, the functions that they call are written to that file.
        """
        return self._status(tests, limit_s, record) == _PASSED

    def notices(self, fault: Fault, plan: Plan) -> bool:
        """Whether the tests fail with a fault; the copy is as before afterwards."""
        path = self.folder / fault.path
        kept = {file: file.read_bytes() for file in code_files(self.folder)}
        self._discard(plan.stale)
        source = path.read_bytes()
        times = path.stat()
        limit_s = 60.0 + _SLOWER * plan.seconds
        try:
            path.write_bytes(fault.planted(source))
            status = self._status(plan.first, limit_s) if plan.first else _PASSED
            if status == _NOT_FOUND:  # a test is no longer there, or its file cannot be imported
                status = self._status(dict.fromkeys(name.partition("::")[0] for name in plan.first), limit_s)
            if status == _PASSED and plan.then:
                status = self._status(plan.then, limit_s)
            return status != _PASSED
        finally:
            path.write_bytes(source)
            # numba compares the time of the file with that in the cache
            os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
            self._restore(kept)

    def _status(self, tests: Iterable[str], limit_s: float, record: Path | None = None) -> int | None:
        """Exit status of pytest, or none if it did not end."""
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:xdist", "-p", "no:cacheprovider", *tests]
        environment = {"PYTHONPATH": str(self.folder), "PATH": "/usr/bin:/bin", "HOME": str(self.folder)}
        environment["OPENBLAS_NUM_THREADS"] = "1"
        if record is not None:
            command[4:4] = ["-p", "benchmarks.mutation.recording"]
            environment[VARIABLE] = str(record)
        # a session of its own, so that programs which the tests started end with them, and Ctrl-C reaches only this one
        with (
            open(self.output, "wb") as output,
            subprocess.Popen(
                command,
                cwd=self.folder,
                env=environment,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            ) as tests_running,
        ):
            try:
                return tests_running.wait(limit_s)
            except subprocess.TimeoutExpired:
                return None
            finally:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(tests_running.pid, signal.SIGKILL)

    def _discard(self, files: Iterable[Path]) -> None:
        """Remove the machine code of files, which numba would not compile again."""
        for path in (self.folder / file for file in files):
            for cache in path.parent.glob(f"__pycache__/{path.stem}.*.nb[ic]"):
                cache.unlink()

    def _restore(self, kept: dict[Path, bytes]) -> None:
        """Machine code as it was: with a fault, the packages discard that of every file which imports the changed
        one."""
        for file in code_files(self.folder):
            if kept.get(file) != file.read_bytes():
                file.unlink()
        for file, text in kept.items():
            if not file.exists():
                file.write_bytes(text)


def sample(area: Area, root: Path, count: int, seed: str) -> list[Fault]:
    """Faults of an area drawn at random without repetition."""
    found = [fault for path in area.files(root) for fault in faults_of(path, (root / path).read_bytes())]
    return random.Random(seed).sample(found, min(count, len(found)))


def named(area: Area, root: Path, begin: str) -> list[Fault]:
    """Faults of an area whose description begins with a text."""
    found = [fault for path in area.files(root) for fault in faults_of(path, (root / path).read_bytes())]
    return [fault for fault in found if str(fault).startswith(begin)]


def known_equivalent() -> dict[str, str]:
    """Faults of today's files that change nothing, with the reason of each.

    Raises
    ------
    ValueError
        For an entry of a line that is no longer there.
    """
    found: dict[str, str] = {}
    for row in KNOWN_EQUIVALENT.read_text(encoding="utf-8").splitlines():
        path, rest = row.split(" | ", 1)
        text, change, reason = rest.rsplit(" | ", 2)
        same = [fault for fault in _faults_in(Path(path)) if (fault.text, fault.change) == (text, change)]
        if not same:
            raise ValueError(f"{KNOWN_EQUIVALENT.name}: no such fault: {row}")
        found |= {str(fault): reason for fault in same}
    return found


@functools.cache
def _faults_in(path: Path) -> list[Fault]:
    return faults_of(path, (ROOT / path).read_bytes()) if (ROOT / path).is_file() else []


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.mutation", description=__doc__)
    parser.add_argument("--area", action="append", choices=AREAS, help="only this area; may be repeated")
    parser.add_argument("--faults", type=int, default=20, help="faults of each area")
    parser.add_argument("--seed", default="1", help="of the choice of faults")
    parser.add_argument("--fault", metavar="TEXT", help="instead of a sample, those whose description begins so")
    parser.add_argument("--state", type=Path, help="folder with the outcomes so far: a run continues where it ended")
    parser.add_argument("--report", action="store_true", help="only the page, from the outcomes of all runs in --state")
    parser.add_argument(
        "--before", type=Path, help="folder as --state, of an earlier sample, for comparison on the page"
    )
    parser.add_argument("--out", type=Path, help="page to write, Markdown")
    given = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with contextlib.ExitStack() as stack:
        folder = given.state or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        folder.mkdir(parents=True, exist_ok=True)
        try:
            if not given.report:
                measure(given.area or list(AREAS), given.faults, given.seed, given.fault, folder)
        except KeyboardInterrupt:
            print("interrupted; the faults so far:")
        text = page(read_states(folder), read_states(given.before) if given.before else [])
    if given.out:
        given.out.write_text(text, encoding="utf-8")
    print(text)


def measure(areas: Iterable[str], count: int, seed: str, begin: str | None, state: Path) -> None:
    """Plant faults of each area, and add the outcomes to its file in the folder `state`."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Copy(Path(folder))
        references = References(copy.folder, [path.relative_to(ROOT) for path in package_files()])
        for name in areas:
            area = AREAS[name]
            faults = named(area, copy.folder, begin) if begin else sample(area, copy.folder, count, f"{seed} {name}")
            path = state / f"{name}.json"
            done = read_state(path) if path.exists() else State(name, seed, [])
            if done.seed != seed:
                raise SystemExit(f"{path} has the faults of seed {done.seed}")
            left = faults[len(done.outcomes) :]
            if not left:
                continue
            record, tests = copy.folder / f"{name}.calls", area.test_files(copy.folder)
            if not copy.passes(tests, 3600.0, record):
                output = copy.output.read_text(encoding="utf-8", errors="replace")
                raise SystemExit(f"the tests of {name} fail without a fault:\n{output[-2000:]}")
            planner = Planner(copy.folder, references, record)
            for fault in left:
                noticed = copy.notices(fault, planner.plan(fault))
                done.outcomes.append((str(fault), noticed))
                path.write_text(json.dumps(dataclasses.asdict(done), ensure_ascii=False, indent=0), encoding="utf-8")
                print(f"{name}: {'noticed' if noticed else 'UNNOTICED'}: {fault}", flush=True)


def package_files() -> list[Path]:
    """Python files of the packages."""
    return sorted(path for package in _PACKAGES for path in (ROOT / package).rglob("*.py"))


@dataclass
class State:
    """Outcomes of an area so far: each fault, and whether it was noticed."""

    area: str
    seed: str
    outcomes: list[tuple[str, bool]]


def read_state(path: Path) -> State:
    """The outcomes in a file."""
    return State(**json.loads(path.read_text(encoding="utf-8")))


def read_states(folder: Path) -> list[State]:
    """The outcomes of all areas in a folder, in the order of `AREAS`."""
    return [read_state(folder / f"{name}.json") for name in AREAS if (folder / f"{name}.json").exists()]


def page(states: list[State], before: list[State]) -> str:
    """The result as Markdown, beside that of earlier samples."""
    equivalent = known_equivalent()
    day = datetime.datetime.now(datetime.UTC).date()
    earlier = {state.area: state for state in before}
    lines = [
        "# Planted faults",
        "",
        f"`python -m benchmarks.mutation`, {day}. One operator, constant or term of a guard is changed at a time,",
        "drawn at random from all that an area has; a fault is noticed if a test of the area fails. Faults that change",
        "nothing which a user can observe do not count. The last column is the 95 % confidence interval of the share.",
        "",
    ]
    if before:
        lines += [
            "The share before is that of an earlier sample, whose faults led to new tests; the second has new faults.",
            "A sample without one is the first: it shows an area before the tests that its faults led to.",
            "",
        ]
    lines += [
        f"| area | {'before | ' if before else ''}seed | faults | equivalent | noticed | share | 95 % |",
        f"|---|{'---|' if before else ''}---|---|---|---|---|---|",
    ]
    missed, same = [], []
    for state in states:
        unnoticed = [fault for fault, noticed in state.outcomes if not noticed]
        missed += [f"- `{fault}`" for fault in unnoticed if fault not in equivalent]
        same += [f"- `{fault}`: {equivalent[fault]}" for fault in unnoticed if fault in equivalent]
        noticed, counted = counts(state, equivalent)
        low, high = wilson_interval(noticed, max(counted, 1))
        old = ""
        if before:
            was = earlier.get(state.area)
            old = f"{_share(*counts(was, equivalent))} | " if was and was.seed != state.seed else " | "
        total = len(state.outcomes)
        interval = f"{100 * low:.0f} to {100 * high:.0f} %"
        row = f"{state.seed} | {total} | {total - counted} | {noticed} | {_share(noticed, counted)} | {interval}"
        lines.append(f"| {state.area} | {old}{row} |")
    left_out = [name for name in AREAS if name not in {state.area for state in states}]
    lines += ["", f"Not measured in these runs: {', '.join(left_out)}."] if left_out else []
    lines += ["", "Not noticed:", "", *(missed or ["none"])]
    lines += ["", "Equivalent, with the reason:", "", *same] if same else []
    return "\n".join(lines) + "\n"


def counts(state: State, equivalent: Container[str]) -> tuple[int, int]:
    """Faults that were noticed, and those that can be."""
    noticed = sum(found for _, found in state.outcomes)
    return noticed, noticed + sum(not found and fault not in equivalent for fault, found in state.outcomes)


def _share(noticed: int, counted: int) -> str:
    return f"{100 * noticed / max(counted, 1):.0f} %"


if __name__ == "__main__":
    main()
