"""Design of the flight build of a scenario's camera, or of a camera that is given by its size and field."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from simulator.renderer import Renderer
from simulator.scenario import Scenario
from simulator.scenario.schema_sequence import SequenceSection
from simulator.study.process_noise import process_noise
from simulator.study.star_tracker import build_tracker
from startracker.catalog import load_catalog
from startracker.catalog.guide import GuideDatabase
from startracker.catalog.stars import StarCatalog
from startracker.errors import InputError
from startracker.flight.design import DetectorNumbers, FlightDesign
from startracker.geometry.camera import Camera
from startracker.observer import Observer
from startracker.settings import TrackingSettings
from startracker.settings.identification import IdentificationSettings
from startracker.tracking.mekf import GyroNoise, RateNoise

_NUMBERS_END = 2**31


def flight_design(
    scenario: Scenario, arithmetic: str | None = None, identifier: str | None = None, renderer: Renderer | None = None
) -> FlightDesign:
    """What the flight build of a scenario's camera is made for.

    Parameters
    ----------
    scenario : Scenario
        Camera, detector and settings of the tracker.
    arithmetic : str, optional
        As in `FlightDesign`; default: the arithmetic of the scenario.
    identifier : str, optional
        As in `FlightDesign`; default: ``triads`` for a scenario with triads, else ``adaptive``.
    renderer : Renderer, optional
        Of the scenario, if there is one.

    Raises
    ------
    InputError
        For an unknown arithmetic or identifier, or a camera that cannot be built.
    """
    if identifier is None:
        identifier = "triads" if scenario.tracker.identifier == "triads" else "adaptive"
    renderer = renderer or Renderer(scenario)
    tracker = build_tracker(scenario, renderer.camera)
    psf = renderer.focal_plane.psfs.psf()
    frame, _ = renderer.frame(0)
    _check_numbers(tracker.guide.catalog)
    # the observer without aberration, which the flight build applies itself
    epoch = Observer(frame.observer.epoch_jyear)
    return FlightDesign(
        renderer.camera,
        tracker.guide.apparent_to(epoch),
        DetectorNumbers(frame.gain_e_per_dn, frame.read_noise_e, int(frame.saturation_dn)),
        psf.sigma_px,
        tracker.detection,
        tracker.centroid,
        _identification(scenario, tracker.identification, identifier),
        arithmetic or scenario.tracker.flight.arithmetic,
        identifier,
        _motion(scenario.sequence),
        TrackingSettings(),
        scenario.name,
        scenario.fingerprint(),
    )


def _check_numbers(catalog: StarCatalog) -> None:
    """`InputError` for stars whose numbers the tables of a flight build do not hold, as Gaia's."""
    if len(catalog) and int(np.abs(catalog.id).max()) >= _NUMBERS_END:
        raise InputError(
            f"the catalogue {catalog.name} has star numbers of more than 32 bits, which a flight build does not hold; "
            "use tracker.catalog: hipparcos"
        )


def camera_design(
    size_px: tuple[int, int],
    fov_deg: tuple[float, float],
    settings: IdentificationSettings,
    identifier: str = "triads",
    arithmetic: str = "fixed",
    declination_deg: tuple[float, float] = (-90.0, 90.0),
    magnitude_limit: float = 6.0,
) -> FlightDesign:
    """Design of a camera without distortion, whose tracker takes lists of centroids.

    Parameters
    ----------
    size_px, fov_deg : (int, int), (float, float)
        Pixels and degrees, across and down; the optical axis is in the middle of the image.
    settings : IdentificationSettings
        Of the identifier.
    identifier, arithmetic : str
        As in `FlightDesign`.
    declination_deg : (float, float)
        Range of the stars of the Bright Star Catalogue.
    magnitude_limit : float
        Magnitude of the faintest star.

    Raises
    ------
    InputError
        For fewer than three stars, or a camera or settings that a flight build does not hold.
    """
    (width, height), low_high = size_px, np.radians(declination_deg)
    fx, fy = (n / 2.0 / math.tan(math.radians(angle) / 2.0) for n, angle in zip(size_px, fov_deg, strict=True))
    camera = Camera(fx, fy, (width - 1) / 2.0, (height - 1) / 2.0, width, height)
    catalog = load_catalog("bsc5")
    catalog = catalog.select((catalog.dec_rad >= low_high[0]) & (catalog.dec_rad <= low_high[1]))
    guide = GuideDatabase.build(catalog, camera, magnitude_limit, settings)
    return FlightDesign(camera, guide, identification=settings, arithmetic=arithmetic, identifier=identifier)


def _motion(section: SequenceSection) -> RateNoise | GyroNoise:
    """Motion of the camera between the frames of a sequence; the default where it is measured from the frames. A flight
    build does not estimate a gyro's scale factors."""
    if section.rate_walk_deg_s_sqrt_s == "auto":
        walk = math.degrees(RateNoise().acceleration)
        section = section.model_copy(update={"rate_walk_deg_s_sqrt_s": walk})
    noise = process_noise(section, [], [], 0.0)
    return dataclasses.replace(noise, scale_sigma=0.0) if isinstance(noise, GyroNoise) else noise


def _identification(scenario: Scenario, settings: IdentificationSettings, identifier: str) -> IdentificationSettings:
    """Settings of the scenario's identifier; those that all methods share if the flight build has another one."""
    if identifier == scenario.tracker.identifier:
        return settings
    shared = {one.name: getattr(settings, one.name) for one in dataclasses.fields(IdentificationSettings)}
    return IdentificationSettings(**shared)
