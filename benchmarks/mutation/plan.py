"""Which tests a fault needs, in an order that finds it soon."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.mutation.faults import Fault
from benchmarks.mutation.references import Definition, References


@dataclass(frozen=True)
class Plan:
    """Tests to run with a fault.

    Parameters
    ----------
    first : list of str
        Tests that call what contains the fault, by their pytest names.
    then : list of str
        Files of tests to run if these pass: all, where the calls are not known for certain.
    seconds : float
        Duration of all of them without a fault.
    stale : list of Path
        Files with compiled functions that contain the fault, whose machine code on disk is out of date with it.
    """

    first: list[str]
    then: list[str]
    seconds: float
    stale: list[Path]


class Planner:
    """Plans the tests of faults from the calls that the tests of an area made (`recording`).

    A fault in a function of Python is noticed by the tests that call it, or by none. Compiled functions and constants
    are not seen in the record: the tests that call their users come first, then all.
    """

    def __init__(self, root: Path, references: References, recorded: Path) -> None:
        self._root, self._references = root, references
        self._files: dict[str, Any] = json.loads(recorded.read_text(encoding="utf-8"))

    def plan(self, fault: Fault) -> Plan:
        """Tests of one fault."""
        definition, line = self._references.at(fault.path, fault.line), None
        inside: set[Definition] = set()
        outside: set[Definition] = set()
        if definition is not None:
            inside, outside = self._references.through(definition)
            if not definition.is_compiled:
                line = self._references.function_at(fault.path, fault.line)
        if line is not None:
            callers = [(fault.path, line, line)]
        else:
            callers = [(user.path, user.first, user.last) for user in {*inside, *outside}]
        first = self._calling(fault, callers)
        then = self._in_order(fault, self._files)
        if line is not None:  # a function that no test calls may be called by a process that a test starts
            then = [] if first else [file for file in then if self._is_near(fault, file)]
        seconds = sum(seconds for tests in self._files.values() for seconds, _ in tests["tests"].values())
        return Plan(first, then, seconds, sorted({fault.path, *(part.path for part in inside if part.is_compiled)}))

    def _calling(self, fault: Fault, callers: Iterable[tuple[Path, int, int]]) -> list[str]:
        """Tests that call one of some functions, given by their lines."""
        ranges: dict[str, list[tuple[int, int]]] = {}
        for path, low, high in callers:
            ranges.setdefault(str(path), []).append((low, high))

        def calls(names: Iterable[str]) -> bool:
            for name in names:
                path, _, line = name.rpartition(":")
                if any(low <= int(line) <= high for low, high in ranges.get(path, ())):
                    return True
            return False

        found = {}
        for file, tests in self._files.items():
            everywhere = calls(tests["shared"])
            found[file] = [name for name, (_, names) in tests["tests"].items() if everywhere or calls(names)]
        return [name for file in self._in_order(fault, found) for name in found[file]]

    def _in_order(self, fault: Fault, tests: dict[str, Any]) -> list[str]:
        """Files of tests with some left, those first that import the module of the fault, then by duration."""

        def key(file: str) -> tuple[bool, float]:
            return not self._is_near(fault, file), sum(s for s, _ in self._files[file]["tests"].values())

        return sorted((file for file, left in tests.items() if left), key=key)

    def _is_near(self, fault: Fault, file: str) -> bool:
        """Whether a file of tests imports the module of a fault."""
        package, name = ".".join(fault.path.parent.parts), fault.path.stem
        imported = rf"\b{re.escape(package)}(\.{name}\b| import .*\b{name}\b)"
        return re.search(imported, (self._root / file).read_text("utf-8")) is not None
