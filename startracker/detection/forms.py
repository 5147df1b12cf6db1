"""Form of the objects of a table: second moments, pieces of halos."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from startracker.core import FloatArray
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
from startracker.kernels import kernel, kernel_part

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
    """Centre (N, 2), second moments (N, 3) of x, y and xy, and whether an object is too long for a star."""
    moments, long = np.empty((len(table), 5)), np.empty(len(table), np.bool_)
    _measure_forms(table, max_axis_ratio, moments, long)
    return Forms(moments[:, :2], moments[:, 2:], long)


@kernel
def _measure_forms(table: Sources, max_axis_ratio: float, moments: FloatArray, long: Flags) -> None:
    for n in range(len(table)):
        x, y, xx, yy, xy, long[n] = form_of(table[n], max_axis_ratio)
        moments[n, 0], moments[n, 1], moments[n, 2], moments[n, 3], moments[n, 4] = x, y, xx, yy, xy


@kernel_part
def form_of(row: np.void, max_axis_ratio: float) -> tuple[float, float, float, float, float, bool]:
    """Centre and second moments x, y, xx, yy, xy of an object, and whether it is too long for a star.

    Too long is an object whose second moments along its principal axes differ by more than a factor (Greyling 1995,
    eqs. 4.8 and 4.9, here along the principal axes, so that a slanted streak is one too). The moments are weighted with
    the signal; the variance of a pixel is added to each; objects of fewer than seven pixels have no shape.
    """
    flux = row["flux"]
    x, y = row["sum_x"] / flux, row["sum_y"] / flux
    xx = row["sum_xx"] / flux - x * x + _PIXEL_VARIANCE
    yy = row["sum_yy"] / flux - y * y + _PIXEL_VARIANCE
    xy = row["sum_xy"] / flux - x * y
    middle, half = 0.5 * (xx + yy), math.hypot(0.5 * (xx - yy), xy)
    elongated = middle + half > max_axis_ratio * max(middle - half, 1e-12)
    return x, y, xx, yy, xy, elongated and row["pixels"] >= SHAPE_PIXELS and middle + half > LONG_LEAST_PX2


def centres(table: Sources) -> FloatArray:
    """Centres of light (N, 2) of objects, px."""
    centre, flux = np.empty((len(table), 2)), table["flux"]
    np.divide(table["sum_x"], flux, centre[:, 0])
    np.divide(table["sum_y"], flux, centre[:, 1])
    return centre


def brightest_first(table: Sources) -> Sources:
    """The objects by falling flux; position breaks ties, so that the order never depends on how they were found."""
    falling = -table["flux"]
    order = np.argsort(falling)
    sorted_flux = falling[order]
    if (sorted_flux[1:] == sorted_flux[:-1]).any():
        order = np.lexsort((table["x_peak"], table["y_peak"], falling))
    return table.take(order)


def are_long(table: Sources, needed: int, fewest: int, most: int, max_axis_ratio: float) -> bool:
    """Whether `needed` of the `most` brightest objects of at least `fewest` pixels are long: see `form_of`.

    `table` has the brightest first.
    """
    whole = ((table["pixels"] >= fewest) & (table["flux"] > 0.0)).nonzero()[0][:most]
    return bool(np.count_nonzero(measure_forms(table.take(whole), max_axis_ratio).long) >= needed)


@kernel
def is_halo(table: Sources) -> Flags:
    """Pieces of a brighter star's halo or diffraction rings; `table` has the brightest first.

    Under 0.05 of the star's peak, and within 2½ of its radii or as near as a ring of an Airy pattern can be that
    bright: the envelope of the rings at r first dark radii falls as 0.045 / r³, and the pattern's light divided by its
    peak gives that radius as 1.9 √(flux / (π peak)).
    """
    halo, faintest = np.zeros(len(table), np.bool_), np.inf
    x, y, peaks = np.empty(len(table), np.int64), np.empty(len(table), np.int64), np.empty(len(table))
    for n in range(len(table)):
        x[n], y[n], peaks[n] = table[n]["x_peak"], table[n]["y_peak"], table[n]["peak_residual"]
        faintest = min(faintest, peaks[n])
    for star in range(len(peaks)):
        peak = peaks[star]
        if not peak > HALO_PEAK_RATIO * faintest:  # most objects of a frame are too faint for rings
            continue
        near = HALO_RADII * math.sqrt(table[star]["pixels"] / np.pi) + HALO_MARGIN_PX
        dark_radius = 1.9 * math.sqrt(table[star]["flux"] / (np.pi * peak))
        # no farther than the ring about as faint as the faintest
        reach = max(near, dark_radius * (RING_MARGIN * 0.045 * peak / max(faintest, 1e-30)) ** (1.0 / 3.0)) + 1.0
        for n in range(np.uint64(len(peaks))):
            dx, dy = x[n] - x[star], y[n] - y[star]
            if dx * dx + dy * dy > reach * reach:
                continue
            times, distance = peak / peaks[n], math.hypot(dx, dy)
            share = distance / dark_radius
            ring = share * share * share < RING_MARGIN * 0.045 * times
            halo[n] |= times > HALO_PEAK_RATIO and (distance < near or ring)
    return halo
