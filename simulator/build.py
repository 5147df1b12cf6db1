"""From a scenario to physics: the one module that knows both the scenario's keys and the objects of the physics.

Physics takes plain frozen parameters, of which a scenario's sections are made; here names become objects and files are
read.
"""

from __future__ import annotations

import math
from dataclasses import fields, replace

from simulator.detector import Detector, build_fixed_pattern
from simulator.detector.parameters import DetectorParameters
from simulator.exposure import Shutter
from simulator.focal_plane import FocalPlane
from simulator.mission.parameters import SequenceMotion
from simulator.mission.pointing import mounting_of
from simulator.mission.trajectories import build_trajectory
from simulator.mission.trajectory import Trajectory
from simulator.optics.curves import load_curve
from simulator.optics.jitter import load_spectrum
from simulator.optics.psf import Lens
from simulator.optics.psf_set import PsfSet
from simulator.optics.stray_light import build_baffle
from simulator.optics.thermal import true_camera
from simulator.scenario import Scenario
from simulator.scenario.schema import DetectorSection, SequenceSection
from simulator.scene import SceneBuilder, SceneParameters
from simulator.sky.photometry import Photometer
from startracker.attitude import Attitude
from startracker.camera import Camera

__all__ = [
    "build_camera",
    "build_detector",
    "build_focal_plane",
    "build_mounting",
    "build_orbit",
    "build_scenes",
    "detector_parameters",
    "sequence_motion",
    "shutter_of",
]


def build_camera(scenario: Scenario) -> Camera:
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


def build_focal_plane(scenario: Scenario) -> FocalPlane:
    """Lens, response and point spread functions of a scenario.

    Raises
    ------
    InputError
        For names or files in the scenario that cannot be used.
    """
    optics, detector = scenario.optics, scenario.detector
    camera, baffle, thermal = build_camera(scenario), optics.baffle, optics.thermal
    response = load_curve(optics.transmission, "transmission", scenario.base_dir) * load_curve(
        detector.quantum_efficiency, "quantum_efficiency", scenario.base_dir
    )
    area_cm2 = math.pi / 4 * (optics.aperture_mm / 10.0) ** 2 * (1.0 - optics.obscuration**2)
    photometer = Photometer(response, area_cm2, scenario.sky.spectrum)
    lens = Lens(
        optics.focal_length_mm / optics.aperture_mm,
        detector.pitch_um,
        optics.obscuration,
        detector.charge_diffusion_um,
    )
    return FocalPlane(
        camera=camera,
        true_camera=true_camera(camera, thermal.expansion_ppm_k, thermal.temperature_c - thermal.reference_c),
        photometer=photometer,
        psfs=PsfSet(optics.psf, lens, (detector.width, detector.height), photometer.bin_weights),
        sky=replace(scenario.sky, earth=scenario.sky.earth and not _without_earth(scenario)),
        aperture_mm=optics.aperture_mm,
        pixel_area_cm2=detector.pitch_um[0] * detector.pitch_um[1] * 1e-8,
        vignetting=optics.vignetting,
        ghosts=optics.ghosts,
        baffle=build_baffle(
            baffle.pst,
            baffle.sun_exclusion_deg,
            baffle.moon_exclusion_deg,
            baffle.earth_exclusion_deg,
            scenario.base_dir,
        ),
        tether=scenario.tether,
    )


def _without_earth(scenario: Scenario) -> bool:
    """Whether attitudes are random over the whole sky, and the study leaves the Earth out of it."""
    study = scenario.study
    return study.sampling == "sky" and study.sky_without_earth and scenario.pointing.target is None


def build_scenes(scenario: Scenario) -> SceneBuilder:
    """Orbit, pointing and sky of a scenario.

    Raises
    ------
    InputError
        For a target that is not in its sky, or names or files that cannot be used.
    """
    parameters = SceneParameters(
        seed=scenario.seed,
        sampling=scenario.study.sampling,
        pointing=scenario.pointing,
        spectrum=load_spectrum(scenario.pointing.jitter, scenario.base_dir),
        sky=scenario.sky,
    )
    return SceneBuilder(parameters, build_orbit(scenario))


def build_orbit(scenario: Scenario) -> Trajectory:
    """Trajectory of a scenario's spacecraft; `InputError` for a file that cannot be used."""
    return build_trajectory(scenario.orbit, scenario.epoch, scenario.base_dir)


def build_mounting(scenario: Scenario) -> Attitude:
    """Body → camera of a scenario."""
    return mounting_of(scenario.pointing)


def build_detector(scenario: Scenario) -> Detector:
    """Detector of a scenario with its fixed pattern, which enters frames in single precision."""
    parameters = detector_parameters(scenario.detector)
    return Detector(parameters, build_fixed_pattern(parameters, scenario.seed).single())


def detector_parameters(section: DetectorSection) -> DetectorParameters:
    """A detector without its exposure."""
    names = {field.name for field in fields(DetectorParameters)} - {"pitch_um"}
    return DetectorParameters(**{name: getattr(section, name) for name in names}, pitch_um=section.pitch_um)


def shutter_of(section: DetectorSection) -> Shutter:
    """How a detector is exposed."""
    return Shutter(
        kind=section.shutter,
        line_time_s=section.line_time_us * 1e-6,
        transfer_direction="up" if section.readout_corner.startswith("top") else "down",
        transfer_smear=section.transfer_smear,
    )


def sequence_motion(section: SequenceSection) -> SequenceMotion:
    """Rate profile and slew of a sequence."""
    return SequenceMotion(section.start_s, section.step_s, section.rates, section.slew)
