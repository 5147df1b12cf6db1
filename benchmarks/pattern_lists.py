"""Lists of points that are not a sky."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Pattern = Literal["uniform", "clump", "clumps", "line", "grid", "ring", "pairs", "clump_and_field"]
PATTERNS: tuple[Pattern, ...] = ("uniform", "clump", "clumps", "line", "grid", "ring", "pairs", "clump_and_field")


def pattern_list(pattern: Pattern, size_px: tuple[int, int], rng: np.random.Generator, count: int) -> FloatArray:
    """Up to `count` points (≤ count, 2) that are not a sky: pixels from the centre of an image of this size, in random
    order."""
    half = np.array(size_px) / 2.0
    jitter = rng.normal(0.0, rng.choice([0.0, 0.1, 1.0]), (count, 2))
    center = rng.uniform(-half, half) * 0.7
    if pattern == "uniform":
        xy = rng.uniform(-half, half, (count, 2))
    elif pattern == "clump":
        xy = center + rng.normal(0.0, math.exp(rng.uniform(1.0, 4.6)), (count, 2))
    elif pattern == "clumps":
        centers = rng.uniform(-half, half, (3, 2)) * 0.8
        xy = centers[rng.integers(3, size=count)] + rng.normal(0.0, math.exp(rng.uniform(1.0, 3.5)), (count, 2))
    elif pattern == "clump_and_field":
        xy = rng.uniform(-half, half, (count, 2))
        part = max(count // 2, 2)
        xy[:part] = center + rng.normal(0.0, math.exp(rng.uniform(1.0, 4.0)), (part, 2))
    elif pattern == "line":
        a = rng.uniform(0.0, math.pi)
        along = rng.uniform(-half.max(), half.max(), count) if rng.random() < 0.5 else np.arange(count) * 25.0 - 140.0
        xy = center * 0.3 + along[:, None] * [math.cos(a), math.sin(a)] + jitter
    elif pattern == "grid":
        a, pitch = rng.uniform(0.0, math.pi), rng.uniform(15.0, 90.0, 2)
        columns = int(rng.integers(2, 5))
        cell = np.stack([np.arange(count) % columns, np.arange(count) // columns], axis=1)
        rotation = np.array([[math.cos(a), math.sin(a)], [-math.sin(a), math.cos(a)]])
        xy = (cell - cell.mean(axis=0)) * pitch @ rotation + center * 0.3 + jitter
    elif pattern == "ring":
        turn = np.arange(count) * 2.0 * math.pi / count + rng.uniform(0.0, 6.3)
        xy = rng.uniform(20.0, half.min()) * np.stack([np.cos(turn), np.sin(turn)], axis=1) + jitter
    else:
        first = rng.uniform(-half, half, ((count + 1) // 2, 2))
        xy = np.concatenate([first, first + rng.normal(0.0, 8.0, first.shape)])[:count]
    xy = xy[(np.abs(xy) < half - 0.5).all(axis=1)]
    return np.asarray(xy[rng.permutation(len(xy))])
