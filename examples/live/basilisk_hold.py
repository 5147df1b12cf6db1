"""A spacecraft in Basilisk that holds its attitude on rendered and solved star images alone, without a gyro.

It flies twice: with the star tracker of ``hold.yaml``, whose filter gives attitude and rate, and with Basilisk's ideal
navigation. Both have the same controller (``mrpFeedback`` with integral feedback), Earth gravity, gravity gradient and
a constant disturbance. Needs the package bsk.

    python examples/live/basilisk_hold.py [--seconds 900] [--figure hold.png]
"""

from __future__ import annotations

import argparse
from collections import Counter
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from Basilisk.architecture import messaging
from Basilisk.fswAlgorithms import attTrackingError, inertial3D, mrpFeedback
from Basilisk.simulation import GravityGradientEffector, extForceTorque, simpleNav, spacecraft
from Basilisk.utilities import SimulationBaseClass, macros, simIncludeGravBody
from loop_theory import Expected, Loop, expected, frame_covariance
from matplotlib import rc_context
from matplotlib.figure import Figure
from numpy.typing import NDArray

from simulator import Scenario
from simulator.build import build_orbit
from simulator.live.basilisk import CameraStarTracker, Measurement
from simulator.live.mrp import attitude_of_mrp, mrp_of_attitude
from simulator.mission.pointing import local_level, mounting_of
from simulator.study.style import BLUE, GREEN, INK, ORANGE, STUDY_STYLE, VERMILION
from startracker import Attitude
from startracker.images.picture import figure_bytes

FloatArray = NDArray[np.float64]

ARCSEC = np.radians(1.0 / 3600.0)
SCENARIO = Path(__file__).with_name("hold.yaml")

INERTIA = np.diag([0.22, 0.13, 0.22])
"""kg m²: a 12U satellite of 20 kg, 0.2 × 0.3 × 0.2 m, of even density; the camera looks along +Y."""
DISTURBANCE = (1e-6, -0.5e-6, 1e-6)
"""N m, body axes; assumed: a residual dipole of 0.03 A m² in a field of 3e-5 T."""
BANDWIDTH, DAMPING = 0.1, 0.9
"""Natural frequency, rad/s, and damping of the loop about the axes of larger inertia."""
START_DEG, START_RATE = (0.1, -0.1, 0.2), (1e-4, -1e-4, 5e-5)
"""Initial pointing error, and rate in rad/s."""
FREE_S = 3.0
"""Time before the controller is switched on, in which the tracker finds its first attitudes."""


class Flight(NamedTuple):
    """One flight, at the times of the commands."""

    t_s: FloatArray
    pointing_rad: FloatArray
    """(N, 3): Rotation vector from the commanded to the true attitude of the body, body axes."""
    measurements: list[Measurement]
    """Frames of the tracker; empty with ideal navigation."""


def loop_of(scenario: Scenario) -> Loop:
    """The controller, and the filter of the scenario's tracker."""
    inertia = float(INERTIA[0, 0])
    rate_gain = 2.0 * DAMPING * BANDWIDTH * inertia
    section = scenario.sequence
    return Loop(
        INERTIA,
        attitude_gain=4.0 * inertia * BANDWIDTH**2,
        rate_gain=rate_gain,
        integral_gain=0.2 * BANDWIDTH / rate_gain,
        step_s=section.step_s,
        acceleration=np.radians(section.rate_walk_deg_s_sqrt_s),
    )


class _Craft(NamedTuple):
    """A spacecraft and what acts on it; Basilisk keeps no references to them."""

    body: spacecraft.Spacecraft
    commanded: Attitude
    """ICRS → body to be held: the local level of the first moment."""
    torque: extForceTorque.ExtForceTorque
    gradient: GravityGradientEffector.GravityGradientEffector
    gravity: simIncludeGravBody.gravBodyFactory


class _Controller(NamedTuple):
    """Basilisk's chain from an estimated attitude to a torque."""

    reference: inertial3D.inertial3D
    error: attTrackingError.attTrackingError
    feedback: mrpFeedback.mrpFeedback
    vehicle: messaging.VehicleConfigMsg


def fly(scenario: Scenario, seconds: float, *, ideal: bool = False) -> Flight:
    """Fly with the scenario's star tracker, or with Basilisk's ideal navigation."""
    simulation = SimulationBaseClass.SimBaseClass()
    process, step_ns = simulation.CreateNewProcess("all"), macros.sec2nano(scenario.sequence.step_s)
    for name, period_ns, priority in (("body", step_ns // 5, 3), ("sensor", step_ns, 2), ("control", step_ns, 1)):
        process.addTask(simulation.CreateNewTask(name, period_ns), priority)

    craft = _spacecraft(scenario)
    navigation = simpleNav.SimpleNav() if ideal else CameraStarTracker(scenario)
    navigation.scStateInMsg.subscribeTo(craft.body.scStateOutMsg)
    controller = _controller(loop_of(scenario), craft.commanded, navigation.attOutMsg)
    craft.torque.cmdTorqueInMsg.subscribeTo(controller.feedback.cmdTorqueOutMsg)
    states = craft.body.scStateOutMsg.recorder()
    models = {"body": (craft.body, craft.gradient, craft.torque), "sensor": (navigation, states)}
    models["control"] = controller[:3]
    for task, members in models.items():
        for model in members:
            simulation.AddModelToTask(task, model)

    simulation.InitializeSimulation()
    simulation.disableTask("control")
    simulation.ConfigureStopTime(macros.sec2nano(FREE_S))
    simulation.ExecuteSimulation()
    simulation.enableTask("control")
    simulation.ConfigureStopTime(macros.sec2nano(seconds))
    simulation.ExecuteSimulation()
    pointing = [craft.commanded.rotation_vector_to(attitude_of_mrp(s, "icrs")) for s in states.sigma_BN]
    return Flight(states.times() * 1e-9, np.array(pointing), [] if ideal else navigation.measurements)


def _spacecraft(scenario: Scenario) -> _Craft:
    """The body in the scenario's orbit, and its torques."""
    r_km, v_km_s = build_orbit(scenario).state(np.array(scenario.sequence.start_s))
    commanded = Attitude(local_level(r_km, v_km_s).quat, "icrs", "body")
    start = Attitude.from_rotation_vector(np.radians(START_DEG), "body", "body") @ commanded
    body = spacecraft.Spacecraft()
    body.hub.mHub = 20.0
    body.hub.IHubPntBc_B = INERTIA.tolist()
    body.hub.r_CN_NInit, body.hub.v_CN_NInit = (r_km * 1e3).tolist(), (v_km_s * 1e3).tolist()
    body.hub.sigma_BNInit, body.hub.omega_BN_BInit = mrp_of_attitude(start).tolist(), list(START_RATE)
    gravity = simIncludeGravBody.gravBodyFactory()
    earth = gravity.createEarth()
    earth.isCentralBody = True
    gravity.addBodiesTo(body)
    gradient = GravityGradientEffector.GravityGradientEffector()
    gradient.addPlanetName(earth.planetName)
    torque = extForceTorque.ExtForceTorque()
    torque.extTorquePntB_B = list(DISTURBANCE)
    for effector in (gradient, torque):
        body.addDynamicEffector(effector)
    return _Craft(body, commanded, torque, gradient, gravity)


def _controller(loop: Loop, commanded: Attitude, navigation: messaging.NavAttMsg) -> _Controller:
    """Reference, error and feedback, all of Basilisk."""
    reference = inertial3D.inertial3D()
    reference.sigma_R0N = mrp_of_attitude(commanded).tolist()
    error = attTrackingError.attTrackingError()
    error.attRefInMsg.subscribeTo(reference.attRefOutMsg)
    error.attNavInMsg.subscribeTo(navigation)
    feedback = mrpFeedback.mrpFeedback()
    feedback.K, feedback.P, feedback.Ki = loop.attitude_gain, loop.rate_gain, loop.integral_gain
    feedback.integralLimit = 1.0  # N m: never reached
    feedback.guidInMsg.subscribeTo(error.attGuidOutMsg)
    inertia = messaging.VehicleConfigMsgPayload(ISCPntB_B=loop.inertia_kg_m2.ravel().tolist())
    vehicle = messaging.VehicleConfigMsg().write(inertia)
    feedback.vehConfigInMsg.subscribeTo(vehicle)
    return _Controller(reference, error, feedback, vehicle)


class Steady(NamedTuple):
    """Errors after the loop has settled, body axes, beside what is expected of them."""

    pointing_rad: FloatArray
    knowledge_rad: FloatArray
    """(N, 3): Rotation from the commanded to the true attitude, and from the true to the estimated one."""
    nees: FloatArray
    """(N,): Knowledge error squared, normalised by the tracker's covariance."""
    expected: Expected
    """By the linear theory, with the error of a frame that the tracker states."""


def steady(scenario: Scenario, flight: Flight, settled_s: float) -> Steady:
    """Errors of a flight with the star tracker from a time on."""
    loop, to_body = loop_of(scenario), mounting_of(scenario.pointing).inverse.as_matrix()
    frames = [m for m in flight.measurements if m.t_s >= settled_s]
    covariances = [m.covariance for m in frames]
    of_frames = [frame_covariance(loop, *pair) for pair in pairwise(covariances)]
    errors = np.array([m.error_rad for m in frames])
    nees = [e @ np.linalg.solve(c[:3, :3], e) for e, c in zip(errors, covariances, strict=True)]
    theory = expected(loop, to_body @ np.mean(of_frames, axis=0) @ to_body.T)
    return Steady(flight.pointing_rad[flight.t_s >= settled_s], errors @ to_body.T, np.array(nees), theory)


def report(flight: Flight, found: Steady, ideal: Flight, settled_s: float) -> str:
    """Figures of both flights as a table."""
    theory, settled = found.expected, ideal.t_s >= settled_s
    modes = Counter(str(m.solution.status) for m in flight.measurements)
    rows = [
        ("pointing, rms", _rms(found.pointing_rad)),
        ("  expected", np.sqrt(np.diag(theory.pointing))),
        ("  with ideal navigation", _rms(ideal.pointing_rad[settled])),
        ("knowledge, rms", _rms(found.knowledge_rad)),
        ("  of which constant", np.abs(found.knowledge_rad.mean(axis=0))),
        ("  expected", np.sqrt(np.diag(theory.knowledge))),
        ("  stated by the tracker", np.sqrt(np.diag(theory.stated))),
    ]
    head = f"{'arcseconds about the axes of the body':38}{'X':>8}{'Y':>8}{'Z':>8}"
    table = [f"{name:38}" + "".join(f"{v / ARCSEC:8.3f}" for v in values) for name, values in rows]
    nees = f"NEES {found.nees.mean():.2f}, expected {theory.nees:.2f}; frames: {dict(modes)}"
    return "\n".join([head, *table, nees])


def _rms(errors: FloatArray) -> FloatArray:
    return np.sqrt(np.mean(errors**2, axis=0))


def figure(flight: Flight, found: Steady, ideal: Flight, settled_s: float) -> Figure:
    """Acquisition; then pointing and knowledge, across and about the boresight."""
    drawing = Figure(figsize=(8.6, 7.4))
    panels = drawing.subplot_mosaic([["start", "start"], ["pointing", "roll"], ["knowledge", "known roll"]])
    start = panels["start"]
    for flown, colour, name in ((ideal, ORANGE, "ideal navigation"), (flight, BLUE, "star tracker")):
        start.semilogy(flown.t_s, np.linalg.norm(flown.pointing_rad, axis=1) / ARCSEC, color=colour, label=name, lw=1)
    start.set(xlabel="time (s)", ylabel="error (″)", ylim=(1e-3, 2e3), title="Pointing from the first frames on")
    start.legend()
    theory, across, about = found.expected, ((0, BLUE), (2, GREEN)), ((1, VERMILION),)
    for panel, errors, covariance, axes, title in (
        ("pointing", found.pointing_rad, theory.pointing, across, "Pointing across the boresight"),
        ("roll", found.pointing_rad, theory.pointing, about, "Pointing about the boresight"),
        ("knowledge", found.knowledge_rad, theory.stated, across, "Knowledge across the boresight"),
        ("known roll", found.knowledge_rad, theory.stated, about, "Knowledge about the boresight"),
    ):
        time = np.linspace(settled_s, flight.t_s[-1], len(errors))
        band = "expected ± 3σ" if errors is found.pointing_rad else "stated ± 3σ"
        for k, colour in axes:
            panels[panel].plot(time, errors[:, k] / ARCSEC, color=colour, lw=0.8, label=f"about {'XYZ'[k]}")
        limit = 3.0 * np.sqrt(covariance[k, k]) / ARCSEC
        panels[panel].plot(time[[0, -1]], [limit, limit], color=INK, ls="--", lw=0.9, label=band)
        panels[panel].plot(time[[0, -1]], [-limit, -limit], color=INK, ls="--", lw=0.9)
        largest = max(limit, np.abs(errors[:, [k for k, _ in axes]]).max() / ARCSEC)
        panels[panel].set(title=title, xlabel="time (s)", ylabel="error (″)", ylim=(-1.1 * largest, 1.5 * largest))
        panels[panel].legend(ncols=3, loc="upper center", columnspacing=1.2, handlelength=1.5)
    return drawing


def main() -> None:
    """Both flights, their table, and their figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=900.0)
    parser.add_argument("--settled", type=float, default=400.0, help="start of the statistics")
    parser.add_argument("--figure", type=Path)
    asked = parser.parse_args()
    scenario = Scenario.load(SCENARIO)
    flight, ideal = fly(scenario, asked.seconds), fly(scenario, asked.seconds, ideal=True)
    found = steady(scenario, flight, asked.settled)
    print(report(flight, found, ideal, asked.settled))
    if asked.figure:
        with rc_context(STUDY_STYLE):
            asked.figure.write_bytes(figure_bytes(figure(flight, found, ideal, asked.settled), dpi=100))


if __name__ == "__main__":
    main()
