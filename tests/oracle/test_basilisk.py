"""The module for Basilisk: its conventions against Basilisk's own star tracker and kinematics, Skyfield and ERFA."""

import erfa
import numpy as np
import pytest
from scipy.stats import chi2
from skyfield.framelib import ICRS_to_J2000

pytest.importorskip("Basilisk", reason="needs the package bsk (extra basilisk)")

from Basilisk.architecture import messaging
from Basilisk.fswAlgorithms import stComm
from Basilisk.simulation import simpleNav, spacecraft, starTracker
from Basilisk.utilities import RigidBodyKinematics as rbk
from Basilisk.utilities import SimulationBaseClass, macros

from simulator.build import build_orbit
from simulator.live.basilisk import CameraStarTracker
from simulator.live.mrp import attitude_of_mrp, euler_parameters, mrp_of_attitude
from simulator.scenario import Scenario
from startracker import Attitude
from startracker.core import ARCSEC_RAD
from startracker.errors import InputError

MOUNTING = Attitude.from_rotation_vector([0.3, -1.1, 0.4], "body", "camera")
SCENARIO = Scenario.load("scenarios/cubesat_ideal.yaml").changed(
    {
        "detector.width": 512,
        "detector.height": 512,
        "detector.pixel_pitch_um": 11,
        "pointing.mounting": MOUNTING.quat.tolist(),
        "sequence.step_s": 0.5,
    }
)
RNG = np.random.default_rng(5)
AWAY = Attitude.from_radec_roll(200.0, 12.0, 35.0)
"""A camera that sees no Earth from `R_M`."""
R_KM, V_KM_S = build_orbit(SCENARIO).state(np.array(0.0))
OMEGA = (2e-4, -3e-4, 1e-3)
CHANCE = 1e-6


class Flight:
    """A free spacecraft with our tracker and Basilisk's, all in one task."""

    def __init__(self, camera=AWAY, task_s=0.5, r_km=R_KM, scenario=SCENARIO, **settings):
        self.simulation = SimulationBaseClass.SimBaseClass()
        process = self.simulation.CreateNewProcess("p")
        process.addTask(self.simulation.CreateNewTask("t", macros.sec2nano(task_s)))
        self.body = spacecraft.Spacecraft()
        self.body.hub.IHubPntBc_B = np.eye(3).tolist()
        self.body.hub.r_CN_NInit, self.body.hub.v_CN_NInit = (r_km * 1e3).tolist(), (V_KM_S * 1e3).tolist()
        self.body.hub.sigma_BNInit = mrp_of_attitude(MOUNTING.inverse @ camera).tolist()
        self.body.hub.omega_BN_BInit = list(OMEGA)
        self.ours = CameraStarTracker(scenario, **settings)
        self.theirs = starTracker.StarTracker()
        self.theirs.dcm_CB = MOUNTING.as_matrix().tolist()
        self.truth = simpleNav.SimpleNav()
        for model in (self.ours, self.theirs, self.truth):
            model.scStateInMsg.subscribeTo(self.body.scStateOutMsg)
        self.reader = stComm.stComm()
        self.reader.stSensorInMsg.subscribeTo(self.ours.sensorOutMsg)
        self.reader.dcm_BP = MOUNTING.inverse.as_matrix().ravel().tolist()
        for model in (self.body, self.ours, self.theirs, self.truth, self.reader):
            self.simulation.AddModelToTask("t", model)

    def run(self, seconds):
        self.simulation.InitializeSimulation()
        self.simulation.ConfigureStopTime(macros.sec2nano(seconds))
        self.simulation.ExecuteSimulation()
        return self


@pytest.fixture(scope="module")
def flown():
    """Three frames, the last one delivered."""
    return Flight().run(1.5)


@pytest.fixture(scope="module")
def at_frame():
    """The same flight at mid-exposure of that frame."""
    return Flight().run(1.0)


def matrix_error_rad(estimate, truth):
    """Rotation vector (3,) of `estimate truthᵀ`, coordinate transformations; small angles."""
    turn = estimate @ truth.T
    return 0.5 * np.array([turn[1, 2] - turn[2, 1], turn[2, 0] - turn[0, 2], turn[0, 1] - turn[1, 0]])


def test_parameters_are_those_of_its_kinematics():
    for _ in range(50):
        attitude = Attitude(RNG.standard_normal(4), "inertial", "body")
        sigma = mrp_of_attitude(attitude)
        np.testing.assert_allclose(rbk.MRP2C(sigma), attitude.as_matrix(), atol=2e-15)
        np.testing.assert_allclose(rbk.C2MRP(attitude.as_matrix()), sigma, atol=2e-15)
        np.testing.assert_allclose(rbk.EP2C(euler_parameters(attitude)), attitude.as_matrix(), atol=2e-15)
        assert attitude_of_mrp(sigma).angle_to(attitude) < 1e-15 * 4


def test_sensor_message_agrees_with_its_star_tracker(flown, at_frame):
    """Without noise theirs is the truth at the time of the message; ours, at its time tag, errs as it states."""
    message, now = flown.ours.sensorOutMsg.read(), flown.theirs.sensorOutMsg.read()
    assert (message.timeTag, now.timeTag) == (1_000_000_000, 1_500_000_000)
    earlier = at_frame.theirs.sensorOutMsg.read()
    error = matrix_error_rad(rbk.EP2C(message.qInrtl2Case), rbk.EP2C(earlier.qInrtl2Case))
    latest = flown.ours.latest
    np.testing.assert_allclose(error, latest.error_rad, atol=1e-12)
    assert error @ np.linalg.solve(latest.covariance[:3, :3], error) < chi2.isf(CHANCE, 3)
    assert np.linalg.norm(error) < 60.0 * ARCSEC_RAD


def test_its_flight_software_reads_the_message(flown, at_frame):
    """Basilisk's stComm turns the camera's message into the attitude of the body."""
    told = rbk.MRP2C(flown.reader.stAttOutMsg.read().MRP_BdyInrtl)
    earlier = rbk.MRP2C(at_frame.truth.attOutMsg.read().sigma_BN)
    error = MOUNTING.apply(matrix_error_rad(told, earlier))
    np.testing.assert_allclose(error, flown.ours.latest.error_rad, atol=1e-12)


def test_navigation_message_is_propagated_to_now(flown):
    """Attitude half a second after the frame, and rate, against Basilisk's ideal navigation, by the covariance."""
    message, truth, latest = flown.ours.attOutMsg.read(), flown.truth.attOutMsg.read(), flown.ours.latest
    assert message.timeTag == truth.timeTag == 1.5
    attitude = MOUNTING.apply(matrix_error_rad(rbk.MRP2C(message.sigma_BN), rbk.MRP2C(truth.sigma_BN)))
    rate = MOUNTING.apply(np.array(message.omega_BN_B) - truth.omega_BN_B)
    step = np.block([[np.eye(3), 0.5 * np.eye(3)], [np.zeros((3, 3)), np.eye(3)]])
    covariance = step @ latest.covariance @ step.T
    error = np.concatenate([attitude, rate])
    assert error @ np.linalg.solve(covariance, error) < chi2.isf(CHANCE, 6)
    assert np.linalg.norm(rate) < 0.1 * np.linalg.norm(OMEGA)


def test_frames_of_axes():
    """ICRF needs no rotation; with N the mean equator of 2000 the camera is rotated by Skyfield's frame bias."""
    for inertial, turn in (("icrf", np.eye(3)), ("eme2000", ICRS_to_J2000)):
        flight = Flight(inertial=inertial).run(0.0)
        sigma = flight.body.scStateOutMsg.read().sigma_BN
        expected = MOUNTING.as_matrix() @ rbk.MRP2C(sigma) @ turn
        truth = flight.ours.frame.truth
        assert np.abs(truth.attitude.as_matrix() - expected).max() < 1e-9 * 0.5  # 0.1 mas
        moved = np.linalg.norm(matrix_error_rad(truth.attitude.as_matrix(), AWAY.as_matrix()))
        assert moved == pytest.approx(0.0231 * ARCSEC_RAD if inertial == "eme2000" else 0.0, abs=1e-4 * ARCSEC_RAD)


def test_back_in_its_axes_the_bias_is_gone():
    """The message is in Basilisk's axes again: between both choices it differs by the errors of the tracker alone."""
    flight = Flight(inertial="eme2000").run(0.5)
    message, latest = flight.ours.sensorOutMsg.read(), flight.ours.latest
    truth = MOUNTING.as_matrix() @ rbk.MRP2C(mrp_of_attitude(MOUNTING.inverse @ AWAY))
    np.testing.assert_allclose(matrix_error_rad(rbk.EP2C(message.qInrtl2Case), truth), latest.error_rad, atol=1e-12)


@pytest.mark.parametrize("inertial", ["icrf", "ecliptic"])
def test_aberration_is_that_of_its_velocity(inertial):
    """Barycentric velocity: ERFA's of the Earth (epv00: 5 mm/s) plus Basilisk's in our axes."""
    flight = Flight(inertial=inertial).run(0.0)
    frame = flight.ours.frame.frame
    _, earth = erfa.epv00(2_461_121.0, 0.000_800_740_7)  # 2026-03-21T12:00:00 UTC in TT
    au_day = 149_597_870.7 / 86_400.0
    obliquity = np.radians(84_381.448 / 3600.0)
    turn = np.array([[1, 0, 0], [0, np.cos(obliquity), -np.sin(obliquity)], [0, np.sin(obliquity), np.cos(obliquity)]])
    own = V_KM_S if inertial == "icrf" else turn @ V_KM_S
    np.testing.assert_allclose(frame.observer.velocity_km_s, earth["v"] * au_day + own, atol=2e-5)
    place = earth["p"] * 149_597_870.7 + (R_KM if inertial == "icrf" else turn @ R_KM)
    np.testing.assert_allclose(frame.observer.position_au * 149_597_870.7, place, atol=15.0)  # epv00: 4.6 km an axis
    # a wrong velocity of the orbit alone would move the stars by 5″


def test_the_earth_is_where_its_position_says():
    """Towards the Earth's centre there is no star: status and reason, and no message; on the other side there is."""
    nadir = Attitude.from_radec_roll(*np.degrees(_radec(-R_KM)))
    flight = Flight(nadir).run(1.0)
    latest = flight.ours.latest
    assert latest.solution.attitude is None
    assert latest.attitude is None
    assert latest.solution.reason
    assert "Earth" in latest.row["excluded"] or latest.row["stars_in_field"] == 0
    for reader, message in (
        (messaging.STSensorMsgReader(), flight.ours.sensorOutMsg),
        (messaging.NavAttMsgReader(), flight.ours.attOutMsg),
    ):
        reader.subscribeTo(message)
        assert not reader.isWritten()
    assert Flight(nadir, r_km=-R_KM).run(0.5).ours.latest.solution.solved


def _radec(vector):
    x, y, z = vector / np.linalg.norm(vector)
    return np.arctan2(y, x), np.arcsin(z)


def test_latency():
    """A frame at 0 s, exposed for 0.2 s, with 0.35 s to process: ready at 0.45 s, in the task of 0.1 s at 0.5 s."""
    flight = Flight(task_s=0.1, latency_s=0.35)
    recorder = flight.ours.sensorOutMsg.recorder()
    flight.simulation.AddModelToTask("t", recorder)
    flight.run(1.2)
    written = {int(at): int(tag) for at, tag in zip(recorder.timesWritten(), recorder.timeTag, strict=True) if at}
    assert written == {500_000_000: 0, 1_000_000_000: 500_000_000}
    assert [m.t_s for m in flight.ours.measurements] == [0.0, 0.5, 1.0]
    assert flight.ours.attOutMsg.read().timeTag == pytest.approx(1.2, abs=1e-12)


def test_same_seed_same_messages(flown):
    again = Flight().run(1.5)
    assert list(again.ours.sensorOutMsg.read().qInrtl2Case) == list(flown.ours.sensorOutMsg.read().qInrtl2Case)
    np.testing.assert_array_equal(again.ours.frame.frame.image, flown.ours.frame.frame.image)
    flown_again = again.run(1.5)  # Basilisk resets its modules
    assert list(flown_again.ours.sensorOutMsg.read().qInrtl2Case) == list(flown.ours.sensorOutMsg.read().qInrtl2Case)


def test_measurements_may_be_cleared(flown):
    """The noise of a frame is that of its number, not of the length of the list."""
    flight = Flight().run(0.5)
    flight.ours.measurements.clear()
    flight.simulation.ConfigureStopTime(macros.sec2nano(1.5))
    flight.simulation.ExecuteSimulation()
    assert len(flight.ours.measurements) == 2
    np.testing.assert_array_equal(flight.ours.frame.frame.image, flown.ours.frame.frame.image)


def test_gravity_free_bodies_use_the_orbit_of_the_scenario():
    flight = Flight(r_km=np.zeros(3), centre=None).run(0.0)
    np.testing.assert_allclose(
        flight.ours.frame.frame.observer.position_au,
        Flight().run(0.0).ours.frame.frame.observer.position_au,
        rtol=1e-12,
    )


def test_mistakes():
    with pytest.raises(InputError, match="unknown inertial frame 'J2000'; choose one of icrf, eme2000"):
        CameraStarTracker(SCENARIO, inertial="J2000")
    with pytest.raises(InputError, match="latency"):
        CameraStarTracker(SCENARIO, latency_s=-1.0)
    with pytest.raises(InputError, match="scStateInMsg is not linked"):
        CameraStarTracker(SCENARIO).Reset(0)
    inside = CameraStarTracker(SCENARIO)
    state = messaging.SCStatesMsg().write(messaging.SCStatesMsgPayload(r_BN_N=[1e6, 0.0, 0.0]))
    inside.scStateInMsg.subscribeTo(state)
    inside.Reset(0)
    with pytest.raises(InputError, match="1000 km from the centre of the Earth, within its surface"):
        inside.UpdateState(0)
