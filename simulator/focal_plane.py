"""Light onto the detector: a scene through lens, point spread function and smear, as mean photo-electrons a pixel."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simulator.frame import TrueSources
from simulator.light import Light, Seen, near_image, path_middles
from simulator.optics.bodies import LAW_OF_BODY, NO_LIMB, draw_body, sun_angle_rad
from simulator.optics.curves import load_curve
from simulator.optics.disk import add_disk
from simulator.optics.ghosts import ghost_sources
from simulator.optics.illumination import illumination_map, is_off, star_illumination
from simulator.optics.psf_set import build_psf_set
from simulator.optics.shutter import frame_transfer_smear, rolling_paths
from simulator.optics.smear import star_paths
from simulator.optics.splat import add_stars
from simulator.optics.stray_light import build_baffle, stray_light_e_s_pixel
from simulator.optics.tether import tether_points
from simulator.optics.thermal import true_camera
from simulator.scenario import Scenario
from simulator.scene import Scene
from simulator.sky.background import diffuse_sky_s10
from simulator.sky.earth import limbs, occulted, stray_sources, unhidden
from simulator.sky.magnitudes import sun_v
from simulator.sky.photometry import Photometer
from simulator.sky.solar_system import Bodies
from simulator.sky.spectra import SOLAR_B_V
from startracker.camera import Camera

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_EDGE_MARGIN_PX = 160.0
"""Stars up to this far outside the detector are drawn where their wings reach in; those of a million electrons do."""

_KIND = "U8"
_DISK_PX = 1.5
"""Bodies of a larger radius are drawn as disks, smaller ones as points through the PSF."""


def camera_of(scenario: Scenario) -> Camera:
    """The calibrated camera of a scenario's optics and detector."""
    optics, detector = scenario.optics, scenario.detector
    pitch_x, pitch_y = detector.pitch_um
    return Camera(
        fx=optics.focal_length_mm * 1e3 / pitch_x,
        fy=optics.focal_length_mm * 1e3 / pitch_y,
        cx=(detector.width - 1) / 2 + optics.principal_point_offset_px[0],
        cy=(detector.height - 1) / 2 + optics.principal_point_offset_px[1],
        width=detector.width,
        height=detector.height,
        distortion=optics.distortion,
        projection=optics.projection,
        row_time_s=detector.line_time_us * 1e-6 if detector.shutter == "rolling" else 0.0,
    )


@dataclass(frozen=True, eq=False)
class Exposure:
    """Light of one exposure.

    Parameters
    ----------
    sources : TrueSources
        Every source whose light reaches the detector.
    mean_e : array, shape (height, width)
        Mean photo-electrons, of the sources and of the background.
    level_e : float, optional
        Mean photo-electrons of all pixels that no source lights; None where they have not all the same. Only stray
        light is even: of the sky a pixel sees the less the further out it lies.
    excluded : tuple of str
        Bodies within the baffle's exclusion angle.
    """

    sources: TrueSources
    mean_e: FloatArray
    level_e: float | None
    excluded: tuple[str, ...] = ()


class FocalPlane:
    """Camera, response and point spread functions of one scenario, built once.

    Parameters
    ----------
    scenario : Scenario
        The scenario.

    Raises
    ------
    InputError
        For names or files in the scenario that cannot be used.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        optics, detector = scenario.optics, scenario.detector
        self.sky = scenario.sky
        if scenario.study.sampling == "sky" and scenario.pointing.target is None:
            # attitudes drawn at random are for trying the whole sky, a third of which the Earth would hide
            self.sky = scenario.sky.model_copy(update={"earth": False})
        self.camera = camera_of(scenario)
        """As calibrated: what the frame carries."""
        self.true_camera = true_camera(self.camera, optics.thermal)
        """As it is: what the sky is drawn through."""
        response = load_curve(optics.transmission, "transmission", scenario.base_dir) * load_curve(
            detector.quantum_efficiency, "quantum_efficiency", scenario.base_dir
        )
        area_cm2 = math.pi / 4 * (optics.aperture_mm / 10.0) ** 2 * (1.0 - optics.obscuration**2)
        self.photometer = Photometer(response, area_cm2, scenario.sky.spectrum)
        self.s10_e_s_pixel = self.photometer.background_e_s_pixel(
            1.0, 1.0 / (self.true_camera.fx * self.true_camera.fy)
        )
        """Electrons a second of diffuse light of 1 S10 in a pixel at the principal point."""
        self.psfs = build_psf_set(
            optics.psf,
            optics.focal_length_mm / optics.aperture_mm,
            detector.pitch_um,
            (detector.width, detector.height),
            obscuration=optics.obscuration,
            diffusion_um=detector.charge_diffusion_um,
            weights_of=self.photometer.bin_weights,
        )
        self.half_field_rad = self._half_field_rad()
        """Sources this far from the boresight, at any moment of the exposure, may leave light on the detector."""
        self.baffle = build_baffle(optics.baffle, scenario.base_dir)
        self.vignettes = not is_off(optics.vignetting)
        """Whether stars lose light towards the edge of the field."""

    def _half_field_rad(self) -> float:
        camera = self.true_camera
        brightest_e = self.photometer.electrons_per_s(sun_v(1.0), SOLAR_B_V) * self.scenario.detector.exposure_s
        reach_px = math.ceil(min(float(self.psfs.radius_px(brightest_e)), _EDGE_MARGIN_PX)) + 1
        grown = replace(
            camera,
            width=camera.width + 2 * reach_px,
            height=camera.height + 2 * reach_px,
            cx=camera.cx + reach_px,
            cy=camera.cy + reach_px,
        )
        margin_rad = _EDGE_MARGIN_PX * camera.pixel_rad
        return min(camera.half_diagonal_rad + margin_rad, grown.half_diagonal_rad, camera.limit_rad)

    def expose(self, scene: Scene) -> Exposure:
        """Mean photo-electrons of a scene in every pixel."""
        detector = self.scenario.detector
        light = self._sources(scene)
        stray_e, excluded = self._stray_light(scene)
        diffuse_e, tether_e = self._diffuse_e(scene), self._tether_e(scene)
        level_e = stray_e if diffuse_e is None and tether_e is None else None
        mean_e = np.full((detector.height, detector.width), stray_e) if diffuse_e is None else diffuse_e
        if diffuse_e is not None and stray_e > 0.0:
            mean_e += stray_e
        if tether_e is not None:
            mean_e += tether_e
        sources = replace(light.sources, image_xy=self._draw(mean_e, light, scene))
        self._draw_ghosts(mean_e, sources)
        if detector.shutter == "frame_transfer":
            smear_e = frame_transfer_smear(
                mean_e,
                detector.exposure_s,
                detector.line_time_us * 1e-6,
                "up" if detector.readout_corner.startswith("top") else "down",
                detector.transfer_smear,
            )
            mean_e += smear_e
            level_e = None
        return Exposure(sources, mean_e, level_e, excluded)

    # ------------------------------------------------------------------ sources
    def _sources(self, scene: Scene) -> Light:
        """Every source whose light reaches the detector, at mid-exposure."""
        camera, pointing, bodies = self.true_camera, scene.pointing, scene.bodies
        streak_rad = math.hypot(*pointing.rate_camera_rad_s.tolist()) * self.scenario.detector.exposure_s
        v_mag = scene.catalog.v_mag[scene.rows]
        rate = self.photometer.electrons_per_s(v_mag, scene.star_b_v, scene.star_giant)
        stars = self._reaching(scene, scene.star_directions, rate, streak_rad)
        if self.sky.earth:
            stars = stars.select(np.flatnonzero(~occulted(scene.star_directions[stars.rows], scene.r_km)))
        off_axis = np.arccos(np.clip(bodies.direction @ pointing.camera.boresight, -1.0, 1.0))
        reach = np.minimum(self.half_field_rad + streak_rad + bodies.angular_radius_rad, camera.limit_rad)
        near = np.flatnonzero(off_axis < reach)
        if not len(near):
            return self._of_stars(scene, stars)
        bodies = bodies.select(near)
        rate = self.photometer.body_electrons_per_s(bodies.name, bodies.v_mag)
        rate *= unhidden(bodies, scene.r_km, scene.sun_direction, self.sky)
        found = self._reaching(scene, bodies.direction, rate, bodies.angular_radius_rad + streak_rad)
        return Light.joined(self._of_stars(scene, stars), self._of_bodies(scene, bodies, found))

    def _of_stars(self, scene: Scene, seen: Seen) -> Light:
        catalog, rows, none = scene.catalog, scene.rows[seen.rows], np.zeros(len(seen.rows))
        sources = TrueSources(
            id=catalog.id[rows],
            name=catalog.star_name[rows],
            kind=np.full(len(rows), "star", dtype=_KIND),
            xy=seen.xy,
            image_xy=seen.xy,
            direction=scene.star_directions[seen.rows],
            v_mag=catalog.v_mag[rows],
            b_v=scene.star_b_v[seen.rows],
            electrons=seen.electrons,
            variable=catalog.variable[rows],
        )
        nm = none
        if self.psfs.coloured:
            nm = self.photometer.effective_wavelength_nm(scene.star_b_v[seen.rows], scene.star_giant[seen.rows])
        return Light(sources, seen.in_camera, none, none + 1.0, none, np.tile(NO_LIMB, (len(rows), 1)), nm)

    def _of_bodies(self, scene: Scene, bodies: Bodies, seen: Seen) -> Light:
        bodies = bodies.select(seen.rows)
        angles = [
            sun_angle_rad(self.true_camera, scene.pointing.camera, u, scene.sun_direction) for u in bodies.direction
        ]
        sources = TrueSources(
            id=np.zeros(len(bodies), np.int64),
            name=bodies.name,
            kind=np.array(
                [{"Sun": "sun", "Moon": "moon"}.get(str(name), "planet") for name in bodies.name], dtype=_KIND
            ),
            xy=seen.xy,
            image_xy=seen.xy,
            direction=bodies.direction,
            v_mag=bodies.v_mag,
            b_v=bodies.b_v,
            electrons=seen.electrons,
            variable=np.zeros(len(bodies), dtype=bool),
        )
        lit = bodies.illuminated_fraction if self.sky.phases else np.ones(len(bodies))
        limb = np.tile(NO_LIMB, (len(bodies), 1))
        if self.sky.earth:
            limb[:, 0], limb[:, 1] = limbs(bodies.direction, bodies.angular_radius_rad, scene.r_km)
            limb[:, 2] = [
                sun_angle_rad(self.true_camera, scene.pointing.camera, u, -scene.r_km) for u in bodies.direction
            ]
        nm = self.photometer.body_wavelength_nm(bodies.name)
        return Light(sources, seen.in_camera, bodies.angular_radius_rad, lit, np.array(angles), limb, nm)

    def _reaching(
        self, scene: Scene, direction: FloatArray, electrons_s: FloatArray, extent_rad: float | FloatArray
    ) -> Seen:
        """Those sources that shine and whose image, extended by disk and streak, reaches the detector."""
        camera, scenario = self.true_camera, self.scenario
        in_camera = scene.pointing.camera.apply(direction)
        electrons = electrons_s * scenario.detector.exposure_s
        if self.vignettes:
            electrons = electrons * star_illumination(camera, scenario.optics.vignetting, in_camera)
        xy = camera.project(in_camera)
        extent_px = self.psfs.radius_px(electrons) + extent_rad / camera.pixel_rad
        rows = near_image(xy, extent_px, camera.width, camera.height)
        rows = rows[electrons[rows] > 0.0]
        return Seen(rows, in_camera[rows], xy[rows], electrons[rows])

    def _paths(self, light: Light, scene: Scene) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Positions (N, K, 2) over the exposure, weights (K,), and electrons (N,) gathered in it."""
        camera, detector, sources = self.true_camera, self.scenario.detector, light.sources
        directions = light.in_camera
        rate = scene.pointing.rate_camera_rad_s
        margin_px = _EDGE_MARGIN_PX + float(np.max(light.radius_rad, initial=0.0)) / camera.pixel_rad
        feature_px = self.psfs.feature_px
        if detector.shutter == "rolling":
            xy, weights, exposed = rolling_paths(
                camera,
                directions,
                rate,
                detector.exposure_s,
                detector.line_time_us * 1e-6,
                feature_px,
                margin_px,
                scene.jitter,
            )
            return xy, weights, sources.electrons * exposed
        xy, weights = star_paths(camera, directions, rate, detector.exposure_s, feature_px, margin_px, scene.jitter)
        return xy, weights, sources.electrons

    def _draw(self, mean_e: FloatArray, light: Light, scene: Scene) -> FloatArray:
        """Stars and small bodies through their PSFs, large bodies as disks; returns the middles of their paths."""
        camera, sources = self.true_camera, light.sources
        xy, weights, electrons = self._paths(light, scene)
        disk = light.radius_rad / camera.pixel_rad > _DISK_PX
        points = np.flatnonzero(~disk)
        for members, share, psf in self.psfs.blends(light.wavelength_nm[points], sources.xy[points]):
            chosen = points[members]
            add_stars(mean_e, np.ascontiguousarray(xy[chosen]), weights, electrons[chosen] * share, psf)
        for i in np.flatnonzero(disk):
            place = (float(sources.xy[i, 0]), float(sources.xy[i, 1]))
            size = (float(light.radius_rad[i] * camera.fx), float(light.radius_rad[i] * camera.fy))
            draw_body(
                mean_e,
                xy[i],
                weights,
                size,
                float(electrons[i]),
                float(light.lit[i]),
                float(light.sun_angle_rad[i]),
                self.psfs.psf(float(sources.b_v[i]), place),
                LAW_OF_BODY.get(str(sources.name[i]), "lambert"),
                (float(light.limb[i, 0]), float(light.limb[i, 1]), float(light.limb[i, 2])),
            )
        return np.asarray(path_middles(xy, weights, sources.xy))

    def _draw_ghosts(self, mean_e: FloatArray, sources: TrueSources) -> None:
        ghosts = self.scenario.optics.ghosts
        if ghosts:
            for xy, electrons, radius_px in zip(
                *ghost_sources(self.true_camera, sources.image_xy, sources.electrons, ghosts), strict=True
            ):
                add_disk(mean_e, xy, float(radius_px), float(electrons))

    # ------------------------------------------------------------------ background
    @functools.cached_property
    def _sky_e_s(self) -> FloatArray:
        """Electrons a second of an even sky of 1 S10 in every pixel."""
        return illumination_map(self.true_camera, self.scenario.optics.vignetting) * self.s10_e_s_pixel

    def _diffuse_e(self, scene: Scene) -> FloatArray | None:
        """Diffuse sky, Earth and its limb, an image of its own; None where there is no such light."""
        s10 = diffuse_sky_s10(self.true_camera, scene.pointing.camera, scene.r_km, scene.sun_direction, self.sky)
        if not isinstance(s10, np.ndarray):
            return self._sky_e_s * (s10 * self.scenario.detector.exposure_s) if s10 > 0.0 else None
        s10 *= self._sky_e_s
        s10 *= self.scenario.detector.exposure_s
        return s10

    def _tether_e(self, scene: Scene) -> FloatArray | None:
        """The tether in the light of Sun and Moon: disks where it is out of focus, points through the PSF beyond."""
        section, camera, bodies = self.scenario.tether, self.true_camera, scene.bodies
        if section.diameter_mm == 0.0:
            return None
        lamps = np.flatnonzero(np.isin(bodies.name, ("Sun", "Moon")))
        share = unhidden(bodies.select(lamps), scene.r_km, scene.sun_direction, self.sky)
        lamps, share = lamps[share > 0.0], share[share > 0.0]
        image = np.zeros((camera.height, camera.width))
        rate = self.photometer.body_electrons_per_s(bodies.name[lamps], bodies.v_mag[lamps]) * share
        for lamp, electrons_s in zip(lamps, rate, strict=True):
            towards = scene.pointing.camera.apply(bodies.direction[lamp])
            points = tether_points(section, camera, self.scenario.optics.aperture_mm, towards)
            electrons = points.share * float(electrons_s) * self.scenario.detector.exposure_s
            if self.vignettes:
                electrons *= star_illumination(camera, self.scenario.optics.vignetting, points.direction)
            xy = camera.project(points.direction)
            blurred = points.blur_rad / camera.pixel_rad > _DISK_PX
            for k in np.flatnonzero(blurred & np.isfinite(xy).all(axis=1)):
                radius = (float(points.blur_rad[k] * camera.fx), float(points.blur_rad[k] * camera.fy))
                add_disk(image, xy[k], radius, float(electrons[k]))
            sharp = np.flatnonzero(~blurred & camera.contains(xy, _EDGE_MARGIN_PX))
            nm = np.full(len(sharp), self.photometer.body_wavelength_nm(bodies.name[lamp : lamp + 1])[0])
            for members, part, psf in self.psfs.blends(nm, xy[sharp]):
                chosen = sharp[members]
                paths = np.ascontiguousarray(xy[chosen][:, None, :])
                add_stars(image, paths, np.ones(1), electrons[chosen] * part, psf)
        return image

    def _stray_light(self, scene: Scene) -> tuple[float, tuple[str, ...]]:
        """Sun, Moon and Earth through the baffle, electrons a pixel, and whose exclusion angle is broken."""
        if self.baffle is None:
            return 0.0, ()
        detector, boresight = self.scenario.detector, scene.pointing.camera.boresight
        names, directions, v_mag = stray_sources(scene.bodies, scene.r_km, self.sky)
        pitch_x, pitch_y = detector.pitch_um
        rate = stray_light_e_s_pixel(
            self.baffle,
            boresight,
            directions,
            self.photometer.body_electrons_per_s(names, v_mag),
            self.photometer.aperture_area_cm2,
            pitch_x * pitch_y * 1e-8,
        )
        excluded = self.baffle.within_exclusion(names, boresight, directions)
        return rate * detector.exposure_s, tuple(excluded)
