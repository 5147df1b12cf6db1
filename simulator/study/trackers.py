"""The tracker that a scenario runs: the reference in Python, or the flight build of its camera (``tracker.engine``)."""

from __future__ import annotations

from dataclasses import replace

from simulator.renderer import Renderer
from simulator.scenario import Scenario
from simulator.study.flight.design import flight_design
from simulator.study.flight.engine import FlightEngine
from simulator.study.flight.library import FlightLibrary, compiled_library
from simulator.study.flight.session import FlightSession
from simulator.study.star_tracker import build_tracker
from startracker.errors import InputError
from startracker.tracker import StarTracker
from startracker.tracking import GyroNoise, RateNoise, TrackingSession

Tracker = StarTracker | FlightEngine
Session = TrackingSession | FlightSession


def tracker_of(scenario: Scenario, renderer: Renderer) -> Tracker:
    """The tracker of a scenario for the camera of its renderer.

    Raises
    ------
    InputError
        For a camera or settings that a flight build does not hold, or without a C compiler.
    """
    reference = build_tracker(scenario, renderer.camera)
    if scenario.tracker.engine == "reference":
        return reference
    # without the digest of the scenario, which changes with seed and trials: the C does not know them
    try:
        design = replace(flight_design(scenario, renderer=renderer), digest="")
        return FlightEngine(design, reference.guide, FlightLibrary(compiled_library(design)))
    except InputError as error:
        raise InputError(f"tracker.engine: {error}") from error


def session_of(tracker: Tracker, noise: RateNoise | GyroNoise | None = None, exposure_s: float = 0.0) -> Session:
    """A tracking session. In a flight build it has the motion that was exported, whatever the noise."""
    if isinstance(tracker, FlightEngine):
        return FlightSession(tracker)
    return TrackingSession(tracker, noise, exposure_s=exposure_s)
