"""Steps of the attitude filter of a flight build in integers: propagation at a constant rate, and correction.

The equations are those of `startracker.tracking.kinematics`. Angles are in units of 2⁻²⁰ rad, rates in units per
second. The C source (`c/tracker_attitude_filter.c`) performs the same operations in the same order.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

from startracker.fixed_point.vectors import quotient
from startracker.flight.linear import factorised, solved
from startracker.flight.real import ONE, ZERO, Real, arctangent

ANGLE_BITS = 20
"""The unit of angles is 2⁻²⁰ rad."""
Vector: TypeAlias = list[Real]
Matrix: TypeAlias = list[list[Real]]
_ONE = 1 << 30
_TERMS = 8
_MOST_PARTS = 64
_ROUNDING = -28
_HALF = Real(1, -1)


class Correction(NamedTuple):
    """Kalman update with a measured attitude."""

    distance2: Real
    """Squared Mahalanobis distance of the innovation."""
    white: Vector
    """Whitened innovation, (3,)."""
    change: Vector
    """Correction of the state, (6,)."""
    covariance: Matrix
    """After the update, (6, 6)."""


def series(square: Real, first: int) -> Real:
    """Σ (−x)ᵏ / (2k + n)! of x = `square`, n = `first`."""
    total = ZERO
    for k in range(_TERMS - 1, -1, -1):
        total = ONE - square * total / Real((2 * k + first + 1) * (2 * k + first + 2))
    return total / Real(math.factorial(first))


def propagate(
    quaternion: list[int], covariance: Matrix, rate: Vector, step: Real, sign: int, psd: Vector
) -> tuple[list[int], Matrix] | None:
    """Quaternion (4,) of 2.30 and covariance (6, 6) after a step in seconds at a rate (3,).

    `sign` is +1 if the second state is the rate, −1 if it is a gyro's bias; `psd` (3,) are the white noises of the
    angle's derivative, of the second state's, and of both disturbances of the rate together. The step is divided into
    equal parts of at most one radian; None if these are more than 64.
    """
    omega = [value.scaled(-ANGLE_BITS) for value in rate]
    speed = (omega[0] * omega[0] + omega[1] * omega[1] + omega[2] * omega[2]).root()
    parts = 1
    while speed * step > Real(parts):
        parts *= 2
        if parts > _MOST_PARTS:
            return None
    part = step / Real(parts)
    angle = [value * part for value in rate]
    transition, noise = _transition(omega, speed, part, sign, psd)
    for _ in range(parts):
        covariance = _transformed(transition, covariance, noise)
        quaternion = turned_quaternion(quaternion, angle)
    return quaternion, covariance


def _transition(omega: Vector, speed: Real, dt: Real, sign: int, psd: Vector) -> tuple[Matrix, Matrix]:
    """Transition matrix (6, 6) and covariance (6, 6) of the process noise."""
    square = (speed * dt) * (speed * dt)
    dt2, dt3 = dt * dt, dt * dt * dt
    s1, c1 = dt * series(square, 1), dt2 * series(square, 2)
    d1, f1 = dt3 * series(square, 3), dt2 * dt2 * series(square, 4)
    e1 = (dt3 * dt2 * series(square, 5)).scaled(1)
    x, y, z = omega
    cross = [[ZERO, -z, y], [z, ZERO, -x], [-y, x, ZERO]]
    w2 = speed * speed
    phi, noise = ([[ZERO] * 6 for _ in range(6)] for _ in range(2))
    for i in range(3):
        for j in range(3):
            one = ONE if i == j else ZERO
            twice = omega[i] * omega[j] - one * w2
            phi[i][j] = one - s1 * cross[i][j] + c1 * twice
            psi = dt * one - c1 * cross[i][j] + d1 * twice
            phi[i][3 + j] = -psi if sign < 0 else psi
            mixed = psd[1] * (dt2 * _HALF * one - d1 * cross[i][j] + f1 * twice)
            noise[i][3 + j] = noise[3 + j][i] = -mixed if sign < 0 else mixed
            noise[i][j] = psd[2] * (dt3 / Real(3) * one + e1 * twice)
        phi[3 + i][3 + i] = ONE
        noise[i][i] = noise[i][i] + psd[0] * dt
        noise[3 + i][3 + i] = psd[1] * dt
    return phi, noise


def correct(covariance: Matrix, innovation: Vector, noise: Matrix) -> Correction | None:
    """Update of a covariance (6, 6) with a measured attitude error (3,) and its covariance (3, 3), in Joseph form; None
    if the innovation's covariance is not positive definite."""
    spread = [[covariance[i][j] + noise[i][j] for j in range(3)] for i in range(3)]
    if factorised(spread) is None:
        return None
    white = list(innovation)
    distance2 = ZERO
    for k in range(3):
        for j in range(k):
            white[k] = white[k] - spread[k][j] * white[j]
    for k in range(3):
        white[k] = white[k] * spread[k][k].root()
        distance2 = distance2 + white[k] * white[k]
    gain = [solved(spread, covariance[i][:3]) for i in range(6)]
    change = [gain[i][0] * innovation[0] + gain[i][1] * innovation[1] + gain[i][2] * innovation[2] for i in range(6)]
    left = [[ONE if i == j else ZERO for j in range(6)] for i in range(6)]
    wide = [[ZERO] * 6 for _ in range(6)]
    for i in range(6):
        for j in range(3):
            left[i][j] = left[i][j] - gain[i][j]
            for k in range(3):
                wide[i][j] = wide[i][j] + gain[i][k] * noise[k][j]
    added = [
        [wide[i][0] * gain[j][0] + wide[i][1] * gain[j][1] + wide[i][2] * gain[j][2] for j in range(6)]
        for i in range(6)
    ]
    after = _transformed(left, covariance, added)
    if factorised([list(row) for row in after]) is None:
        for i in range(3, 6):  # nothing but rounding is left of them
            after[i][i] = after[i][i] + covariance[i][i].scaled(_ROUNDING + 6)
    return Correction(distance2, white, change, after)


def _transformed(a: Matrix, p: Matrix, added: Matrix) -> Matrix:
    """A P Aᵀ and a symmetric matrix, all (6, 6).

    A share of 2⁻²⁸ of the terms (2⁻²⁴ in single precision) is added to the variances, in which the roundings of all are
    lost: where an attitude is far better known than predicted, a variance of the rate could become negative.
    """
    first = [[_row(a[i], [p[k][j] for k in range(6)]) for j in range(6)] for i in range(6)]
    made = _symmetric([[_row(first[i], a[j]) + added[i][j] for j in range(6)] for i in range(6)])
    for i in range(6):
        terms = ZERO
        for k in range(6):
            terms = terms + a[i][k] * a[i][k] * p[k][k]
        made[i][i] = made[i][i] + terms.scaled(_ROUNDING)
    return made


def _row(a: Vector, b: Vector) -> Real:
    total = ZERO
    for x, y in zip(a, b, strict=True):
        total = total + x * y
    return total


def _symmetric(a: Matrix) -> Matrix:
    return [[_HALF * (a[i][j] + a[j][i]) for j in range(6)] for i in range(6)]


# ------------------------------------------------------------------ quaternions of 2.30
def product(second: list[int], first: list[int]) -> list[int]:
    """Quaternion (4,) of a rotation after another (`startracker.geometry.attitude.quat_multiply`)."""
    x1, y1, z1, w1 = second
    x2, y2, z2, w2 = first
    return [
        (w1 * x2 + x1 * w2 - y1 * z2 + z1 * y2) >> 30,
        (w1 * y2 + y1 * w2 - z1 * x2 + x1 * z2) >> 30,
        (w1 * z2 + z1 * w2 - x1 * y2 + y1 * x2) >> 30,
        (w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2) >> 30,
    ]


def turned_quaternion(quaternion: list[int], angle: Vector) -> list[int]:
    """Unit quaternion (4,) of the frame after a rotation vector (3,) in its own axes, up to three radians."""
    half = [value.scaled(-ANGLE_BITS - 1) for value in angle]
    square = half[0] * half[0] + half[1] * half[1] + half[2] * half[2]
    share = series(square, 1)
    turn = [(share * value).integer(30) for value in half]
    turn.append((ONE - square * series(square, 2)).integer(30))
    q = product(turn, quaternion)
    length = math.isqrt(sum(c * c for c in q))
    return [quotient(c * _ONE, length) for c in q]


def rotation_between(first: list[int], second: list[int]) -> Vector:
    """Rotation vector (3,) from one attitude to another, quaternions (4,), in the axes of the first one's frame."""
    x, y, z = first[:3]
    q = product(second, [-x, -y, -z, first[3]])
    sign = -1 if q[3] < 0 else 1
    vector = [Real(sign * c, -30) for c in q[:3]]
    sine = (vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2]).root()
    share = Real(2)
    if sine > ZERO:
        share = arctangent(sine, Real(abs(q[3]), -30)).scaled(1) / sine
    return [(share * value).scaled(ANGLE_BITS) for value in vector]
