"""Connected components above the threshold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from startracker.detection.background import Background
from startracker.detection.blends import part_blends
from startracker.detection.classify import select_spots
from startracker.detection.forms import brightest_first
from startracker.detection.matched import filter_half, search_filtered
from startracker.detection.scan import UNFILTERED, runs_above, search_rows
from startracker.detection.sources import Sources, cut_runs, join_runs, join_tables, measure_objects
from startracker.detection.spots import Spots
from startracker.detection.thresholds import LONGEST_TIMES, OVERSIZED_CONTRAST, OVERSIZED_LEVELS, OVERSIZED_RAISE
from startracker.detection.trailed import decide, line_up, looks_trailed, select_trailed
from startracker.detection.values import Image, as_pixels
from startracker.errors import InputError
from startracker.settings import DetectionSettings


def find_components(
    image: Image,
    background: Background,
    settings: DetectionSettings,
    saturation_dn: float | None = None,
) -> Spots:
    """Star candidates as 8-connected components above background + `threshold_sigma` × noise.

    With `matched_filter` the components are those of the filtered image (`startracker.detection.matched`), above
    `threshold_sigma` times the noise of that image; fluxes, peaks and sizes are measured in the original image.

    An object of more than `max_pixels` (the wings of a very bright star, stars in front of a nebula or beside the Moon)
    is searched again at thresholds that double, until the remaining parts have the size of a star. Parts that then
    exceed the threshold by less than a factor of 2 are structure of an extended object and are dropped. Objects with
    several peaks and distinct valleys between them are split (`startracker.detection.blends`).

    If three of the brightest objects are streaks, or many objects were split, the frame may be smeared: it is searched
    again at half the threshold. If the streaks fit one motion of the camera (`startracker.detection.forms`), either all
    stars are trailed by it, or the stars are points and the streaks are satellites: see
    `startracker.detection.trailed`.

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
    pixels = as_pixels(image)
    if pixels.shape != background.shape:
        raise InputError(f"the image is {pixels.shape} but its background {background.shape}; compute it again")
    saturation = np.inf if saturation_dn is None else float(saturation_dn)
    known, threshold = saturation_dn is not None, float(settings.threshold_sigma)
    if not settings.matched_filter:
        noise, limit = background.noise_plane, threshold
        groups, found, _ = search_rows(pixels, background.level_plane, noise, UNFILTERED, limit, pixels.size + 1)
        runs, signal = runs_above(groups, found, pixels, noise, limit)
        table, _ = measure_found(runs, signal, pixels, background, threshold, settings.max_pixels, saturation)
        return select_spots(brightest_first(table), settings, known, pixels, background)
    half = filter_half(settings.psf_sigma_px)
    runs, signal, excess = search_filtered(pixels, background, half, threshold)
    table, parted = measure_found(runs, signal, pixels, background, excess * threshold, settings.max_pixels, saturation)
    table, trails = brightest_first(table), None
    if looks_trailed(table, parted, settings):
        trails = find_trailed(pixels, background, settings, saturation_dn)
    if trails is None:
        spots = select_spots(table, settings, known, pixels, background, half, excess)
        return replace(spots, direction_rad=line_up(table))
    more = replace(settings, max_stars=settings.max_stars + len(trails))  # short streaks may be among them
    points = select_spots(table, more, known, pixels, background, half, excess)
    return decide(trails, points, pixels, background, settings.max_stars)


def find_trailed(
    image: Image, background: Background, settings: DetectionSettings, saturation_dn: float | None = None
) -> Spots | None:
    """Stars trailed by one motion of the camera, from a search at half the threshold; None without such a motion.

    The parameters are those of `find_components`.
    """
    pixels, threshold = as_pixels(image), 0.5 * float(settings.threshold_sigma)
    runs, signal, excess = search_filtered(pixels, background, filter_half(settings.psf_sigma_px), threshold)
    saturation = np.inf if saturation_dn is None else float(saturation_dn)
    longest = LONGEST_TIMES * settings.max_pixels
    table, _ = measure_found(runs, signal, pixels, background, excess * threshold, longest, saturation, 1)
    return select_trailed(table, settings, saturation_dn is not None, background, excess)


def measure_found(
    runs: NDArray[np.int64],
    signal: NDArray[np.float32],
    image: Image,
    background: Background,
    threshold: float,
    max_pixels: int,
    saturation: float,
    levels: int = OVERSIZED_LEVELS,
) -> tuple[Sources, int]:
    """Measure the components of the runs; returns their table and how many objects were split.

    `signal` is the (filtered) signal in which the runs were found, above `threshold`. Oversized objects are searched
    again at up to `levels` thresholds, each twice the one before; with one level nothing is split.
    """
    level, noise = background.level_plane, background.noise_plane
    tables, parted = [], 0
    for depth in range(levels):
        number, count = join_runs(runs)
        table = measure_objects(runs, number, count, image, level, saturation)
        oversized = table["pixels"] > max_pixels
        if levels > 1:
            table, several = part_blends(runs, number, table, max_pixels, image, level, noise, saturation)
            parted += several
        if depth == 0 and not oversized.any():
            return table, parted
        # Above the first threshold only parts that stand out clearly are kept: the rest is structure of the object
        # itself.
        fits = table["pixels"] <= max_pixels
        if depth > 0:
            at_peak = noise[table["y_peak"].astype(np.intp), table["x_peak"].astype(np.intp)]
            fits &= table["peak_residual"] >= OVERSIZED_CONTRAST * threshold * at_peak
        tables.append(table.take(np.flatnonzero(fits)))
        if not oversized.any():
            break
        threshold *= OVERSIZED_RAISE
        runs, signal = cut_runs(runs, signal, oversized[number], noise, np.float32(threshold))
    return join_tables(*tables), parted
