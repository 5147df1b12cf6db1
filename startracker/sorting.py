"""Sorting within kernels: NumPy's sort takes a second to compile for each data type."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from startracker._compiled import kernel, kernel_part

_INFINITE_BITS = int(np.float32(np.inf).view(np.int32))


@kernel
def sort(values: NDArray[Any]) -> None:
    """Sort numbers without NaN in place, ascending: heapsort (Williams 1964, Comm. ACM 7, 347)."""
    count = len(values)
    for step in range(count + count // 2):
        # first build a heap, then move its maximum to the end
        start, end = count // 2 - 1 - step, count
        if start < 0:
            end = count - (step - count // 2) - 1
            start = 0
            values[0], values[end] = values[end], values[0]
        value, parent, child = values[start], start, 2 * start + 1
        while child < end:
            if child + 1 < end and values[child] < values[child + 1]:
                child += 1
            if not value < values[child]:
                break
            values[parent] = values[child]
            parent, child = child, 2 * child + 1
        values[parent] = value


@kernel
def ranked(values: NDArray[np.float32], rank: int) -> tuple[float, float]:
    """Value at a rank, and at the next rank, that finite numbers would have if they were sorted.

    The last value is its own successor. A limit between the two is bisected by counting, over the bit patterns of
    numbers in ascending order: some twenty passes without a branch take a quarter of the time of a sort.
    """
    low, high, limit, count = -_INFINITE_BITS - 1, _INFINITE_BITS, np.float32(np.inf), np.int32(len(values))
    while low < high and count != rank + 1:
        middle, below = (low + high) >> 1, np.int32(0)
        # Negative floats have bit patterns in descending order; flipping all bits but the sign makes them ascending.
        trial = np.int32(middle if middle >= 0 else middle ^ 0x7FFFFFFF).view(np.float32)
        for i in range(np.uint64(len(values))):
            below = np.int32(below + np.int32(values[i] <= trial))
        if below > rank:
            high, limit, count = middle, trial, below
        else:
            low = middle + 1
    value, following = np.float32(-np.inf), np.float32(np.inf)
    for i in range(np.uint64(len(values))):
        within = values[i] <= limit
        value = max(value, values[i] if within else np.float32(-np.inf))
        following = min(following, np.float32(np.inf) if within else values[i])
    return float(value), float(following if count == rank + 1 < len(values) else value)


@kernel
def median(values: NDArray[np.float64]) -> float:
    """Median of numbers, which are sorted in place; NaN if one of them is NaN."""
    for value in values:
        if np.isnan(value):
            return np.nan
    sort(values)
    middle: float = 0.5 * (values[(len(values) - 1) // 2] + values[len(values) // 2])
    return middle


def finite_medians(values: NDArray[np.float64]) -> tuple[float, ...]:
    """Medians of the columns (K,) of a few rows (N, K), over the rows that are finite; NaN if there are none.

    For a handful of numbers Python's lists take a tenth of the time of `numpy.median`.
    """
    rows = [row for row in values.tolist() if all(map(math.isfinite, row))]
    columns = map(sorted, zip(*rows, strict=True)) if rows else [[math.nan]] * values.shape[1]
    return tuple(0.5 * (column[(len(column) - 1) // 2] + column[len(column) // 2]) for column in columns)


@kernel_part
def order_of(values: NDArray[np.float64], order: NDArray[np.int64]) -> None:
    """Write the indices of a few numbers in stable ascending order to `order`: insertion sort."""
    for last in range(len(values)):
        at = last
        while at > 0 and values[last] < values[order[at - 1]]:
            order[at] = order[at - 1]
            at -= 1
        order[at] = last


@kernel
def order_of_columns(keys: NDArray[np.float64]) -> NDArray[np.int64]:
    """Stable ascending order (N,) of the columns of numbers (K, N) without NaN, by the first row, then by the next
    ones.

    Shell's sort (Knuth 1998, The Art of Computer Programming 3, section 5.2.1); ties are ordered by index, which makes
    it stable.
    """
    count = keys.shape[1]
    order, gap = np.arange(count), 1
    while gap < count // 3:
        gap = 3 * gap + 1
    while gap > 0:
        for last in range(gap, count):
            column, at = order[last], last
            while at >= gap and _is_before(column, order[at - gap], keys):
                order[at] = order[at - gap]
                at -= gap
            order[at] = column
        gap //= 3
    return order


@kernel_part
def _is_before(one: int, other: int, keys: NDArray[np.float64]) -> bool:
    before, row = one < other, len(keys) - 1
    # From the last key to the first, so that the first one that differs decides.
    while row >= 0:
        if keys[row, one] != keys[row, other]:
            before = keys[row, one] < keys[row, other]
        row -= 1
    return before
