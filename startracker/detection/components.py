"""The detector `components`: connected pixels above the threshold, and the decision between points and trails.

The decision is made for all stars of a frame at once: either the camera's rotation has trailed them, or it has not.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from startracker._compiled import kernel
from startracker.core import FloatArray, IntArray
from startracker.detection.background import Background
from startracker.detection.blends import part_blends
from startracker.detection.classify import FAINTER, select_spots
from startracker.detection.forms import agrees, are_long, brightest_first, frame_motion, measure_forms, motion_at
from startracker.detection.matched import filter_half, search_filtered
from startracker.detection.scan import UNFILTERED, runs_above, search_rows
from startracker.detection.shapes import MAJOR, MINOR, SHAPE_SNR, measure_shapes
from startracker.detection.sources import Sources, cut_runs, is_saturated, join_runs, join_tables, measure_objects
from startracker.detection.spots import Spots
from startracker.detection.thresholds import (
    ALIGNED_SIGMA,
    FEWEST_ALIGNED,
    FEWEST_LONG,
    FEWEST_POINTS,
    LONGEST_TIMES,
    LOOK_LONG_SHARE,
    ON_TRAIL_PX,
    OVERSIZED_CONTRAST,
    OVERSIZED_LEVELS,
    OVERSIZED_RAISE,
    PARTED_SHARE,
    POINT_SHARE,
    TRAIL_AXIS_RATIO,
    TRAIL_PIXELS,
    WIDTH_RATIO,
    WIDTH_SNR,
)
from startracker.detection.values import Image, as_pixels
from startracker.errors import InputError
from startracker.settings import DetectionSettings
from startracker.sorting import median

Flags = NDArray[np.bool_]

_LOOKED_AT = 30
_WHOLE_PIXELS = 12
_BRIGHTEST, _NEIGHBOUR_PX, _DIRECTIONS = 150, 40.0, 18
"""Number of objects, largest distance, and number of direction bins (10° each) for pairs that may be fragments of one
trail."""
_WEIGHTS_PX = (1.2, 2.4, 4.8)
"""Widths of the Gaussian weight under which widths are measured; the first one wider than the star images is used."""


def find_components(
    image: Image,
    background: Background,
    settings: DetectionSettings,
    saturation_dn: float | None = None,
) -> Spots:
    """Star candidates as 8-connected components above background + `threshold_sigma` × noise.

    With `matched_filter` components are found in the filtered image (`startracker.detection.matched`), above
    `threshold_sigma` times the noise of that image; fluxes, peaks and sizes are measured in the original image.

    An object of more than `max_pixels` (the wings of a very bright star, stars in front of a nebula or beside the Moon)
    is searched again at thresholds that double, until the remaining parts have the size of a star. Parts that then
    exceed the threshold by less than a factor of 2 are structure of an extended object and are dropped. Objects with
    several peaks and distinct valleys between them are split (`startracker.detection.blends`).

    If three of the brightest objects are streaks, or many objects were split, the frame may be smeared: it is searched
    again at half the threshold. If the streaks fit one motion of the camera (`startracker.detection.forms`), either all
    stars are trailed by it, or the stars are points and the streaks are satellites: see
    `startracker.detection.components`.

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

    Parameters as for `find_components`.
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


def looks_trailed(table: Sources, parted: int, settings: DetectionSettings) -> bool:
    """Whether to search for a motion: many objects were split, or three of the brightest thirty are long."""
    whole = np.count_nonzero(table["pixels"] >= _WHOLE_PIXELS) - parted
    if parted >= max(FEWEST_LONG, PARTED_SHARE * whole):
        return True
    ratio = LOOK_LONG_SHARE * settings.max_axis_ratio
    return bool(are_long(table, FEWEST_LONG, settings.min_pixels, _LOOKED_AT, ratio))


def line_up(table: Sources) -> float | None:
    """Direction, rad, along which far more neighbouring objects are aligned than by chance, or None.

    Such objects may be fragments of long trails. Pairs within 40 px among the 150 brightest objects are counted by
    direction; pairs of stars are equally frequent in all directions. `table` is sorted by decreasing flux.
    """
    flux = table["flux"]
    count = len(flux) if len(flux) <= _BRIGHTEST else np.count_nonzero(flux >= flux[_BRIGHTEST - 1])
    xy = np.empty((count, 2))
    xy[:, 0], xy[:, 1] = table["x_peak"][:count], table["y_peak"][:count]
    counts = np.zeros(_DIRECTIONS, np.int64)
    _count_directions(xy, counts)
    pairs = counts.tolist()
    # Three adjacent bins are added, because a direction near the border of a bin fills two; directions are periodic in
    # 180°.
    beside = list(zip(pairs[-1:] + pairs[:-1], pairs, pairs[1:] + pairs[:1], strict=True))
    three = [sum(counted) for counted in beside]
    most, mean = three.index(max(three)), 3.0 * sum(pairs) / _DIRECTIONS
    if three[most] < max(FEWEST_ALIGNED, mean + ALIGNED_SIGMA * math.sqrt(mean)):
        return None
    # Centre of the excess over the mean in the three bins, in units of a bin.
    before, middle, after = (max(count - mean / 3.0, 0.0) for count in beside[most])
    return (most + 0.5 + (after - before) / (before + middle + after)) * math.pi / _DIRECTIONS


@kernel
def _count_directions(xy: FloatArray, pairs: IntArray) -> None:
    """Count the pairs of neighbouring objects by direction."""
    for first in range(len(xy)):
        for second in range(first):
            dx, dy = xy[second, 0] - xy[first, 0], xy[second, 1] - xy[first, 1]
            if 0.0 < dx * dx + dy * dy < _NEIGHBOUR_PX * _NEIGHBOUR_PX:
                pairs[int((math.atan2(dy, dx) / math.pi) % 1.0 * _DIRECTIONS) % _DIRECTIONS] += 1


def select_trailed(
    table: Sources,
    settings: DetectionSettings,
    saturation_known: bool,
    background: Background,
    excess: float,
) -> Spots | None:
    """Stars of a trailed frame: the long objects that fit its one motion, or None if there is no such motion.

    Parameters
    ----------
    table, settings, saturation_known, background, excess
        As for `startracker.detection.classify.select_spots`, for objects found at half the threshold, because faint
        trails fall apart above the full one. In exchange an object needs 12 pixels and, as a whole, twice the
        threshold. To count as a trail it need only be longer than wide: the limit on the axis ratio is meant for single
        objects, and trails of one length scatter about it.
    """
    at_peak = table["y_peak"].astype(np.intp), table["x_peak"].astype(np.intp)
    noise = excess * background.noise_plane[*at_peak]
    strong = table["flux"] > 2.0 * settings.threshold_sigma * noise * np.sqrt(table["pixels"])
    table = table.take(np.flatnonzero(strong & (table["pixels"] >= TRAIL_PIXELS)))
    forms = measure_forms(table, TRAIL_AXIS_RATIO)
    whole = np.flatnonzero(forms.long & ~table["edge"])
    order = whole[np.lexsort((table["x_peak"][whole], table["y_peak"][whole], -table["flux"][whole]))]
    middle = 0.5 * (np.array(background.shape[::-1]) - 1.0)
    motion = frame_motion(forms.centre[order] - middle, forms.lines[order])
    if motion is None:
        return None
    expected = motion_at(forms.centre[order] - middle, motion)
    fits = agrees(forms.lines[order], expected)
    chosen, lengths = order[fits][: max(settings.max_stars, 0)], expected[fits][: max(settings.max_stars, 0)]
    rejected = {
        "streak": int(np.count_nonzero(forms.long)) - int(np.count_nonzero(fits)),
        "not smeared as the frame": int(np.count_nonzero(~forms.long)),
        FAINTER: int(np.count_nonzero(fits)) - len(chosen),
    }
    nearest = np.rint(forms.centre[chosen]).astype(np.int64)
    return Spots(
        nearest[:, 0],
        nearest[:, 1],
        table["flux"][chosen].copy(),
        table["pixels"][chosen].astype(np.int64),
        is_saturated(table, saturation_known)[chosen],
        np.zeros(len(chosen), np.bool_),
        forms.centre[chosen],
        lengths,
        {reason: count for reason, count in rejected.items() if count},
    )


def decide(trails: Spots, points: Spots, image: Image, background: Background, most: int) -> Spots:
    """Choose between two hypotheses, all stars trailed or all stars points; the other is returned as `Spots.other`.

    If points are chosen, those that are trails of the common motion, such as satellites, are left out.

    Parameters
    ----------
    trails, points : Spots
        Candidates under each hypothesis.
    image, background
        Where they were found.
    most : int
        Number of points wanted.
    """
    assert trails.centre is not None
    assert trails.streak is not None
    star, on_trail, major = _round_stars(trails.centre, trails.streak, points, image, background)
    if _are_too_few(star, len(trails)):
        return replace(trails, other=points.take(np.arange(min(most, len(points)))))
    # A satellite is longer than the stars, which aberrations may elongate too, so a trail is compared with their
    # median.
    trailed = on_trail & (major > WIDTH_RATIO * median(major[star]))
    return replace(points.take(np.flatnonzero(~trailed)[:most]), other=trails)


def trails_win(centre: FloatArray, length: FloatArray, points: Spots, image: Image, background: Background) -> bool:
    """Whether all stars of a frame are trailed rather than points, see `decide`.

    A trailed frame has no round star images: apart from its trails it shows hot pixels and cosmic rays, which are
    sharper, and fragments of trails, which lie on trails. So the decision depends on the number of points that have the
    width of the frame's star images along both axes and lie on no trail. That width is measured across the trails.

    Parameters
    ----------
    centre, length : array, shape (N, 2)
        Centres and lengths of the trails, px.
    """
    return _are_too_few(_round_stars(centre, length, points, image, background)[0], len(centre))


def _are_too_few(star: Flags, trails: int) -> bool:
    return bool(np.count_nonzero(star) < max(FEWEST_POINTS, POINT_SHARE * trails))


def _round_stars(
    centre: FloatArray, lengths: FloatArray, points: Spots, image: Image, background: Background
) -> tuple[Flags, Flags, FloatArray]:
    """Which points (N,) are round star images off the trails, which lie on a trail, and their major variance (N,),
    px²."""
    assert points.centre is not None
    level, noise, width = background.level_plane, background.noise_plane, math.nan
    x, y = np.rint(centre).astype(np.int64).T
    for weight in _WEIGHTS_PX:
        across = measure_shapes(image, level, noise, np.ascontiguousarray(x), np.ascontiguousarray(y), weight)[:, MINOR]
        across = across[np.isfinite(across)]
        width = median(across) if len(across) else math.nan
        if width < weight**2:
            break
    shapes = measure_shapes(image, level, noise, points.x_peak, points.y_peak, weight)
    compact = shapes[:, MAJOR] <= width * WIDTH_RATIO
    star = (shapes[:, MINOR] > width / WIDTH_RATIO) & compact & (shapes[:, SHAPE_SNR] > WIDTH_SNR)
    length = np.maximum(np.hypot(*lengths.T), 1e-12)
    unit = lengths / length[:, None]
    apart = points.centre[:, None] - centre[None]
    along = np.abs((apart * unit).sum(axis=2))
    beside = np.abs(apart[..., 0] * unit[:, 1] - apart[..., 1] * unit[:, 0])
    on_trail = ((along < 0.5 * length + ON_TRAIL_PX) & (beside < ON_TRAIL_PX)).any(axis=1)
    star &= ~on_trail & ~points.edge & ~points.saturated
    return star, on_trail, shapes[:, MAJOR]
