"""Which objects are star candidates: size, shape, sharpness, surroundings."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from startracker.detection.background import Background
from startracker.detection.forms import brightest_first, is_halo, measure_forms
from startracker.detection.matched import quantiles
from startracker.detection.plane import Plane, sample_plane
from startracker.detection.scan import UNFILTERED
from startracker.detection.smear import agrees, frame_motion, motion_at
from startracker.detection.spots import (
    AT_PEAK,
    EDGE,
    FLUX,
    PEAK,
    PIXELS,
    SATURATED,
    X_PEAK,
    Y_PEAK,
    Spots,
)
from startracker.detection.surroundings import ring_pixels
from startracker.detection.values import Image
from startracker.detection.verdicts import REASONS, STAR, judge_objects
from startracker.settings import DetectionSettings

__all__ = ["select_smeared", "select_spots"]

FloatArray = NDArray[np.float64]
FloatImage = NDArray[np.float32]
IntArray = NDArray[np.int64]
Flags = NDArray[np.bool_]
Columns = tuple[IntArray, IntArray, FloatArray, IntArray, Flags, Flags, FloatArray, FloatArray]

_FLAT_TOP_PIXELS = 5
"""Pixels that share the highest value of a flat top; a star centred on a corner has four of them."""
_STREAK_PIXELS, _STREAK_RATIO = 12, 1.5
_LOOKED_AT, _LOOKED_AT_MORE = 6, 36
"""Objects examined for each star asked for: the brightest; an image full of noise has thousands. More where these are
too few stars, or all as sharp as hot pixels, of which a warm detector has thousands too."""
_QUIET_QUANTILE = 0.25
_QUIET_STEP_PX = 16
_FAINTER = "fainter than the brightest"


def select_spots(
    table: FloatArray,
    settings: DetectionSettings,
    saturation_known: bool,
    image: Image,
    background: Background,
    half: FloatImage | None = None,
    excess: float = 1.0,
) -> Spots:
    """Candidates out of a table of objects: those that a star can be, the brightest first.

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
    image, background
        What the objects were found in.
    half, excess : array and float, optional
        The matched filter (`startracker.detection.scan`), where one was used, and how far the noise after it exceeds
        the background's.

    Returns
    -------
    Spots
        With the number of objects left out by reason. Only the brightest objects, six for each star asked for, are
        examined, 36 where these are too few stars or all as sharp as hot pixels, but for streaks only as many as it
        takes; the rest count as "fainter than the brightest".
    """
    rejected: dict[str, int] = {}
    if not len(table):
        return Spots.none()
    fewest, most = settings.min_pixels if half is None else 1, max(settings.max_stars, 0)
    quiet = 0.0
    if settings.isolation > 0.0:
        # where there are branches, the noise of the tiles is theirs
        noise = sample_plane(background.noise_plane, _QUIET_STEP_PX, _QUIET_STEP_PX)
        quiet = excess * settings.threshold_sigma * quantiles(noise, (_QUIET_QUANTILE,))[0]
    columns: Columns
    for looked_at in (_LOOKED_AT * most, _LOOKED_AT_MORE * most):
        objects, saturated, left_out = _brightest(table, saturation_known, fewest, settings.max_pixels, looked_at)
        forms = measure_forms(objects, settings.max_axis_ratio)
        columns, verdicts, told = _judge(
            objects,
            saturated,
            forms.long,
            forms.centre,
            image,
            background.level_plane,
            background.noise_plane,
            UNFILTERED if half is None else half,
            settings.reject_hits,
            *ring_pixels(),
            quiet,
            settings.isolation,
            most,
        )
        if len(objects) < looked_at or (told and len(columns[0]) == most):
            break
    reasons = ("too small", "too large", "without signal", _FAINTER, *REASONS)
    for reason, number in zip(reasons, (*left_out, *verdicts.tolist()), strict=True):
        if number > 0:
            rejected[reason] = rejected.get(reason, 0) + number
    return Spots(*columns, rejected)


@njit(cache=True, error_model="numpy")
def _brightest(
    table: FloatArray, saturation_known: bool, fewest: int, largest: int, most: int
) -> tuple[FloatArray, Flags, tuple[int, int, int, int]]:
    """The brightest objects, which of them are saturated, and how many are too small, large, dark and faint."""
    saturated = is_saturated(table, saturation_known)
    index, small, large, dark = brightest_first(table, fewest, largest)
    fainter = len(index) - most
    index = index[:most]
    return table[index], saturated[index], (small, large, dark, fainter)


@njit(cache=True, error_model="numpy")
def _judge(
    table: FloatArray,
    saturated: Flags,
    long: Flags,
    centre: FloatArray,
    image: Image,
    level: Plane,
    noise: Plane,
    half: FloatImage,
    reject_hits: bool,
    offsets: IntArray,
    ends: IntArray,
    quiet: float,
    isolation: float,
    most: int,
) -> tuple[Columns, IntArray, bool]:
    """Columns of `Spots` for the objects that are stars, the number of the others by verdict, and whether hits could be
    told from stars."""
    verdict, told = judge_objects(
        table, saturated, is_halo(table), long, image, level, noise, half, reject_hits, offsets, ends, quiet, isolation,
        most,
    )  # fmt: skip
    number = np.zeros(len(REASONS) + 1, np.int64)
    for n in range(len(verdict)):
        number[verdict[n]] += 1
    chosen = np.flatnonzero(verdict == STAR)
    stars = table[chosen]
    columns = (
        stars[:, X_PEAK].astype(np.int64),
        stars[:, Y_PEAK].astype(np.int64),
        stars[:, FLUX].copy(),
        stars[:, PIXELS].astype(np.int64),
        saturated[chosen],
        stars[:, EDGE] > 0.0,
        centre[chosen],
        np.zeros((len(chosen), 2)),
    )
    return columns, number[1:], told or not reject_hits


@njit(cache=True, error_model="numpy")
def is_saturated(table: FloatArray, saturation_known: bool) -> Flags:
    """Objects with a saturated pixel; the level not known: those of the highest value, if one has a flat top."""
    if saturation_known or not len(table):
        return table[:, SATURATED] > 0.0
    highest = table[:, PEAK] == table[:, PEAK].max()
    flat: Flags = highest & np.any(highest & (table[:, AT_PEAK] >= _FLAT_TOP_PIXELS))
    return flat


def select_smeared(
    table: FloatArray,
    settings: DetectionSettings,
    saturation_known: bool,
    background: Background,
    excess: float,
) -> Spots | None:
    """Stars of a smeared frame: objects that are long and fit the one motion; None where there is no such motion.

    Parameters
    ----------
    table, settings, saturation_known, background, excess
        As for `select_spots`; the objects found at half the threshold, which faint streaks fall apart above. In
        exchange an object needs 12 pixels and, as a whole, twice the threshold. To be a streak it need only be longer
        than broad: the limit on the axis ratio, somewhere in which streaks of one length scatter, is for single ones.
    """
    at_peak = table[:, Y_PEAK].astype(np.intp), table[:, X_PEAK].astype(np.intp)
    noise = excess * background.noise_plane[*at_peak]
    strong = table[:, FLUX] > 2.0 * settings.threshold_sigma * noise * np.sqrt(table[:, PIXELS])
    table = table[strong & (table[:, PIXELS] >= _STREAK_PIXELS)]
    forms = measure_forms(table, _STREAK_RATIO)
    whole = np.flatnonzero(forms.long & (table[:, EDGE] == 0))
    order = whole[np.lexsort((table[whole, X_PEAK], table[whole, Y_PEAK], -table[whole, FLUX]))]
    middle = 0.5 * (np.array(background.shape[::-1]) - 1.0)
    motion = frame_motion(forms.centre[order] - middle, forms.lines[order])
    if motion is None:
        return None
    expected = motion_at(forms.centre[order] - middle, motion)
    fits = agrees(forms.lines[order], expected)
    chosen, drawn = order[fits][: max(settings.max_stars, 0)], expected[fits][: max(settings.max_stars, 0)]
    rejected = {
        "streak": int(np.count_nonzero(forms.long)) - int(np.count_nonzero(fits)),
        "not smeared as the frame": int(np.count_nonzero(~forms.long)),
        _FAINTER: int(np.count_nonzero(fits)) - len(chosen),
    }
    nearest = np.rint(forms.centre[chosen]).astype(np.int64)
    return Spots(
        nearest[:, 0],
        nearest[:, 1],
        table[chosen, FLUX].copy(),
        table[chosen, PIXELS].astype(np.int64),
        is_saturated(table, saturation_known)[chosen],
        np.zeros(len(chosen), np.bool_),
        forms.centre[chosen],
        drawn,
        {reason: count for reason, count in rejected.items() if count},
    )
