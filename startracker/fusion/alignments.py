"""The filter of several heads: `Mekf` of the body, with the alignment of each head as further states.

The attitude is that of the body, whose axes are the gyro's. A head is mounted at M (body to camera), which is known up
to a small rotation a about the camera's axes: A_head = R(a) M A_body. With an error θ of the body's attitude, a head
measures M θ + a + noise. Like the attitude, the mountings are corrected by multiplication.

Only differences between alignments can be observed from stars; their common part only through the gyro, while the body
rotates. A head with a standard deviation of zero defines the body's axes, so that the others' are relative to it.

Sources: Lefferts, Markley & Shuster 1982, J. Guidance 5, 417; Pittelkau 2001, J. Guidance 24, 1187 (alignments in the
filter); Markley & Crassidis 2014, *Fundamentals of Spacecraft Attitude Determination and Control*, section 6.2.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker.attitude import Attitude, quat_multiply, quat_to_matrix
from startracker.errors import InputError
from startracker.tracking.kinematics import correct, turn_quaternion
from startracker.tracking.mekf import GyroNoise, Innovation, Mekf, RateNoise, chi_square_limit, rotation_between

__all__ = ["AlignedMekf", "Head"]

FloatArray = NDArray[np.float64]

_ALIGNMENTS = 9
"""First state of the alignments; before it attitude, bias or rate, and scale factors."""
_LINEAR_RAD = 3e-5
"""Change, rad, below which a correction is not linearised again: the product with an alignment of 1° is 0.1″."""
_MOST_PASSES = 6


@dataclass(frozen=True)
class Head:
    """One camera of several on a body.

    Parameters
    ----------
    name : str
        Its name.
    mounting : Attitude
        Body to camera, as known before the flight.
    alignment_sigma_rad : float
        Standard deviation of the mounting about each axis, which is then estimated. 0: it is exact.
    """

    name: str
    mounting: Attitude
    alignment_sigma_rad: float = 0.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.alignment_sigma_rad) and self.alignment_sigma_rad >= 0.0):
            raise InputError(f"head {self.name}: alignment_sigma_rad must be zero or positive")
        if (self.mounting.source, self.mounting.target) != ("body", "camera"):
            raise InputError(f"head {self.name}: the mounting must be an attitude from body to camera")


class AlignedMekf(Mekf):
    """The filter of a body with several heads, started by the attitude of one of them.

    Parameters
    ----------
    heads : sequence of Head
        The heads; they are referred to by their index.
    head : int
        The head that gives the initial attitude.
    attitude : Attitude
        ICRS to the camera of that head.
    covariance : array_like, shape (3, 3)
        Of its error in camera axes, rad².
    noise : GyroNoise or RateNoise
        Process noise, as of `Mekf`.
    """

    def __init__(
        self,
        heads: Sequence[Head],
        head: int,
        attitude: Attitude,
        covariance: ArrayLike,
        noise: GyroNoise | RateNoise,
    ) -> None:
        self.heads = tuple(heads)
        self._mountings = tuple(np.array(one.mounting.quat) for one in heads)
        sigma = np.array([one.alignment_sigma_rad for one in heads])
        rank = np.cumsum(sigma > 0.0) - 1
        self._columns = tuple(_ALIGNMENTS + 3 * int(k) if s > 0.0 else None for k, s in zip(rank, sigma, strict=True))
        """First column of each head's alignment; None if its mounting is exact."""
        self._alignments = np.diag(np.repeat(sigma[sigma > 0.0] ** 2, 3))
        super().__init__(*self._from_head(head, attitude, covariance), noise)
        self._correlate(head)

    def copy(self) -> Self:
        """An independent filter with the same state."""
        twin = super().copy()
        twin.heads, twin._mountings = self.heads, self._mountings
        twin._columns, twin._alignments = self._columns, self._alignments
        return twin

    # ------------------------------------------------------------------ state
    @property
    def attitude(self) -> Attitude:
        """ICRS to body."""
        return Attitude(self._quat, "icrs", "body")

    @property
    def full_covariance(self) -> FloatArray:
        """Covariance (n, n) of attitude, bias or rate, scale factors, and the estimated alignments in order."""
        return self._covariance.copy()

    def mounting(self, head: int) -> Attitude:
        """Estimated mounting of a head, body to camera."""
        return Attitude(self._mountings[head], "body", "camera")

    def alignment_rad(self, head: int) -> FloatArray:
        """Estimated rotation vector (3,) from the given to the actual mounting of a head, camera axes."""
        return rotation_between(np.array(self.heads[head].mounting.quat), self._mountings[head])

    def alignment_sigma_rad(self, head: int) -> FloatArray:
        """Standard deviations (3,) of `alignment_rad`."""
        column = self._columns[head]
        return np.zeros(3) if column is None else np.sqrt(self._covariance.diagonal()[column : column + 3])

    def head_attitude(self, head: int) -> Attitude:
        """ICRS to the camera of a head."""
        return Attitude(quat_multiply(self._mountings[head], self._quat))

    def head_covariance(self, head: int) -> FloatArray:
        """Covariance (3, 3) of the error of `head_attitude`, in the axes of that camera, rad²."""
        axes = self._axes(head, self._mountings[head])
        return np.asarray(axes @ self._covariance @ axes.T)

    # ------------------------------------------------------------------ measurements
    def update_head(
        self, head: int, attitude: Attitude, covariance: ArrayLike, false_rejection: float = 0.0
    ) -> Innovation:
        """Update with the attitude that one head measured.

        A large correction is iterated, with linearisation about its result (Jazwinski 1970).

        Parameters
        ----------
        head : int
            Index of the head.
        attitude : Attitude
            ICRS to its camera.
        covariance : array_like, shape (3, 3)
            Of its error in camera axes, rad².
        false_rejection : float
            Probability of rejecting a correct measurement, which defines the gate on χ². 0: no gate.
        """
        noise = np.ascontiguousarray(covariance, dtype=float)
        column = self._columns[head]
        delta = np.zeros(len(self._covariance))
        for _ in range(_MOST_PASSES):
            turn = delta[column : column + 3] if column is not None else np.zeros(3)
            mounting = turn_quaternion(self._mountings[head], turn)
            predicted = quat_multiply(mounting, turn_quaternion(self._quat, delta[:3]))
            axes = self._axes(head, mounting)
            innovation = rotation_between(predicted, attitude.quat) + axes @ delta
            outcome = correct(self._covariance, axes, innovation, noise)
            moved, delta = float(np.abs(outcome[1] - delta)[self._angles].max()), outcome[1]
            if moved < _LINEAR_RAD:
                break
        return self._take(outcome, chi_square_limit(3, false_rejection), 3)

    def restart(
        self, head: int, attitude: Attitude, covariance: ArrayLike, second_sigma_rad_s: float | None = None
    ) -> None:
        """Restart from the attitude of one head; alignments are kept with their covariance.

        Parameters
        ----------
        head, attitude, covariance
            As in `update_head`.
        second_sigma_rad_s : float, optional
            As in `Mekf.reset`.
        """
        self._alignments = self._covariance[_ALIGNMENTS:, _ALIGNMENTS:]
        self.reset(*self._from_head(head, attitude, covariance), second_sigma_rad_s=second_sigma_rad_s)
        self._correlate(head)

    # ------------------------------------------------------------------ details
    @property
    def _angles(self) -> NDArray[np.intp]:
        """States that are angles."""
        return np.array([0, 1, 2, *range(_ALIGNMENTS, len(self._covariance))])

    def _axes(self, head: int, mounting: FloatArray) -> FloatArray:
        """Derivative (3, n) of a head's rotation by the states, for a mounting (4,)."""
        axes = np.zeros((3, len(self._covariance)))
        axes[:, :3] = quat_to_matrix(mounting)
        column = self._columns[head]
        if column is not None:
            axes[:, column : column + 3] = np.eye(3)
        return axes

    def _from_head(self, head: int, attitude: Attitude, covariance: ArrayLike) -> tuple[Attitude, FloatArray]:
        """Attitude of the body and its covariance from those of a head."""
        noise, column = np.asarray(covariance, dtype=float), self._columns[head]
        if column is not None and noise.shape == (3, 3):
            own = slice(column - _ALIGNMENTS, column - _ALIGNMENTS + 3)
            noise = noise + self._alignments[own, own]
        mounting = self.mounting(head)
        matrix = mounting.as_matrix()
        return mounting.inverse @ attitude, matrix.T @ noise @ matrix if noise.shape == (3, 3) else noise

    def _correlate(self, head: int) -> None:
        """Append the alignments, to which an attitude of one head is correlated: θ = Mᵀ (noise − a)."""
        estimated, before = len(self._alignments), self._covariance
        if not estimated:
            return
        out = np.zeros((_ALIGNMENTS + estimated,) * 2)
        out[: len(before), : len(before)] = before
        out[_ALIGNMENTS:, _ALIGNMENTS:] = self._alignments
        column = self._columns[head]
        if column is not None:
            own = self._alignments[column - _ALIGNMENTS : column - _ALIGNMENTS + 3]
            out[:3, _ALIGNMENTS:] = -quat_to_matrix(self._mountings[head]).T @ own
            out[_ALIGNMENTS:, :3] = out[:3, _ALIGNMENTS:].T
        self._covariance = out

    def _take(
        self, outcome: tuple[float, FloatArray, FloatArray, FloatArray], limit: float, freedom: int
    ) -> Innovation:
        innovation = super()._take(outcome, limit, freedom)
        if innovation.accepted:
            change = outcome[1]
            self._mountings = tuple(
                quat if column is None else turn_quaternion(quat, change[column : column + 3])
                for quat, column in zip(self._mountings, self._columns, strict=True)
            )
        return innovation
