"""Effects that act on every pixel by itself, as steps: which kernel, with which numbers. `chain.py` has their order.

A row of them begins with what makes mean charge of light, if anything does: `LIGHT`, `PHOTO_RESPONSE`, `DARK_SIGNAL`.
These alone may have a value of its own for each pixel, and are done together, while the pixels are fetched.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
SingleArray = NDArray[np.float32]

LIGHT, PHOTO_RESPONSE, DARK_SIGNAL, SHOT_NOISE, CLIP, NORMAL_NOISE, BEND, AMPLIFY, CONVERT = range(9)
_BEGINNING = (LIGHT, PHOTO_RESPONSE, DARK_SIGNAL)
_NO_MAP: SingleArray = np.zeros(0, dtype=np.float32)


@dataclass(frozen=True)
class Step:
    """One effect on each pixel: the kernel's number, its values, a value for each pixel, the stream or its name."""

    kernel: int
    values: tuple[float, ...] = ()
    map: SingleArray = field(default_factory=lambda: _NO_MAP)
    rng: np.random.Generator | str | None = None


def of_map(kernel: int, map_: SingleArray | FloatArray | float) -> Step:
    """Step with a value for each pixel, to seven digits, or the same for all."""
    if np.ndim(map_) == 0:
        return Step(kernel, (float(map_),))
    return Step(kernel, map=np.ascontiguousarray(map_, dtype=np.float32).reshape(-1))


_ALL_OF_IT, _NO_DARK = Step(PHOTO_RESPONSE, (1.0,)), Step(DARK_SIGNAL, (0.0,))


class Collection(NamedTuple):
    """How a row begins: mean charge = light × response + dark signal.

    Parameters
    ----------
    light : bool
        Whether the signal is light, which has to be finite and not negative.
    response, dark_e : float
        Of all pixels.
    responses, darks_e : (N,) float32
        Of each pixel, in place of those of all; empty where all are alike.
    """

    light: bool
    response: float
    responses: SingleArray
    dark_e: float
    darks_e: SingleArray


def begin(steps: Sequence[Step]) -> tuple[Collection, list[Step]]:
    """How a row begins, and what is left of it."""
    rest, first = list(steps), {}
    for kernel in _BEGINNING:
        if rest and rest[0].kernel == kernel:
            first[kernel] = rest.pop(0)
    if any(step.kernel in _BEGINNING for step in rest):
        raise ValueError("light, photo response and dark signal begin a row of steps, in this order")
    response, dark = first.get(PHOTO_RESPONSE, _ALL_OF_IT), first.get(DARK_SIGNAL, _NO_DARK)
    return Collection(LIGHT in first, sum(response.values), response.map, sum(dark.values), dark.map), rest
