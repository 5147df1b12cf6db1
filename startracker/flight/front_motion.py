"""Integer reference of the motion that the trails of a frame share. See `front_trails`."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from startracker.flight.front_tables import FrontTables
from startracker.flight.front_trail_fit import Trail

_FEWEST_AGREEING, _FEWEST_TURNED = 4, 8
"""Trails that make a motion, and that show whether the camera turns about its boresight."""
_ROUNDS = 3
_FASTEST_TURN = 1 << 26


class Motion(NamedTuple):
    """Length of trails along both axes, 8 fraction bits, in the middle of the frame (x, y, half pixels); and its change
    per half pixel, 20 more bits, as the camera turns about its boresight."""

    along_x: int
    along_y: int
    turn: int
    x: int
    y: int

    def at(self, x: int, y: int) -> tuple[int, int]:
        """Length along both axes at a position of 16 fraction bits."""
        x, y = (x >> 15) - self.x, (y >> 15) - self.y
        return self.along_x - (self.turn * y >> 20), self.along_y + (self.turn * x >> 20)


def common_motion(trails: list[Trail], tables: FrontTables) -> Motion | None:
    """Motion that at least four of the trails, and a third of them, share."""
    if len(trails) < _FEWEST_AGREEING:
        return None
    along = np.array([(t.along_x, t.along_y) for t in trails])
    along *= np.where(along @ along[0] < 0, -1, 1)[:, None]
    x, y = (int(np.sort(column)[len(trails) // 2]) for column in along.T)
    motion = Motion(x, y, 0, tables.width, tables.height)
    for _ in range(_ROUNDS):
        motion = _fitted([t for t in trails if agrees(t, motion)], motion)
    count = sum(agrees(trail, motion) for trail in trails)
    return motion if count >= _FEWEST_AGREEING and 3 * count >= len(trails) else None


def _fitted(trails: list[Trail], near: Motion) -> Motion:
    """Least squares."""
    if len(trails) < _FEWEST_AGREEING:
        return near
    n, sums = len(trails), [0] * 6
    for t in trails:
        x, y, (ax, ay) = (t.x >> 15) - near.x, (t.y >> 15) - near.y, _turned(t, near)
        for k, value in enumerate((x, y, ax, ay, ay * x - ax * y, x * x + y * y)):
            sums[k] += value
    x, y, ax, ay, moment, square = sums
    below = n * square - x * x - y * y
    turn = ((n * moment - x * ay + y * ax) << 20) // max(below, 1) if n >= _FEWEST_TURNED else 0
    turn = min(max(turn, -_FASTEST_TURN), _FASTEST_TURN)
    return near._replace(along_x=(ax + (turn * y >> 20)) // n, along_y=(ay - (turn * x >> 20)) // n, turn=turn)


def _turned(trail: Trail, motion: Motion) -> tuple[int, int]:
    """Length along both axes in the sense of the motion."""
    x, y = motion.at(trail.x, trail.y)
    sign = -1 if trail.along_x * x + trail.along_y * y < 0 else 1
    return sign * trail.along_x, sign * trail.along_y


def agrees(trail: Trail, motion: Motion) -> bool:
    """Whether a trail is as the motion makes it: to 1 px and a fifth of its length."""
    (ax, ay), (x, y) = _turned(trail, motion), motion.at(trail.x, trail.y)
    limit = 256 + math.isqrt(x * x + y * y) // 5
    return (ax - x) ** 2 + (ay - y) ** 2 <= limit * limit


def lies_on(one: Trail, other: Trail) -> bool:
    """Whether the middle of a trail is on another one, or not far beyond its ends."""
    x, y = (one.x - other.x) >> 8, (one.y - other.y) >> 8
    along, across = x * other.along_x + y * other.along_y, x * other.along_y - y * other.along_x
    square = other.along_x * other.along_x + other.along_y * other.along_y
    return abs(along) * 4 <= 3 * square and across * across <= square * 9 << 16
