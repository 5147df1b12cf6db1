"""Stack that a program needs, from the call graph that gcc writes (``-fcallgraph-info=su``)."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from startracker.errors import InputError

_NODE = re.compile(r'node: \{ title: "([^"]+)" label: "[^"]*?\\n(\d+) bytes \((static|dynamic[^)]*)\)')
_EDGE = re.compile(r'edge: \{ sourcename: "([^"]+)" targetname: "([^"]+)"')


def deepest_stack(graphs: Sequence[Path]) -> int:
    """Bytes of stack of the deepest chain of calls.

    Functions outside these files, as the divisions of libgcc, count nothing, nor do the 128 bytes below the stack
    pointer that a last function may use on x86-64 (the red zone).

    Parameters
    ----------
    graphs : sequence of Path
        Files ``.ci`` of all modules.

    Raises
    ------
    InputError
        If a function calls itself, directly or through others, or has a frame without a fixed size.
    """
    text = "\n".join(path.read_text(encoding="utf-8") for path in graphs if path.exists())
    frames = {}
    for name, size, kind in _NODE.findall(text):
        if kind == "dynamic":
            raise InputError(f"{name}: its stack frame has no fixed size")
        frames[name] = int(size)
    calls: dict[str, set[str]] = {}
    for caller, called in _EDGE.findall(text):
        calls.setdefault(caller, set()).add(called)
    deepest: dict[str, int] = {}

    def depth(name: str, chain: tuple[str, ...]) -> int:
        if name in chain:
            raise InputError(f"recursion: {' -> '.join((*chain, name))}")
        if name not in deepest:
            below = max((depth(called, (*chain, name)) for called in calls.get(name, ())), default=0)
            deepest[name] = frames.get(name, 0) + below
        return deepest[name]

    return max((depth(name, ()) for name in frames), default=0)
