"""Light before the exposure: sources with their rates, electrons per second, and their shapes for rendering."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from simulator.frame import TrueSources
from simulator.optics.bodies import NO_LIMB, sun_angle_rad
from simulator.scene import NEAR_BODY_RAD, Scene
from simulator.sky.earth import has_disk, limbs, occulted, unhidden
from simulator.sky.instants import Bodies
from simulator.sky.parameters import Sky
from simulator.sky.photometry import Photometer
from simulator.sky.satellites import Satellites
from simulator.sky.spectra import SOLAR_B_V
from startracker.core import FloatArray, IntArray
from startracker.geometry.camera import Camera

_KIND_OF_BODY = {"Sun": "sun", "Moon": "moon"}


@dataclass(frozen=True, eq=False)
class Light:
    """Sources of light, as columns of equal length N; the first seven are as in `simulator.frame.TrueSources`."""

    id: IntArray
    name: NDArray[np.str_]
    kind: NDArray[np.str_]
    direction: FloatArray
    v_mag: FloatArray
    b_v: FloatArray
    variable: NDArray[np.bool_]
    rate_e_s: FloatArray
    """(N,): Photo-electrons per second through the lens, without vignetting."""
    radius_rad: FloatArray
    """(N,): Angular radius; 0 for stars."""
    lit: FloatArray
    """(N,): Illuminated fraction of the disk."""
    sun_angle_rad: FloatArray
    """(N,): Direction of the Sun on the disk, from +x (columns) towards +y (rows)."""
    limb: FloatArray
    """(N, 3): Limb of the Earth across the disk (`simulator.optics.bodies.Limb`)."""
    wavelength_nm: FloatArray
    """(N,): Mean wavelength of the photo-electrons."""

    def joined(self, other: Light) -> Light:
        """These sources followed by others."""
        return Light(*(np.concatenate([getattr(light, f.name) for light in (self, other)]) for f in fields(Light)))

    def truth(self, xy: FloatArray, image_xy: FloatArray, electrons: FloatArray) -> TrueSources:
        """The sources as a frame's truth, with positions (N, 2) and electrons (N,) over the exposure."""
        kept = ("id", "name", "kind", "direction", "v_mag", "b_v", "variable")
        columns = {name: getattr(self, name) for name in kept}
        return TrueSources(xy=xy, image_xy=image_xy, electrons=electrons, **columns)


def star_rates_e_s(scene: Scene, photometer: Photometer, sky: Sky) -> FloatArray:
    """Photo-electrons per second of the scene's stars (N,); 0 where they are hidden."""
    rate = photometer.star_electrons_per_s(scene.catalog, scene.b_v, scene.giant)[scene.rows]
    rate[hidden_stars(scene, scene.star_directions, sky)] = 0.0
    return rate


def hidden_stars(scene: Scene, directions: FloatArray, sky: Sky) -> NDArray[np.bool_]:
    """Whether stars in directions (N, 3) are behind the Earth, or behind a body that the spacecraft orbits."""
    # The Earth is tested as a sphere around the nadir, any other near body as a disk of its angular radius.
    hidden = occulted(directions, scene.r_km) if has_disk(sky, scene.r_km) else np.zeros(len(directions), dtype=bool)
    for body in (scene.bodies.angular_radius_rad > NEAR_BODY_RAD).nonzero()[0]:
        hidden |= directions @ scene.bodies.direction[body] > math.cos(scene.bodies.angular_radius_rad[body])
    return hidden


def star_light(scene: Scene, rows: IntArray, rate_e_s: FloatArray, photometer: Photometer, coloured: bool) -> Light:
    """A selection of a scene's stars as sources; wavelengths only if images depend on them."""
    catalog, stars, none = scene.catalog, scene.rows[rows], np.zeros(len(rows))
    b_v = scene.b_v[stars]
    return Light(
        id=catalog.id[stars],
        name=catalog.star_name[stars],
        kind=np.full(len(rows), "star", dtype="U8"),
        direction=scene.star_directions[rows],
        v_mag=catalog.v_mag[stars],
        b_v=b_v,
        variable=catalog.variable[stars],
        rate_e_s=rate_e_s,
        radius_rad=none,
        lit=none + 1.0,
        sun_angle_rad=none,
        limb=none[:, None] + NO_LIMB,
        wavelength_nm=photometer.effective_wavelength_nm(b_v, scene.giant[stars]) if coloured else none,
    )


def body_rates_e_s(scene: Scene, bodies: Bodies, photometer: Photometer, sky: Sky) -> FloatArray:
    """Photo-electrons per second of bodies (N,), reduced by the part of each that the Earth hides."""
    share = unhidden(bodies, scene.r_km, scene.sun_direction, sky)
    return photometer.body_electrons_per_s(bodies.name, bodies.v_mag) * share


def body_light(
    scene: Scene, bodies: Bodies, rate_e_s: FloatArray, camera: Camera, photometer: Photometer, sky: Sky
) -> Light:
    """Bodies of the solar system as sources, with the phase and the Earth's limb on their disks."""
    attitude = scene.pointing.camera

    # The Sun's direction and that of the Earth's limb are angles on the image, which depend on the attitude.
    def angles(towards: FloatArray) -> FloatArray:
        return np.array([sun_angle_rad(camera, attitude, body, towards) for body in bodies.direction])

    limb = np.tile(NO_LIMB, (len(bodies), 1))
    if has_disk(sky, scene.r_km):
        limb[:, 0], limb[:, 1] = limbs(bodies.direction, bodies.angular_radius_rad, scene.r_km)
        limb[:, 2] = angles(-scene.r_km)
    return Light(
        id=np.zeros(len(bodies), np.int64),
        name=bodies.name,
        kind=np.array([_KIND_OF_BODY.get(str(name), "planet") for name in bodies.name], dtype="U8"),
        direction=bodies.direction,
        v_mag=bodies.v_mag,
        b_v=bodies.b_v,
        variable=np.zeros(len(bodies), dtype=bool),
        rate_e_s=rate_e_s,
        radius_rad=bodies.angular_radius_rad,
        lit=bodies.illuminated_fraction if sky.phases else np.ones(len(bodies)),
        sun_angle_rad=angles(scene.sun_direction),
        limb=limb,
        wavelength_nm=photometer.body_wavelength_nm(bodies.name),
    )


def satellite_light(
    scene: Scene, satellites: Satellites, rate_e_s: FloatArray, camera: Camera, photometer: Photometer, sky: Sky
) -> Light:
    """Satellites as sources of reflected sunlight; those near enough to be resolved are disks with a phase."""
    count, attitude, direction = len(satellites), scene.pointing.camera, satellites.direction
    return Light(
        id=satellites.number,
        name=satellites.name,
        kind=np.full(count, "satellite"),
        direction=direction,
        v_mag=satellites.v_mag,
        b_v=np.full(count, SOLAR_B_V),
        variable=np.zeros(count, dtype=bool),
        rate_e_s=rate_e_s,
        radius_rad=satellites.angular_radius_rad,
        lit=satellites.illuminated_fraction if sky.phases else np.ones(count),
        sun_angle_rad=np.array([sun_angle_rad(camera, attitude, one, scene.sun_direction) for one in direction]),
        limb=np.tile(NO_LIMB, (count, 1)),
        wavelength_nm=photometer.body_wavelength_nm(np.full(count, "Sun")),
    )


def near_image(xy: FloatArray, extent_px: FloatArray, width: int, height: int) -> IntArray:
    """Rows of the positions (N, 2) that are within an extent (N,) of the image, in pixels."""
    x, y = xy[:, 0], xy[:, 1]
    near = (-x <= extent_px) & (x - width <= extent_px) & (-y <= extent_px) & (y - height <= extent_px)
    return near.nonzero()[0]


def path_middles(paths: FloatArray, weights: FloatArray, otherwise: FloatArray) -> FloatArray:
    """Weighted means (N, 2) of paths (N, K, 2) over the moments that are not NaN, or `otherwise` (N, 2) for a path
    without any."""
    finite = np.isfinite(paths)
    if finite.all():
        return np.asarray(np.einsum("k,nkj->nj", weights, paths) / weights.sum())
    known = np.asarray(finite.all(axis=2))
    share = np.where(known, weights, 0.0)
    total = share.sum(axis=1)[:, None]
    sums = np.einsum("nk,nkj->nj", share, np.where(known[..., None], paths, 0.0))
    return np.asarray(np.divide(sums, total, out=otherwise.copy(), where=total > 0.0))
