"""Attitude and covariance of a frame from its identified stars, in integers.

The steps are those of `startracker.estimation.refine`: all stars of the list that agree with guide stars of the field
are matched again with the attitude of the identified ones, with gates from the median of the residuals; then the fit of
`pose_fit` estimates the actual errors, and its gates select the stars of the next fit, until they no longer change.
Residuals are measured in pixels of the image, through the derivatives of the grid table.

The C source (`c/tracker_pose.c`) performs the same operations in the same order.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from startracker.core import BoolArray
from startracker.errors import InputError
from startracker.fixed_point.c_table import CTable
from startracker.fixed_point.formats import Integers, divide
from startracker.fixed_point.vectors import DIRECTION
from startracker.flight.apparent import FlightObserver, apparent, guide_motion
from startracker.flight.design import FlightDesign
from startracker.flight.directions import (
    GridTables,
    grid_tables,
    plane_of,
    project,
    quaternion_of,
    slopes_of,
    turned,
)
from startracker.flight.pose_fit import GRID, Fit, FitPriors, Stars, fit, fit_priors, median
from startracker.flight.real import ONE, Real
from startracker.flight.stars import StarList

POSE_MODULES = ("integers", "arithmetic", "linear", "directions", "pose_fit", "pose")
COVARIANCE_BITS = 60
"""Fraction bits of the covariance, square radians."""
_MATCH_ROUNDS, _FIT_ROUNDS = 6, 4
_FEWEST_TO_REJECT = 4
_UNKNOWN_PX = 0.15
"""Standard error of a star of unknown error."""
_MARGIN_PX, _MARGIN_RAD = 3.0, 2.5e-4
"""Guide stars up to this far outside the image may have a centroid on it; plus aberration."""
_MANY, _LEAST_SCALE2 = 10, 41
_GATE2 = 3505  # 3.7², 8 fraction bits
_FREEDOM = 1477  # 1/(2 ln 2), the squared median of a Rayleigh distribution, of 11 fraction bits
_NEAR = 1 << 20  # 16 px
_LARGEST_COVARIANCE = 1 << COVARIANCE_BITS  # a square radian
_LARGEST_RESIDUAL, _LARGEST_COLUMN, _LARGEST_VARIANCE = (1 << 19) - 1, (1 << 16) - 1, 1 << 42
_LEAST_DETERMINANT = 1 << 31  # 1/2
_LARGEST_UNKNOWN = 1 << 27  # of 2.30: 0.125
_LARGEST_SQUARE, _LARGEST_POSITION = 1 << 40, (1 << 31) - 1
_MOST_FIELD = 250


class PoseTables(NamedTuple):
    """Guide stars and constants of one camera."""

    guide: Integers
    """Directions of 2.30, brightest first, (G, 3)."""
    motion: Integers
    """Proper motions a year, unit vectors of 29 fraction bits, (G, 3)."""
    grid: GridTables
    priors: FitPriors
    radius_bits: int
    """The unit of rotations about the boresight and of the camera's unknowns: they move a star at 2^`radius_bits`
    pixels from the principal point by one pixel."""
    centre: Integers
    """Principal point, pixels of 16 fraction bits, (2,)."""
    floor: int
    unknown: int
    """Variances of the catalogue, and of a star of unknown error, square pixels of 36 fraction bits."""
    margin: int
    """Width of the border around the image, pixels of 16 fraction bits."""
    most_field: int
    """Largest number of guide stars that are compared with the stars, the brightest of the field."""


class Pose(NamedTuple):
    """Attitude of one frame.

    Parameters
    ----------
    matrix : int array, shape (3, 3)
        ICRS to camera, 2.30.
    quaternion : int array, shape (4,)
        The same, scalar last, 2.30.
    covariance : int array, shape (3, 3)
        Of the rotation vector in camera axes, square radians of 60 fraction bits.
    guide : int array, shape (N,)
        Guide star of each star that the attitude was fitted to; −1: not used.
    """

    matrix: Integers
    quaternion: Integers
    covariance: Integers
    guide: Integers


def pose_tables(design: FlightDesign) -> PoseTables:
    """Tables of a design.

    Raises
    ------
    InputError
        For a camera with a rolling shutter, or one that `grid_tables` refuses.
    """
    camera, guide = design.camera, design.guide
    if camera.row_time_s:
        raise InputError("a flight build takes cameras with a global shutter; this one exposes its rows in turn")
    grid = grid_tables(design)
    _check_slopes(grid)
    radius_bits = math.ceil(math.log2(0.5 * math.hypot(camera.width, camera.height)))
    share = (1.0 - math.cos(camera.half_diagonal_rad)) / 2.0
    one = float(1 << 36)
    return PoseTables(
        DIRECTION.encode(guide.directions, rounded=True),
        guide_motion(guide),
        grid,
        fit_priors(float(1 << radius_bits)),
        radius_bits,
        np.rint(np.array([camera.cx, camera.cy]) * 65536.0).astype(np.int64),
        round((guide.catalog.position_sigma_rad / camera.pixel_rad) ** 2 * one),
        round(_UNKNOWN_PX**2 * one),
        round((_MARGIN_PX + _MARGIN_RAD * camera.fx) * 65536.0),
        min(max(60, round(2.5 * share * len(guide)) + 30), _MOST_FIELD),
    )


def _check_slopes(grid: GridTables) -> None:
    x, y = (np.linspace(0.0, n - 1.0, 20) * 65536.0 for n in grid.size)
    slopes = slopes_of(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2).astype(np.int64), grid)
    if np.linalg.det(slopes / 65536.0).min() < 0.55:
        raise InputError(
            "a flight build takes lenses that magnify the edge of the field less than 1.8 times in area over the "
            "centre, and nearly square pixels; use another lens model"
        )


def pose_constants(t: PoseTables) -> dict[str, int]:
    """Macros of the exported tables, without those of the grid."""
    return {
        "POSE_GUIDES": len(t.guide),
        "POSE_GRID": GRID,
        "POSE_RADIUS_BITS": t.radius_bits,
        "POSE_CENTRE_X": int(t.centre[0]),
        "POSE_CENTRE_Y": int(t.centre[1]),
        "POSE_FLOOR": t.floor,
        "POSE_UNKNOWN": t.unknown,
        "POSE_MARGIN": t.margin,
        "POSE_LEAST_COSINE": _least_cosine(t),
        "POSE_MAX_FIELD": t.most_field,
    }


def _least_cosine(t: PoseTables) -> int:
    """Cosine, 2.30, of the angle from the boresight within which the image and its border are."""
    u, v = (t.grid.half + t.margin).tolist()
    return math.floor(t.grid.focal / math.hypot(t.grid.focal, u, v) * (1 << 30)) - (1 << 10)


def pose_arrays(t: PoseTables) -> list[CTable]:
    """Arrays of the exported tables, without those of the grid and the guide stars."""
    return [
        CTable(
            "int64_t", "pose_information", "priors of focal length and shears, 24 fraction bits", t.priors.information
        ),
        CTable("int32_t", "pose_model", "log2 of the prior of each model, 24 fraction bits", t.priors.model),
        CTable("int32_t", "pose_systematic", "log2 of the prior of each systematic error", t.priors.systematic),
    ]


def solve_pose(
    stars: StarList, guide: Integers, start: Integers, observer: FlightObserver, t: PoseTables
) -> Pose | None:
    """Attitude of identified stars, and of all others that agree.

    Parameters
    ----------
    stars : StarList
        The N stars of the frame.
    guide : int array, shape (N,)
        Guide star with which each is identified, −1 for none.
    start : int array, shape (3, 3)
        Attitude of the identification, 2.30, right to about eight pixels.
    observer : FlightObserver
    t : PoseTables

    Returns
    -------
    Pose, or None if fewer than two stars are identified or they determine no attitude to a radian.
    """
    seen = _Seen(stars, t)
    numbers, directions = _field(start, observer, t)
    position = np.full(len(t.guide), -1)
    position[numbers] = np.arange(len(numbers))
    used = np.where((guide >= 0) & seen.usable, position[guide], -1)
    count = int((used >= 0).sum())
    if count < 2:
        return None
    fewest = min(count, _FEWEST_TO_REJECT)
    matched = _matched_again(seen, used, directions, start, fewest, t)
    if matched is None:
        return None
    matrix, used = matched
    found, last = None, used
    for _ in range(_FIT_ROUNDS):
        found = fit(_linearised(seen, used, project(matrix, directions, t.grid)[0], seen.variance, t), t.priors, False)
        after = None if found is None else _stepped(matrix, found, t)
        if found is None or after is None:
            return None
        matrix, last = after, used
        factor = min(max(found.factor.integer(12), 1), 1 << 20)
        systematic = min(found.systematic.integer(36), _LARGEST_VARIANCE)
        variance = ((seen.variance * factor) >> 12) + systematic + 1
        corrected = np.clip(seen.plane - seen.displacement(found, t), -_LARGEST_POSITION, _LARGEST_POSITION)
        index, _ = _nearest(seen, corrected, *project(matrix, directions, t.grid), variance, _GATE2)
        if (index >= 0).sum() < fewest or np.array_equal(index, used):
            break
        used = index
    assert found is not None
    covariance = _covariance(found, t)
    if max(np.diag(covariance)) >= _LARGEST_COVARIANCE:
        return None
    return Pose(matrix, quaternion_of(matrix), covariance, np.where(last >= 0, numbers[last], -1))


class _Seen:
    """Stars of a frame: positions (N, 2) in the tangent plane, 16 fraction bits; derivatives of these (N, 2, 2), and
    their inverse; positions from the principal point (N, 2); variances (N,) of 36 fraction bits; which can be used."""

    def __init__(self, stars: StarList, t: PoseTables) -> None:
        xy = np.column_stack([stars.x, stars.y])
        self.plane, inside = plane_of(xy, t.grid)
        self.plane[~inside] = 0
        self.slopes = slopes_of(np.where(inside[:, None], xy, t.centre), t.grid)
        a, b, c, d = self.slopes.reshape(-1, 4).T
        determinant = a * d - b * c
        self.usable: BoolArray = inside & (determinant >= _LEAST_DETERMINANT)
        adjugate = np.stack([d, -b, -c, a], axis=1) << 32
        self.inverse = divide(adjugate, np.where(self.usable, determinant, 1)[:, None]).reshape(-1, 2, 2)
        self.offset = xy - t.centre
        own = np.where(stars.variance > 0, stars.variance << 10, t.unknown)
        self.variance = np.minimum(own + t.floor, _LARGEST_VARIANCE)

    def displacement(self, found: Fit, t: PoseTables) -> Integers:
        """Displacement (N, 2) in the tangent plane by the camera's unknowns, 16 fraction bits."""
        unknowns = [found.step[k].scaled(-t.radius_bits).integer(30) for k in range(3, 6)]
        focal, one, two = (min(max(value, -_LARGEST_UNKNOWN), _LARGEST_UNKNOWN) for value in unknowns)
        x, y = self.offset.T
        moved = np.stack([((focal + one) * x + two * y) >> 30, (two * x + (focal - one) * y) >> 30], axis=1)
        return np.asarray((self.slopes * moved[:, None, :]).sum(axis=2) >> 16)


def _field(matrix: Integers, observer: FlightObserver, t: PoseTables) -> tuple[Integers, Integers]:
    """Guide stars on the image or its border (K,), the brightest, and their apparent directions (K, 3)."""
    plane, ahead = project(matrix, t.guide, t.grid)
    on_image = ahead & (np.abs(plane[:, 0]) <= t.grid.half[0] + t.margin)
    numbers = np.flatnonzero(on_image & (np.abs(plane[:, 1]) <= t.grid.half[1] + t.margin))[: t.most_field]
    return numbers, apparent(t.guide[numbers], t.motion[numbers], observer)


def _matched_again(
    seen: _Seen, used: Integers, directions: Integers, matrix: Integers, fewest: int, t: PoseTables
) -> tuple[Integers, Integers] | None:
    """Attitude and guide star of the field (N,) of each star that agrees with the previous ones, iterated until
    unchanged; bright stars are given the median variance, as they show systematic errors first."""
    for _ in range(_MATCH_ROUNDS):
        wide = np.maximum(seen.variance, median(seen.variance[used >= 0].tolist()))
        found = fit(_linearised(seen, used, project(matrix, directions, t.grid)[0], wide, t), t.priors, True)
        after = None if found is None else _stepped(matrix, found, t)
        if after is None:
            return None
        matrix = after
        predicted, ahead = project(matrix, directions, t.grid)
        n = int((used >= 0).sum())
        middle = median(_squares(seen, used, predicted, wide)[used >= 0].tolist())
        scale2 = middle * 2 * n * _FREEDOM // ((2 * n - 3) << 11)
        gate = (max(scale2, _LEAST_SCALE2 if n >= _MANY else 256) * _GATE2) >> 8
        index, _ = _nearest(seen, seen.plane, predicted, ahead, wide, gate)
        if (index >= 0).sum() < fewest or np.array_equal(index, used):
            break
        used = index
    return matrix, used


def _linearised(seen: _Seen, used: Integers, predicted: Integers, variance: Integers, t: PoseTables) -> Stars:
    """Matched stars as the fit takes them, for the predicted positions (K, 2) of the field."""
    star = np.flatnonzero(used >= 0)
    p, inverse, down = predicted[used[star]], seen.inverse[star], t.radius_bits + 2
    a, b = divide(p << 14, t.grid.focal).T
    ab, one = (a * b) >> 14, 1 << 14
    plane = np.empty((len(star), 2, 3), np.int64)
    plane[:, 0] = np.stack([ab, -one - ((a * a) >> 14), p[:, 1] >> down], axis=1)
    plane[:, 1] = np.stack([one + ((b * b) >> 14), -ab, -(p[:, 0] >> down)], axis=1)
    turns = (inverse @ plane) >> 16
    x, y = (seen.offset[star] >> down).T
    camera = np.stack([np.stack([x, x, y], axis=1), np.stack([y, -y, x], axis=1)], axis=1)
    columns = np.clip(np.concatenate([turns, camera], axis=2), -_LARGEST_COLUMN, _LARGEST_COLUMN)
    residual = _in_pixels(inverse, seen.plane[star] - p)
    return Stars(columns, np.clip(residual, -_LARGEST_RESIDUAL, _LARGEST_RESIDUAL), variance[star])


def _in_pixels(inverse: Integers, away: Integers) -> Integers:
    """Differences (M, 2) in the tangent plane, converted to pixels by inverse derivatives (M, 2, 2)."""
    return np.asarray((inverse * away[:, None, :]).sum(axis=2) >> 16)


def _squares(seen: _Seen, index: Integers, predicted: Integers, variance: Integers) -> Integers:
    """Squared distances (N,) of stars from their guide stars over their variances, 8 fraction bits; at most 16 px in
    the tangent plane count."""
    away = np.clip(seen.plane - predicted[index], -_NEAR, _NEAR)
    square = ((_in_pixels(seen.inverse, away) ** 2).sum(axis=1) << 12) // variance
    return np.asarray(np.minimum(square, _LARGEST_SQUARE))


def _nearest(
    seen: _Seen, plane: Integers, predicted: Integers, ahead: BoolArray, variance: Integers, gate: int
) -> tuple[Integers, Integers]:
    """Nearest guide star of the field (K,) of each star (N,) within its gate, one to one, −1 for none; squared distance
    over variance (N,)."""
    index, square = np.full(len(plane), -1), np.zeros(len(plane), np.int64)
    owner = np.full(len(predicted), -1)
    for n in np.flatnonzero(seen.usable):
        away = plane[n] - predicted
        near = np.flatnonzero(ahead & (np.abs(away) <= _NEAR).all(axis=1))
        if not len(near):
            continue
        distance2 = (_in_pixels(seen.inverse[n][None], away[near]) ** 2).sum(axis=1)
        at, best = near[np.argmin(distance2)], (int(distance2.min()) << 12) // int(variance[n])
        square[n] = min(best, _LARGEST_SQUARE)
        if square[n] > gate:
            continue
        rival = owner[at]
        if rival >= 0:
            if square[rival] <= square[n]:
                continue
            index[rival] = -1
        owner[at], index[n] = n, at
    return index, square


def _scales(t: PoseTables) -> list[Real]:
    """Radians of a unit of each component of the rotation."""
    across = ONE / Real(t.grid.focal, -16)
    return [across, across, Real(1, -t.radius_bits)]


def _stepped(matrix: Integers, found: Fit, t: PoseTables) -> Integers | None:
    """Attitude after the step of a fit; None if it is too large."""
    angles = [(found.step[k] * scale).integer(30) for k, scale in enumerate(_scales(t))]
    if max(map(abs, angles)) >= 1 << 27:
        return None
    return turned(matrix, np.array(angles))


def _covariance(found: Fit, t: PoseTables) -> Integers:
    scales, made = _scales(t), np.empty((3, 3), dtype=np.int64)
    for i in range(3):
        for j in range(i + 1):
            made[i, j] = made[j, i] = (found.covariance[i][j] * scales[i] * scales[j]).integer(COVARIANCE_BITS)
    return made
