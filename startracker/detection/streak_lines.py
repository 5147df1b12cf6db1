"""Lines in any direction that stand out of an image: where streaks may be."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from startracker.detection.matched import matched_kernel
from startracker.detection.streak_kernels import best_lines, keep_apart

__all__ = ["CLIP", "COARSE_SIGMA", "LOOKED_AT", "SHORTEST_PX", "candidate_lines", "find_peaks", "smooth_bins"]

FloatArray = NDArray[np.float64]
FloatImage = NDArray[np.float32]

SHORTEST_PX = 8.0
_LONGEST_SHARE = 0.3
"""Of the image's smaller side: of longer streaks too few lie within it."""
_OFF_LINE_PX = 1.5
"""A line of the search misses the end of a streak by no more than this."""
CLIP = 4.0
"""Noise in a bin at most counted: what is no streak (a star, a hit) is far brighter than long, and must not be
found in every line that runs across it."""
COARSE_SIGMA = 5.5
"""Chance exceeds it in some ten million places and lines about once in five frames; then four must fit one motion."""
_MOST_LINES = 40
LOOKED_AT = 600
_BIN_MIDDLE = np.array([0.5, 0.5, 0.0, 0.0])
"""A bin's middle from its corner, in the columns of a line."""


def candidate_lines(bins: FloatImage, unit: int) -> FloatArray:
    """Lines (N, 4), px: centre, half length along x and y, the most significant first."""
    longest = _LONGEST_SHARE * 2.0 * unit * min(bins.shape)
    lengths = SHORTEST_PX * unit * math.sqrt(2.0) ** np.arange(40)
    lengths = lengths[lengths <= max(longest, SHORTEST_PX * unit)]
    tables = []
    for turned in (False, True):
        half = bins.T if turned else bins
        half = half[:, : half.shape[1] // 2 * 2]
        rows = np.ascontiguousarray(half[:, ::2] + half[:, 1::2]) * np.float32(math.sqrt(0.5))
        table = _lines_one_way(rows, lengths / unit)
        # a line of the turned image runs along y
        scale = unit * np.array([4.0, 2.0, 4.0, 2.0])
        table[:, :4] = (table[:, :4] + _BIN_MIDDLE) * scale - _BIN_MIDDLE
        tables.append(table[:, [1, 0, 3, 2, 4]] if turned else table)
    every = np.concatenate(tables)
    every = every[np.argsort(-every[:, 4], kind="stable")][:LOOKED_AT]
    clipped = np.clip(smooth_bins(bins, 0.5), -CLIP, CLIP)
    in_bins = (every[:, :4] + _BIN_MIDDLE) / (2.0 * unit) - _BIN_MIDDLE
    kept = keep_apart(clipped, in_bins, 2.0, COARSE_SIGMA, _MOST_LINES)
    return np.asarray(every[kept, :4])


def _lines_one_way(rows: FloatImage, lengths: FloatArray) -> FloatArray:
    """Lines within 45° of the x axis (N, 5): centre, half lengths, significance; bins of 4 × 2 px."""
    smooth = np.zeros_like(rows)
    smooth += 2.0 * rows
    smooth[1:] += rows[:-1]
    smooth[:-1] += rows[1:]
    np.clip(smooth * np.float32(1.0 / math.sqrt(6.0)), -CLIP, CLIP, out=smooth)
    step = 4.0 * _OFF_LINE_PX / float(lengths.max())
    slopes = np.linspace(-1.0, 1.0, 2 * math.ceil(1.0 / step) + 1)
    every = np.maximum(1, (lengths.max() / lengths).astype(np.int64))
    spans = np.rint(lengths[None, :] / 4.0 / np.hypot(1.0, slopes)[:, None]).astype(np.int64)
    best, line = best_lines(np.ascontiguousarray(smooth.T), 2.0 * slopes, every, np.maximum(spans, 2))
    x, y = find_peaks(best, COARSE_SIGMA)
    number, length = np.divmod(line[x, y], len(lengths))
    span = spans[number, length]
    # the middle of an even number of bins is between two
    centre = x - 0.5 * (1 - span % 2)
    shift = (centre - x) * 2.0 * slopes[number]
    return np.column_stack([centre, y + shift, 0.5 * span, span * slopes[number], best[x, y]]).astype(np.float64)


def find_peaks(height: FloatImage, threshold: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns of local maxima above a threshold, the border left out."""
    y, x = np.nonzero(height[1:-1, 1:-1] > threshold)
    y, x = y + 1, x + 1
    top = np.ones(len(y), np.bool_)
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            if (dy, dx) != (0, 0):
                top &= height[y, x] >= height[y + dy, x + dx]
    return y[top], x[top]


def smooth_bins(bins: FloatImage, sigma: float) -> FloatImage:
    """Correlated with a star image of σ bins; white noise keeps its size."""
    kernel = matched_kernel(sigma).astype(np.float32)
    reach = len(kernel) // 2
    for axis in (0, 1):
        padded = np.pad(bins, [(reach, reach) if k == axis else (0, 0) for k in (0, 1)])
        size = bins.shape[axis]
        total = np.zeros_like(bins)
        for k in range(len(kernel)):
            total += kernel[k] * (padded[k : k + size] if axis == 0 else padded[:, k : k + size])
        bins = total
    return bins
