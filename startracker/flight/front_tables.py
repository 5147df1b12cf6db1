"""Tables and constants of the flight build's front end: background, filter, star image, noise and limits."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from startracker.core import IntArray
from startracker.detection.artefacts import peak_share
from startracker.detection.matched import DEFAULT_SIGMA_PX, matched_kernel
from startracker.detection.scan import kernel_half
from startracker.detection.thresholds import SHARP_SHARE, SHARPEST_STARS_PX2, WIDEST_TRACK_PX2
from startracker.errors import InputError
from startracker.flight.c_table import CTable
from startracker.flight.design import FlightDesign
from startracker.flight.stars import VARIANCE_BITS

FRONT_MODULES = (
    "integers",
    "background",
    "hot_pixels",
    "rows",
    "components",
    "trails",
    "motion",
    "trail_fit",
    "stamps",
    "fit",
    "front",
)
BLOCK = 4
"""Rows of a block of the background."""
HALF = 5
"""Half side of a stamp, pixels."""
RUNS, HOT = 32, 64
"""Runs of a row above the threshold that are looked at, and hot pixels of a row that are bridged."""
TRAIL_POINTS = 18
"""Candidates that decide whether the others have the rest of the memory, or trails."""
TRAIL_RUNS, TRAIL_PENDING = 24, 16
"""Runs of a row above half the threshold, and components that have ended and wait for their last pixels."""
TRAIL_MARGIN = 3
"""Pixels that are kept about a component above half the threshold."""
TRAIL_WAIT = HALF + TRAIL_MARGIN
"""Rows after which all pixels about one are kept."""
TRAIL_ROWS, TRAIL_WORDS = 64, 3328
"""Rows of which pixels about these are kept, and words for them."""
OBJECTS = 40
"""Components kept that no stamp holds."""
FIRST_TAP = 128
SMALLEST_SIDE, LARGEST_SIDE = 16, 4096
SHAPE_VARIANCE_PX2 = 3.0
"""Variance of the weight under which star images are measured: wider than images smeared by 5 px."""
_SAMPLES = 128
_LONGEST_REACH = 4
SMALLEST_SIGMA_PX, LARGEST_SIGMA_PX = 0.35, 2.2
"""Of a star image along an axis: more does not fit in a stamp."""
_PIXEL_VARIANCE = 1.0 / 12.0
_PROFILE_REACH = 4.5
_LONGEST_TIMES = 5
LEAST_IMAGE, MOST_IMAGE = (round(256 * (s**2 + _PIXEL_VARIANCE)) for s in (SMALLEST_SIGMA_PX, LARGEST_SIGMA_PX))
"""Variances of these, pixel included, 8 fraction bits."""
_SYSTEMATIC_PX = 0.001
"""As of `startracker.centroid.psf_fit`."""


class FrontTables(NamedTuple):
    """Numbers of the front end; lengths in pixels, levels in DN.

    Parameters
    ----------
    width, height : int
        Of the frame.
    saturation : int
        Pixels of this value or more are saturated.
    max_stars, pool : int
        Stars of a list; candidates of which stamps are kept.
    max_pixels : int
        Largest star; a trail may have five times as many.
    axis_ratio : int
        Largest ratio of a star's principal variances, 8 fraction bits.
    stride : int
        Every how many pixels of a row are sampled for the background.
    knot : int array, shape (C + 2,)
        Columns between which the background is interpolated: 0, the middles of C tiles, width - 1.
    edge : int array, shape (C + 1,)
        First columns of the tiles, and the width.
    inverse : int array, shape (C + 1,)
        65536 over the distance of two knots.
    extend : int array, shape (2,)
        How far the first and last knots lie beyond the tiles' middles, in distances of these, 16 fraction bits.
    tap : int array, shape (R + 1,)
        Middle and one half of the filter; the middle is 128.
    level_weight : int
        Filtered value of a level of one DN, 8 fraction bits.
    threshold : int
        Threshold in filtered units for a noise of one DN.
    share : int
        Largest brightest pixel of a star over its filtered value, 16 fraction bits; 0: not tested.
    sharp : int
        Least variance along the minor axis of a star's image, square pixels, 8 fraction bits.
    seen_sharp : int
        The same under the weight `shape_weight`.
    profile, density : int array, shape (P,)
        Integral from 0 and density of the normal distribution, 15 fraction bits, steps of σ/64.
    shape_weight : int array
        Gaussian weight of measured shapes, 12 fraction bits, steps of 1/16 pixel.
    fit_half : int
        Half side of the window of a fit, at least.
    image : int
        Variance of the star image along an axis where a frame has too few stars to measure it, pixel included, square
        pixels, 8 fraction bits.
    gain : int
        2^44 over the gain.
    flat : int
        Flat-field error, 16 fraction bits.
    floor : int
        Variance that is added to each position's, square pixels, 26 fraction bits.
    """

    width: int
    height: int
    saturation: int
    max_stars: int
    pool: int
    max_pixels: int
    axis_ratio: int
    stride: int
    knot: IntArray
    edge: IntArray
    inverse: IntArray
    extend: IntArray
    tap: IntArray
    level_weight: int
    threshold: int
    share: int
    sharp: int
    seen_sharp: int
    profile: IntArray
    density: IntArray
    shape_weight: IntArray
    fit_half: int
    image: int
    gain: int
    flat: int
    floor: int


def front_tables(design: FlightDesign) -> FrontTables:
    """Tables of the front end for a design.

    Raises
    ------
    InputError
        A frame of less than 16 or more than 4096 pixels a side; a gain out of range.
    """
    width, height, sigma = design.camera.width, design.camera.height, design.psf_sigma_px
    if min(width, height) < SMALLEST_SIDE or max(width, height) > LARGEST_SIDE:
        raise InputError(f"a flight build takes frames of 16 to 4096 pixels a side; the camera has {width} × {height}")
    detector = design.front_detector
    if not 2.0**-6 <= detector.gain_e_per_dn <= 2.0**14:
        raise InputError(f"the gain is {detector.gain_e_per_dn:g} e/DN; a flight build takes 1/64 to 16384")
    detection, centroid = design.detection, design.centroid
    taps = _taps(detection.psf_sigma_px or DEFAULT_SIGMA_PX)
    whole, squares = int(2 * taps.sum() - taps[0]), int(2 * (taps**2).sum() - taps[0] ** 2)
    tiles = max(1, round(width / detection.background_tile_px))
    edge = np.arange(tiles + 1) * width // tiles
    limit = min(SHARP_SHARE * (sigma**2 + _PIXEL_VARIANCE), WIDEST_TRACK_PX2)
    judged = detection.reject_hits and sigma**2 + _PIXEL_VARIANCE > SHARPEST_STARS_PX2
    seen = limit * SHAPE_VARIANCE_PX2 / (limit + SHAPE_VARIANCE_PX2)
    step = np.arange(round(_PROFILE_REACH * 64) + 1) / 64.0
    distance = np.arange(16 * (HALF + 2) + 1) / 16.0
    variance = 1 << VARIANCE_BITS
    return FrontTables(
        width,
        height,
        detector.saturation_dn,
        detection.max_stars,
        detection.max_stars + detection.max_stars // 10,
        detection.max_pixels,
        round(256 * detection.max_axis_ratio),
        max(2, -(-int(np.diff(edge).max()) * BLOCK // _SAMPLES)),
        *_knots(edge),
        taps,
        16 * whole**2,
        round(detection.threshold_sigma * squares / 16.0),
        _share(math.sqrt(max(limit - _PIXEL_VARIANCE, 0.01)), taps) if judged else 0,
        round(256 * limit) if judged else 0,
        round(256 * seen) if judged else 0,
        np.rint((ndtr(step) - 0.5) * (1 << 15)).astype(np.int64),
        np.rint(np.exp(-0.5 * step**2) / math.sqrt(2.0 * math.pi) * (1 << 15)).astype(np.int64),
        np.rint(4096.0 * np.exp(-0.5 * distance**2 / SHAPE_VARIANCE_PX2)).astype(np.int64),
        min(centroid.window_px // 2, HALF),
        round(256 * (min(max(sigma, SMALLEST_SIGMA_PX), LARGEST_SIGMA_PX) ** 2 + _PIXEL_VARIANCE)),
        round(2.0**44 / detector.gain_e_per_dn),
        round(65536 * centroid.flat_field_error),
        round(variance * (_SYSTEMATIC_PX**2 + centroid.camera_model_px**2)),
    )


def _taps(sigma_px: float) -> IntArray:
    half = matched_kernel(min(sigma_px, (_LONGEST_REACH + 0.5) / 2.5))
    half = half[len(half) // 2 :]
    return np.asarray(np.rint(FIRST_TAP * half / half[0]).astype(np.int64))


def _share(sigma_px: float, taps: IntArray) -> int:
    """Brightest pixel of the sharpest star over its filtered value, middle tap 1."""
    half = kernel_half(np.concatenate([taps[:0:-1], taps]) / float(FIRST_TAP))
    return round(65536 * float(peak_share(sigma_px, half)))


def _knots(edge: IntArray) -> tuple[IntArray, IntArray, IntArray, IntArray]:
    """Knots, edges, inverse distances and extensions."""
    middle, width = (edge[:-1] + edge[1:]) // 2, int(edge[-1])
    knot = np.concatenate([[0], middle, [width - 1]])
    length = np.diff(knot)
    inverse = np.where(length > 0, 65536 // np.maximum(length, 1), 0)
    extend = np.zeros(2, np.int64)
    if len(middle) > 1:
        apart = np.maximum(np.diff(middle), 1)
        extend[:] = 65536 * length[0] // apart[0], 65536 * length[-1] // apart[-1]
    return knot, edge, inverse, extend


def front_constants(tables: FrontTables) -> dict[str, int]:
    """Constants of the C source by name."""
    numbers = {
        name.upper(): value
        for name, value in tables._asdict().items()
        if isinstance(value, int) and name not in ("width", "height", "max_stars")
    }
    tiles, reach = len(tables.edge) - 1, len(tables.tap) - 1
    numbers |= {
        "BLOCK": BLOCK,
        "BLOCKS": max(1, tables.height // BLOCK),
        "KEPT": (BLOCK + max(HALF, reach + 1)) // BLOCK + 2,
        "KNOTS": tiles + 2,
        "WIDE": round(256 * SHAPE_VARIANCE_PX2),
        "LEAST_IMAGE": LEAST_IMAGE,
        "MOST_IMAGE": MOST_IMAGE,
        "HALF": HALF,
        "SIDE": 2 * HALF + 1,
        "LAG": BLOCK + max(HALF, reach + 1),
        "RING": HALF + BLOCK + max(HALF, reach + 1) + 1,
        "RUNS": RUNS,
        "HOT": HOT,
        "OBJECTS": OBJECTS,
        "TRAIL_POINTS": min(TRAIL_POINTS, tables.pool),
        "TRAIL_RUNS": TRAIL_RUNS,
        "TRAIL_PENDING": TRAIL_PENDING,
        "TRAIL_MARGIN": TRAIL_MARGIN,
        "TRAIL_WAIT": TRAIL_WAIT,
        "TRAIL_HISTORY": TRAIL_WAIT + 1,
        "TRAIL_ROWS": TRAIL_ROWS,
        "TRAIL_WORDS": TRAIL_WORDS,
        "TILES": tiles,
        "REACH": reach,
        "TAPS": reach + 1,
        "LAST_PROFILE": len(tables.profile) - 1,
        "LAST_WEIGHT": len(tables.shape_weight) - 1,
        "SAMPLES": BLOCK * -(-int(np.diff(tables.edge).max()) // tables.stride),
        "LARGEST": _LONGEST_TIMES * tables.max_pixels,
    }
    return {f"FRONT_{name}": value for name, value in numbers.items()}


def front_arrays(tables: FrontTables) -> list[CTable]:
    """Constant arrays of the C source."""
    return [
        CTable("uint16_t", "front_edge", "first columns of the tiles of the background, and the width", tables.edge),
        CTable("uint16_t", "front_knot", "columns between which the background is interpolated", tables.knot),
        CTable("int32_t", "front_inverse", "65536 / distance of the knots", tables.inverse),
        CTable("int32_t", "front_extend", "extrapolation to both borders, 16 fraction bits", tables.extend),
        CTable("int16_t", "front_tap", "matched filter from its middle outwards", tables.tap),
        CTable("uint16_t", "front_profile", "integral of the normal distribution, steps of 1/64", tables.profile),
        CTable("uint16_t", "front_density", "density of the normal distribution", tables.density),
        CTable("uint16_t", "front_shape_weight", "weight of measured shapes, 1/16 px", tables.shape_weight),
    ]
