"""What callers give, made fit for identification: directions of centroids, and a prior attitude."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from startracker.attitude import Attitude
from startracker.errors import InputError
from startracker.identification.observed import Prior
from startracker.image_map import ImageMap, to_directions
from startracker.interop import is_rotation, is_skycoord, plain
from startracker.kernels import kernel

__all__ = ["WORST_PX", "as_prior", "usable_directions"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

WORST_PX = 5.0
"""A centroid with a larger error says nothing worth knowing."""
_AXES = math.sqrt(3.0)


@kernel
def usable_directions(
    xy: FloatArray, stated_px: FloatArray, pixel_rad: float, image: ImageMap
) -> tuple[FloatArray, IntArray, FloatArray, FloatArray]:
    """Directions (N, 3) of centroids, those that are of use (M,), and directions and standard errors, rad, of these."""
    directions = to_directions(xy, image)
    usable, sigma, count = np.empty(len(xy), np.int64), np.empty(len(xy)), 0
    chosen = np.empty_like(directions)
    for n in range(len(xy)):
        # beyond the lens model's fold there are no directions, NaN on all axes
        if math.isfinite(directions[n, 2]) and stated_px[n] < WORST_PX:
            usable[count], sigma[count] = n, stated_px[n] * pixel_rad
            for axis in range(3):
                chosen[count, axis] = directions[n, axis]
            count += 1
    return directions, usable[:count], chosen[:count], sigma[:count]


def as_prior(attitude: object, prior_deg: float) -> Prior | None:
    """Prior of an attitude that is off by `prior_deg` degrees about each axis at most; None where there is none.

    Raises
    ------
    InputError
        For anything but an `Attitude` or a SciPy ``Rotation`` (ICRS to camera), or an angle that is not positive.
    """
    if attitude is None:
        return None
    if is_rotation(attitude):
        attitude = Attitude.from_rotation(attitude)
    if is_skycoord(attitude):
        raise InputError("a SkyCoord has no roll; give prior=Attitude.from_skycoord(coordinate, roll_deg)")
    if not isinstance(attitude, Attitude):
        made = "Attitude.from_matrix, from_radec_roll or from_rotation_vector make one"
        raise InputError(f"a prior must be an Attitude ({made}); got {type(attitude).__name__}")
    prior_deg = plain(prior_deg, "deg", "prior_deg")
    try:
        fits = math.isfinite(prior_deg) and prior_deg > 0
    except TypeError:
        fits = False
    if not fits:
        raise InputError(f"prior_deg must be a positive angle in degrees; got {prior_deg!r}")
    # at the limit about all three axes at once
    return Prior(attitude, min(math.radians(prior_deg) * _AXES, math.pi))
