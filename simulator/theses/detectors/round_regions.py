"""Region growing with the rules of Greyling 1995, section 4.2.1, and no others: size, axis ratio, and eight stars."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from simulator.theses.detectors.region_growing import grow_objects
from startracker.detection.background import Background, as_image
from startracker.detection.sources import Sources, is_saturated
from startracker.detection.spots import Spots
from startracker.detection.values import Image
from startracker.errors import InputError
from startracker.settings import DetectionSettings

FloatImage = NDArray[np.float32]

_KEPT, _SMALL, _LARGE, _NOT_ROUND = range(4)
_REASONS = ("too small", "too large", "axis ratio")


def find_round_regions(
    image: Image,
    background: Background,
    settings: DetectionSettings,
    saturation_dn: float | None = None,
    *,
    stop: bool = False,
) -> Spots:
    """Star candidates by size and roundness alone: 7 to 36 pixels, σx²/σy² from 0.7 to 1.3 (Greyling 1995, 4.2).

    Regions grow as in `grow_regions`, from every third pixel over the four neighbours above the threshold:
    `threshold_dn` of the raw image, or, if that is not set, background + `threshold_sigma` × noise. A region of
    `min_pixels` to `max_pixels` is a star if its second moments along x and y (eqs. 4.8, 4.9, weighted with the signal
    above the background) satisfy |σx²/σy² − 1| < `max_axis_ratio` − 1. The `max_stars` brightest are returned. There is
    no matched filter and no test for isolation, hot pixels or streaks: those settings have no effect.

    Parameters
    ----------
    image : array, shape (H, W)
        DN. Values that are not finite belong to no region.
    background : Background
        Of the same shape.
    settings : DetectionSettings
        Threshold and limits.
    saturation_dn : float, optional
        DN at and above which a pixel is saturated; None: a flat top at the highest value.
    stop : bool
        Stop the search at the `max_stars`-th star in reading order, as `grow.m` does.

    Returns
    -------
    Spots
        Brightest first, with the number of regions left out by reason.

    Raises
    ------
    InputError
        Shapes that differ, a step below one.
    """
    pixels = as_image(image)
    if pixels.shape != background.shape:
        raise InputError(f"the image is {pixels.shape} but its background {background.shape}; compute it again")
    if settings.search_step_px < 1:
        raise InputError(f"detection.search_step_px is {settings.search_step_px}; it must be at least 1")
    level = background.level
    if settings.threshold_dn is None:
        limit = level + np.float32(settings.threshold_sigma) * background.noise
    else:
        limit = np.full(pixels.shape, settings.threshold_dn, np.float32)
    saturation = np.float32(np.inf if saturation_dn is None else saturation_dn)
    table, _ = grow_objects(pixels, level, limit, settings.search_step_px, saturation)
    outcome = _outcomes(table, settings)
    if stop:
        last = np.flatnonzero(outcome == _KEPT)[max(settings.max_stars, 1) - 1 :][:1]
        table, outcome = (rows[: last[0] + 1] if len(last) else rows for rows in (table, outcome))
    kept = table[outcome == _KEPT]
    left_out = np.bincount(outcome, minlength=4)[1:]
    rejected = {reason: int(number) for reason, number in zip(_REASONS, left_out, strict=True) if number}
    if not len(kept):
        return Spots.none(rejected)
    order = np.lexsort((kept["x_peak"], kept["y_peak"], -kept["flux"]))
    saturated = is_saturated(kept, saturation_dn is not None)[order[: settings.max_stars]]
    stars = kept[order[: settings.max_stars]]
    if len(kept) > len(stars):
        rejected["fainter than the brightest"] = len(kept) - len(stars)
    return Spots(
        stars["x_peak"].astype(np.int64),
        stars["y_peak"].astype(np.int64),
        stars["flux"].copy(),
        stars["pixels"].astype(np.int64),
        saturated,
        stars["edge"].copy(),
        np.column_stack([stars["sum_x"], stars["sum_y"]]) / stars["flux"][:, None],
        np.zeros((len(stars), 2)),
        rejected,
    )


find_first_regions = partial(find_round_regions, stop=True)
"""`find_round_regions` that stops at the `max_stars`-th star in reading order ("stop at 8")."""


def _outcomes(table: Sources, settings: DetectionSettings) -> NDArray[np.int64]:
    """Outcome (N,) for each region: tested by its size, then by its axis ratio (eqs. 4.8 and 4.9)."""
    # A region without light has moments of NaN, fails the comparison, and so counts as not round.
    flux = np.where(table["flux"] > 0.0, table["flux"], np.nan)
    xx = table["sum_xx"] / flux - (table["sum_x"] / flux) ** 2
    yy = table["sum_yy"] / flux - (table["sum_y"] / flux) ** 2
    is_round = np.abs(xx - yy) < (settings.max_axis_ratio - 1.0) * yy
    sizes = [table["pixels"] < settings.min_pixels, table["pixels"] > settings.max_pixels, ~is_round]
    return np.asarray(np.select(sizes, [_SMALL, _LARGE, _NOT_ROUND], _KEPT))
