"""Plate constants in 64-bit integers: centre, roll and attitude of an image (Yee 1999, section 2.4).

Yee's 32 bits are too few for them (section 3.5). The fit is that of `startracker.estimation.plate`: standard
coordinates on the tangent plane at the centre, a least-squares linear map from the image to them, and iteration with
the centre moved to the image of the origin until it converges. It fits into 64 bits because directions are unit vectors
of 2.30, whose products have 60 bits; because each iteration only fits the remaining residuals, so that quotients need
only a few correct bits; and because sums are shifted to 30 bits before they are multiplied. If the stars are nearly
collinear, only a scale and a rotation are fitted (four constants), as in `startracker.estimation.plate_constants`.

The C export (`c/tracker_attitude.c`) performs the same operations in the same order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from startracker.fixed_point.cordic import angles_deg
from startracker.fixed_point.formats import CENTROID, FixedPointOverflow, Integers, divide, integers
from startracker.fixed_point.square_root import square_root
from startracker.fixed_point.vectors import DIRECTION, cross, normalized

MAX_STARS = 16
"""Sums of products would overflow for more."""
_ROUNDS = 40
_SETTLED = 8  # units of 2.30: 0.0015″
_LEAST_ROUNDS = 4
_PIXEL_SHIFT = 6  # centroids of 10.22 to 10.16
_MAP_BITS = 24  # additional fraction bits of the map relative to its product
_SLENDER_SHIFT = 10  # determinant below trace² × 2⁻¹⁰: the shear would be noise
_LEAST_LENGTH = 1 << 10
_NEAREST_DEPTH = DIRECTION.one // 2  # cosine of 60°
_LARGEST_LEFT = 1 << 31  # whose products with 10.16 pixels, sixteen of them, have 62 bits
_LARGEST_MAP = 1 << 32
_NO_PLATE = "the stars fit no plate"


class NotSolved(ArithmeticError):
    """No attitude can be computed from the given stars; the message says why."""


@dataclass(frozen=True)
class IntegerAttitude:
    """Attitude of an image in integers."""

    matrix: Integers
    """Rows, (3, 3): the camera's x (right), y (down) and boresight in the catalogue's axes, of 2.30: v_camera = matrix
    @ v_catalogue."""
    ra: int
    dec: int
    roll: int
    """Of the boresight, degrees of 10.22; roll is the position angle of the image's up direction, east of north."""


def plate_attitude(xy: ArrayLike, directions: ArrayLike) -> IntegerAttitude:
    """Attitude from identified stars.

    Parameters
    ----------
    xy : int array, shape (M, 2)
        Centroids of 10.22 from the image's centre, 3 ≤ M ≤ 16; x right, y **up**.
    directions : int array, shape (M, 3)
        Unit vectors of 2.30 of the stars.

    Raises
    ------
    NotSolved
        Too few or too many stars; coincident stars; stars 60° from the centre; an image that is mirrored or whose shape
        does not match the stars.
    FixedPointOverflow
        Centroids or directions outside their formats.
    """
    image = (CENTROID.check(xy, "centroid") >> _PIXEL_SHIFT) * np.array([1, -1])
    sky = DIRECTION.check(directions, "direction")
    count = len(image)
    if not 3 <= count <= MAX_STARS:
        raise NotSolved(f"plate constants take 3 to {MAX_STARS} stars; got {count}")
    middle = image.sum(axis=0) // count
    image = image - middle
    fit = _Fit(image)
    center = unit(sky.sum(axis=0))
    smallest = int(np.argmin(np.abs(center)))
    plate = np.zeros((2, 2), dtype=np.int64)  # 2.30 per 2⁻¹⁶ pixel, with _MAP_BITS more
    for rounds in range(1, _ROUNDS + 1):
        east, north = _axes(center, smallest)
        left = _standard(sky, east, north, center) - ((image @ plate.T) >> _MAP_BITS)
        if int(np.abs(left).max()) >= _LARGEST_LEFT:
            raise NotSolved(_NO_PLATE)
        mean = left.sum(axis=0) // count
        left = left - mean
        plate += fit.of(left)
        if int(np.abs(plate).max()) >= _LARGEST_MAP:
            raise NotSolved(_NO_PLATE)
        offset = mean - ((plate @ middle) >> _MAP_BITS)
        if int(np.abs(offset).max()) >= DIRECTION.one:
            raise NotSolved(_NO_PLATE)
        if rounds >= _LEAST_ROUNDS and int(np.abs(offset).max()) <= _SETTLED:
            return _attitude(center, east, north, plate)
        center = unit(center + ((int(offset[0]) * east + int(offset[1]) * north) >> 30))
    raise NotSolved(f"the centre does not converge in {_ROUNDS} iterations: check the stars")


class _Fit:
    """Least-squares linear map of the image (M, 2), 10.16 about its mean; four constants for collinear stars."""

    def __init__(self, image: Integers) -> None:
        self.image = image
        x, y = image[:, 0], image[:, 1]
        sums, self.shift = _thirty_bits([int(x @ x), int(x @ y), int(y @ y)])
        self.xx, self.xy, self.yy = sums
        total = self.xx + self.yy
        determinant = self.xx * self.yy - self.xy * self.xy
        self.full = determinant > (total * total) >> _SLENDER_SHIFT
        # determinant × 2⁻³⁰, or the trace: a divisor accurate to at least 16 bits
        self.divisor = determinant >> 30 if self.full else total
        if self.divisor < 1 << 12:
            raise NotSolved("plate constants need stars at different positions")

    def of(self, left: Integers) -> Integers:
        """Map (2, 2) fitted to the residuals (M, 2) of 2.30: 2.30 per 2⁻¹⁶ pixel, with _MAP_BITS more."""
        x, y = self.image[:, 0], self.image[:, 1]
        u, v = left[:, 0], left[:, 1]
        (ux, uy, vx, vy), shift = _thirty_bits([int(u @ x), int(u @ y), int(v @ x), int(v @ y)])
        if self.full:
            power = shift - self.shift + _MAP_BITS - 30
            numerators = (
                self.yy * ux - self.xy * uy,
                self.xx * uy - self.xy * ux,
                self.yy * vx - self.xy * vy,
                self.xx * vy - self.xy * vx,
            )
        else:
            power = shift - self.shift
            along, across = (ux + vy) << _MAP_BITS, (vx - uy) << _MAP_BITS
            numerators = (along, -across, across, along)
        return np.array([_shifted(int(divide(n, self.divisor)), power) for n in numerators]).reshape(2, 2)


def unit(vector: ArrayLike) -> Integers:
    """Unit vector of 2.30 of a vector with components below 2³⁶ in magnitude.

    Raises
    ------
    FixedPointOverflow
        If a component is larger.
    NotSolved
        If the vector is too short.
    """
    v = integers(vector)
    largest = int(np.abs(v).max())
    if largest >= 1 << 36:
        raise FixedPointOverflow("length of a vector", largest, "36 bits")
    found = normalized(v, _LEAST_LENGTH)
    if found is None:
        raise NotSolved("the directions cancel, so that their mean is undefined")
    return found


def _axes(center: Integers, smallest: int) -> tuple[Integers, Integers]:
    """Two axes perpendicular to a direction, right-handed with it; the first is close to the coordinate axis
    `smallest`."""
    first = -((int(center[smallest]) * center) >> 30)
    first[smallest] += DIRECTION.one
    first = unit(first)
    return first, cross(center, first)


def _standard(sky: Integers, east: Integers, north: Integers, center: Integers) -> Integers:
    """Gnomonic coordinates (M, 2) of 2.30: products of 60 bits divided by the depth of 30."""
    depth = (sky @ center) >> 30
    if int(depth.min()) < _NEAREST_DEPTH:
        raise NotSolved("plate constants need stars less than 60° from the centre of the image")
    return np.column_stack([divide(sky @ east, depth), divide(sky @ north, depth)])


def _attitude(center: Integers, east: Integers, north: Integers, plate: Integers) -> IntegerAttitude:
    """Attitude from the rotation closest to the plate's map."""
    turning = int(plate[0, 0]) * (int(plate[1, 1]) >> 4) - int(plate[0, 1]) * (int(plate[1, 0]) >> 4)
    if turning <= 0:
        raise NotSolved("the image is mirrored, or its shape does not match the stars")
    reach, swing = int(plate[0, 0] + plate[1, 1]), int(plate[1, 0] - plate[0, 1])
    cosine, sine, _ = unit(_long(np.array([reach, swing, 0])))
    matrix = np.vstack([(cosine * east + sine * north) >> 30, (cosine * north - sine * east) >> 30, center])
    return IntegerAttitude(matrix, *matrix_angles(matrix))


def matrix_angles(matrix: Integers) -> tuple[int, int, int]:
    """Right ascension and declination of the boresight and roll, degrees of 10.22, of a matrix of 2.30."""
    up = [-int(c) for c in matrix[1]]
    cx, cy, cz = (int(c) for c in matrix[2])
    level = int(square_root(cx * cx + cy * cy))
    to_east = (cx * up[1] - cy * up[0]) >> 30
    to_north = (up[2] * level >> 30) * level - ((cx * up[0] + cy * up[1]) >> 30) * cz >> 30
    ra, dec, roll = (int(a) for a in angles_deg([cy, cz, to_east], [cx, level, to_north]))
    return ra, dec - (360 << 22 if dec > 180 << 22 else 0), roll


def _long(vector: Integers) -> Integers:
    """A vector of less than 34 bits, shifted left to 30 bits, so that the direction of short vectors is preserved."""
    while 0 < int(np.abs(vector).max()) < 1 << 30:
        vector = vector * 2
    return vector


def _thirty_bits(sums: list[int]) -> tuple[list[int], int]:
    """Integers shifted right by a common amount until all are below 2³⁰ in magnitude, and that amount."""
    shift, largest = 0, max(abs(s) for s in sums)
    while largest >= 1 << 30:
        largest, shift = largest >> 1, shift + 1
    return [s >> shift for s in sums], shift


def _shifted(value: int, power: int) -> int:
    """value × 2^power, rounded down; a value too large for a plate's map is rejected before it overflows."""
    if power <= 0:
        return value >> -power
    if abs(value) >> max(33 - power, 0):
        raise NotSolved(_NO_PLATE)
    return value << power
