"""Where guide stars stand on an image, and what displaces them besides the attitude: columns of the fit of `refine`."""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np

from startracker.core import FloatArray, IntArray
from startracker.geometry.image_map import CX, CY, HEIGHT, ImageMap, pixel_slopes, to_pixels
from startracker.geometry.linalg import cross
from startracker.kernels import kernel
from startracker.observer import ABERRATION_SCALE_SIGMA

RATE_SIGMA_RAD_S = math.radians(2.0)
"""Assumed standard deviation of an unknown body rate about each axis."""
EPOCH_SIGMA_YR = 30.0
"""Assumed interval between the catalogue's epoch and a frame of unknown time, years."""


class Displaced(NamedTuple):
    """Displacements of the stars that are always fitted.

    Parameters
    ----------
    rolls : bool
        By the body rate, in the rows of a rolling shutter.
    moves : bool
        By the stars' space motion since the catalogue's epoch, if the time is unknown.
    scales : bool
        By aberration, which changes the scale of the field, if the velocity is unknown.
    """

    rolls: bool
    moves: bool
    scales: bool


EXTRA_SIGMA = {
    Displaced(rolls, moves, scales): np.array(
        [RATE_SIGMA_RAD_S] * 3 * rolls + [EPOCH_SIGMA_YR] * moves + [ABERRATION_SCALE_SIGMA] * scales
    )
    for rolls, moves, scales in itertools.product((False, True), repeat=3)
}
"""Prior standard deviations (E,) of the amplitudes of `seen_stars`."""


@kernel
def seen_stars(
    guides: IntArray,
    matrix: FloatArray,
    directions: FloatArray,
    motion: FloatArray,
    image: ImageMap,
    row_time_s: float,
    displaced: Displaced,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Pixels (M, 2) of guide stars at an attitude (3, 3), the same from the principal point, their derivatives (M, 2,
    3) (`pixel_slopes`), and the displacements (M, 2, E) that are always fitted: by the rotation about each axis between
    the rows' exposures, per year by the space motion (3, G), and by a change of scale."""
    vectors = np.empty((len(guides), 3))
    for n in range(len(guides)):
        guide = guides[n]
        x, y, z = directions[guide, 0], directions[guide, 1], directions[guide, 2]
        for k in range(3):
            vectors[n, k] = matrix[k, 0] * x + matrix[k, 1] * y + matrix[k, 2] * z
    pixels, slopes = to_pixels(vectors, image), pixel_slopes(vectors, image)
    rows, moves, middle = 3 * displaced.rolls, displaced.moves, (image[HEIGHT] - 1.0) / 2.0
    extra, offset = np.zeros((len(guides), 2, rows + moves + displaced.scales)), np.empty_like(pixels)
    for n in range(len(guides)):
        offset[n, 0], offset[n, 1] = pixels[n, 0] - image[CX], pixels[n, 1] - image[CY]
        guide, row_s = guides[n], (pixels[n, 1] - middle) * row_time_s
        # θ = motion × v, with −θ × v = motion, for motion across v
        x, y, z = cross(motion[:, guide], directions[guide])
        for k in range(3):
            turn = matrix[k, 0] * x + matrix[k, 1] * y + matrix[k, 2] * z
            for axis in range(2):
                if rows > 0:
                    extra[n, axis, k] = slopes[n, axis, k] * row_s
                if moves:
                    extra[n, axis, rows] += slopes[n, axis, k] * turn
        for axis in range(2 if displaced.scales else 0):
            extra[n, axis, rows + moves] = offset[n, axis]
    return pixels, offset, slopes, extra
