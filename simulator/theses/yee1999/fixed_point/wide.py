"""The triad pipeline in 64-bit integers, as recommended by Yee 1999 (section 5.2): exact geometry without tables.

Formats: separations and angles 10.22, centroids 22.22, directions 2.30. What the 16-bit version looks up in tables or
approximates by plane geometry is computed on the sphere: arctangents by CORDIC (`cordic`), with products of 62 bits.
Separations are accurate to 0.001″, so that stars are matched within their centroid errors instead of tenths of a
degree.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from simulator.theses.yee1999.fixed_point.arithmetic import FixedArithmetic, inner_angles, vector_separations
from simulator.theses.yee1999.fixed_point.cordic import DEGREES, fine_angles
from simulator.theses.yee1999.fixed_point.formats import DIRECTION, Format, check_product, divide, integers
from simulator.theses.yee1999.fixed_point.square_root import square_root
from startracker.flight.integers import FINE_BITS, Integers

WIDE_CENTROID = Format(22, 22)
"""Pixels, of a detector of any size."""
_SCALE = Format(4, 38)
"""Radians per pixel."""
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

    Its methods take the types returned by its own `image` and `sky`, not the 16-bit ones: hence "own stars" below.
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
        """Centroids truncated to 22.22, on the tangent plane.

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
        """Angles between the directions of the stars (eq. D.1)."""
        return vector_separations(image.directions[integers(i)], image.directions[integers(j)], DEGREES)

    def image_directions(self, image: WideImage, i: ArrayLike, j: ArrayLike) -> Integers:  # type: ignore[override]  # own stars
        """Arctangent of the difference in pixels."""
        step = image.xy[integers(j)] - image.xy[integers(i)]
        return _angles(step[..., 1], step[..., 0])

    def catalog_directions(self, sky: WideSky, i: ArrayLike, j: ArrayLike) -> Integers:  # type: ignore[override]  # own stars
        """Direction of the great circle at star i, from its components along the parallel and the meridian."""
        a, b = sky.directions[integers(i)], sky.directions[integers(j)]
        step = b - a
        east = (a[..., 0] * step[..., 1] - a[..., 1] * step[..., 0]) >> 30
        along = (a * step).sum(axis=-1) >> 30
        north = step[..., 2] - ((a[..., 2] * along) >> 30)
        return _angles(north, -east)

    def image_enclosed(  # type: ignore[override]  # own stars
        self, image: WideImage, i: ArrayLike, j: ArrayLike, k: ArrayLike
    ) -> tuple[Integers, Integers, Integers]:
        """Angles on the sphere."""
        a, b, c = (image.directions[integers(index)] for index in (i, j, k))
        return inner_angles(a, b, c, DEGREES)


def _angles(y: Integers, x: Integers) -> Integers:
    """Arctangents in [0°, 360°), of 10.22."""
    fine = fine_angles(y, x)
    return np.asarray((fine >> (FINE_BITS - DEGREES.fraction_bits)) % (360 * DEGREES.one))
