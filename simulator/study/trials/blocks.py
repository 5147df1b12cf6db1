"""Division of the remaining trials into blocks of about `TARGET_S` seconds.

Rows depend only on (scenario, seed, index), so that blocks may vary with the number of workers and the speed of the
machine.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import pyarrow as pa

from simulator.study.trials.arrow import table_of
from startracker._compiled import clock

FIRST_TRIALS = 10
"""Trials per block while their duration is unknown."""
MOST_TRIALS = 5000
"""Maximum number of trials per block, whose rows are temporarily Python objects."""
TARGET_S = 1.5
"""Target duration of a block, seconds: long compared with the transfer, short enough to be lost if killed."""
MAX_ATTEMPTS = 4
"""Maximum number of worker deaths during a block; beyond it the block is assumed to be the cause."""


class Result(NamedTuple):
    """A finished block."""

    block: range
    """Indices of the trials."""
    table: pa.Table
    """One row per trial."""
    seconds: float
    """Computing time in the worker."""


def run_block(
    trial: Callable[[int], dict[str, Any]], block: range, stopped: Callable[[], bool] | None = None
) -> Result:
    """Rows of the trials of a block; only the first ones if `stopped` becomes true."""
    started = clock()
    rows: list[dict[str, Any]] = []
    for index in block:
        if stopped is not None and stopped():
            break
        rows.append(trial(index))
    return Result(range(block.start, block.start + len(rows)), table_of(rows), clock() - started)


class Blocks:
    """Remaining trials, distributed in blocks.

    Parameters
    ----------
    gaps : iterable of range
        Indices without finished trials, in ascending order.
    workers : int
        Number of workers; blocks become smaller towards the end, so that all workers finish together.
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
        """Number of trials of the next block."""
        if self._cost_s is None:
            wanted = FIRST_TRIALS
        else:
            wanted = int(min(max(TARGET_S / max(self._cost_s, 1e-9), 1), MOST_TRIALS))
        share = -(-self.left // (2 * self.workers))
        return max(1, min(wanted, max(share, wanted // 8)))

    def take(self) -> range:
        """Next block; returned blocks come first, unchanged."""
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
        """Return blocks whose worker died, to be run again; False if one of them has been tried too often."""
        tried = 0
        for block in blocks:
            self._attempts[block.start] = self._attempts.get(block.start, 0) + 1
            tried = max(tried, self._attempts[block.start])
            self._returned.append(block)
            self.left += len(block)
        return tried < MAX_ATTEMPTS

    def drop(self) -> None:
        """Discard blocks that have not been started."""
        self._gaps.clear()
        self._returned.clear()
        self.left = 0

    def finished(self, result: Result) -> None:
        """Update the duration of a trial from a finished block."""
        self._attempts.pop(result.block.start, None)
        cost_s = result.seconds / len(result.block)
        # the first block includes compilation and caches: the weight of the past is halved with each block
        self._cost_s = cost_s if self._cost_s is None else 0.5 * (self._cost_s + cost_s)
