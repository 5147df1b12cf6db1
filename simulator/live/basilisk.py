"""A star tracker for Basilisk: its frames are rendered from the spacecraft's state and solved, in process.

Needs the package ``bsk`` (extra ``basilisk``). Basilisk: Kenneally, Piggott & Schaub 2020, J. Aerospace Information
Systems 17, 496.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Any, NamedTuple

import numpy as np

from simulator.constants import RADIUS_KM
from simulator.live.mrp import attitude_of_mrp, euler_parameters, mrp_of_attitude
from simulator.mission.clock import Clock
from simulator.mission.frames import to_frame
from simulator.mission.given import GivenTrajectory
from simulator.mission.motion import MotionState, on_mounting
from simulator.mission.pointing import Pointing, mounting_of
from simulator.randomness import stream
from simulator.renderer import Renderer
from simulator.scenario import Scenario
from simulator.scenario.schema import SequenceSection
from simulator.study.axes import CAMERA_AXES
from simulator.study.sequence.camera import Moment, SequenceCamera, TrackedFrame
from startracker.core import FloatArray
from startracker.errors import InputError
from startracker.geometry.attitude import Attitude
from startracker.solution import Solution
from startracker.tracking import RateNoise

try:
    from Basilisk.architecture import messaging, sysModel
except ImportError as error:
    raise ImportError(
        "the star tracker for Basilisk needs the package bsk: pip install 'boresight[basilisk]'"
    ) from error

__all__ = ["INERTIAL_FRAMES", "CameraStarTracker", "Measurement"]

INERTIAL_FRAMES = ("icrf", "eme2000", "ecliptic")
"""Axes that Basilisk's frame N can have (`simulator.mission.frames.to_frame`)."""

_NANO = 1e-9


class Measurement(NamedTuple):
    """One frame of the tracker, beside its truth."""

    t_s: float
    """Mid-exposure, seconds of Basilisk's clock."""
    row: dict[str, Any]
    """Row of ``sequence.parquet`` with truth, errors, mode and counts."""
    solution: Solution
    """Status, reason, and the filter's attitude if the frame was solved."""
    attitude: Attitude | None
    """ICRS → camera of the filter at mid-exposure, also if the frame was not solved; None before the first solution."""
    rate_rad_s: FloatArray | None
    """(3,): Estimated rate, camera axes."""
    covariance: FloatArray | None
    """(6, 6): Of the errors of attitude and rate, camera axes."""

    @property
    def error_rad(self) -> FloatArray:
        """Rotation vector (3,) from the true to the estimated attitude, camera axes; NaN without an estimate."""
        return np.radians([self.row[f"error_{axis}_deg"] for axis in CAMERA_AXES])


class _Delivery(NamedTuple):
    """A measurement on its way to the messages."""

    due_ns: int
    measured: Measurement


class CameraStarTracker(sysModel.SysModel):  # type: ignore[misc]
    """Star tracker as a module of Basilisk.

    Parameters
    ----------
    scenario : Scenario
        Camera, tracker, sky and mounting (``pointing.mounting``). A frame is taken every ``sequence.step_s``; time zero
        of Basilisk is ``sequence.start_s`` after the scenario's epoch. The attitude is Basilisk's.
    inertial : str
        Axes of Basilisk's inertial frame N, one of `INERTIAL_FRAMES`. SPICE calls its realisation of ICRF "J2000", so
        that ``icrf`` is right for states of SPICE; ``eme2000`` is the mean equator and equinox of J2000, 23 mas away.
    centre : str, optional
        Origin of Basilisk's positions, one of `simulator.mission.trajectory.CENTRES`. None: the spacecraft's position
        and velocity follow the scenario's orbit, for spacecraft without gravity.
    latency_s : float
        Time from the end of an exposure to the message.

    Attributes
    ----------
    scStateInMsg : SCStatesMsgReader
        State of the spacecraft.
    sensorOutMsg : STSensorMsg
        Euler parameters of the camera, and the time of mid-exposure, ns; written when a frame was solved.
    attOutMsg : NavAttMsg
        Attitude and rate of the body by the tracker's filter, propagated with the estimated rate from mid-exposure to
        the time of each update; written from the first solution on.
    latest : Measurement or None
        Last delivered frame, with status, reason and covariance.
    measurements : list of Measurement
        All frames taken, without their images, 5 kB each; may be cleared during a long flight.
    frame : TrackedFrame or None
        Last frame taken, with its image and truth.

    Raises
    ------
    InputError
        For an unknown frame or centre, or a scenario that cannot be rendered; from updates, for an impossible state.

    Notes
    -----
    A frame is rendered at the first update at or after its time, with mid-exposure at the update, the true attitude of
    `scStateInMsg` and its rate over the exposure; it is delivered at the first update after half the exposure and the
    latency. Aberration and parallax follow from Basilisk's velocity and position. The messages have no field for a
    failure: without a solution `sensorOutMsg` keeps its old time tag, and `latest` has the reason.
    """

    def __init__(
        self, scenario: Scenario, *, inertial: str = "icrf", centre: str | None = "Earth", latency_s: float = 0.0
    ) -> None:
        super().__init__()
        if inertial not in INERTIAL_FRAMES:
            raise InputError(f"unknown inertial frame {inertial!r}; choose one of {', '.join(INERTIAL_FRAMES)}")
        if not (math.isfinite(latency_s) and latency_s >= 0.0):
            raise InputError(f"the latency must be zero or positive seconds; got {latency_s}")
        self.ModelTag = "CameraStarTracker"
        self.scenario, self.latency_s = scenario, latency_s
        clock = Clock(scenario.epoch)
        self._given = None if centre is None else GivenTrajectory(clock, centre)
        self.renderer = Renderer(scenario, trajectory=self._given)
        self.mounting = mounting_of(scenario.pointing)
        """Body → camera."""
        still = Attitude(np.array([0.0, 0.0, 0.0, 1.0]), "icrs", "body")
        start = Pointing(still, self.mounting @ still, self.mounting @ still, self.mounting, np.zeros(3))
        self.camera = SequenceCamera(scenario, self.renderer, start)  # of the start, only the mounting is used
        self._inertial = Attitude.from_matrix(to_frame(inertial, clock, 0.0), "icrs", "inertial")
        self._step_ns = round(scenario.sequence.step_s / _NANO)
        self._delay_ns = math.ceil((0.5 * self.renderer.exposure_s + latency_s) / _NANO)
        self.scStateInMsg = messaging.SCStatesMsgReader()
        self.sensorOutMsg = messaging.STSensorMsg()
        self.attOutMsg = messaging.NavAttMsg()

    def Reset(self, CurrentSimNanos: int) -> None:
        """Begin at a time of Basilisk's clock, as it calls at initialisation; the frames start again with number 0."""
        if not self.scStateInMsg.isLinked():
            raise InputError("scStateInMsg is not linked: subscribe it to the spacecraft's scStateOutMsg")
        section = self.scenario.sequence
        self.camera.begin(_noise(section), None)
        self._jitter = self.renderer.scenes.sequence_jitter(stream(self.scenario.seed, "jitter", 0), section.start_s)
        self.measurements: list[Measurement] = []
        self.latest: Measurement | None = None
        self.frame: TrackedFrame | None = None
        self._pending: deque[_Delivery] = deque()
        self._next_ns, self._frames = CurrentSimNanos, 0

    def UpdateState(self, CurrentSimNanos: int) -> None:
        """Take a frame if it is time, and write the messages of those that are ready."""
        if CurrentSimNanos >= self._next_ns:
            self._next_ns += self._step_ns * (1 + (CurrentSimNanos - self._next_ns) // self._step_ns)
            measured = self._measure(CurrentSimNanos)
            self.measurements.append(measured)
            self._pending.append(_Delivery(CurrentSimNanos + self._delay_ns, measured))
        while self._pending and self._pending[0].due_ns <= CurrentSimNanos:
            self.latest = self._pending.popleft().measured
            if self.latest.solution.attitude is not None:
                self._write_sensor(self.latest, CurrentSimNanos)
        if self.latest is not None and self.latest.attitude is not None:
            self._write_navigation(self.latest, CurrentSimNanos)

    # ------------------------------------------------------------------ one frame
    def _measure(self, now_ns: int) -> Measurement:
        """Render and solve the frame with mid-exposure now."""
        since_s, camera, index = now_ns * _NANO, self.camera, self._frames
        self._frames += 1
        state = self._body_on_camera(since_s)
        rotation_rad = self.renderer.scenes.mounting_rotation_rad(state.t_s)
        jitter = None if self._jitter is None else self._jitter.shifted(since_s)
        moment = Moment(index, since_s, on_mounting(state, rotation_rad), rotation_rad, jitter)
        self.frame, session = camera.take(moment), camera.session
        filtered = session.filter_attitude, session.rate_rad_s, session.covariance
        return Measurement(since_s, self.frame.row, self.frame.solution, *filtered)

    def _body_on_camera(self, since_s: float) -> MotionState:
        """The camera on its nominal mounting, by the message of the spacecraft's state."""
        t_s, state = self.scenario.sequence.start_s + since_s, self.scStateInMsg()
        if self._given is not None:
            to_icrs = self._inertial.inverse
            r_km, v_km_s = (np.array(x) * 1e-3 for x in (state.r_BN_N, state.v_BN_N))
            _refuse_inside(self._given.centre, r_km)
            self._given.update(t_s, to_icrs.apply(r_km), to_icrs.apply(v_km_s))
        body = attitude_of_mrp(state.sigma_BN) @ self._inertial
        return MotionState(t_s, self.mounting @ body, self.mounting.apply(state.omega_BN_B))

    def _write_sensor(self, measured: Measurement, now_ns: int) -> None:
        assert measured.solution.attitude is not None
        message = messaging.STSensorMsgPayload()
        message.qInrtl2Case = euler_parameters(measured.solution.attitude @ self._inertial.inverse)
        message.timeTag = round(measured.t_s / _NANO)
        self.sensorOutMsg.write(message, now_ns, self.moduleID)

    def _write_navigation(self, measured: Measurement, now_ns: int) -> None:
        assert measured.attitude is not None
        assert measured.rate_rad_s is not None
        turn = measured.rate_rad_s * (now_ns * _NANO - measured.t_s)
        camera = Attitude.from_rotation_vector(turn, "camera", "camera") @ measured.attitude
        message = messaging.NavAttMsgPayload()
        message.timeTag = now_ns * _NANO
        message.sigma_BN = mrp_of_attitude(self.mounting.inverse @ camera @ self._inertial.inverse)
        message.omega_BN_B = self.mounting.inverse.apply(measured.rate_rad_s)
        self.attOutMsg.write(message, now_ns, self.moduleID)


def _noise(section: SequenceSection) -> RateNoise:
    """Process noise of the filter; ``auto`` is that of a body under control."""
    walk, sigma_rad_s = section.rate_walk_deg_s_sqrt_s, math.radians(section.rate_sigma_deg_s)
    if walk == "auto":
        return RateNoise(rate_sigma_rad_s=sigma_rad_s)
    return RateNoise(math.radians(walk), sigma_rad_s)


def _refuse_inside(centre: str, r_km: FloatArray) -> None:
    """`InputError` for a position within the body at the centre."""
    distance_km, radius_km = math.hypot(*r_km.tolist()), RADIUS_KM.get(centre, 0.0)
    if distance_km < radius_km:
        raise InputError(
            f"the spacecraft is {distance_km:.0f} km from the centre of the {centre}, within its surface: set its "
            "position (r_CN_NInit), or give centre=None to use the scenario's orbit"
        )
