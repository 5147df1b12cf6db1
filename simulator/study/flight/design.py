"""Design of the flight build of a scenario's camera."""

from __future__ import annotations

import dataclasses

from simulator.build import build_focal_plane
from simulator.renderer import Renderer
from simulator.scenario import Scenario
from simulator.study.trials.trial import build_tracker
from startracker.flight.design import DetectorNumbers, FlightDesign
from startracker.identification_settings import IdentificationSettings
from startracker.observer import Observer


def flight_design(scenario: Scenario, arithmetic: str = "fixed", identifier: str = "adaptive") -> FlightDesign:
    """What the flight build of a scenario's camera is made for.

    Parameters
    ----------
    scenario : Scenario
        Camera, detector and settings of the tracker.
    arithmetic, identifier : str
        As in `FlightDesign`.

    Raises
    ------
    InputError
        For an unknown arithmetic or identifier, or a camera that cannot be built.
    """
    renderer = Renderer(scenario)
    tracker = build_tracker(scenario, renderer.camera)
    psf = build_focal_plane(scenario).psfs.psf()
    frame, _ = renderer.frame(0)
    # the observer without aberration, which the flight build applies itself
    epoch = Observer(frame.observer.epoch_jyear)
    return FlightDesign(
        renderer.camera,
        tracker.guide.seen_by(epoch),
        DetectorNumbers(frame.gain_e_per_dn, frame.read_noise_e, int(frame.saturation_dn)),
        psf.sigma_px,
        tracker.detection,
        tracker.centroid,
        _identification(scenario, tracker.identification, identifier),
        arithmetic,
        identifier,
        scenario.name,
        scenario.fingerprint(),
    )


def _identification(scenario: Scenario, settings: IdentificationSettings, identifier: str) -> IdentificationSettings:
    """Settings of the scenario's identifier; those that all methods share if the flight build has another one."""
    if scenario.tracker.identifier == identifier:
        return settings
    shared = {one.name: getattr(settings, one.name) for one in dataclasses.fields(IdentificationSettings)}
    return IdentificationSettings(**shared)
