"""Section 3.2 and Fig. 3.3: the orbit, the camera's matrix and the boresight's path over the year."""

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
from simulator.mission.pointing import BoresightPath, boresight_path, local_level, mounting_of
from simulator.mission.sampling import TROPICAL_YEAR_S
from simulator.mission.secular import mean_motion, sun_synchronous_inclination
from simulator.scenario.schema import OrbitSection, PointingSection
from simulator.sky.background import ECLIPTIC, GALACTIC
from simulator.study.style import BLUE, GREEN, INK, ORANGE, SOFT, VERMILION
from simulator.theses.greyling1995.matrix import (
    camera_to_celestial,
    departure_from_rotation,
    printed_matrix,
    turn_x,
    turn_y,
    turn_z,
)
from simulator.theses.printed import Row, Section, compare, new_figure
from startracker.attitude import direction_to_radec
from startracker.catalog import load_catalog

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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
    section = OrbitSection(altitude_km=ALTITUDE_KM, inclination_deg=INCLINATION_DEG, raan_deg=NODE_DEG)
    return build_orbit(section, EQUINOX)


def year_path(count: int = 367, pointing: PointingSection | None = None) -> BoresightPath:
    """Boresight at `count` instants of the year after the equinox."""
    return boresight_path(thesis_orbit(), pointing or PointingSection(), np.linspace(0.0, TROPICAL_YEAR_S, count))


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
    return Section(
        "Chapter 3.2: the orbit and the path of the boresight",
        [*_orbit_rows(), *_path_rows(), *_matrix_rows()],
        {"fig_3_3_path": path_figure},
    )


def _orbit_rows() -> list[Row]:
    radius = EARTH_RADIUS_KM + ALTITUDE_KM
    kepler_min = 2.0 * math.pi / mean_motion(radius) / 60.0
    nodal_min = thesis_orbit().period_s / 60.0
    i_deg = math.degrees(sun_synchronous_inclination(radius))
    return [
        compare(
            "Table 3.2",
            "period",
            "100",
            kepler_min,
            unit="min",
            form=".2f",
            why=f"2π √(a³/μ), rounded in print; from node to node it is {nodal_min:.2f} min under J2",
        ),
        compare(
            "Table 3.2",
            "inclination",
            "98.6",
            i_deg,
            unit="°",
            form=".4f",
            why="the inclination at which J2 turns the node once a tropical year at 800 km",
        ),
    ]


def _path_rows() -> list[Row]:
    path = year_path()
    t_s = np.linspace(0.0, TROPICAL_YEAR_S, 367)
    ahead = (path.ra_date_deg - np.degrees(thesis_orbit().raan_rad(t_s))) % 360.0
    tilted = boresight_path(
        thesis_orbit(), PointingSection(offset_deg=(0.0, 0.0, 2.0)), np.linspace(0.0, thesis_orbit().period_s, 361)
    )
    low, high = galactic_crossings_deg(DECLINATION_DEG)
    equinox_ra = float(path.ra_date_deg[0])
    right_ra, right_dec = bs_path(0.0, exchanged=True)
    listing = [bs_path(float(omega))[1] for omega in range(0, 360, 5)]
    return [
        compare(
            "§ 3.2",
            "declination of the boresight, constant over the year",
            "8.6",
            float(path.dec_date_deg.mean()),
            unit="°",
            form="+.3f",
            why=f"along +Y of the local level (+X velocity, +Z nadir), true equator of date; varies by "
            f"{np.ptp(path.dec_date_deg):.0e}°. RA = Ω + {ahead.mean():.3f}°",
        ),
        compare(
            "Fig. 3.3",
            "boresight behind the Sun at the equinox, 90° + β with β = 30° (bs_path.m)",
            "120",
            360.0 - equinox_ra,
            unit="°",
            form=".2f",
            why=f"from Ω = {NODE_DEG:g}° of Table 3.2, to which β = {270.0 - equinox_ra:.2f}° belongs; β = 30° belongs "
            "to Ω = 150°, which scenarios/sunsat.yaml and greyling1995.yaml take",
        ),
        Row(
            "App. B",
            "declination of the boresight over the year by the turns of bs_path.m",
            "+8.6°",
            f"{min(listing):+.1f}° to {max(listing):+.1f}°",
            "differs",
            f"it turns by 90° − i about z and by β + 90° − Ω about x; with these axes exchanged the declination is "
            f"{right_dec:+.2f}° and the boresight {360.0 - right_ra:.2f}° behind the Sun at the equinox",
        ),
        Row(
            "§ 3.2",
            "offset from +Y",
            "circles around Dec 8.6°",
            f"2° of yaw: {tilted.dec_date_deg.min():.2f}° to {tilted.dec_date_deg.max():.2f}°",
            "exact",
            "one circle an orbit, of the radius of the offset",
        ),
        Row(
            "Fig. 3.3",
            "RA where the path crosses the galactic plane",
            "90° and 270°",
            f"{low:.1f}° and {high:.1f}°",
            "close",
            "read off the map in the thesis; computed for b = 0 at Dec 8.6°. The Milky Way is some 20° wide",
        ),
    ]


def _matrix_rows() -> list[Row]:
    u, i, gamma = math.radians(37.0), math.radians(INCLINATION_DEG), math.radians(-65.0)
    printed = printed_matrix(u, i, gamma, corrected=False)
    corrected = printed_matrix(u, i, gamma, corrected=True)
    return [
        Row(
            "eq. 3.3, A.19",
            "M_Total is a rotation: greatest |M Mᵀ − I| at u = 37°, γ = −65°",
            "0 (a rotation)",
            f"{departure_from_rotation(printed):.3f} as printed, {departure_from_rotation(corrected):.0e} corrected",
            "differs",
            "element (3,1) should be −cos(u + π/2) sin(π/2 − i); printed is −cos(u + π/2) cos(π/2 − i) sin γ",
        ),
        Row(
            "eq. A.12, A.13",
            "greatest difference of the camera's attitude from the turns of Appendix A",
            "0",
            f"{_attitude_difference():.0e}",
            "exact",
            "with the turn by u + π/2 about y, as the text has it; (A.12) prints a turn about z, (A.13) one about y",
        ),
    ]


def _attitude_difference() -> float:
    """Of the product's orbit, local level and mounting from `camera_to_celestial`, around one orbit."""
    orbit = thesis_orbit()
    mounting = mounting_of(PointingSection())
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
    ax.set_xlabel("right ascension [°] along the equator; x = (α − 180°) cos δ")
    ax.set_ylabel("declination [°]")
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=6)
    return figure


def _graticule(ax: Axes) -> None:
    dec = np.linspace(-90.0, 90.0, 181)
    for ra in range(0, 361, 30):
        ax.plot(*sanson_flamsteed(np.full(181, float(ra)), dec), color=SOFT, linewidth=0.4, alpha=0.6)
    for parallel in range(-60, 61, 30):
        ax.plot(*sanson_flamsteed([0.0, 360.0], [parallel, parallel]), color=SOFT, linewidth=0.4, alpha=0.6)
    ax.set_xticks(np.arange(-180, 181, 30), [f"{ra}" for ra in range(0, 361, 30)])
    ax.set_yticks(np.arange(-90, 91, 30))
    ax.set_xlim(-184, 184)
    ax.set_ylim(-93, 93)
    ax.set_aspect("equal")
    ax.grid(visible=False)


def _great_circle(ax: Axes, to_frame: FloatArray, style: str, colour: str, label: str) -> None:
    """Equator of a frame (rows of `to_frame`: its axes in ICRS), from the RA where it begins to where it ends."""
    t = np.linspace(0.0, 2.0 * np.pi, 721)
    ra, dec = np.degrees(direction_to_radec(np.cos(t)[:, None] * to_frame[0] + np.sin(t)[:, None] * to_frame[1]))
    order = np.argsort(ra % 360.0)
    ax.plot(*sanson_flamsteed((ra % 360.0)[order], dec[order]), style, color=colour, label=label)
