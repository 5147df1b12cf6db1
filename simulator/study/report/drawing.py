"""Reports drawn by a process of their own, so that what renders frames and what draws them never share a memory."""

from __future__ import annotations

import contextlib
import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from subprocess import PIPE
from typing import TYPE_CHECKING, TypeVar

from startracker.errors import BoresightError

if TYPE_CHECKING:
    from simulator.study.report.page import Report

__all__ = ["drawn_apart"]

Page = TypeVar("Page", str, bytes)


def drawn_apart(draw: Callable[[Report], Page], report: Report) -> Page:
    """What `draw` (`html_of` or `pdf_of`) makes of a report, in a process that ends with it.

    Raises
    ------
    BoresightError
        When that process fails (out of memory?).
    """
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    command = [sys.executable, "-m", "simulator.study.report.drawing"]
    with subprocess.Popen(command, stdin=PIPE, stdout=PIPE, stderr=PIPE, env=environment) as process:
        assert process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # it has died, and says why
            pickle.dump((draw, report), process.stdin)
        drawn, said = process.communicate()
    if process.returncode != 0:
        lines = said.decode(errors="replace").strip().splitlines() or [f"exit status {process.returncode}"]
        raise BoresightError(f"the report could not be drawn: {lines[-1]}")
    page: Page = pickle.loads(drawn)
    return page


def _main() -> None:
    draw, report = pickle.load(sys.stdin.buffer)
    sys.stdout.buffer.write(pickle.dumps(draw(report)))


if __name__ == "__main__":
    _main()
