"""Slow tests: which slice of them to run, how long each takes, and which have not run since their code changed.

    python tests/helpers/slow_tests.py            names the slow tests that have not passed since their code changed
    python -m pytest -m slow --slow-slice 2/5     runs the second of five slices of equal duration
    python -m pytest -m slow --record-slow        also writes durations and the commit into tests/slow_tests.json

A test covers the modules that its file imports and those that these import, found in the source, with the other files
in the folders of these modules; a file that imports none of our packages starts them as commands, and covers all.
"""

from __future__ import annotations

import ast
import functools
import json
import subprocess
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from statistics import fmean
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
RECORDS = ROOT / "tests" / "slow_tests.json"
PACKAGES = ("simulator", "startracker")
_ELSEWHERE = ("benchmarks", "tests/helpers", "docs/_ext")
"""Folders from which tests import as well."""
_COMMON = ("scenarios/", "pyproject.toml", "tests/conftest.py")
"""Paths that every test covers."""
_FIRST_GUESS_S = 60.0
"""Duration of a test before any has been measured: what makes it slow."""


# ---------------------------------------------------------------------- durations and slices
def read_records(path: Path = RECORDS) -> dict[str, dict[str, Any]]:
    """Duration (``seconds``) and commit of the last pass (``passed``) of each slow test, by its identifier."""
    records: dict[str, dict[str, Any]] = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    return records


def write_records(records: Mapping[str, Mapping[str, Any]], path: Path = RECORDS) -> None:
    """Write the records, a line for each test."""
    lines = [f"  {json.dumps(name)}: {json.dumps(dict(records[name]))}" for name in sorted(records)]
    path.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


def slice_of(names: Iterable[str], records: Mapping[str, Mapping[str, Any]], number: int, count: int) -> set[str]:
    """Tests of slice `number` of `count`: the longest first, each into the slice that is shortest so far.

    A test that was never measured is taken to last as long as the mean of the others.
    """
    known = {name: float(record["seconds"]) for name, record in records.items() if "seconds" in record}
    usual = fmean(known.values()) if known else _FIRST_GUESS_S
    slices: list[set[str]] = [set() for _ in range(count)]
    lasts = [0.0] * count
    for name in sorted(set(names), key=lambda name: (-known.get(name, usual), name)):
        shortest = lasts.index(min(lasts))
        slices[shortest].add(name)
        lasts[shortest] += known.get(name, usual)
    return slices[number - 1]


def parse_slice(text: str) -> tuple[int, int]:
    """Number and count of ``2/5``; `ValueError` for anything else."""
    number, _, count = text.partition("/")
    if not (number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count)):
        raise ValueError(f"--slow-slice: must be NUMBER/COUNT such as 2/5, not '{text}'")
    return int(number), int(count)


# ---------------------------------------------------------------------- the code that a test covers
def _file_of(module: str) -> Path | None:
    """Source of a dotted name that is a module of ours; None for anything else."""
    for folder in (ROOT, *(ROOT / name for name in _ELSEWHERE)):
        base = folder.joinpath(*module.split("."))
        for file in (base / "__init__.py", base.with_suffix(".py")):
            if file.is_file():
                return file
    return None


def _imported(file: Path) -> Iterator[str]:
    """Dotted names that a file imports, anywhere in it."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


@functools.cache
def _imported_files(file: Path) -> frozenset[Path]:
    """Files of ours that a file imports directly, with the packages that contain them."""
    found: set[Path] = set()
    for name in _imported(file):
        parts = name.split(".")
        found |= {known for n in range(1, len(parts) + 1) if (known := _file_of(".".join(parts[:n])))}
    return frozenset(found)


def covered_files(test_file: Path) -> set[Path]:
    """Sources that a test's file covers: itself, and what it imports directly and indirectly."""
    covered, pending = {test_file}, [test_file]
    while pending:
        new = _imported_files(pending.pop()) - covered
        covered |= new
        pending += new
    return covered


def covers(test_file: Path, changed: Iterable[str]) -> list[str]:
    """Those of the changed paths, relative to the repository, that a test's file covers."""
    files = {file.relative_to(ROOT).as_posix() for file in covered_files(test_file) if file.is_relative_to(ROOT)}
    folders = {name.rpartition("/")[0] for name in files if name.startswith(PACKAGES)}
    all_of_it = not folders  # commands are started

    def is_covered(path: str) -> bool:
        if path in files or path.startswith(_COMMON):
            return True
        if not path.startswith(tuple(f"{package}/" for package in PACKAGES)):
            return False
        return all_of_it or (not path.endswith(".py") and any(path.startswith(f"{folder}/") for folder in folders))

    return [path for path in changed if is_covered(path)]


# ---------------------------------------------------------------------- what has not run since
def git(*arguments: str) -> str:
    """Output of a git command in the repository; empty if it fails."""
    done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False)
    return done.stdout.strip() if done.returncode == 0 else ""


def clean_commit() -> str:
    """The current commit, empty if files other than the records differ from it: then nothing is known of a commit."""
    changed = [line for line in git("status", "--porcelain").splitlines() if line.strip()]
    if any(not line.endswith("tests/slow_tests.json") for line in changed):
        return ""
    return git("rev-parse", "--short=12", "HEAD")


@functools.cache
def changed_since(commit: str) -> tuple[str, ...] | None:
    """Paths that differ from a commit, those not yet committed included; None for an unknown commit."""
    if not git("rev-parse", "--verify", "--quiet", f"{commit}^{{commit}}"):
        return None
    return tuple(git("diff", "--name-only", commit).splitlines())


def stale_tests(names: Iterable[str], records: Mapping[str, Mapping[str, Any]]) -> dict[str, str]:
    """Why each test that has to run again has: test to reason."""
    reasons: dict[str, str] = {}
    for name in names:
        commit = records.get(name, {}).get("passed")
        changed = changed_since(commit) if commit else None
        if not commit:
            reasons[name] = "has never passed on record"
        elif changed is None:
            reasons[name] = f"passed at {commit}, which is not a commit of this repository"
        elif since := covers(ROOT / name.partition("::")[0], changed):
            reasons[name] = f"passed at {commit}; {len(since)} files it covers have changed, such as {since[0]}"
    return reasons


# ---------------------------------------------------------------------- recording
class Recorder:
    """Plug-in of pytest that writes how long each slow test took and the commit at which it passed.

    A test has passed if its call has: one that is skipped or interrupted has reports of its set-up and tear-down alone.
    """

    def __init__(self, path: Path = RECORDS) -> None:
        self.path = path
        self.seconds: dict[str, float] = {}
        self.passed: set[str] = set()
        self.failed: set[str] = set()

    def pytest_runtest_logreport(self, report: Any) -> None:
        """Take the report of the set-up, the call or the tear-down of a test."""
        if "slow" not in report.keywords:
            return
        self.seconds[report.nodeid] = self.seconds.get(report.nodeid, 0.0) + report.duration
        if report.failed:
            self.failed.add(report.nodeid)
        elif report.when == "call" and report.passed:
            self.passed.add(report.nodeid)

    def pytest_sessionfinish(self) -> None:
        """Write the records."""
        records, commit = read_records(self.path), clean_commit()
        for name in self.passed | self.failed:
            record = records.setdefault(name, {})
            record["seconds"] = round(self.seconds[name], 1)
            if name not in self.failed and commit:
                record["passed"] = commit
        if self.passed or self.failed:
            write_records(records, self.path)


def slow_names() -> list[str]:
    """Identifiers of all slow tests, as pytest collects them."""
    import sys

    command = [sys.executable, "-m", "pytest", "-p", "no:xdist", "-q", "--collect-only", "-m", "slow", "tests"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"the slow tests could not be collected:\n{done.stdout}{done.stderr}")
    return [line for line in done.stdout.splitlines() if "::" in line and not line.startswith("SKIPPED")]


def main() -> None:
    """Name the slow tests that have not passed since the code that they cover changed."""
    names = slow_names()
    reasons = stale_tests(names, read_records())
    for name, reason in reasons.items():
        print(f"{name}: {reason}")
    print(f"{len(reasons)} of {len(names)} slow tests have not passed since the code that they cover changed")


if __name__ == "__main__":
    main()
