"""Brightness of a display: from the level of each colour to light, and back to the nearest levels.

Light is a flux relative to a star of magnitude 0 in the tracker's band: 10^(−0.4 m) for a star of magnitude m. A pixel
at (u, v) whose colours c have the levels l_c gives the flux

    U(u, v) · w · Σ_c 10^(−0.4 m_c) T_c(l_c)

with m_c the magnitude of one pixel at the highest level, T_c the relative curve (power law or table), w the share of
the sum that all colours together give, and U the uniformity, 1 at the middle of the display.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulator.live.stimulator.patterns import COLOURS, TOP_LEVEL
from startracker._compiled import kernel
from startracker.arguments import of_kind, pair, real_array, real_number, whole_number
from startracker.core import FloatArray, IntArray
from startracker.errors import InputError

__all__ = ["DITHERING", "Curve", "Photometry", "uniformity_terms"]


DITHERING = ("none", "spatial", "temporal")
"""Nearest level; the error of a pixel corrected in the next ones of the same star; levels that alternate from picture
to picture such that their mean is right."""
_ORDER = 4
_POWERS = tuple((j, n - j) for n in range(1, _ORDER + 1) for j in range(n, -1, -1))
_STEP_OF_PICTURE, _STEP_OF_PIXEL = 0.6180339887498949, 0.7548776662466927
"""Irrational steps, whose multiples modulo 1 are evenly distributed."""


@dataclass(frozen=True)
class Curve:
    """Relative light of one colour against its level: a power law, or a table.

    Parameters
    ----------
    gamma : float, optional
        Exponent of (level / 255)^gamma.
    levels, relative : tuple
        Otherwise a table that ends with (255, 1); level 0 gives 0. Between its points relative^(1/2.2) is
        interpolated by a monotone cubic.

    Raises
    ------
    InputError
        Unless exactly one of both is given and rises.
    """

    gamma: float | None = None
    levels: tuple[int, ...] = ()
    relative: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        for name in ("levels", "relative"):
            real_array(name, getattr(self, name), (None,), finite=False)
            object.__setattr__(self, name, tuple(np.asarray(getattr(self, name)).tolist()))
        if self.gamma is not None:
            real_number("gamma", self.gamma, finite=False)
        if self.gamma is not None:
            if self.levels or self.relative or not 0.2 <= self.gamma <= 6.0:
                raise InputError(f"a curve is a gamma from 0.2 to 6, or a table; got gamma {self.gamma}")
        elif not (
            len(self.levels) == len(self.relative) >= 2
            and (self.levels[-1], self.relative[-1]) == (TOP_LEVEL, 1.0)
            and self.levels[0] > 0
            and self.relative[0] >= 0.0
            and (np.diff(self.levels) > 0).all()
            and (np.diff(self.relative) >= 0).all()
        ):
            raise InputError("a curve's table must rise from a level above 0 to level 255 with relative 1")

    @cached_property
    def table(self) -> FloatArray:
        """Relative light (256,) of each level."""
        if self.gamma is not None:
            return np.asarray((np.arange(TOP_LEVEL + 1) / TOP_LEVEL) ** self.gamma)
        from scipy.interpolate import PchipInterpolator

        root = np.array([0.0, *self.relative]) ** (1 / 2.2)
        return np.asarray(PchipInterpolator([0, *self.levels], root)(np.arange(TOP_LEVEL + 1)) ** 2.2)


def uniformity_terms(pixels: ArrayLike, size: tuple[int, int]) -> FloatArray:
    """Terms (N, 14) of ln U: x^j y^k, 1 ≤ j + k ≤ 4, in half widths and half heights from the middle."""
    x, y = (2.0 * (np.asarray(pixels, float) + 0.5) / np.array(size) - 1.0).T
    xs, ys = (np.cumprod([np.ones_like(one), *[one] * _ORDER], axis=0) for one in (x, y))
    return np.stack([xs[j] * ys[k] for j, k in _POWERS], axis=1)


class Levels(NamedTuple):
    """Levels (N, 3) of pixels in red, green and blue, the flux (N,) that they give, and that of the highest levels."""

    rgb: NDArray[np.uint8]
    flux: FloatArray
    most: FloatArray


@dataclass(frozen=True, eq=False)
class Photometry:
    """Brightness of a display.

    Parameters
    ----------
    size : tuple of int
        Columns and rows.
    magnitude : mapping of str to float
        Magnitude, in the tracker's band, of one pixel at level 255 in the middle of the display, by colour.
    curve : mapping of str to Curve
        Curve by colour.
    white_factor : float
        Flux of all colours at once over the sum of the single ones; 1 for an additive display.
    uniformity : (14,) array
        Coefficients of `uniformity_terms`; zeros: uniform.
    black : float
        Flux of a pixel at level 0 over that at level 255 in all colours.

    Raises
    ------
    InputError
        For unknown colours or values out of range.
    """

    size: tuple[int, int]
    magnitude: Mapping[str, float]
    curve: Mapping[str, Curve]
    white_factor: float = 1.0
    uniformity: FloatArray = field(default_factory=lambda: np.zeros(len(_POWERS)))
    black: float = 0.0

    def __post_init__(self) -> None:
        for side in pair("size", self.size):
            whole_number("size", side, least=1)
        for name in ("white_factor", "black"):
            real_number(name, getattr(self, name), finite=False)
        for name in ("magnitude", "curve"):
            of_kind(name, getattr(self, name), (Mapping,))
        for colour, value in self.magnitude.items():
            real_number(f"magnitude of {colour}", value, finite=False)
        for colour, one in self.curve.items():
            of_kind(f"curve of {colour}", one, Curve)
        real_array("uniformity", self.uniformity, (None,), finite=False)
        if not self.magnitude or set(self.magnitude) != set(self.curve) or set(self.magnitude) - set(COLOURS):
            raise InputError(f"a display needs a magnitude and a curve for some of {', '.join(COLOURS)}")
        numbers = [*self.magnitude.values(), self.white_factor, self.black, *self.uniformity]
        if not (np.isfinite(numbers).all() and self.white_factor > 0 and len(self.uniformity) == len(_POWERS)):
            raise InputError(f"brightness must be finite, and the uniformity {len(_POWERS)} coefficients")

    @property
    def full(self) -> FloatArray:
        """Flux (3,) of one pixel at level 255 in red, green and blue, all of them lit; 0 for colours not driven."""
        return self.white_factor * np.array(
            [10.0 ** (-0.4 * self.magnitude[c]) if c in self.magnitude else 0.0 for c in COLOURS]
        )

    @property
    def white_magnitude(self) -> float:
        """Magnitude of one pixel at level 255 in all colours."""
        return -2.5 * math.log10(float(self.full.sum()))

    def relative(self, pixels: ArrayLike) -> FloatArray:
        """Uniformity U (N,) at display pixels (N, 2)."""
        return np.asarray(np.exp(uniformity_terms(pixels, self.size) @ self.uniformity))

    def flux(self, pixels: ArrayLike, rgb: ArrayLike) -> FloatArray:
        """Flux (N,) of display pixels (N, 2) with levels (N, 3), above the black level."""
        levels = np.asarray(rgb, dtype=np.int64)
        light = sum(self.full[k] * self.curve[c].table[levels[:, k]] for k, c in enumerate(COLOURS) if c in self.curve)
        return np.asarray(self.relative(pixels) * light)

    def quantised(
        self, pixels: IntArray, wanted: FloatArray, star: IntArray, dithering: str = "spatial", picture: int = 0
    ) -> Levels:
        """Levels for a wanted flux.

        Parameters
        ----------
        pixels : (N, 2)
            Display pixels.
        wanted : (N,)
            Flux; beyond that of level 255 it is clipped.
        star : (N,)
            Star that each pixel belongs to, from 0: within a star, errors are passed on from its brightest pixel to
            its faintest, and from the brightest colour to the faintest, if `dithering` is ``spatial``.
        dithering : str
            One of `DITHERING`.
        picture : int
            Number of the picture, for ``temporal``.
        """
        room = self._uniform[pixels[:, 1], pixels[:, 0], None] * self.full
        order = np.lexsort((-wanted, star))
        driven = np.argsort(-self.full, kind="stable")[: len(self.curve)]
        threshold = np.full(len(pixels), 0.5)
        if dithering == "temporal":
            cell = pixels @ np.array([1, self.size[0]])
            threshold = (picture * _STEP_OF_PICTURE + cell * _STEP_OF_PIXEL) % 1.0
        rgb, flux = quantise(order, star, wanted, room, self._tables, driven, threshold, dithering == "spatial")
        return Levels(rgb, flux, room.sum(axis=1))

    @cached_property
    def _uniform(self) -> FloatArray:
        """U (H, W) of all pixels."""
        columns, rows = self.size
        pixels = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
        return self.relative(pixels).reshape(rows, columns)

    @cached_property
    def _tables(self) -> FloatArray:
        """Relative light (3, 256) of each colour and level; zeros for colours not driven."""
        return np.array([self.curve[c].table if c in self.curve else np.zeros(TOP_LEVEL + 1) for c in COLOURS])


@kernel
def quantise(
    order: IntArray,
    star: IntArray,
    wanted: FloatArray,
    room: FloatArray,
    tables: FloatArray,
    driven: IntArray,
    threshold: FloatArray,
    diffuse: bool,
) -> tuple[NDArray[np.uint8], FloatArray]:
    """Kernel of `Photometry.quantised`: levels (N, 3), and the flux (N,) that they give.

    Pixels are taken in `order`, and colours in that of `driven`; `room` (N, 3) is the flux at the highest level.
    """
    rgb, flux = np.zeros((len(wanted), 3), np.uint8), np.zeros(len(wanted))
    carry, last = 0.0, -1
    for n in order:
        if star[n] != last:
            carry, last = 0.0, star[n]
        share = min(wanted[n] / room[n].sum(), 1.0)
        for k in driven:
            table = tables[k]
            relative = share + (carry / room[n, k] if diffuse else 0.0)
            level = min(max(np.searchsorted(table, relative, side="right") - 1, 0), len(table) - 2)
            if relative - table[level] > threshold[n] * (table[level + 1] - table[level]):
                level += 1
            given = table[level] * room[n, k]
            carry = carry + share * room[n, k] - given if share < 1.0 else 0.0
            rgb[n, k] = level
            flux[n] += given
    return rgb, flux
