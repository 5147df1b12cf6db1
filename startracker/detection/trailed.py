"""Points or trails: decides for all stars of a frame at once whether the camera's rotation has trailed them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from startracker._compiled import kernel
from startracker.core import FloatArray, IntArray
from startracker.detection.background import Background
from startracker.detection.classify import FAINTER
from startracker.detection.forms import agrees, are_long, frame_motion, measure_forms, motion_at
from startracker.detection.shapes import MAJOR, MINOR, SHAPE_SNR, measure_shapes
from startracker.detection.sources import Sources, is_saturated
from startracker.detection.spots import Spots
from startracker.detection.thresholds import (
    ALIGNED_SIGMA,
    FEWEST_ALIGNED,
    FEWEST_LONG,
    FEWEST_POINTS,
    LOOK_LONG_SHARE,
    ON_TRAIL_PX,
    PARTED_SHARE,
    POINT_SHARE,
    TRAIL_AXIS_RATIO,
    TRAIL_PIXELS,
    WIDTH_RATIO,
    WIDTH_SNR,
)
from startracker.detection.values import Image
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
