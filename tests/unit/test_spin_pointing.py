"""A spinning body through the stages: pointing of a trial, states of a sequence, sampling over a turn, coverage."""

import math
from dataclasses import replace

import numpy as np
import pytest

from simulator.mission.motion import motion
from simulator.mission.orbit import build_orbit
from simulator.mission.pointing import mounting_of, point, point_at_random, point_by, point_spinning, round_s
from simulator.mission.spin import spin_attitude
from simulator.renderer import render
from simulator.scenario import Scenario
from simulator.study.coverage.boresights import along_path
from simulator.study.coverage.sensitivity import nominal_rate_rad_s


@pytest.fixture(scope="module")
def scenario():
    return Scenario.load("oedipus", ["pointing.offset_deg=[3, -2, 1]", "pointing.error_deg=2"])


def test_rate_is_how_the_camera_turns(scenario):
    h = 1e-3
    before, at, after = (
        point_spinning(scenario.pointing, t, np.random.default_rng(1)) for t in (5.0 - h, 5.0, 5.0 + h)
    )
    turned = before.camera.rotation_vector_to(after.camera) / (2.0 * h)
    # central difference: ω‴ h² / 6 is below 1e-7 of ω at 0.5 rad/s
    np.testing.assert_allclose(at.rate_camera_rad_s, turned, atol=1e-7)
    assert np.degrees(np.linalg.norm(at.rate_camera_rad_s)) == pytest.approx(28.8, rel=2e-3)


def test_offset_and_error_are_turns_of_the_body(scenario):
    spinning = point_spinning(scenario.pointing, 5.0, np.random.default_rng(1))
    bare = mounting_of(scenario.pointing).as_matrix() @ spin_attitude(scenario.pointing.spin, 5.0).as_matrix()
    error = spinning.camera.rotation_vector_to(spinning.prior)
    assert 0.0 < np.degrees(np.abs(error).max()) <= 2.0 * np.sqrt(3.0)
    offset = spinning.prior.as_matrix() @ bare.T
    angle = np.degrees(np.arccos((np.trace(offset) - 1.0) / 2.0))
    assert angle == pytest.approx(np.sqrt(3.0**2 + 2.0**2 + 1.0), abs=1e-9)


def test_a_sequence_follows_the_same_spin(scenario):
    orbit = build_orbit(scenario.orbit, scenario.epoch)
    start = point_spinning(scenario.pointing, 0.0, np.random.default_rng(1))
    for state in motion(
        scenario.pointing, scenario.sequence, orbit, start, [k * scenario.sequence.step_s for k in range(4)]
    ):
        alone = point_spinning(scenario.pointing, state.t_s, np.random.default_rng(1))  # the same random error
        np.testing.assert_allclose(state.camera.as_matrix(), alone.camera.as_matrix(), atol=1e-12)
        np.testing.assert_allclose(state.rate_camera_rad_s, alone.rate_camera_rad_s, atol=1e-12)


def test_trials_are_spread_over_a_turn(scenario):
    assert round_s(scenario.pointing, 6000.0) == pytest.approx(12.5)
    still = replace(scenario.pointing, spin=type(scenario.pointing.spin)())
    assert round_s(still, 6000.0) == 6000.0
    plain = Scenario.load("oedipus")
    path = along_path(plain, 12)
    assert path.t_s.min() >= 0.0
    assert path.t_s.max() < 12.5
    for k in (0, 7):
        expected = point_spinning(plain.pointing, float(path.t_s[k]), np.random.default_rng(1)).prior.as_matrix()
        np.testing.assert_allclose(path.matrices[k], expected, atol=1e-12)
    _, truth = render(plain, 7)
    np.testing.assert_allclose(truth.attitude.as_matrix(), path.matrices[7], atol=1e-12)


def test_nominal_rate_is_the_spin():
    plain = Scenario.load("oedipus")
    expected = point_spinning(plain.pointing, 0.0, np.random.default_rng(1)).rate_camera_rad_s
    np.testing.assert_allclose(nominal_rate_rad_s(plain), expected, atol=1e-12)


@pytest.mark.parametrize("law", ["spin", "level", "random", "given"])
def test_errors_of_the_pointing_are_symmetric(scenario, law):
    """Uniform within ±2° about each axis and independent: the mean of 300 is within 4 × 2°/√3/√300 = 0.27° of zero, and
    both signs are found on every axis."""
    r_km, v_km_s = np.array([7178.0, 0.0, 0.0]), np.array([0.0, 7.45, 0.0])

    class Still:
        """An attitude law: the body at rest along the axes of the sky."""

        span_s = (-math.inf, math.inf)

        def quaternions(self, t_s):
            return np.tile([0.0, 0.0, 0.0, 1.0], (len(t_s), 1))

    drawn = {
        "spin": lambda rng: point_spinning(scenario.pointing, 5.0, rng),
        "level": lambda rng: point(scenario.pointing, r_km, v_km_s, rng),
        "random": lambda rng: point_at_random(scenario.pointing, rng),
        "given": lambda rng: point_by(scenario.pointing, Still(), 5.0, rng),
    }[law]
    found = [drawn(np.random.default_rng(seed)) for seed in range(300)]
    body = mounting_of(scenario.pointing).inverse.as_matrix()
    errors = np.degrees([body @ one.camera.rotation_vector_to(one.prior) for one in found])
    assert np.abs(errors.mean(axis=0)).max() < 0.27
    assert (errors.min(axis=0) < -1.0).all()
    assert (errors.max(axis=0) > 1.0).all()
