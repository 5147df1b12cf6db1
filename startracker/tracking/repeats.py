"""Repeated frames: the same star list, or an image with the same pixels around its stars.

A frozen camera, or a buffer or list that is sent twice, looks like a body at rest, with identical noise that does not
average out. Because of noise no two frames are identical to the last bit.
"""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from startracker.core import FloatArray, IntArray

_FRAMES = 8
"""Number of frames remembered: more than the buffers of a camera driver."""
_STARS = 16
_HALF_PX = 3
"""7 × 7 pixels around each star are compared; elsewhere a driver may write counters or time stamps into the image."""
_STEPS = np.arange((2 * _HALF_PX + 1) ** 2) + (2 * _HALF_PX + 1) ** 2 // 2
_STEPS %= len(_STEPS)  # the star's own pixel comes first
_ROWS, _COLUMNS = _STEPS // (2 * _HALF_PX + 1) - _HALF_PX, _STEPS % (2 * _HALF_PX + 1) - _HALF_PX


class FrameMemory:
    """Recent frames used by the filter."""

    def __init__(self) -> None:
        self._lists: deque[tuple[float, bytes]] = deque(maxlen=_FRAMES)
        self._images: deque[tuple[float, tuple[int, ...], IntArray, IntArray, FloatArray]] = deque(maxlen=_FRAMES)

    def list_repeats(self, key: bytes) -> float | None:
        """Time of the frame with the same list (`list_key`); None if there is none."""
        return next((t_s for t_s, other in self._lists if other == key), None) if key else None

    def keep_list(self, t_s: float, key: bytes) -> None:
        """Remember a list that was used."""
        self._lists.append((t_s, key))

    def image_repeats(self, pixels: NDArray[Any] | None) -> float | None:
        """Time of the frame with the same pixels around its stars as this one (H, W); None if there is none."""
        if pixels is None:
            return None
        for t_s, shape, rows, columns, values in self._images:
            # one pixel is sufficient for nearly every new frame
            if pixels.shape != shape or pixels[rows[0], columns[0]] != values[0] == values[0]:
                continue
            # compared by bytes: NaN, which marks unusable pixels, then equals itself
            if pixels[rows, columns].astype(float).tobytes() == values.tobytes():
                return t_s
        return None

    def keep_image(self, t_s: float, pixels: NDArray[Any] | None, xy: FloatArray) -> None:
        """Remember the pixels of a used image around its identified stars, (N, 2)."""
        if pixels is None or not len(xy):
            return
        centre = np.rint(xy[:_STARS]).astype(np.int64)
        height, width = pixels.shape
        rows = np.minimum(np.maximum(centre[:, 1, None] + _ROWS, 0), height - 1).ravel()  # some are at the border
        columns = np.minimum(np.maximum(centre[:, 0, None] + _COLUMNS, 0), width - 1).ravel()
        self._images.append((t_s, pixels.shape, rows, columns, pixels[rows, columns].astype(float)))


def list_key(points: FloatArray) -> bytes:
    """Key of the coordinates (N, 2) of a list, independent of their order; empty for an empty list or another shape."""
    if points.ndim != 2 or points.shape[1] != 2:
        return b""
    pairs = np.ascontiguousarray(points, dtype=float).view(np.complex128)  # sorted by x, then by y
    return bytes(np.sort(pairs, axis=0).tobytes())
