"""Tables of what lights the detector in one exposure: which sources reach it, and what drawing them needs."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulator.frame import TrueSources

__all__ = ["Light", "Seen", "near_image", "path_middles"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class Seen(NamedTuple):
    """Sources whose light reaches the detector: their rows, and what was found on the way."""

    rows: IntArray
    in_camera: FloatArray
    xy: FloatArray
    electrons: FloatArray

    def select(self, kept: IntArray) -> Seen:
        """Some of them, by index array."""
        return Seen(self.rows[kept], self.in_camera[kept], self.xy[kept], self.electrons[kept])


class Light(NamedTuple):
    """Sources of one exposure with what drawing them needs; columns of equal length N, `limb` of three values."""

    sources: TrueSources
    in_camera: FloatArray
    radius_rad: FloatArray
    lit: FloatArray
    sun_angle_rad: FloatArray
    limb: FloatArray
    wavelength_nm: FloatArray

    @classmethod
    def joined(cls, first: Light, second: Light) -> Light:
        """One after the other."""
        columns = [np.concatenate(pair) for pair in zip(first[1:], second[1:], strict=True)]
        sources = {
            column.name: np.concatenate([getattr(light.sources, column.name) for light in (first, second)])
            for column in fields(TrueSources)
        }
        return cls(TrueSources(**sources), *columns)


@njit(cache=True, error_model="numpy")
def near_image(xy: FloatArray, extent_px: FloatArray, width: int, height: int) -> IntArray:
    """Rows of those places (N, 2) that lie on the image or outside by no more than an extent (N,)."""
    rows, count = np.empty(len(xy), np.int64), 0
    for n in range(len(xy)):
        x, y = xy[n, 0], xy[n, 1]
        if max(-x, x - width) <= extent_px[n] and max(-y, y - height) <= extent_px[n]:
            rows[count] = n
            count += 1
    return rows[:count]


@njit(cache=True, error_model="numpy")
def path_middles(paths: FloatArray, weights: FloatArray, otherwise: FloatArray) -> FloatArray:
    """Weighted means (N, 2) of paths (N, K, 2) over their moments that are not NaN; (N, 2) `otherwise` without one."""
    out = otherwise.copy()
    for n in range(len(paths)):
        x, y, total = 0.0, 0.0, 0.0
        for k in range(len(weights)):
            if math.isfinite(paths[n, k, 0] + paths[n, k, 1]):
                x += weights[k] * paths[n, k, 0]
                y += weights[k] * paths[n, k, 1]
                total += weights[k]
        if total > 0.0:
            out[n, 0], out[n, 1] = x / total, y / total
    return out
