"""What the table of objects tells of their form: second moments, pieces of halos."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from startracker.detection.motion import elongations
from startracker.detection.sources import Sources
from startracker.detection.thresholds import (
    HALO_MARGIN_PX,
    HALO_PEAK_RATIO,
    HALO_RADII,
    LONG_LEAST_PX2,
    RING_MARGIN,
    SHAPE_PIXELS,
)
from startracker.kernels import kernel

__all__ = ["Forms", "are_long", "brightest_first", "is_halo", "measure_forms"]

FloatArray = NDArray[np.float64]
Flags = NDArray[np.bool_]

_PIXEL_VARIANCE = 1.0 / 12.0


@dataclass(frozen=True, eq=False)
class Forms:
    """Second moments of objects: see `measure_forms`."""

    centre: FloatArray
    moments: FloatArray
    long: Flags

    @property
    def lines(self) -> FloatArray:
        """Line (N, 2) as of `elongations`."""
        return elongations(*self.moments.T)


def measure_forms(table: Sources, max_axis_ratio: float) -> Forms:
    """Centre (N, 2), second moments (N, 3) of x, y and xy, and whether an object is too long for a star.

    Too long is an object whose second moments along its principal axes differ by more than a factor (Greyling 1995,
    eqs. 4.8 and 4.9, here along the principal axes, so that a slanted streak is one too). The moments are weighted with
    the signal; the variance of a pixel is added to each; objects of fewer than seven pixels have no shape.
    """
    return Forms(*_measure_forms(table, max_axis_ratio))


@kernel
def _measure_forms(table: Sources, max_axis_ratio: float) -> tuple[FloatArray, FloatArray, Flags]:
    count = len(table)
    centre, moments, long = np.empty((count, 2)), np.empty((count, 3)), np.empty(count, np.bool_)
    for n in range(count):
        row = table[n]
        flux = row["flux"]
        x, y = row["sum_x"] / flux, row["sum_y"] / flux
        xx = row["sum_xx"] / flux - x * x + _PIXEL_VARIANCE
        yy = row["sum_yy"] / flux - y * y + _PIXEL_VARIANCE
        xy = row["sum_xy"] / flux - x * y
        middle, half = 0.5 * (xx + yy), math.hypot(0.5 * (xx - yy), xy)
        centre[n, 0], centre[n, 1] = x, y
        moments[n, 0], moments[n, 1], moments[n, 2] = xx, yy, xy
        elongated = middle + half > max_axis_ratio * max(middle - half, 1e-12)
        long[n] = elongated and row["pixels"] >= SHAPE_PIXELS and middle + half > LONG_LEAST_PX2
    return centre, moments, long


@kernel
def brightest_first(table: Sources, fewest: int, largest: int) -> tuple[NDArray[np.int64], int, int, int]:
    """Objects of `fewest` to `largest` pixels that have a signal, brightest first; how many are smaller, larger, dark.

    Position breaks ties, so that the order never depends on how the objects were found.
    """
    index, count, small, large, dark = np.empty(len(table), np.int64), 0, 0, 0, 0
    for n in range(len(table)):
        if table["pixels"][n] < fewest:
            small += 1
        elif table["pixels"][n] > largest:
            large += 1
        elif not table["flux"][n] > 0.0:
            dark += 1
        else:
            index[count] = n
            count += 1
    index = index[:count]
    index = index[np.argsort(-table["flux"][index], kind="mergesort")]
    for last in range(1, count):
        n, place = index[last], last
        while place > 0 and _comes_before(table, n, index[place - 1]):
            index[place] = index[place - 1]
            place -= 1
        index[place] = n
    return index, small, large, dark


@kernel
def _comes_before(table: Sources, n: int, other: int) -> bool:
    """Of two objects of the same flux, the first in reading order."""
    if table["flux"][n] != table["flux"][other]:
        return False
    y, x = table["y_peak"][n] - table["y_peak"][other], table["x_peak"][n] - table["x_peak"][other]
    return bool(y < 0.0 or (y == 0.0 and x < 0.0))


@kernel
def are_long(table: Sources, needed: int, fewest: int, most: int, max_axis_ratio: float) -> bool:
    """Whether `needed` of the `most` brightest objects of at least `fewest` pixels are long: see `measure_forms`."""
    if int(np.sum(_measure_forms(table, max_axis_ratio)[2])) < needed:
        return False
    index = brightest_first(table, fewest, np.iinfo(np.int64).max)[0][:most]
    return int(np.sum(_measure_forms(table[index], max_axis_ratio)[2])) >= needed


@kernel
def is_halo(table: Sources) -> Flags:
    """Pieces of a brighter star's halo or diffraction rings; `table` has the brightest first.

    Under 0.05 of the star's peak, and within 2½ of its radii or as near as a ring of an Airy pattern can be that
    bright: the envelope of the rings at r first dark radii falls as 0.045 / r³, and the pattern's light divided by its
    peak gives that radius as 1.9 √(flux / (π peak)).
    """
    count = len(table)
    halo = np.zeros(count, np.bool_)
    # side by side in memory
    x, y, peaks = table["x_peak"].copy(), table["y_peak"].copy(), table["peak_residual"].copy()
    faintest = np.inf
    for n in range(count):
        faintest = min(faintest, peaks[n])
    for star in range(count):
        peak = peaks[star]
        if not peak > HALO_PEAK_RATIO * faintest:  # most objects of a frame are too faint for rings
            continue
        near = HALO_RADII * math.sqrt(table["pixels"][star] / np.pi) + HALO_MARGIN_PX
        dark_radius = 1.9 * math.sqrt(table["flux"][star] / (np.pi * peak))
        # no farther than the ring about as faint as the faintest
        reach = max(near, dark_radius * (RING_MARGIN * 0.045 * peak / max(faintest, 1e-30)) ** (1.0 / 3.0)) + 1.0
        for n in range(np.uint64(count)):
            dx, dy = x[n] - x[star], y[n] - y[star]
            if dx * dx + dy * dy > reach * reach:
                continue
            times = peak / peaks[n]
            if times > HALO_PEAK_RATIO and not halo[n]:
                distance = math.hypot(dx, dy)
                ring = (distance / dark_radius) ** 3 < RING_MARGIN * 0.045 * times
                halo[n] = distance < near or ring
    return halo
