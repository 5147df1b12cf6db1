"""The filter of several heads: `Mekf` of the body, with the alignment of each head as further states.

The filter estimates the attitude of the body, whose axes are the gyro's. A head is mounted at M (body to camera), known
up to a small rotation a about the camera's axes: A_head = R(a) M A_body. With an error θ of the body's attitude, a head
measures M θ + a + noise. Like the attitude, the mountings are corrected by multiplication.

Errors of single frames are not quite independent: a star with an unresolved companion is displaced in every frame. This
part c of a head's error is a first-order Gauss–Markov process, of which one state for each axis is estimated if its
standard deviation is given; without it the filter is overconfident where it averages many frames of the same stars.

A mounting that moves in flight, as a structure bends with its temperature, is a process of the same kind, b, and part
of the mounting: A_head = R(b) R(a) M A_body. Its mean is zero. If the mountings of all heads move, the axes of the body
are therefore those about which they move, as the gyro holds them; no head is exempt for being the first.

Only differences between alignments can be observed from stars; their common part only through the gyro, while the body
rotates. A head with standard deviations of zero defines the body's axes, so that the others' are relative to it.

Sources: Lefferts, Markley & Shuster 1982, J. Guidance 5, 417; Pittelkau 2001, J. Guidance 24, 1187 (alignments in the
filter); Markley & Crassidis 2014, *Fundamentals of Spacecraft Attitude Determination and Control*, section 6.2; Gelb
1974, *Applied Optimal Estimation*, section 4.5 (correlated measurement errors as states).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker.core import FloatArray
from startracker.errors import InputError
from startracker.fusion.head import Head
from startracker.geometry.attitude import Attitude, quat_multiply, quat_to_matrix
from startracker.tracking.checked import checked_attitude, checked_covariance
from startracker.tracking.kinematics import correct, turn_quaternion
from startracker.tracking.mekf import GyroNoise, Innovation, Mekf, RateNoise, chi_square_limit, rotation_between

_BODY = 9
"""States of the body: attitude, bias or rate, and scale factors; those of the heads follow."""
_LINEAR_RAD = 3e-5
"""Change, rad, below which a correction is not linearised again: the product with an alignment of 1° is 0.1″."""
_MOST_PASSES = 6


class _Process(NamedTuple):
    """A first-order Gauss–Markov process of three components about the axes of a camera."""

    at: int | None
    """First of its columns in the covariance; None if it is zero."""
    sigma_rad: FloatArray
    """(3,)"""
    correlation_s: float
    value_rad: FloatArray = np.zeros(3)
    """(3,): Estimate."""

    def decayed(self, dt: float) -> _Process:
        """The process after a time without measurements."""
        return self._replace(value_rad=self.value_rad * math.exp(-dt / self.correlation_s))

    def corrected(self, change: FloatArray) -> _Process:
        """The process after a correction of all states (n,)."""
        return self if self.at is None else self._replace(value_rad=self.value_rad + change[self.at : self.at + 3])


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

    _target = "body"

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
        variances: list[float] = []

        def column(*sigma_rad: float) -> int | None:
            """First column of three new states; None if they are zero."""
            if not any(sigma_rad):
                return None
            variances.extend(value**2 for value in sigma_rad)
            return _BODY + len(variances) - 3

        alignments, correlated = [], []
        for one in self.heads:
            alignments.append(column(*(one.alignment_sigma_rad,) * 3))
            sigma = one.correlated_sigma_rad
            correlated.append(_Process(column(*sigma), np.array(sigma), one.correlation_s))
        self._alignment_at, self._correlated = tuple(alignments), tuple(correlated)
        self._bending = tuple(
            _Process(column(*(one.bending_sigma_rad,) * 3), np.full(3, one.bending_sigma_rad), one.bending_s)
            for one in self.heads
        )
        self._of_heads = np.diag(np.array(variances))
        super().__init__(*self._from_head(head, attitude, covariance), noise)
        self._append(head)

    # ------------------------------------------------------------------ state
    @property
    def attitude(self) -> Attitude:
        """ICRS to body."""
        return Attitude(self._quat, "icrs", "body")

    @property
    def full_covariance(self) -> FloatArray:
        """Covariance (n, n) of attitude, bias or rate, scale factors, head by head of its alignment and of its
        correlated error, and then of the motion of each mounting, as far as they are estimated."""
        return self._covariance.copy()

    def mounting(self, head: int) -> Attitude:
        """Estimated mounting of a head, body to camera."""
        return Attitude(self._mountings[head], "body", "camera")

    def alignment_rad(self, head: int) -> FloatArray:
        """Estimated rotation vector (3,) from the given to the actual mounting of a head, camera axes."""
        return rotation_between(np.array(self.heads[head].mounting.quat), self._mountings[head])

    def alignment_sigma_rad(self, head: int) -> FloatArray:
        """Standard deviations (3,) of `alignment_rad`."""
        own = self._mounting_columns(head)
        axes = np.zeros((3, len(self._covariance)))
        for column in own:
            axes[:, column : column + 3] = np.eye(3)
        return np.sqrt(np.diag(axes @ self._covariance @ axes.T))

    def bending_sigma_rad(self, head: int) -> float:
        """Standard deviation that is assumed for the motion of a mounting: the stated one, or that of `bend`."""
        return float(self._bending[head].sigma_rad.max())

    def bending_s(self, head: int) -> float:
        """Correlation time of this motion."""
        return self._bending[head].correlation_s

    def bending_rad(self, head: int) -> float:
        """Angle by which a mounting has moved, as estimated."""
        return math.hypot(*self._bending[head].value_rad.tolist())

    def head_attitude(self, head: int) -> Attitude:
        """ICRS to the camera of a head."""
        return Attitude(quat_multiply(self._mountings[head], self._quat))

    def head_covariance(self, head: int) -> FloatArray:
        """Covariance (3, 3) of the error of `head_attitude`, in the axes of that camera, rad²."""
        axes = self._axes(head, self._mountings[head], self._mounting_columns(head))
        return np.asarray(axes @ self._covariance @ axes.T)

    def innovation_covariance(self, head: int, covariance: ArrayLike) -> FloatArray:
        """Covariance (3, 3) of the difference between a measurement of covariance (3, 3) and its prediction, in the
        axes of the body, rad²."""
        axes = self._axes(head, self._mountings[head], self._all_columns(head))
        to_body = quat_to_matrix(self._mountings[head]).T
        return np.asarray(
            to_body @ (axes @ self._covariance @ axes.T + np.asarray(covariance, dtype=float)) @ to_body.T
        )

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
        noise = checked_covariance(covariance)
        head, attitude = self._index(head), checked_attitude(attitude, "icrs", "camera")
        own, at = self._mounting_columns(head), self._correlated[head].at
        delta = np.zeros(len(self._covariance))
        for _ in range(_MOST_PASSES):
            turn, error = _sum_at(delta, own), _sum_at(delta, () if at is None else (at,))
            mounting = turn_quaternion(self._mountings[head], turn)
            predicted = quat_multiply(mounting, turn_quaternion(self._quat, delta[:3]))
            predicted = turn_quaternion(predicted, self._correlated[head].value_rad + error)
            axes = self._axes(head, mounting, self._all_columns(head))
            innovation = rotation_between(predicted, attitude.quat) + axes @ delta
            outcome = correct(self._covariance, axes, innovation, noise)
            moved, delta = float(np.abs(outcome[1] - delta)[self._angles].max()), outcome[1]
            if moved < _LINEAR_RAD:
                break
        return self._take(outcome, chi_square_limit(3, false_rejection), 3)

    def predict(self, dt: float, gyro_rad_s: ArrayLike | None = None) -> None:
        """Propagate by `dt` seconds; as `Mekf.predict`."""
        super().predict(dt, gyro_rad_s)
        moving = [(one.at, one) for one in (*self._correlated, *self._bending) if one.at is not None]
        if not moving:
            return
        kept, fresh = np.ones(len(self._covariance)), np.zeros(len(self._covariance))
        for at, process in moving:
            columns = slice(at, at + 3)
            kept[columns] = math.exp(-dt / process.correlation_s)
            fresh[columns] = -math.expm1(-2.0 * dt / process.correlation_s) * np.square(process.sigma_rad)
        self._covariance = self._covariance * np.outer(kept, kept) + np.diag(fresh)
        self._mountings = tuple(
            quat if one.at is None else turn_quaternion(quat, math.expm1(-dt / one.correlation_s) * one.value_rad)
            for quat, one in zip(self._mountings, self._bending, strict=True)
        )
        self._correlated = tuple(process.decayed(dt) for process in self._correlated)
        self._bending = tuple(process.decayed(dt) for process in self._bending)

    # ------------------------------------------------------------------ mountings that are not as stated
    def bend(self, head: int, sigma_rad: float, correlation_s: float, at_once_rad: float = 0.0) -> None:
        """Assume another motion of a mounting from now on.

        Parameters
        ----------
        head : int
            Index of the head.
        sigma_rad, correlation_s : float
            As `bending_sigma_rad` and `bending_s` of `Head`.
        at_once_rad : float
            Standard deviation of a motion that has already happened.
        """
        process = self._bending[head]
        at = self._grow() if process.at is None else process.at
        process = process._replace(at=at, sigma_rad=np.full(3, sigma_rad), correlation_s=correlation_s)
        self._bending = (*self._bending[:head], process, *self._bending[head + 1 :])
        self._add_variance(at, at_once_rad)

    def realign(self, head: int, sigma_rad: float) -> None:
        """Increase the uncertainty of a head's alignment, which has changed by about `sigma_rad`."""
        at = self._alignment_at[head]
        if at is None:
            at = self._grow()
            self._alignment_at = (*self._alignment_at[:head], at, *self._alignment_at[head + 1 :])
        self._add_variance(at, sigma_rad)

    def restart(
        self, head: int, attitude: Attitude, covariance: ArrayLike, second_sigma_rad_s: float | None = None
    ) -> None:
        """Restart from the attitude of one head; alignments are kept with their covariance.

        Parameters
        ----------
        head, attitude, covariance
            As in `update_head`.
        second_sigma_rad_s : float, optional
            Standard deviation of the gyro's bias, or of the rate. None: their covariance is kept, as is that of the
            scale factors, since another attitude does not say anything about the gyro.
        """
        before = self._covariance
        self._of_heads = before[_BODY:, _BODY:]
        self.reset(*self._from_head(head, attitude, covariance), second_sigma_rad_s=second_sigma_rad_s)
        if second_sigma_rad_s is None:
            kept = min(len(self._covariance), _BODY)
            self._covariance[3:kept, 3:kept] = before[3:kept, 3:kept]
        self._append(head)

    # ------------------------------------------------------------------ details
    def _index(self, head: int) -> int:
        """Index of a head."""
        whole = isinstance(head, (int, np.integer)) and not isinstance(head, bool)
        if not whole or not 0 <= head < len(self.heads):
            raise InputError(f"a head's index must be from 0 to {len(self.heads) - 1}; got {head!r}")
        return int(head)

    @property
    def _angles(self) -> NDArray[np.intp]:
        """States that are angles."""
        return np.array([0, 1, 2, *range(_BODY, len(self._covariance))])

    def _mounting_columns(self, head: int) -> tuple[int, ...]:
        """First columns of the states of a head's mounting."""
        return tuple(at for at in (self._alignment_at[head], self._bending[head].at) if at is not None)

    def _all_columns(self, head: int) -> tuple[int, ...]:
        """First columns of the states of a head."""
        at = self._correlated[head].at
        return self._mounting_columns(head) if at is None else (*self._mounting_columns(head), at)

    def _axes(self, head: int, mounting: FloatArray, own: tuple[int, ...]) -> FloatArray:
        """Derivative (3, n) of a head's rotation by the states, for a mounting (4,) and columns of its own states."""
        axes = np.zeros((3, len(self._covariance)))
        axes[:, :3] = quat_to_matrix(mounting)
        for column in own:
            axes[:, column : column + 3] = np.eye(3)
        return axes

    def _errors_of(self, head: int) -> FloatArray:
        """Derivative (3, m) of the measured attitude of a head by the states of all heads."""
        axes = np.zeros((3, len(self._of_heads)))
        for column in self._all_columns(head):
            axes[:, column - _BODY : column - _BODY + 3] = np.eye(3)
        return axes

    def _grow(self) -> int:
        """Append three states that are exactly zero; returns their first column."""
        before = self._covariance
        at = max(len(before), _BODY)
        self._covariance = np.zeros((at + 3,) * 2)
        self._covariance[: len(before), : len(before)] = before
        return at

    def _add_variance(self, at: int, sigma_rad: float) -> None:
        """Increase the variance of three states."""
        added = np.zeros(len(self._covariance))
        added[at : at + 3] = sigma_rad**2
        self._covariance = self._covariance + np.diag(added)

    def _from_head(self, head: int, attitude: Attitude, covariance: ArrayLike) -> tuple[Attitude, FloatArray]:
        """Attitude of the body and its covariance from those of a head."""
        head, attitude = self._index(head), checked_attitude(attitude, "icrs", "camera")
        noise, mounting = checked_covariance(covariance), self.mounting(head)
        errors, matrix = self._errors_of(head), mounting.as_matrix()
        noise = matrix.T @ (noise + errors @ self._of_heads @ errors.T) @ matrix
        seen = Attitude(turn_quaternion(attitude.quat, -self._correlated[head].value_rad))
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
                turn_quaternion(quat, _sum_at(change, own)) if (own := self._mounting_columns(head)) else quat
                for head, quat in enumerate(self._mountings)
            )
            self._correlated = tuple(process.corrected(change) for process in self._correlated)
            self._bending = tuple(process.corrected(change) for process in self._bending)
        return innovation


def _sum_at(states: FloatArray, columns: tuple[int, ...]) -> FloatArray:
    """Sum (3,) of the groups of three states that begin at some columns."""
    total = np.zeros(3)
    for column in columns:
        total = total + states[column : column + 3]
    return total
