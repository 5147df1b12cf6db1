"""Diffuse sky background by direction: zodiacal light and unresolved starlight.

Directions are ICRS; brightness is in S10, the number of stars with V = 10 and the Sun's colour per square degree
(27.78 mag arcsec⁻²).
"""

from __future__ import annotations

import csv
import functools
import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from simulator.sky.celestial_frames import ECLIPTIC, GALACTIC
from simulator.sky.earth import earth_radiance_map
from simulator.sky.star_counts import light_between_s10
from startracker.catalog import load_catalog
from startracker.core import FloatArray
from startracker.files import included_lines
from startracker.geometry.attitude import Attitude, direction_to_radec, radec_to_direction
from startracker.geometry.camera import Camera
from startracker.geometry.distortion import Distortion

if TYPE_CHECKING:
    from simulator.sky.parameters import Sky

POLE_S10 = 60.0
"""Zodiacal light at the ecliptic poles, ±3; Leinert et al. 1998, section 8.3."""

PIONEER_LIMIT_V = 6.5
"""Stars brighter than this are not included in the Pioneer map (Toller 1981; Leinert et al. 1998, section 10.3)."""

_CAP_DEG = 6.0
"""Radius within which the catalogue's light is averaged; the nodes of the map are 4° to 10° apart."""

_LEAST_SHARE = 0.25
"""Minimum fraction of the measured light that remains diffuse for any number of rendered stars: the diffuse galactic
light alone is 10 to 35 % (Leinert et al. 1998, table 39, after Toller 1981)."""

STAR_CONTRAST = 0.8
"""Exponent k of the model (number of stars) ∝ (measured starlight)^k. Tycho-2 (to V = 11.5) has 150, 50 and 25 stars
per square degree at galactic latitudes 0, ±30° and ±90° (Høg et al. 2000, A&A 355, L27), a factor of 6, while the light
varies by a factor of 9."""

_GRID_PX = 32
"""Step of the grid on which `background_map` evaluates the sky."""

_LEAST_ELONGATION_DEG = 1.0
"""Elongation below which the extrapolated zodiacal light is constant."""


def sky_brightness_s10(directions: ArrayLike, sun_direction: ArrayLike, sky: Sky) -> FloatArray:
    """Brightness (N,) of the diffuse sky, S10, by its `background_model`.

    ``constant``: `background_s10` everywhere. ``leinert1998``: `zodiacal_s10` plus `starlight_s10`.

    Parameters
    ----------
    directions : array_like, shape (N, 3)
        Unit vectors, ICRS.
    sun_direction : array_like, shape (3,)
        Apparent direction of the Sun, ICRS.
    sky : Sky
        Its `background`, `background_model`, `background_s10`, `catalog`, `magnitude_limit`, `faint_magnitude_limit`.
    """
    directions = np.atleast_2d(np.asarray(directions, dtype=float))
    if not sky.background:
        return np.zeros(len(directions))
    if sky.background_model == "constant":
        return np.full(len(directions), sky.background_s10)
    rendered = sky.magnitude_limit, sky.faint_magnitude_limit
    return zodiacal_s10(directions, sun_direction) + starlight_s10(directions, sky.catalog, *rendered)


def diffuse_sky_s10(
    camera: Camera, attitude: Attitude, r_km: ArrayLike, sun_direction: ArrayLike, sky: Sky
) -> float | FloatArray:
    """All diffuse light in the field, S10: sky, Earth and the Earth's limb.

    A number if the sky is `constant` and the Earth is outside the field; otherwise an array (height, width).

    Parameters
    ----------
    camera, attitude : Camera, Attitude
        Projection; ICRS → camera at mid-exposure.
    r_km, sun_direction : array_like, shape (3,)
        Position of the spacecraft (GCRS); direction of the Sun.
    sky : Sky
        Background model and the Earth.
    """
    earth = earth_radiance_map(camera, attitude, r_km, sun_direction, sky)
    even = sky.background_model == "constant" or not sky.background
    beyond: float | FloatArray = sky.background_s10 if sky.background else 0.0
    if not even:
        beyond = background_map(camera, attitude, sun_direction, sky)
    if earth is None:
        return beyond
    s10, hidden = earth
    return np.where(hidden, 0.0, beyond) + s10


def background_map(
    camera: Camera, attitude: Attitude, sun_direction: ArrayLike, sky: Sky, grid_px: int = _GRID_PX
) -> FloatArray:
    """Brightness (height, width) of the diffuse sky in every pixel, S10.

    The sky is evaluated on a grid with a spacing of `grid_px` pixels that includes the last row and column, and
    interpolated bilinearly; the nodes of the tables are 4° and more apart. Pixels without a direction in the lens model
    use that of the lens without distortion; if it does not exist either, they have no light.

    Parameters
    ----------
    camera : Camera
        Projection.
    attitude : Attitude
        ICRS → camera at mid-exposure.
    sun_direction, sky
        As in `sky_brightness_s10`.
    """
    x = np.unique(np.append(np.arange(0, camera.width, grid_px), camera.width - 1)).astype(float)
    y = np.unique(np.append(np.arange(0, camera.height, grid_px), camera.height - 1)).astype(float)
    nodes = np.stack([a.ravel() for a in np.meshgrid(x, y)], axis=1)
    # A strong distortion may leave corners without a direction; the sky changes so slowly that the lens without
    # distortion is good enough there.
    seen = camera.unproject(nodes)
    lost = ~np.isfinite(seen).all(axis=1)
    if lost.any():
        seen[lost] = replace(camera, distortion=Distortion()).unproject(nodes[lost])
    known = np.isfinite(seen).all(axis=1)
    flat = np.zeros(len(nodes))
    flat[known] = sky_brightness_s10(attitude.inverse.apply(seen[known]), sun_direction, sky)
    value = flat.reshape(len(y), len(x))
    # Bilinear interpolation, first along the rows of the grid, then between them.
    columns = np.arange(camera.width, dtype=float)
    rows = np.arange(camera.height, dtype=float)
    along = np.array([np.interp(columns, x, line) for line in value])
    k = np.clip(np.searchsorted(y, rows, side="right") - 1, 0, max(len(y) - 2, 0))
    if len(y) == 1:
        return np.repeat(along, camera.height, axis=0)
    t = ((rows - y[k]) / (y[k + 1] - y[k]))[:, None]
    return np.asarray((1.0 - t) * along[k] + t * along[k + 1])


# ---------------------------------------------------------------------- zodiacal light
def zodiacal_s10(directions: ArrayLike, sun_direction: ArrayLike) -> FloatArray:
    """Zodiacal light (N,), S10 at 500 nm, seen from 1 au.

    Leinert et al. 1998, table 16, by |λ − λ_Sun| and |β|, with 60 S10 at the pole; bilinear interpolation of the
    logarithm.

    Parameters
    ----------
    directions : array_like, shape (N, 3)
        Unit vectors, ICRS.
    sun_direction : array_like, shape (3,)
        Direction of the Sun, ICRS.

    Notes
    -----
    The table is accurate to about 10 % and is an annual mean. Not modelled: the tilt of the dust's plane of symmetry
    (±10 % at the poles over the year), the Earth's distance (±4 %), and the reddening relative to the Sun (S10 at
    500 nm are taken as S10 in V: 2 %). Within 15° of the Sun the table has gaps; there the light is extrapolated as
    ε^−2.2 from 9,000 S10 on the ecliptic and 2,450 S10 above the Sun at ε = 15°, down to ε = 1° (our assumption).
    """
    ecliptic = np.atleast_2d(np.asarray(directions, dtype=float)) @ ECLIPTIC.T
    sun = ECLIPTIC @ np.asarray(sun_direction, dtype=float)
    longitude, latitude = direction_to_radec(ecliptic)
    sun_longitude = math.atan2(sun[1], sun[0])
    # The difference of longitudes is wrapped into [−π, π); the table is symmetric about the Sun and the ecliptic.
    apart = np.degrees(np.abs((longitude - sun_longitude + np.pi) % (2.0 * np.pi) - np.pi))
    nodes, latitudes, table = _zodiacal_table()
    value: FloatArray = np.exp(_bilinear(nodes, latitudes, np.log(table), apart, np.degrees(np.abs(latitude))))
    return value


@functools.cache
def _zodiacal_table() -> tuple[FloatArray, FloatArray, FloatArray]:
    longitude, latitude, table = _read("zodiacal_light.csv")
    for i, j in zip(*np.nonzero(np.isnan(table)), strict=True):
        table[i, j] = _near_sun(longitude[i], latitude[j])
    return longitude, np.append(latitude, 90.0), np.column_stack([table, np.full(len(longitude), POLE_S10)])


def _near_sun(longitude_deg: float, latitude_deg: float) -> float:
    """Extrapolation of the table towards the Sun; see `zodiacal_s10`."""
    lon, lat = math.radians(longitude_deg), math.radians(latitude_deg)
    elongation = math.degrees(math.acos(math.cos(lon) * math.cos(lat)))
    # Position angle about the Sun, 0 along the ecliptic. The reciprocal of the brightness at 15° is interpolated
    # between the ecliptic and the direction above the Sun.
    above = math.atan2(math.sin(lat), math.sin(lon) * math.cos(lat)) if elongation > 0 else 0.0
    at_15 = 1.0 / (math.cos(above) ** 2 / 9000.0 + math.sin(above) ** 2 / 2450.0)
    return float(at_15 * (max(elongation, _LEAST_ELONGATION_DEG) / 15.0) ** -2.2)


# ---------------------------------------------------------------------- starlight
def starlight_s10(
    directions: ArrayLike, catalog: str, magnitude_limit: float, faint_limit: float | None = None
) -> FloatArray:
    """Starlight (N,), S10, that is not rendered as stars: fainter stars, diffuse galactic light, galaxies.

    The map measured by Pioneer 10 from beyond the zodiacal dust (Toller 1981, in Leinert et al. 1998) contains stars
    fainter than V = 6.5. Catalogue stars between 6.5 and `magnitude_limit` are rendered and therefore subtracted from
    the map; with a limit below 6.5 the stars that are not rendered are added. The catalogue's light is averaged within
    6° of each node of the map; at least a quarter of the measured light remains.

    Parameters
    ----------
    directions : array_like, shape (N, 3)
        Unit vectors, ICRS.
    catalog : str
        Name of the catalogue whose stars are rendered.
    magnitude_limit : float
        Faintest V rendered.
    faint_limit : float, optional
        Faintest V of the statistical stars that are rendered beyond it (`simulator.sky.faint_stars`), whose mean light
        is subtracted as well.

    Notes
    -----
    The map at 440 nm is taken as V: S10 are units of solar colour, and starlight is redder than the Sun by about
    0.1 mag (10 %). Its steps of 10° × 4° to 10° smooth the Milky Way. The gap in the Pioneer data (towards RA 140°,
    Dec +15°) is filled with the mean of the map at similar galactic latitude and longitude distance from the
    anticentre.
    """
    ra, dec = direction_to_radec(np.atleast_2d(np.asarray(directions, dtype=float)))
    nodes_ra, nodes_dec, table = _starlight_table(catalog, float(magnitude_limit), faint_limit)
    return _bilinear(nodes_ra, nodes_dec, table, np.degrees(ra), np.degrees(dec))


def star_contrast(directions: ArrayLike) -> FloatArray:
    """Density of faint stars (N,) in directions (N, 3) relative to the mean over the sky: the measured starlight to the
    power of `STAR_CONTRAST`, normalised."""
    ra, dec = direction_to_radec(np.atleast_2d(np.asarray(directions, dtype=float)))
    return _bilinear(*_contrast_table(), np.degrees(ra), np.degrees(dec))


@functools.cache
def _contrast_table() -> tuple[FloatArray, FloatArray, FloatArray]:
    ra, dec, measured = _pioneer()
    ra, dec, table = _closed(ra, dec, measured**STAR_CONTRAST)
    # Points of equal areas are equidistant in the sine of the declination; their plain mean is that over the sky.
    sines, longitudes = np.linspace(-1.0, 1.0, 361), np.arange(0.0, 360.0, 2.0)
    even = np.meshgrid(longitudes, np.degrees(np.arcsin(0.5 * (sines[1:] + sines[:-1]))))
    return ra, dec, table / _bilinear(ra, dec, table, even[0].ravel(), even[1].ravel()).mean()


@functools.lru_cache(maxsize=8)
def _starlight_table(catalog: str, limit: float, faint: float | None) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The map minus the light of the stars that are rendered."""
    ra, dec, measured = _pioneer()
    # The map contains the stars fainter than 6.5. Rendered ones among them are subtracted; with a brighter limit the
    # stars between the limit and 6.5, which are in neither, are added.
    drawn = _catalog_light(catalog, min(limit, PIONEER_LIMIT_V), max(limit, PIONEER_LIMIT_V), ra, dec)
    if limit <= PIONEER_LIMIT_V:
        drawn = -drawn
    if faint is not None:
        light = light_between_s10(max(limit, PIONEER_LIMIT_V), max(faint, PIONEER_LIMIT_V))
        drawn = drawn + light * star_contrast(_node_directions(ra, dec)).reshape(drawn.shape)
    return _closed(ra, dec, np.maximum(measured - drawn, _LEAST_SHARE * measured))


def _closed(ra: FloatArray, dec: FloatArray, table: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A map extended by both poles and by the meridian 360°, so that it can be interpolated everywhere."""
    ends = [np.full(len(ra), table[:, k].mean()) for k in (0, -1)]
    table = np.column_stack([ends[0], table, ends[1]])
    return np.append(ra, 360.0), np.concatenate([[-90.0], dec, [90.0]]), np.vstack([table, table[:1]])


@functools.cache
def _pioneer() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Right ascensions, declinations and the map with filled gaps."""
    ra, dec, table = _read("background_starlight.csv")
    galactic = _node_directions(ra, dec) @ GALACTIC.T
    longitude, latitude = (np.degrees(a) for a in direction_to_radec(galactic))
    from_anticentre, height = np.abs(longitude - 180.0), np.abs(latitude)
    flat = table.ravel()
    known = ~np.isnan(flat)
    # A gap gets the mean of all nodes, weighted by a Gaussian of 4° in galactic latitude and 20° in longitude, both
    # folded by the symmetry of the Galaxy about its plane and its centre.
    for k in np.flatnonzero(~known):
        nearness = np.exp(
            -0.5 * ((height[known] - height[k]) / 4.0) ** 2
            - 0.5 * ((from_anticentre[known] - from_anticentre[k]) / 20.0) ** 2
        )
        flat[k] = float(nearness @ flat[known] / nearness.sum())
    return ra, dec, flat.reshape(table.shape)


def _catalog_light(catalog: str, brightest: float, faintest: float, ra: FloatArray, dec: FloatArray) -> FloatArray:
    """Mean brightness, S10, of catalogue stars with brightest < V ≤ faintest around each node."""
    stars = load_catalog(catalog)
    rows = np.flatnonzero((stars.v_mag > brightest) & (stars.v_mag <= faintest))
    if len(rows) == 0:
        return np.zeros((len(ra), len(dec)))
    stars = stars.select(rows)
    light = 10.0 ** (-0.4 * (stars.v_mag - 10.0))
    tree = cKDTree(stars.directions(2000.0))
    # The radius of the cap as a chord between unit vectors; the light is divided by the cap's area in square degrees.
    caps = tree.query_ball_point(_node_directions(ra, dec), 2.0 * math.sin(math.radians(_CAP_DEG) / 2.0))
    square_degrees = 2.0 * math.pi * (1.0 - math.cos(math.radians(_CAP_DEG))) / math.radians(1.0) ** 2
    return np.array([light[cap].sum() for cap in caps]).reshape(len(ra), len(dec)) / square_degrees


def _node_directions(ra_deg: FloatArray, dec_deg: FloatArray) -> FloatArray:
    nodes = np.meshgrid(np.radians(ra_deg), np.radians(dec_deg), indexing="ij")
    return radec_to_direction(nodes[0].ravel(), nodes[1].ravel())


# ---------------------------------------------------------------------- tables
def _read(name: str) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Row nodes, column nodes and values (NaN where empty) of an included table."""
    header, *rows = csv.reader(included_lines("simulator.sky", name))
    values = np.array([[float(cell) if cell else math.nan for cell in row] for row in rows])
    return values[:, 0], np.array([float(cell) for cell in header[1:]]), values[:, 1:].copy()


def _bilinear(x_nodes: FloatArray, y_nodes: FloatArray, table: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    # Cells (i, j) of the table and the fractions (s, t) within them; points beyond the nodes are extrapolated.
    i = np.clip(np.searchsorted(x_nodes, x, side="right") - 1, 0, len(x_nodes) - 2)
    j = np.clip(np.searchsorted(y_nodes, y, side="right") - 1, 0, len(y_nodes) - 2)
    s = (x - x_nodes[i]) / (x_nodes[i + 1] - x_nodes[i])
    t = (y - y_nodes[j]) / (y_nodes[j + 1] - y_nodes[j])
    low = (1.0 - t) * table[i, j] + t * table[i, j + 1]
    high = (1.0 - t) * table[i + 1, j] + t * table[i + 1, j + 1]
    return np.asarray((1.0 - s) * low + s * high)
