"""Integer reference of the front end's fit of a trail: an even line, blurred by the star image. See `front_trails`."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from startracker.core import IntArray
from startracker.flight.front_tables import FrontTables
from startracker.flight.stars import MOST_VARIANCE

UNUSED = -(1 << 15)
"""Value of a pixel that is saturated or beyond the range."""
STEPS = 9
_BESIDE, _BEYOND = 7 << 15, 4 << 16
"""Pixels of a fit, from the line and beyond its ends, 16 fraction bits."""
SHORTEST, LONGEST = 3 << 16, 60 << 16
_STEP, _STRETCH, _TURN = 1 << 16, 4 << 16, 6554
"""Longest step of the middle, the length (px) and the direction (rad), 16 fraction bits."""
_AWAY = 8 << 16
_COVERED = 2
"""Part of the pixels near a line, as its inverse, that must be known."""
_LEAST_ABOVE = 2
"""Rows that must be known above a trail: one whose beginning is lost has another middle."""
_FEWEST_PIXELS = 20
_STRENGTH, _STRENGTH_KNOWN = 64, 36
"""Least square of the signal-to-noise ratio, also for known length and direction."""
_PLACES = 8
"""On either side of a piece where the middle of its trail may be."""
_CLIP = 1 << 14
"""Largest light of a pixel there, DN of 4 fraction bits."""
_WORST = 3 << 8
"""χ² a degree of freedom, 8 fraction bits, of a trail without light; the light of one may be wrong by 1/64."""
_LEAST_PEAK, _MOST_PEAK = 2, 1 << 20


class Line(NamedTuple):
    """Middle and length, pixels of 16 fraction bits; unit vector of 15."""

    x: int
    y: int
    length: int
    cos: int
    sin: int


class Trail(NamedTuple):
    """A measured trail.

    Parameters
    ----------
    flux, y, x : int
        As of a `StarList`.
    variance : int
        As of a `StarList`, without floor.
    along_x, along_y : int
        Length along both axes, 8 fraction bits; along_x ≥ 0.
    """

    flux: int
    y: int
    x: int
    variance: int
    along_x: int
    along_y: int


class _Sums(NamedTuple):
    normal: list[int]
    """Of peak, along, across, length and turn."""
    score: list[int]
    chi2: int
    used: int


def _entry(table: IntArray, away: IntArray) -> IntArray:
    last = len(table) - 1
    index, part = np.minimum(away >> 10, last - 1), away & 1023
    inner = (table[index] * (1024 - part) + table[index + 1] * part) >> 10
    return np.asarray(np.where(away >> 10 >= last, table[last], inner))


def _images(u: IntArray, v: IntArray, length: int, inverse: int, tables: FrontTables) -> list[IntArray]:
    """Line of peak 1 and its slopes (along, across, length / 2σ, turn / 8), 15 fraction bits."""
    ends = [u + (length >> 1), u - (length >> 1)]
    away = [(np.abs(end) * inverse) >> 12 for end in ends]
    integral = [np.sign(end) * _entry(tables.profile, a) for end, a in zip(ends, away, strict=True)]
    rise = [_entry(tables.density, a) for a in away]
    across = _entry(tables.density, (np.abs(v) * inverse) >> 12)
    image = ((integral[0] - integral[1]) * across) >> 15
    beside = (image * ((v * inverse) >> 12)) >> 16
    return [
        image,
        ((rise[1] - rise[0]) * across) >> 15,
        beside,
        ((rise[0] + rise[1]) * across) >> 15,
        (beside * ((u * inverse) >> 12)) >> 19,
    ]


def _ratio(score: int, normal: int, peak: int) -> int:
    """2³¹ score / (normal peak), rounded down, within ±2⁴⁰."""
    while abs(score) >= 1 << 31 or normal >= 1 << 31:
        score, normal = score >> 1, normal >> 1
    return min(max((score << 31) // max(normal, 1) // peak, -(1 << 40)), 1 << 40)


class TrailFit:
    """Fit of a trail to pixels.

    Parameters
    ----------
    x, y, value : int array, shape (N,)
        Pixels, and what they have above the background, DN of 2 fraction bits.
    top : int
        First row of which pixels are known.
    noise : int
        DN, 8 fraction bits.
    """

    def __init__(self, x: IntArray, y: IntArray, value: IntArray, top: int, noise: int, tables: FrontTables) -> None:
        used = value != UNUSED
        self.x, self.y, self.data = x[used] << 16, y[used] << 16, value[used] << 2
        self.top, self.noise, self.tables = top, noise, tables
        self.inverse = (1 << 24) // math.isqrt(tables.image << 16)

    def _near(self, line: Line) -> tuple[IntArray, IntArray, IntArray]:
        """Along and across the line, 16 fraction bits, and values of the pixels near it."""
        dx, dy = self.x - line.x, self.y - line.y
        u, v = (dx * line.cos + dy * line.sin) >> 15, (dy * line.cos - dx * line.sin) >> 15
        near = (np.abs(v) <= _BESIDE) & (np.abs(u) <= (line.length >> 1) + _BEYOND)
        return u[near], v[near], self.data[near]

    def _weight(self, light: IntArray) -> IntArray:
        square = self.noise * self.noise
        photon, flat = min(self.tables.gain // square, 1 << 34), (1 << 40) // square
        uneven = np.minimum((light * self.tables.flat) >> 16, 1 << 16)
        parts = 4096 + ((light * photon) >> 20) + ((uneven * uneven * flat) >> 20)
        return np.asarray((1 << 31) // np.minimum(parts, (1 << 31) - 1))

    def _sums(self, line: Line, peak: int) -> _Sums:
        u, v, data = self._near(line)
        images = _images(u, v, line.length, self.inverse, self.tables)
        light = (peak * images[0]) >> 15
        weight, left = self._weight(light), np.clip(data - light, -(1 << 16), 1 << 16)
        normal = [int((weight * part * part).sum()) for part in images]
        score = [int((weight * part * left).sum()) for part in images]
        return _Sums(normal, score, int((weight * left * left).sum()) // (8 * self.noise**2), len(u))

    def start_along(self, line: Line) -> Line:
        """The line moved along itself to where its light is strongest, of those that cover its middle."""
        best, found = 0, line
        for step in range(-_PLACES, _PLACES + 1):
            away = line.length * step // (2 * _PLACES + 1)
            moved = line._replace(x=line.x + (away * line.cos >> 15), y=line.y + (away * line.sin >> 15))
            u, v, data = self._near(moved)
            image = _images(u, v, line.length, self.inverse, self.tables)[0]
            light = int((image * np.clip(data, -_CLIP, _CLIP)).sum())
            if light > best:
                best, found = light, moved
        return found

    def measure(self, start: Line, free: bool = True) -> Trail | None:
        """Fisher scoring of peak, middle, length and direction, each for itself, as they hardly depend on each other;
        unless `free` length and direction are known."""
        line = start
        u, v, data = self._near(line)
        image = _images(u, v, line.length, self.inverse, self.tables)[0]
        below = int((image * image).sum()) >> 15
        peak = min(max(int((image * data).sum()) // max(below, 1), _LEAST_PEAK), _MOST_PEAK)
        for step in range(STEPS + 1):
            sums = self._sums(line, peak)
            if min(sums.normal) <= 0 or sums.used < _FEWEST_PIXELS:
                return None
            if step < STEPS:
                line, peak = self._moved(line, peak, sums, free)
        area = (line.length + 2 * _BEYOND) * 2 * _BESIDE >> 32
        if max(abs(line.x - start.x), abs(line.y - start.y)) > _AWAY or _COVERED * sums.used < area:
            return None
        return self._result(line, peak, sums, free)

    def _moved(self, line: Line, peak: int, sums: _Sums, free: bool) -> tuple[Line, int]:
        more = _ratio(sums.score[0], sums.normal[0], 1) >> 16
        along, across, stretch, turn = (_ratio(sums.score[k], sums.normal[k], peak) for k in range(1, 5))
        along, across = (min(max((q << 12) // self.inverse, -_STEP), _STEP) for q in (along, across))
        length = line.length + min(max((stretch << 13) // self.inverse, -_STRETCH), _STRETCH)
        turn = min(max(turn >> 3, -_TURN), _TURN)
        x = line.x + ((along * line.cos - across * line.sin) >> 15)
        y = line.y + ((along * line.sin + across * line.cos) >> 15)
        if not free:
            length, turn = line.length, 0
        cos, sin = line.cos - ((line.sin * turn) >> 16), line.sin + ((line.cos * turn) >> 16)
        size = math.isqrt(cos * cos + sin * sin)
        line = Line(x, y, min(max(length, SHORTEST), LONGEST), (cos << 15) // size, (sin << 15) // size)
        return line, min(max(peak + min(max(more, -(peak // 2)), peak), _LEAST_PEAK), _MOST_PEAK)

    def _result(self, line: Line, peak: int, sums: _Sums, free: bool) -> Trail | None:
        image = self.tables.image
        dark = min(max((self.noise << 12) // peak, 1), 1 << 20)
        strength = sums.normal[0] // (dark * dark << 17)
        freedom = sums.used - 5
        allowed = _WORST + (_WORST * min(strength, 1 << 30) >> 12)
        if strength < (_STRENGTH if free else _STRENGTH_KNOWN) or sums.chi2 > allowed * freedom:
            return None
        variance = sum(self._of_axis(dark * dark * image, sums.normal[k]) for k in (1, 2)) >> 1
        excess = sums.chi2 - (freedom << 8)
        if excess > math.isqrt(32 * freedom << 16):
            variance = variance * min(sums.chi2 >> 4, 1 << 24) // (16 * freedom)
        half_x, half_y = (line.length * line.cos) >> 16, (line.length * line.sin) >> 16
        if self.top > 0 and line.y - abs(half_y) < self.top + _LEAST_ABOVE << 16:
            return None
        if not self._inside(line, abs(half_x), abs(half_y)):
            return None
        flux = ((peak * line.length >> 16) << 12) // self.inverse
        along_x, along_y = half_x >> 7, half_y >> 7
        if along_x < 0 or (along_x == 0 and along_y < 0):
            along_x, along_y = -along_x, -along_y
        return Trail(flux, line.y, line.x, min(variance, MOST_VARIANCE), along_x, along_y)

    def _of_axis(self, square: int, normal: int) -> int:
        """square 2³⁵ / normal, at most 2³²."""
        bits = 35
        while square < 1 << 61 and bits > 0:
            square, bits = square << 1, bits - 1
        return min(min(square // normal, MOST_VARIANCE) << bits, MOST_VARIANCE)

    def _inside(self, line: Line, half_x: int, half_y: int) -> bool:
        """Whether both ends are on the searched part of the frame."""
        reach = len(self.tables.tap) - 1 << 16
        return (
            line.x - half_x >= reach
            and line.y - half_y >= reach
            and line.x + half_x <= (self.tables.width - 1 << 16) - reach
            and line.y + half_y <= (self.tables.height - 1 << 16) - reach
        )
