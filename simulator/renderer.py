"""The stages in order: scenario → orbit → pointing → sky → optics → detector → frame and truth.

This is the one place where the order of the physics is written down; every stage is a pure function of what stands
before it, and of a random stream of its own.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.detector.chain import detect
from simulator.detector.fixed_pattern import build_fixed_pattern
from simulator.detector.readout import section_reset_noise_e
from simulator.frame import Frame, FrameTruth, TrueSources
from simulator.mission.clock import Clock
from simulator.mission.orbit import build_orbit
from simulator.mission.pointing import Pointing, point, point_at_random, turned_to
from simulator.mission.sampling import trial_time_s
from simulator.optics.curves import load_curve
from simulator.optics.psf import build_psf
from simulator.optics.smear import star_paths
from simulator.optics.splat import add_disk, add_stars
from simulator.randomness import stream
from simulator.scenario import Scenario
from simulator.sky.apparent import SkyIndex
from simulator.sky.observer import observe
from simulator.sky.photometry import Photometer
from simulator.sky.solar_system import solar_system, sun_position_au
from startracker.attitude import Attitude
from startracker.camera import Camera
from startracker.catalog import load_catalog
from startracker.observer import Observer

FloatArray = NDArray[np.float64]

_EDGE_MARGIN_PX = 160.0
"""Stars up to this far outside the detector are drawn where their wings reach in; those of a million electrons do."""

_LEAST_PRIOR_DEG = 0.1
"""No other sensor is trusted beyond this, even where a scenario gives it no error."""

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


def render(
    scenario: Scenario, index: int = 0, *, at_s: float | None = None, attitude: Attitude | None = None
) -> tuple[Frame, FrameTruth]:
    """Render one frame of a scenario.

    Parameters
    ----------
    scenario : Scenario
        The scenario; what its frames share is kept for the next call.
    index : int
        Index of the trial: its time, its attitude, its noise.
    at_s : float, optional
        Seconds after the epoch, in place of the trial's own time.
    attitude : Attitude, optional
        True camera attitude, in place of the trial's own; the prior is then off by the trial's random error.
    """
    return _renderer(scenario).frame(index, at_s=at_s, attitude=attitude)


class Renderer:
    """Renders frames of one scenario; what they share (catalogue, PSF, response, device) is built once.

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
        self.half_diagonal_rad = self.camera.half_diagonal_rad
        self.clock = Clock(scenario.epoch)
        self.orbit = build_orbit(scenario.orbit, scenario.epoch)
        self.sky = SkyIndex(load_catalog(scenario.sky.catalog).brighter_than(scenario.sky.magnitude_limit))
        response = load_curve(optics.transmission, "transmission", scenario.base_dir) * load_curve(
            detector.quantum_efficiency, "quantum_efficiency", scenario.base_dir
        )
        self.photometer = Photometer(response, math.pi / 4 * (optics.aperture_mm / 10.0) ** 2)
        self.psf = build_psf(optics.psf, optics.focal_length_mm / optics.aperture_mm, detector.pitch_um)
        self.pattern = build_fixed_pattern(detector, scenario.seed)
        solid_angle_sr = 1.0 / (self.camera.fx * self.camera.fy)
        self.background_e = (
            self.photometer.background_e_s_pixel(scenario.sky.background_s10, solid_angle_sr) * detector.exposure_s
            if scenario.sky.background
            else 0.0
        )

    def frame(
        self, index: int = 0, *, at_s: float | None = None, attitude: Attitude | None = None
    ) -> tuple[Frame, FrameTruth]:
        """Frame and truth of trial `index`; parameters as in `render`."""
        scenario = self.scenario
        sampling = scenario.study.sampling
        streams = functools.partial(_stream_of_trial, scenario.seed, index)

        t_s = trial_time_s(sampling, scenario.seed, index, self.orbit.period_s) if at_s is None else at_s
        r_km, v_km_s = self.orbit.state(t_s)
        observer = observe(self.clock, t_s, r_km, v_km_s)
        if sampling == "sky" and at_s is None:
            pointing = point_at_random(scenario.pointing, streams("pointing"), math.tau / self.orbit.period_s)
        else:
            pointing = point(scenario.pointing, r_km, v_km_s, streams("pointing"))
        if attitude is not None:
            pointing = turned_to(pointing, attitude)

        sources, radius_rad = self._sources(t_s, observer, pointing)
        mean_e = self._expose(sources, radius_rad, pointing)
        readout = detect(mean_e + self.background_e, scenario.detector, self.pattern, streams)

        frame = Frame(
            image=readout.image,
            camera=self.camera,
            observer=observer,
            utc=self.clock.isot(t_s),
            exposure_s=scenario.detector.exposure_s,
            saturation_dn=readout.saturation_dn,
            gain_e_per_dn=readout.gain_e_per_dn,
            offset_dn=scenario.detector.offset_dn,
            read_noise_e=math.hypot(scenario.detector.read_noise_e, section_reset_noise_e(scenario.detector)),
            prior=pointing.prior if scenario.tracker.prior else None,
            prior_deg=max(scenario.pointing.error_deg, _LEAST_PRIOR_DEG),
            scenario=scenario.name,
            seed=scenario.seed,
            index=index,
            parameters=flat_parameters(scenario),
        )
        truth = FrameTruth(
            attitude=pointing.camera,
            mounting=pointing.mounting,
            rate_camera_rad_s=pointing.rate_camera_rad_s,
            t_s=t_s,
            sources=sources,
            mean_electrons=mean_e,
        )
        return frame, truth

    # ------------------------------------------------------------------ the stages
    def _sources(self, t_s: float, observer: Observer, pointing: Pointing) -> tuple[TrueSources, FloatArray]:
        """Everything whose light may reach the detector, at mid-exposure, and the angular radius of each."""
        scenario, camera = self.scenario, self.camera
        streak_rad = float(np.linalg.norm(pointing.rate_camera_rad_s)) * scenario.detector.exposure_s
        reach = min(self.half_diagonal_rad + _EDGE_MARGIN_PX * camera.pixel_rad + streak_rad, math.pi / 2)
        sun_au = sun_position_au(self.clock, t_s)
        stars, directions = self.sky.view(pointing.camera.boresight, reach, observer, sun_au, scenario.sky)
        bodies = solar_system(self.clock, t_s, observer, scenario.sky)
        off_axis = np.arccos(np.clip(bodies.direction @ pointing.camera.boresight, -1.0, 1.0))
        near = np.flatnonzero(off_axis < np.minimum(reach + bodies.angular_radius_rad, math.pi / 2 - 1e-3))
        direction = np.concatenate([directions, bodies.direction[near]])
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
            electrons=self.photometer.electrons_per_s(v_mag, b_v) * scenario.detector.exposure_s,
        )
        radius_rad = np.concatenate([np.zeros(len(stars)), bodies.angular_radius_rad[near]])
        extent_px = self.psf.radius_px(sources.electrons) + (radius_rad + streak_rad) / camera.pixel_rad
        outside = np.maximum(
            np.maximum(-sources.xy[:, 0], sources.xy[:, 0] - camera.width),
            np.maximum(-sources.xy[:, 1], sources.xy[:, 1] - camera.height),
        )
        reaching = np.flatnonzero(outside <= extent_px)
        return sources.select(reaching), radius_rad[reaching]

    def _expose(self, sources: TrueSources, radius_rad: FloatArray, pointing: Pointing) -> FloatArray:
        """Mean photo-electrons of stars and bodies in every pixel: lens, PSF, smear."""
        camera, detector = self.camera, self.scenario.detector
        mean_e = np.zeros((detector.height, detector.width))
        xy, weights = star_paths(
            camera,
            pointing.camera.apply(sources.direction),
            pointing.rate_camera_rad_s,
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
        return mean_e


def flat_parameters(scenario: Scenario) -> dict[str, float | int | str | bool]:
    """Scalar keys of the orbit, pointing, sky, optics and detector sections by dotted path, for a file header."""
    flat: dict[str, float | int | str | bool] = {}

    def walk(prefix: str, value: Any) -> None:
        if isinstance(value, dict):
            for key, inner in value.items():
                walk(f"{prefix}.{key}" if prefix else key, inner)
        elif isinstance(value, list):
            flat[prefix] = " ".join(str(item) for item in value)
        elif value is not None:
            flat[prefix] = value

    resolved = scenario.resolved()
    walk("", {name: resolved[name] for name in ("orbit", "pointing", "sky", "optics", "detector")})
    return flat


def _stream_of_trial(seed: int, trial: int, stage: str) -> np.random.Generator:
    return stream(seed, stage, trial)


@functools.lru_cache(maxsize=4)
def _renderer(scenario: Scenario) -> Renderer:
    return Renderer(scenario)
