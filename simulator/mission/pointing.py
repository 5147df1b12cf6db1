"""Attitude and rate of the camera: local level → body (offset, random error) → camera (mounting).

Local level (also the nominal body): +X along the velocity, +Y = minus the orbit normal, +Z to the centre of the
trajectory, which is the Earth's for an orbit around it.
Angles about X, Y, Z are roll, pitch, yaw, the components of one rotation vector.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from simulator.mission.attitude_law import AttitudeLaw, law_attitude, law_rate_rad_s
from simulator.mission.frames import true_of_date
from simulator.mission.parameters import PointingParameters
from simulator.mission.spin import spin_attitude, spin_rate_rad_s
from simulator.mission.trajectory import Trajectory
from startracker.core import FloatArray
from startracker.display import fields_repr
from startracker.errors import InputError
from startracker.geometry.attitude import Attitude, direction_to_radec
from startracker.settings.registry import lookup

_X, _Y, _Z = np.eye(3)


def _mounting(boresight: FloatArray, up: FloatArray) -> Attitude:
    """Body → camera: +z along `boresight`, −y along `up`, both in body axes."""
    return Attitude.from_matrix(np.stack([np.cross(-up, boresight), -up, boresight]), "body", "camera")


MOUNTINGS: dict[str, Attitude] = {
    "orbit_normal": _mounting(boresight=_Y, up=-_Z),
    "anti_orbit_normal": _mounting(boresight=-_Y, up=-_Z),
    "zenith": _mounting(boresight=-_Z, up=_X),
    "forward": _mounting(boresight=_X, up=-_Z),
    "backward": _mounting(boresight=-_X, up=-_Z),
}
"""Body → camera by name. The camera's up direction (−y) is the zenith, for ``zenith`` the velocity. ``orbit_normal`` is
the reference mounting, along +Y, which is *minus* the angular momentum (Greyling 1995, section 3.2)."""


@dataclass(frozen=True, eq=False)
class Pointing:
    """Attitude at mid-exposure."""

    body: Attitude
    """True attitude ICRS → body."""
    camera: Attitude
    """True attitude ICRS → camera."""
    prior: Attitude
    """ICRS → camera without the random error, as known from other sensors."""
    mounting: Attitude
    """True body → camera."""
    rate_camera_rad_s: FloatArray
    """(3,): Inertial angular velocity in camera axes."""
    mounting_rotation_rad: FloatArray | None = None
    """(3,): Rotation vector from the nominal to the true mounting, camera axes; None if they are the same."""

    __repr__ = fields_repr


def mounting_of(parameters: PointingParameters) -> Attitude:
    """Body → camera of parameters: by name, or its quaternion (x, y, z, w).

    Raises
    ------
    InputError
        For an unknown name, or a quaternion that is zero.
    """
    return _mounting_of(parameters.mounting)


@functools.lru_cache(maxsize=16)
def _mounting_of(mounting: str | tuple[float, ...]) -> Attitude:
    if isinstance(mounting, str):
        return lookup("mountings", MOUNTINGS, mounting)
    return Attitude(np.array(mounting), "body", "camera")


def local_level(r_km: ArrayLike, v_km_s: ArrayLike) -> Attitude:
    """Attitude ICRS → local level from position and velocity (3,) relative to the centre, in GCRS axes.

    Z = −r/|r|, Y = −(r × v)/|r × v|, X = Y × Z: the velocity component perpendicular to Z (Wertz 1978, *Spacecraft
    Attitude Determination and Control*, section 2.2).

    Raises
    ------
    InputError
        If position and velocity are parallel.
    """
    return _local_level(r_km, v_km_s)[0]


def _local_level(r_km: ArrayLike, v_km_s: ArrayLike) -> tuple[Attitude, float]:
    """`local_level`, and its rate |r × v| / r², rad/s."""
    r, v = np.asarray(r_km, dtype=float), np.asarray(v_km_s, dtype=float)
    # This runs for every frame and every step of a motion; Python floats take a tenth of the time of NumPy's calls.
    (x, y, z), (vx, vy, vz) = r.tolist(), v.tolist()
    momentum = (y * vz - z * vy, z * vx - x * vz, x * vy - y * vx)
    distance, turn = math.hypot(x, y, z), math.hypot(*momentum)
    if not turn > 1e-9 * distance * math.hypot(vx, vy, vz):
        raise InputError(f"no local level: position {r} km and velocity {v} km/s are parallel")
    # (a, b, c) is Y, the negative orbit normal, (d, e, f) is Z, towards the centre, and the first row is Y × Z.
    (a, b, c), (d, e, f) = (h / -turn for h in momentum), (x / -distance, y / -distance, z / -distance)
    matrix = np.array([[b * f - c * e, c * d - a * f, a * e - b * d], [a, b, c], [d, e, f]])
    return Attitude.from_matrix(matrix, "icrs", "local_level"), turn / distance**2


def point(parameters: PointingParameters, r_km: FloatArray, v_km_s: FloatArray, rng: np.random.Generator) -> Pointing:
    """Attitude and rate of a spacecraft in local-level attitude at a position and velocity (3,) in GCRS.

    The body is rotated from the local level by the fixed `offset_deg`, and then about its own axes by a random rotation
    vector with components uniform within ±`error_deg`. Its inertial rate is that of the local level, ω = r × v / r² =
    (0, −n, 0) in local-level axes, plus `rate_deg_s` in body axes.

    Parameters
    ----------
    parameters : PointingParameters
        Mounting, offset, error, rate.
    r_km, v_km_s : array, shape (3,)
        State of the spacecraft.
    rng : Generator
        Draws three uniform numbers, whatever the parameters.

    Raises
    ------
    InputError
        For an unknown mounting, or a state without an orbital plane.
    """
    level, orbital_rate = _local_level(r_km, v_km_s)
    return _pointing(parameters, _offset(parameters) @ level, _level_rate(orbital_rate), rng.uniform(-1.0, 1.0, 3))


def point_at_random(
    parameters: PointingParameters, rng: np.random.Generator, orbital_rate_rad_s: float = 0.0
) -> Pointing:
    """`point` with a uniformly random nominal camera attitude instead of the local level.

    Offset, error and rates act as in orbit: the reference, a random frame, rotates at (0, −`orbital_rate_rad_s`, 0).
    The generator draws three numbers for the error, then three for the attitude.
    """
    draws = rng.uniform(-1.0, 1.0, 3)  # before the attitude, so that the error is that of other samplings
    nominal = mounting_of(parameters).inverse @ random_attitude(rng)
    return _pointing(parameters, nominal, _level_rate(orbital_rate_rad_s), draws)


def point_spinning(parameters: PointingParameters, t_s: float, rng: np.random.Generator) -> Pointing:
    """`point` for a freely spinning body (`simulator.mission.spin`), `t_s` seconds after the epoch.

    Its principal axes replace the local level: offset, random error and `rate_deg_s` are added.
    """
    nominal = _offset(parameters) @ spin_attitude(parameters.spin, t_s)
    return _pointing(parameters, nominal, spin_rate_rad_s(parameters.spin, t_s), rng.uniform(-1.0, 1.0, 3))


def point_by(parameters: PointingParameters, law: AttitudeLaw, t_s: float, rng: np.random.Generator) -> Pointing:
    """`point` for a body that follows an attitude law, `t_s` seconds after the epoch.

    The axes of the law replace the local level: offset, random error and `rate_deg_s` are added.
    """
    nominal = _offset(parameters) @ law_attitude(law, t_s)
    return _pointing(parameters, nominal, law_rate_rad_s(law, t_s), rng.uniform(-1.0, 1.0, 3))


def round_s(parameters: PointingParameters, orbital_period_s: float) -> float:
    """Time after which pointing repeats: one rotation of a spinning body, otherwise one orbit."""
    rate_deg_s = parameters.spin.rate_deg_s
    return 360.0 / abs(rate_deg_s) if rate_deg_s else orbital_period_s


def hold(parameters: PointingParameters, camera: Attitude, rng: np.random.Generator) -> Pointing:
    """`point` with an inertially fixed nominal camera attitude (ICRS → camera): the only rate is `rate_deg_s`."""
    return _pointing(parameters, mounting_of(parameters).inverse @ camera, np.zeros(3), rng.uniform(-1.0, 1.0, 3))


def turned_to(pointing: Pointing, camera: Attitude, rate_camera_rad_s: ArrayLike | None = None) -> Pointing:
    """The same spacecraft with another true camera attitude. The error of the prior is unchanged, and so is the rate in
    camera axes unless one is given."""
    error = pointing.camera @ pointing.prior.inverse
    rate = pointing.rate_camera_rad_s if rate_camera_rad_s is None else np.array(rate_camera_rad_s, dtype=float)
    return replace(
        pointing,
        body=pointing.mounting.inverse @ camera,
        camera=camera,
        prior=error.inverse @ camera,
        rate_camera_rad_s=rate,
    )


def deformed(pointing: Pointing, rotation_rad: FloatArray | None) -> Pointing:
    """The same body with its mounting and camera rotated by a rotation vector (3,) in camera axes.

    The prior is not rotated, because the spacecraft does not know of the deformation. The rate of the rotation is
    neglected (0.05″/s for 50″ in a low orbit).
    """
    if rotation_rad is None:
        return pointing
    turn = Attitude.from_rotation_vector(rotation_rad, "camera", "camera")
    return replace(
        pointing,
        camera=turn @ pointing.camera,
        mounting=turn @ pointing.mounting,
        rate_camera_rad_s=turn.apply(pointing.rate_camera_rad_s),
        mounting_rotation_rad=rotation_rad,
    )


def attitude_at(pointing: Pointing, dt_s: float) -> Attitude:
    """True camera attitude `dt_s` seconds from mid-exposure: A(t + dt) = exp(−[ω×] dt) A(t).

    Constant rate in camera axes; exact in local-level attitude, otherwise accurate to ω² dt² times the angle by which
    the body rotates relative to the local level.
    """
    turn = Attitude.from_rotation_vector(pointing.rate_camera_rad_s * dt_s, "camera", "camera")
    return turn @ pointing.camera


def random_attitude(rng: np.random.Generator) -> Attitude:
    """Attitude uniform over all rotations (Shoemake 1992, "Uniform random rotations", *Graphics Gems III*)."""
    u, a, b = rng.random(3)
    a, b = 2.0 * math.pi * a, 2.0 * math.pi * b
    outer, inner = math.sqrt(1.0 - u), math.sqrt(u)
    quat = np.array([outer * math.sin(a), outer * math.cos(a), inner * math.sin(b), inner * math.cos(b)])
    return Attitude(quat, "icrs", "camera")


@dataclass(frozen=True, eq=False)
class BoresightPath:
    """Path of the nominal boresight; arrays of the shape of the times, degrees, right ascension in [0, 360)."""

    ra_deg: FloatArray
    """Right ascension, ICRS."""
    dec_deg: FloatArray
    """Declination, ICRS."""
    ra_date_deg: FloatArray
    """Right ascension, true equator and equinox of date, to which the orbit's node and inclination refer."""
    dec_date_deg: FloatArray
    """Declination, true equator of date."""


def boresight_path(orbit: Trajectory, parameters: PointingParameters, t_s: ArrayLike) -> BoresightPath:
    """Geometric path over the sky without the random error, at seconds since the epoch, an array of any shape."""
    t = np.asarray(t_s, dtype=float)
    in_level = (mounting_of(parameters) @ _offset(parameters)).boresight
    # The transposed matrix leads from the local level to GCRS.
    direction = np.einsum("...ji,j->...i", level_matrices(*orbit.state(t)), in_level)
    of_date = np.einsum("...ij,...j->...i", true_of_date(orbit.clock, t), direction)
    ra, dec = np.degrees(direction_to_radec(direction))
    ra_date, dec_date = np.degrees(direction_to_radec(of_date))
    return BoresightPath(ra, dec, ra_date, dec_date)


def level_matrices(r_km: FloatArray, v_km_s: FloatArray) -> FloatArray:
    """Matrices (..., 3, 3) from GCRS into the local level at positions and velocities (..., 3)."""
    momentum = np.cross(r_km, v_km_s)
    z = -r_km / np.linalg.norm(r_km, axis=-1, keepdims=True)
    y = -momentum / np.linalg.norm(momentum, axis=-1, keepdims=True)
    return np.stack([np.cross(y, z), y, z], axis=-2)


def _offset(parameters: PointingParameters) -> Attitude:
    """Local level → body, without the random error."""
    return _turned_by(parameters.offset_deg)


@functools.lru_cache(maxsize=64)
def _turned_by(offset_deg: tuple[float, float, float]) -> Attitude:
    return Attitude.from_rotation_vector(np.radians(offset_deg), "local_level", "body")


def _level_rate(orbital_rate_rad_s: float) -> FloatArray:
    """Angular velocity of the local level in its own axes."""
    return np.array([0.0, -orbital_rate_rad_s, 0.0])


def _pointing(parameters: PointingParameters, nominal: Attitude, level_rate: FloatArray, draws: FloatArray) -> Pointing:
    """Pointing with a random error about a nominal body attitude (ICRS → body).

    `level_rate` (3,) is the rate of the reference in its own axes; `draws` are three numbers uniform in [−1, 1).
    """
    mounting = mounting_of(parameters)
    error = Attitude.from_rotation_vector(math.radians(parameters.error_deg) * draws, mounting.source, mounting.source)
    body = error @ nominal
    # The rate of the reference is transformed to body axes, in which the body's own rate is given.
    rate_rad_s = error.apply(_offset(parameters).apply(level_rate)) + np.radians(parameters.rate_deg_s)
    return Pointing(
        body=body,
        camera=mounting @ body,
        prior=mounting @ nominal,
        mounting=mounting,
        rate_camera_rad_s=mounting.apply(rate_rad_s),
    )
