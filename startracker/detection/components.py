"""Connected components above the threshold."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from startracker.detection.background import Background, as_image
from startracker.detection.blends import part_blends
from startracker.detection.objects import cut_runs, find_runs, join_runs, measure_objects
from startracker.detection.spots import COLUMNS, PEAK_RESIDUAL, PIXELS, X_PEAK, Y_PEAK, Spots, select_spots
from startracker.errors import InputError
from startracker.settings import DetectionSettings

__all__ = ["find_components"]

_RAISE = 2.0
"""Factor between the thresholds at which an oversized object is looked at again."""
_CONTRAST = 2.0
"""A star in an oversized object stands out this many times above the threshold that cuts it free."""
_MOST_LEVELS = 24


def find_components(
    image: NDArray[np.float32],
    background: Background,
    settings: DetectionSettings,
    saturation_dn: float | None = None,
) -> Spots:
    """Star candidates as 8-connected components above background + `threshold_sigma` × noise.

    An object of more than `max_pixels` (the wings of a very bright star, stars before a nebula or beside the Moon) is
    looked at again above thresholds that double, until what is left of it has a star's size; what then stands out of
    it by less than a factor 2 is structure of something extended, and left out. Objects with several peaks and
    distinct valleys between them are parted (`startracker.detection.blends`).

    Parameters
    ----------
    image : array, shape (H, W)
        DN. Values that are not finite belong to no object.
    background : Background
        Of the same shape.
    settings : DetectionSettings
        Threshold and limits.
    saturation_dn : float, optional
        DN at and above which a pixel is saturated; None: a flat top at the highest value.

    Returns
    -------
    Spots
        Brightest first.
    """
    pixels = as_image(image)
    level, noise = background.level, background.noise
    if pixels.shape != level.shape:
        raise InputError(f"the image is {pixels.shape} but its background {level.shape}; make it anew")
    saturation = np.float32(np.inf if saturation_dn is None else saturation_dn)
    threshold = float(settings.threshold_sigma)
    runs = find_runs(pixels, level, noise, np.float32(threshold))
    tables = []
    for depth in range(_MOST_LEVELS):
        number, count = join_runs(runs)
        table = measure_objects(runs, number, count, pixels, level, saturation)
        oversized = table[:, PIXELS] > settings.max_pixels
        table = part_blends(runs, number, table, settings.max_pixels, pixels, level, noise, saturation)
        fits = table[:, PIXELS] <= settings.max_pixels
        if depth > 0:
            at_peak = noise[table[:, Y_PEAK].astype(np.intp), table[:, X_PEAK].astype(np.intp)]
            fits &= table[:, PEAK_RESIDUAL] >= _CONTRAST * threshold * at_peak
        tables.append(table[fits])
        if not oversized.any():
            break
        threshold *= _RAISE
        runs = cut_runs(runs, oversized[number], pixels, level, noise, np.float32(threshold))
    return select_spots(
        np.concatenate(tables) if tables else np.empty((0, COLUMNS)), settings, saturation_dn is not None
    )
