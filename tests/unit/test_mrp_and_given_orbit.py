"""Basilisk's attitude parameters against SciPy, and a trajectory that is given state by state."""

import math
from datetime import UTC, datetime
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from simulator.live.mrp import attitude_of_mrp, euler_parameters, mrp_of_attitude
from simulator.mission.clock import Clock
from simulator.mission.elliptic import EllipticOrbit
from simulator.mission.given import GivenTrajectory
from simulator.mission.kepler import Elements
from simulator.mission.tabulated import RESOLUTION_S, Segment, TabulatedTrajectory
from simulator.mission.trajectory import GM_KM3_S2
from simulator.renderer import Renderer
from simulator.scenario import Scenario
from startracker.errors import InputError

RNG = np.random.default_rng(20)
ROTATIONS = Rotation.random(50, rng=RNG)


def test_parameters_are_those_of_scipy_for_the_opposite_rotation():
    """SciPy's parameters are those of the rotation of vectors; Basilisk's, of the frame: the sign is the other."""
    for rotation in ROTATIONS:
        attitude = attitude_of_mrp(-rotation.as_mrp())
        np.testing.assert_allclose(attitude.as_matrix(), rotation.as_matrix(), atol=4e-16 * 4)
        x, y, z, w = rotation.inv().as_quat(canonical=True)
        np.testing.assert_allclose(euler_parameters(attitude), [w, x, y, z], atol=1e-15)
        assert np.linalg.norm(mrp_of_attitude(attitude)) <= 1.0


def test_both_sets_are_the_same_attitude():
    for rotation in ROTATIONS:
        sigma = -rotation.as_mrp()
        shadow = -sigma / (sigma @ sigma)  # Schaub & Junkins, section 3.5
        assert attitude_of_mrp(sigma).angle_to(attitude_of_mrp(shadow)) < 1e-14
        np.testing.assert_allclose(mrp_of_attitude(attitude_of_mrp(shadow)), sigma, atol=1e-14)


@pytest.mark.parametrize("sigma", [[0.0, 0.0], [0.0, np.nan, 0.0], [np.inf, 0.0, 0.0]])
def test_parameters_that_are_none(sigma):
    with pytest.raises(InputError, match="three finite numbers"):
        attitude_of_mrp(sigma)


# ------------------------------------------------------------------ the trajectory
CUBESAT = Scenario.load("scenarios/cubesat_ideal.yaml")
CLOCK = Clock(CUBESAT.epoch)


def test_extrapolation_of_a_state_is_that_of_kepler():
    """The neglected jerk is n² v at most: its integrals n² v τ²/2 and n² v τ³/6 bound the errors."""
    orbit = EllipticOrbit(Elements(7178.0, 0.01, 1.7, 0.4, 0.3, 1.0), CLOCK, "Earth", "icrf", j2=False)
    given = GivenTrajectory(CLOCK)
    given.update(100.0, *orbit.state(100.0))
    assert given.period_s == pytest.approx(orbit.period_s, rel=1e-9)
    for since_s in (-10.0, -1.0, 0.0, 0.1, 1.0, 10.0):
        r_km, v_km_s = orbit.state(100.0 + since_s)
        near_r, near_v = given.state(100.0 + since_s)
        jerk = 3.0 * 398_600.4 * np.linalg.norm(v_km_s) / np.linalg.norm(r_km) ** 3
        assert np.abs(near_r - r_km).max() <= jerk * abs(since_s) ** 3 / 6.0 + 1e-9
        assert np.abs(near_v - v_km_s).max() <= jerk * since_s**2 / 2.0 + 1e-12
    many, _ = given.state(np.array([99.0, 100.0, 101.0]))
    np.testing.assert_array_equal(many[2], given.state(101.0)[0])


def test_what_is_no_state():
    given = GivenTrajectory(CLOCK)
    with pytest.raises(InputError, match="no position"):
        given.state(0.0)
    for r_km, v_km_s in (([0.0, 0.0, 0.0], [1.0, 0.0, 0.0]), ([np.nan, 0, 0], [1, 0, 0]), ([7e3, 0], [1, 0, 0])):
        with pytest.raises(InputError, match="not a state of a spacecraft"):
            given.update(0.0, r_km, v_km_s)
    assert given.period_s == math.inf
    given.update(0.0, [7e3, 0.0, 0.0], [0.0, 7.5, 0.0])
    osculating_km = 1.0 / (2.0 / 7e3 - 7.5**2 / GM_KM3_S2["Earth"])  # on an axis: two coordinates are zero
    assert given.period_s == pytest.approx(math.tau * math.sqrt(osculating_km**3 / GM_KM3_S2["Earth"]), rel=1e-12)
    with pytest.raises(InputError, match="within 10 s"):
        given.state(10.1)
    with pytest.raises(InputError, match="unknown centre 'Vulcan'"):
        GivenTrajectory(CLOCK, "Vulcan")


def test_frames_of_a_given_trajectory_are_those_of_the_orbit_itself():
    """Same position and velocity, same frame, to the last digital number."""
    small = CUBESAT.changed({"detector.width": 128, "detector.height": 128})
    own = Renderer(small)
    orbit = own.scenes.orbit
    given = GivenTrajectory(orbit.clock)
    other = Renderer(small, trajectory=given)
    scene = own.scene(0, at_s=50.0)
    given.update(50.0, *orbit.state(50.0))
    known = {"at_s": 50.0, "attitude": scene.pointing.camera, "rate_camera_rad_s": [0.0, 0.0, 0.001]}
    frame, _ = own.frame(0, **known)
    again, _ = other.frame(0, **known)
    np.testing.assert_array_equal(again.image, frame.image)
    np.testing.assert_array_equal(again.observer.velocity_km_s, frame.observer.velocity_km_s)
    assert other.changed({"detector.read_noise_e": 5.0}).scenes.orbit is given
    assert other.changed({"sky.magnitude_limit": 6.0}).scenes.orbit is given


@pytest.mark.parametrize(
    ("first_s", "last_s", "at_s"), [(-50.0, 50.0, 0.0), (100.0, 200.0, 100.0), (-90.0, -20.0, -20.0)]
)
def test_the_period_of_a_table_is_that_at_the_epoch_or_at_its_nearest_end(first_s, last_s, at_s):
    """States on circles that grow with time: T = 2π √(a³/μ) at the epoch, or the end of the span next to it."""

    def radius_km(t_s):
        return 7000.0 + np.asarray(t_s)

    def state(t_s):
        r_km = radius_km(t_s)
        zero = np.zeros_like(r_km)
        return np.stack([r_km, zero, zero, zero, np.sqrt(GM_KM3_S2["Earth"] / r_km), zero], axis=1)

    clock = Clock(datetime(2026, 3, 21, tzinfo=UTC))
    segment = Segment(first_s, last_s, "Earth", "icrf", SimpleNamespace(state=state))
    orbit = TabulatedTrajectory.of([segment], clock, "states")
    assert orbit.span_s == (first_s - RESOLUTION_S, last_s + RESOLUTION_S)
    expected = 2.0 * math.pi * math.sqrt(radius_km(at_s) ** 3 / GM_KM3_S2["Earth"])
    assert orbit.period_s == pytest.approx(expected, rel=1e-6)
