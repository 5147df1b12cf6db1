"""Which trials are run together: blocks cut from what is left, as long as one takes about `TARGET_S` seconds.

Rows depend on (scenario, seed, index) alone, so the cut is free: it differs with the number of workers and the speed of
the machine, and the rows do not.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import pyarrow as pa

from startracker.kernels import clock

FIRST_TRIALS = 10
"""Trials of a block while their cost is not known yet."""
MOST_TRIALS = 5000
"""Trials of a block at most: its rows are in memory as Python objects for a moment."""
TARGET_S = 1.5
"""Seconds that a block should take: long beside handing it over, short enough to lose in a kill."""
MAX_ATTEMPTS = 4
"""Times that a block may be under way when a worker dies; more, and the block itself is suspected."""


class Result(NamedTuple):
    """A finished block."""

    block: range
    """Indices of its trials."""
    table: pa.Table
    """A row a trial."""
    seconds: float
    """Time that it took the worker."""


def run_block(
    trial: Callable[[int], dict[str, Any]], block: range, stopped: Callable[[], bool] | None = None
) -> Result:
    """Rows of the trials of a block; only the first of them where `stopped` says so in the middle."""
    started = clock()
    rows: list[dict[str, Any]] = []
    for index in block:
        if stopped is not None and stopped():
            break
        rows.append(trial(index))
    return Result(range(block.start, block.start + len(rows)), pa.Table.from_pylist(rows), clock() - started)


class Blocks:
    """What is left to run, handed out in blocks.

    Parameters
    ----------
    gaps : iterable of range
        Indices that no finished block has, in ascending order.
    workers : int
        How many take from it; towards the end blocks get smaller, so that all finish together.
    """

    def __init__(self, gaps: Iterable[range], workers: int = 1) -> None:
        self._gaps = deque(gap for gap in gaps if len(gap))
        self._returned: deque[range] = deque()
        self._attempts: dict[int, int] = {}
        self._cost_s: float | None = None
        self.workers = workers
        self.left = sum(len(gap) for gap in self._gaps)

    def __bool__(self) -> bool:
        return self.left > 0

    @property
    def size(self) -> int:
        """Trials of the next block."""
        if self._cost_s is None:
            wanted = FIRST_TRIALS
        else:
            wanted = int(min(max(TARGET_S / max(self._cost_s, 1e-9), 1), MOST_TRIALS))
        share = -(-self.left // (2 * self.workers))
        return max(1, min(wanted, max(share, wanted // 8)))

    def take(self) -> range:
        """Next block; those that were given back come first, as they were."""
        if self._returned:
            block = self._returned.popleft()
        else:
            gap, size = self._gaps.popleft(), self.size
            block = gap[:size]
            if len(gap) > size:
                self._gaps.appendleft(gap[size:])
        self.left -= len(block)
        return block

    def give_back(self, blocks: Iterable[range]) -> bool:
        """Blocks whose worker died, to be run again; False when one of them has been tried too often."""
        tried = 0
        for block in blocks:
            self._attempts[block.start] = self._attempts.get(block.start, 0) + 1
            tried = max(tried, self._attempts[block.start])
            self._returned.append(block)
            self.left += len(block)
        return tried < MAX_ATTEMPTS

    def drop(self) -> None:
        """Forget what nobody has begun."""
        self._gaps.clear()
        self._returned.clear()
        self.left = 0

    def finished(self, result: Result) -> None:
        """Learn from a finished block what a trial costs."""
        self._attempts.pop(result.block.start, None)
        cost_s = result.seconds / len(result.block)
        # the first block also pays for compilation and caches: half the weight of the past is gone with each block
        self._cost_s = cost_s if self._cost_s is None else 0.5 * (self._cost_s + cost_s)
