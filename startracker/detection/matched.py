"""Matched filter: the image correlated with a Gaussian star image, for whole images and for single pixels."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from startracker._compiled import kernel, kernel_part
from startracker.detection.background import Background
from startracker.detection.scan import kernel_half, runs_above, search_rows
from startracker.detection.tiles import Plane
from startracker.detection.values import Image, is_integer, is_value
from startracker.errors import InputError
from startracker.sorting import ranked

FloatImage = NDArray[np.float32]


def stamp_pitch(half: FloatImage, radius: int) -> int:
    """Number of values from one row of a stamp to the next."""
    return 2 * (radius + len(half)) - 1


@kernel
def filter_stamp(
    image: Image, level: Plane, half: FloatImage, x0: int, y0: int, radius: int, work: FloatImage, out: FloatImage
) -> None:
    """Filtered signal around a pixel, row by row; NaN where the image has no value.

    Parameters
    ----------
    out : float32 array
        Its first (2 radius + 1) × `stamp_pitch` numbers are written, of which the first 2 radius + 1 of each row
        count: rows one behind the other are filtered as if they were one.
    work : float32 array
        Working space for twice the square of the pitch.
    """
    height, width = image.shape
    reach = len(half) - 1
    side, pitch = 2 * radius + 1, 2 * (radius + len(half)) - 1
    left, top = x0 - radius - reach, y0 - radius - reach
    first, last, square = max(left, 0), min(left + pitch, width), pitch * pitch
    # Only a stamp that extends beyond the image needs zeros: every other value is overwritten.
    if left < 0 or left + pitch > width or top < 0 or top + pitch > height:
        for i in range(square):
            work[i] = 0.0
    for y in range(max(top, 0), min(top + pitch, height)):
        share, cell, lines = level.share[y], np.uint64(level.cell[y]), level.lines
        below, row = min(cell + np.uint64(1), np.uint64(len(lines) - 1)), np.uint64(y)
        to = np.uint64((y - top) * pitch - left)
        for x in range(np.uint64(first), np.uint64(last)):
            signal = np.float32(image[row, x]) - (lines[cell, x] + share * (lines[below, x] - lines[cell, x]))
            work[to + x] = signal if is_value(image[row, x]) else np.float32(0.0)
    start, step = np.int64(0), np.int64(1)
    _correlate(work, start, half, pitch, work, square, side * pitch)
    _correlate(work, square, half, step, out, start, side * pitch - 2 * reach)
    inside = x0 >= radius and y0 >= radius and x0 + radius < width and y0 + radius < height
    if not (is_integer(image) and inside):
        for j in range(side):
            for i in range(side):
                y, x = y0 - radius + j, x0 - radius + i
                if not (0 <= y < height and 0 <= x < width and is_value(image[y, x])):
                    out[j * pitch + i] = np.nan


@kernel
def _correlate(
    values: FloatImage, start: int, half: FloatImage, step: int, out: FloatImage, to: int, count: int
) -> None:
    """Sums of 2 reach + 1 values that are `step` apart, each stored at the index of its first value."""
    reach, weight = len(half) - 1, half[0]
    # Two weights are applied per pass, so that the array is read and written half as often.
    for k in range(1, reach, 2):
        near, far = half[k], half[k + 1]
        inner, outer, middle = np.uint64(k * step), np.uint64((k + 1) * step), np.uint64(start + reach * step)
        for i in range(np.uint64(count)):
            at, sums = middle + i, np.uint64(to) + i
            before = weight * values[at] if k == 1 else out[sums]
            beside = near * (values[at - inner] + values[at + inner])
            out[sums] = before + beside + far * (values[at - outer] + values[at + outer])


@kernel_part
def filtered_pixel(image: Image, level: Plane, half: FloatImage, x0: int, y0: int) -> tuple[float, float]:
    """Filtered signal of a single pixel, and its own signal, DN; the first is NaN if the pixel is not finite."""
    height, width = image.shape
    reach, total = len(half) - 1, np.float32(0.0)
    for y in range(max(y0 - reach, 0), min(y0 + reach + 1, height)):
        line = np.float32(0.0)
        for x in range(max(x0 - reach, 0), min(x0 + reach + 1, width)):
            if is_value(image[y, x]):
                line += half[abs(x - x0)] * (np.float32(image[y, x]) - level[y, x])
        total += half[abs(y - y0)] * line
    filtered = np.float64(total) if is_value(image[y0, x0]) else np.nan
    return filtered, np.float64(np.float32(image[y0, x0]) - level[y0, x0])


DEFAULT_SIGMA_PX = 0.8
"""Width, px, if none is given. For stars of width σ the filter keeps 2 r / (1 + r²) of the best signal-to-noise ratio,
where r is the ratio of the widths including the pixel: more than 0.9 from 0.4 to 1.3 px."""
_REACH = 2.5
_LARGEST_SIGMA_PX = 20.0
_SAMPLES = 8192
_SIGMA_QUANTILES = (0.5, 0.841345, 0.933193)
"""Quantiles of a Gaussian at 0, 1 and 1½ standard deviations above the mean."""


def matched_kernel(sigma_px: float) -> NDArray[np.float64]:
    """One axis of the filter: a Gaussian integrated over pixels, with Σ k² = 1 so that white noise keeps its
    variance."""
    reach = max(1, math.ceil(_REACH * sigma_px - 0.5))
    edges = (np.arange(-reach, reach + 2) - 0.5) / (math.sqrt(2.0) * sigma_px)
    kernel = np.diff([math.erf(edge) for edge in edges])
    return np.asarray(kernel / np.sqrt(np.sum(kernel**2)))


@lru_cache(maxsize=16)
def filter_half(sigma_px: float | None) -> FloatImage:
    """The filter in the form that `startracker.detection.scan` uses; a width of None stands for 0.8 px.

    Raises
    ------
    InputError
        Width not between 0.05 and 20 px.
    """
    sigma = DEFAULT_SIGMA_PX if sigma_px is None else sigma_px
    if not 0.05 <= sigma <= _LARGEST_SIGMA_PX:
        raise InputError(f"detection.psf_sigma_px is {sigma}; it must be between 0.05 and {_LARGEST_SIGMA_PX:g} pixels")
    return kernel_half(matched_kernel(sigma))


def search_filtered(
    image: Image, background: Background, half: FloatImage, threshold: float
) -> tuple[NDArray[np.int64], FloatImage, float]:
    """Find the pixels at which the image, correlated with a Gaussian star image, exceeds `threshold` × its noise.

    A star of flux F whose pixels have the shares p (Σ p = 1) stands F Σ p k above the background in the filtered image,
    or F √(Σ p²) if the width is right; its brightest pixel alone has F max p. For σ = 0.8 px the gain is 1.5 on the
    centre of a pixel and 1.8 on a corner (Turin 1960). White noise keeps its standard deviation. The noise of a
    photograph is correlated (interpolated colours, compression): `excess` is the ratio of the noise of the filtered
    image to the background's noise, at least 1, from quantiles of some thousand pixels. Two quantiles are used, because
    noise that is cut off at zero has a longer tail than a Gaussian.

    Parameters
    ----------
    image : float32 array, shape (H, W)
        DN. Pixels that are not finite, and those beyond the border, count as background.
    background : Background
        Of the same shape.
    half : array
        From `filter_half`.
    threshold : float
        In units of the filtered image's noise.

    Returns
    -------
    runs : int array, shape (R, 3)
        Row, first column, last column + 1, in reading order; no pixel of them is not finite.
    signal : float32 array
        Filtered signal of the runs' pixels, DN.
    excess : float
        Noise of the filtered image in units of the background's.
    """
    level, noise = background.level_plane, background.noise_plane
    stride = max(1, image.size // _SAMPLES) | 1
    groups, found, sample = search_rows(image, level, noise, half, threshold, stride)
    excess = 1.0
    if len(sample):
        middle, one, more = quantiles(sample, _SIGMA_QUANTILES)
        # Noise cannot be more correlated than if it is the same in every pixel, when the filter raises it by Σ k. Any
        # more than that comes from stars, which fill much of a small image.
        largest = float(half[0] + 2.0 * half[1:].sum()) ** 2
        excess = min(max(1.0, one - middle, (more - middle) / 1.5), largest)
    runs, signal = runs_above(groups, found, image, noise, excess * threshold)
    return runs, signal, excess


def quantiles(values: NDArray[np.float32], shares: tuple[float, ...]) -> list[float]:
    """Quantiles of finite values, interpolated between neighbours as `numpy.quantile` does."""
    found = []
    for share in shares:
        rank = share * (len(values) - 1)
        below, above = ranked(values, math.floor(rank))
        found.append(below + (rank - math.floor(rank)) * (above - below))
    return found
