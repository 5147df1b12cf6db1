"""Attitude: a unit quaternion between two named frames, and the functions it is built on.

Convention: the quaternion is scalar last, (x, y, z, w), and *rotates coordinates* of a vector given in the source
frame into the target frame, ``v_target = A @ v_source`` with ``A = attitude.as_matrix()``. By default the source is
ICRS and the target the camera (+z boresight, +x along increasing column, +y along increasing row).
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from startracker.arguments import (
    is_rotation,
    is_skycoord,
    of_kind,
    real_array,
    real_number,
    rotation_quat,
    skycoord_deg,
    text,
)
from startracker.core import FloatArray
from startracker.errors import FrameMismatchError, InputError

_CONJUGATE = np.array([-1.0, -1.0, -1.0, 1.0])
_UNIT = 4.0 * np.finfo(float).eps
"""Largest deviation of a normalised quaternion's squared length from one: it is 3 eps in 200,000 random ones. A
quaternion within it is not normalised again, so that one written to a file is read back bit by bit."""


def radec_to_direction(ra_rad: ArrayLike, dec_rad: ArrayLike) -> FloatArray:
    """Unit vectors, shape (..., 3), from right ascension and declination in radians."""
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
    x, y, z, w = np.asarray(quat, dtype=float).tolist()  # Python floats take a tenth of the time of NumPy scalars
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)],
            [2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)],
            [2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def matrix_to_quat(matrix: FloatArray) -> FloatArray:
    """Unit quaternion (x, y, z, w) with w ≥ 0 of a rotation matrix; well conditioned at every angle.

    Shepperd's method: always divides by the largest of the four candidates (Markley & Crassidis 2014, section 2.9.3).
    """
    (a, b, c), (d, e, f), (g, h, i) = np.asarray(matrix, dtype=float).tolist()
    trace = a + e + i
    squares = (1 + 2 * a - trace, 1 + 2 * e - trace, 1 + 2 * i - trace, 1 + trace)
    largest = squares.index(max(squares))
    x, y, z, w = (
        (squares[0], b + d, c + g, f - h),
        (b + d, squares[1], f + h, g - c),
        (c + g, f + h, squares[2], b - d),
        (f - h, g - c, b - d, squares[3]),
    )[largest]
    length = math.sqrt(x * x + y * y + z * z + w * w)
    if w < 0:
        length = -length
    return np.array([x / length, y / length, z / length, w / length])


def quat_multiply(second: FloatArray, first: FloatArray) -> FloatArray:
    """Quaternion of ``quat_to_matrix(second) @ quat_to_matrix(first)`` (Markley & Crassidis 2014, eq. 2.82a)."""
    x1, y1, z1, w1 = np.asarray(second, dtype=float).tolist()
    x2, y2, z2, w2 = np.asarray(first, dtype=float).tolist()
    return np.array(
        [
            w1 * x2 + x1 * w2 - y1 * z2 + z1 * y2,
            w1 * y2 + y1 * w2 - z1 * x2 + x1 * z2,
            w1 * z2 + z1 * w2 - x1 * y2 + y1 * x2,
            w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
        ]
    )


def rotation_vector_to_matrix(vector: ArrayLike) -> FloatArray:
    """Matrix that transforms *coordinates* when the frame rotates by the vector (radians, right-handed, any angle)."""
    return quat_to_matrix(_rotation_vector_to_quat(vector))


def _rotation_vector_to_quat(vector: ArrayLike) -> FloatArray:
    """Quaternion (x, y, z, w) of `rotation_vector_to_matrix`; w < 0 for angles beyond π."""
    x, y, z = np.asarray(vector, dtype=float).tolist()
    angle = math.sqrt(x * x + y * y + z * z)
    half_sinc = math.sin(0.5 * angle) / angle if angle > 0.0 else 0.5
    return np.array([x * half_sinc, y * half_sinc, z * half_sinc, math.cos(0.5 * angle)])


@dataclass(frozen=True, eq=False)
class Attitude:
    """Orientation of one frame relative to another.

    Parameters
    ----------
    quat : array_like, shape (4,)
        Quaternion, scalar last; normalised on creation. `InputError` if it is zero or not finite.
    source, target : str
        Names of the frames. Composition checks that they match.
    """

    quat: FloatArray
    source: str = field(default="icrs")
    target: str = field(default="camera")

    def __post_init__(self) -> None:
        text("source", self.source)
        text("target", self.target)
        quat = real_array("an attitude's quaternion (x, y, z, w)", self.quat, finite=False).copy()
        x, y, z, w = quat.tolist() if quat.shape == (4,) else (math.nan,) * 4
        if not abs(x * x + y * y + z * z + w * w - 1.0) <= _UNIT:  # nearly all are normalised
            largest = max(abs(x), abs(y), abs(z), abs(w))
            finite = math.isfinite(x) and math.isfinite(y) and math.isfinite(z) and math.isfinite(w)
            if not (finite and largest > 0):
                raise InputError(f"an attitude needs a finite, non-zero quaternion (x, y, z, w); got {self.quat}")
            x, y, z, w = x / largest, y / largest, z / largest, w / largest  # no overflow or underflow of the squares
            length = math.sqrt(x * x + y * y + z * z + w * w)
            quat[0], quat[1], quat[2], quat[3] = x / length, y / length, z / length, w / length
        # q and −q are the same rotation; w ≥ 0 selects one of them.
        if w < 0.0:
            np.negative(quat, out=quat)
        quat.flags.writeable = False
        object.__setattr__(self, "quat", quat)

    # ------------------------------------------------------------------ construction
    @classmethod
    def from_matrix(cls, matrix: ArrayLike, source: str = "icrs", target: str = "camera") -> Attitude:
        """Attitude from a proper rotation matrix, ``v_target = matrix @ v_source``."""
        m = real_array("an attitude matrix", matrix, finite=False)
        if m.shape != (3, 3) or not _is_rotation(m):
            raise InputError("an attitude matrix must be 3×3 and orthogonal, with determinant +1")
        return cls(matrix_to_quat(m), source, target)

    @classmethod
    def from_radec_roll(cls, ra_deg: float, dec_deg: float, roll_deg: float = 0.0) -> Attitude:
        """Camera attitude from RA and Dec of the boresight and the roll, in degrees or as astropy quantities.

        The roll is the position angle of the camera's up axis (−y), east of north.
        """
        ra_deg, dec_deg = real_number("RA", ra_deg, unit="deg"), real_number("Dec", dec_deg, unit="deg")
        roll_deg = real_number("roll", roll_deg, unit="deg")
        ra, dec, roll = math.radians(ra_deg), math.radians(dec_deg), math.radians(roll_deg)
        boresight = radec_to_direction(ra, dec)
        north = np.array([-math.sin(dec) * math.cos(ra), -math.sin(dec) * math.sin(ra), math.cos(dec)])
        east = np.array([-math.sin(ra), math.cos(ra), 0.0])
        up = math.cos(roll) * north + math.sin(roll) * east
        return cls.from_matrix(np.stack([np.cross(-up, boresight), -up, boresight]))

    @classmethod
    def from_rotation_vector(cls, vector_rad: ArrayLike, source: str, target: str) -> Attitude:
        """Attitude of the frame that results from rotating the source frame by a rotation vector (radians, or an
        astropy quantity)."""
        vector = real_array("the rotation vector", vector_rad, (3,), unit="rad")
        return cls(_rotation_vector_to_quat(vector), source, target)

    @classmethod
    def from_rotation(cls, rotation: Any, source: str = "icrs", target: str = "camera") -> Attitude:
        """Attitude from a SciPy ``Rotation`` that transforms coordinates from the source to the target frame.

        ``v_target = rotation.apply(v_source)``; ``rotation.as_matrix()`` equals `as_matrix`. `InputError` for a stack
        of rotations.
        """
        return cls(rotation_quat(rotation), source, target)

    @classmethod
    def from_skycoord(cls, coordinate: Any, roll_deg: float = 0.0) -> Attitude:
        """Camera attitude whose boresight is an astropy ``SkyCoord`` in any frame that can be transformed to ICRS; roll
        as in `from_radec_roll`."""
        return cls.from_radec_roll(*skycoord_deg(coordinate, "the boresight"), roll_deg)

    # ------------------------------------------------------------------ conversion
    def as_quat(self) -> FloatArray:
        """Unit quaternion (x, y, z, w), w ≥ 0; read-only."""
        return self.quat

    def as_matrix(self) -> FloatArray:
        """Matrix A (3, 3) with ``v_target = A @ v_source``."""
        return self._matrix.copy()

    @property
    def rotation(self) -> Any:
        """SciPy ``Rotation`` with ``v_target = rotation.apply(v_source)``."""
        from scipy.spatial.transform import Rotation

        return Rotation.from_quat(self.quat * _CONJUGATE)

    @property
    def skycoord(self) -> Any:
        """The boresight as an astropy ``SkyCoord``, ICRS; `FrameMismatchError` if the source is another frame."""
        if self.source != "icrs":
            raise FrameMismatchError(
                f"{self.source} → {self.target} has no direction in the sky: its source frame is not ICRS"
            )
        from astropy.coordinates import SkyCoord

        return SkyCoord(self.ra_deg, self.dec_deg, unit="deg", frame="icrs")

    @functools.cached_property
    def _matrix(self) -> FloatArray:
        return quat_to_matrix(self.quat)

    @property
    def boresight(self) -> FloatArray:
        """Unit vector of the target frame's +z axis in the source frame."""
        axis: FloatArray = self._matrix[2].copy()
        return axis

    @property
    def ra_deg(self) -> float:
        """Right ascension of the boresight, degrees in [0, 360)."""
        x, y, _ = self._matrix[2].tolist()
        return math.degrees(_right_ascension(x, y))

    @property
    def dec_deg(self) -> float:
        """Declination of the boresight, degrees."""
        x, y, z = self._matrix[2].tolist()
        return math.degrees(math.atan2(z, math.hypot(x, y)))

    @property
    def roll_deg(self) -> float:
        """Position angle of the camera's up axis (−y) at the boresight, east of north, degrees in [0, 360).

        At a celestial pole, north is the limit along the meridian of `ra_deg`.
        """
        _, (a, b, c), (x, y, z) = self._matrix.tolist()
        ra, across = _right_ascension(x, y), math.hypot(x, y)  # cos Dec; sin Dec is z
        north = z * (math.cos(ra) * a + math.sin(ra) * b) - across * c
        east = math.sin(ra) * a - math.cos(ra) * b
        roll = math.degrees(math.atan2(east, north)) % 360.0
        return 0.0 if roll >= 360.0 else roll

    # ------------------------------------------------------------------ composition
    @property
    def inverse(self) -> Attitude:
        """The inverse: from target to source."""
        return Attitude(self.quat * _CONJUGATE, self.target, self.source)

    def __matmul__(self, other: Attitude) -> Attitude:
        """``self @ other``: first `other`, then `self`; `FrameMismatchError` if their frames do not match."""
        of_kind("what precedes an attitude", other, Attitude, "apply transforms vectors")
        if other.target != self.source:
            raise FrameMismatchError(
                f"cannot compose {other.source} → {other.target} with {self.source} → {self.target}: "
                f"'{other.target}' is not '{self.source}'"
            )
        return Attitude(quat_multiply(self.quat, other.quat), other.source, self.target)

    def apply(self, vectors: ArrayLike) -> FloatArray:
        """Transform vectors of shape (..., 3) from the source to the target frame."""
        array = real_array("vectors", vectors, finite=False)
        if array.ndim == 0 or array.shape[-1] != 3:
            raise InputError(f"vectors must have the shape (..., 3); got {array.shape}")
        return array @ self._matrix.T

    def rotation_vector_to(self, other: Attitude) -> FloatArray:
        """Rotation vector (3,), radians, in target axes, from this attitude to `other`.

        If `self` is the truth and `other` an estimate, this is the attitude error. Its length is in [0, π].
        """
        of_kind("what is compared with an attitude", other, Attitude)
        if (self.source, self.target) != (other.source, other.target):
            raise FrameMismatchError(
                f"{self.source} → {self.target} and {other.source} → {other.target} cannot be compared"
            )
        x, y, z, w = quat_multiply(other.quat, self.quat * _CONJUGATE).tolist()
        sine = math.sqrt(x * x + y * y + z * z)
        # The arc tangent is accurate for small and large angles, unlike the arc cosine of w.
        angle = 2.0 * math.atan2(sine, abs(w))
        scale = (angle / sine if sine > 0 else 2.0) * (1.0 if w >= 0 else -1.0)
        return np.array([x * scale, y * scale, z * scale])

    def angle_to(self, other: Attitude) -> float:
        """Angle of the rotation between two attitudes, radians."""
        return math.hypot(*self.rotation_vector_to(other).tolist())

    def __repr__(self) -> str:
        if (self.source, self.target) == ("icrs", "camera"):
            return f"Attitude(ra={self.ra_deg:.5f}°, dec={self.dec_deg:+.5f}°, roll={self.roll_deg:.5f}°)"
        return f"Attitude({self.source} → {self.target}, quat={np.array2string(self.quat, precision=6)})"


def camera_attitude(name: str, given: Any) -> Attitude:
    """Argument as an attitude from ICRS to the camera; a SciPy ``Rotation`` is taken as one.

    Raises
    ------
    InputError
        For anything else, an attitude between other frames included.
    """
    if is_rotation(given):
        return Attitude.from_rotation(given)
    if is_skycoord(given):
        raise InputError(f"{name}: a SkyCoord has no roll; give {name}=Attitude.from_skycoord(coordinate, roll_deg)")
    made_by = "Attitude.from_matrix, from_radec_roll or from_rotation_vector make one"
    attitude = of_kind(name, given, Attitude, made_by)
    if (attitude.source, attitude.target) != ("icrs", "camera"):
        raise InputError(f"{name} must be from icrs to camera; got {attitude.source} → {attitude.target}")
    return attitude


def _is_rotation(matrix: FloatArray) -> bool:
    """Whether a matrix (3, 3) is orthogonal, to 1e-5 in the lengths of its rows, with a positive determinant."""
    (a, b, c), (d, e, f), (g, h, i) = matrix.tolist()
    one, two, three = a * a + b * b + c * c, d * d + e * e + f * f, g * g + h * h + i * i
    square = abs(one - 1.0) <= 1.1e-5 and abs(two - 1.0) <= 1.1e-5 and abs(three - 1.0) <= 1.1e-5
    slants = abs(a * d + b * e + c * f), abs(a * g + b * h + c * i), abs(d * g + e * h + f * i)
    determinant = a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g)
    return bool(square and max(slants) <= 1e-6 and determinant > 0.0)


def _right_ascension(x: float, y: float) -> float:
    """Angle of (x, y) from +x towards +y, radians in [0, 2π)."""
    angle = math.atan2(y, x)
    if angle < 0.0:
        angle += 2.0 * math.pi
    return 0.0 if angle >= 2.0 * math.pi else angle + 0.0  # a tiny negative angle rounds to 2π; also avoids −0.0
