"""The focal plane: mean photo-electrons per pixel of a scene, with lens, point-spread function and smear.

Sources and background are rates in electrons per second until `simulator.exposure` integrates them over the exposure.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from simulator.exposure import Exposure, Motion, Paths
from simulator.frame import TrueSources
from simulator.light import (
    Light,
    body_light,
    body_rates_e_s,
    hidden_stars,
    near_image,
    path_middles,
    satellite_light,
    star_light,
    star_rates_e_s,
)
from simulator.optics.bodies import LAW_OF_BODY, LAWS, LitDisk, draw_body
from simulator.optics.disk import add_disk
from simulator.optics.displacement import Displacement
from simulator.optics.drift import Drift
from simulator.optics.ghosts import Ghost, ghost_sources
from simulator.optics.illumination import Vignetting, illumination_map, star_illumination
from simulator.optics.psf_set import PsfSet
from simulator.optics.splat import add_stars
from simulator.optics.stray_light import Baffle, stray_light_e_s_pixel
from simulator.optics.tether import Tether, TetherPoints, tether_points
from simulator.optics.thermal import LensTemperature
from simulator.scene import Scene
from simulator.sky.apparent import aberrated, largest_shift_rad
from simulator.sky.background import diffuse_sky_s10
from simulator.sky.earth import stray_sources, unhidden
from simulator.sky.faint_stars import FaintSky
from simulator.sky.magnitudes import sun_v
from simulator.sky.parameters import Sky
from simulator.sky.photometry import Photometer
from simulator.sky.spectra import SOLAR_B_V
from startracker.core import FloatArray, IntArray
from startracker.geometry.camera import Camera

_EDGE_MARGIN_PX = 160.0
"""Maximum distance outside the detector at which stars are rendered if their wings overlap it; the wings of 10⁶
electrons reach as far."""

_DISK_PX = 1.5
"""Bodies with a larger radius are rendered as disks, smaller ones as points with the PSF."""


class Illumination(NamedTuple):
    """Light of one exposure."""

    sources: TrueSources
    """Every source whose light reaches the detector."""
    mean_e: FloatArray
    """(height, width): Mean photo-electrons, of the sources and of the background."""
    excluded: tuple[str, ...]
    """Bodies within the baffle's exclusion angle."""


class Reaching(NamedTuple):
    """Sources whose light reaches the detector."""

    rows: IntArray
    """(N,): Rows in the table of sources."""
    in_camera: FloatArray
    """(N, 3): Unit vectors in camera axes at mid-exposure."""
    xy: FloatArray
    """(N, 2): Pixels at mid-exposure."""
    electrons: FloatArray
    """(N,): Electrons over the exposure for a static source."""

    def joined(self, other: Reaching) -> Reaching:
        """These sources followed by others."""
        return Reaching(*(np.concatenate(pair) for pair in zip(self, other, strict=True)))


@dataclass(frozen=True, eq=False)
class FocalPlane:
    """Camera, response and point spread functions of one instrument."""

    camera: Camera
    """The calibrated camera, as in the frame."""
    true_camera: Camera
    """The true camera at the epoch, with which the sky is rendered; `at` returns that of another time."""
    temperature: LensTemperature
    """Temperature of the lens over time."""
    displacement: Displacement
    """Displacement of star images from the positions of the true camera."""
    photometer: Photometer
    """Aperture, transmission and quantum efficiency."""
    psfs: PsfSet
    """Point-spread functions."""
    sky: Sky
    """Parameters of the sky."""
    faint_sky: FaintSky | None
    """Synthetic stars fainter than the catalogue's limit; None for none."""
    aperture_mm: float
    """Diameter of the entrance pupil."""
    pixel_area_cm2: float
    """Area of a pixel."""
    vignetting: Vignetting
    """Fall of the illumination with the angle from the optical axis."""
    ghosts: tuple[Ghost, ...]
    """Ghost images by reflections within the lens."""
    baffle: Baffle | None
    """Baffle before the lens; None for none."""
    tether: Tether
    """Tether of the spacecraft; its diameter is 0 if there is none."""
    _half_fields: dict[float, float] = field(default_factory=dict, repr=False)

    def at(self, t_s: float) -> FocalPlane:
        """The focal plane at the lens temperature of a time, s after the epoch; itself if the temperature is
        constant."""
        if self.temperature.swing_k == 0.0:
            return self
        camera = self.temperature.camera_at(self.camera, t_s)
        return replace(self, true_camera=camera, displacement=replace(self.displacement, camera=camera))

    def half_field_rad(self, exposure_s: float) -> float:
        """Maximum angle from the boresight, at any moment of the exposure, of sources whose light can reach the
        detector."""
        if exposure_s not in self._half_fields:
            # The radius of the PSF that is rendered grows with the brightness of a source, and none is brighter than
            # the Sun. The field is the cone around the detector enlarged by this radius on every side.
            camera = self.true_camera
            brightest_e = self.photometer.electrons_per_s(sun_v(1.0), SOLAR_B_V) * exposure_s
            wing_px = min(float(self.psfs.radius_px(brightest_e)), _EDGE_MARGIN_PX)
            reach_px = math.ceil(wing_px + self.displacement.most_px) + 1
            grown = replace(
                camera,
                width=camera.width + 2 * reach_px,
                height=camera.height + 2 * reach_px,
                cx=camera.cx + reach_px,
                cy=camera.cy + reach_px,
            )
            margin_rad = _EDGE_MARGIN_PX * camera.pixel_rad
            reach_rad = min(camera.half_diagonal_rad + margin_rad, grown.half_diagonal_rad, camera.limit_rad)
            self._half_fields[exposure_s] = reach_rad
        return self._half_fields[exposure_s]

    def expose(self, scene: Scene, exposure: Exposure) -> Illumination:
        """Mean photo-electrons of a scene in every pixel."""
        # The order is that of the physics: light of sources and background, ghosts of the lens, which need the
        # electrons of the sources, then the smear of the transfer, which needs the complete image.
        light, seen = self._sources(scene, exposure)
        rate_e_s, excluded = self.background_rate_e_s(scene)
        mean_e = exposure.electrons(rate_e_s)
        margin_px = _EDGE_MARGIN_PX + float(light.radius_rad.max(initial=0.0)) / self.true_camera.pixel_rad
        motion = Motion(scene.pointing.rate_camera_rad_s, scene.jitter)
        paths = exposure.paths(
            self.true_camera, seen.in_camera, seen.electrons, motion, self.psfs.feature_px, margin_px
        )
        xy = self.displacement.moved(seen.xy, light.wavelength_nm)
        paths = paths._replace(xy=self.displacement.moved(paths.xy, light.wavelength_nm))
        self._draw(mean_e, light, xy, paths)
        sources = light.truth(xy, path_middles(paths.xy, paths.weights, xy), seen.electrons)
        if scene.satellites is not None and len(scene.satellites):
            sources = sources.joined(self._draw_satellites(mean_e, scene, exposure))
        self._draw_ghosts(mean_e, sources)
        if self.faint_sky is not None:
            self._draw_faint_stars(mean_e, self.faint_sky, scene, exposure)
        exposure.add_transfer_smear(mean_e)
        return Illumination(sources, mean_e, excluded)

    # ------------------------------------------------------------------ sources
    def _sources(self, scene: Scene, exposure: Exposure) -> tuple[Light, Reaching]:
        """Stars and bodies whose light reaches the detector, and their positions at mid-exposure."""
        camera, photometer, sky, bodies = self.true_camera, self.photometer, self.sky, scene.bodies
        rate_e_s = star_rates_e_s(scene, photometer, sky)
        seen = self._reaching(scene, scene.star_directions, rate_e_s, exposure, 0.0)
        coloured = self.psfs.coloured or self.displacement.coloured
        stars = star_light(scene, seen.rows, rate_e_s[seen.rows], photometer, coloured)
        # The few bodies in the field are selected first: their light needs phases and the Earth's limb.
        cosine = bodies.direction @ scene.pointing.camera.boresight
        off_axis = np.arccos(np.minimum(np.maximum(cosine, -1.0), 1.0))
        reach = self.half_field_rad(exposure.duration_s) + scene.streak_rad + bodies.angular_radius_rad
        near = (off_axis < np.minimum(reach, camera.limit_rad)).nonzero()[0]
        if not len(near):
            return stars, seen
        bodies = bodies.select(near)
        rate_e_s = body_rates_e_s(scene, bodies, photometer, sky)
        found = self._reaching(scene, bodies.direction, rate_e_s, exposure, bodies.angular_radius_rad)
        rows = found.rows
        disks = body_light(scene, bodies.select(rows), rate_e_s[rows], camera, photometer, sky)
        return stars.joined(disks), seen.joined(found)

    def _reaching(
        self,
        scene: Scene,
        direction: FloatArray,
        rate_e_s: FloatArray,
        exposure: Exposure,
        radius_rad: float | FloatArray,
    ) -> Reaching:
        """Sources of more than 0 electrons whose image, including disk and streak, overlaps the detector."""
        camera = self.true_camera
        in_camera = scene.pointing.camera.apply(direction)
        electrons = exposure.electrons(self._vignetted(rate_e_s, in_camera))
        xy = camera.project(in_camera)
        extent_px = self.psfs.radius_px(electrons) + (radius_rad + scene.streak_rad) / camera.pixel_rad
        extent_px += self.displacement.most_px
        rows = near_image(xy, extent_px, camera.width, camera.height)
        rows = rows[electrons[rows] > 0.0]
        return Reaching(rows, in_camera[rows], xy[rows], electrons[rows])

    def _vignetted(self, rate_e_s: FloatArray, in_camera: FloatArray) -> FloatArray:
        """Rates (N,) of sources along unit vectors (N, 3) in camera axes, reduced by vignetting."""
        if self.vignetting.is_off:
            return rate_e_s
        return rate_e_s * star_illumination(self.true_camera, self.vignetting, in_camera)

    def _draw(self, mean_e: FloatArray, light: Light, positions: FloatArray, paths: Paths) -> None:
        """Stars and small bodies through their PSFs, large bodies as disks."""
        # A point is rendered at all moments of its path in one call; a disk is rendered at each moment, which only the
        # few large bodies can afford.
        camera, (xy, weights, electrons) = self.true_camera, paths
        disk = light.radius_rad / camera.pixel_rad > _DISK_PX
        self._draw_points(mean_e, (~disk).nonzero()[0], light.wavelength_nm, positions, paths)
        for i in disk.nonzero()[0]:
            position = (float(positions[i, 0]), float(positions[i, 1]))
            body = LitDisk(
                radius_x=float(light.radius_rad[i] * camera.fx),
                radius_y=float(light.radius_rad[i] * camera.fy),
                illuminated_fraction=float(light.lit[i]),
                sun_angle_rad=float(light.sun_angle_rad[i]),
                law=LAWS[LAW_OF_BODY.get(str(light.name[i]), "lambert")],
                limb=(float(light.limb[i, 0]), float(light.limb[i, 1]), float(light.limb[i, 2])),
            )
            psf = self.psfs.psf(float(light.b_v[i]), position)
            draw_body(mean_e, xy[i], weights, float(electrons[i]), body, psf)

    def _draw_points(
        self, mean_e: FloatArray, points: IntArray, wavelength_nm: FloatArray, positions: FloatArray, paths: Paths
    ) -> None:
        """Render a selection of sources with their PSFs."""
        # The PSF depends on wavelength and position. Each source is a blend of neighbouring tabulated PSFs with shares
        # that add up to 1, so the stars of one PSF are rendered in one call of the kernel.
        for members, share, psf in self.psfs.blends(wavelength_nm[points], positions[points]):
            chosen = points[members]
            xy = np.ascontiguousarray(paths.xy[chosen])
            add_stars(mean_e, xy, paths.weights, paths.electrons[chosen] * share, psf)

    def _draw_satellites(self, mean_e: FloatArray, scene: Scene, exposure: Exposure) -> TrueSources:
        """Render satellites along their own paths, and return those whose light reaches the detector."""
        near, camera, photometer = scene.satellites, self.true_camera, self.photometer
        assert near is not None
        # Satellites have the spectrum of sunlight. Their own motion adds to the extent of their streaks.
        rate_e_s = photometer.body_electrons_per_s(np.full(len(near), "Sun"), near.v_mag)
        extent_rad = near.angular_radius_rad + near.rate_rad_s * exposure.duration_s
        seen = self._reaching(scene, near.direction, rate_e_s, exposure, extent_rad)
        near = near.select(seen.rows)
        light = satellite_light(scene, near, rate_e_s[seen.rows], camera, photometer, self.sky)
        drift = Drift(near.path_km @ scene.pointing.camera.as_matrix().T)
        margin_px = _EDGE_MARGIN_PX + float(light.radius_rad.max(initial=0.0)) / camera.pixel_rad
        motion = Motion(scene.pointing.rate_camera_rad_s, scene.jitter)
        sampling = (motion, self.psfs.feature_px, margin_px)
        paths = exposure.paths(camera, seen.in_camera, seen.electrons, *sampling, drift=drift)
        xy = self.displacement.moved(seen.xy, light.wavelength_nm)
        paths = paths._replace(xy=self.displacement.moved(paths.xy, light.wavelength_nm))
        self._draw(mean_e, light, xy, paths)
        return light.truth(xy, path_middles(paths.xy, paths.weights, xy), seen.electrons)

    def _draw_faint_stars(self, mean_e: FloatArray, sky: FaintSky, scene: Scene, exposure: Exposure) -> None:
        """Render the synthetic stars fainter than the catalogue's limit; all have the Sun's colour."""
        camera, velocity = self.true_camera, scene.observer.velocity_km_s
        reach_rad = self.half_field_rad(exposure.duration_s) + scene.streak_rad
        shift_rad = largest_shift_rad(scene.observer)
        direction, v_mag = sky.near(scene.pointing.camera.boresight, reach_rad, shift_rad)
        if self.sky.aberration and velocity is not None:
            direction = aberrated(direction, velocity)
        rate_e_s = self.photometer.electrons_per_s(v_mag, SOLAR_B_V, 0.0)
        rate_e_s[hidden_stars(scene, direction, self.sky)] = 0.0
        seen = self._reaching(scene, direction, rate_e_s, exposure, 0.0)
        motion = Motion(scene.pointing.rate_camera_rad_s, scene.jitter)
        paths = exposure.paths(camera, seen.in_camera, seen.electrons, motion, self.psfs.feature_px, _EDGE_MARGIN_PX)
        nm = np.full(len(seen.rows), float(self.photometer.effective_wavelength_nm(SOLAR_B_V, 0.0)))
        # The displacement changes by less than 0.001 px along a star's path, so that of mid-exposure serves for all of
        # it; for these many stars that saves an evaluation per moment.
        shift = self.displacement.moved(seen.xy, nm) - seen.xy
        self._draw_points(mean_e, np.arange(len(nm)), nm, seen.xy, paths._replace(xy=paths.xy + shift[:, None, :]))

    def _draw_ghosts(self, mean_e: FloatArray, sources: TrueSources) -> None:
        if self.ghosts:
            disks = ghost_sources(self.true_camera, sources.image_xy, sources.electrons, self.ghosts)
            for xy, electrons, radius_px in zip(*disks, strict=True):
                add_disk(mean_e, xy, float(radius_px), float(electrons))

    # ------------------------------------------------------------------ background
    @functools.cached_property
    def s10_e_s_pixel(self) -> float:
        """Electrons per second of diffuse light of 1 S10 in a pixel at the principal point."""
        return self.photometer.background_e_s_pixel(1.0, 1.0 / (self.true_camera.fx * self.true_camera.fy))

    @functools.cached_property
    def _s10_e_s(self) -> FloatArray:
        """Electrons per second of a uniform sky of 1 S10 in every pixel."""
        return self._uniform_rate_e_s()

    @functools.lru_cache(maxsize=1)  # noqa: B019 (one image, as long as the plane lives)
    def _even_rate_e_s(self, s10: float) -> FloatArray:
        # A map of its own is scaled in place: a uniform sky needs no second image in memory.
        rate_e_s = self._uniform_rate_e_s()
        rate_e_s *= s10
        rate_e_s.flags.writeable = False
        return rate_e_s

    def _uniform_rate_e_s(self) -> FloatArray:
        rate_e_s = illumination_map(self.true_camera, self.vignetting)
        rate_e_s *= self.s10_e_s_pixel
        return rate_e_s

    def background_rate_e_s(self, scene: Scene) -> tuple[FloatArray, tuple[str, ...]]:
        """Background rate of every pixel (height, width), electrons per second (diffuse sky, the Earth and its limb,
        stray light, a tether), and the bodies within their exclusion angle."""
        camera = self.true_camera
        s10 = diffuse_sky_s10(camera, scene.pointing.camera, scene.r_km, scene.sun_direction, self.sky)
        rate_e_s = self._s10_e_s * s10 if isinstance(s10, np.ndarray) else self._even_rate_e_s(s10)
        stray_e_s, excluded = self._stray_light(scene)
        if stray_e_s > 0.0:
            rate_e_s = rate_e_s + stray_e_s
        if self.tether.diameter_mm > 0.0:
            rate_e_s = rate_e_s + self._tether_rate_e_s(scene)
        return rate_e_s, excluded

    def _tether_rate_e_s(self, scene: Scene) -> FloatArray:
        """The tether in the light of Sun and Moon, electrons per second in every pixel."""
        camera, bodies = self.true_camera, scene.bodies
        image = np.zeros((camera.height, camera.width))
        lit_by = np.flatnonzero(np.isin(bodies.name, ("Sun", "Moon")))
        # The share of Sun and Moon that the Earth does not hide is the same for the spacecraft and its tether.
        share = unhidden(bodies.select(lit_by), scene.r_km, scene.sun_direction, self.sky)
        lit_by, share = lit_by[share > 0.0], share[share > 0.0]
        rates_e_s = self.photometer.body_electrons_per_s(bodies.name[lit_by], bodies.v_mag[lit_by]) * share
        for row, rate_e_s in zip(lit_by, rates_e_s, strict=True):
            towards = scene.pointing.camera.apply(bodies.direction[row])
            points = tether_points(self.tether, camera, self.aperture_mm, towards)
            nm = float(self.photometer.body_wavelength_nm(bodies.name[row : row + 1])[0])
            self._draw_tether(image, points, self._vignetted(points.share * float(rate_e_s), points.direction), nm)
        return image

    def _draw_tether(self, image: FloatArray, points: TetherPoints, rate_e_s: FloatArray, nm: float) -> None:
        """Render defocused parts of the tether as disks and the others as points with the PSF."""
        camera = self.true_camera
        # An out-of-focus part is a disk of the shape of the aperture; sharp parts are rendered as stars.
        xy = camera.project(points.direction)
        blurred = points.blur_rad / camera.pixel_rad > _DISK_PX
        for k in np.flatnonzero(blurred & np.isfinite(xy).all(axis=1)):
            radius = (float(points.blur_rad[k] * camera.fx), float(points.blur_rad[k] * camera.fy))
            add_disk(image, xy[k], radius, float(rate_e_s[k]))
        sharp = np.flatnonzero(~blurred & camera.contains(xy, _EDGE_MARGIN_PX))
        for members, share, psf in self.psfs.blends(np.full(len(sharp), nm), xy[sharp]):
            chosen = sharp[members]
            positions = np.ascontiguousarray(xy[chosen][:, None, :])
            add_stars(image, positions, np.ones(1), rate_e_s[chosen] * share, psf)

    def _stray_light(self, scene: Scene) -> tuple[float, tuple[str, ...]]:
        """Sun, Moon and Earth through the baffle, electrons per second and pixel, and whose exclusion is violated."""
        if self.baffle is None:
            return 0.0, ()
        # The light of each source is integrated over the aperture by the photometer, and the baffle's transmittance
        # distributes it uniformly over the detector.
        boresight = scene.pointing.camera.boresight
        names, directions, v_mag = stray_sources(scene.bodies, scene.r_km, self.sky)
        rate_e_s = stray_light_e_s_pixel(
            self.baffle,
            boresight,
            directions,
            self.photometer.body_electrons_per_s(names, v_mag),
            self.photometer.aperture_area_cm2,
            self.pixel_area_cm2,
        )
        return rate_e_s, tuple(self.baffle.within_exclusion(names, boresight, directions))
