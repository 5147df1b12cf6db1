"""Mosaic of small windows of an image, to which detector and centroider are applied."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from startracker._compiled import kernel
from startracker.core import FloatArray, IntArray
from startracker.sorting import median

FloatImage = NDArray[np.float32]

_SIGMA_OF_MAD = 1.4826
_GAP_PX = 3
_NOISE_FREE = 1e-5
"""Minimum noise of a window relative to the peak of the brightest star."""


@kernel
def _background(image: NDArray[Any], x: int, y: int, half: int, rim: FloatArray) -> tuple[float, float]:
    """Level and noise of a window's rim, whose pixels are copied to `rim`; zeros without pixels."""
    count = 0
    for j in range(-half, half + 1):
        for i in range(-half, half + 1):
            if max(abs(i), abs(j)) < half - 1:
                continue
            row, column = y + j, x + i
            if 0 <= row < image.shape[0] and 0 <= column < image.shape[1]:
                value = float(image[row, column])
                if np.isfinite(value):
                    rim[count] = value
                    count += 1
    if count == 0:
        return 0.0, 0.0
    level = median(rim[:count])
    for n in range(count):
        rim[n] = abs(rim[n] - level)
    return level, _SIGMA_OF_MAD * median(rim[:count])


@kernel
def lay_out(
    image: NDArray[Any], x: IntArray, y: IntArray, half: int, columns: int, noise_floor: float
) -> tuple[FloatImage, FloatImage, FloatImage]:
    """Windows of an image as a mosaic, with the level and the noise of the background at the border of each.

    Level: the median of the rim (the outermost two rings of pixels); noise: 1.4826 times the median absolute deviation
    of these pixels, at least 0.7 times the median over all windows. Between windows, and outside the image, the mosaic
    contains background.

    Parameters
    ----------
    image : (H, W)
        Any real data type.
    x, y : (M,)
        Central pixels.
    half : int
        A window has 2 half + 1 pixels per side.
    columns : int
        Number of windows per row of the mosaic.
    noise_floor : float
        Minimum noise, which is also at least 1e-5 of the brightest central pixel.

    Returns
    -------
    Mosaic, level, noise: float32. Window m is at the centre of cell (m // columns, m % columns), whose side is
    `cell_px(half)`.
    """
    side, pitch = 2 * half + 1, 2 * half + 1 + 2 * _GAP_PX
    rows = (len(x) + columns - 1) // columns
    mosaic = np.zeros((rows * pitch, columns * pitch), np.float32)
    level = np.zeros_like(mosaic)
    noise = np.ones_like(mosaic)
    levels, noises = np.zeros(len(x)), np.zeros(len(x))
    rim = np.empty(8 * side)
    for m in range(len(x)):
        levels[m], noises[m] = _background(image, x[m], y[m], half, rim)
    common = median(noises.copy())
    top = common
    for m in range(len(x)):
        if 0 <= y[m] < image.shape[0] and 0 <= x[m] < image.shape[1] and np.isfinite(float(image[y[m], x[m]])):
            top = max(top, float(image[y[m], x[m]]) - levels[m])
    least = max(noise_floor, _NOISE_FREE * top, 1e-30)
    for m in range(len(x)):
        row0, column0 = (m // columns) * pitch, (m % columns) * pitch
        spread = max(noises[m], 0.7 * common, least)
        for j in range(pitch):
            for i in range(pitch):
                mosaic[row0 + j, column0 + i] = levels[m]
                level[row0 + j, column0 + i] = levels[m]
                noise[row0 + j, column0 + i] = spread
        for j in range(side):
            for i in range(side):
                row, column = y[m] - half + j, x[m] - half + i
                if 0 <= row < image.shape[0] and 0 <= column < image.shape[1]:
                    mosaic[row0 + _GAP_PX + j, column0 + _GAP_PX + i] = image[row, column]
    return mosaic, level, noise


def cell_px(half: int) -> int:
    """Pitch of the mosaic's cells."""
    return 2 * half + 1 + 2 * _GAP_PX


def to_image(xy: FloatArray, x: IntArray, y: IntArray, half: int, columns: int) -> FloatArray:
    """Positions (N, 2) on the image from positions on the mosaic."""
    pitch = cell_px(half)
    column = np.clip(np.floor_divide(xy[:, 0] + 0.5, pitch).astype(np.int64), 0, columns - 1)
    row = np.maximum(np.floor_divide(xy[:, 1] + 0.5, pitch).astype(np.int64), 0)
    window = np.minimum(row * columns + column, len(x) - 1)
    corner = np.stack([window % columns, window // columns], axis=1) * pitch + _GAP_PX + half
    return np.asarray(xy - corner + np.stack([x[window], y[window]], axis=1))


@kernel
def first_of_each(xy: FloatArray, width: float, height: float, margin: float, same_px: float) -> IntArray:
    """Rows of points (N, 2) that are finite, inside the image by a margin, and not within `same_px` of an earlier
    one."""
    out = np.empty(len(xy), np.int64)
    count = 0
    for i in range(len(xy)):
        x, y = xy[i, 0], xy[i, 1]
        inside = (
            margin - 0.5 <= x < width - 0.5 - margin and margin - 0.5 <= y < height - 0.5 - margin
        )  # false for NaN too
        if not inside:
            continue
        alone = True
        for k in range(count):
            other = out[k]
            if max(abs(xy[other, 0] - x), abs(xy[other, 1] - y)) < same_px:
                alone = False
                break
        if alone:
            out[count] = i
            count += 1
    return out[:count]
