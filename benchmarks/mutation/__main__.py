"""``python -m benchmarks.mutation``: plant faults one at a time, run the tests of their area, count those noticed."""

from __future__ import annotations

import argparse
import ast
import contextlib
import datetime
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path

from benchmarks.mutation.areas import AREAS, Area
from benchmarks.mutation.faults import Fault, faults_of
from simulator.study.statistics import wilson_interval

ROOT = Path(__file__).resolve().parents[2]
KNOWN_EQUIVALENT = Path(__file__).with_name("equivalent.txt")
"""Faults that change nothing which a user can observe, each with the reason, as ``fault | reason``."""
_PACKAGES = ("simulator", "startracker")
_SLOWER = 4.0
"""A fault whose tests take this many times longer is noticed: it is an endless loop."""
NOTICED, UNNOTICED, EQUIVALENT = "noticed", "unnoticed", "equivalent"


class Copy:
    """A copy of the checkout in which faults are planted, with the caches of the kernels."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True, text=True)
        for name in filter(None, listed.stdout.split("\0")):
            if (ROOT / name).is_file():
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(ROOT / name, folder / name)
        for package in _PACKAGES:
            for path in (ROOT / package).rglob("*.nb[ic]"):
                target = folder / path.relative_to(ROOT)
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(path, target)
        self._users = users_of_modules(folder)

    def passes(self, tests: Iterable[str], limit_s: float) -> bool:
        """Whether the tests pass within a time; tests that are killed, by the system or by a crash, do not."""
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:xdist", "-p", "no:cacheprovider", *tests]
        environment = {"PYTHONPATH": str(self.folder), "PATH": "/usr/bin:/bin", "HOME": str(self.folder)}
        # a session of its own, so that programs which the tests started end with them, and Ctrl-C reaches only this one
        with subprocess.Popen(
            command,
            cwd=self.folder,
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        ) as tests_running:
            try:
                return tests_running.wait(limit_s) == 0
            except subprocess.TimeoutExpired:
                return False
            finally:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(tests_running.pid, signal.SIGKILL)

    def notices(self, fault: Fault, tests: Iterable[str], limit_s: float) -> bool:
        """Whether the tests fail with a fault; the copy is as before afterwards."""
        path = self.folder / fault.path
        kept = self._take_caches(fault.path)
        source = path.read_bytes()
        times = path.stat()
        try:
            path.write_bytes(fault.planted(source))
            return not self.passes(tests, limit_s)
        finally:
            path.write_bytes(source)
            # numba compares the time of the file with that in the cache
            os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
            for users in [path, *self._users_of(fault.path)]:
                for cache in users.parent.glob(f"__pycache__/{users.stem}.*.nb[ic]"):
                    cache.unlink()
            for cache, text in kept.items():
                cache.write_bytes(text)

    def _users_of(self, path: Path) -> list[Path]:
        return [self.folder / user for user in self._users.get(path, ())]

    def _take_caches(self, path: Path) -> dict[Path, bytes]:
        """Caches of a module's kernels and of those that call them, which numba would not compile again."""
        kept = {}
        for user in [self.folder / path, *self._users_of(path)]:
            for cache in user.parent.glob(f"__pycache__/{user.stem}.*.nb[ic]"):
                kept[cache] = cache.read_bytes()
                cache.unlink()
        return kept


def users_of_modules(root: Path) -> dict[Path, list[Path]]:
    """Files that import each file of the packages, directly or through others, relative to `root`."""
    files = [path.relative_to(root) for package in _PACKAGES for path in (root / package).rglob("*.py")]
    module = {".".join(path.with_suffix("").parts).removesuffix(".__init__"): path for path in files}
    direct: dict[Path, set[Path]] = {path: set() for path in files}
    for path in files:
        for node in ast.walk(ast.parse((root / path).read_bytes())):
            names = []
            if isinstance(node, ast.ImportFrom) and node.module:
                names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
            elif isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            for name in names:
                if name in module:
                    direct[module[name]].add(path)
    found = {}
    for path in files:
        reached, left = set(), [path]
        while left:
            for user in direct[left.pop()] - reached:
                reached.add(user)
                left.append(user)
        found[path] = sorted(reached)
    return found


def sample(area: Area, count: int, seed: str) -> list[Fault]:
    """Faults of an area drawn at random without repetition."""
    found = [fault for path in area.files(ROOT) for fault in faults_of(path, (ROOT / path).read_bytes())]
    return random.Random(seed).sample(found, min(count, len(found)))


def known_equivalent() -> dict[str, str]:
    """Faults that change nothing, with the reason of each."""
    rows = (line.split(" | ") for line in KNOWN_EQUIVALENT.read_text(encoding="utf-8").splitlines() if " | " in line)
    return dict(rows)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.mutation", description=__doc__)
    parser.add_argument("--area", action="append", choices=AREAS, help="only this area; may be repeated")
    parser.add_argument("--faults", type=int, default=20, help="faults of each area")
    parser.add_argument("--seed", default="1", help="of the choice of faults")
    parser.add_argument("--out", type=Path, help="page to write, Markdown")
    given = parser.parse_args()
    equivalent = known_equivalent()
    results: dict[str, list[tuple[Fault, str]]] = {}
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        measure(given.area or list(AREAS), given.faults, given.seed, results)
    except KeyboardInterrupt:
        print("interrupted; the faults so far:")
    text = page(results, given.seed, equivalent)
    if given.out:
        given.out.write_text(text, encoding="utf-8")
    print(text)


def measure(areas: Iterable[str], count: int, seed: str, results: dict[str, list[tuple[Fault, str]]]) -> None:
    """Plant faults of each area, and add the outcomes to `results`, which has those so far if this is interrupted."""
    equivalent = known_equivalent()
    with tempfile.TemporaryDirectory() as folder:
        copy = Copy(Path(folder))
        for name in areas:
            tests = AREAS[name].test_files(ROOT)
            began = time.perf_counter()
            if not copy.passes(tests, 3600.0):
                raise SystemExit(f"the tests of {name} fail without a fault: {' '.join(tests)}")
            limit_s = 60.0 + _SLOWER * (time.perf_counter() - began)
            results[name] = []
            for fault in sample(AREAS[name], count, f"{seed} {name}"):
                noticed = copy.notices(fault, nearest_first(tests, fault), limit_s)
                outcome = NOTICED if noticed else EQUIVALENT if str(fault) in equivalent else UNNOTICED
                results[name].append((fault, outcome))
                print(f"{name}: {outcome}: {fault}", flush=True)


def nearest_first(tests: Iterable[str], fault: Fault) -> list[str]:
    """Files of tests of an area and all others that import the module of a fault, these first: the run of a fault ends
    at the first failure."""
    package, name = ".".join(fault.path.parent.parts), fault.path.stem
    imported = re.compile(rf"\b{re.escape(package)}(\.{name}\b| import .*\b{name}\b)")
    near = [path for path in sorted(ROOT.glob("tests/*/test_*.py")) if imported.search(path.read_text("utf-8"))]
    return list(dict.fromkeys([*(str(path.relative_to(ROOT)) for path in near), *tests]))


def page(results: dict[str, list[tuple[Fault, str]]], seed: str, equivalent: dict[str, str]) -> str:
    """The result as Markdown."""
    day = datetime.datetime.now(datetime.UTC).date()
    introduction = (
        f"`python -m benchmarks.mutation --seed {seed}`, {day}. One operator, constant or term of a guard is changed "
        "at a time, drawn at random from all that an area has; the area's tests run, and all others that import the "
        "changed module. "
        "Faults that change nothing a user can observe do not count."
    )
    lines = [
        "# Planted faults",
        "",
        introduction,
        "",
        "| area | faults | equivalent | noticed | share | 95 % |",
        "|---|---|---|---|---|---|",
    ]
    for name, rows in results.items():
        outcomes = [outcome for _, outcome in rows]
        noticed, counted = outcomes.count(NOTICED), len(rows) - outcomes.count(EQUIVALENT)
        low, high = wilson_interval(noticed, max(counted, 1))
        lines.append(
            f"| {name} | {len(rows)} | {outcomes.count(EQUIVALENT)} | {noticed} | "
            f"{100 * noticed / max(counted, 1):.0f} % | {100 * low:.0f} to {100 * high:.0f} % |"
        )
    unnoticed = [f"- `{fault}`" for rows in results.values() for fault, outcome in rows if outcome == UNNOTICED]
    same = [
        f"- `{fault}`: {equivalent[str(fault)]}"
        for rows in results.values()
        for fault, outcome in rows
        if outcome == EQUIVALENT
    ]
    lines += ["", "Not noticed:", "", *(unnoticed or ["none"])]
    lines += ["", "Equivalent, with the reason:", "", *same] if same else []
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
