"""Second moments of objects, and the rotation of the camera that explains the streaks of a frame."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from startracker._compiled import kernel, kernel_part
from startracker.core import FloatArray
from startracker.detection.sources import Sources
from startracker.detection.thresholds import (
    AGREEING_SHARE,
    CLEAR_MOTION_PX,
    FEWEST_AGREEING,
    HALO_MARGIN_PX,
    HALO_PEAK_RATIO,
    HALO_RADII,
    LONG_LEAST_PX2,
    MOTION_TOLERANCE_PX,
    MOTION_TOLERANCE_SHARE,
    RING_MARGIN,
    SHAPE_PIXELS,
    SHORT_AGREEING_SHARE,
    SHORTEST_MOTION_PX,
)
from startracker.sorting import median

_TRIED = 14
"""Number of the brightest streaks of which every pair proposes a motion."""


def elongations(variance_x: FloatArray, variance_y: FloatArray, covariance: FloatArray) -> FloatArray:
    """Vector (N, 2), px, of the uniform line that widens round images to these second moments.

    A line of length L adds L²/12 to the variance along itself. Which end came first is unknown, so the sign of the
    vector is arbitrary.
    """
    half = np.hypot(0.5 * (variance_x - variance_y), covariance)
    angle = 0.5 * np.arctan2(2.0 * covariance, variance_x - variance_y)
    length = np.sqrt(24.0 * half)
    return np.column_stack([length * np.cos(angle), length * np.sin(angle)])


def common_motion(
    xy: FloatArray, lines: FloatArray, shortest_px: float = SHORTEST_MOTION_PX, clear_px: float = CLEAR_MOTION_PX
) -> FloatArray | None:
    """Motion (a, b, c) of the image that most streaks share, or None if fewer than four do.

    A rotating camera moves the image at (x, y) by (a − c y, b + c x): two shifts, and a rotation about the line of
    sight (narrow field). Every pair of the brightest streaks, with either sign, proposes a motion by least squares; the
    one that fits most of these to 12 % of the length and 1 px is fitted to all streaks that it explains. Fainter
    objects take no part in the proposals, because among hundreds of them some always agree by chance.

    Of the brightest streaks 0.6 must share the motion, or 0.7 if its median length is below `clear_px`; it must be at
    least `shortest_px` long.

    Parameters
    ----------
    xy : (N, 2)
        Centres, brightest first, about the middle of the image.
    lines : (N, 2)
        From `elongations`.
    shortest_px, clear_px : float
        Least motion, and the least that 0.6 suffice for.
    """
    count = len(xy)
    if count < FEWEST_AGREEING:
        return None
    tried = min(count, _TRIED)
    best, motion = _search(xy, lines, tried)
    if best < FEWEST_AGREEING:
        return None
    # The fit is repeated once, because fitting may bring streaks within the limits or out of them.
    for _ in range(2):
        expected = motion_at(xy, motion)
        sign = np.where((expected * lines).sum(axis=1) < 0.0, -1.0, 1.0)
        fits = agrees(lines, expected)
        if np.count_nonzero(fits[:tried]) < max(FEWEST_AGREEING, AGREEING_SHARE * tried):
            return None
        motion = _fit(xy[fits], (sign[:, None] * lines)[fits])
    length = median(np.hypot(*motion_at(xy[:tried], motion).T))
    sure = length > clear_px or np.count_nonzero(fits[:tried]) >= SHORT_AGREEING_SHARE * tried
    return motion if sure and length > shortest_px else None


def frame_motion(xy: FloatArray, lines: FloatArray) -> FloatArray | None:
    """`common_motion`, also for a frame in which a train of satellites draws bright parallel streaks.

    If no motion of the brightest streaks is shared by half of all streaks, each of the two largest groups of one motion
    is set aside in turn. Of the motions that the remaining streaks then share, the one with more streaks is the
    frame's.
    """
    first = common_motion(xy, lines)
    if len(xy) < 2 * FEWEST_AGREEING or (
        first is not None and 2 * np.count_nonzero(_fits(xy, lines, first)) >= len(xy)
    ):
        return first
    best, most, left = first, 0 if first is None else np.count_nonzero(_fits(xy, lines, first)), np.ones(len(xy), bool)
    # The two largest groups are set aside one after the other: a train of satellites may outnumber the brightest stars.
    for _ in range(2):
        agreeing, group = _search(xy[left], lines[left], min(int(left.sum()), _TRIED))
        if agreeing < FEWEST_AGREEING:
            break
        aside = _fits(xy, lines, group)
        left &= ~aside
        motion = common_motion(xy[~aside], lines[~aside])
        count = 0 if motion is None else np.count_nonzero(_fits(xy, lines, motion))
        if count > most:
            best, most = motion, count
    return best


def _fits(xy: FloatArray, lines: FloatArray, motion: FloatArray) -> NDArray[np.bool_]:
    """Mask of the streaks that a motion explains."""
    return agrees(lines, motion_at(xy, motion))


def motion_at(xy: FloatArray, motion: FloatArray) -> FloatArray:
    """Streak (N, 2), px, that a motion causes at each position."""
    a, b, c = motion
    return np.column_stack([a - c * xy[:, 1], b + c * xy[:, 0]])


def agrees(lines: FloatArray, expected: FloatArray) -> NDArray[np.bool_]:
    """Mask of the streaks that agree with the expected ones, in either orientation."""
    limit = MOTION_TOLERANCE_PX + MOTION_TOLERANCE_SHARE * np.hypot(*expected.T)
    apart = np.minimum(np.hypot(*(lines - expected).T), np.hypot(*(lines + expected).T))
    return np.asarray(apart <= limit)


def _fit(xy: FloatArray, lines: FloatArray) -> FloatArray:
    """Least squares fit of a motion: the rotation from differences to the means, the shift from the means."""
    (x, y), (u, v) = xy.mean(axis=0), lines.mean(axis=0)
    apart = xy - (x, y)
    turn = (apart[:, 0] @ lines[:, 1] - apart[:, 1] @ lines[:, 0]) / max(float((apart * apart).sum()), 1e-12)
    return np.array([u + turn * y, v - turn * x, turn])


@kernel
def _search(xy: FloatArray, lines: FloatArray, tried: int) -> tuple[int, FloatArray]:
    # All pairs of `tried` streaks are tried, each with both signs, because the orientation of a streak is unknown.
    best, most = np.zeros(3), 0
    smallest = np.inf
    for first in range(tried):
        for second in range(first + 1, tried):
            for sign in (1.0, -1.0):
                # Least squares for two points: the rotation follows from their differences, the shift from their means.
                x, y = xy[second, 0] - xy[first, 0], xy[second, 1] - xy[first, 1]
                u = sign * lines[second, 0] - lines[first, 0]
                v = sign * lines[second, 1] - lines[first, 1]
                c = (x * v - y * u) / max(x * x + y * y, 1e-12)
                a = 0.5 * (lines[first, 0] + sign * lines[second, 0] + c * (xy[first, 1] + xy[second, 1]))
                b = 0.5 * (lines[first, 1] + sign * lines[second, 1] - c * (xy[first, 0] + xy[second, 0]))
                count, total = 0, 0.0
                for k in range(tried):
                    p, q = a - c * xy[k, 1], b + c * xy[k, 0]
                    u, v = lines[k, 0], lines[k, 1]
                    limit = MOTION_TOLERANCE_PX + MOTION_TOLERANCE_SHARE * math.sqrt(p * p + q * q)
                    apart = math.sqrt(min((u - p) ** 2 + (v - q) ** 2, (u + p) ** 2 + (v + q) ** 2))
                    if apart <= limit:
                        count += 1
                        total += apart
                if count > most or (count == most and total < smallest):
                    best[0], best[1], best[2], most, smallest = a, b, c, count, total
    return most, best


Flags = NDArray[np.bool_]

_PIXEL_VARIANCE = 1.0 / 12.0


@dataclass(frozen=True, eq=False)
class Forms:
    """Second moments of objects: see `measure_forms`."""

    centre: FloatArray
    moments: FloatArray
    long: Flags

    @property
    def lines(self) -> FloatArray:
        """Line (N, 2), px, see `elongations`."""
        return elongations(*self.moments.T)


def measure_forms(table: Sources, max_axis_ratio: float) -> Forms:
    """Centre (N, 2), second moments (N, 3) of x, y and xy, and a flag whether an object is too long for a star."""
    moments, long = np.empty((len(table), 5)), np.empty(len(table), np.bool_)
    _measure_forms(table, max_axis_ratio, moments, long)
    return Forms(moments[:, :2], moments[:, 2:], long)


@kernel
def _measure_forms(table: Sources, max_axis_ratio: float, moments: FloatArray, long: Flags) -> None:
    for n in range(len(table)):
        x, y, xx, yy, xy, long[n] = form_of(table[n], max_axis_ratio)
        moments[n, 0], moments[n, 1], moments[n, 2], moments[n, 3], moments[n, 4] = x, y, xx, yy, xy


@kernel_part
def form_of(row: np.void, max_axis_ratio: float) -> tuple[float, float, float, float, float, bool]:
    """Centre and second moments x, y, xx, yy, xy of an object, px and px², and whether it is too long for a star.

    An object is too long if its second moments along the principal axes differ by more than a factor of
    `max_axis_ratio` (Greyling 1995, eqs. 4.8 and 4.9, but along the principal axes, so that slanted streaks are
    included). The moments are weighted with the signal; the variance of a pixel, 1/12 px², is added to xx and yy.
    Objects of fewer than seven pixels are never too long.
    """
    flux = row["flux"]
    x, y = row["sum_x"] / flux, row["sum_y"] / flux
    xx = row["sum_xx"] / flux - x * x + _PIXEL_VARIANCE
    yy = row["sum_yy"] / flux - y * y + _PIXEL_VARIANCE
    xy = row["sum_xy"] / flux - x * y
    middle, half = 0.5 * (xx + yy), math.hypot(0.5 * (xx - yy), xy)
    elongated = middle + half > max_axis_ratio * max(middle - half, 1e-12)
    return x, y, xx, yy, xy, elongated and row["pixels"] >= SHAPE_PIXELS and middle + half > LONG_LEAST_PX2


def centres(table: Sources) -> FloatArray:
    """Centres of light (N, 2) of objects, px."""
    centre, flux = np.empty((len(table), 2)), table["flux"]
    # `np.divide` with an output writes straight into a column; this runs on thousands of objects per frame.
    np.divide(table["sum_x"], flux, centre[:, 0])
    np.divide(table["sum_y"], flux, centre[:, 1])
    return centre


def brightest_first(table: Sources) -> Sources:
    """The objects by decreasing flux; ties are ordered by position, so that the result does not depend on the
    search."""
    falling = -table["flux"]
    order = np.argsort(falling)
    sorted_flux = falling[order]
    # Ties are rare, and a sort by three keys takes several times as long as one by the flux.
    if (sorted_flux[1:] == sorted_flux[:-1]).any():
        order = np.lexsort((table["x_peak"], table["y_peak"], falling))
    return table.take(order)


def are_long(table: Sources, needed: int, fewest: int, most: int, max_axis_ratio: float) -> bool:
    """Whether `needed` of the `most` brightest objects of at least `fewest` pixels are long, see `form_of`.

    `table` is sorted by decreasing flux.
    """
    whole = ((table["pixels"] >= fewest) & (table["flux"] > 0.0)).nonzero()[0][:most]
    return bool(np.count_nonzero(measure_forms(table.take(whole), max_axis_ratio).long) >= needed)


@kernel
def is_halo(table: Sources) -> Flags:
    """Mask of the pieces of a brighter star's halo or diffraction rings; `table` is sorted by decreasing flux.

    A piece has less than 0.05 of the star's peak. It lies within 2½ radii of the star, or where a ring of an Airy
    pattern can still be that bright: the envelope of the rings at r first dark radii falls as 0.045 / r³, and the first
    dark radius follows from the ratio of the pattern's light to its peak, 1.9 √(flux / (π peak)).
    """
    halo, faintest = np.zeros(len(table), np.bool_), np.inf
    x, y, peaks = np.empty(len(table), np.int64), np.empty(len(table), np.int64), np.empty(len(table))
    for n in range(len(table)):
        x[n], y[n], peaks[n] = table[n]["x_peak"], table[n]["y_peak"], table[n]["peak_residual"]
        faintest = min(faintest, peaks[n])
    for star in range(len(peaks)):
        peak = peaks[star]
        if not peak > HALO_PEAK_RATIO * faintest:  # most objects of a frame are too faint for rings
            continue
        near = HALO_RADII * math.sqrt(table[star]["pixels"] / np.pi) + HALO_MARGIN_PX
        dark_radius = 1.9 * math.sqrt(table[star]["flux"] / (np.pi * peak))
        # The largest distance at which anything of this star can be as bright as the faintest object.
        reach = max(near, dark_radius * (RING_MARGIN * 0.045 * peak / max(faintest, 1e-30)) ** (1.0 / 3.0)) + 1.0
        for n in range(np.uint64(len(peaks))):
            dx, dy = x[n] - x[star], y[n] - y[star]
            if dx * dx + dy * dy > reach * reach:
                continue
            times, distance = peak / peaks[n], math.hypot(dx, dy)
            share = distance / dark_radius
            ring = share * share * share < RING_MARGIN * 0.045 * times
            halo[n] |= times > HALO_PEAK_RATIO and (distance < near or ring)
    return halo
