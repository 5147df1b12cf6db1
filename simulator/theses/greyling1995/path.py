"""Section 3.2, Fig. 3.3 and Appendix A: the orbit, the camera's matrix and the boresight's path over the year."""

from __future__ import annotations

import functools
import math
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulator.constants import EARTH_RADIUS_KM
from simulator.mission.frames import true_of_date
from simulator.mission.orbit import Orbit, build_orbit
from simulator.mission.parameters import OrbitParameters, PointingParameters
from simulator.mission.pointing import BoresightPath, boresight_path, local_level, mounting_of
from simulator.mission.sampling import TROPICAL_YEAR_S
from simulator.mission.secular import mean_motion, sun_synchronous_inclination
from simulator.sky.background import ECLIPTIC, GALACTIC
from simulator.study.style import BLUE, GREEN, INK, ORANGE, SOFT, VERMILION
from simulator.theses.printed import Section, new_figure
from simulator.theses.tables import Values, table_rows
from startracker.attitude import direction_to_radec
from startracker.catalog import load_catalog

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["camera_to_celestial", "departure_from_rotation", "printed_matrix"]

FloatArray = NDArray[np.float64]

EQUINOX = datetime(1995, 3, 21, 2, 14, tzinfo=UTC)
"""Vernal equinox of 1995, at which Table 3.2 gives the node."""

ALTITUDE_KM, INCLINATION_DEG, NODE_DEG = 800.0, 98.6, 155.0
"""Table 3.2."""

DECLINATION_DEG = INCLINATION_DEG - 90.0
"""Of the boresight, from the orbit's normal."""


@functools.cache
def thesis_orbit() -> Orbit:
    """The orbit of Table 3.2 with J2's secular drift of the node."""
    section = OrbitParameters(altitude_km=ALTITUDE_KM, inclination_deg=INCLINATION_DEG, raan_deg=NODE_DEG)
    return build_orbit(section, EQUINOX)


def year_path(count: int = 367, pointing: PointingParameters | None = None) -> BoresightPath:
    """Boresight at `count` instants of the year after the equinox."""
    return boresight_path(thesis_orbit(), pointing or PointingParameters(), np.linspace(0.0, TROPICAL_YEAR_S, count))


def sanson_flamsteed(ra_deg: ArrayLike, dec_deg: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """The thesis' map: x = (α − 180°) cos δ, y = δ, degrees; equal in area.

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


SUN_ANGLE_DEG = 30.0
"""β in `bs_path.m`."""


def bs_path(omega_deg: float, spin_deg: float = 0.0, *, exchanged: bool = False) -> tuple[float, float]:
    """Right ascension and declination of the boresight, degrees, by the turns of `bs_path.m` in its own order.

    Parameters
    ----------
    omega_deg : float
        Turn of the Earth about the Sun since the equinox.
    spin_deg : float
        Turn of the satellite about +Y of the local level.
    exchanged : bool
        With the axes of its last two turns exchanged: by the inclination about x, by β + 90° − Ω about z, as the text
        of Appendix A has them; the listing has them about z and x.
    """
    tilt, turn = 90.0 - INCLINATION_DEG, SUN_ANGLE_DEG + 90.0 - omega_deg
    vector = np.array([0.0, 0.0, -1.0])
    for psi, theta, phi in (
        (180.0, 0.0, 90.0),  # sensor to body
        (0.0, 0.0, 180.0),  # body to local level
        (0.0, spin_deg, 0.0),
        (0.0, 0.0, tilt) if exchanged else (tilt, 0.0, 0.0),  # local level to Earth
        (turn, 0.0, 0.0) if exchanged else (0.0, 0.0, turn),
    ):
        vector = turn_x(math.radians(phi)) @ turn_y(math.radians(theta)) @ turn_z(math.radians(psi)) @ vector
    ra = math.degrees(math.atan2(-vector[0], vector[1])) % 360.0
    return ra, math.degrees(math.asin(vector[2]))


def section() -> Section:
    """Boresight path, camera matrix and period."""
    values = _orbit_values() | _path_values() | _matrix_values()
    rows = table_rows("greyling1995/path", values)
    return Section("Chapter 3.2: the orbit and the path of the boresight", rows, {"fig_3_3_path": path_figure})


def _orbit_values() -> Values:
    radius = EARTH_RADIUS_KM + ALTITUDE_KM
    return {
        "kepler_min": 2.0 * math.pi / mean_motion(radius) / 60.0,
        "nodal_min": thesis_orbit().period_s / 60.0,
        "i_deg": math.degrees(sun_synchronous_inclination(radius)),
    }


def _path_values() -> Values:
    path, orbit = year_path(), thesis_orbit()
    ahead = (path.ra_date_deg - np.degrees(orbit.raan_rad(np.linspace(0.0, TROPICAL_YEAR_S, 367)))) % 360.0
    tilted = boresight_path(
        orbit, PointingParameters(offset_deg=(0.0, 0.0, 2.0)), np.linspace(0.0, orbit.period_s, 361)
    )
    equinox_ra = float(path.ra_date_deg[0])
    exchanged_ra, exchanged_dec = bs_path(0.0, exchanged=True)
    listing = [bs_path(float(omega))[1] for omega in range(0, 360, 5)]
    return {
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
    }


def _matrix_values() -> Values:
    angles = math.radians(37.0), math.radians(INCLINATION_DEG), math.radians(-65.0)
    return {
        "printed_departure": departure_from_rotation(printed_matrix(*angles, corrected=False)),
        "corrected_departure": departure_from_rotation(printed_matrix(*angles, corrected=True)),
        "attitude_difference": _attitude_difference(),
    }


def _attitude_difference() -> float:
    """Of the product's orbit, local level and mounting from `camera_to_celestial`, around one orbit."""
    orbit = thesis_orbit()
    mounting = mounting_of(PointingParameters())
    greatest = 0.0
    for t_s in np.linspace(0.0, orbit.period_s, 9):
        camera = mounting.as_matrix() @ local_level(*orbit.state(t_s)).as_matrix()
        ours = true_of_date(orbit.clock, t_s) @ camera.T
        u = 2.0 * math.pi * t_s / orbit.period_s
        theirs = camera_to_celestial(u, math.radians(INCLINATION_DEG), float(orbit.raan_rad(t_s)))
        greatest = max(greatest, float(np.abs(ours - theirs).max()))
    return greatest


def path_figure(magnitude_limit: float = 5.0) -> Figure:
    """Fig. 3.3: the path in the Sanson-Flamsteed projection, with stars, ecliptic and galactic plane.

    Parameters
    ----------
    magnitude_limit : float
        Faintest star drawn, V.
    """
    figure, ax = new_figure(size=(9.0, 4.9))
    _graticule(ax)
    stars = load_catalog("bsc5").brighter_than(magnitude_limit)
    x, y = sanson_flamsteed(np.degrees(stars.ra_rad), np.degrees(stars.dec_rad))
    size = 1.2 * (magnitude_limit + 1.0 - stars.v_mag) ** 1.4
    ax.scatter(x, y, s=size, c=INK, linewidths=0, alpha=0.6, label=f"stars, V ≤ {magnitude_limit:g}")
    _great_circle(ax, ECLIPTIC, "--", ORANGE, "ecliptic")
    _great_circle(ax, GALACTIC, ":", GREEN, "galactic plane")
    path = year_path()
    order = np.argsort(path.ra_deg)
    px, py = sanson_flamsteed(path.ra_deg[order], path.dec_deg[order])
    ax.plot(px, py, "-", color=BLUE, linewidth=2.0, label="boresight")
    ax.plot(*sanson_flamsteed(0.0, 0.0), "o", color=ORANGE, markeredgecolor=INK, label="Sun at the equinox")
    ax.plot(*sanson_flamsteed(path.ra_deg[0], path.dec_deg[0]), "D", color=VERMILION, label="boresight at the equinox")
    ax.set(xlabel="right ascension [°] along the equator; x = (α − 180°) cos δ", ylabel="declination [°]")
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=6)
    return figure


def _graticule(ax: Axes) -> None:
    dec = np.linspace(-90.0, 90.0, 181)
    for ra in range(0, 361, 30):
        ax.plot(*sanson_flamsteed(np.full(181, float(ra)), dec), color=SOFT, linewidth=0.4, alpha=0.6)
    for parallel in range(-60, 61, 30):
        ax.plot(*sanson_flamsteed([0.0, 360.0], [parallel, parallel]), color=SOFT, linewidth=0.4, alpha=0.6)
    ax.set_xticks(np.arange(-180, 181, 30), [f"{ra}" for ra in range(0, 361, 30)])
    ax.set(yticks=np.arange(-90, 91, 30), xlim=(-184, 184), ylim=(-93, 93), aspect="equal")
    ax.grid(visible=False)


def _great_circle(ax: Axes, to_frame: FloatArray, style: str, colour: str, label: str) -> None:
    """Equator of a frame (rows of `to_frame`: its axes in ICRS), from the RA where it begins to where it ends."""
    t = np.linspace(0.0, 2.0 * np.pi, 721)
    ra, dec = np.degrees(direction_to_radec(np.cos(t)[:, None] * to_frame[0] + np.sin(t)[:, None] * to_frame[1]))
    order = np.argsort(ra % 360.0)
    ax.plot(*sanson_flamsteed((ra % 360.0)[order], dec[order]), style, color=colour, label=label)


_LEVEL_FROM_FOV = np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, -1.0, 0.0]])
"""(A.9): field of view (x right, y up, z against the boresight) to local level."""

FOV_FROM_CAMERA = np.diag([1.0, -1.0, -1.0])
"""From this product's camera axes (x right, y down, z along the boresight) to the thesis' of the field of view."""


def turn_z(angle_rad: float) -> FloatArray:
    """(A.1): turn of the axes about z."""
    s, c = math.sin(angle_rad), math.cos(angle_rad)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def turn_y(angle_rad: float) -> FloatArray:
    """(A.2): turn of the axes about y."""
    s, c = math.sin(angle_rad), math.cos(angle_rad)
    return np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])


def turn_x(angle_rad: float) -> FloatArray:
    """(A.3): turn of the axes about x."""
    s, c = math.sin(angle_rad), math.cos(angle_rad)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]])


def printed_matrix(u_rad: float, inclination_rad: float, gamma_rad: float, *, corrected: bool) -> FloatArray:
    """M_Total of (3.3) and (A.19), field of view to Earth axes, letter by letter or with element (3,1) corrected.

    Parameters
    ----------
    u_rad, inclination_rad : float
        Angle from the ascending node, inclination.
    gamma_rad : float
        β + π/2 − Ω.
    corrected : bool
        Element (3,1) as −cos(u + π/2) sin(π/2 − i), without which no row or column through it is a unit vector; printed
        is −cos(u + π/2) cos(π/2 − i) sin γ.
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


def camera_to_celestial(u_rad: float, inclination_rad: float, raan_rad: float) -> FloatArray:
    """Camera to celestial axes from the turns that the text of Appendix A names, in their order.

    Local level to Earth: by u + π/2 about y, by π/2 − i about x, by −Ω about z. The printed factors (A.12) and (A.13)
    have the first about z and the second about y.
    """
    earth_from_level = turn_z(-raan_rad) @ turn_x(math.pi / 2 - inclination_rad) @ turn_y(u_rad + math.pi / 2)
    return np.asarray(earth_from_level @ _LEVEL_FROM_FOV @ FOV_FROM_CAMERA)


def departure_from_rotation(matrix: FloatArray) -> float:
    """Greatest element of |M Mᵀ − I|; 0 for a rotation."""
    return float(np.abs(matrix @ matrix.T - np.eye(3)).max())
