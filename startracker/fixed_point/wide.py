"""The triad pipeline's arithmetic in 64-bit integers, as Yee 1999 recommends (section 5.2): no tables, exact geometry.

Separations and angles of 10.22, centroids of 22.22, directions of 2.30. What her 16 bits must look up or call plane is
computed on the sphere: arctangents by rotations (`cordic`) of vectors that products of 62 bits make. Separations are
good to 0.001″, so that stars are matched within their centroids' errors instead of within tenths of a degree.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from startracker.fixed_point.arithmetic import FixedArithmetic, inner_angles, vector_separations
from startracker.fixed_point.cordic import DEGREES, FINE_BITS, fine_angles
from startracker.fixed_point.formats import Format, Integers, check_product, divide, integers
from startracker.fixed_point.square_root import square_root
from startracker.fixed_point.vectors import DIRECTION

__all__ = ["WIDE_CENTROID", "WideArithmetic", "WideImage", "WideSky"]

WIDE_CENTROID = Format(22, 22)
"""Pixels, of any detector."""
_SCALE = Format(4, 38)
"""Radians a pixel."""
_LENGTH_SHIFT = 3


@dataclass(frozen=True, eq=False)
class WideImage:
    """Image stars: centroids (N, 2) of 22.22 and their directions (N, 3) of 2.30, x right, y up."""

    xy: Integers
    directions: Integers


@dataclass(frozen=True, eq=False)
class WideSky:
    """Catalogue stars: directions (G, 3) of 2.30."""

    directions: Integers


@dataclass(frozen=True)
class WideArithmetic(FixedArithmetic):
    """As `FloatArithmetic(exact=True)` of `startracker.identification.arithmetic`, in integers.

    Its methods take the stars that its own `image` and `sky` make, not those of 16 bits: hence the "own stars" below.
    """

    @property
    def separation_format(self) -> Format:
        """10.22."""
        return DEGREES

    @property
    def angle_format(self) -> Format:
        """10.22."""
        return DEGREES

    def image(self, xy_px: ArrayLike, scale_deg: ArrayLike) -> WideImage:  # type: ignore[override]  # own stars
        """Centroids truncated to 22.22; pixels are those of a tangent plane.

        Raises
        ------
        FixedPointOverflow
            A star about 83° or more from the boresight.
        """
        xy = WIDE_CENTROID.encode(xy_px).reshape(-1, 2)
        scale = _SCALE.encode(np.radians(scale_deg), rounded=True)
        check_product(xy, scale, "tangent of an angle from the boresight")  # of 4.60
        fraction = WIDE_CENTROID.fraction_bits + _SCALE.fraction_bits - DIRECTION.fraction_bits
        plane = np.empty((len(xy), 3), dtype=np.int64)
        plane[:, :2] = (xy * scale) >> fraction
        plane[:, 2] = DIRECTION.one
        short = plane >> _LENGTH_SHIFT
        length = square_root((short * short).sum(axis=1))
        return WideImage(xy, divide(plane << (DIRECTION.fraction_bits - _LENGTH_SHIFT), length[:, None]))

    def sky(self, ra_deg: ArrayLike, dec_deg: ArrayLike, max_separation_deg: float) -> WideSky:  # type: ignore[override]  # own stars
        """Directions rounded to 2.30."""
        a, d = np.radians(ra_deg), np.radians(dec_deg)
        directions = np.column_stack([np.cos(d) * np.cos(a), np.cos(d) * np.sin(a), np.sin(d)])
        return WideSky(DIRECTION.encode(directions, rounded=True))

    def image_separations(self, image: WideImage, i: ArrayLike, j: ArrayLike) -> Integers:  # type: ignore[override]  # own stars
        """Between the stars' directions (eq. D.1)."""
        return vector_separations(image.directions[integers(i)], image.directions[integers(j)], DEGREES)

    def image_directions(self, image: WideImage, i: ArrayLike, j: ArrayLike) -> Integers:  # type: ignore[override]  # own stars
        """Arctangent of the step in pixels."""
        step = image.xy[integers(j)] - image.xy[integers(i)]
        return _angles(step[..., 1], step[..., 0])

    def catalog_directions(self, sky: WideSky, i: ArrayLike, j: ArrayLike) -> Integers:  # type: ignore[override]  # own stars
        """As great circles leave star i, by components along its parallel and its meridian."""
        a, b = sky.directions[integers(i)], sky.directions[integers(j)]
        step = b - a
        east = (a[..., 0] * step[..., 1] - a[..., 1] * step[..., 0]) >> 30
        along = (a * step).sum(axis=-1) >> 30
        north = step[..., 2] - ((a[..., 2] * along) >> 30)
        return _angles(north, -east)

    def image_enclosed(  # type: ignore[override]  # own stars
        self, image: WideImage, i: ArrayLike, j: ArrayLike, k: ArrayLike
    ) -> tuple[Integers, Integers, Integers]:
        """On the sphere."""
        a, b, c = (image.directions[integers(index)] for index in (i, j, k))
        return inner_angles(a, b, c, DEGREES)


def _angles(y: Integers, x: Integers) -> Integers:
    """Arctangents in [0°, 360°), of 10.22."""
    fine = fine_angles(y, x)
    return np.asarray((fine >> (FINE_BITS - DEGREES.fraction_bits)) % (360 * DEGREES.one))
