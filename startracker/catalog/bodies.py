"""Sun, Moon and planets among the detected objects: their directions at an epoch, and the centroids that belong to
them."""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker._compiled import kernel
from startracker.core import AU_KM, DAYS_PER_JULIAN_YEAR, J2000_JD_TT, SPEED_OF_LIGHT_KM_S, FloatArray, IntArray
from startracker.ephemeris import DE421_SPAN_JD, de421_file, outside_ephemeris
from startracker.errors import InputError
from startracker.geometry.camera import Camera
from startracker.observer import Observer, aberrated

_NAIF = {
    "Mercury": (1, 199),
    "Venus": (2, 299),
    "Mars": (4, 499),
    "Jupiter": (5,),
    "Saturn": (6,),
    "Uranus": (7,),
    "Neptune": (8,),
    "Sun": (10,),
    "Moon": (3, 301),
    "Earth": (3, 399),
}
"""Path of each body from the barycentre of the solar system in DE421's numbers; the Moon and the Earth are the last."""
# The Earth is never a target; the Moon is one only for an observer whose position is known.
_FROM_ANYWHERE, _FROM_EARTH, _EARTH = tuple(_NAIF)[:-1], tuple(_NAIF)[:-2], len(_NAIF) - 1
_NOWHERE, _AT_REST = np.full(3, np.nan), np.zeros(3)
_STEP_DAYS = 0.5
"""Step of the table, days: a cubic through positions and velocities is within 0.2 km of the Moon and 4 km of
Mercury."""
_TABLE_DAYS = 366.0
_LIGHT_DAY_AU = SPEED_OF_LIGHT_KM_S * 86_400.0 / AU_KM
_BODY_PX = 3.0
"""Largest distance of a planet's centroid from its prediction, px; that of a star is similar
(`startracker.estimation.refine.NAMED_PX`)."""
_RADIUS_RAD = {"Sun": math.radians(0.28), "Moon": math.radians(0.29)}
_PLANET_RAD = math.radians(33.0 / 3600.0)
"""Largest apparent radii from near the Earth; Venus has the largest of the planets."""
_PARALLAX_RAD = math.radians(35.0 / 3600.0)
"""Largest parallax of a planet between the Earth's centre and an observer on or near the ground: Venus at 0.26 au."""


class SeenBodies(NamedTuple):
    """Detected Sun, Moon and planets, as columns of equal length B."""

    name: NDArray[np.str_]
    """English names."""
    centroid: IntArray
    """Index of the centroid of each, (B,)."""
    xy: FloatArray
    """Their centroids, px, (B, 2)."""
    residual_px: FloatArray
    """Measured minus predicted position, px, (B, 2)."""


NO_BODIES = SeenBodies(np.empty(0, np.str_), np.empty(0, np.int64), np.empty((0, 2)), np.empty((0, 2)))
"""No bodies."""


def body_directions(observer: Observer) -> dict[str, FloatArray]:
    """ICRS unit vectors (3,) of the bodies as seen by an observer, with light time to first order.

    Aberration is included if the velocity is known, as in the directions that a tracker receives. Without a position
    the observer is assumed at the Earth's centre, from which the direction of the Moon differs by up to 1° from that on
    the ground; the Moon is then omitted. The directions are from DE421, and within 0.1″ of Skyfield.

    Raises
    ------
    InputError
        If the ephemeris (DE421: 1899-07-29 to 2053-10-09) does not cover the epoch.
    """
    return dict(zip(*_directions(observer), strict=True))


def _directions(observer: Observer) -> tuple[tuple[str, ...], FloatArray]:
    """Names, and directions (B, 3), of `body_directions`."""
    jd = J2000_JD_TT + DAYS_PER_JULIAN_YEAR * (observer.epoch_jyear - 2000.0)
    if not DE421_SPAN_JD[0] + _STEP_DAYS < jd < DE421_SPAN_JD[1] - _STEP_DAYS:
        raise InputError(outside_ephemeris(jd))
    first_jd, table = _table(math.floor((jd - J2000_JD_TT) / _TABLE_DAYS))
    node, u = divmod((jd - first_jd) / _STEP_DAYS, 1.0)
    here, names = observer.position_au, _FROM_ANYWHERE
    if here is None:
        here, names = _NOWHERE, _FROM_EARTH
    beta = _AT_REST if observer.velocity_km_s is None else observer.velocity_km_s / SPEED_OF_LIGHT_KM_S
    return names, _directions_from(here, beta, table[int(node) : int(node) + 2], u, len(names))


def seen_bodies(
    xy: FloatArray,
    camera: Camera,
    matrix: FloatArray,
    observer: Observer | None,
    stars: tuple[IntArray, FloatArray],
) -> SeenBodies:
    """Centroids that belong to a body of the solar system, according to its ephemeris.

    A centroid belongs to a body if it is the nearest to the predicted position, within 3 px and the radius of the disk,
    and farther from the star with which it is identified, if any.

    Parameters
    ----------
    xy : (N, 2) array
        Centroids, pixels.
    camera : Camera
        Camera of the image.
    matrix : (3, 3) array
        ICRS to camera.
    observer : Observer, optional
        Supplies epoch, velocity and position; without it, or for a date outside DE421, there are no bodies.
    stars : tuple
        Indices (M,) of the identified centroids, and their residuals (M, 2), px.
    """
    if observer is None or not len(xy):
        return NO_BODIES
    try:
        names, directions = _directions(observer)
    except InputError:
        return NO_BODIES
    off_axis = directions @ matrix[2]
    near = (off_axis > math.cos(camera.half_diagonal_rad)).nonzero()[0].tolist()
    if not near:
        return NO_BODIES
    from_star = dict(zip(stars[0].tolist(), np.hypot(stars[1][:, 0], stars[1][:, 1]).tolist(), strict=True))
    found = []
    for k in near:
        predicted = camera.project((directions[k] @ matrix.T)[None])[0]
        reach_rad = _RADIUS_RAD.get(names[k], _PLANET_RAD)
        if observer.position_au is None:
            reach_rad += _PARALLAX_RAD
        away = np.hypot(xy[:, 0] - predicted[0], xy[:, 1] - predicted[1])
        row = int(np.argmin(away))
        if away[row] <= _BODY_PX + reach_rad / camera.pixel_rad and away[row] < from_star.get(row, math.inf):
            found.append((names[k], row, xy[row], xy[row] - predicted))
    return SeenBodies(*(np.array(column) for column in zip(*found, strict=True))) if found else NO_BODIES


def beside_bodies(directions: FloatArray, observer: Observer | None, pixel_rad: float) -> NDArray[np.bool_]:
    """Mask (N,) of apparent directions (N, 3) so close to a body of the solar system that its image may be mistaken for
    a star.

    They are within 6 px and the radius of the disk. All False without an observer or for a date outside DE421.
    """
    beside = np.zeros(len(directions), dtype=bool)
    if observer is None:
        return beside
    try:
        names, bodies = _directions(observer)
    except InputError:
        return beside
    reach_rad = np.array([_RADIUS_RAD.get(name, _PLANET_RAD) for name in names]) + 2.0 * _BODY_PX * pixel_rad
    return np.asarray((directions @ bodies.T > np.cos(reach_rad)).any(axis=1))


@kernel
def _directions_from(here: FloatArray, beta: FloatArray, nodes: FloatArray, u: float, bodies: int) -> FloatArray:
    """Unit vectors (bodies, 3), ICRF axes, from a barycentric position (3,), au, or from the Earth if that is NaN.

    Aberration (`startracker.observer.aberrate`) is included for a velocity `beta` (3,) in units of that of light.
    `nodes` (2, 2, 10, 3) are two successive rows of `_table`: positions and velocities at the date `u` steps after the
    first are those of a cubic (Hermite), and light time is to first order.
    """
    position, velocity, out = np.empty((_EARTH + 1, 3)), np.empty((_EARTH + 1, 3)), np.empty((bodies, 3))
    for body in range(_EARTH + 1):
        for axis in range(3):
            change = nodes[1, 0, body, axis] - nodes[0, 0, body, axis]
            left, right = nodes[0, 1, body, axis] - change, nodes[1, 1, body, axis] - change
            # Cubic Hermite polynomial: the chord, plus u (1 − u) times the deviations of the end slopes from it.
            between = u * (1.0 - u) * ((1.0 - u) * left - u * right)
            position[body, axis] = nodes[0, 0, body, axis] + u * change + between
            slope = change + (1.0 - u) * (1.0 - 3.0 * u) * left - u * (2.0 - 3.0 * u) * right
            # Per day instead of per step of the table.
            velocity[body, axis] = slope / _STEP_DAYS
    start = position[_EARTH] if math.isnan(here[0]) else here
    for body in range(bodies):
        x, y, z = position[body, 0] - start[0], position[body, 1] - start[1], position[body, 2] - start[2]
        light_days = math.sqrt(x * x + y * y + z * z) / _LIGHT_DAY_AU
        x, y = x - velocity[body, 0] * light_days, y - velocity[body, 1] * light_days
        z -= velocity[body, 2] * light_days
        out[body, 0], out[body, 1], out[body, 2] = aberrated(x, y, z, (beta[0], beta[1], beta[2]))
    return out


@functools.lru_cache(maxsize=4)
def _table(number: int) -> tuple[float, FloatArray]:
    """Table (T, 2, 10, 3) of barycentric positions of the bodies, au, and of their changes per step, for one year.

    Also returns the first date of the year, which is numbered from J2000.
    """
    from jplephem.spk import SPK

    first_jd = J2000_JD_TT + _TABLE_DAYS * number
    jd = first_jd + _STEP_DAYS * np.arange(round(_TABLE_DAYS / _STEP_DAYS) + 2)
    segments: dict[int, FloatArray] = {}
    with SPK.open(str(de421_file())) as kernel:
        for segment in kernel.segments:
            # The tables of the first and last years extend beyond DE421; `_directions` rejects such dates.
            position_km, velocity_km_day = segment.compute_and_differentiate(np.clip(jd, *DE421_SPAN_JD))
            segments[segment.target] = np.stack([position_km, velocity_km_day * _STEP_DAYS]) / AU_KM
    paths = [np.sum([segments[number] for number in path], axis=0) for path in _NAIF.values()]
    # From (body, position or change, axis, time) to the order in which one date is contiguous.
    return first_jd, np.ascontiguousarray(np.array(paths).transpose(3, 1, 0, 2))
