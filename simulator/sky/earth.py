"""The Earth in and near the field: occultation, and the brightness of its lit side and limb.

The Earth is a sphere with the equatorial radius (WGS 84; the poles are 21 km lower, 0.4° at the limb from 800 km) and a
Lambertian surface, with single scattering in the atmosphere. Directions are ICRS, positions GCRS.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulator.constants import EARTH_RADIUS_KM
from simulator.optics.bodies import LAW_OF_BODY, share_before_limb
from simulator.sky.instants import EARTH_DISK_KM, Bodies
from simulator.sky.magnitudes import sun_v
from startracker._compiled import kernel, kernel_part
from startracker.core import BoolArray, FloatArray
from startracker.geometry.attitude import Attitude
from startracker.geometry.camera import Camera

if TYPE_CHECKING:
    from simulator.sky.parameters import Sky

SUN_S10_SR = 10.0 ** (-0.4 * (sun_v(1.0) - 10.0)) * math.radians(1.0) ** 2
"""Brightness in S10 of the Sun's light at 1 au spread over one steradian: 1.51e11."""

SCALE_HEIGHT_KM = 7.1
"""Scale height of the atmosphere: reproduces the density of the US Standard Atmosphere 1976 at 30, 50 and 80 km
(1.5e-2, 8.4e-4, 1.5e-5 of that at the ground) to 20 %; at lower altitudes the density falls more slowly."""

RAYLEIGH_DEPTH = 0.098
"""Vertical molecular optical depth at 550 nm, sea level; Bucholtz 1995 (Appl. Opt. 34, 2765) 0.0973, Hansen &
Travis 1974 (Space Sci. Rev. 16, 527) 0.0978."""

ATMOSPHERE_TOP_KM = 180.0
"""Altitude above which the limb is fainter than 1 S10 and is not rendered."""

_AIR_MASSES = math.sqrt(2.0 * math.pi * EARTH_RADIUS_KM / SCALE_HEIGHT_KM)
"""Ratio of the optical depth of a grazing ray to the vertical one: Chapman's √(2πR/H) = 75.1."""


def has_disk(sky: Sky, r_km: ArrayLike) -> bool:
    """Whether the Earth is rendered with surface and limb. It is not if `Sky.earth` is off, nor beyond
    `simulator.sky.instants.EARTH_DISK_KM`, where it is one of the bodies."""
    return sky.earth and math.hypot(*np.asarray(r_km, dtype=float).tolist()) < EARTH_DISK_KM


def angular_radius_rad(r_km: ArrayLike) -> float:
    """Angle between the Earth's centre and its horizon, arcsin(R/r), at a position (3,); 90° on the ground."""
    return math.asin(min(EARTH_RADIUS_KM / math.hypot(*np.asarray(r_km, dtype=float).tolist()), 1.0))


def occulted(directions: ArrayLike, r_km: ArrayLike) -> BoolArray:
    """Whether the solid Earth occults objects at infinity in directions (N, 3).

    Refraction is neglected: it displaces a star at the limb by up to 1.2°, but also spreads its light over this angle.

    Parameters
    ----------
    directions : array_like, shape (N, 3)
        Unit vectors.
    r_km : array_like, shape (3,)
        Position of the spacecraft from the Earth's centre.
    """
    r = np.asarray(r_km, dtype=float)
    cosine = np.atleast_2d(np.asarray(directions, dtype=float)) @ (r / -math.hypot(*r.tolist()))
    return np.asarray(cosine > math.cos(angular_radius_rad(r)))


def limbs(directions: ArrayLike, radius_rad: ArrayLike, r_km: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """The Earth's limb on the disks of bodies.

    On the sphere the limb is a circle of radius ρ about the nadir with geodesic curvature cot ρ. On a disk of radius
    a ≪ ρ whose centre is at D from the nadir, with t the distance towards the nadir and p perpendicular to it, in
    radii, the Earth occults t > (D − ρ)/a + ½ a cot ρ p².

    Parameters
    ----------
    directions : array_like, shape (N, 3)
        Unit vectors of the disks' centres.
    radius_rad : array_like, shape (N,)
        Their radii.
    r_km : array_like, shape (3,)
        Position of the spacecraft.

    Returns
    -------
    offset, curvature : (N,) arrays
        (D − ρ)/a and a cot ρ. The disk is free if the offset is 1 or more, and occulted if it is −1 or less.
    """
    r = np.asarray(r_km, dtype=float)
    radius = np.maximum(np.asarray(radius_rad, dtype=float), 1e-9)
    horizon = angular_radius_rad(r)
    away = np.arccos(np.clip(np.atleast_2d(directions) @ (r / -math.hypot(*r.tolist())), -1.0, 1.0))  # from the nadir
    return (away - horizon) / radius, radius * math.cos(horizon) / math.sin(horizon)


def unhidden(bodies: Bodies, r_km: ArrayLike, sun_direction: ArrayLike, sky: Sky) -> FloatArray:
    """Fraction (N,) of the light of Sun, Moon and planets that the Earth does not occult; between 0 and 1 if its limb
    crosses the disk, as in the penumbra.

    The brightness over the disk follows its phase and scattering law (`simulator.optics.bodies`).
    """
    if not has_disk(sky, r_km) or not len(bodies):
        return np.ones(len(bodies))
    offset, curvature = limbs(bodies.direction, bodies.angular_radius_rad, r_km)
    # Only a disk that the limb crosses needs the integral over its brightness.
    share = (offset > 0.0).astype(float)
    nadir = -np.asarray(r_km, dtype=float)
    for k in np.flatnonzero(np.abs(offset) < 1.0):
        lit = float(bodies.illuminated_fraction[k]) if sky.phases else 1.0
        between = _angle_at(bodies.direction[k], np.asarray(sun_direction, dtype=float), nadir)
        law = LAW_OF_BODY.get(str(bodies.name[k]), "lambert")
        share[k] = share_before_limb(float(offset[k]), float(curvature[k]), between, lit, law)
    return share


def _angle_at(centre: FloatArray, one: FloatArray, other: FloatArray) -> float:
    """Angle between the great circles from a direction towards two others; 0 if one of them is undefined."""
    first, second = one - (one @ centre) * centre, other - (other @ centre) * centre
    return math.atan2(float(np.linalg.norm(np.cross(first, second))), float(first @ second))


def earth_in_field(camera: Camera, attitude: Attitude, r_km: ArrayLike) -> bool:
    """Whether the Earth with its atmosphere may overlap the circle about the image."""
    r = np.asarray(r_km, dtype=float)
    distance = math.hypot(*r.tolist())
    nadir = min(max(float(attitude.boresight @ r) / -distance, -1.0), 1.0)
    reach = math.asin(min((EARTH_RADIUS_KM + ATMOSPHERE_TOP_KM) / distance, 1.0))
    return math.acos(nadir) < reach + camera.half_diagonal_rad


def earth_s10(directions: ArrayLike, r_km: ArrayLike, sun_direction: ArrayLike, albedo: float = 0.3) -> FloatArray:
    """Brightness (N,) of the Earth, S10; 0 on its dark side and for lines of sight that do not meet it.

    The disk follows Lambert's law, L = A E cos θ/π, with the Sun's zenith distance θ at the ground and the Sun's light
    E at 1 au (the Sun's V = −26.74 spread over a steradian: `SUN_S10_SR`). Above the limb, sunlight is scattered once
    by molecules, L = E P(Θ)/4π · (1 − e^−τ) · e^−τ_s, with the Rayleigh phase function P = ¾(1 + cos² Θ), the optical
    depth τ = τ₀ √(2πR/H) e^−h/H along the line of sight with tangent height h, and that from the Sun to the tangent
    point, τ_s. If the Sun is above the horizon, τ_s = τ₀ e^−h/H X(cos θ), X(c) = 1/(c + 0.0266 e^−11c) (Rozenberg
    1966, with his 0.025 adapted to our scale height). If it is below, τ_s is that of the whole grazing ray minus
    X(−cos θ) behind the point, and infinite if that ray meets the ground. The brightness falls exponentially with
    H = 7.1 km where τ is small.

    Parameters
    ----------
    directions : array_like, shape (N, 3)
        Unit vectors.
    r_km : array_like, shape (3,)
        Position of the spacecraft.
    sun_direction : array_like, shape (3,)
        Direction of the Sun.
    albedo : float
        Lambert albedo A of the surface; the Earth's Bond albedo is 0.29 to 0.31 (Stephens et al. 2015).

    Notes
    -----
    Not modelled: clouds, seas, sun glint, airglow, moonlight and cities; the atmosphere in front of the disk, aerosols
    and multiple scattering, which brighten the limb and soften the terminator.
    """
    lines = np.ascontiguousarray(np.atleast_2d(np.asarray(directions, dtype=float)))
    r = np.ascontiguousarray(r_km, dtype=float)
    sun = np.asarray(sun_direction, dtype=float)
    out = np.empty(len(lines))
    _radiance(out, lines, r, np.ascontiguousarray(sun / np.linalg.norm(sun)), albedo, SUN_S10_SR)
    return out


def earth_radiance_map(
    camera: Camera, attitude: Attitude, r_km: ArrayLike, sun_direction: ArrayLike, sky: Sky
) -> tuple[FloatArray, BoolArray] | None:
    """Brightness of the Earth in every pixel; None if it is not in the field, or `earth` is off.

    Sampled at pixel centres. Smear is neglected, as the limb does not move for a camera in local-level attitude; light
    scattered out of the disk by the optics is in `simulator.optics.stray_light`.

    Parameters
    ----------
    camera, attitude : Camera, Attitude
        Projection; ICRS → camera.
    r_km, sun_direction : array_like, shape (3,)
        Position of the spacecraft; direction of the Sun.
    sky : Sky
        Its `earth` and `earth_albedo`.

    Returns
    -------
    s10 : (height, width) array
        Brightness of disk and limb; 0 elsewhere.
    hidden : (height, width) bool
        Whether the solid Earth occults the sky.
    """
    if not has_disk(sky, r_km) or not earth_in_field(camera, attitude, r_km):
        return None
    shape = (camera.height, camera.width)
    x, y = np.meshgrid(np.arange(camera.width, dtype=float), np.arange(camera.height, dtype=float))
    seen = attitude.inverse.apply(camera.unproject(np.stack([x.ravel(), y.ravel()], axis=1)))
    s10 = earth_s10(seen, r_km, sun_direction, sky.earth_albedo)
    return s10.reshape(shape), occulted(seen, r_km).reshape(shape)


def stray_sources(
    bodies: Bodies, r_km: ArrayLike, sky: Sky, rings: int = 24, sectors: int = 48
) -> tuple[NDArray[np.str_], FloatArray, FloatArray]:
    """Sources of stray light: Sun, Moon, and elements of the lit Earth.

    The visible part of the Earth is divided into elements of equal solid angle about the nadir, each a point of
    V = −2.5 log₁₀(L Ω) + 10 with L in S10 and Ω in square degrees. Sun and Moon are omitted while the Earth occults
    them, and fainter if it occults part of them.

    Parameters
    ----------
    bodies : Bodies
        From `solar_system`; without the Sun there are no sources.
    r_km : array_like, shape (3,)
        Position of the spacecraft.
    sky : Sky
        Its `earth` (false: the Earth neither occults nor emits) and `earth_albedo`.

    Returns
    -------
    names : (N,) str
        ``Sun``, ``Moon``, ``Earth``.
    directions : (N, 3)
        Unit vectors.
    v_mag : (N,)
        Brightness.
    """
    sun = np.flatnonzero(bodies.name == "Sun")
    sources = bodies.select(np.flatnonzero(np.isin(bodies.name, ["Sun", "Moon"])))
    share = unhidden(sources, r_km, bodies.direction[sun[0]] if len(sun) else np.zeros(3), sky)
    free = np.flatnonzero(share > 0.0)
    names, directions = sources.name[free], sources.direction[free]
    # A partly hidden source has the magnitude of its free part, and so has each element of the Earth that of its light.
    v_mag = sources.v_mag[free] - 2.5 * np.log10(share[free])
    if sky.earth and len(sun):
        pieces, square_degrees = _pieces(np.asarray(r_km, dtype=float), rings, sectors)
        light = earth_s10(pieces, r_km, bodies.direction[sun[0]], sky.earth_albedo) * square_degrees
        lit = np.flatnonzero(light > 0.0)
        names = np.concatenate([names, np.full(len(lit), "Earth")])
        directions = np.concatenate([directions, pieces[lit]])
        v_mag = np.concatenate([v_mag, 10.0 - 2.5 * np.log10(light[lit])])
    return names, directions, v_mag


def _pieces(r_km: FloatArray, rings: int, sectors: int) -> tuple[FloatArray, float]:
    """Directions (rings × sectors, 3) over the Earth's disk with equal solid angles, and that solid angle in deg²."""
    nadir = -r_km / np.linalg.norm(r_km)
    span = 1.0 - math.cos(angular_radius_rad(r_km))
    # Equal steps of the cosine of the angle from the nadir are equal solid angles.
    cosine = 1.0 - span * (np.arange(rings) + 0.5) / rings
    sine = np.sqrt(1.0 - cosine**2)
    azimuth = (np.arange(sectors) + 0.5) * 2.0 * math.pi / sectors
    # Any two axes across the nadir; the unit vector farthest from it gives the first without loss of precision.
    across = np.cross(nadir, np.eye(3)[int(np.argmin(np.abs(nadir)))])
    across /= np.linalg.norm(across)
    along = np.cross(nadir, across)
    turn = np.cos(azimuth)[:, None] * across + np.sin(azimuth)[:, None] * along
    pieces = cosine[:, None, None] * nadir + sine[:, None, None] * turn
    return pieces.reshape(-1, 3), 2.0 * math.pi * span / (rings * sectors) / math.radians(1.0) ** 2


@kernel
def _radiance(
    out: FloatArray, lines: FloatArray, r: FloatArray, sun: FloatArray, albedo: float, sun_s10: float
) -> None:
    """Kernel of `earth_s10`."""
    square = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
    radius = EARTH_RADIUS_KM
    for n in range(len(lines)):
        dx, dy, dz = lines[n, 0], lines[n, 1], lines[n, 2]
        along = -(r[0] * dx + r[1] * dy + r[2] * dz)  # distance to the point closest to the Earth's centre
        nearest = math.sqrt(max(square - along * along, 0.0))  # its distance from the centre
        if not along > 0.0 or nearest > radius + ATMOSPHERE_TOP_KM:  # behind the observer, no intersection, or NaN
            out[n] = 0.0
            continue
        # The point of scattering is on the ground if the line of sight meets it, otherwise the tangent point.
        distance = along - math.sqrt(radius * radius - nearest * nearest) if nearest < radius else along
        scale = 1.0 / max(nearest, radius)
        cosine = scale * (
            (r[0] + distance * dx) * sun[0] + (r[1] + distance * dy) * sun[1] + (r[2] + distance * dz) * sun[2]
        )
        if nearest < radius:
            out[n] = sun_s10 * albedo * max(cosine, 0.0) / math.pi
            continue
        # Density at the tangent point relative to the ground, and the optical depth from the Sun to it in units of the
        # vertical depth at the ground.
        thinning = math.exp(-(nearest - radius) / SCALE_HEIGHT_KM)
        way_in = thinning * _air_mass(abs(cosine))
        if cosine < 0.0:
            # The Sun is below the local horizon: its rays have passed a lowest point before this one. The depth is that
            # of the whole grazing ray minus the part behind the point.
            grazing = nearest * math.sqrt(max(1.0 - cosine * cosine, 0.0)) - radius
            if grazing < 0.0:
                out[n] = 0.0
                continue
            way_in = max(_AIR_MASSES * math.exp(-grazing / SCALE_HEIGHT_KM) - way_in, 0.0)
        towards_sun = dx * sun[0] + dy * sun[1] + dz * sun[2]
        phase = 0.75 * (1.0 + towards_sun * towards_sun)
        share = 1.0 - math.exp(-RAYLEIGH_DEPTH * _AIR_MASSES * thinning)
        out[n] = sun_s10 * phase / (4.0 * math.pi) * share * math.exp(-RAYLEIGH_DEPTH * way_in)


@kernel_part
def _air_mass(cosine: float) -> float:
    """Optical depth above a point towards a zenith distance, relative to the vertical (Rozenberg 1966).

    The constant is adapted so that the air mass at 90° is half of that of a grazing line of sight.
    """
    return 1.0 / (cosine + 2.0 / _AIR_MASSES * math.exp(-11.0 * cosine))
