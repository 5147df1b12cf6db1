"""Pictures for the display, whose photographs calibrate the stimulator.

========== =========================================================================================================
dots       a lattice of dots, and three in the middles of its cells which give origin, axes and mirroring: geometry
uniform    squares at the highest level in all colours: brightness over the display, and of all colours together
ramp-red … squares of one colour at all levels of the ramp, scattered over the display: brightness and curve
black      every pixel at level 0: compared with a photograph ``off`` of the display switched off, its black level
========== =========================================================================================================
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from startracker.arguments import names_of, real_array, text, whole_number
from startracker.core import FloatArray, IntArray
from startracker.errors import InputError

COLOURS = ("red", "green", "blue")
TOP_LEVEL = 255
"""Grey levels are those of the browser's canvas, eight bits."""
MARKERS = np.array([[0.5, 0.5], [2.5, 0.5], [0.5, 3.5]])
"""Of the lattice: corner, end of the short leg along +x, end of the long leg along +y; cells, from the middle dot."""


@dataclass(frozen=True)
class Pattern:
    """Calibration pictures of a display.

    Parameters
    ----------
    width, height : int
        Size of the display, pixels.
    colours : tuple of str
        Channels to drive: red, green, blue, or some of them.
    spacing_px : int
        Of the dots, even; the squares are 3/8 of it wide, with gaps as wide.
    dot_px : int
        Width of a dot, odd; about two pixels of the camera measure best.
    levels : tuple of int
        Of the ramps; the last is 255.

    Raises
    ------
    InputError
        For other colours, sizes that leave fewer than 7 × 9 dots, or levels that do not rise to 255.
    """

    width: int
    height: int
    colours: tuple[str, ...] = COLOURS
    spacing_px: int = 64
    dot_px: int = 3
    levels: tuple[int, ...] = (5, 10, 15, 20, 30, *range(45, 256, 15))

    def __post_init__(self) -> None:
        for name in ("width", "height", "spacing_px", "dot_px"):
            object.__setattr__(self, name, whole_number(name, getattr(self, name), least=1))
        object.__setattr__(self, "colours", names_of(self.colours))
        levels = real_array("levels", self.levels, (None,)).tolist()
        object.__setattr__(self, "levels", tuple(whole_number("a level", level) for level in levels))
        if not self.colours or set(self.colours) - set(COLOURS) or len(set(self.colours)) < len(self.colours):
            raise InputError(f"colours must be some of {', '.join(COLOURS)}; got {', '.join(self.colours) or 'none'}")
        if self.spacing_px < 16 or self.spacing_px % 2 or self.dot_px < 1 or self.dot_px % 2 == 0:
            raise InputError(f"spacing must be even, from 16, and a dot odd; got {self.spacing_px} and {self.dot_px}")
        if 3 * self.dot_px > self.spacing_px:
            raise InputError(f"dots {self.dot_px} wide need a spacing of at least {3 * self.dot_px}")
        if min(self._half) < 3 or self._half[1] < 4:
            most = min((self.width // 14) * 2, (self.height // 18) * 2)
            raise InputError(f"{self.width}×{self.height} pixels hold too few dots; use a spacing of at most {most}")
        if (
            len(self.levels) < 5
            or self.levels[0] < 1
            or self.levels[-1] != TOP_LEVEL
            or (np.diff(self.levels) <= 0).any()
        ):
            raise InputError(f"a ramp needs at least five levels from 1 up to 255, rising; got {self.levels}")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the pictures, in the order of the photographs."""
        return "dots", "uniform", *(f"ramp-{colour}" for colour in self.colours), "black"

    @property
    def _half(self) -> tuple[int, int]:
        """Dots on either side of the middle one."""
        margin = 2 * self.dot_px
        return (self.width // 2 - margin) // self.spacing_px, (self.height // 2 - margin) // self.spacing_px

    @cached_property
    def lattice(self) -> IntArray:
        """Indices (N, 2) of the dots from the middle one, along x and y."""
        nx, ny = self._half
        return np.stack(np.meshgrid(np.arange(-nx, nx + 1), np.arange(-ny, ny + 1)), axis=-1).reshape(-1, 2)

    def position(self, index: NDArray[np.generic]) -> FloatArray:
        """Display pixels (N, 2) of lattice indices (N, 2); halves for the markers."""
        halves = real_array("index", index, (None, 2))
        return np.asarray(np.array([self.width // 2, self.height // 2]) + self.spacing_px * halves)

    @property
    def square_px(self) -> int:
        """Width of a square, and of the gaps."""
        return 3 * self.spacing_px // 8

    @cached_property
    def squares(self) -> IntArray:
        """First column and row (N, 2) of each square."""
        side, size = self.square_px, np.array([self.width, self.height])
        count = (size - side) // (2 * side)
        first = (size - (2 * count - 1) * side) // 2
        index = np.stack(np.meshgrid(*(np.arange(n) for n in count)), axis=-1).reshape(-1, 2)
        return np.asarray(first + 2 * side * index)

    @cached_property
    def square_levels(self) -> IntArray:
        """Level (N,) of each square of a ramp: all levels equally often, scattered."""
        order = np.random.default_rng(0).permutation(len(self.squares))
        return np.array(self.levels)[order % len(self.levels)]

    def image(self, name: str) -> NDArray[np.uint8]:
        """Picture (H, W, 3) by its name.

        Raises
        ------
        InputError
            For an unknown name.
        """
        if text("name", name) not in self.names:
            raise InputError(f"unknown pattern {name!r}; use {', '.join(self.names)}")
        grey = np.zeros((self.height, self.width), np.uint8)
        if name == "dots":
            spots = self.position(np.concatenate([self.lattice, MARKERS])).astype(int) - self.dot_px // 2
            _paint(grey, spots, self.dot_px, np.full(len(spots), TOP_LEVEL))
        elif name != "black":
            levels = np.full(len(self.squares), TOP_LEVEL) if name == "uniform" else self.square_levels
            _paint(grey, self.squares, self.square_px, levels)
        lit = (name.removeprefix("ramp-"),) if name.startswith("ramp-") else self.colours
        return grey[..., None] * np.array([colour in lit for colour in COLOURS], np.uint8)


def _paint(grey: NDArray[np.uint8], first: IntArray, side: int, levels: IntArray) -> None:
    for (x, y), level in zip(first.tolist(), levels.tolist(), strict=True):
        grey[y : y + side, x : x + side] = level
