"""Thermo-elastic motion of the mounting: angle along the orbit, frames, sequences, errors of the body, datasheet."""

import math

import numpy as np
import pytest

from simulator.checks import load_scenario
from simulator.mission.thermo_elastic import angle_from_noon_rad
from simulator.renderer import Renderer
from simulator.study.datasheet.dependence import _mounting
from simulator.study.sequence.run import run_sequence
from simulator.study.trials.trial import TrialRunner, attitude_errors_deg
from startracker.geometry.attitude import Attitude

ARCSEC = math.pi / 648000.0
AMPLITUDE, PHASE = (30.0, -20.0, 50.0), (0.0, 40.0, 120.0)
MOVING = [
    f"pointing.thermo_elastic.amplitude_arcsec={list(AMPLITUDE)}",
    f"pointing.thermo_elastic.phase_deg={list(PHASE)}",
]
NODE = [*MOVING, "pointing.thermo_elastic.reference=node"]


def test_the_angle_is_zero_at_noon_and_half_a_turn_in_the_middle_of_the_eclipse():
    """Of an orbit by its instants: evenly along a circle, and sunlit symmetrically about noon."""
    renderer = Renderer(load_scenario("cubesat_ideal", ["orbit.ltan_h=12", "study.sampling=orbit"]))
    period_s = renderer.scenes.orbit.period_s
    times = np.linspace(0.0, period_s, 400, endpoint=False)
    renderer.scenes.plan(times)
    now = [renderer.scenes.instant_at(t) for t in times]
    suns = [n.sun_au - n.observer.position_au for n in now]
    angles = np.array([angle_from_noon_rad(n.r_km, n.v_km_s, s) for n, s in zip(now, suns, strict=True)])
    # one revolution; J2 speeds the argument of latitude up against the two-body period, and the Sun moves: 1e-3
    np.testing.assert_allclose(np.diff(np.unwrap(angles)), 2.0 * math.pi / 400, rtol=5e-3)
    nearest = np.argmax([n.r_km @ s / np.linalg.norm(s) for n, s in zip(now, suns, strict=True)])
    assert abs(angles[nearest]) < 2.0 * math.pi / 400
    dark = np.array([not n.sunlit for n in now])
    assert 100 < dark.sum() < 160
    middle = np.angle(np.mean(np.exp(1j * angles[dark])))
    assert abs(abs(middle) - math.pi) < 2.0 * math.pi / 400


def test_the_camera_rotates_and_the_body_does_not():
    """θ = A cos(u − φ) about the camera's axes; the spacecraft does not know of it."""
    still, moved = Renderer(load_scenario("cubesat_ideal")), Renderer(load_scenario("cubesat_ideal", NODE))
    for index in range(3):
        before, after = still.scene(index).pointing, moved.scene(index).pointing
        u = math.radians(moved.scenes.instant(index).orbit_argument_deg)
        expected = np.array(AMPLITUDE) * np.cos(u - np.radians(PHASE))
        np.testing.assert_allclose(before.camera.rotation_vector_to(after.camera) / ARCSEC, expected, atol=1e-8)
        np.testing.assert_allclose(after.mounting_rotation_rad / ARCSEC, expected, atol=1e-9)
        np.testing.assert_array_equal(after.body.quat, before.body.quat)
        np.testing.assert_array_equal(after.prior.quat, before.prior.quat)
        np.testing.assert_allclose((after.mounting @ after.body).quat, after.camera.quat, atol=1e-15)
        assert before.mounting_rotation_rad is None
    frame, truth = moved.frame(0)
    np.testing.assert_allclose(truth.mounting.quat, moved.scene(0).pointing.mounting.quat, atol=0)
    assert (frame.image != still.frame(0)[0].image).any()


def test_errors_of_the_body_contain_it_and_those_of_the_camera_do_not():
    """With a perfect estimate of the camera the body is wrong by the rotation, in body axes: opposite to a camera that
    is thought to be where it is not; to second order, 50″ squared."""
    scene = Renderer(load_scenario("cubesat_ideal", NODE)).scene(1).pointing
    errors = attitude_errors_deg(scene.camera, scene.camera, scene.mounting, scene.mounting_rotation_rad)
    nominal = Attitude.from_rotation_vector(scene.mounting_rotation_rad, "camera", "camera").inverse @ scene.mounting
    estimate = nominal.inverse @ scene.camera
    expected = np.degrees(scene.body.rotation_vector_to(estimate))
    np.testing.assert_allclose([errors[a] for a in ("roll", "pitch", "yaw")], expected, atol=1e-12)
    assert max(abs(errors[a]) for a in ("cross_x", "cross_y", "about_boresight")) < 1e-12
    assert np.linalg.norm(expected) == pytest.approx(math.degrees(np.linalg.norm(scene.mounting_rotation_rad)))


def test_columns_of_trials_and_sequences():
    small = ["sequence.frames=3", "sequence.step_s=600", "pointing.error_deg=0", "sequence.gyro.use=true"]
    moved, still = (
        TrialRunner(load_scenario("cubesat_ideal", MOVING)).run(0),
        TrialRunner(load_scenario("cubesat_ideal")).run(0),
    )
    theta_deg = np.array([moved[f"mounting_{axis}_deg"] for axis in "xyz"])
    assert np.abs(theta_deg).max() > 1e-3
    assert not any(name.startswith("mounting_") for name in still)
    camera = np.array([moved[f"error_{a}_deg"] for a in ("cross_x", "cross_y", "about_boresight")])
    body = np.array([moved[f"error_{a}_deg"] for a in ("roll", "pitch", "yaw")])
    assert np.linalg.norm(body) == pytest.approx(np.linalg.norm(camera + theta_deg), rel=1e-3)
    sequence = run_sequence(load_scenario("cubesat_ideal", [*small, *MOVING]))
    plain = run_sequence(load_scenario("cubesat_ideal", small))
    columns, without = sequence.columns, plain.columns
    for k in range(3):
        turn, before = (Attitude(np.array([c[f"true_q{x}"][k] for x in "xyzw"])) for c in (columns, without))
        theta = np.radians([columns[f"mounting_{axis}_deg"][k] for axis in "xyz"])
        np.testing.assert_allclose(before.rotation_vector_to(turn), theta, atol=1e-14)
    # six hundred seconds are a tenth of an orbit
    assert np.ptp(columns["mounting_z_deg"]) > 1e-3
    assert "mounting_x_deg" not in without


def test_the_datasheet_states_the_amplitudes():
    assert _mounting(load_scenario("cubesat_ideal")) == []
    found = _mounting(load_scenario("cubesat_ideal", MOVING))
    for quantity, amplitude in zip(found, AMPLITUDE, strict=True):
        assert quantity.estimate.plain()[0] == pytest.approx(abs(amplitude) / math.sqrt(2.0))
        assert quantity.unit == "arcsec"
