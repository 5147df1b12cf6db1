"""Steps of the per-pixel pipeline: kernels and their values. Their order is defined in `chain.py`.

A sequence begins with the steps that convert light to mean charge, if it has any: `LIGHT`, `PHOTO_RESPONSE`,
`DARK_CURRENT`. Only these can have a separate value for each pixel, and all three are applied together while a tile is
read.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from startracker.core import FloatArray, SingleArray

TILE = 2048
"""Pixels per tile. It must not be changed, because the noise of a seed depends on it: pixel k uses the 32 bits
(k mod TILE) div (TILE/4) of the block with counter (k div TILE) (TILE/4) + k mod (TILE/4)."""

LIGHT, PHOTO_RESPONSE, DARK_CURRENT, SHOT_NOISE, CLIP, GAUSSIAN_NOISE, BEND, AMPLIFY, CONVERT = range(9)
_BEGINNING = (LIGHT, PHOTO_RESPONSE, DARK_CURRENT)
_NO_MAP: SingleArray = np.zeros(0, dtype=np.float32)


@dataclass(frozen=True)
class Step:
    """One effect on single pixels."""

    kernel: int
    """Number of the kernel, such as `CLIP`."""
    values: tuple[float, ...] = ()
    """Values that are common to all pixels."""
    map: SingleArray = field(default_factory=lambda: _NO_MAP)
    """(N,): A value for each pixel; empty for none."""
    rng: np.random.Generator | str | None = None
    """Random stream, or its name; None for an effect without noise."""


def of_map(kernel: int, map_: SingleArray | FloatArray | float) -> Step:
    """Step with a value for each pixel, in single precision, or the same for all."""
    if np.ndim(map_) == 0:
        return Step(kernel, (float(map_),))
    return Step(kernel, map=np.ascontiguousarray(map_, dtype=np.float32).reshape(-1))


class Collection(NamedTuple):
    """First part of the pipeline: mean charge = light × response + dark current × exposure."""

    is_light: bool
    """Whether the signal is light, which must be finite and not negative."""
    response: float
    """Response that is common to all pixels."""
    response_map: SingleArray
    """(N,): Factor of each pixel, or ones for one tile if `response_mapped` is false."""
    response_mapped: bool
    """Whether each pixel has its own response."""
    dark_e_s: float
    """Dark current that is common to all pixels, electrons per second."""
    dark_map_e_s: SingleArray
    """(N,): Dark current of each pixel in addition to `dark_e_s`, or zeros for one tile if `dark_mapped` is false."""
    dark_mapped: bool
    """Whether each pixel has its own dark current."""


def begin(steps: Sequence[Step]) -> tuple[Collection, list[Step]]:
    """Split a sequence of steps into charge collection and the remaining steps.

    A sequence without the former gets a neutral one, so that the kernel needs no special case.
    """
    rest, first = list(steps), {}
    for kernel in _BEGINNING:
        if rest and rest[0].kernel == kernel:
            first[kernel] = rest.pop(0)
    if any(step.kernel in _BEGINNING for step in rest):
        raise ValueError("a sequence of steps must begin with light, photo response and dark signal, in this order")
    response = _of_pixels(first.get(PHOTO_RESPONSE), 1.0)
    return Collection(LIGHT in first, *response, *_of_pixels(first.get(DARK_CURRENT), 0.0)), rest


def _of_pixels(step: Step | None, neutral: float) -> tuple[float, SingleArray, bool]:
    """Common value, map of values, and whether each pixel has its own; otherwise the map is neutral, for one tile."""
    if step is not None and step.map.size:
        return neutral, step.map, True
    return neutral if step is None else step.values[0], np.full(TILE, neutral, dtype=np.float32), False
