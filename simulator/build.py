"""Build the objects of the physics from a scenario: the only module that knows both the scenario's keys and those
objects.

The physics modules take plain frozen dataclasses, which also serve as sections of a scenario. This module looks up
names in registries, reads files, and converts units (mm, µm and µs of the scenario to pixels, cm and s).
"""

from __future__ import annotations

import functools
import math
from dataclasses import fields, replace
from datetime import datetime
from pathlib import Path

from simulator.detector import Detector, build_fixed_pattern
from simulator.detector.parameters import DetectorParameters, DisplacementDamage
from simulator.environment.damage import Damage, Pixel, damage
from simulator.environment.dose import OrbitRadiation, dose, orbit_radiation
from simulator.environment.parameters import Environment
from simulator.environment.transients import Transients
from simulator.exposure import Shutter
from simulator.focal_plane import FocalPlane
from simulator.mission.attitudes import build_attitude_law
from simulator.mission.jitter_table import read_jitter
from simulator.mission.parameters import OrbitParameters, SequenceMotion
from simulator.mission.pointing import mounting_of
from simulator.mission.trajectories import build_trajectory
from simulator.mission.trajectory import Trajectory
from simulator.optics.curves import Curve, load_curve
from simulator.optics.displacement import Displacement, draw_residual
from simulator.optics.jitter import load_spectrum
from simulator.optics.lens import Lens
from simulator.optics.psf_set import PsfSet
from simulator.optics.stray_light import build_baffle
from simulator.optics.thermal import LensTemperature
from simulator.randomness import stream
from simulator.scenario import Scenario
from simulator.scenario.schema import DetectorSection, SequenceSection
from simulator.scene import SceneBuilder, SceneParameters
from simulator.sky.faint_stars import FaintSky
from simulator.sky.photometry import Photometer
from simulator.sky.satellites import load_satellites
from startracker.geometry.attitude import Attitude
from startracker.geometry.camera import Camera

_LARGEST_IMAGE_PX = 512
"""Largest extent of a star image beyond the detector, in lines. A rolling shutter exposes rows of such an image before
its first and after its last row, so the time of a scene must cover them as well."""


def build_camera(scenario: Scenario) -> Camera:
    """The calibrated camera of a scenario's optics and detector."""
    optics, detector = scenario.optics, scenario.detector
    pitch_x, pitch_y = detector.pitch_um
    # Pixel centres have integer coordinates, so the middle of an image of `width` columns is (width - 1) / 2.
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


def build_focal_plane(scenario: Scenario, camera_seed: int | None = None) -> FocalPlane:
    """Lens, response and point spread functions of a scenario.

    Parameters
    ----------
    scenario : Scenario
        The scenario.
    camera_seed : int, optional
        Seed of the properties of this camera (its calibration residual), instead of the scenario's seed.

    Raises
    ------
    InputError
        For names or files in the scenario that cannot be used.
    """
    optics, detector = scenario.optics, scenario.detector
    camera, baffle = build_camera(scenario), optics.baffle
    exclusion_deg = (baffle.sun_exclusion_deg, baffle.moon_exclusion_deg, baffle.earth_exclusion_deg)
    with scenario.located("optics.baffle.pst"):
        shade = build_baffle(baffle.pst, *exclusion_deg, scenario.base_dir)
    response = load_curve(optics.transmission, "transmission", scenario.base_dir) * load_curve(
        detector.quantum_efficiency, "quantum_efficiency", scenario.base_dir
    )
    if scenario.environment.has_damage:
        response = Curve(response.wavelength_nm, build_damage(scenario).transmission * response.value)
    # The central obstruction is a fraction of the diameter, so it blocks the square of this fraction of the area.
    area_cm2 = math.pi / 4 * (optics.aperture_mm / 10.0) ** 2 * (1.0 - optics.obscuration**2)
    photometer = Photometer(response, area_cm2, scenario.sky.spectrum)
    lens = Lens(
        optics.focal_length_mm / optics.aperture_mm,
        detector.pitch_um,
        optics.obscuration,
        detector.charge_diffusion_um,
        detector.intra_pixel.contrast,
    )
    temperature = lens_temperature(scenario)
    with scenario.located("optics.psf"):
        psfs = PsfSet(optics.psf, lens, (detector.width, detector.height), photometer.bin_weights)
    # The tracker is given the calibrated camera; the sky is rendered through the lens as it is at the epoch.
    true_camera = temperature.camera_at(camera, 0.0)
    return FocalPlane(
        camera=camera,
        true_camera=true_camera,
        temperature=temperature,
        displacement=_displacement(scenario, true_camera, photometer, camera_seed),
        photometer=photometer,
        psfs=psfs,
        sky=replace(scenario.sky, earth=scenario.sky.earth and not _without_earth(scenario)),
        faint_sky=_faint_sky(scenario),
        aperture_mm=optics.aperture_mm,
        pixel_area_cm2=detector.pitch_um[0] * detector.pitch_um[1] * 1e-8,  # µm² to cm²
        vignetting=optics.vignetting,
        ghosts=optics.ghosts,
        baffle=shade,
        tether=scenario.tether,
    )


def _faint_sky(scenario: Scenario) -> FaintSky | None:
    """Synthetic stars fainter than the catalogue's limit; None if the scenario has none."""
    sky = scenario.sky
    if sky.faint_magnitude_limit is None or sky.faint_magnitude_limit <= sky.magnitude_limit:
        return None
    return FaintSky(scenario.seed, sky.magnitude_limit, sky.faint_magnitude_limit)


def lens_temperature(scenario: Scenario) -> LensTemperature:
    """Temperature of the lens over time, and its effect on the camera."""
    thermal, pitch_um = scenario.optics.thermal, scenario.detector.pitch_um
    return LensTemperature(
        expansion_ppm_k=thermal.expansion_ppm_k,
        decentring_px_k=(thermal.decentring_um_k[0] / pitch_um[0], thermal.decentring_um_k[1] / pitch_um[1]),
        warmer_k=thermal.temperature_c - thermal.reference_c,
        swing_k=thermal.swing_k,
        period_s=thermal.swing_period_s,
    )


def _displacement(scenario: Scenario, camera: Camera, photometer: Photometer, camera_seed: int | None) -> Displacement:
    """Displacement of star images from the positions that the camera model predicts."""
    optics, seed = scenario.optics, scenario.seed if camera_seed is None else camera_seed
    residual = draw_residual(camera, optics.calibration_residual, stream(seed, "calibration residual"))
    reference_nm = float(photometer.effective_wavelength_nm(optics.lateral_colour.reference_b_v))
    curve_px = scenario.detector.intra_pixel.centroid_curve_px
    return Displacement.of(camera, residual, optics.lateral_colour, reference_nm, curve_px)


def _without_earth(scenario: Scenario) -> bool:
    """Whether attitudes are random over the whole sky and ``study.sky_without_earth`` removes the Earth from it."""
    study = scenario.study
    return study.sampling == "sky" and study.sky_without_earth and scenario.pointing.target is None


def build_scenes(scenario: Scenario, trajectory: Trajectory | None = None) -> SceneBuilder:
    """Orbit, pointing and sky of a scenario; a `trajectory` replaces the scenario's orbit.

    Raises
    ------
    InputError
        For a target that is not in its sky, or names or files that cannot be used.
    """
    # Rows of a rolling shutter, and of star images beyond the detector, are exposed one after the other.
    orbit, detector = trajectory or build_orbit(scenario), scenario.detector
    margin_lines = detector.height + 2 * _LARGEST_IMAGE_PX if detector.shutter == "rolling" else 0
    with scenario.located("pointing.jitter"):
        spectrum = load_spectrum(scenario.pointing.jitter, scenario.base_dir)
        series = read_jitter(scenario.pointing.jitter, orbit.clock, scenario.base_dir)
    parameters = SceneParameters(
        seed=scenario.seed,
        sampling=scenario.study.sampling,
        pointing=scenario.pointing,
        spectrum=spectrum,
        sky=scenario.sky,
        series=series,
        exposure_margin_s=margin_lines * detector.line_time_us * 1e-6,
    )
    with scenario.located("pointing"):
        law = build_attitude_law(scenario.pointing, orbit, scenario.base_dir)
    with scenario.located("sky.satellites.file"):
        satellites = load_satellites(scenario.sky.satellites, orbit.clock, scenario.base_dir)
    with scenario.located("pointing.target"):
        return SceneBuilder(parameters, orbit, law, satellites)


def build_orbit(scenario: Scenario) -> Trajectory:
    """Trajectory of a scenario's spacecraft; `InputError` for a file that cannot be used."""
    with scenario.located("orbit"):
        return build_trajectory(scenario.orbit, scenario.epoch, scenario.base_dir)


def build_mounting(scenario: Scenario) -> Attitude:
    """Body → camera of a scenario."""
    return mounting_of(scenario.pointing)


def build_detector(scenario: Scenario, camera_seed: int | None = None) -> Detector:
    """Detector of a scenario, aged by its environment, with its fixed pattern.

    The pattern is drawn from `camera_seed`, or from the scenario's seed, and stored in single precision.
    """
    parameters, seed = aged_detector(scenario), scenario.seed if camera_seed is None else camera_seed
    with scenario.located("detector"):
        return Detector(parameters, build_fixed_pattern(parameters, seed).single())


def detector_parameters(section: DetectorSection) -> DetectorParameters:
    """Parameters of the detector's section, without those of the exposure (time, shutter)."""
    # The pitch is excluded because the section defines it as a property, from one number or two.
    names = {field.name for field in fields(DetectorParameters)} - {"pitch_um"}
    return DetectorParameters(**{name: getattr(section, name) for name in names}, pitch_um=section.pitch_um)


def aged_detector(scenario: Scenario) -> DetectorParameters:
    """The detector of a scenario with the radiation damage of its environment added."""
    parameters = detector_parameters(scenario.detector)
    if scenario.environment.has_damage:
        parameters = _with_damage(parameters, build_damage(scenario))
    if scenario.environment.has_particles:
        # The environment gives the particles of every frame. The rate set here has no effect on their number: a rate
        # above 0 only enables the cosmic-ray stage.
        parameters = replace(parameters, cosmic_rays=replace(parameters.cosmic_rays, rate_cm2_s=1.0))
    return parameters


def _with_damage(new: DetectorParameters, aged: Damage) -> DetectorParameters:
    """The detector's own defects plus the damage of its environment."""
    # Both populations of displacement defects are merged into one with the same total dark current.
    interactions = new.displacement.interactions_per_pixel + aged.displacement.interactions_per_pixel
    dark_e_s = new.displacement.mean_e_s + aged.displacement.mean_e_s
    return replace(
        new,
        dark_current_e_s=new.dark_current_e_s + aged.dark_current_e_s,
        displacement=DisplacementDamage(interactions, dark_e_s / interactions if interactions > 0 else 0.0),
        telegraph=aged.telegraph if new.telegraph.pixel_fraction == 0 else new.telegraph,
        cti_parallel=new.cti_parallel + aged.cti_parallel,
        cti_serial=new.cti_serial + aged.cti_serial,
    )


def build_damage(scenario: Scenario, environment: Environment | None = None) -> Damage:
    """Damage of the camera by the scenario's environment, or by `environment` if it is given.

    Raises
    ------
    InputError
        If the package of the trapped particles is not installed.
    """
    environment, section = environment or scenario.environment, scenario.detector
    with scenario.located("environment"):
        radiation = orbit_radiation_of(scenario, environment)
    pixel = Pixel(section.pitch_um[0] * section.pitch_um[1], section.dark_reference_c, section.kind != "cmos")
    # The detector is behind the camera's shield, the lens behind its own (the glass shield).
    inner, outer = (
        dose(radiation, environment, shield_mm, environment.age_years)
        for shield_mm in (environment.shield_mm, environment.glass_shield_mm)
    )
    return damage(inner, outer, pixel, environment)


def orbit_radiation_of(scenario: Scenario, environment: Environment) -> OrbitRadiation:
    """Mean radiation outside the spacecraft along the orbit of a scenario."""
    return _orbit_radiation(scenario.orbit, scenario.epoch, scenario.base_dir, environment.sources)


@functools.lru_cache(maxsize=8)  # takes 1.5 s, and the detector and the lens need the same orbit
def _orbit_radiation(orbit: OrbitParameters, epoch: datetime, folder: Path, sources: Environment) -> OrbitRadiation:
    return orbit_radiation(build_trajectory(orbit, epoch, folder), sources)


def build_transients(scenario: Scenario) -> Transients | None:
    """Particle rates at the positions of frames; None if the environment has no particles.

    Raises
    ------
    InputError
        If the package of the trapped particles is not installed.
    """
    environment = scenario.environment
    with scenario.located("environment"):
        return Transients(environment, build_orbit(scenario).clock) if environment.has_particles else None


def shutter_of(section: DetectorSection) -> Shutter:
    """How a detector is exposed."""
    return Shutter(
        kind=section.shutter,
        line_time_s=section.line_time_us * 1e-6,
        # Row 0 is the top of the image, and charge is transferred towards the readout corner.
        transfer_direction="up" if section.readout_corner.startswith("top") else "down",
        transfer_smear=section.transfer_smear,
    )


def sequence_motion(section: SequenceSection) -> SequenceMotion:
    """Rate profile and slew of a sequence."""
    return SequenceMotion(section.start_s, section.step_s, section.rates, section.slew)
