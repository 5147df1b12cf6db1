"""Plug-in of pytest: the functions that each test calls, and its duration, in the file named by `VARIABLE`.

Compiled functions are not seen. What a file's imports and fixtures call counts for each of its tests.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import pytest

VARIABLE = "RECORD_CALLS"
ROOT = Path(__file__).resolve().parents[2]
_OURS = tuple(f"{ROOT / package}{os.sep}" for package in ("simulator", "startracker"))


class Recorder:
    """Collects the functions called, by file of tests and by test."""

    def __init__(self) -> None:
        self.shared: dict[str, set[str]] = {}
        self.tests: dict[str, dict[str, tuple[float, list[str]]]] = {}

    @pytest.hookimpl(wrapper=True)
    def pytest_make_collect_report(self, collector: Any) -> Iterator[None]:
        """Importing the file of tests."""
        with _called() as names:
            report = yield
        self.shared.setdefault(collector.nodeid.partition("::")[0], set()).update(names)
        return report

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_setup(self, item: Any) -> Iterator[None]:
        """The fixtures of a test."""
        with _called() as names:
            yield
        self.shared.setdefault(item.nodeid.partition("::")[0], set()).update(names)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item: Any) -> Iterator[None]:
        """The test itself."""
        began = time.perf_counter()
        with _called() as names:
            yield
        seconds = round(time.perf_counter() - began, 3)
        self.tests.setdefault(item.nodeid.partition("::")[0], {})[item.nodeid] = seconds, sorted(names)

    def pytest_sessionfinish(self) -> None:
        """Write what was called."""
        content = {
            file: {"shared": sorted(self.shared.get(file, ())), "tests": tests} for file, tests in self.tests.items()
        }
        Path(os.environ[VARIABLE]).write_text(json.dumps(content), encoding="utf-8")


@contextmanager
def _called() -> Iterator[set[str]]:
    """The functions of the packages that are called meanwhile, each as ``file:line`` of its definition."""
    codes: set[CodeType] = set()

    def see(frame: FrameType, event: str, _: Any) -> None:
        if event == "call":
            codes.add(frame.f_code)

    names: set[str] = set()
    threading.setprofile(see)
    sys.setprofile(see)
    try:
        yield names
    finally:
        sys.setprofile(None)
        threading.setprofile(None)
        for code in codes:
            if code.co_filename.startswith(_OURS):
                names.add(f"{Path(code.co_filename).relative_to(ROOT)}:{code.co_firstlineno}")


def pytest_configure(config: Any) -> None:
    """Record if asked to."""
    if VARIABLE in os.environ:
        config.pluginmanager.register(Recorder(), "recorder of calls")
