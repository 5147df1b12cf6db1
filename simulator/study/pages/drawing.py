"""Pages drawn in a separate process, to limit memory: the renderer and matplotlib are never loaded together."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from typing import TypeVar

from startracker.errors import BoresightError

Content = TypeVar("Content")
Page = TypeVar("Page")


def drawn_apart(draw: Callable[[Content], Page], content: Content) -> Page:
    """Result of `draw`, such as `simulator.study.pages.html.html_of`, for its content, computed in a separate process.

    Raises
    ------
    BoresightError
        If the process fails (out of memory?).
    """
    page: Page = pickle.loads(in_a_process(pickle.dumps((draw, content))))
    return page


def in_a_process(given: bytes) -> bytes:
    """What `answer` gives, computed in a process of its own; errors as from `drawn_apart`."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    # -P: a folder of results may have the name of a module, and is not to be imported
    command = [sys.executable, "-P", "-m", "simulator.study.pages.drawing"]
    done = subprocess.run(command, input=given, capture_output=True, env=environment, check=False)
    if done.returncode != 0:
        lines = done.stderr.decode(errors="replace").strip().splitlines() or [f"exit status {done.returncode}"]
        raise BoresightError(f"the page could not be drawn: {lines[-1]}")
    return done.stdout


def answer(given: bytes) -> bytes:
    """The page, pickled, of a pickled function and its content."""
    draw, content = pickle.loads(given)
    return pickle.dumps(draw(content))


if __name__ == "__main__":
    sys.stdout.buffer.write(answer(sys.stdin.buffer.read()))
