"""Which objects are star candidates: size, shape, sharpness, surroundings."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from startracker.detection.background import Background
from startracker.detection.matched import DEFAULT_SIGMA_PX, matched_kernel
from startracker.detection.shapes import measure_shapes, measure_surroundings
from startracker.detection.smear import agrees, common_motion, elongations, motion_at
from startracker.detection.spots import (
    AT_PEAK,
    EDGE,
    FLUX,
    PEAK,
    PEAK_RESIDUAL,
    PIXELS,
    SATURATED,
    SUM_X,
    SUM_XX,
    SUM_XY,
    SUM_Y,
    SUM_YY,
    X_PEAK,
    Y_PEAK,
    Spots,
)
from startracker.settings import DetectionSettings

__all__ = ["common_width", "is_clutter", "is_halo", "is_hit", "measure_forms", "select_smeared", "select_spots"]

FloatArray = NDArray[np.float64]
FloatImage = NDArray[np.float32]
Flags = NDArray[np.bool_]

_FLAT_TOP_PIXELS = 5
"""Pixels that share the highest value of a flat top; a star centred on a corner has four of them."""
_SHAPE_PIXELS = 7
"""The thesis' smallest object; the second moments of fewer pixels are noise."""
_SHORTEST_PX2 = 0.5
"""Variance, pixel included, below which nothing is long: a sharp star that falls on two pixels has 0.33."""
_STREAK_PIXELS = 12
_PIXEL_VARIANCE = 1.0 / 12.0
_HALO_TIMES = 20.0
_HALO_RADII = 2.5
_HALO_MARGIN_PX = 3.0
_RING_MARGIN = 3.0
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


def select_spots(
    table: FloatArray,
    settings: DetectionSettings,
    saturation_known: bool,
    image: FloatImage,
    background: Background,
    filtered: FloatImage | None = None,
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
    filtered, excess : array and float, optional
        The image after the matched filter and how far its noise exceeds the background's, where it was used.

    Returns
    -------
    Spots
        With the number of objects left out by reason. Only the brightest objects, six for each star asked for, are
        examined; the rest count as "fainter than the brightest".
    """
    rejected: dict[str, int] = {}
    if not len(table):
        return Spots.none()
    saturated = is_saturated(table, saturation_known)
    fewest = settings.min_pixels if filtered is None else 1
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

    keep = np.ones(len(table), np.bool_)
    keep &= ~_counted(rejected, "halo of a brighter star", is_halo(table))
    x, y = table[:, X_PEAK].astype(np.int64), table[:, Y_PEAK].astype(np.int64)
    if settings.reject_hits and keep.any():
        hit, one_pixel = is_hit(table, saturated, image, background, filtered, settings.psf_sigma_px)
        _count(rejected, "hot pixel", keep & hit & one_pixel)
        _count(rejected, "cosmic-ray hit", keep & hit & ~one_pixel)
        keep &= ~hit
    forms = measure_forms(table, settings.max_axis_ratio)
    keep &= ~_counted(rejected, "streak", keep & forms.long)
    if settings.isolation > 0.0 and keep.any():
        searched = image if filtered is None else filtered
        threshold = excess * settings.threshold_sigma
        cluttered = is_clutter(table, saturated, searched, background, threshold, settings.isolation)
        keep &= ~_counted(rejected, "clutter", keep & cluttered)
    chosen = np.flatnonzero(keep)
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


@dataclass(frozen=True, eq=False)
class Forms:
    """Second moments of objects: see `measure_forms`."""

    centre: FloatArray
    lines: FloatArray
    long: Flags


def measure_forms(table: FloatArray, max_axis_ratio: float) -> Forms:
    """Centre (N, 2), line (N, 2) as of `elongations`, and whether it is too long for a star.

    Too long is an object whose second moments along its principal axes differ by more than a factor (thesis eqs. 4.8
    and 4.9, here along the principal axes, so that a slanted streak is one too). The moments are weighted with the
    signal; the variance of a pixel is added to each; objects of fewer than seven pixels have no shape.
    """
    flux = table[:, FLUX]
    mean_x, mean_y = table[:, SUM_X] / flux, table[:, SUM_Y] / flux
    var_x = table[:, SUM_XX] / flux - mean_x**2 + _PIXEL_VARIANCE
    var_y = table[:, SUM_YY] / flux - mean_y**2 + _PIXEL_VARIANCE
    covariance = table[:, SUM_XY] / flux - mean_x * mean_y
    middle, half = 0.5 * (var_x + var_y), np.hypot(0.5 * (var_x - var_y), covariance)
    long = middle + half > max_axis_ratio * np.maximum(middle - half, 1e-12)
    long &= (table[:, PIXELS] >= _SHAPE_PIXELS) & (middle + half > _SHORTEST_PX2)
    return Forms(np.column_stack([mean_x, mean_y]), elongations(var_x, var_y, covariance), long)


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
    noise = excess * background.noise[table[:, Y_PEAK].astype(np.intp), table[:, X_PEAK].astype(np.intp)]
    strong = table[:, FLUX] > 2.0 * settings.threshold_sigma * noise * np.sqrt(table[:, PIXELS])
    table = table[strong & (table[:, PIXELS] >= _STREAK_PIXELS)]
    forms = measure_forms(table, settings.max_axis_ratio)
    whole = np.flatnonzero(forms.long & (table[:, EDGE] == 0))
    order = whole[np.lexsort((table[whole, X_PEAK], table[whole, Y_PEAK], -table[whole, FLUX]))]
    middle = 0.5 * (np.array(background.level.shape[::-1]) - 1.0)
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


def is_halo(table: FloatArray) -> Flags:
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
    filtered: FloatImage | None = None,
    filter_sigma_px: float | None = None,
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
    weight, width = _WEIGHT_PX, float("nan")
    shapes = np.empty((0, 0))
    for _ in range(2):
        brightest = np.flatnonzero(~saturated & (table[:, EDGE] == 0) & (table[:, PIXELS] >= 3))[: 2 * _WIDTH_STARS]
        shapes = measure_shapes(image, background.level, background.noise, x[brightest], y[brightest], weight)
        tells = np.flatnonzero(shapes[:, 4] > _WIDTH_SNR)[:_WIDTH_STARS]
        width = common_width(shapes[tells, 0])
        if not width > weight**2:
            break
        weight = 1.2 * float(np.sqrt(width))
    if not width > _SHARPEST_STAR_PX2:
        return np.zeros(len(table), np.bool_), np.zeros(len(table), np.bool_)
    limit = min(_SHARP_SHARE * width, _TRACK_PX2)
    shapes = measure_shapes(image, background.level, background.noise, x, y, weight)
    with np.errstate(invalid="ignore"):
        sharp = shapes[:, 0] + _SHARP_ERRORS * shapes[:, 2] < limit
    if filtered is not None:
        level, noise = background.level[y, x], background.noise[y, x]
        share = peak_share(math.sqrt(max(limit - _PIXEL_VARIANCE, 0.01)), filter_sigma_px)
        sharp |= image[y, x] - level > share * (filtered[y, x] - level) + _PEAK_ERRORS * noise
    return sharp & ~saturated & (table[:, EDGE] == 0), shapes[:, 3] > _ONE_PIXEL


def peak_share(star_sigma_px: float, filter_sigma_px: float | None) -> float:
    """Brightest pixel of a star on a pixel's centre, as a share of its signal in the filtered image."""
    kernel = matched_kernel(DEFAULT_SIGMA_PX if filter_sigma_px is None else filter_sigma_px)
    reach = len(kernel) // 2
    edges = (np.arange(-reach, reach + 2) - 0.5) / (math.sqrt(2.0) * star_sigma_px)
    star = np.diff([0.5 * math.erf(edge) for edge in edges])
    return float((star[reach] / (star @ kernel)) ** 2)


def is_clutter(
    table: FloatArray,
    saturated: Flags,
    searched: FloatImage,
    background: Background,
    threshold: float,
    isolation: float,
) -> Flags:
    """Objects that do not stand out of their own surroundings.

    A star is alone, or has a neighbour to one side; a leaf, a twig, a rag of cloud has its like all around. So the
    ring around an object is cut into eight sectors; where in four of them something exceeds the noise in the quiet
    parts of the frame by `threshold` (the quartile of the background's noise: where there are branches, the
    noise of the tiles is theirs), the object must be `isolation` times as high as the fourth highest sector.
    """
    x, y = table[:, X_PEAK].astype(np.int64), table[:, Y_PEAK].astype(np.int64)
    ring = measure_surroundings(searched, background.level, x, y, np.sqrt(table[:, PIXELS] / np.pi))
    quiet = threshold * float(np.quantile(background.noise[::16, ::16], _QUIET_QUANTILE))
    height = searched[y, x].astype(np.float64) - background.level[y, x] - ring[:, 0]
    return np.asarray((ring[:, 1] > quiet) & (height < isolation * ring[:, 1]) & ~saturated)
