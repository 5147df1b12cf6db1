"""Connected components above the threshold."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from startracker.detection.background import Background
from startracker.detection.blends import part_blends
from startracker.detection.forms import are_long
from startracker.detection.matched import filter_half, search_filtered
from startracker.detection.objects import cut_runs, join_runs, measure_objects
from startracker.detection.scan import UNFILTERED, runs_above, search_rows
from startracker.detection.selection import select_smeared, select_spots
from startracker.detection.shapes import MAJOR, MINOR, SHAPE_SNR, measure_shapes
from startracker.detection.spots import PEAK_RESIDUAL, PIXELS, X_PEAK, Y_PEAK, Spots
from startracker.detection.values import Image, as_pixels
from startracker.errors import InputError
from startracker.settings import DetectionSettings

__all__ = ["find_components", "find_smeared", "weigh"]

_RAISE = 2.0
"""Factor between the thresholds at which an oversized object is looked at again."""
_CONTRAST = 2.0
"""A star in an oversized object stands out this many times above the threshold that cuts it free."""
_MOST_LEVELS = 24
_LOOKED_AT = 30
_FEWEST_LONG, _EARLIER = 3, 0.6
"""Objects so long make one look for smear; at this share of the axis ratio from which single ones are left out, so that
no star is before the smear is seen."""
_WHOLE_PIXELS, _PARTED_SHARE = 12, 0.25
"""Where such a share of objects of so many pixels was parted, they may be streaks of soft images, in pieces because the
noise of their photons makes them uneven."""
_FEWEST_POINTS, _POINT_SHARE = 5, 0.25
"""Round star images, and their share of the number of streaks, from which the frame is not trailed. A trailed frame has
one or two, of hot pixels or cosmic rays that touch; satellites are fewer than stars."""
_WEIGHTS_PX = (1.2, 2.4, 4.8)
"""Gaussian weights under which widths are measured: the first that is wider than the star images."""
_WIDTH_RATIO, _CLEAR_SNR = 2.0, 8.0
"""Factor in variance between images of one width at this signal-to-noise ratio: 4 standard errors of the variance, and
the variation of a lens over its field. A trail of 4 px differs by more from a star of σ = 0.9 px."""
_ON_TRAIL_PX = 4.0
"""Half width of a streak and the error of its line: a point nearer may be a piece of it."""
_LONGEST = 5
"""A streak may have this many times `max_pixels`."""


def find_components(
    image: Image,
    background: Background,
    settings: DetectionSettings,
    saturation_dn: float | None = None,
) -> Spots:
    """Star candidates as 8-connected components above background + `threshold_sigma` × noise.

    With `matched_filter` the components are those of the filtered image (`startracker.detection.matched`) above as
    many times its own noise; fluxes, peaks and sizes stay those of the image.

    An object of more than `max_pixels` (the wings of a very bright star, stars before a nebula or beside the Moon) is
    looked at again above thresholds that double, until what is left of it has a star's size; what then stands out of
    it by less than a factor 2 is structure of something extended, and left out. Objects with several peaks and
    distinct valleys between them are parted (`startracker.detection.blends`).

    Where three of the brightest objects are streaks, or many were parted, the frame may be smeared: it is searched
    again at half the threshold. If streaks fit one motion of the camera (`startracker.detection.smear`), either all
    stars are trailed by it, or the stars are points and the streaks are satellites: see `weigh`.

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
        raise InputError(f"the image is {pixels.shape} but its background {background.shape}; make it anew")
    saturation = np.float32(np.inf if saturation_dn is None else saturation_dn)
    known, threshold = saturation_dn is not None, float(settings.threshold_sigma)
    if not settings.matched_filter:
        noise, limit = background.noise_plane, np.float32(threshold)
        groups, found, _ = search_rows(pixels, background.level_plane, noise, UNFILTERED, limit, pixels.size + 1)
        runs, signal = runs_above(groups, found, pixels, noise, limit)
        table, _ = measure_found(runs, signal, pixels, background, threshold, settings.max_pixels, saturation)
        return select_spots(table, settings, known, pixels, background)
    half = filter_half(settings.psf_sigma_px)
    runs, signal, excess = search_filtered(pixels, background, half, threshold)
    table, parted = measure_found(runs, signal, pixels, background, excess * threshold, settings.max_pixels, saturation)
    whole = np.count_nonzero(table[:, PIXELS] >= _WHOLE_PIXELS) - parted
    trails = None
    if parted >= max(_FEWEST_LONG, _PARTED_SHARE * whole) or _looks_smeared(table, settings):
        trails = find_smeared(pixels, background, settings, saturation_dn)
    if trails is None:
        return select_spots(table, settings, known, pixels, background, half, excess)
    more = replace(settings, max_stars=settings.max_stars + len(trails))  # short streaks may be among them
    points = select_spots(table, more, known, pixels, background, half, excess)
    return weigh(trails, points, pixels, background, settings.max_stars)


def weigh(trails: Spots, points: Spots, image: Image, background: Background, most: int) -> Spots:
    """Candidates of the likelier hypothesis, all stars trailed or all stars points; the other's as `Spots.other`.

    A trailed frame has no round images of stars: what is left beside its streaks are hot pixels and cosmic rays, which
    are sharper, and pieces of streaks, which lie on these. So the number decides of points that have the width of the
    frame's star images along both axes and lie on no streak. The streaks tell that width across themselves. Where
    points are chosen, those that are streaks of the common motion are left out.

    Parameters
    ----------
    trails, points : Spots
        Candidates under either hypothesis.
    image, background
        What they were found in.
    most : int
        Points wanted.
    """
    assert trails.centre is not None
    assert trails.streak is not None
    assert points.centre is not None
    level, noise, width = background.level_plane, background.noise_plane, math.nan
    for weight in _WEIGHTS_PX:
        across = measure_shapes(image, level, noise, trails.x_peak, trails.y_peak, weight)[:, MINOR]
        width = float(np.median(across[np.isfinite(across)])) if np.isfinite(across).any() else math.nan
        if width < weight**2:
            break
    shapes = measure_shapes(image, level, noise, points.x_peak, points.y_peak, weight)
    broad = shapes[:, MAJOR] > width * _WIDTH_RATIO
    star = (shapes[:, MINOR] > width / _WIDTH_RATIO) & ~broad & (shapes[:, SHAPE_SNR] > _CLEAR_SNR)
    length = np.maximum(np.hypot(*trails.streak.T), 1e-12)
    unit = trails.streak / length[:, None]
    apart = points.centre[:, None] - trails.centre[None]
    along = np.abs((apart * unit).sum(axis=2))
    beside = np.abs(apart[..., 0] * unit[:, 1] - apart[..., 1] * unit[:, 0])
    on_trail = ((along < 0.5 * length + _ON_TRAIL_PX) & (beside < _ON_TRAIL_PX)).any(axis=1)
    stars = np.count_nonzero(star & ~on_trail & ~points.edge & ~points.saturated)
    if stars < max(_FEWEST_POINTS, _POINT_SHARE * len(trails)):
        return replace(trails, other=points.take(np.arange(min(most, len(points)))))
    return replace(points.take(np.flatnonzero(~(on_trail & broad))[:most]), other=trails)


def find_smeared(
    image: Image, background: Background, settings: DetectionSettings, saturation_dn: float | None = None
) -> Spots | None:
    """Stars drawn out by one motion of the camera, from a search at half the threshold; None where there is no such.

    Parameters are those of `find_components`.
    """
    pixels, threshold = as_pixels(image), 0.5 * float(settings.threshold_sigma)
    runs, signal, excess = search_filtered(pixels, background, filter_half(settings.psf_sigma_px), threshold)
    saturation, longest = np.float32(np.inf if saturation_dn is None else saturation_dn), _LONGEST * settings.max_pixels
    table, _ = measure_found(runs, signal, pixels, background, excess * threshold, longest, saturation, 1)
    return select_smeared(table, settings, saturation_dn is not None, background, excess)


def _looks_smeared(table: NDArray[np.float64], settings: DetectionSettings) -> bool:
    """Whether there are three long objects among the thirty brightest: then it is worth looking for a motion."""
    ratio = _EARLIER * settings.max_axis_ratio
    return bool(are_long(table, _FEWEST_LONG, settings.min_pixels, _LOOKED_AT, ratio))


def measure_found(
    runs: NDArray[np.int64],
    signal: NDArray[np.float32],
    image: Image,
    background: Background,
    threshold: float,
    max_pixels: int,
    saturation: np.float32,
    levels: int = _MOST_LEVELS,
) -> tuple[NDArray[np.float64], int]:
    """Table of the components of the runs, measured in the image, oversized ones taken apart; how many were parted.

    `signal` is what the runs were found in, above `threshold`; `levels` is the number of thresholds, each twice the one
    before; with one, nothing is parted.
    """
    level, noise = background.level_plane, background.noise_plane
    tables, parted = [], 0
    for depth in range(levels):
        number, count = join_runs(runs)
        table = measure_objects(runs, number, count, image, level, saturation)
        oversized = table[:, PIXELS] > max_pixels
        if levels > 1:
            table, several = part_blends(runs, number, table, max_pixels, image, level, noise, saturation)
            parted += several
        fits = table[:, PIXELS] <= max_pixels
        if depth > 0:
            at_peak = noise[table[:, Y_PEAK].astype(np.intp), table[:, X_PEAK].astype(np.intp)]
            fits &= table[:, PEAK_RESIDUAL] >= _CONTRAST * threshold * at_peak
        tables.append(table[fits])
        if not oversized.any():
            break
        threshold *= _RAISE
        runs, signal = cut_runs(runs, signal, oversized[number], noise, np.float32(threshold))
    return np.concatenate(tables), parted
