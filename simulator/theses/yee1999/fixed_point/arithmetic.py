"""Integer arithmetic of the triad pipeline (Yee 1999, chapter 3): the `Arithmetic` of `startracker.identification`.

Formats: centroids and coordinates 10.22, degrees per pixel 12.20, separations 6.10, angles 10.6, directions 2.30. Words
have 16 or 32 bits and products 64. Real numbers are only accepted by `image`, `sky`, `separation_of` and `angle_of` and
only returned by `separation_degrees` and `angle_degrees`. A quantity that does not fit its format raises
`FixedPointOverflow`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulator.theses.yee1999.fixed_point.cordic import DEGREES, fine_angles
from simulator.theses.yee1999.fixed_point.formats import (
    ANGLE,
    CENTROID,
    COSINE,
    DIRECTION,
    SEPARATION,
    Format,
    check_product,
    integers,
)
from simulator.theses.yee1999.fixed_point.square_root import separation, square_root
from simulator.theses.yee1999.fixed_point.tables import quadrant_table
from startracker.flight.integers import FINE_BITS, Integers

SCALE = Format(12, 20)
"""Degrees per pixel: with 20 fraction bits eight of the ten separations of Table 4.17 are exact to the last bit."""
FULL_TURN = 360 * ANGLE.one
_ANGLE_BITS, _COSINE_BITS = ANGLE.fraction_bits, COSINE.fraction_bits
_VECTOR_SHIFT = 8  # vectors of 10.22 to 10.14, whose squares fit


@dataclass(frozen=True, eq=False)
class FixedImage:
    """Image stars in integers."""

    xy: Integers
    """Centroids of 10.22, x right, y up, from the image's centre, (N, 2)."""
    scale_deg: Integers
    """Degrees per pixel of 12.20, (2,)."""


@dataclass(frozen=True, eq=False)
class FixedSky:
    """Catalogue stars in integers."""

    ra: Integers
    dec: Integers
    """Degrees of 10.22, (G,)."""
    directions: Integers
    """Unit vectors of 2.30, (G, 3)."""


@dataclass(frozen=True)
class FixedArithmetic:
    """Two's complement integers; `startracker.identification.arithmetic.FloatArithmetic` documents each method."""

    @property
    def separation_format(self) -> Format:
        """6.10."""
        return SEPARATION

    @property
    def angle_format(self) -> Format:
        """10.6."""
        return ANGLE

    @property
    def full_turn(self) -> int:
        """360° in the format of angles."""
        return 360 * self.angle_format.one

    # ------------------------------------------------------------------ input: real numbers to integers
    def image(self, xy_px: ArrayLike, scale_deg: ArrayLike) -> FixedImage:
        """Centroids truncated to 10.22 and scales to 12.20; integer arrays must already have these formats."""
        return FixedImage(_entered(CENTROID, xy_px, "centroid").reshape(-1, 2), _entered(SCALE, scale_deg, "scale"))

    def sky(self, ra_deg: ArrayLike, dec_deg: ArrayLike, max_separation_deg: float) -> FixedSky:
        """Coordinates truncated to 10.22, directions rounded to 2.30.

        Raises
        ------
        FixedPointOverflow
            If the maximum separation is 32° or more.
        """
        SEPARATION.encode(max_separation_deg)
        ra, dec = np.asarray(ra_deg, dtype=np.float64), np.asarray(dec_deg, dtype=np.float64)
        a, d = np.radians(ra), np.radians(dec)
        directions = np.column_stack([np.cos(d) * np.cos(a), np.cos(d) * np.sin(a), np.sin(d)])
        return FixedSky(DEGREES.encode(ra), DEGREES.encode(dec), DIRECTION.encode(directions, rounded=True))

    def separation_of(self, degrees: float) -> int:
        """Truncated."""
        return int(self.separation_format.encode(degrees))

    def angle_of(self, degrees: float) -> int:
        """Truncated."""
        return int(self.angle_format.encode(degrees))

    # ------------------------------------------------------------------ separations
    def image_separations(self, image: FixedImage, i: ArrayLike, j: ArrayLike) -> Integers:
        """By Pythagoras' theorem up to 11.65°, by the tables beyond (section 3.4)."""
        step = np.abs(image.xy[integers(i)] - image.xy[integers(j)])
        check_product(step, image.scale_deg, "pixels times degrees per pixel")
        fraction = CENTROID.fraction_bits + SCALE.fraction_bits - SEPARATION.fraction_bits
        along = SEPARATION.check((step * image.scale_deg) >> fraction, "separation along an axis")
        return separation(along[..., 0], along[..., 1])

    def catalog_separations(self, sky: FixedSky, i: ArrayLike, j: ArrayLike) -> Integers:
        """See `vector_separations`. Up to 180°, as any two stars may be compared, therefore in 32 bits."""
        return vector_separations(sky.directions[integers(i)], sky.directions[integers(j)], self.separation_format)

    # ------------------------------------------------------------------ rotation angles
    def image_directions(self, image: FixedImage, i: ArrayLike, j: ArrayLike) -> Integers:
        """From the table of arccosines (section 3.3.2)."""
        step = image.xy[integers(j)] - image.xy[integers(i)]
        return _direction(step[..., 1], step[..., 0])

    def catalog_directions(self, sky: FixedSky, i: ArrayLike, j: ArrayLike) -> Integers:
        """The same for (−Δα, Δδ), Δα within ±180°."""
        first, second = integers(i), integers(j)
        half, whole = 180 * DEGREES.one, 360 * DEGREES.one
        east = (sky.ra[second] - sky.ra[first] + half) % whole - half
        return _direction(sky.dec[second] - sky.dec[first], -east)

    def rotations(self, catalog: ArrayLike, image: ArrayLike) -> Integers:
        """Catalogue minus image, modulo 360°."""
        return (integers(catalog) - integers(image)) % self.full_turn

    def mean_rotations(self, first: ArrayLike, second: ArrayLike) -> Integers:
        """Midpoint of the shorter arc, rounded down."""
        return (integers(first) + (self._between(second, first) >> 1)) % self.full_turn

    # ------------------------------------------------------------------ enclosed angles
    def image_enclosed(
        self, image: FixedImage, i: ArrayLike, j: ArrayLike, k: ArrayLike
    ) -> tuple[Integers, Integers, Integers]:
        """Differences of the directions of the sides."""
        ij, ik, jk = (self.image_directions(image, *pair) for pair in ((i, j), (i, k), (j, k)))
        half = self.full_turn // 2
        at_i, at_k = np.abs(self._between(ij, ik)), np.abs(self._between(ik, jk))
        return at_i, np.abs(self._between(ij + half, jk)), at_k

    def catalog_enclosed(
        self, sky: FixedSky, i: ArrayLike, j: ArrayLike, k: ArrayLike
    ) -> tuple[Integers, Integers, Integers]:
        """Angles of the spherical triangle, truncated to 10.6: the entries of the enclosed-angle table (Table 3.2)."""
        a, b, c = (sky.directions[integers(index)] for index in (i, j, k))
        return inner_angles(a, b, c, self.angle_format)

    # ------------------------------------------------------------------ comparisons and means
    def separations_agree(self, first: ArrayLike, second: ArrayLike, tolerance: Any) -> NDArray[np.bool_]:
        """|first − second| within the tolerance."""
        return np.asarray(np.abs(integers(first) - integers(second)) <= integers(tolerance))

    def angles_agree(self, first: ArrayLike, second: ArrayLike, tolerance: Any) -> NDArray[np.bool_]:
        """The same for angles, along the shorter arc."""
        return np.asarray(np.abs(self._between(first, second)) <= integers(tolerance))

    def group_mean(self, origin: Any, total: Any, count: int) -> int:
        """Running mean; the quotient is rounded down."""
        return (int(integers(origin)) + int(integers(total)) // int(count)) % self.full_turn

    # ------------------------------------------------------------------ output: integers to real numbers
    def separation_degrees(self, separations: ArrayLike) -> NDArray[np.float64]:
        """As real numbers."""
        return self.separation_format.decode(separations)

    def angle_degrees(self, angles: ArrayLike) -> NDArray[np.float64]:
        """As real numbers."""
        return self.angle_format.decode(angles)

    def _between(self, first: ArrayLike, second: ArrayLike) -> Integers:
        """Angle first − second in [−180°, 180°)."""
        half = self.full_turn // 2
        return np.asarray((integers(first) - integers(second) + half) % self.full_turn - half)


def _entered(format: Format, value: ArrayLike, what: str) -> Integers:
    array = np.asarray(value)
    return format.check(array, what) if array.dtype.kind in "iu" else format.encode(array)


def _direction(y: Integers, x: Integers) -> Integers:
    """Angles of 10.6 in [0°, 360°) of vectors (Δx, Δy) of 10.22, from the arccosine table of the first quadrant.

    The table is entered with the smaller component over the length, where its resolution is fine; 0 for a zero vector.
    """
    right, along, across = 90 << _ANGLE_BITS, np.abs(x) >> _VECTOR_SHIFT, np.abs(y) >> _VECTOR_SHIFT
    length = square_root(along * along + across * across)
    angle = quadrant_table()[(np.minimum(along, across) << _COSINE_BITS) // np.maximum(length, 1)]
    angle = np.where(along >= across, right - angle, angle)
    angle = np.where(length > 0, angle, 0)
    angle = np.where(x < 0, 2 * right - angle, angle)
    return np.asarray(np.where(y < 0, 4 * right - angle, angle) % (4 * right))


def vector_separations(a: Integers, b: Integers, format: Format) -> Integers:
    """Angles between directions (..., 3) of 2.30: twice the arctangent of |a − b| / |a + b|, truncated."""
    half = fine_angles(_length(a - b), _length(a + b))
    return np.asarray(half >> (FINE_BITS - 1 - format.fraction_bits))


def inner_angles(a: Integers, b: Integers, c: Integers, format: Format) -> tuple[Integers, Integers, Integers]:
    """Inner angles (...) at a, b and c of spherical triangles of directions (..., 3) of 2.30, truncated."""
    return _angle_at(a, b, c, format), _angle_at(b, a, c, format), _angle_at(c, a, b, format)


def _length(vector: Integers) -> Integers:
    """Lengths of vectors (..., 3) of 2.30, of 2.29."""
    half = vector >> 1
    return square_root((half * half).sum(axis=-1))


def _angle_at(vertex: Integers, first: Integers, second: Integers, format: Format) -> Integers:
    """Angle (...) at a vertex (..., 3) between two directions; 0 where one of them equals the vertex.

    tan A = v · (u × w) / (u · w − (u · v)(w · v)), with the differences u and w from the vertex, which are exact for
    close stars.
    """
    u, w = first - vertex, second - vertex
    cross = np.stack([_determinant(u, w, 1, 2), _determinant(u, w, 2, 0), _determinant(u, w, 0, 1)], axis=-1)
    sine = np.abs((cross * vertex).sum(axis=-1) >> 30)
    along_u, along_w = (u * vertex).sum(axis=-1) >> 30, (w * vertex).sum(axis=-1) >> 30
    cosine = ((u * w).sum(axis=-1) >> 30) - ((along_u * along_w) >> 30)
    return format.check(fine_angles(sine, cosine) >> (FINE_BITS - format.fraction_bits), "enclosed angle")


def _determinant(u: Integers, w: Integers, p: int, q: int) -> Integers:
    return (u[..., p] * w[..., q] - u[..., q] * w[..., p]) >> 30
