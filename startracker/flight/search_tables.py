"""Tables of the identification of a flight build, made once in floating point: guide stars, pairs, grid, evidence.

Directions are unit vectors of 2.30, and chords between them have the same unit, 2⁻³⁰. Logarithms are to base 2 with 12
fraction bits. Each entry of the evidence is rounded to the side on which the Bayes factor comes out smaller.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammaln, pdtrc

from startracker.catalog.guide import GuideDatabase, brightest_everywhere
from startracker.catalog.sky_view import field_shape
from startracker.core import FloatArray, IntArray
from startracker.errors import InputError
from startracker.flight.apparent import epoch_of, guide_motion
from startracker.flight.design import FlightDesign
from startracker.flight.integers import DIRECTION_BITS, rounded
from startracker.flight.search_plan import QUICK, SEARCHES, Search, triad_searches
from startracker.flight.triad_numbers import TriadNumbers, triad_numbers
from startracker.identification.bayes_factor import (
    DISTRACTORS,
    SCALE_LOG_PRIOR,
    SCALES,
    SCATTERS_MAG,
    SEEN,
    count_table,
    largest_density,
)
from startracker.identification.verification import MOST_EXTRA
from startracker.settings.identification import AdaptiveSettings

LOG_BITS = 12
"""Fraction bits of logarithms to base 2."""
MAGNITUDE_BITS, DENSITY_BITS, CROWD_BITS, COUNT_BITS = 6, 20, 30, 6
"""Fraction bits of magnitudes, densities of magnitudes, the kernel of the crowding, and of the logarithms
in the large tables of counts."""
PAIR_SHARE, BRIGHT_SHARE, BRIGHT_IN_FIELD = 0.3, 0.8, 14
"""Largest separation of the pairs, of the field's diagonal; that of pairs of the brightest stars everywhere, so many in
a circle around the field: if an image has few stars, they are those and far apart."""
TRIAD_SHARE, TRIAD_BRIGHT = 0.8, 2.0
"""For triads: largest separation of the pairs, of the field's diagonal, which are between the brightest stars
everywhere; so many in a circle around the field for each star that makes triads."""
_BINS = 2048
MOST_STARS, LARGEST_PIXEL_RAD = 120, 4.4e-3
"""Limits of 8-bit indices, and of products of 64 bits."""
COLUMNS = 64
COLUMN_SHIFT = 31 - COLUMNS.bit_length() + 1
"""Columns of the grid along x and along y: squares of the unit disc."""
QUADRANT = 64
"""Entries of the outline a quadrant."""
_FAINTEST_DIFFERENCE = 6.0
CROWD_FROM, CROWD_STEP_BITS = -8, 7
"""First logarithm of the crowding's table, and the shift from logarithms to entries."""
_CROWD_TO = 15
_MOST_NEEDED, _MARGIN = 12, 1024
LARGEST_MAG = 100.0
"""More than any difference of brightness."""
MOST_KEPT, _ALL_VOTES = 8192, 1 << 24
"""Votes about a pole that the default identification keeps; more than there are."""
WIDE_MAG, WIDE_SHARE, FLOOR, EVEN = 1.5, 0.2, 1e-3, 0.1
"""Those of `bayes_factor` and `clustering_null`: wings of the magnitudes, least density, share of points anywhere."""


class SearchTables(NamedTuple):
    """Guide stars and constants of one camera; the arrays of the C have the same contents."""

    most_stars: int
    """Stars of a list at most."""
    least_stars: int
    pixel2: int
    """Square of a pixel's angle, 2⁻⁶⁰ rad²."""
    guide: IntArray
    """Directions (G, 3), brightest first."""
    motion: IntArray
    """Proper motions (G, 3) a year, unit vectors of 29 fraction bits."""
    epoch: int
    """Julian epoch of the directions, years of 16 fraction bits."""
    magnitude: IntArray
    """V (G,), 6 fraction bits."""
    number: IntArray
    """Catalogue numbers (G,)."""
    first: IntArray
    second: IntArray
    """Guide stars of the pairs (P,), by ascending bins of their chords."""
    bin_start: IntArray
    """First pair of each bin (B + 1,)."""
    bin_shift: int
    """From chords to bins."""
    longest: int
    """Largest chord of a pair."""
    column_start: IntArray
    column_star: IntArray
    """First entry of each column of the grid (COLUMNS² + 1,), and the guide stars (G,) of the columns, by z."""
    outline_axes: IntArray
    """Rows (3, 3): two transverse axes and the image's centre, camera axes."""
    outline: IntArray
    """Least cosine from the centre, by the azimuth as a share of the diamond |x| + |y| = 1 (4 × QUADRANT + 1,)."""
    least_cosine: int
    field_chord: int
    """Largest chord from the image's centre to its outline."""
    log_area: int
    log_area_up: int
    """log₂ of the image's area, 2⁻⁶⁰ sr, rounded down and up."""
    log_table: IntArray
    sum_table: IntArray
    crowd_table: IntArray
    """1/(1 + x)², 30 fraction bits, by log₂ x, rounded up."""
    density_table: IntArray
    """Density of a magnitude's difference for each scatter (2, ·), 20 fraction bits, rounded down."""
    distracting: IntArray
    seeing: IntArray
    total: IntArray
    """log₂ of weights, 6 fraction bits: of k false stars (N + 1,); of m stars detected and k not (N + 1, depth + 1); of
    all assignments of n stars to up to k guide stars (N + 1, depth + 1)."""
    log_scale2: IntArray
    quadratic: IntArray
    log_volume: IntArray
    """Of each width (8,): log₂ of its square; log₂ e/2 of a squared residual, 20 fraction bits; log₂ of its prior and
    of the volume of attitudes for a normal matrix of determinant 1."""
    log_density: IntArray
    """log₂ of the bound on the density of ln B, by the number of stars, rounded up."""
    log_rate: int
    """log₂ of the false-alarm rate, rounded down."""
    needed: IntArray
    """Largest mean, 16 fraction bits, of which k or more matches have a probability of `CHANCES` at most, (4, k)."""
    magnitude_tolerance: int
    """Between differences of brightness, 6 fraction bits."""
    searches: tuple[Search, ...]
    quick: int
    """Number of the searches after which an attitude accepted with a margin ends the identification."""
    most_kept: int
    """Votes about a pole that are kept."""
    triads: TriadNumbers | None
    """Limits of the triads; None: the default identification."""

    @property
    def identifier(self) -> str:
        """As in `FlightDesign`."""
        return "adaptive" if self.triads is None else "triads"


CHANCES = (0.02, 0.005, 0.001, 1e-4)
"""Rows of `SearchTables.needed`."""


def search_tables(design: FlightDesign) -> SearchTables:
    """Tables of a camera's guide stars.

    Parameters
    ----------
    design : FlightDesign

    Raises
    ------
    InputError
        For more guide stars than 15-bit indices can address, or none that fit into the field in pairs; more stars a
        list than 8-bit indices can address; settings of the triads as in `triad_numbers`.
    """
    if design.camera.pixel_rad > LARGEST_PIXEL_RAD:
        raise InputError("a flight build takes pixels of less than 15 arcminutes; use a longer focal length")
    if design.detection.max_stars > MOST_STARS:
        raise InputError(f"a flight build takes up to {MOST_STARS} stars per frame; set tracker.detection.max_stars")
    guide, triads = design.guide, triad_numbers(design) if design.identifier == "triads" else None
    if not 3 <= len(guide) < 1 << 15:
        raise InputError(f"a flight build holds 3 to 32767 guide stars, not {len(guide)}; change the magnitude limit")
    directions = rounded(guide.directions, DIRECTION_BITS)
    most = design.detection.max_stars
    depths = 2 * most + MOST_EXTRA
    shape = field_shape(design.camera)
    axes = rounded(shape.axes, DIRECTION_BITS)
    outline = _outline(shape.least_cosine)
    settings = design.identification
    log_area = math.log2(guide.solid_angle_sr) + 2 * DIRECTION_BITS
    return SearchTables(
        most,
        max(settings.min_stars, 3),
        round((design.camera.pixel_rad * (1 << DIRECTION_BITS)) ** 2),
        directions,
        guide_motion(guide),
        epoch_of(guide.epoch_jyear),
        np.rint(guide.v_mag * (1 << MAGNITUDE_BITS)).astype(np.int64),
        np.asarray(guide.catalog.id, dtype=np.int64),
        *_pairs(guide, directions, triads),
        *_columns(directions),
        axes,
        outline,
        int(outline.min()),
        math.ceil(math.sqrt(2.0 * (1.0 - shape.widest_cosine)) * (1 << DIRECTION_BITS)) + _MARGIN,
        int(_down(log_area)),
        int(_up(log_area)),
        _down(np.log2(1.0 + np.arange(256) / 256.0)),
        _down(np.log2(1.0 + 2.0 ** -(np.arange(1, 64 * 13 + 1) / 64.0))),
        _crowding(),
        _densities(),
        _log2_distracting(most),
        _log2_seeing(most, depths),
        _totals(most, depths),
        _up(2.0 * np.log2(SCALES)),
        np.ceil((1 << (2 * LOG_BITS - 4)) * 0.5 / math.log(2.0) / SCALES**2).astype(np.int64),
        _down(
            1.5 * math.log2(2.0 * math.pi)
            - math.log2(8.0 * math.pi**2)
            + 3.0 * np.log2(SCALES)
            + SCALE_LOG_PRIOR / math.log(2.0)
        ),
        _up([math.log2(largest_density(n)) for n in range(most + 1)]),
        int(_down(math.log2(settings.false_alarm_rate))),
        np.array([[_largest_mean(k, chance) for k in range(1, _MOST_NEEDED + 1)] for chance in CHANCES]),
        _magnitude_tolerance(design),
        SEARCHES if triads is None else triad_searches(triads.stars, triads.fixed > 0),
        QUICK if triads is None else 0,
        MOST_KEPT if triads is None else _ALL_VOTES,
        triads,
    )


def _magnitude_tolerance(design: FlightDesign) -> int:
    """Between differences of brightness, 6 fraction bits; triads do not look at them."""
    largest = LARGEST_MAG
    if design.identifier == "adaptive":
        largest = min(AdaptiveSettings.of(design.identification).magnitude_tolerance, largest)
    return round(largest * (1 << MAGNITUDE_BITS))


def _pairs(
    guide: GuideDatabase, directions: IntArray, triads: TriadNumbers | None
) -> tuple[IntArray, IntArray, IntArray, int, int]:
    """Both stars of the pairs and the bins of their chords, in integers."""
    share, bright_share, most = PAIR_SHARE, BRIGHT_SHARE, BRIGHT_IN_FIELD
    if triads is not None:
        share, bright_share, most = 0.0, TRIAD_SHARE, round(TRIAD_BRIGHT * triads.stars)
    listed = guide.pairs_within(max(share, bright_share))
    if not len(listed):
        raise InputError("no two guide stars fit into the field; raise the magnitude limit")
    bright = brightest_everywhere(guide.directions, guide.half_diagonal_rad, most)
    near = listed.separation_rad <= 2.0 * guide.half_diagonal_rad * share
    kept = near | (bright[listed.first] & bright[listed.second])
    one, other = listed.first[kept], listed.second[kept]
    apart = directions[one] - directions[other]
    chord = np.array([math.isqrt(int(c)) for c in (apart * apart).sum(axis=1)])
    shift = max(int(chord.max()).bit_length() - (_BINS.bit_length() - 1), 0)
    order = np.argsort(chord >> shift, kind="stable")
    bins = chord[order] >> shift
    start = np.searchsorted(bins, np.arange(int(bins[-1]) + 2))
    first, second = one[order].astype(np.int64), other[order].astype(np.int64)
    return first, second, start, shift, int(chord.max())


def column_of(coordinate: ArrayLike) -> IntArray:
    """Column of the grid of coordinates from −1 to 1 of 2.30."""
    cell = (np.asarray(coordinate, dtype=np.int64) + (1 << 30)) >> COLUMN_SHIFT
    return np.asarray(np.clip(cell, 0, COLUMNS - 1))


def _columns(directions: IntArray) -> tuple[IntArray, IntArray]:
    column = column_of(directions[:, 0]) * COLUMNS + column_of(directions[:, 1])
    order = np.lexsort((directions[:, 2], column))
    start: IntArray = np.searchsorted(column[order], np.arange(COLUMNS * COLUMNS + 1))
    return start, np.asarray(order)


def _outline(least_cosine: FloatArray) -> IntArray:
    """Table by the share of the diamond of one by azimuths from −π."""
    share = np.arange(4 * QUADRANT + 1) / QUADRANT  # 0 to 4, from +x to +y
    quadrant, along = np.divmod(share, 1.0)
    azimuth = 0.5 * math.pi * quadrant + np.arctan2(along, 1.0 - along)
    known = -math.pi + 2.0 * math.pi * np.arange(len(least_cosine)) / len(least_cosine)
    value = np.interp(azimuth, known, least_cosine, period=2.0 * math.pi)
    return np.asarray(np.rint(value * (1 << DIRECTION_BITS)).astype(np.int64))


def _crowding() -> IntArray:
    step = 2.0 ** (CROWD_STEP_BITS - LOG_BITS)
    x = 2.0 ** np.arange(CROWD_FROM, _CROWD_TO, step)
    return np.ceil((1 << CROWD_BITS) / (1.0 + x) ** 2).astype(np.int64)


def _densities() -> IntArray:
    difference = np.arange(0.0, _FAINTEST_DIFFERENCE, 1.0 / (1 << MAGNITUDE_BITS))
    width = SCATTERS_MAG[:, None]
    core = (1.0 - WIDE_SHARE) / width * np.exp(-0.5 * (difference / width) ** 2)
    wide = WIDE_SHARE / WIDE_MAG * np.exp(-0.5 * (difference / WIDE_MAG) ** 2)
    density = (core + wide) / math.sqrt(2.0 * math.pi)
    return np.asarray(np.floor(density * (1 << DENSITY_BITS)).astype(np.int64))


def _log2_distracting(most: int) -> IntArray:
    k = np.arange(most + 1)
    terms = [math.log(weight) - mean + k * math.log(mean) for mean, weight in DISTRACTORS]
    return _down(np.logaddexp.reduce(terms, axis=0) / math.log(2.0), COUNT_BITS)


def _log2_seeing(most: int, depths: int) -> IntArray:
    m, unseen = np.arange(most + 1)[:, None], np.arange(depths + 1)[None, :]
    terms = [math.log(weight) + m * math.log(p) + unseen * math.log1p(-p) for p, weight in SEEN]
    return _down(np.logaddexp.reduce(terms, axis=0) / math.log(2.0), COUNT_BITS)


def _totals(most: int, depths: int) -> IntArray:
    """log₂ of n! times the probability of n stars, upwards."""
    out = np.zeros((most + 1, depths + 1), dtype=np.int64)
    for n in range(3, most + 1):
        out[n, 1:] = _up((count_table(n, depths).log_total[1:] + gammaln(n + 1.0)) / math.log(2.0), COUNT_BITS)
    return out


def _largest_mean(k: int, chance: float) -> int:
    """Largest mean of a Poisson distribution, 16 fraction bits, of which k or more occur with `chance` at most."""
    low, high = 0, 64 << 16
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if pdtrc(k - 1, middle / 65536.0) <= chance else (low, middle)
    return low


def _down(value: ArrayLike, bits: int = LOG_BITS) -> IntArray:
    return np.asarray(np.floor(np.asarray(value) * (1 << bits)), dtype=np.int64)


def _up(value: ArrayLike, bits: int = LOG_BITS) -> IntArray:
    return np.asarray(np.ceil(np.asarray(value) * (1 << bits)), dtype=np.int64)


EVEN_SHARE_LOG = int(_up(math.log2(EVEN)))
SPREAD_SHARE_LOG = int(_up(math.log2((1.0 - EVEN) / math.pi)))
"""log₂ of the share of points that lie anywhere; of the others', over π."""
