"""Star candidates: what the detectors hand on, and the criteria they share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from startracker.settings import DetectionSettings

__all__ = ["COLUMNS", "Spots", "is_streak", "select_spots"]

COLUMNS = 14
"""Columns of the table of objects: see `select_spots`."""
(
    PIXELS,
    FLUX,
    X_PEAK,
    Y_PEAK,
    PEAK,
    AT_PEAK,
    SATURATED,
    EDGE,
    SUM_X,
    SUM_Y,
    SUM_XX,
    SUM_YY,
    SUM_XY,
    PEAK_RESIDUAL,
) = range(COLUMNS)

_FLAT_TOP_PIXELS = 5
"""Pixels that share the highest value of a flat top; a star centred on a corner has four of them."""
_SHAPE_PIXELS = 7
"""The thesis' smallest object; the second moments of fewer pixels are noise."""
_PIXEL_VARIANCE = 1.0 / 12.0
_HALO_TIMES = 20.0
_HALO_RADII = 2.5
_HALO_MARGIN_PX = 3.0
_RING_MARGIN = 3.0


@dataclass(frozen=True, eq=False)
class Spots:
    """Star candidates as columns of equal length N, brightest first.

    Parameters
    ----------
    x_peak, y_peak : int array
        Brightest pixel; the first in reading order where several are.
    flux : array
        Sum over the object's pixels above the background, DN.
    pixels : int array
        Number of pixels above the threshold.
    saturated : bool array
        Whether a pixel reaches the saturation, or the top is flat.
    edge : bool array
        Whether the object touches the border of the image, so that a part may be missing.
    """

    x_peak: NDArray[np.int64]
    y_peak: NDArray[np.int64]
    flux: NDArray[np.float64]
    pixels: NDArray[np.int64]
    saturated: NDArray[np.bool_]
    edge: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.flux)

    @classmethod
    def none(cls) -> Spots:
        """No candidates."""
        integers, flags = np.empty(0, np.int64), np.empty(0, np.bool_)
        return cls(integers, integers, np.empty(0), integers, flags, flags)


def is_streak(table: NDArray[np.float64], max_axis_ratio: float) -> NDArray[np.bool_]:
    """Objects whose second moments along their principal axes differ by more than a factor.

    The moments are weighted with the signal (thesis eqs. 4.8 and 4.9, here along the principal axes, so that a slanted
    streak is one too); the variance of a pixel is added to each. Objects of fewer than seven pixels have no shape.
    """
    flux = table[:, FLUX]
    mean_x, mean_y = table[:, SUM_X] / flux, table[:, SUM_Y] / flux
    var_x = table[:, SUM_XX] / flux - mean_x**2 + _PIXEL_VARIANCE
    var_y = table[:, SUM_YY] / flux - mean_y**2 + _PIXEL_VARIANCE
    covariance = table[:, SUM_XY] / flux - mean_x * mean_y
    middle, half = 0.5 * (var_x + var_y), np.hypot(0.5 * (var_x - var_y), covariance)
    streak = middle + half > max_axis_ratio * np.maximum(middle - half, 1e-12)
    return np.asarray(streak & (table[:, PIXELS] >= _SHAPE_PIXELS))


def _is_halo(table: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Pieces of a brighter star's halo or diffraction rings; `table` has the brightest first.

    Under 0.05 of the star's peak, and within 2½ of its radii or as near as a ring of an Airy pattern can be that
    bright: the envelope of the rings at r first dark radii falls as 0.045 / r³, and the pattern's light divided by its
    peak gives that radius as 1.9 √(flux / (π peak)).
    """
    halo = np.zeros(len(table), np.bool_)
    peak, flux = table[:, PEAK_RESIDUAL], table[:, FLUX]
    # most objects of a frame are too faint for rings
    for star in np.flatnonzero(peak > _HALO_TIMES * peak.min(initial=np.inf)):
        times = peak[star] / peak
        radius = np.sqrt(table[star, PIXELS] / np.pi)
        dark_radius = 1.9 * np.sqrt(flux[star] / (np.pi * peak[star]))
        reach = np.maximum(_HALO_RADII * radius + _HALO_MARGIN_PX, dark_radius * np.cbrt(_RING_MARGIN * 0.045 * times))
        near = np.hypot(table[:, X_PEAK] - table[star, X_PEAK], table[:, Y_PEAK] - table[star, Y_PEAK]) < reach
        halo |= near & (times > _HALO_TIMES)
    return halo


def select_spots(table: NDArray[np.float64], settings: DetectionSettings, saturation_known: bool) -> Spots:
    """Candidates out of a table of objects: those of a star's size and shape, the brightest first.

    Parameters
    ----------
    table : array, shape (N, 14)
        A row an object: pixels, flux, x and y of the brightest pixel, its value, how many pixels have it, how many
        reach the saturation, whether it touches the border, the signal-weighted sums of x, y, x², y², xy, the
        brightest pixel's signal.
    settings : DetectionSettings
        Limits.
    saturation_known : bool
        Where it is not, a flat top at the highest value of all objects is taken for saturation.
    """
    if not len(table):
        return Spots.none()
    highest = table[:, PEAK].max()
    saturated = table[:, SATURATED] > 0
    if not saturation_known:
        flat = (table[:, PEAK] == highest) & (table[:, AT_PEAK] >= _FLAT_TOP_PIXELS)
        saturated = (table[:, PEAK] == highest) & flat.any()
    size_fits = (table[:, PIXELS] >= settings.min_pixels) & (table[:, PIXELS] <= settings.max_pixels)
    good = size_fits & (table[:, FLUX] > 0) & ~is_streak(table, settings.max_axis_ratio)
    index = np.flatnonzero(good)
    # position breaks ties, so that the order never depends on how the objects were found
    order = np.lexsort((table[index, X_PEAK], table[index, Y_PEAK], -table[index, FLUX]))
    # more than are asked for, as some may be halo; far more would cost time on an image full of noise
    index = index[order[: 4 * max(settings.max_stars, 0)]]
    index = index[~_is_halo(table[index])][: max(settings.max_stars, 0)]
    chosen = table[index]
    return Spots(
        chosen[:, X_PEAK].astype(np.int64),
        chosen[:, Y_PEAK].astype(np.int64),
        chosen[:, FLUX].copy(),
        chosen[:, PIXELS].astype(np.int64),
        saturated[index],
        chosen[:, EDGE] > 0,
    )
