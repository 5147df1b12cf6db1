"""Input and output of identification: observed stars, a prior attitude, and the pairs that were found."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from startracker._compiled import kernel, kernel_part
from startracker.arguments import ABOVE_0, real_number
from startracker.core import FloatArray, IntArray
from startracker.display import fields_repr
from startracker.geometry.attitude import Attitude, camera_attitude
from startracker.geometry.image_map import ImageMap, to_directions
from startracker.solution import Status

WORST_PX = 5.0
"""Centroid error, px, above which a star is not used."""
_AXES = math.sqrt(3.0)


@dataclass(frozen=True, eq=False)
class Observed:
    """Observed stars, brightest first.

    Parameters
    ----------
    vectors : array, shape (N, 3)
        Unit vectors in the camera frame.
    flux : array, shape (N,), optional
        Signal in any linear unit; if None, magnitudes are not used.
    sigma_rad : array, shape (N,)
        Standard error of each direction on one axis.
    kept : dict
        Cache of quantities derived from these stars.
    """

    vectors: FloatArray
    flux: FloatArray | None
    sigma_rad: FloatArray
    kept: dict[float, Any] = field(default_factory=dict)

    __repr__ = fields_repr

    def __len__(self) -> int:
        return len(self.vectors)

    def magnitudes(self) -> FloatArray | None:
        """Instrumental magnitudes −2.5 log₁₀ flux (N,), or None without a usable flux."""
        magnitude = self.magnitudes_or_nan()
        return None if self.flux is None or (len(self) and math.isnan(magnitude[0])) else magnitude

    def magnitudes_or_nan(self) -> FloatArray:
        """Instrumental magnitudes (N,), all NaN if they are unknown."""
        return np.asarray(magnitudes_of(self.flux_or_nan()))

    def flux_or_nan(self) -> FloatArray:
        """Signal (N,), NaN if it is unknown."""
        return np.full(len(self), math.nan) if self.flux is None else self.flux


@kernel_part
def magnitudes_of(flux: FloatArray) -> FloatArray:
    """Instrumental magnitudes −2.5 log₁₀ flux (N,); all NaN if one flux is not positive and finite."""
    out = np.empty(len(flux))
    for n in range(len(flux)):
        if not 0.0 < flux[n] < math.inf:
            out[:] = math.nan
            break
        out[n] = -2.5 * math.log10(flux[n])
    return out


@dataclass(frozen=True, eq=False)
class Prior:
    """A prior attitude, and the largest rotation angle, rad, by which it may be wrong."""

    attitude: Attitude
    radius_rad: float

    def allows(self, matrix: FloatArray) -> bool:
        """Whether an attitude (3, 3) is within 1.05 times that angle."""
        turn = matrix @ self.attitude.as_matrix().T
        # The trace of a rotation matrix is 1 + 2 cos(angle).
        return bool((np.trace(turn) - 1.0) / 2.0 >= math.cos(min(self.radius_rad * 1.05, math.pi)))


@dataclass(frozen=True, eq=False)
class Identification:
    """Result of an identification.

    Parameters
    ----------
    status, reason : Status, str
        ``solved``, ``too_few_stars``, ``no_match``, ``ambiguous`` or ``search_limit``, and the reason in words.
    pairs : int array, shape (M, 2)
        Observed index and guide index of each identified star; empty unless solved.
    log_false_alarm : float
        Natural logarithm of the probability that a random field agrees as well, over all attitudes.
    focal : float
        Ratio of the focal length to the camera's, if that is slightly wrong; otherwise 1.
    steps : sequence of str
        What was tried, and the result of each step, for the explanation.
    operations : int
        Number of operations of the search, see `IdentificationSettings.max_operations`; it does not depend on the
        machine.
    """

    status: Status
    reason: str
    pairs: IntArray = field(default_factory=lambda: np.empty((0, 2), dtype=np.int64))
    log_false_alarm: float = 0.0
    focal: float = 1.0
    steps: Sequence[str] = ()
    operations: int = 0

    __repr__ = fields_repr


@kernel
def usable_directions(
    xy: FloatArray, stated_px: FloatArray, pixel_rad: float, image: ImageMap
) -> tuple[FloatArray, IntArray, FloatArray, FloatArray]:
    """Directions (N, 3) of centroids, indices (M,) of the usable ones, and directions (M, 3) and errors (M,), rad, of
    these."""
    directions = to_directions(xy, image)
    usable, sigma, count = np.empty(len(xy), np.int64), np.empty(len(xy)), 0
    chosen = np.empty_like(directions)
    for n in range(len(xy)):
        # Beyond the fold of the lens model there are no directions: all axes are NaN.
        if math.isfinite(directions[n, 2]) and stated_px[n] < WORST_PX:
            usable[count], sigma[count] = n, stated_px[n] * pixel_rad
            for axis in range(3):
                chosen[count, axis] = directions[n, axis]
            count += 1
    return directions, usable[:count], chosen[:count], sigma[:count]


def as_prior(attitude: object, prior_deg: float) -> Prior | None:
    """Prior from an attitude that may be wrong by up to `prior_deg` degrees about each axis; None without an attitude.

    Raises
    ------
    InputError
        For anything but an `Attitude` or a SciPy ``Rotation`` from ICRS to the camera, or for an angle that is not
        positive.
    """
    if attitude is None:
        return None
    known = camera_attitude("prior", attitude)
    prior_deg = real_number("prior_deg", prior_deg, unit="deg", least=ABOVE_0)
    # The largest rotation has the maximum error about all three axes at once.
    return Prior(known, min(math.radians(prior_deg) * _AXES, math.pi))
