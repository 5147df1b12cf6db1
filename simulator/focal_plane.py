"""Light onto the detector: a scene through lens, point spread function and smear, as mean photo-electrons a pixel."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulator.frame import TrueSources
from simulator.optics.curves import load_curve
from simulator.optics.psf import build_psf
from simulator.optics.smear import star_paths
from simulator.optics.splat import add_disk, add_stars
from simulator.scenario import Scenario
from simulator.scene import Scene
from simulator.sky.photometry import Photometer
from startracker.camera import Camera

FloatArray = NDArray[np.float64]

_EDGE_MARGIN_PX = 160.0
"""Stars up to this far outside the detector are drawn where their wings reach in; those of a million electrons do."""

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
    )


@dataclass(frozen=True, eq=False)
class Exposure:
    """Light of one exposure.

    Parameters
    ----------
    sources : TrueSources
        Every source whose light reaches the detector.
    mean_e : array, shape (height, width)
        Mean photo-electrons of the sources.
    background_e : float or array
        Mean photo-electrons a pixel of the diffuse background.
    """

    sources: TrueSources
    mean_e: FloatArray
    background_e: float | FloatArray


class FocalPlane:
    """Camera, response and point spread function of one scenario, built once.

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
        self.camera = camera_of(scenario)
        self.half_field_rad = min(self.camera.half_diagonal_rad + _EDGE_MARGIN_PX * self.camera.pixel_rad, math.pi / 2)
        response = load_curve(optics.transmission, "transmission", scenario.base_dir) * load_curve(
            detector.quantum_efficiency, "quantum_efficiency", scenario.base_dir
        )
        self.photometer = Photometer(response, math.pi / 4 * (optics.aperture_mm / 10.0) ** 2)
        self.psf = build_psf(optics.psf, optics.focal_length_mm / optics.aperture_mm, detector.pitch_um)

    def expose(self, scene: Scene) -> Exposure:
        """Mean photo-electrons of a scene in every pixel."""
        sources, radius_rad = self._sources(scene)
        camera, detector = self.camera, self.scenario.detector
        mean_e = np.zeros((detector.height, detector.width))
        xy, weights = star_paths(
            camera,
            scene.pointing.camera.apply(sources.direction),
            scene.pointing.rate_camera_rad_s,
            detector.exposure_s,
            self.psf.feature_px,
            margin_px=_EDGE_MARGIN_PX + float(radius_rad.max(initial=0.0)) / camera.pixel_rad,
        )
        disk = radius_rad / camera.pixel_rad > _DISK_PX
        points = np.flatnonzero(~disk)
        add_stars(mean_e, np.ascontiguousarray(xy[points]), weights, sources.electrons[points], self.psf)
        for i in np.flatnonzero(disk):
            size = (radius_rad[i] * camera.fx, radius_rad[i] * camera.fy)
            for place, weight in zip(xy[i], weights, strict=True):
                add_disk(mean_e, place, size, float(sources.electrons[i] * weight))
        return Exposure(sources, mean_e, self._background_e())

    def _background_e(self) -> float:
        sky = self.scenario.sky
        if not sky.background:
            return 0.0
        solid_angle_sr = 1.0 / (self.camera.fx * self.camera.fy)
        rate = self.photometer.background_e_s_pixel(sky.background_s10, solid_angle_sr)
        return rate * self.scenario.detector.exposure_s

    def _sources(self, scene: Scene) -> tuple[TrueSources, FloatArray]:
        """Every source whose light reaches the detector, at mid-exposure, and the angular radius of each."""
        camera, exposure_s = self.camera, self.scenario.detector.exposure_s
        stars, bodies, pointing = scene.stars, scene.bodies, scene.pointing
        streak_rad = float(np.linalg.norm(pointing.rate_camera_rad_s)) * exposure_s
        off_axis = np.arccos(np.clip(bodies.direction @ pointing.camera.boresight, -1.0, 1.0))
        reach = np.minimum(self.half_field_rad + streak_rad + bodies.angular_radius_rad, math.pi / 2 - 1e-3)
        near = np.flatnonzero(off_axis < reach)
        direction = np.concatenate([scene.star_directions, bodies.direction[near]])
        v_mag = np.concatenate([stars.v_mag, bodies.v_mag[near]])
        b_v = np.concatenate([stars.b_v, bodies.b_v[near]])
        kinds = [{"Sun": "sun", "Moon": "moon"}.get(str(name), "planet") for name in bodies.name[near]]
        sources = TrueSources(
            id=np.concatenate([stars.id, np.zeros(len(near), np.int64)]),
            name=np.concatenate([stars.star_name, bodies.name[near]]),
            kind=np.array(["star"] * len(stars) + kinds, dtype="U8"),
            xy=camera.project(pointing.camera.apply(direction)),
            direction=direction,
            v_mag=v_mag,
            b_v=b_v,
            electrons=self.photometer.electrons_per_s(v_mag, b_v) * exposure_s,
        )
        radius_rad = np.concatenate([np.zeros(len(stars)), bodies.angular_radius_rad[near]])
        extent_px = self.psf.radius_px(sources.electrons) + (radius_rad + streak_rad) / camera.pixel_rad
        outside = np.maximum(
            np.maximum(-sources.xy[:, 0], sources.xy[:, 0] - camera.width),
            np.maximum(-sources.xy[:, 1], sources.xy[:, 1] - camera.height),
        )
        reaching = np.flatnonzero(outside <= extent_px)
        return sources.select(reaching), radius_rad[reaching]
