"""What identification takes and gives: observed stars, a prior attitude, and the pairs found."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from startracker.attitude import Attitude
from startracker.display import fields_repr
from startracker.kernels import kernel
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
    kept : dict
        Room for what is derived from these stars once and used often.
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
        """The same, NaN for all where they are not known."""
        return np.full(len(self), math.nan) if self.flux is None else np.asarray(_magnitudes(self.flux))


@kernel
def _magnitudes(flux: FloatArray) -> FloatArray:
    out = np.empty(len(flux))
    for n in range(len(flux)):
        if not 0.0 < flux[n] < math.inf:
            out[:] = math.nan
            break
        out[n] = -2.5 * math.log10(flux[n])
    return out


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
        ``solved``, ``too_few_stars``, ``no_match``, ``ambiguous`` or ``search_limit``, and why, in words.
    pairs : int array, shape (M, 2)
        Observed index and guide index of each identified star; empty unless solved.
    log_false_alarm : float
        Natural logarithm of the chance that the sky gives such agreement at random, over all attitudes.
    focal : float
        Factor of the focal length against the camera's, where that is a little off; else 1.
    steps : sequence of str
        What was tried and how far it got, for people.
    operations : int
        Steps of the search, as `IdentificationSettings.max_operations` counts them: the same on every machine.
    """

    status: Status
    reason: str
    pairs: IntArray = field(default_factory=lambda: np.empty((0, 2), dtype=np.int64))
    log_false_alarm: float = 0.0
    focal: float = 1.0
    steps: Sequence[str] = ()
    operations: int = 0

    __repr__ = fields_repr
