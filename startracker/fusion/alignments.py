"""The filter of several heads: `Mekf` of the body, with the alignment of each head as further states.

The attitude is that of the body, whose axes are the gyro's. A head is mounted at M (body to camera), which is known up
to a small rotation a about the camera's axes: A_head = R(a) M A_body. With an error θ of the body's attitude, a head
measures M θ + a + noise. Like the attitude, the mountings are corrected by multiplication.

Errors of single frames are not quite independent: a star with an unresolved companion is displaced in every frame. This
part c of a head's error is a first-order Gauss–Markov process, of which one state for each axis is estimated if its
standard deviation is given; without it the filter is overconfident where it averages many frames of the same stars.

Only differences between alignments can be observed from stars; their common part only through the gyro, while the body
rotates. A head with a standard deviation of zero defines the body's axes, so that the others' are relative to it.

Sources: Lefferts, Markley & Shuster 1982, J. Guidance 5, 417; Pittelkau 2001, J. Guidance 24, 1187 (alignments in the
filter); Markley & Crassidis 2014, *Fundamentals of Spacecraft Attitude Determination and Control*, section 6.2; Gelb
1974, *Applied Optimal Estimation*, section 4.5 (correlated measurement errors as states).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker.arrays import FloatArray
from startracker.errors import InputError
from startracker.geometry.attitude import Attitude, quat_multiply, quat_to_matrix
from startracker.tracking.kinematics import correct, turn_quaternion
from startracker.tracking.mekf import GyroNoise, Innovation, Mekf, RateNoise, chi_square_limit, rotation_between

_BODY = 9
"""States of the body: attitude, bias or rate, and scale factors; those of the heads follow."""
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
    correlated_sigma_rad : tuple of three float
        Standard deviation of the part of its errors that is correlated from frame to frame, about each axis of the
        camera; in addition to the covariance of its attitudes. All 0: errors of different frames are independent.
    correlation_s : float
        Correlation time of this part, such as the time that a star takes to cross the field.
    """

    name: str
    mounting: Attitude
    alignment_sigma_rad: float = 0.0
    correlated_sigma_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    correlation_s: float = 60.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.alignment_sigma_rad) and self.alignment_sigma_rad >= 0.0):
            raise InputError(f"head {self.name}: alignment_sigma_rad must be zero or positive")
        if not (all(math.isfinite(s) and s >= 0.0 for s in self.correlated_sigma_rad) and self.correlation_s > 0.0):
            raise InputError(f"head {self.name}: correlated_sigma_rad and correlation_s must be positive")
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
        self._correlated = (np.zeros(3),) * len(self.heads)
        """Estimated correlated error of each head, camera axes."""
        variances: list[float] = []
        columns = []
        for one in self.heads:
            for sigma in ((one.alignment_sigma_rad,) * 3, one.correlated_sigma_rad):
                columns.append(_BODY + len(variances) if any(sigma) else None)
                variances += [value**2 for value in sigma] if any(sigma) else []
        self._alignment_at, self._correlated_at = tuple(columns[::2]), tuple(columns[1::2])
        """First columns of each head's alignment and of its correlated error; None if they are zero."""
        self._of_heads = np.diag(np.array(variances))
        super().__init__(*self._from_head(head, attitude, covariance), noise)
        self._append(head)

    def copy(self) -> Self:
        """An independent filter with the same state."""
        twin = super().copy()
        twin.heads, twin._mountings, twin._correlated = self.heads, self._mountings, self._correlated
        twin._alignment_at, twin._correlated_at = self._alignment_at, self._correlated_at
        twin._of_heads = self._of_heads
        return twin

    # ------------------------------------------------------------------ state
    @property
    def attitude(self) -> Attitude:
        """ICRS to body."""
        return Attitude(self._quat, "icrs", "body")

    @property
    def full_covariance(self) -> FloatArray:
        """Covariance (n, n) of attitude, bias or rate, scale factors, and, head by head, of its alignment and of its
        correlated error, as far as they are estimated."""
        return self._covariance.copy()

    def mounting(self, head: int) -> Attitude:
        """Estimated mounting of a head, body to camera."""
        return Attitude(self._mountings[head], "body", "camera")

    def alignment_rad(self, head: int) -> FloatArray:
        """Estimated rotation vector (3,) from the given to the actual mounting of a head, camera axes."""
        return rotation_between(np.array(self.heads[head].mounting.quat), self._mountings[head])

    def alignment_sigma_rad(self, head: int) -> FloatArray:
        """Standard deviations (3,) of `alignment_rad`."""
        column = self._alignment_at[head]
        return np.zeros(3) if column is None else np.sqrt(self._covariance.diagonal()[column : column + 3])

    def head_attitude(self, head: int) -> Attitude:
        """ICRS to the camera of a head."""
        return Attitude(quat_multiply(self._mountings[head], self._quat))

    def head_covariance(self, head: int) -> FloatArray:
        """Covariance (3, 3) of the error of `head_attitude`, in the axes of that camera, rad²."""
        axes = self._axes(head, self._mountings[head], (self._alignment_at[head],))
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
        own = self._alignment_at[head], self._correlated_at[head]
        delta = np.zeros(len(self._covariance))
        for _ in range(_MOST_PASSES):
            turn, error = (delta[at : at + 3] if at is not None else np.zeros(3) for at in own)
            mounting = turn_quaternion(self._mountings[head], turn)
            predicted = quat_multiply(mounting, turn_quaternion(self._quat, delta[:3]))
            predicted = turn_quaternion(predicted, self._correlated[head] + error)
            axes = self._axes(head, mounting, own)
            innovation = rotation_between(predicted, attitude.quat) + axes @ delta
            outcome = correct(self._covariance, axes, innovation, noise)
            moved, delta = float(np.abs(outcome[1] - delta)[self._angles].max()), outcome[1]
            if moved < _LINEAR_RAD:
                break
        return self._take(outcome, chi_square_limit(3, false_rejection), 3)

    def predict(self, dt: float, gyro_rad_s: ArrayLike | None = None) -> None:
        """Propagate by `dt` seconds; as `Mekf.predict`."""
        super().predict(dt, gyro_rad_s)
        if all(at is None for at in self._correlated_at):
            return
        kept, fresh, correlated = np.ones(len(self._covariance)), np.zeros(len(self._covariance)), []
        for head, at, error in zip(self.heads, self._correlated_at, self._correlated, strict=True):
            decay = math.exp(-dt / head.correlation_s)
            correlated.append(error * decay)
            if at is not None:
                kept[at : at + 3] = decay
                fresh[at : at + 3] = -math.expm1(-2.0 * dt / head.correlation_s) * np.square(head.correlated_sigma_rad)
        self._correlated = tuple(correlated)
        self._covariance = self._covariance * np.outer(kept, kept) + np.diag(fresh)

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
        self._of_heads = self._covariance[_BODY:, _BODY:]
        self.reset(*self._from_head(head, attitude, covariance), second_sigma_rad_s=second_sigma_rad_s)
        self._append(head)

    # ------------------------------------------------------------------ details
    @property
    def _angles(self) -> NDArray[np.intp]:
        """States that are angles."""
        return np.array([0, 1, 2, *range(_BODY, len(self._covariance))])

    def _axes(self, head: int, mounting: FloatArray, own: tuple[int | None, ...]) -> FloatArray:
        """Derivative (3, n) of a head's rotation by the states, for a mounting (4,) and columns of its own states."""
        axes = np.zeros((3, len(self._covariance)))
        axes[:, :3] = quat_to_matrix(mounting)
        for column in own:
            if column is not None:
                axes[:, column : column + 3] = np.eye(3)
        return axes

    def _errors_of(self, head: int) -> FloatArray:
        """Derivative (3, m) of the measured attitude of a head by the states of all heads."""
        axes = np.zeros((3, len(self._of_heads)))
        for column in (self._alignment_at[head], self._correlated_at[head]):
            if column is not None:
                axes[:, column - _BODY : column - _BODY + 3] = np.eye(3)
        return axes

    def _from_head(self, head: int, attitude: Attitude, covariance: ArrayLike) -> tuple[Attitude, FloatArray]:
        """Attitude of the body and its covariance from those of a head."""
        noise, mounting = np.asarray(covariance, dtype=float), self.mounting(head)
        if noise.shape == (3, 3):  # otherwise `reset` reports it
            errors, matrix = self._errors_of(head), mounting.as_matrix()
            noise = matrix.T @ (noise + errors @ self._of_heads @ errors.T) @ matrix
        seen = Attitude(turn_quaternion(attitude.quat, -self._correlated[head]))
        return mounting.inverse @ seen, noise

    def _append(self, head: int) -> None:
        """Append the states of the heads, to which an attitude of one of them is correlated: θ = Mᵀ (noise − a − c)."""
        added, before = len(self._of_heads), self._covariance
        if not added:
            return
        out = np.zeros((_BODY + added,) * 2)
        out[: len(before), : len(before)] = before
        out[_BODY:, _BODY:] = self._of_heads
        out[:3, _BODY:] = -quat_to_matrix(self._mountings[head]).T @ self._errors_of(head) @ self._of_heads
        out[_BODY:, :3] = out[:3, _BODY:].T
        self._covariance = out

    def _take(
        self, outcome: tuple[float, FloatArray, FloatArray, FloatArray], limit: float, freedom: int
    ) -> Innovation:
        innovation = super()._take(outcome, limit, freedom)
        if innovation.accepted:
            change = outcome[1]
            self._mountings = tuple(
                quat if at is None else turn_quaternion(quat, change[at : at + 3])
                for quat, at in zip(self._mountings, self._alignment_at, strict=True)
            )
            self._correlated = tuple(
                error if at is None else error + change[at : at + 3]
                for error, at in zip(self._correlated, self._correlated_at, strict=True)
            )
        return innovation
