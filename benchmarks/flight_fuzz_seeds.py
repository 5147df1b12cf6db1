"""Inputs from which the fuzzers of the flight build begin: bytes that ``fuzz_fields.h`` and ``fuzz_pixels.h`` read."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

SEED, NUMBER = 20261, 48


def _two(value: int) -> bytes:
    return (value & 0xFFFF).to_bytes(2, "little")


def list_seed(rng: np.random.Generator, stars: int, false: int) -> bytes:
    """A field: guide stars moved by up to a tenth of a pixel, and false stars; a third of the lists have a prior."""
    prior = bytes([1 + 8 * 12]) + _two(40000) + bytes([0, 0]) if rng.random() < 1 / 3 else bytes(5)
    head = _two(int(rng.integers(1 << 16))) + _two(int(rng.integers(1 << 16))) + bytes(3) + prior
    ways = [3] * stars + [0] * false
    rng.shuffle(ways)
    groups = []
    for number, way in enumerate(ways):
        flux = _two(60000 - 4000 * number)
        moved = bytes([way + 16, *rng.bytes(2)]) + flux + bytes([18, 6, 6])
        groups.append(moved if way else bytes([16, *rng.bytes(2)]) + flux + bytes([18, *rng.bytes(2)]))
    return head + b"".join(groups)


def _lists() -> list[bytes]:
    rng = np.random.default_rng(SEED)
    return [list_seed(rng, 3 + number % 10, number % 4) for number in range(NUMBER)]


def _sessions() -> list[bytes]:
    """Four lists of nine stars each, of nearly the same attitude, a tenth of a second apart."""
    rng = np.random.default_rng(SEED + 1)
    made = []
    for _ in range(NUMBER):
        at, roll = int(rng.integers(1 << 16)), int(rng.integers(1 << 15))
        frames = []
        for frame in range(4):
            data = list_seed(rng, 9, 0)
            time = _two(50000) + bytes([1, 0])
            frames.append(_two(at) + _two(roll + 3 * frame) + bytes(4) + time + data[12:])
        made.append(b"".join(frames))
    return made


def _frames() -> list[bytes]:
    """Fields with noise, still and moved, with hot pixels, saturated stars, bright columns and boxes; raw pixels."""
    rng = np.random.default_rng(SEED + 2)
    made = []
    for number in range(NUMBER):
        even = bytes([number % 60, 3 * number % 80])
        trail = (bytes(2), bytes(2), rng.bytes(2), even)[number % 4]
        kind = (1, 1, 1, 9, 1, 1, 1, 0, 1, 1, 15)[number % 11]
        head = bytes([kind]) + rng.bytes(2) + _two(200) + bytes([20, number % 7, 40, 80 + number])
        head += trail + bytes([3 + number % 9])
        groups = [
            bytes([what, *rng.bytes(4)]) + _two(int(rng.integers(50, 30000 if what > 2 else 1000))) + bytes([number])
            for what in rng.choice([3, 3, 3, 4, 4, 0, 1, 2], number % 12)
        ]
        made.append(head + b"".join(groups) + (rng.bytes(200) if kind == 0 else b""))
    return made


def _filters() -> list[bytes]:
    """Twelve attitudes a tenth of a second apart that turn evenly; now and then a jump or a gap."""
    rng = np.random.default_rng(SEED + 3)
    made = []
    for number in range(NUMBER):
        data = rng.bytes(4)
        for step in range(12):
            jump = 18 if number % 4 == 1 and step % 5 == 3 else 10
            data += _two(50000) + bytes([1, 20, 5, 3, jump, *([70 + number] * 3), 0, number % 2 + 6 * (step % 7 == 5)])
            data += bytes(4)
        made.append(data)
    return made


SEEDS: dict[str, Callable[[], list[bytes]]] = {
    "front": _frames,
    "frames": _frames,
    "stars": _lists,
    "search": _lists,
    "pose": _lists,
    "filter": _filters,
    "session": _sessions,
}
"""Inputs by fuzzer."""
