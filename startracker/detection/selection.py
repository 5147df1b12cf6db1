"""Which objects are star candidates: size, shape, sharpness, surroundings."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from startracker.detection.background import Background
from startracker.detection.forms import is_halo, measure_forms
from startracker.detection.matched import quantiles
from startracker.detection.plane import sample_plane
from startracker.detection.scan import UNFILTERED, filtered_at
from startracker.detection.shapes import find_clutter, measure_shapes, ring_pixels
from startracker.detection.smear import agrees, common_motion, motion_at
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
from startracker.settings import DetectionSettings

__all__ = ["common_width", "is_clutter", "is_hit", "select_smeared", "select_spots"]

FloatArray = NDArray[np.float64]
FloatImage = NDArray[np.float32]
Flags = NDArray[np.bool_]

_FLAT_TOP_PIXELS = 5
"""Pixels that share the highest value of a flat top; a star centred on a corner has four of them."""
_STREAK_PIXELS = 12
_PIXEL_VARIANCE = 1.0 / 12.0
_LOOKED_AT = 6
"""Objects examined for each star asked for: the brightest; an image full of noise has thousands."""
_WEIGHT_PX = 1.2
_WIDTH_STARS = 40
_WIDTH_SNR = 8.0
_WIDTH_RATIO = 1.3
_SHARP_SHARE = 0.45
_SHARPEST_STAR_PX2 = 0.3
"""Star images of less variance, pixel included (σ < 0.47 px), are as sharp as a particle's track, which has 0.03 to
0.25: then sharpness tells nothing."""
_TRACK_PX2 = 0.4
_SHARP_ERRORS = 2.0
_PEAK_ERRORS = 3.0
_ONE_PIXEL = 0.6
_QUIET_QUANTILE = 0.25
_QUIET_STEP_PX = 16


def select_spots(
    table: FloatArray,
    settings: DetectionSettings,
    saturation_known: bool,
    image: FloatImage,
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
        examined, for clutter only as many as it takes; the rest count as "fainter than the brightest".
    """
    rejected: dict[str, int] = {}
    if not len(table):
        return Spots.none()
    saturated = is_saturated(table, saturation_known)
    fewest = settings.min_pixels if half is None else 1
    small, large = table[:, PIXELS] < fewest, table[:, PIXELS] > settings.max_pixels
    dark = ~small & ~large & ~(table[:, FLUX] > 0)
    _count(rejected, "too small", small)
    _count(rejected, "too large", large)
    _count(rejected, "without signal", dark)
    index = np.flatnonzero(~(small | large | dark))
    # position breaks ties, so that the order never depends on how the objects were found
    order = np.lexsort((table[index, X_PEAK], table[index, Y_PEAK], -table[index, FLUX]))
    most = max(settings.max_stars, 0)
    if len(index) > _LOOKED_AT * most:
        rejected["fainter than the brightest"] = len(index) - _LOOKED_AT * most
    index = index[order[: _LOOKED_AT * most]]
    table, saturated = table[index], saturated[index]

    keep = ~_counted(rejected, "halo of a brighter star", is_halo(table))
    x, y = table[:, X_PEAK].astype(np.int64), table[:, Y_PEAK].astype(np.int64)
    if settings.reject_hits and keep.any():
        hit, one_pixel = is_hit(table, saturated, image, background, half)
        _count(rejected, "hot pixel", keep & hit & one_pixel)
        _count(rejected, "cosmic-ray hit", keep & hit & ~one_pixel)
        keep &= ~hit
    forms = measure_forms(table, settings.max_axis_ratio)
    keep &= ~_counted(rejected, "streak", keep & forms.long)
    chosen = np.flatnonzero(keep)
    if settings.isolation > 0.0 and len(chosen):
        threshold = excess * settings.threshold_sigma
        filtering = UNFILTERED if half is None else half
        cluttered = is_clutter(
            table[chosen], saturated[chosen], image, background, filtering, threshold, settings.isolation, most
        )
        chosen = chosen[~_counted(rejected, "clutter", cluttered)]
    if len(chosen) > most:
        rejected["fainter than the brightest"] = rejected.get("fainter than the brightest", 0) + len(chosen) - most
    chosen = chosen[:most]
    return Spots(
        x[chosen],
        y[chosen],
        table[chosen, FLUX].copy(),
        table[chosen, PIXELS].astype(np.int64),
        saturated[chosen],
        table[chosen, EDGE] > 0,
        forms.centre[chosen],
        np.zeros((len(chosen), 2)),
        rejected,
    )


def is_saturated(table: FloatArray, saturation_known: bool) -> Flags:
    """Objects with a saturated pixel; the level not known: those of the highest value, if one has a flat top."""
    if saturation_known or not len(table):
        return np.asarray(table[:, SATURATED] > 0)
    highest = table[:, PEAK] == table[:, PEAK].max()
    return np.asarray(highest & (highest & (table[:, AT_PEAK] >= _FLAT_TOP_PIXELS)).any())


def _count(rejected: dict[str, int], reason: str, flags: Flags) -> None:
    number = int(np.count_nonzero(flags))
    if number:
        rejected[reason] = rejected.get(reason, 0) + number


def _counted(rejected: dict[str, int], reason: str, flags: Flags) -> Flags:
    _count(rejected, reason, flags)
    return flags


def select_smeared(
    table: FloatArray, settings: DetectionSettings, saturation_known: bool, background: Background, excess: float
) -> Spots | None:
    """Stars of a smeared frame: objects that are long and fit the one motion; None where there is no such motion.

    Parameters
    ----------
    table, settings, saturation_known, background, excess
        As for `select_spots`; the objects found at half the threshold, which faint streaks fall apart above. In
        exchange an object needs 12 pixels and, as a whole, twice the threshold.
    """
    at_peak = table[:, Y_PEAK].astype(np.intp), table[:, X_PEAK].astype(np.intp)
    noise = excess * background.noise_plane[*at_peak]
    strong = table[:, FLUX] > 2.0 * settings.threshold_sigma * noise * np.sqrt(table[:, PIXELS])
    table = table[strong & (table[:, PIXELS] >= _STREAK_PIXELS)]
    forms = measure_forms(table, settings.max_axis_ratio)
    whole = np.flatnonzero(forms.long & (table[:, EDGE] == 0))
    order = whole[np.lexsort((table[whole, X_PEAK], table[whole, Y_PEAK], -table[whole, FLUX]))]
    middle = 0.5 * (np.array(background.shape[::-1]) - 1.0)
    motion = common_motion(forms.centre[order] - middle, forms.lines[order])
    if motion is None:
        return None
    expected = motion_at(forms.centre[order] - middle, motion)
    fits = agrees(forms.lines[order], expected)
    chosen, drawn = order[fits][: max(settings.max_stars, 0)], expected[fits][: max(settings.max_stars, 0)]
    rejected = {
        "streak": int(np.count_nonzero(forms.long)) - int(np.count_nonzero(fits)),
        "not smeared as the frame": int(np.count_nonzero(~forms.long)),
        "fainter than the brightest": int(np.count_nonzero(fits)) - len(chosen),
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


def common_width(variance: FloatArray) -> float:
    """The variance that most values share, to a factor 1.3 either way; NaN for none.

    Hits scatter over all widths, stars agree: so the stars are found among more hits than stars, where a median is
    not. Of equal numbers the wider counts.
    """
    values = np.sort(variance[np.isfinite(variance) & (variance > 0.0)])
    if not len(values):
        return float("nan")
    near = np.searchsorted(values, values * _WIDTH_RATIO, "right") - np.searchsorted(values, values / _WIDTH_RATIO)
    centre = values[len(values) - 1 - int(np.argmax(near[::-1]))]
    return float(np.median(values[(values >= centre / _WIDTH_RATIO) & (values <= centre * _WIDTH_RATIO)]))


def is_hit(
    table: FloatArray,
    saturated: Flags,
    image: FloatImage,
    background: Background,
    half: FloatImage | None = None,
) -> tuple[Flags, Flags]:
    """Objects sharper than the star images of their frame, and which of them are single pixels.

    The optics spread all light alike; charge that arises in the detector stays in its pixels. Judged is the variance
    along the minor axis: a track is long at most in one direction, and smear widens no star in that one. The sharpest
    star allowed has 0.45 of the variance that the frame's stars share, and at most 0.4 px² (the PSF of a poor lens
    varies more than twice over its field, but a track is never wider). Out goes what is below that by twice its
    standard error; and, where the matched filter was used, what has a brightest pixel that exceeds by three times
    its noise the one which such a star has with the object's filtered signal: this tells a hot pixel of 9σ, whose
    moments do not. Saturated objects, those cut off by the border, and frames whose stars are as sharp as tracks, are
    not judged.
    """
    x, y = table[:, X_PEAK].astype(np.int64), table[:, Y_PEAK].astype(np.int64)
    brightest = np.flatnonzero(~saturated & (table[:, EDGE] == 0) & (table[:, PIXELS] >= 3))[: 2 * _WIDTH_STARS]
    weight = _WEIGHT_PX
    shapes = measure_shapes(image, background.level_plane, background.noise_plane, x, y, weight)
    for _ in range(2):
        clean = shapes[brightest]
        width = common_width(clean[clean[:, 4] > _WIDTH_SNR][:_WIDTH_STARS, 0])
        if not width > weight**2:
            break
        weight = 1.2 * math.sqrt(width)
        shapes = measure_shapes(image, background.level_plane, background.noise_plane, x, y, weight)
    if not width > _SHARPEST_STAR_PX2:
        return np.zeros(len(table), np.bool_), np.zeros(len(table), np.bool_)
    limit = min(_SHARP_SHARE * width, _TRACK_PX2)
    with np.errstate(invalid="ignore"):
        sharp = shapes[:, 0] + _SHARP_ERRORS * shapes[:, 2] < limit
    if half is not None:
        level, noise = background.level_plane[y, x], background.noise_plane[y, x]
        share = peak_share(math.sqrt(max(limit - _PIXEL_VARIANCE, 0.01)), half)
        filtered = filtered_at(image, background.level_plane, half, x, y)
        sharp |= image[y, x] - level > share * filtered + _PEAK_ERRORS * noise
    return sharp & ~saturated & (table[:, EDGE] == 0), shapes[:, 3] > _ONE_PIXEL


def peak_share(star_sigma_px: float, half: FloatImage) -> float:
    """Brightest pixel of a star on a pixel's centre, as a share of its signal after the filter `half`."""
    edges = [math.erf((k + 0.5) / (math.sqrt(2.0) * star_sigma_px)) for k in range(len(half))]
    along = edges[0] * float(half[0])
    for k in range(1, len(half)):
        along += (edges[k] - edges[k - 1]) * float(half[k])
    return (edges[0] / along) ** 2


def is_clutter(
    table: FloatArray,
    saturated: Flags,
    image: FloatImage,
    background: Background,
    half: FloatImage,
    threshold: float,
    isolation: float,
    most: int,
) -> Flags:
    """Objects that do not stand out of their own surroundings; the search ends with the `most`-th that does.

    A star is alone, or has a neighbour to one side; a leaf, a twig, a rag of cloud has its like all around. So the
    ring around an object is cut into eight sectors; where in four of them something exceeds the noise in the quiet
    parts of the frame by `threshold` (the quartile of the background's noise: where there are branches, the
    noise of the tiles is theirs), the object must be `isolation` times as high as the fourth highest sector.
    """
    quiet = (
        threshold
        * quantiles(sample_plane(background.noise_plane, _QUIET_STEP_PX, _QUIET_STEP_PX), (_QUIET_QUANTILE,))[0]
    )
    x, y = table[:, X_PEAK].astype(np.int64), table[:, Y_PEAK].astype(np.int64)
    radius = np.sqrt(table[:, PIXELS] / np.pi)
    return np.asarray(
        find_clutter(
            image, background.level_plane, half, x, y, radius, ~saturated, *ring_pixels(), quiet, isolation, most
        )
    )
