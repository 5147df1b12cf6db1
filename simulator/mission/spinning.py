"""Attitudes of a spinning spacecraft in CCSDS messages: phase and rate of the spin, and nutation of its axis.

At each epoch the spin axis, +z of the body, has right ascension α and declination δ, and the body is at phase ψ about
it: successive rotations of the axes by 90° + α about z, 90° − δ about x and ψ about z (CCSDS 504.0-B-2, annex F). With
nutation the spin axis itself moves, at a constant rate, on a cone about the angular momentum.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from startracker.core import FloatArray
from startracker.errors import InputError

LARGEST_STEP_DEG = 170.0
"""Maximum rotation from one attitude to the next; beyond 180° its direction would be ambiguous."""


@dataclass(frozen=True, eq=False)
class SpinningStates:
    """Attitudes of a spinning body between given states.

    The attitude is predicted forwards from the state before, and backwards from the state after, each with its own
    rates. The result is between the two, on the shortest rotation from one to the other, in proportion to the time. It
    is exact if the rates are constant, for any number of revolutions between two states."""

    t_s: FloatArray
    """(N,): Ascending times."""
    quaternions: FloatArray
    """(N, 4): Of the states, scalar last."""
    spin_rad_s: FloatArray
    """(N,): Rate about +z of the body."""
    momentum: FloatArray
    """(N, 3): Axis of the cone, in the axes from which the quaternions start."""
    cone_rad_s: FloatArray
    """(N,): Rate of the spin axis about the axis of the cone."""
    reverse: bool = False
    """Whether the inverse quaternions are returned."""

    def __call__(self, t_s: FloatArray) -> FloatArray:
        """Unit quaternions (T, 4) at times (T,)."""
        if not len(t_s):
            return np.empty((0, 4))
        # A single state is its own successor; its share of time is then arbitrary.
        last = max(len(self.t_s) - 2, 0)
        before = np.clip(np.searchsorted(self.t_s, t_s, side="right") - 1, 0, last)
        after = np.minimum(before + 1, len(self.t_s) - 1)
        step_s = np.where(after > before, self.t_s[after] - self.t_s[before], 1.0)
        share = np.clip((t_s - self.t_s[before]) / step_s, 0.0, 1.0)
        first = self._moved(before, t_s)
        between = (first.inv() * self._moved(after, t_s)).as_rotvec()
        found = first * Rotation.from_rotvec(share[:, None] * between)
        return np.asarray((found.inv() if self.reverse else found).as_quat())

    def _moved(self, rows: np.ndarray, t_s: FloatArray) -> Rotation:
        """Attitudes (T,) at times (T,) predicted from the states `rows` (T,)."""
        since = (t_s - self.t_s[rows])[:, None]
        about_z = np.zeros((len(rows), 3))
        about_z[:, 2] = self.spin_rad_s[rows]
        # The nutation is about an inertially fixed axis, so it is applied on the left, and the spin on the right.
        cone = Rotation.from_rotvec(since * self.cone_rad_s[rows, None] * self.momentum[rows])
        return cone * Rotation.from_quat(self.quaternions[rows]) * Rotation.from_rotvec(since * about_z)

    def check(self, positions: Sequence[str]) -> None:
        """Raise `InputError`, with its position, for a state that contradicts the motion from the state before."""
        rows = np.arange(len(self.t_s) - 1)
        predicted = self._moved(rows, self.t_s[1:])
        off_deg = np.degrees((predicted.inv() * Rotation.from_quat(self.quaternions[1:])).magnitude())
        if (wrong := np.flatnonzero(off_deg > LARGEST_STEP_DEG)).size:
            raise InputError(
                f"{positions[wrong[0] + 1]}: {off_deg[wrong[0]]:.0f}° from the attitude that the state before and its "
                "rate of spin give; give states at shorter steps, or more decimals of the rate"
            )


def spinning(t_s: FloatArray, columns: dict[str, FloatArray], *, reverse: bool) -> SpinningStates:
    """Attitudes from the columns of a message.

    Parameters
    ----------
    t_s : array, shape (N,)
        Ascending times.
    columns : dict of (N,) arrays
        By keyword: SPIN_ALPHA, SPIN_DELTA, SPIN_ANGLE and SPIN_ANGLE_VEL; with nutation also NUTATION, NUTATION_PER
        and NUTATION_PHASE, or MOMENTUM_ALPHA, MOMENTUM_DELTA and NUTATION_VEL. Degrees and seconds.
    reverse : bool
        Whether the quaternions are wanted in the other direction.
    """
    angles = np.stack([90.0 + columns["SPIN_ALPHA"], 90.0 - columns["SPIN_DELTA"], columns["SPIN_ANGLE"]], axis=1)
    attitude = Rotation.from_euler("ZXZ", angles, degrees=True)
    momentum, cone_rad_s = attitude.apply([0.0, 0.0, 1.0]), np.zeros(len(t_s))
    # Without nutation the axis of the cone is the spin axis itself, and does not move. With nutation a message gives
    # either the cone in body axes by its angle, phase and period, or the direction of the angular momentum and a rate.
    if "NUTATION" in columns:
        cone, phase = np.radians(columns["NUTATION"]), np.radians(columns["NUTATION_PHASE"])
        in_body = [np.sin(cone) * np.cos(phase), -np.sin(cone) * np.sin(phase), np.cos(cone)]
        momentum = attitude.apply(np.stack(in_body, axis=1))
        cone_rad_s = 2.0 * np.pi / columns["NUTATION_PER"]
    elif "MOMENTUM_ALPHA" in columns:
        ra, dec = np.radians(columns["MOMENTUM_ALPHA"]), np.radians(columns["MOMENTUM_DELTA"])
        momentum = np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=1)
        cone_rad_s = np.radians(columns["NUTATION_VEL"])
    spin_rad_s = np.radians(columns["SPIN_ANGLE_VEL"])
    return SpinningStates(t_s, np.asarray(attitude.as_quat()), spin_rad_s, momentum, cone_rad_s, reverse)
