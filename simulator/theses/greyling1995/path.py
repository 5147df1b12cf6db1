"""Section 3.2, Fig. 3.3 and Appendix A: the orbit, the camera's matrix and the boresight's path over the year."""

from __future__ import annotations

import functools
import math
from datetime import UTC, datetime

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from simulator.constants import EARTH_RADIUS_KM, TROPICAL_YEAR_S
from simulator.mission.frames import true_of_date
from simulator.mission.orbit import Orbit, build_orbit
from simulator.mission.parameters import OrbitParameters, PointingParameters
from simulator.mission.pointing import BoresightPath, boresight_path, local_level, mounting_of
from simulator.mission.secular import mean_motion, sun_synchronous_inclination
from simulator.sky.celestial_frames import ECLIPTIC, GALACTIC, equator_of
from simulator.theses.figures import section_of
from simulator.theses.printed import Section
from simulator.theses.tables import Values
from startracker.catalog import load_catalog
from startracker.core import FloatArray
from startracker.geometry.attitude import direction_to_radec

EQUINOX = datetime(1995, 3, 21, 2, 14, tzinfo=UTC)
"""Vernal equinox of 1995, for which Table 3.2 gives the node."""

ALTITUDE_KM, INCLINATION_DEG, NODE_DEG = 800.0, 98.6, 155.0
"""Table 3.2."""

DECLINATION_DEG = INCLINATION_DEG - 90.0
"""Angle of the boresight from the orbit normal."""

SUN_ANGLE_DEG = 30.0
"""β in `bs_path.m`."""

_LEVEL_FROM_FOV = np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, -1.0, 0.0]])
"""(A.9): field of view (x right, y up, z against the boresight) to local level."""

_FOV_FROM_CAMERA = np.diag([1.0, -1.0, -1.0])
"""From the product's camera axes (x right, y down, z along the boresight) to the field-of-view axes of the thesis."""


@functools.cache
def thesis_orbit() -> Orbit:
    """The orbit of Table 3.2 with the secular drift of the node by J2."""
    section = OrbitParameters(altitude_km=ALTITUDE_KM, inclination_deg=INCLINATION_DEG, raan_deg=NODE_DEG)
    return build_orbit(section, EQUINOX)


@functools.cache
def year_path() -> BoresightPath:
    """Boresight at 367 instants of the year after the equinox."""
    return boresight_path(thesis_orbit(), PointingParameters(), np.linspace(0.0, TROPICAL_YEAR_S, 367))


def sanson_flamsteed(ra_deg: ArrayLike, dec_deg: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Map projection of the thesis: x = (α − 180°) cos δ, y = δ, degrees; equal-area.

    Snyder 1987, *Map Projections* (USGS Professional Paper 1395), section 30, "Sinusoidal".
    """
    ra, dec = np.asarray(ra_deg, dtype=float), np.asarray(dec_deg, dtype=float)
    return (ra - 180.0) * np.cos(np.radians(dec)), dec


def galactic_crossings_deg(dec_deg: float) -> tuple[float, float]:
    """Right ascensions where the parallel of `dec_deg` crosses the galactic plane, degrees, ascending.

    cos(α − α_P) = −tan δ tan δ_P, (α_P, δ_P) the galactic pole.
    """
    pole_ra, pole_dec = (float(v) for v in direction_to_radec(GALACTIC[2]))
    half = math.degrees(math.acos(-math.tan(math.radians(dec_deg)) * math.tan(pole_dec)))
    low, high = sorted(((math.degrees(pole_ra) - half) % 360.0, (math.degrees(pole_ra) + half) % 360.0))
    return low, high


def bs_path(omega_deg: float, spin_deg: float = 0.0, *, exchanged: bool = False) -> tuple[float, float]:
    """Right ascension and declination of the boresight, degrees, by the rotations of `bs_path.m` in its order.

    `omega_deg` is the rotation of the Earth about the Sun since the equinox, `spin_deg` that of the satellite about +Y
    of the local level. `exchanged`: the last two rotations are by the inclination about x and by β + 90° − Ω about z,
    as in the text of Appendix A; in the listing they are about z and x.
    """
    tilt, turn = 90.0 - INCLINATION_DEG, SUN_ANGLE_DEG + 90.0 - omega_deg
    vector = np.array([0.0, 0.0, -1.0])
    for about_z_y_x in (
        (180.0, 0.0, 90.0),  # sensor to body
        (0.0, 0.0, 180.0),  # body to local level
        (0.0, spin_deg, 0.0),
        (0.0, 0.0, tilt) if exchanged else (tilt, 0.0, 0.0),  # local level to Earth
        (turn, 0.0, 0.0) if exchanged else (0.0, 0.0, turn),
    ):
        vector = _turn("zyx", np.radians(about_z_y_x)) @ vector
    ra = math.degrees(math.atan2(-vector[0], vector[1])) % 360.0
    return ra, math.degrees(math.asin(vector[2]))


def _turn(axes: str, angles_rad: ArrayLike) -> FloatArray:
    """(A.1) to (A.3): successive rotations of the axes."""
    return np.asarray(Rotation.from_euler(axes, -np.asarray(angles_rad)).as_matrix())


def section() -> Section:
    """Boresight path, camera matrix and period."""
    values = _path_values() | _map_values()
    return section_of("greyling1995/path", "Chapter 3.2: the orbit and the path of the boresight", values)


def _path_values() -> Values:
    path, orbit, radius = year_path(), thesis_orbit(), EARTH_RADIUS_KM + ALTITUDE_KM
    ahead = (path.ra_date_deg - np.degrees(orbit.raan_rad(np.linspace(0.0, TROPICAL_YEAR_S, 367)))) % 360.0
    tilted = boresight_path(
        orbit, PointingParameters(offset_deg=(0.0, 0.0, 2.0)), np.linspace(0.0, orbit.period_s, 361)
    )
    equinox_ra = float(path.ra_date_deg[0])
    exchanged_ra, exchanged_dec = bs_path(0.0, exchanged=True)
    angles = math.radians(37.0), math.radians(INCLINATION_DEG), math.radians(-65.0)
    listing = [bs_path(float(omega))[1] for omega in range(0, 360, 5)]
    return {
        "kepler_min": 2.0 * math.pi / mean_motion(radius) / 60.0,
        "nodal_min": orbit.period_s / 60.0,
        "i_deg": math.degrees(sun_synchronous_inclination(radius)),
        "dec_deg": path.dec_date_deg.mean(),
        "varies_deg": np.ptp(path.dec_date_deg),
        "ahead_deg": ahead.mean(),
        "behind_sun_deg": 360.0 - equinox_ra,
        "beta_deg": 270.0 - equinox_ra,
        "least_dec_deg": min(listing),
        "most_dec_deg": max(listing),
        "exchanged_dec_deg": exchanged_dec,
        "exchanged_behind_deg": 360.0 - exchanged_ra,
        "circle": (tilted.dec_date_deg.min(), tilted.dec_date_deg.max()),
        "crossings": galactic_crossings_deg(DECLINATION_DEG),
        "printed_departure": departure_from_rotation(printed_matrix(*angles, corrected=False)),
        "corrected_departure": departure_from_rotation(printed_matrix(*angles, corrected=True)),
        "attitude_difference": _attitude_difference(),
    }


def _attitude_difference() -> float:
    """Difference between the product's orbit, local level and mounting and the rotations of Appendix A, over one orbit.

    Local level to Earth: by u + π/2 about y, by π/2 − i about x, by −Ω about z. The printed factors (A.12) and (A.13)
    have the first about z and the second about y.
    """
    orbit = thesis_orbit()
    mounting = mounting_of(PointingParameters())
    greatest = 0.0
    for t_s in np.linspace(0.0, orbit.period_s, 9):
        camera = mounting.as_matrix() @ local_level(*orbit.state(t_s)).as_matrix()
        ours = true_of_date(orbit.clock, t_s) @ camera.T
        u = 2.0 * math.pi * t_s / orbit.period_s
        angles = u + math.pi / 2, math.pi / 2 - math.radians(INCLINATION_DEG), -float(orbit.raan_rad(t_s))
        theirs = _turn("yxz", angles) @ _LEVEL_FROM_FOV @ _FOV_FROM_CAMERA
        greatest = max(greatest, float(np.abs(ours - theirs).max()))
    return greatest


def printed_matrix(u_rad: float, inclination_rad: float, gamma_rad: float, *, corrected: bool) -> FloatArray:
    """M_Total of (3.3) and (A.19), field of view to Earth axes, as printed or with element (3,1) corrected.

    u is the angle from the ascending node, γ = β + π/2 − Ω. Printed in (3,1) is −cos(u + π/2) cos(π/2 − i) sin γ; its
    row and column are unit vectors only with −cos(u + π/2) sin(π/2 − i).
    """
    su, cu = math.sin(u_rad + math.pi / 2), math.cos(u_rad + math.pi / 2)
    si, ci = math.sin(math.pi / 2 - inclination_rad), math.cos(math.pi / 2 - inclination_rad)
    sg, cg = math.sin(gamma_rad), math.cos(gamma_rad)
    return np.array(
        [
            [-cu * ci * cg + su * sg, si * cg, -su * ci * cg - cu * sg],
            [cu * ci * sg + su * cg, -si * sg, su * ci * sg - cu * cg],
            [-cu * si if corrected else -cu * ci * sg, -ci, -su * si],
        ]
    )


def departure_from_rotation(matrix: FloatArray) -> float:
    """Largest element of |M Mᵀ − I|; 0 for a rotation."""
    return float(np.abs(matrix @ matrix.T - np.eye(3)).max())


def _map_values() -> Values:
    """The path in the Sanson-Flamsteed projection, with stars to V = 5, ecliptic and galactic plane."""
    stars, path = load_catalog("bsc5").brighter_than(5.0), year_path()
    dec = np.linspace(-90.0, 90.0, 181)
    meridians = [sanson_flamsteed(np.full(181, float(ra)), dec) for ra in range(0, 361, 30)]
    parallels = [sanson_flamsteed([0.0, 360.0], [parallel, parallel]) for parallel in range(-60, 61, 30)]
    order = np.argsort(path.ra_deg)
    return {
        "graticule": [{"line": line} for line in meridians + parallels],
        "stars": sanson_flamsteed(np.degrees(stars.ra_rad), np.degrees(stars.dec_rad)),
        "size": 1.2 * (6.0 - stars.v_mag) ** 1.4,
        "ecliptic": _great_circle(ECLIPTIC),
        "galactic": _great_circle(GALACTIC),
        "path": sanson_flamsteed(path.ra_deg[order], path.dec_deg[order]),
        "sun": sanson_flamsteed(0.0, 0.0),
        "equinox": sanson_flamsteed(path.ra_deg[0], path.dec_deg[0]),
        "ra_ticks": np.arange(-180, 181, 30),
        "ra_texts": [f"{ra}" for ra in range(0, 361, 30)],
    }


def _great_circle(to_frame: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Equator of a frame (rows of `to_frame`: its axes in ICRS) in the map, starting at its first right ascension."""
    ra, dec = np.degrees(direction_to_radec(equator_of(to_frame)))
    order = np.argsort(ra % 360.0)
    return sanson_flamsteed((ra % 360.0)[order], dec[order])
