"""Integer reference of the front end's trails: components above half the threshold, and the pixels about them.

Rows are taken in order, as by ``c/tracker_trails.c``: a component that has ended is fitted (`front_trail_fit`) from
pixels that were kept when they left the rows in memory. See `front_end`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from startracker.core import BoolArray, IntArray
from startracker.flight.front_background import at_columns
from startracker.flight.front_components import major_variance
from startracker.flight.front_motion import Motion, agrees, common_motion, lies_on
from startracker.flight.front_rows import Searched
from startracker.flight.front_tables import (
    HALF,
    TRAIL_MARGIN,
    TRAIL_PENDING,
    TRAIL_ROWS,
    TRAIL_WAIT,
    TRAIL_WORDS,
    FrontTables,
)
from startracker.flight.front_trail_fit import LONGEST, UNUSED, Line, Trail, TrailFit

_LOOKED_AT, _FEWEST = 8, 12
"""Pixels of a component from which it is kept, and fitted."""
_LARGEST_SIDE, _MOST_PIXELS = 56, 900
_LONG = 5 << 16
_RANGE = (1 << 15) - 1
_BRIGHT = 100
"""Fluxes (4 fraction bits) over noises (8) from which a trail has its own length and direction."""


@dataclass(eq=False)
class _Component:
    """An open component; or joined to another one."""

    first: tuple[int, int]
    """Row and column of its first pixel."""
    bottom: int
    left: int
    right: int
    sums: IntArray = field(default_factory=lambda: np.zeros(6, np.int64))
    """Pixels, x, y, xx, yy, xy."""
    parent: _Component | None = None

    def root(self) -> _Component:
        here = self
        while here.parent is not None:
            here = here.parent
        return here

    def join(self, other: _Component) -> None:
        other.parent = self
        self.first, self.bottom = min(self.first, other.first), max(self.bottom, other.bottom)
        self.left, self.right = min(self.left, other.left), max(self.right, other.right)
        self.sums = self.sums + other.sums

    @property
    def fits(self) -> bool:
        """Whether it is not too large."""
        size = max(self.right - self.left, self.bottom - self.first[0])
        return size < _LARGEST_SIDE and int(self.sums[0]) <= _MOST_PIXELS


@dataclass(eq=False)
class _Run:
    first: int
    last: int
    component: _Component | None


class TrailSearch:
    """Trails of a frame, row by row.

    Parameters
    ----------
    searched : Searched
    tables : FrontTables
    """

    def __init__(self, searched: Searched, tables: FrontTables) -> None:
        self.searched, self.tables = searched, tables
        self.trails: list[Trail] = []
        self._history: dict[int, list[_Run]] = {}
        self._open: list[_Component] = []
        self._pending: list[_Component] = []
        self._kept: dict[int, tuple[IntArray, IntArray, int]] = {}
        self._words = 0
        self._motion: Motion | None = None

    def to(self, rows: range) -> None:
        """Take the next rows; beyond the frame those that nothing is on."""
        height = self.tables.height
        for y in rows:
            self._take(y, _runs(self.searched.low[y]) if y < height else [])

    def _take(self, y: int, runs: list[tuple[int, int]]) -> None:
        above = self._history.get(y - 1, [])
        here: list[_Run] = []
        for first, last in runs:
            found: _Component | None = None
            for run in above:
                if run.first > last + 1 or run.last + 1 < first or run.component is None:
                    continue
                other = run.component.root()
                if found is None:
                    found = other
                elif other is not found:
                    found.join(other)
            if found is None:
                found = _Component((y, first), y, first, last)
                self._open.append(found)
            x = np.arange(first, last + 1)
            n, sx = len(x), int(x.sum())
            found.sums = found.sums + np.array([n, sx, n * y, int((x * x).sum()), n * y * y, sx * y])
            found.left, found.right, found.bottom = min(found.left, first), max(found.right, last), y
            here.append(_Run(first, last, found))
        self._history[y] = here
        self._history.pop(y - TRAIL_WAIT - 1, None)
        self._close(y)
        self._keep(y - HALF)
        end = self.tables.height + TRAIL_WAIT
        ready = [c for c in self._pending if self._last(c) <= y or y == end]
        self._pending = [c for c in self._pending if c not in ready]
        for component in ready:
            self._measure(component, y)

    def _close(self, y: int) -> None:
        """Components that do not reach row y: those that may be trails wait for their pixels."""
        self._open = [c for c in self._open if c.parent is None]
        ended = sorted((c for c in self._open if c.bottom < y), key=lambda c: c.first)
        self._open = [c for c in self._open if c.bottom == y]
        for component in ended:
            if component.sums[0] >= _FEWEST and component.fits and len(self._pending) < TRAIL_PENDING:
                self._pending.append(component)
            else:
                component.sums = np.zeros(6, np.int64)

    def _piece(self, component: _Component) -> tuple[int, int, int, int] | None:
        """Middle (px) of a component that may be a piece of a trail, and length along both axes of the whole."""
        if self._motion is None or component.sums[0] < _LOOKED_AT or not component.fits:
            return None
        n, x, y = (int(value) for value in component.sums[:3])
        x, y = x // n, y // n
        along_x, along_y = self._motion.at(x << 16, y << 16)
        size = component.right - component.left + component.bottom - component.first[0]
        return (x, y, along_x, along_y) if size << 10 < 3 * (abs(along_x) + abs(along_y)) else None

    def _last(self, component: _Component) -> int:
        """Row from which all pixels about a component are kept."""
        last, piece = component.bottom + TRAIL_MARGIN, self._piece(component)
        return max(last, piece[1] + (abs(piece[3]) >> 8) + TRAIL_MARGIN if piece else 0) + HALF

    def _keep(self, r: int) -> None:
        """Pixels of row r about components."""
        tables, height = self.tables, self.tables.height
        if not 0 <= r < height:
            return
        near = np.zeros(tables.width, np.bool_)
        for k in range(r - TRAIL_MARGIN, r + TRAIL_MARGIN + 1):
            for run in self._history.get(k, []):
                assert run.component is not None
                component = run.component.root()
                if component.sums[0] >= _LOOKED_AT and component.fits:
                    near[max(run.first - TRAIL_MARGIN, 0) : run.last + TRAIL_MARGIN + 1] = True
        for component in self._open + self._pending:
            piece = self._piece(component)
            if piece is not None:
                cx, cy, ax, ay = piece
                if abs(r - cy) > (abs(ay) >> 8) + TRAIL_MARGIN:
                    continue
                ay = ay if ay != 0 else 1
                middle = cx + (r - cy) * ax // ay
                half = TRAIL_MARGIN * math.isqrt(ax * ax + ay * ay) // abs(ay)
                reach = (abs(ax) >> 8) + TRAIL_MARGIN
                near[max(middle - half, cx - reach, 0) : max(min(middle + half, cx + reach) + 1, 0)] = True
        x = np.flatnonzero(near)
        words = len(x) + 2 * len(_runs(near))
        if words > TRAIL_WORDS:
            x, words = x[:0], 0
        row = np.full(len(x), min(r + HALF, height - 1))
        pixel = self.searched.pixels[r, x]
        value = (pixel << 2) - (at_columns(self.searched.lines.level, tables, row, x) >> 6)
        value = np.where((pixel >= tables.saturation) | (np.abs(value) > _RANGE), UNUSED, value)
        self._kept[r] = x, value, words
        self._words += words
        for old in sorted(self._kept):
            if old > r - TRAIL_ROWS and self._words <= TRAIL_WORDS:
                break
            self._words -= self._kept.pop(old)[2]

    def _measure(self, component: _Component, y: int) -> None:
        start, motion = _line_of(component.sums), self._motion
        if start is None:
            return
        x, value = (np.concatenate([row[k] for row in self._kept.values()]) for k in (0, 1))
        at = np.repeat(list(self._kept), [len(row[0]) for row in self._kept.values()])
        row, column = np.array([min(y, self.tables.height - 1)]), np.array([start.x >> 16])
        noise = int(at_columns(self.searched.lines.noise, self.tables, row, column)[0])
        fit = TrailFit(x, at, value, min(self._kept), noise, self.tables)
        trail = fit.measure(start)
        if motion is not None and (trail is None or trail.flux < _BRIGHT * noise or not agrees(trail, motion)):
            along_x, along_y = motion.at(start.x, start.y)
            length = math.isqrt(along_x * along_x + along_y * along_y << 16)
            if _LONG <= length <= LONGEST:
                known = Line(start.x, start.y, length, (along_x << 23) // length, (along_y << 23) // length)
                trail = fit.measure(fit.start_along(known), False) or trail
        if trail is not None:
            self._add(trail)

    def _add(self, trail: Trail) -> None:
        """Add a trail to the list, unless it is on one that has more light; those that have less are left out."""
        same = [t for t in self.trails if lies_on(trail, t) or lies_on(t, trail)]
        if not all((t.flux, -t.y, -t.x) < (trail.flux, -trail.y, -trail.x) for t in same):
            return
        left = [t for t in self.trails if t not in same]
        self.trails = sorted([*left, trail], key=lambda t: (-t.flux, t.y, t.x))[: self.tables.max_stars]
        self._motion = common_motion(self.trails, self.tables)


def _runs(row: BoolArray) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], row, [False]]).astype(np.int8)))
    return [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _line_of(sums: IntArray) -> Line | None:
    """Line with the moments of a component's area; None if it is not long."""
    n, x, y, xx, yy, xy = (int(value) for value in sums)
    cx, cy = x // n, y // n
    mx, my = ((x - cx * n) << 8) // n, ((y - cy * n) << 8) // n
    xx = ((xx - 2 * cx * x + cx * cx * n) << 8) // n - (mx * mx >> 8)
    yy = ((yy - 2 * cy * y + cy * cy * n) << 8) // n - (my * my >> 8)
    xy = ((xy - cx * y - cy * x + cx * cy * n) << 8) // n - (mx * my >> 8)
    major, minor = (int(axis[0]) for axis in major_variance(np.array([xx]), np.array([yy]), np.array([xy])))
    length = math.isqrt(12 * (major - minor) << 24)
    if length < _LONG:
        return None
    cos, sin = (major - yy, xy) if xx >= yy else (xy, major - xx)
    size = math.isqrt((cos * cos + sin * sin) << 16)
    if size == 0:
        return None
    return Line((cx << 16) + (mx << 8), (cy << 16) + (my << 8), length, (cos << 23) // size, (sin << 23) // size)


def find_trails(searched: Searched, tables: FrontTables) -> list[Trail]:
    """Trails of a frame, the brightest first."""
    search = TrailSearch(searched, tables)
    search.to(range(tables.height + TRAIL_WAIT + 1))
    return search.trails
