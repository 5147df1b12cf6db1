"""Artificial satellites and debris near the field, as moving sunlit spheres that scatter diffusely.

A sphere of radius a and albedo A that scatters by Lambert's law has, at a distance d and a phase angle φ,

    E = E_sun · (2/3) A (a/d)² · F(φ),   F(φ) = [sin φ + (π − φ) cos φ] / π

(Russell 1916, ApJ 43, 173; Hejduk 2011, AMOS: "Specular and diffuse components in spherical satellite photometric
modeling"). The standard magnitude is V at 1000 km and φ = 90°, where F = 1/π. The Earth, a sphere, dims a satellite in
proportion to the part of the Sun's uniform disk that it covers, and hides satellites behind it.

Not modelled: shapes, flares, the atmosphere's refraction and reddening in the penumbra, light from the Earth and the
Moon, occultation by bodies other than the Earth.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulator.constants import EARTH_RADIUS_KM, RADIUS_KM
from simulator.mission.clock import Clock
from simulator.mission.element_files import is_called
from simulator.mission.element_list import ElementList
from simulator.mission.trajectory import States
from simulator.optics.bodies import share_before_limb
from simulator.sky.apparent import aberrated
from simulator.sky.earth import has_disk, limbs
from simulator.sky.magnitudes import sun_v
from simulator.sky.parameters import SatelliteParameters, Sky
from startracker.core import AU_KM, SPEED_OF_LIGHT_KM_S, FloatArray, IntArray
from startracker.display import fields_repr
from startracker.errors import InputError

STANDARD_KM = 1000.0
"""Distance of the standard magnitude; its phase angle is 90°."""
LEAST_KM = 0.01
"""Objects nearer than this are taken for the spacecraft itself, whose elements may be in the list."""
_NODES = 5
"""Instants of an exposure to which a path is fitted; the quartic agrees with Skyfield to 0.005″ over 10 s."""
_SHIFT_RAD = 3e-4
"""Upper limit of aberration and light time together, for the selection of satellites near the field."""


@dataclass(frozen=True, eq=False)
class Satellites:
    """Satellites near the field, as columns; satellites in the Earth's umbra or behind the Earth are omitted."""

    number: IntArray
    """(N,): Catalogue number; 0 if it is not a number."""
    name: NDArray[np.str_]
    """(N,): Name, or the number."""
    path_km: FloatArray
    """(N, 5, 3): Apparent vector from the spacecraft, ICRS axes, as a polynomial of the seconds from mid-exposure,
    lowest power first."""
    rate_rad_s: FloatArray
    """(N,): Angular rate relative to the stars."""
    v_mag: FloatArray
    """(N,): Apparent V, including the dimming in the penumbra."""
    angular_radius_rad: FloatArray
    """(N,): Apparent radius."""
    illuminated_fraction: FloatArray
    """(N,): Illuminated fraction of the disk, (1 + cos φ) / 2."""

    __repr__ = fields_repr

    def __len__(self) -> int:
        return len(self.number)

    @property
    def direction(self) -> FloatArray:
        """(N, 3): Apparent unit vectors at mid-exposure."""
        middle = self.path_km[:, 0]
        return np.asarray(middle / np.linalg.norm(middle, axis=1, keepdims=True))

    def select(self, rows: IntArray) -> Satellites:
        """Selection of satellites by index array."""
        return Satellites(*(getattr(self, column.name)[rows] for column in fields(self)))


class Look(NamedTuple):
    """One exposure: its time, the motion of the spacecraft, and the field of the camera."""

    t_s: float
    """Mid-exposure, seconds after the epoch."""
    exposure_s: float
    """Time from the first to the last exposed row, over which paths are fitted."""
    states: Callable[[FloatArray], States]
    """Geocentric states (K, 3) of the spacecraft at times (K,)."""
    span_s: tuple[float, float]
    """First and last time of these states."""
    earth_km_s: FloatArray
    """(3,): Barycentric velocity of the Earth."""
    sun_km: FloatArray
    """(3,): Geocentric position of the Sun."""
    boresight: FloatArray
    """(3,): Direction of the camera, ICRS."""
    reach_rad: float
    """Greatest angle from the boresight of a satellite whose light may reach the detector."""


class SatelliteList(NamedTuple):
    """Satellites of a scenario."""

    orbits: ElementList
    """Orbits of the N satellites."""
    standard_magnitude: FloatArray
    """(N,): V at 1000 km and a phase angle of 90°."""
    radius_km: FloatArray
    """(N,): Radius of the sphere."""

    def near(self, look: Look, sky: Sky) -> Satellites:
        """The satellites whose light may reach the detector during an exposure.

        Positions are those at the times of light emission: with the light time τ and the Earth's barycentric velocity
        v_E, ρ = r_s − r − (v_s + v_E) τ; the aberration (`Sky.aberration`) nearly cancels v_E. Light deflection is
        neglected: it is below 1 mas for a source that is near in comparison with the Sun.
        """
        middle = np.array([look.t_s])
        here, there = look.states(middle), self.orbits.states(middle)
        away_km = there.r_km[:, 0] - here.r_km[0]
        distance_km = np.linalg.norm(away_km, axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):  # decayed orbits are NaN, the spacecraft is at 0
            speed = np.linalg.norm(there.v_km_s[:, 0] - here.v_km_s[0], axis=1)
            own_rad = np.arcsin(np.minimum((speed * look.exposure_s + self.radius_km) / distance_km, 1.0))
            off_axis = np.arccos(np.clip(away_km @ look.boresight / distance_km, -1.0, 1.0))
            close = (off_axis < look.reach_rad + own_rad + _SHIFT_RAD) & (distance_km > LEAST_KM)
        # The few satellites near the field are then tested for the Earth in front of them and for its shadow.
        rows = np.flatnonzero(close)
        share = np.ones(len(rows))
        if has_disk(sky, here.r_km[0]):
            rows = rows[~behind_earth(there.r_km[rows, 0], here.r_km[0])]
            share = sunlit_share(there.r_km[rows, 0], look.sun_km)
            rows, share = rows[share > 0.0], share[share > 0.0]
        return self._seen(rows, share, there.r_km[rows, 0], look, sky)

    def _seen(self, rows: IntArray, share: FloatArray, r_km: FloatArray, look: Look, sky: Sky) -> Satellites:
        """Columns of some rows, with the sunlit fraction (n,) of each and its geocentric position (n, 3) at
        mid-exposure."""
        path = self._path_km(rows, look, sky)
        to_sun, to_camera = look.sun_km - r_km, -path[:, 0]
        sun_km, distance_km = np.linalg.norm(to_sun, axis=1), np.linalg.norm(to_camera, axis=1)
        cosine = np.clip(np.sum(to_sun * to_camera, axis=1) / (sun_km * distance_km), -1.0, 1.0)
        # The standard magnitude is at 90°, where F = 1/π; the factor π is relative to it.
        phase = diffuse_phase(np.arccos(cosine)) * math.pi
        v_mag = self.standard_magnitude[rows] + 5.0 * np.log10(distance_km / STANDARD_KM * sun_km / AU_KM)
        with np.errstate(divide="ignore"):  # at φ = 180° no lit surface is visible, and V is infinite
            v_mag = v_mag - 2.5 * np.log10(phase * share)
        unit = path[:, 0] / distance_km[:, None]
        across = path[:, 1] - np.sum(path[:, 1] * unit, axis=1)[:, None] * unit
        elements = [self.orbits.elements[row] for row in rows.tolist()]
        return Satellites(
            number=np.array([int(e.number) if e.number.isdecimal() else 0 for e in elements], dtype=np.int64),
            name=np.array([e.name or e.number for e in elements], dtype=np.str_),
            path_km=path,
            rate_rad_s=np.linalg.norm(across, axis=1) / distance_km,
            v_mag=v_mag,
            angular_radius_rad=np.arcsin(np.minimum(self.radius_km[rows] / distance_km, 1.0)),
            illuminated_fraction=(1.0 + cosine) / 2.0,
        )

    def _path_km(self, rows: IntArray, look: Look, sky: Sky) -> FloatArray:
        """Polynomials (n, 5, 3) of the apparent vectors of some rows."""
        half_s = 0.5 * look.exposure_s
        first_s, last_s = max(look.t_s - half_s, look.span_s[0]), min(look.t_s + half_s, look.span_s[1])
        # Chebyshev nodes minimise the largest error of the polynomial over the exposure.
        chebyshev = np.cos(np.pi * (np.arange(_NODES) + 0.5) / _NODES)
        t_s = 0.5 * (first_s + last_s) + 0.5 * (last_s - first_s) * chebyshev
        here, there = look.states(t_s), self.orbits.states(t_s, rows)
        vector = there.r_km - here.r_km
        for _ in range(2):  # two iterations suffice, as satellites are slow against light
            delay_s = np.linalg.norm(vector, axis=-1, keepdims=True) / SPEED_OF_LIGHT_KM_S
            vector = there.r_km - here.r_km - (there.v_km_s + look.earth_km_s) * delay_s
        if sky.aberration:
            distance_km = np.linalg.norm(vector, axis=-1, keepdims=True)
            vector = aberrated(vector / distance_km, look.earth_km_s + here.v_km_s) * distance_km
        # Times in units of half an exposure keep the matrix well conditioned; the coefficients are scaled back.
        powers = np.vander((t_s - look.t_s) / half_s, _NODES, increasing=True)
        found = np.einsum("dk,nkj->ndj", np.linalg.inv(powers), vector)
        return np.asarray(found / (half_s ** np.arange(_NODES))[:, None])


def load_satellites(given: SatelliteParameters, clock: Clock, folder: Path) -> SatelliteList | None:
    """Satellites of a scenario; None without a file.

    Raises
    ------
    InputError
        With file and line for a file that cannot be used, or for an object that is not in it.
    """
    if given.file is None:
        return None
    path = folder / given.file
    orbits = ElementList.read(path, clock, given.max_age_days)
    # Values of all satellites first, then those of single ones. A diameter or albedo of a satellite's own replaces the
    # common magnitude.
    magnitude = np.empty(len(orbits))
    radius_km = np.full(len(orbits), given.diameter_m / 2000.0)
    magnitude[:] = (
        standard_magnitude(given.diameter_m, given.albedo)
        if given.standard_magnitude is None
        else given.standard_magnitude
    )
    for size in given.objects:
        rows = [k for k, elements in enumerate(orbits.elements) if is_called(elements, size.object)]
        if not rows:
            raise InputError(f"{path}: has no object {size.object} (sky.satellites.objects)")
        diameter_m = given.diameter_m if size.diameter_m is None else size.diameter_m
        radius_km[rows] = diameter_m / 2000.0
        if size.standard_magnitude is not None:
            magnitude[rows] = size.standard_magnitude
        elif size.diameter_m is not None or size.albedo is not None or given.standard_magnitude is None:
            magnitude[rows] = standard_magnitude(diameter_m, given.albedo if size.albedo is None else size.albedo)
    return SatelliteList(orbits, magnitude, radius_km)


def diffuse_phase(phase_rad: ArrayLike) -> FloatArray:
    """F(φ) = [sin φ + (π − φ) cos φ] / π: brightness of a diffuse sphere relative to that at full phase."""
    phase = np.asarray(phase_rad, dtype=float)
    return np.asarray(np.maximum(np.sin(phase) + (math.pi - phase) * np.cos(phase), 0.0) / math.pi)


def standard_magnitude(diameter_m: float, albedo: float) -> float:
    """V of a diffuse sphere at 1000 km, a phase angle of 90° and 1 au from the Sun."""
    share = 2.0 / 3.0 * albedo * (diameter_m / 2000.0 / STANDARD_KM) ** 2 * float(diffuse_phase(math.pi / 2.0))
    return float(sun_v(1.0)) - 2.5 * math.log10(share) if share > 0.0 else math.inf


def sunlit_share(r_km: FloatArray, sun_km: FloatArray) -> FloatArray:
    """Fraction (N,) of the Sun's uniform disk that the spherical Earth does not cover, at geocentric positions (N, 3):
    1 in sunlight, 0 in the umbra."""
    to_sun = sun_km - r_km
    distance_km = np.linalg.norm(to_sun, axis=1)
    radius_rad = np.arcsin(RADIUS_KM["Sun"] / distance_km)
    share = np.ones(len(r_km))
    for k in range(len(r_km)):
        # The Earth's limb on the disk of the Sun, as seen from the satellite.
        offset, curvature = (float(x[0]) for x in limbs(to_sun[k] / distance_km[k], radius_rad[k : k + 1], r_km[k]))
        if offset < 1.0:
            share[k] = share_before_limb(offset, curvature, 0.0, 1.0, "lommel_seeliger") if offset > -1.0 else 0.0
    return share


def behind_earth(r_km: FloatArray, camera_km: FloatArray) -> NDArray[np.bool_]:
    """Whether the solid Earth, a sphere, is between a camera (3,) and objects (N, 3), at geocentric positions; objects
    in front of its disk are not behind it."""
    line = r_km - camera_km
    # The point of the line segment that is closest to the Earth's centre, as a fraction of its length.
    along = np.clip(-line @ camera_km / np.sum(line * line, axis=1), 0.0, 1.0)
    return np.asarray(np.linalg.norm(camera_km + along[:, None] * line, axis=1) < EARTH_RADIUS_KM)
