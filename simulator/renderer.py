"""The stages in order: scenario → orbit → pointing → sky → optics → detector → frame and truth.

This is the one place where the order of the physics is written down; every stage is a pure function of what stands before
it, and of a random stream of its own.
"""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import NDArray
from simulator.mission.orbit import build_orbit
from simulator.mission.pointing import point, point_at_random
from simulator.optics.curves import load_curve
from simulator.optics.psf import build_psf
from simulator.sky.apparent import SkyIndex
from simulator.sky.observer import observe
from simulator.sky.photometry import Photometer

from simulator.detector.chain import detect
from simulator.detector.fixed_pattern import build_fixed_pattern
from simulator.frame import Frame, FrameTruth
from simulator.mission.clock import Clock
from simulator.mission.sampling import trial_time_s
from simulator.scenario import Scenario
from startracker.camera import Camera
from startracker.catalog import load_catalog

FloatArray = NDArray[np.float64]

_EDGE_MARGIN_PX = 40.0
"""Stars this far outside the detector are drawn too: their wings reach in."""


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


def render(scenario: Scenario, index: int = 0, *, at_s: float | None = None) -> tuple[Frame, FrameTruth]:
    """Render one frame of a scenario.

    Parameters
    ----------
    scenario : Scenario
        The scenario; what its frames share is kept for the next call.
    index : int
        Index of the trial: its time, its attitude, its noise.
    at_s : float, optional
        Seconds after the epoch, in place of the trial's own time.
    """
    return _renderer(scenario).frame(index, at_s=at_s)


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

    def frame(self, index: int = 0, *, at_s: float | None = None) -> tuple[Frame, FrameTruth]:
        """Frame and truth of trial `index`; `at_s` (seconds after the epoch) in place of the trial's own time."""
        scenario = self.scenario
        sampling = scenario.study.sampling
        streams = functools.partial(_stream_of_trial, scenario.seed, index)

        t_s = trial_time_s(sampling, scenario.seed, index, self.orbit.period_s) if at_s is None else at_s
        r_km, v_km_s = self.orbit.state(t_s)
        observer = observe(self.clock, t_s, r_km, v_km_s)
        if sampling == "sky" and at_s is None:
            pointing = point_at_random(scenario.pointing, streams("pointing"))
        else:
            pointing = point(scenario.pointing, r_km, v_km_s, streams("pointing"))

        sources, visible = self._sources(t_s, observer, pointing)
        mean_e = self._expose(sources, visible, pointing)
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
            read_noise_e=scenario.detector.read_noise_e,
            prior=pointing.prior if scenario.tracker.prior else None,
            prior_deg=scenario.pointing.error_deg,
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
