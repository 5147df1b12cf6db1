"""What identification takes and gives: observed stars, a prior attitude, and the pairs found."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from startracker.attitude import Attitude
from startracker.solution import Status

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Observed:
    """Observed stars, brightest first.

    Parameters
    ----------
    vectors : array, shape (N, 3)
        Unit vectors in the camera frame.
    flux : array, shape (N,), optional
        Signal in any linear unit; None when it is not known, and magnitudes are then not looked at.
    sigma_rad : array, shape (N,)
        Standard error of each direction, on one axis.
    """

    vectors: FloatArray
    flux: FloatArray | None
    sigma_rad: FloatArray

    def __len__(self) -> int:
        return len(self.vectors)

    def magnitudes(self) -> FloatArray | None:
        """Instrumental magnitudes −2.5 log₁₀ flux (N,), or None without a usable flux."""
        if self.flux is None or not bool(np.all(np.isfinite(self.flux) & (self.flux > 0))):
            return None
        return -2.5 * np.log10(self.flux)


@dataclass(frozen=True, eq=False)
class Prior:
    """An attitude known beforehand, and the angle (rad) of the largest rotation by which it may be wrong."""

    attitude: Attitude
    radius_rad: float


@dataclass(frozen=True, eq=False)
class Identification:
    """Outcome of an identification.

    Parameters
    ----------
    status, reason : Status, str
        ``solved``, ``too_few_stars``, ``no_match`` or ``ambiguous``, and why, in words.
    pairs : int array, shape (M, 2)
        Observed index and guide index of each identified star; empty unless solved.
    log_false_alarm : float
        Natural logarithm of the chance that the sky gives such agreement at random, over all attitudes.
    focal : float
        Factor of the focal length against the camera's, where that is a little off; else 1.
    steps : tuple of str
        What was tried and how far it got, for people.
    """

    status: Status
    reason: str
    pairs: IntArray = field(default_factory=lambda: np.empty((0, 2), dtype=np.int64))
    log_false_alarm: float = 0.0
    focal: float = 1.0
    steps: tuple[str, ...] = ()
