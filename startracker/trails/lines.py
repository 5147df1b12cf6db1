"""Search for lines in an image that may be trails, in any direction or along one motion."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from startracker._compiled import kernel
from startracker.core import FloatArray
from startracker.detection.forms import motion_at
from startracker.detection.matched import matched_kernel, quantiles
from startracker.detection.tiles import Plane

FloatImage = NDArray[np.float32]

SHORTEST_PX = 8.0
LONGEST_SHARE = 0.3
"""Longest line as a share of the image's smaller side: too few longer trails lie completely within the image."""
_OFF_LINE_PX = 1.5
"""Largest distance of a line of the search from the end of a trail, px."""
_CLIP = 4.0
"""Signal of a bin, in units of its noise, at which it is clipped: an object that is not a trail (a star, a cosmic ray)
is far brighter than it is long, and must not be found in every line that crosses it."""
COARSE_SIGMA = 5.5
"""Threshold of the search: noise exceeds it in some ten million positions and lines about once in five frames, and then
four lines must fit one motion."""
_MOST_LINES = 40
_LOOKED_AT = 600
_NARROW_RAD = math.radians(8.0)
"""Range of directions that is searched on either side of one that the objects of a frame suggest."""
_ROWS_AT_ONCE = 16
_BIN_MIDDLE = np.array([0.5, 0.5, 0.0, 0.0])
"""Centre of a bin relative to its corner, in the columns of a line."""


@kernel
def bin_residual(residual: FloatImage, noise: Plane, side: int) -> FloatImage:
    """Residual / noise, summed over squares of `side` px and divided by `side`, so that white noise keeps σ = 1.

    Pixels that are not finite count as background; rows and columns at the end that do not fill a square are ignored.
    """
    height, width = residual.shape[0] // side, residual.shape[1] // side
    out, line = np.empty((height, width), np.float32), np.empty(width * side, np.float32)
    zero, last = np.float32(0.0), len(noise.lines) - 1
    for y in range(height):
        # The first row is copied rather than added to zeros, which saves a quarter of the time.
        first = residual[y * side]
        for x in range(width * side):
            line[x] = first[x] if abs(first[x]) < np.inf else zero
        for j in range(1, side):
            row = residual[y * side + j]
            for x in range(width * side):
                line[x] += row[x] if abs(row[x]) < np.inf else zero
        sums, share = out[y], noise.share[y * side]
        above, below = noise.lines[noise.cell[y * side]], noise.lines[min(noise.cell[y * side] + 1, last)]
        for x in range(width):
            sums[x] = line[x * side]
        for i in range(1, side):
            for x in range(width):
                sums[x] += line[x * side + i]
        for x in range(width):  # the noise hardly varies over a bin
            sums[x] /= np.float32(side) * (above[x * side] + share * (below[x * side] - above[x * side]))
    return out


@kernel
def best_lines(
    bins: FloatImage, slopes: FloatArray, every: NDArray[np.int64], spans: NDArray[np.int64]
) -> tuple[FloatImage, NDArray[np.int32]]:
    """Highest significance of the lines centred on each bin, and the number of that line.

    A line has one bin per column. Its sum is a difference of cumulative sums along the sheared rows (Brady 1998), so
    that all lengths of a slope cost as much as one.

    Parameters
    ----------
    bins : (W, H)
        Bins with noise of standard deviation 1, stored column by column, so that neighbours in memory belong to the
        same column of the line.
    slopes : (K,)
        Rows per column.
    every : (M,)
        Length m is combined with every `every[m]`-th slope, because short lines need fewer directions.
    spans : (K, M)
        Number of columns of each line.

    Returns
    -------
    best : (W, H)
        Sum over the line / √bins; bins above and below the image count as zero. −∞ if the line leaves the image on the
        left or right.
    line : (W, H)
        Slope number × M + length number.
    """
    width, height = bins.shape
    best = np.full((width, height), np.float32(-np.inf))
    line = np.zeros((width, height), np.int32)
    offset = np.empty(width, np.int64)
    lengths = spans.shape[1]
    # A shear moves the columns by up to half the width times the slope, up or down, so the sheared image is taller.
    tallest = height + 2 * (int(np.ceil(0.5 * width * np.abs(slopes).max())) + 1)
    running = np.zeros((width + 1, tallest), np.float32)
    for k in range(len(slopes)):
        for x in range(width):
            offset[x] = int(np.floor(slopes[k] * (x - 0.5 * width) + 0.5))
        low, high = offset.min(), offset.max()
        rows = height + high - low
        for x in range(width):
            # Rows of the sheared image that this column covers.
            first = high - offset[x]
            last = first + height
            before, after, column = running[x], running[x + 1], bins[x]
            after[:first] = before[:first]
            after[last:rows] = before[last:rows]
            old, new = before[first:last], after[first:last]
            for y in range(height):
                new[y] = old[y] + column[y]
        for m in range(lengths):
            if k % every[m] != 0:
                continue
            span = spans[k, m]
            scale = np.float32(1.0 / np.sqrt(span))
            code = np.int32(k * lengths + m)
            for x in range(width - span + 1):
                middle = x + span // 2
                first = high - offset[middle]
                end, begin = running[x + span, first : first + height], running[x, first : first + height]
                most, which = best[middle], line[middle]
                for y in range(height):
                    value = (end[y] - begin[y]) * scale
                    better = value > most[y]
                    most[y] = value if better else most[y]
                    which[y] = code if better else which[y]
    return best, line


@kernel
def _keep_apart(bins: FloatImage, lines: FloatArray, width: float, threshold: float, most: int) -> NDArray[np.int64]:
    """Indices of the lines, taken in order, that remain significant without the bins of the lines before.

    Parameters
    ----------
    bins : (H, W)
        Bins with noise of standard deviation 1.
    lines : (N, 4)
        Centre x and y, half length along x and y, bins; most significant first.
    width : float
        Distance from an accepted line, in bins, within which bins belong to it.
    threshold : float
        Least value of sum over the free bins / √(all bins of the line).
    most : int
        Largest number of lines.
    """
    height, columns = bins.shape
    free = np.ones((height, columns), np.bool_)
    kept = np.empty(min(most, len(lines)), np.int64)
    count = 0
    reach = int(np.ceil(width))
    for n in range(len(lines)):
        if count == len(kept):
            break
        x, y, u, v = lines[n]
        steps = int(np.ceil(max(abs(u), abs(v))))
        total = 0.0
        for k in range(-steps, steps + 1):
            i, j = int(np.rint(x + u * k / steps)), int(np.rint(y + v * k / steps))
            if 0 <= i < columns and 0 <= j < height and free[j, i]:
                total += bins[j, i]
        if total < threshold * np.sqrt(2 * steps + 1.0):
            continue
        kept[count] = n
        count += 1
        for k in range(-steps - reach, steps + reach + 1):
            i, j = int(np.rint(x + u * k / steps)), int(np.rint(y + v * k / steps))
            for q in range(max(0, j - reach), min(height, j + reach + 1)):
                for p in range(max(0, i - reach), min(columns, i + reach + 1)):
                    free[q, p] = False
    return kept[:count]


def candidate_lines(bins: FloatImage, unit: int, direction_rad: float | None = None) -> FloatArray:
    """Most significant lines (N, 4) of an image, px: centre, and half the length along x and y.

    Parameters
    ----------
    bins : (H, W)
        Squares of 2 × `unit` px with noise of standard deviation 1.
    unit : int
        Scale of the search, px.
    direction_rad : float, optional
        Search only lines within 8° of this direction.
    """
    longest = LONGEST_SHARE * 2.0 * unit * min(bins.shape)
    lengths = SHORTEST_PX * unit * math.sqrt(2.0) ** np.arange(40)
    lengths = lengths[lengths <= max(longest, SHORTEST_PX * unit)]
    tables = []
    # Lines within 45° of the x axis are searched in bins of 4 × 2 units, the others in the transposed image.
    for turned in (False, True):
        half = bins.T if turned else bins
        half = half[:, : half.shape[1] // 2 * 2]
        rows = np.ascontiguousarray(half[:, ::2] + half[:, 1::2]) * np.float32(math.sqrt(0.5))
        angle = None if direction_rad is None else 0.5 * math.pi - direction_rad if turned else direction_rad
        table = _lines_one_way(rows, lengths / unit, angle)
        # A line of the transposed image runs along y.
        scale = unit * np.array([4.0, 2.0, 4.0, 2.0])
        table[:, :4] = (table[:, :4] + _BIN_MIDDLE) * scale - _BIN_MIDDLE
        tables.append(table[:, [1, 0, 3, 2, 4]] if turned else table)
    every = np.concatenate(tables)
    every = every[np.argsort(-every[:, 4], kind="stable")][:_LOOKED_AT]
    clipped = np.clip(_smooth_bins(bins, 0.5), -_CLIP, _CLIP)
    in_bins = (every[:, :4] + _BIN_MIDDLE) / (2.0 * unit) - _BIN_MIDDLE
    kept = _keep_apart(clipped, in_bins, 2.0, COARSE_SIGMA, _MOST_LINES)
    return np.asarray(every[kept, :4])


def _lines_one_way(rows: FloatImage, lengths: FloatArray, angle_rad: float | None) -> FloatArray:
    """Lines (N, 5) within 45° of the x axis, in bins of 4 × 2 px: centre, half lengths, significance."""
    # Two adjacent slopes differ at the end of the longest line by twice the largest distance allowed.
    step = 4.0 * _OFF_LINE_PX / float(lengths.max())
    slopes = np.linspace(-1.0, 1.0, 2 * math.ceil(1.0 / step) + 1)
    every = np.maximum(1, (lengths.max() / lengths).astype(np.int64))
    if angle_rad is not None:
        apart = np.abs((np.arctan(slopes) - angle_rad + 0.5 * math.pi) % math.pi - 0.5 * math.pi)
        # Fewer directions are needed near the given one, and short lines use only the first of them.
        slopes = slopes[np.argsort(apart)[: np.count_nonzero(apart < _NARROW_RAD)]]
        if not len(slopes):
            return np.empty((0, 5))
    # Smoothed across the lines with weights 1, 2, 1, normalised so that white noise keeps its standard deviation.
    smooth = np.zeros_like(rows)
    smooth += 2.0 * rows
    smooth[1:] += rows[:-1]
    smooth[:-1] += rows[1:]
    np.clip(smooth * np.float32(1.0 / math.sqrt(6.0)), -_CLIP, _CLIP, out=smooth)
    spans = np.rint(lengths[None, :] / 4.0 / np.hypot(1.0, slopes)[:, None]).astype(np.int64)
    best, line = best_lines(_transposed(smooth), 2.0 * slopes, every, np.maximum(spans, 2))
    x, y = _peaks(best, COARSE_SIGMA)
    number, length = np.divmod(line[x, y], len(lengths))
    span = spans[number, length]
    # The middle of an even number of bins lies between two bins.
    centre = x - 0.5 * (1 - span % 2)
    shift = (centre - x) * 2.0 * slopes[number]
    return np.column_stack([centre, y + shift, 0.5 * span, span * slopes[number], best[x, y]]).astype(np.float64)


def lines_along(bins: FloatImage, scale: float, motion: FloatArray, threshold: float, sigma_px: float) -> FloatArray:
    """Centres (N, 2), px, of significant lines along the trails that a motion causes, most significant first.

    Parameters
    ----------
    bins : (H, W)
        Squares of `scale` px with noise of standard deviation 1.
    motion : (3,)
        (a, b, c) of `startracker.detection.forms`.
    threshold : float
        Least significance, in standard deviations of the sums along the lines.
    sigma_px : float
        Width of a star image, px.
    """
    clipped = np.clip(_smooth_bins(bins, max(sigma_px / scale, 0.3)), -_CLIP, _CLIP)
    response = _response(clipped, scale, motion)
    sample = response[np.isfinite(response)]
    if not len(sample):
        return np.empty((0, 2))
    # Trails raise the upper quantiles of the response, so its noise is measured below the median.
    low, middle = quantiles(sample[:: max(1, len(sample) // 16384)].copy(), (0.158655, 0.5))
    limit = middle + threshold * max(middle - low, 1e-6)
    y, x = _peaks(response, limit)
    order = np.argsort(-response[y, x], kind="stable")[: 10 * _LOOKED_AT]
    xy = np.column_stack([x, y])[order].astype(np.float64)
    halves = 0.5 * motion_at((xy - _middle(bins)) * scale, motion) / scale
    kept = _keep_apart(clipped, np.column_stack([xy, halves]), 2.0, limit, _LOOKED_AT)
    return np.asarray((xy[kept] + 0.5) * scale - 0.5)


def _middle(bins: FloatImage) -> FloatArray:
    return 0.5 * (np.array(bins.shape[::-1]) - 1.0)


def _response(bins: FloatImage, scale: float, motion: FloatArray) -> FloatImage:
    """Sum / √bins (H, W) along the line that a motion causes at each bin; −∞ if the line leaves the image.

    The image is divided into blocks over which the line changes by two bins at most; within a block one line is used.
    """
    height, width = bins.shape
    out = np.full((height, width), np.float32(-np.inf))
    pieces = [math.ceil(0.5 * abs(motion[2]) * size + 1e-9) for size in (height, width)]
    rows, columns = (np.linspace(0, size, n + 1).astype(int) for size, n in zip((height, width), pieces, strict=True))
    for top, bottom in pairwise(rows):
        for left, right in pairwise(columns):
            centre = np.array([left + right - 1, top + bottom - 1]) / 2.0
            u, v = motion_at((centre - _middle(bins))[None] * scale, motion)[0] / scale
            reach_x, reach_y = math.ceil(0.5 * abs(u)) + 1, math.ceil(0.5 * abs(v)) + 1
            x0, x1 = max(left - reach_x, 0), min(right + reach_x, width)
            y0, y1 = max(top - reach_y, 0), min(bottom + reach_y, height)
            part, turned = bins[y0:y1, x0:x1], abs(v) > abs(u)
            along, across = (v, u) if turned else (u, v)
            span = max(round(abs(along)), 1)
            if span >= part.shape[0 if turned else 1]:
                continue
            best, _ = best_lines(
                np.ascontiguousarray(part) if turned else _transposed(part),
                np.array([across / along if along else 0.0]),
                np.ones(1, np.int64),
                np.array([[span]]),
            )
            best = best if turned else _transposed(best)
            out[top:bottom, left:right] = best[top - y0 : bottom - y0, left - x0 : right - x0]
    x, y = np.arange(width) - _middle(bins)[0], np.arange(height) - _middle(bins)[1]
    half_x, half_y = 0.5 * (motion[0] / scale - motion[2] * y), 0.5 * (motion[1] / scale + motion[2] * x)
    for map_, at, half in ((out, x, half_x), (out.T, y, half_y)):
        reach, room = math.ceil(float(np.abs(half).max())) + 1, 0.5 * (len(at) - 1) - np.abs(half)
        for border in (slice(None, reach), slice(-reach, None)):
            map_[:, border][np.abs(at[border]) > room[:, None]] = -np.inf
    return out


def _transposed(values: FloatImage) -> FloatImage:
    """Transposed copy, made some rows at a time, because each value in a column of a large map is in its own cache
    line."""
    out = np.empty(values.shape[::-1], values.dtype)
    for row in range(0, len(values), _ROWS_AT_ONCE):
        out[:, row : row + _ROWS_AT_ONCE] = values[row : row + _ROWS_AT_ONCE].T
    return out


def _peaks(height: FloatImage, threshold: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns of local maxima above a threshold, excluding the border."""
    y, x = np.divmod(np.flatnonzero(height[1:-1, 1:-1] > threshold), height.shape[1] - 2)
    y, x = y + 1, x + 1
    top = np.ones(len(y), np.bool_)
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            if (dy, dx) != (0, 0):
                top &= height[y, x] >= height[y + dy, x + dx]
    return y[top], x[top]


def _smooth_bins(bins: FloatImage, sigma: float) -> FloatImage:
    """Bins correlated with a star image of σ bins; white noise keeps its standard deviation."""
    kernel = matched_kernel(sigma).astype(np.float32)
    middle, part = len(kernel) // 2, np.empty_like(bins)
    for axis in (0, 1):
        total = bins * kernel[middle]
        for k in range(1, middle + 1):
            np.multiply(bins, kernel[middle + k], out=part)
            later, earlier = (np.s_[k:], np.s_[:-k]) if axis == 0 else (np.s_[:, k:], np.s_[:, :-k])
            total[later] += part[earlier]
            total[earlier] += part[later]
        bins = total
    return bins
