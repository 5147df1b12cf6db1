"""Which objects are star candidates: size, shape, sharpness, surroundings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from startracker.detection.background import Background
from startracker.detection.classify import REASONS, STAR, classify_sources
from startracker.detection.forms import brightest_first, is_halo, measure_forms
from startracker.detection.matched import quantiles
from startracker.detection.plane import Plane, sample_plane
from startracker.detection.scan import UNFILTERED
from startracker.detection.sources import Sources
from startracker.detection.spots import Spots
from startracker.detection.surroundings import ring_pixels
from startracker.detection.values import Image
from startracker.kernels import kernel
from startracker.settings import DetectionSettings

__all__ = ["FAINTER", "is_saturated", "select_spots"]

FloatArray = NDArray[np.float64]
FloatImage = NDArray[np.float32]
IntArray = NDArray[np.int64]
Flags = NDArray[np.bool_]
Columns = tuple[IntArray, IntArray, FloatArray, IntArray, Flags, Flags, FloatArray, FloatArray]

_FLAT_TOP_PIXELS = 5
"""Pixels that share the highest value of a flat top; a star centred on a corner has four of them."""
_LOOKED_AT, _LOOKED_AT_MORE = 6, 36
"""Objects examined for each star asked for: the brightest; an image full of noise has thousands. More where these are
too few stars, or all as sharp as hot pixels, of which a warm detector has thousands too."""
_QUIET_QUANTILE = 0.25
_QUIET_STEP_PX = 16
FAINTER = "fainter than the brightest"


def select_spots(
    table: Sources,
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
        columns, left_out_kinds, told = _judge(
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
    reasons = ("too small", "too large", "without signal", FAINTER, *REASONS)
    for reason, number in zip(reasons, (*left_out, *left_out_kinds.tolist()), strict=True):
        if number > 0:
            rejected[reason] = rejected.get(reason, 0) + number
    return Spots(*columns, rejected)


@kernel
def _brightest(
    table: Sources, saturation_known: bool, fewest: int, largest: int, most: int
) -> tuple[FloatArray, Flags, tuple[int, int, int, int]]:
    """The brightest objects, which of them are saturated, and how many are too small, large, dark and faint."""
    saturated = is_saturated(table, saturation_known)
    index, small, large, dark = brightest_first(table, fewest, largest)
    fainter = len(index) - most
    index = index[:most]
    return table[index], saturated[index], (small, large, dark, fainter)


@kernel
def _judge(
    table: Sources,
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
    """Columns of `Spots` for the objects that are stars, the number of the others by class, and whether cosmic rays
    could be distinguished from stars."""
    kind, told = classify_sources(
        table, saturated, is_halo(table), long, image, level, noise, half, reject_hits, offsets, ends, quiet, isolation,
        most,
    )  # fmt: skip
    number = np.zeros(len(REASONS) + 1, np.int64)
    for n in range(len(kind)):
        number[kind[n]] += 1
    chosen = np.flatnonzero(kind == STAR)
    stars = table[chosen]
    columns = (
        stars["x_peak"].astype(np.int64),
        stars["y_peak"].astype(np.int64),
        stars["flux"].copy(),
        stars["pixels"].astype(np.int64),
        saturated[chosen],
        stars["edge"].copy(),
        centre[chosen],
        np.zeros((len(chosen), 2)),
    )
    return columns, number[1:], told or not reject_hits


@kernel
def is_saturated(table: Sources, saturation_known: bool) -> Flags:
    """Objects with a saturated pixel; the level not known: those of the highest value, if one has a flat top."""
    if saturation_known or not len(table):
        return table["saturated"] > 0
    highest = table["peak"] == table["peak"].max()
    flat: Flags = highest & np.any(highest & (table["at_peak"] >= _FLAT_TOP_PIXELS))
    return flat
