"""True attitudes of a sequence against SciPy's `Rotation`, small step by small step.

Oracle: scipy.spatial.transform.Rotation (SciPy 1.17), the turn multiplied up from 22,000 tiny rotations with the rate
at the middle of each, whose error of second order, h² T (ω × ω')/24, is 1e-10 rad in all; what the corners of the rate
add is told where it is compared. The local level is set up here from position and velocity. A slew ends at its
rotation vector, exactly.
"""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from simulator import Scenario
from simulator.mission.clock import Clock
from simulator.mission.motion import RateProfile, motion, rate_profile
from simulator.mission.orbit import build_orbit
from simulator.mission.pointing import hold, point
from simulator.randomness import stream
from startracker.geometry.attitude import Attitude

RATES = (
    "sequence.rates=[{at_s: 1, roll_deg_s: 0.5}, {at_s: 4, roll_deg_s: -1, pitch_deg_s: 2, yaw_deg_s: 0.3}, "
    "{at_s: 6.3, yaw_deg_s: 4}]"
)


def states_of(overrides, target=None):
    scenario = Scenario.load("cubesat_ideal", overrides=["sequence.step_s=0.7", *overrides])
    orbit = build_orbit(scenario.orbit, scenario.epoch)
    rng = stream(scenario.seed, "pointing", 0)
    if target is not None:
        start = hold(scenario.pointing, Attitude.from_radec_roll(*target), rng)
    else:
        start = point(scenario.pointing, *orbit.state(scenario.sequence.start_s), rng)
    since_s = [k * scenario.sequence.step_s for k in range(scenario.sequence.frames)]
    states = motion(scenario.pointing, scenario.sequence, orbit, start, since_s)
    return scenario, orbit, start, states


def rotation_error(attitude, rotation):
    return float((Rotation.from_matrix(attitude.as_matrix()) * rotation.inv()).magnitude())


def level(orbit, t_s):
    r, v = orbit.state(t_s)
    z = -r / np.linalg.norm(r)
    y = -np.cross(r, v) / np.linalg.norm(np.cross(r, v))
    return Rotation.from_matrix(np.stack([np.cross(y, z), y, z]))


def test_path_against_small_rotations():
    _, orbit, start, states = states_of(["sequence.frames=12", "pointing.rate_deg_s=[0.1, -0.2, 0.3]", RATES])
    steps = 22_000  # 2,000 a frame
    end = 11 * 0.7
    middles = (np.arange(steps) + 0.5) * end / steps
    corners = [1.0, 4.0, 6.3]
    table = np.array([[0.5, 0, 0], [-1, 2, 0.3], [0, 0, 4]])
    profile = np.stack([np.interp(middles, corners, c) for c in table.T], axis=1)
    rate = np.radians(profile + np.array([0.1, -0.2, 0.3]))
    small = Rotation.from_rotvec(-rate * end / steps)
    at_start = Rotation.from_matrix(start.body.as_matrix()) * level(orbit, 0.0).inv()
    mounting = Rotation.from_matrix(start.mounting.as_matrix())
    for k in (0, 3, 7, 11):
        turned = Rotation.identity()
        for part in range(round(k * 0.7 / end * steps)):
            turned = small[part] * turned
        expected = mounting * turned * at_start * level(orbit, k * 0.7)
        # a corner of the rate within a step of h = 0.35 ms costs h²/8 times the change of slope, 0.08 rad/s²: 1e-9 rad
        assert rotation_error(states[k].camera, expected) < 3e-9


@pytest.mark.parametrize("start_s", [0.0, 12.0])
def test_a_turn_of_a_changing_axis_against_an_integration(start_s):
    """30°/s about x that becomes 40°/s about y and then stands still, over seven half turns: dS/dt = −[ω×] S by SciPy's
    DOP853 to 1e-12."""
    t_s = np.array([0.0, 20.0, 40.0, 45.0])
    rates = np.radians([[30.0, 0.0, 5.0], [0.0, 40.0, 0.0], [10.0, 0.0, -20.0], [0.0, 0.0, 0.0]])
    profile = RateProfile(t_s, rates)

    def slope(t, matrix):
        x, y, z = profile.at(t)
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        return (-cross @ matrix.reshape(3, 3)).ravel()

    expected = np.eye(3).ravel()
    corners = [start_s, *t_s[t_s > start_s]]
    for low, high in pairwise(corners):
        expected = solve_ivp(slope, (low, high), expected, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    found = profile.turn(start_s, 45.0).as_matrix()
    assert found == pytest.approx(expected.reshape(3, 3), abs=3e-9)


@pytest.mark.parametrize("target", [None, (80.0, 5.0, 30.0)])
def test_rate_is_the_path_s_derivative(target):
    """Central differences over 2 × 1 ms: rounding 1e-16/1e-3, and ω'' h²/6, both below 1e-11 rad/s."""
    extra = ["sequence.frames=3", "pointing.rate_deg_s=[0.1, -0.2, 0.3]", RATES]
    if target is not None:
        extra.append(f"pointing.target={list(target)}")
    *_, here = states_of(["sequence.start_s=100", *extra], target)
    # the same motion on a finer grid: frames 1 ms apart around the second frame at 0.7 s
    _, _, _, fine = states_of(["sequence.start_s=100", *extra, "sequence.step_s=0.001", "sequence.frames=702"], target)
    difference = fine[699].camera.rotation_vector_to(fine[701].camera) / 2e-3
    assert np.allclose(difference, here[1].rate_camera_rad_s, rtol=0, atol=1e-10)
    assert fine[700].camera.angle_to(here[1].camera) < 1e-12


@pytest.mark.parametrize(
    ("turn", "top", "seconds"), [([0, 0, 50], 2.0, 35.0), ([3, -4, 12], 20.0, 2 * (13 / 0.2) ** 0.5)]
)
def test_slew_ends_where_it_should(turn, top, seconds):
    """A trapezoid: turn/top + top/acceleration seconds; a triangle, which does not reach its top: 2 √(turn/a)."""
    scenario, _, start, states = states_of(
        [
            "pointing.target=[80, 5, 30]",
            "sequence.step_s=1",
            "sequence.frames=50",
            f"sequence.slew.turn_deg={turn}",
            f"sequence.slew.max_rate_deg_s={top}",
            "sequence.slew.start_s=4",
        ],
        (80.0, 5.0, 30.0),
    )
    profile = rate_profile(scenario.pointing, scenario.sequence)
    assert profile.t_s[-1] - 4.0 == pytest.approx(seconds, rel=1e-12)
    moved = start.mounting.inverse @ states[-1].camera @ (start.mounting.inverse @ states[0].camera).inverse
    assert np.allclose(Rotation.from_matrix(moved.as_matrix()).as_rotvec(), -np.radians(turn), atol=1e-12)
    assert np.linalg.norm(states[-1].rate_camera_rad_s) == 0.0
    speeds = [np.degrees(np.linalg.norm(s.rate_camera_rad_s)) for s in states]
    assert max(speeds) <= min(top, (np.linalg.norm(turn) * 0.2) ** 0.5) * (1 + 1e-12)


def test_level_turns_with_the_orbit():
    """(0, −n, 0) to the precession of the plane, 360° a year: 2e-7 rad/s."""
    scenario, orbit, start, states = states_of(["sequence.frames=1", "pointing.error_deg=0"])
    n = 2 * np.pi / orbit.period_s
    body = start.mounting.inverse.apply(states[0].rate_camera_rad_s)
    assert np.allclose(body, [0, -n, 0], atol=1.2e-6)  # the nodal period differs from the anomalistic by J2, 1e-3 n
    assert Clock(scenario.epoch).isot(0.0).startswith("2026-03-21T12:00")
