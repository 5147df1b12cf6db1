"""Form of the objects of a table: second moments, pieces of halos."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from startracker.arrays import FloatArray
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
    flux = table["flux"]
    x, y = table["sum_x"] / flux, table["sum_y"] / flux
    xx = table["sum_xx"] / flux - x * x + _PIXEL_VARIANCE
    yy = table["sum_yy"] / flux - y * y + _PIXEL_VARIANCE
    xy = table["sum_xy"] / flux - x * y
    middle, half = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    elongated = middle + half > max_axis_ratio * np.maximum(middle - half, 1e-12)
    long = elongated & (table["pixels"] >= SHAPE_PIXELS) & (middle + half > LONG_LEAST_PX2)
    return Forms(np.column_stack([x, y]), np.column_stack([xx, yy, xy]), long)


def centres(table: Sources) -> FloatArray:
    """Centres of light (N, 2) of objects, px."""
    centre: FloatArray = np.column_stack([table["sum_x"], table["sum_y"]]) / table["flux"][:, None]
    return centre


def brightest_first(table: Sources) -> Sources:
    """The objects by falling flux; position breaks ties, so that the order never depends on how they were found."""
    falling = -table["flux"]
    order = np.argsort(falling)
    sorted_flux = falling[order]
    if np.any(sorted_flux[1:] == sorted_flux[:-1]):
        order = np.lexsort((table["x_peak"], table["y_peak"], falling))
    return table.take(order)


def are_long(table: Sources, needed: int, fewest: int, most: int, max_axis_ratio: float) -> bool:
    """Whether `needed` of the `most` brightest objects of at least `fewest` pixels are long: see `measure_forms`.

    `table` has the brightest first.
    """
    whole = np.flatnonzero((table["pixels"] >= fewest) & (table["flux"] > 0.0))[:most]
    return bool(np.count_nonzero(measure_forms(table.take(whole), max_axis_ratio).long) >= needed)


def is_halo(table: Sources) -> Flags:
    """Pieces of a brighter star's halo or diffraction rings; `table` has the brightest first.

    Under 0.05 of the star's peak, and within 2½ of its radii or as near as a ring of an Airy pattern can be that
    bright: the envelope of the rings at r first dark radii falls as 0.045 / r³, and the pattern's light divided by its
    peak gives that radius as 1.9 √(flux / (π peak)).
    """
    peaks, halo = table["peak_residual"], np.zeros(len(table), np.bool_)
    bright = np.flatnonzero(peaks > HALO_PEAK_RATIO * peaks.min(initial=np.inf))  # the others are too faint for rings
    if len(bright):
        stars, objects = np.empty((len(bright), 6)), np.column_stack([table["x_peak"], table["y_peak"], peaks])
        stars[:, :3] = objects[bright]
        stars[:, 3] = HALO_RADII * np.sqrt(table["pixels"][bright] / np.pi) + HALO_MARGIN_PX
        stars[:, 4] = 1.9 * np.sqrt(table["flux"][bright] / (np.pi * stars[:, 2]))
        # no farther than the ring about as faint as the faintest
        rings = np.cbrt(RING_MARGIN * 0.045 * stars[:, 2] / max(peaks.min(), 1e-30)) * stars[:, 4]
        stars[:, 5] = np.square(np.maximum(stars[:, 3], rings) + 1.0)
        _mark_halos(stars, objects, halo)
    return halo


@kernel
def _mark_halos(stars: FloatArray, objects: FloatArray, halo: Flags) -> None:
    """Mark objects (x, y, peak) near stars (x, y, peak, radius of the halo, first dark radius, squared reach)."""
    for star in range(len(stars)):
        for n in range(len(objects)):
            dx, dy = objects[n, 0] - stars[star, 0], objects[n, 1] - stars[star, 1]
            if dx * dx + dy * dy > stars[star, 5]:
                continue
            times, distance = stars[star, 2] / objects[n, 2], math.hypot(dx, dy)
            share = distance / stars[star, 4]
            ring = share * share * share < RING_MARGIN * 0.045 * times
            halo[n] |= times > HALO_PEAK_RATIO and (distance < stars[star, 3] or ring)
