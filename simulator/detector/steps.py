"""Effects that act on every pixel by itself, as steps: which kernel, with which numbers. `chain.py` has their order."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

LIGHT, PHOTO_RESPONSE, DARK_SIGNAL, SHOT_NOISE, CLIP, NORMAL_NOISE, BEND, AMPLIFY, CONVERT = range(9)
_NO_MAP: FloatArray = np.zeros(0)


@dataclass(frozen=True)
class Step:
    """One effect on each pixel: the kernel's number, its values, a value for each pixel, the stream."""

    kernel: int
    values: tuple[float, ...] = ()
    map: FloatArray = field(default_factory=lambda: _NO_MAP)
    rng: np.random.Generator | None = None


def of_map(kernel: int, map_: FloatArray | float) -> Step:
    """Step with a value for each pixel, or the same for all."""
    if np.ndim(map_) == 0:
        return Step(kernel, (float(map_),))
    return Step(kernel, map=np.ascontiguousarray(map_, dtype=np.float64).reshape(-1))
