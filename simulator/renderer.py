"""The stages in order: scenario → scene (orbit, pointing, sky) → focal plane (optics) → detector → frame and truth.

This module alone defines the order of the stages. Every stage is a pure function of the results of the previous ones
and of its own random stream.
"""

from __future__ import annotations

import copy
import functools
import os
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from simulator.build import build_detector, build_focal_plane, build_scenes, build_transients, shutter_of
from simulator.checks import as_scenario
from simulator.detector.chain import Moment
from simulator.detector.excess_noise import bunch_e
from simulator.detector.parameters import TimeTag
from simulator.detector.readout import electronics_noise_e
from simulator.exposure import Exposure
from simulator.focal_plane import Illumination
from simulator.frame import Frame, FrameTruth
from simulator.mission.trajectory import Trajectory
from simulator.optics.jitter_series import JitterMotion
from simulator.randomness import Streams, stream
from simulator.scenario import Scenario
from simulator.scene import GivenState, Scene
from startracker.arguments import ABOVE_0, of_kind, real_array, real_number, whole_number
from startracker.errors import InputError
from startracker.geometry.attitude import Attitude, camera_attitude

_SCENE_KEYS = ("detector.height", "detector.shutter", "detector.line_time_us")
"""Keys of the detector on which the scenes depend."""
_READOUT_KEYS = (
    *("detector.exposure_s", "detector.gain_e_per_dn", "detector.temperature_c", "detector.hot_pixel_"),
    *("detector.dark_current_e_s", "detector.read_noise_e", "detector.offset_dn", "detector.dsnu", "detector.prnu"),
)
"""Keys on which the focal plane does not depend."""
MOST_SEED = 2**63 - 1
"""Largest seed, and largest index of a trial."""
_LONGEST_EXPOSURE_S = 1e5
"""Maximum exposure time, about a day; it bounds the memory of a star's path, which has a sample for every pixel."""
_LEAST_PRIOR_DEG = 0.1
"""Minimum error of the prior, also if the scenario states no pointing error."""


def render(
    scenario: Scenario | str | os.PathLike[str],
    index: int = 0,
    *,
    at_s: float | None = None,
    attitude: Attitude | None = None,
) -> tuple[Frame, FrameTruth]:
    """Render one frame of a scenario.

    Parameters
    ----------
    scenario : Scenario or path
        The scenario, or the name of an included one or of a file; data common to its frames are cached for the next
        call.
    index : int
        Index of the trial, which determines its time, attitude and noise.
    at_s : float, astropy Quantity or astropy Time, optional
        Seconds after the epoch, or a date, instead of the time of the trial.
    attitude : Attitude or scipy Rotation, optional
        True camera attitude instead of the trial's; the prior then has the random error of the trial.

    Raises
    ------
    InputError
        For invalid names or files in the scenario, or an argument of another type.
    """
    return _renderer(as_scenario(scenario)).frame(index, at_s=at_s, attitude=attitude)


class Renderer:
    """Renders frames of one scenario; common data (catalogue, PSF, response, device) are built once.

    Parameters
    ----------
    scenario : Scenario or path
        The scenario, or the name of an included one or of a file.
    camera_seed : int, optional
        Seed of the camera's own properties and of the noise of its frames, instead of the scenario's: one of several
        cameras under the same sky.
    trajectory : Trajectory, optional
        Trajectory of the spacecraft instead of the scenario's orbit.

    Raises
    ------
    InputError
        For invalid names or files in the scenario.
    """

    def __init__(
        self,
        scenario: Scenario | str | os.PathLike[str],
        camera_seed: int | None = None,
        trajectory: Trajectory | None = None,
    ) -> None:
        self.scenario = scenario = as_scenario(scenario)
        seed = scenario.seed if camera_seed is None else camera_seed
        self.seed = whole_number("camera_seed", seed, least=0, most=MOST_SEED)
        if not (trajectory is None or (hasattr(trajectory, "clock") and hasattr(trajectory, "state"))):
            raise InputError(f"trajectory must be a simulator.mission.trajectory.Trajectory; got {trajectory!r}")
        self.exposure_s = scenario.detector.exposure_s
        self.shutter = shutter_of(scenario.detector)
        self._trajectory = trajectory
        self.scenes = build_scenes(scenario, trajectory)
        self.focal_plane = build_focal_plane(scenario, self.seed)
        self.camera = self.focal_plane.camera
        self.detector = build_detector(scenario, self.seed)
        self.transients = build_transients(scenario)
        self.parameters = flat_parameters(scenario)
        device = self.detector.parameters
        # As a laboratory would state it: in the electrons of the photon-transfer curve, which with an intensifier are
        # not the detector's own.
        self._read_noise_e = electronics_noise_e(device) / bunch_e(device)

    def __repr__(self) -> str:
        return f"Renderer({self.scenario!r})"

    def changed(self, values: Mapping[str, Any]) -> Renderer:
        """Renderer of the scenario with other values, which shares all parts that do not depend on them.

        A new renderer of `Scenario.changed(values)` makes identical frames. Raises `ScenarioError` for values that are
        not valid.
        """
        # Catalogue, PSF tables and fixed patterns take seconds to build; a sweep changes one key for each of its
        # points. Each condition below lists the keys that do not affect a part.
        scenario, other = self.scenario.changed(values), copy.copy(self)
        device = self.detector.parameters
        other.scenario, other.parameters = scenario, flat_parameters(scenario)
        other.exposure_s, other.shutter = scenario.detector.exposure_s, shutter_of(scenario.detector)
        if not _only(values, ("optics.", "detector.", "environment."), _SCENE_KEYS):
            other.scenes = build_scenes(scenario, self._trajectory)
        if not _only(values, _READOUT_KEYS):
            other.focal_plane = build_focal_plane(scenario, self.seed)
            other.camera = other.focal_plane.camera
        if not _only(values, ("optics.", "detector.exposure_s")):
            other.detector = build_detector(scenario, self.seed)
            device = other.detector.parameters
        if not _only(values, ("optics.", "detector.")):
            other.transients = build_transients(scenario)
        other._read_noise_e = electronics_noise_e(device) / bunch_e(device)
        return other

    def scene(
        self,
        index: int = 0,
        *,
        at_s: float | None = None,
        attitude: Attitude | None = None,
        rate_camera_rad_s: ArrayLike | None = None,
        jitter: JitterMotion | None = None,
        exposure_s: float | None = None,
    ) -> Scene:
        """Scene of trial `index`; parameters as in `frame`."""
        index, duration_s = whole_number("index", index, least=0, most=MOST_SEED), self._duration_s(exposure_s)
        at_s = None if at_s is None else self.scenes.clock.elapsed_s(at_s)
        attitude = None if attitude is None else camera_attitude("attitude", attitude)
        if rate_camera_rad_s is not None:
            rate_camera_rad_s = real_array("rate_camera_rad_s", rate_camera_rad_s, (3,), unit="rad/s")
        of_kind("jitter", jitter, (JitterMotion, type(None)))
        half_field_rad = self.focal_plane.half_field_rad(duration_s)
        streams = self._streams(index)
        given = GivenState(at_s, attitude, rate_camera_rad_s, jitter)
        try:
            return self.scenes.scene(index, streams, half_field_rad, duration_s, given)
        except InputError as error:
            if at_s is not None:  # a time that the caller chose is not a matter of the scenario
                raise
            raise self.scenario.error_at("study.sampling", error) from error

    def expose(self, scene: Scene, exposure_s: float | None = None) -> Illumination:
        """Mean photo-electrons of a scene, before the detector."""
        of_kind("scene", scene, Scene, "Renderer.scene makes one")
        exposure = Exposure.about(scene.t_s, self._duration_s(exposure_s), self.shutter)
        return self.focal_plane.at(scene.t_s).expose(scene, exposure)

    def frame(
        self,
        index: int = 0,
        *,
        at_s: float | None = None,
        attitude: Attitude | None = None,
        rate_camera_rad_s: ArrayLike | None = None,
        jitter: JitterMotion | None = None,
        exposure_s: float | None = None,
    ) -> tuple[Frame, FrameTruth]:
        """Frame and truth of trial `index`; parameters as in `render`.

        `rate_camera_rad_s` (3,), the inertial angular velocity in camera axes, replaces the rate of the trial if an
        attitude is given; `jitter`, relative to mid-exposure, replaces the trial's, and `exposure_s` the
        scenario's.
        """
        scenario, duration_s = self.scenario, self._duration_s(exposure_s)
        scene = self.scene(
            index,
            at_s=at_s,
            attitude=attitude,
            rate_camera_rad_s=rate_camera_rad_s,
            jitter=jitter,
            exposure_s=duration_s,
        )
        light = self.expose(scene, duration_s)
        # The image is taken at the true time; an error of the camera's clock only changes the label of the frame.
        moment = self._moment(scene, duration_s)
        readout = self.detector.expose(light.mean_e, moment, self._streams(index), keep_charge=False)
        late_s = self._time_tag_error_s(index)
        frame = Frame(
            image=readout.image,
            camera=self.camera,
            observer=scene.observer,
            utc=self.scenes.clock.isot(scene.t_s + late_s),
            exposure_s=duration_s,
            saturation_dn=readout.saturation_dn,
            gain_e_per_dn=readout.gain_e_per_dn,
            offset_dn=scenario.detector.offset_dn,
            read_noise_e=self._read_noise_e,
            prior=scene.pointing.prior if scenario.tracker.prior else None,
            prior_deg=max(scenario.pointing.error_deg, _LEAST_PRIOR_DEG),
            scenario=scenario.name,
            seed=self.seed,
            index=index,
            parameters=self.parameters | {"detector.exposure_s": duration_s},
        )
        truth = FrameTruth(
            attitude=scene.pointing.camera,
            mounting=scene.pointing.mounting,
            rate_camera_rad_s=scene.pointing.rate_camera_rad_s,
            t_s=scene.t_s,
            sources=light.sources,
            mean_electrons=light.mean_e,
            excluded=light.excluded,
            time_tag_error_s=late_s,
            particles_cm2_s=self._particles_cm2_s(moment),
            mounting_rotation_rad=scene.pointing.mounting_rotation_rad,
        )
        return frame, truth

    def _duration_s(self, exposure_s: float | None) -> float:
        """Exposure time: as given, or the scenario's."""
        if exposure_s is None:
            return self.exposure_s
        return real_number("exposure_s", exposure_s, unit="s", least=ABOVE_0, most=_LONGEST_EXPOSURE_S)

    def _time_tag_error_s(self, index: int) -> float:
        """Error of the stated time of a frame."""
        tag = self.scenario.detector.time_tag
        if tag == TimeTag():
            return 0.0
        return tag.offset_s + tag.jitter_s * float(self._streams(index)("time tag").standard_normal())

    def _moment(self, scene: Scene, exposure_s: float) -> Moment:
        """Time of a frame and particles at its position."""
        if self.transients is None:
            return Moment(exposure_s, scene.t_s)
        depth_um = self.detector.parameters.cosmic_rays.depth_um
        return Moment(exposure_s, scene.t_s, self.transients.particles(scene.t_s, scene.r_km, depth_um))

    def _particles_cm2_s(self, moment: Moment) -> float:
        device = (self.detector.parameters.cosmic_rays,)
        return sum(rays.rate_cm2_s for rays in (device if moment.particles is None else moment.particles))

    def _streams(self, index: int) -> Streams:
        return functools.partial(_stream_of_trial, self.seed, index)


def _only(paths: Iterable[str], shared: tuple[str, ...], except_for: tuple[str, ...] = ()) -> bool:
    """Whether all paths begin with one of `shared`, and none with one of `except_for`."""
    return all(path.startswith(shared) and not path.startswith(except_for) for path in paths)


def flat_parameters(scenario: Scenario) -> dict[str, float | int | str | bool]:
    """Scalar keys of the sections from orbit to detector by dotted path, for a file header."""
    flat: dict[str, float | int | str | bool] = {}

    def walk(prefix: str, value: Any) -> None:
        if isinstance(value, dict):
            for key, inner in value.items():
                walk(f"{prefix}.{key}" if prefix else key, inner)
        elif isinstance(value, list):
            flat[prefix] = " ".join(str(item) for item in value)
        elif value is not None:
            flat[prefix] = value

    # Null values are omitted, because header cards need a value, and lists become text.
    resolved = scenario.resolved()
    if scenario.pointing.track.target is None:
        del resolved["pointing"]["track"]  # some forty keys of an orbit that is not used
    sections = ("orbit", "pointing", "sky", "tether", "optics", "detector", "environment")
    walk("", {name: resolved[name] for name in sections})
    return flat


def _stream_of_trial(seed: int, trial: int, stage: str) -> np.random.Generator:
    return stream(seed, stage, trial)


@functools.lru_cache(maxsize=4)
def _renderer(scenario: Scenario) -> Renderer:
    return Renderer(scenario)
