"""Attitude: a unit quaternion between two named frames, and the kernels it stands on.

Convention: the quaternion is scalar last, (x, y, z, w), and *rotates coordinates* of a vector given in the source
frame into the target frame, ``v_target = A @ v_source`` with ``A = attitude.as_matrix()``. By default the source is
ICRS and the target the camera (+z boresight, +x along increasing column, +y along increasing row).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker.errors import FrameMismatchError, InputError

__all__ = [
    "Attitude",
    "direction_to_radec",
    "matrix_to_quat",
    "quat_multiply",
    "quat_to_matrix",
    "radec_to_direction",
    "rotation_vector_to_matrix",
]

FloatArray = NDArray[np.float64]


def radec_to_direction(ra_rad: ArrayLike, dec_rad: ArrayLike) -> FloatArray:
    """Unit vectors, shape (..., 3), of right ascension and declination in radians."""
    ra, dec = np.asarray(ra_rad, dtype=float), np.asarray(dec_rad, dtype=float)
    return np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=-1)


def direction_to_radec(direction: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Right ascension in [0, 2π) and declination, radians, of vectors of shape (..., 3) and any length."""
    x, y, z = np.moveaxis(np.asarray(direction, dtype=float), -1, 0)
    ra = np.arctan2(y, x)
    # adding 2π to a tiny negative angle rounds to 2π itself, which is outside the half-open range
    ra = np.where(ra < 0.0, ra + 2.0 * np.pi, ra)
    ra = np.where(ra >= 2.0 * np.pi, 0.0, ra) + 0.0  # -0.0 becomes 0.0
    return ra, np.arctan2(z, np.hypot(x, y))


def quat_to_matrix(quat: FloatArray) -> FloatArray:
    """Rotation matrix (3, 3) of a unit quaternion (x, y, z, w), coordinates of source into target frame.

    Markley & Crassidis 2014, *Fundamentals of Spacecraft Attitude Determination and Control*, eq. 2.125.
    """
    x, y, z, w = quat
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)],
            [2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)],
            [2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def matrix_to_quat(matrix: FloatArray) -> FloatArray:
    """Unit quaternion (x, y, z, w) with w ≥ 0 of a rotation matrix; well conditioned for every angle.

    Shepperd's method: the largest of the four candidates is divided by, never a small one
    (Markley & Crassidis 2014, section 2.9.3).
    """
    m = matrix
    trace = m[0, 0] + m[1, 1] + m[2, 2]
    squares = np.array([1 + 2 * m[0, 0] - trace, 1 + 2 * m[1, 1] - trace, 1 + 2 * m[2, 2] - trace, 1 + trace])
    rows = np.array(
        [
            [squares[0], m[0, 1] + m[1, 0], m[0, 2] + m[2, 0], m[1, 2] - m[2, 1]],
            [m[0, 1] + m[1, 0], squares[1], m[1, 2] + m[2, 1], m[2, 0] - m[0, 2]],
            [m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], squares[2], m[0, 1] - m[1, 0]],
            [m[1, 2] - m[2, 1], m[2, 0] - m[0, 2], m[0, 1] - m[1, 0], squares[3]],
        ]
    )
    row = rows[int(np.argmax(squares))]
    quat: FloatArray = row / math.sqrt(float(row @ row))
    return -quat if quat[3] < 0 else quat


def quat_multiply(second: FloatArray, first: FloatArray) -> FloatArray:
    """Quaternion of ``quat_to_matrix(second) @ quat_to_matrix(first)`` (Markley & Crassidis 2014, eq. 2.82a)."""
    x1, y1, z1, w1 = second
    x2, y2, z2, w2 = first
    return np.array(
        [
            w1 * x2 + x1 * w2 - y1 * z2 + z1 * y2,
            w1 * y2 + y1 * w2 - z1 * x2 + x1 * z2,
            w1 * z2 + z1 * w2 - x1 * y2 + y1 * x2,
            w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
        ]
    )


def rotation_vector_to_matrix(vector: ArrayLike) -> FloatArray:
    """Matrix turning *coordinates* when the frame turns by the rotation vector (radians, right-handed, any angle)."""
    theta = np.asarray(vector, dtype=float)
    angle = math.sqrt(float(theta @ theta))
    half_sinc = 0.5 * np.sinc(angle / (2 * math.pi))
    return quat_to_matrix(np.append(theta * half_sinc, math.cos(angle / 2)))


@dataclass(frozen=True, eq=False)
class Attitude:
    """Orientation of one frame against another.

    Parameters
    ----------
    quat : array_like, shape (4,)
        Quaternion, scalar last; normalised on creation. `InputError` when it is zero or not finite.
    source, target : str
        Names of the frames. Composition checks that they join.
    """

    quat: FloatArray
    source: str = field(default="icrs")
    target: str = field(default="camera")

    def __post_init__(self) -> None:
        quat = np.array(self.quat, dtype=float)
        largest = float(np.abs(quat).max()) if quat.shape == (4,) else math.nan
        if not (math.isfinite(largest) and largest > 0):
            raise InputError(f"an attitude needs a finite quaternion (x, y, z, w) that is not zero; got {self.quat}")
        quat /= largest  # so that squares neither overflow nor vanish
        quat /= math.sqrt(float(quat @ quat))
        if quat[3] < 0:
            quat = -quat
        quat.flags.writeable = False
        object.__setattr__(self, "quat", quat)

    # ------------------------------------------------------------------ made from
    @classmethod
    def from_matrix(cls, matrix: ArrayLike, source: str = "icrs", target: str = "camera") -> Attitude:
        """Attitude of a proper rotation matrix, ``v_target = matrix @ v_source``."""
        m = np.asarray(matrix, dtype=float)
        if m.shape != (3, 3) or not np.allclose(m @ m.T, np.eye(3), atol=1e-6) or np.linalg.det(m) < 0:
            raise InputError("an attitude matrix must be 3×3, orthogonal and of determinant +1")
        return cls(matrix_to_quat(m), source, target)

    @classmethod
    def from_radec_roll(cls, ra_deg: float, dec_deg: float, roll_deg: float = 0.0) -> Attitude:
        """Camera attitude from the boresight's RA and Dec and the roll, all in degrees.

        The roll is the position angle of the camera's up axis (−y), east of north.
        """
        ra, dec, roll = math.radians(ra_deg), math.radians(dec_deg), math.radians(roll_deg)
        boresight = radec_to_direction(ra, dec)
        north = np.array([-math.sin(dec) * math.cos(ra), -math.sin(dec) * math.sin(ra), math.cos(dec)])
        east = np.array([-math.sin(ra), math.cos(ra), 0.0])
        up = math.cos(roll) * north + math.sin(roll) * east
        return cls.from_matrix(np.stack([np.cross(-up, boresight), -up, boresight]))

    @classmethod
    def from_rotation_vector(cls, vector_rad: ArrayLike, source: str, target: str) -> Attitude:
        """Attitude of the frame reached by turning the source frame by a rotation vector (radians)."""
        return cls(matrix_to_quat(rotation_vector_to_matrix(vector_rad)), source, target)

    # ------------------------------------------------------------------ given as
    def as_quat(self) -> FloatArray:
        """Unit quaternion (x, y, z, w), w ≥ 0; read-only."""
        return self.quat

    def as_matrix(self) -> FloatArray:
        """Matrix A (3, 3) with ``v_target = A @ v_source``."""
        return quat_to_matrix(self.quat)

    @property
    def boresight(self) -> FloatArray:
        """Unit vector of the target frame's +z axis in the source frame."""
        axis: FloatArray = self.as_matrix()[2]
        return axis

    @property
    def ra_deg(self) -> float:
        """Right ascension of the boresight, degrees in [0, 360)."""
        return math.degrees(float(direction_to_radec(self.boresight)[0]))

    @property
    def dec_deg(self) -> float:
        """Declination of the boresight, degrees."""
        return math.degrees(float(direction_to_radec(self.boresight)[1]))

    @property
    def roll_deg(self) -> float:
        """Position angle of the camera's up axis (−y) at the boresight, east of north, degrees in [0, 360).

        At a celestial pole north is the limit along the meridian of `ra_deg`.
        """
        matrix = self.as_matrix()
        ra, dec = (float(angle) for angle in direction_to_radec(matrix[2]))
        north = np.array([-math.sin(dec) * math.cos(ra), -math.sin(dec) * math.sin(ra), math.cos(dec)])
        east = np.array([-math.sin(ra), math.cos(ra), 0.0])
        roll = math.degrees(math.atan2(float(-matrix[1] @ east), float(-matrix[1] @ north))) % 360.0
        return 0.0 if roll >= 360.0 else roll

    # ------------------------------------------------------------------ put together
    @property
    def inverse(self) -> Attitude:
        """The way back: target into source."""
        return Attitude(self.quat * np.array([-1.0, -1.0, -1.0, 1.0]), self.target, self.source)

    def __matmul__(self, other: Attitude) -> Attitude:
        """``self @ other``: first `other`, then `self`; `FrameMismatchError` when their frames do not join."""
        if other.target != self.source:
            raise FrameMismatchError(
                f"cannot join {other.source} → {other.target} with {self.source} → {self.target}: "
                f"'{other.target}' is not '{self.source}'"
            )
        return Attitude(quat_multiply(self.quat, other.quat), other.source, self.target)

    def apply(self, vectors: ArrayLike) -> FloatArray:
        """Vectors of shape (..., 3) from the source into the target frame."""
        return np.asarray(vectors, dtype=float) @ self.as_matrix().T

    def rotation_vector_to(self, other: Attitude) -> FloatArray:
        """Rotation vector (3,), radians, in target axes, that takes this attitude to `other`.

        With `self` the truth and `other` an estimate this is the attitude error. Its length is in [0, π].
        """
        if (self.source, self.target) != (other.source, other.target):
            raise FrameMismatchError(
                f"{self.source} → {self.target} and {other.source} → {other.target} cannot be compared"
            )
        x, y, z, w = quat_multiply(other.quat, self.inverse.quat)
        vector = np.array([x, y, z]) * (1.0 if w >= 0 else -1.0)
        sine = math.sqrt(float(vector @ vector))
        angle = 2.0 * math.atan2(sine, abs(float(w)))
        return vector * (angle / sine if sine > 0 else 2.0)

    def angle_to(self, other: Attitude) -> float:
        """Angle of the rotation between two attitudes, radians."""
        return float(np.linalg.norm(self.rotation_vector_to(other)))

    def __repr__(self) -> str:
        if (self.source, self.target) == ("icrs", "camera"):
            return f"Attitude(ra={self.ra_deg:.5f}°, dec={self.dec_deg:+.5f}°, roll={self.roll_deg:.5f}°)"
        return f"Attitude({self.source} → {self.target}, quat={np.array2string(self.quat, precision=6)})"
