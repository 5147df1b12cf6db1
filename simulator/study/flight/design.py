"""Design of the flight build of a scenario's camera."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from simulator.renderer import Renderer
from simulator.scenario import Scenario
from simulator.scenario.schema_sequence import SequenceSection
from simulator.study.process_noise import process_noise
from simulator.study.star_tracker import build_tracker
from startracker.catalog.stars import StarCatalog
from startracker.errors import InputError
from startracker.flight.design import DetectorNumbers, FlightDesign
from startracker.observer import Observer
from startracker.settings import TrackingSettings
from startracker.settings.identification import IdentificationSettings
from startracker.tracking.mekf import GyroNoise, RateNoise

_NUMBERS_END = 2**31
_TRIADS = ("triads", "triads_integer")
"""Identifiers of the star tracker that a flight build has as ``triads``."""


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
        identifier = "triads" if scenario.tracker.identifier in _TRIADS else "adaptive"
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
    if identifier == scenario.tracker.identifier or (identifier == "triads" and scenario.tracker.identifier in _TRIADS):
        return settings
    shared = {one.name: getattr(settings, one.name) for one in dataclasses.fields(IdentificationSettings)}
    return IdentificationSettings(**shared)
