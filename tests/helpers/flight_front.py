"""The C of a flight build's front end, compiled with the tables of a design and called from Python."""

import ctypes
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker.flight.front_tables import FRONT_MODULES, FrontTables, front_arrays, front_constants
from startracker.flight.stars import StarList
from tests.helpers.flight_c import library

CALLER = """
#include "tracker_front.h"
unsigned long front_bytes(void);
int front_measure(struct tracker_front *, const uint16_t *, int, struct tracker_star *, int64_t *);
int front_levels(struct tracker_front *, const uint16_t *, int64_t *);
unsigned long front_bytes(void)
{
    return sizeof(struct tracker_front);
}
int front_measure(struct tracker_front *front, const uint16_t *image, int rows, struct tracker_star *star,
                  int64_t *said)
{
    int y, count;
    tracker_front_start(front);
    for (y = 0; y < rows; y++)
        tracker_front_row(front, image + (long)y * TRACKER_WIDTH);
    count = tracker_front_finish(front, star);
    said[0] = front->saturated;
    said[1] = front->lowest;
    said[2] = front->highest;
    return count;
}
/* Position and background level of the candidates of a frame. */
int front_levels(struct tracker_front *front, const uint16_t *image, int64_t *out)
{
    int y, k;
    tracker_front_start(front);
    for (y = 0; y < TRACKER_HEIGHT; y++)
        tracker_front_row(front, image + (long)y * TRACKER_WIDTH);
    for (k = 0; k < front->candidates; k++) {
        *out++ = front->pool.candidate[k].x;
        *out++ = front->pool.candidate[k].y;
        *out++ = front->pool.candidate[k].level;
    }
    return front->candidates;
}
"""
_STAR = np.dtype([("x", "i4"), ("y", "i4"), ("flux", "i4"), ("variance", "u4"), ("flags", "u2"), ("pad", "u2")])


class FrontFrame(NamedTuple):
    """What the front end answers."""

    stars: StarList
    saturated: int
    """Pixels."""
    lowest: int
    highest: int


def constants_of(tables: FrontTables) -> dict[str, int]:
    """Macros of the C, with those that the exporter gives."""
    size = {"WIDTH": tables.width, "HEIGHT": tables.height, "MAX_STARS": tables.max_stars}
    return size | front_constants(tables)


class CompiledFront:
    """The front end as a library."""

    def __init__(self, tables: FrontTables, folder: Path, *options: str, compiler: str = "gcc") -> None:
        self.tables = tables
        self._library = library(
            folder, FRONT_MODULES, constants_of(tables), front_arrays(tables), options, compiler, source=CALLER
        )
        self._library.front_bytes.restype = ctypes.c_ulong
        self._library.front_levels.argtypes = (ctypes.c_void_p,) * 3
        self.bytes = int(self._library.front_bytes())
        self._context = np.empty(self.bytes + 16, np.uint8)

    def measure(self, image: NDArray[np.uint16], rows: int | None = None) -> FrontFrame | None:
        """Stars of a frame; None where rows are missing. The memory holds rubbish before."""
        pixels = np.ascontiguousarray(image, np.uint16)
        assert pixels.shape[1] == self.tables.width
        self._context[:] = 0xA5
        stars, said = np.zeros(self.tables.max_stars, _STAR), np.zeros(3, np.int64)
        addresses = [ctypes.c_void_p(address) for address in (self._start, pixels.ctypes.data)]
        results = [ctypes.c_void_p(array.ctypes.data) for array in (stars, said)]
        count = self._library.front_measure(*addresses, len(pixels) if rows is None else rows, *results)
        if count < 0:
            return None
        columns = (stars[:count][name].astype(np.int64) for name in StarList._fields)
        return FrontFrame(StarList(*columns), *said.tolist())

    @property
    def _start(self) -> int:
        return int(self._context.ctypes.data + (-self._context.ctypes.data) % 16)

    def levels(self, image: NDArray[np.uint16]) -> NDArray[np.int64]:
        """Column, row and background level, DN of 8 fraction bits, of the candidates (N, 3) of a frame of points."""
        pixels, out = np.ascontiguousarray(image, np.uint16), np.zeros((4 * self.tables.max_stars, 3), np.int64)
        count = self._library.front_levels(self._start, pixels.ctypes.data, out.ctypes.data)
        return out[:count]


def assert_same(one: FrontFrame | None, other: FrontFrame | None) -> None:
    """Both frames are equal in every bit."""
    assert one is not None
    assert other is not None
    assert one[1:] == other[1:]
    for name, a, b in zip(StarList._fields, one.stars, other.stars, strict=True):
        assert np.array_equal(a, b), (name, a, b)
