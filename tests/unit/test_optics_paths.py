"""Paths of stars and moving sources during an exposure: how finely they are sampled, and where they go."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from simulator.optics.drift import Drift, drifting_paths, longest_drift_px
from simulator.optics.jitter import JitterPath
from simulator.optics.smear import (
    exposure_nodes,
    longest_path_px,
    path_limit_rad,
    rotation_matrices,
    star_paths,
    turning,
    wander_length_px,
)
from startracker.geometry.camera import Camera

PINHOLE = Camera(2000.0, 2000.0, 511.5, 511.5, 1024, 1024)
FISHEYE = Camera(300.0, 300.0, 511.5, 511.5, 1024, 1024, projection="equidistant")


@pytest.mark.parametrize("cycles", [0.5, 3.0, 20.0, 90.0])
@pytest.mark.parametrize("phase", [0.0, 1.0])
def test_jitter_is_sampled_at_every_cycle(cycles, phase):
    """Mean of cos(πcu + φ) and of its square over the exposure, exactly: sinc c cos φ and ½ (1 + sinc 2c cos 2φ). The
    mean position is good to 1e-4 of the amplitude; the square, which has twice as many cycles, to 1 % of its mean."""
    nodes, weights = exposure_nodes(1e-3, 0.5, cycles)
    wave = np.cos(np.pi * cycles * nodes + phase)
    assert weights @ wave == pytest.approx(np.sinc(cycles) * math.cos(phase), abs=1e-4)
    expected = 0.5 * (1.0 + np.sinc(2.0 * cycles) * math.cos(2.0 * phase))
    assert weights @ wave**2 == pytest.approx(expected, abs=5e-3)
    assert len(nodes) <= 4.0 * cycles + 3.0


def test_one_moment_is_enough_for_a_short_path_without_jitter():
    """A streak of a twenty-fifth of the finest structure, or a ten-thousandth with jitter."""
    assert [len(exposure_nodes(streak, 0.5)[0]) for streak in (0.019, 0.021, 0.5, 10.0)] == [1, 2, 3, 23]
    assert [len(exposure_nodes(streak, 0.5, 2.0)[0]) for streak in (4.9e-5, 5.1e-5, 0.019)] == [1, 9, 9]


def test_panels_of_a_very_long_path_are_one_quadrature():
    """Polynomials of low degree are integrated exactly, also across the ends of panels."""
    nodes, weights = exposure_nodes(2000.0, 0.5)
    assert len(nodes) > 4000
    assert np.diff(nodes).min() > 0.0
    assert (nodes[0] > -1.0, nodes[-1] < 1.0) == (True, True)
    for power in range(8):
        assert weights @ nodes**power == pytest.approx((1 + (-1) ** power) / 2 / (power + 1), abs=1e-12)


def oscillation(axis, frequency_hz=5.0, amplitude_rad=1e-4):
    amplitudes = np.zeros((1, 3))
    amplitudes[0, axis] = amplitude_rad
    return JitterPath(np.full((1, 3), frequency_hz), np.zeros((1, 3)), amplitudes, frequency_hz)


@pytest.mark.parametrize("camera", [PINHOLE, FISHEYE], ids=["pinhole", "fisheye"])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_length_of_a_path_of_jitter_is_that_at_twice_the_rms_rate_at_the_edge(camera, axis):
    """Speed of a star at the edge by a difference of projections: across the axis for x and y, around for z."""
    exposure_s, limit_rad = 0.3, path_limit_rad(camera, 64.0)
    rms_rad_s = 2.0 * np.pi * 5.0 * 1e-4 / math.sqrt(2.0)
    star = np.array([math.sin(limit_rad), 0.0, math.cos(limit_rad)])
    if axis == 0:
        star = star[[1, 0, 2]]
    step = np.zeros(3)
    step[axis] = 1e-6
    ends = camera.project(np.array([Rotation.from_rotvec(sign * step).apply(star) for sign in (-0.5, 0.5)]))
    speed = float(np.linalg.norm(ends[1] - ends[0])) / 1e-6
    found = wander_length_px(camera, oscillation(axis), exposure_s, limit_rad)
    expected = 2.0 * rms_rad_s * exposure_s * speed
    assert found == pytest.approx(expected, rel=1e-6)


def test_the_stretch_of_a_pinhole_ends_at_75_degrees():
    wide = wander_length_px(PINHOLE, oscillation(0), 0.3, math.radians(89.0))
    at_end = wander_length_px(PINHOLE, oscillation(0), 0.3, math.radians(75.0))
    below = wander_length_px(PINHOLE, oscillation(0), 0.3, math.radians(70.0))
    assert wide == at_end
    assert at_end / below == pytest.approx((math.cos(math.radians(70)) / math.cos(math.radians(75))) ** 2)


def test_paths_reach_to_the_corners_and_their_margin():
    """Half the diagonal and the margin, in angle; of a fisheye no more than its own limit."""
    corner = math.atan(512.0 * math.sqrt(2.0) / 2000.0)
    assert path_limit_rad(PINHOLE, 0.0) == pytest.approx(corner, abs=2.0 / 2000.0)
    assert path_limit_rad(PINHOLE, 50.0) - path_limit_rad(PINHOLE, 0.0) == pytest.approx(50.0 / 2000.0, rel=0.01)
    assert path_limit_rad(FISHEYE, 1e5) == FISHEYE.limit_rad


def test_the_longest_path_is_the_sum_of_its_chords():
    """A roll of 40° draws arcs: the longest is the radius times the angle, less θ²/24 of chords of 2.5°."""
    stars = PINHOLE.unproject(np.array([[611.5, 511.5], [511.5, 911.5], [500.0, 500.0]]))
    angle = math.radians(40.0)
    found = longest_path_px(PINHOLE, stars, np.array([0.0, 0.0, angle]), 1.0)
    assert found == pytest.approx(400.0 * angle, rel=1.5e-4)
    assert found < 400.0 * angle
    assert longest_path_px(PINHOLE, stars, np.zeros(3), 1.0) == 0.0
    assert longest_path_px(PINHOLE, stars[:0], np.array([0.0, 0.0, angle]), 1.0) == 0.0
    # beyond the limit there is no path: only the third is within 0.02 rad of the boresight
    near = longest_path_px(PINHOLE, stars, np.array([0.0, 0.0, angle]), 0.02)
    assert near == pytest.approx(11.5 * math.sqrt(2.0) * angle, rel=1.5e-4)


def test_rotations_are_those_of_scipy():
    vectors = np.random.default_rng(2).normal(size=(5, 3))
    assert rotation_matrices(vectors) == pytest.approx(Rotation.from_rotvec(vectors).as_matrix(), abs=1e-14)
    assert np.array_equal(rotation_matrices(np.zeros((1, 3)))[0], np.eye(3))
    moments = np.array([-0.5, 0.0, 0.25])
    expected = Rotation.from_rotvec(moments[:, None] * vectors[0]).as_matrix()
    assert turning(vectors[0], moments) == pytest.approx(expected, abs=1e-14)


def test_a_source_that_turns_with_the_camera_is_a_point():
    """Its direction is v + t ω × v, which turns by atan ωt: for 1e-3 rad the rest is 1e-10 of a radian."""
    rate, exposure_s = np.array([4e-3, -2e-3, 6e-3]), 0.2
    directions = PINHOLE.unproject(np.array([[200.0, 300.0], [800.0, 640.0]]))
    drift = Drift(np.stack([directions, np.cross(rate, directions)], axis=1))
    paths, weights = drifting_paths(PINHOLE, drift, rate, exposure_s)
    assert paths == pytest.approx(np.broadcast_to([[[200.0, 300.0]], [[800.0, 640.0]]], paths.shape), abs=1e-3)
    assert weights.sum() == pytest.approx(1.0)
    assert longest_drift_px(PINHOLE, drift, rate, exposure_s, 1.0) < 1e-3
    assert longest_drift_px(PINHOLE, drift, -rate, exposure_s, 1.0) == pytest.approx(
        2.0 * longest_path_px(PINHOLE, directions, rate * exposure_s, 1.0), rel=1e-3
    )


def test_a_drift_is_the_polynomial_of_its_direction():
    coefficients = np.array([[[0.1, -0.2, 1.0], [0.02, 0.01, -0.03], [0.004, 0.0, 0.002]]])
    t_s = np.array([[-0.7, 0.0, 1.3]])
    expected = coefficients[0, 0] + t_s[0][:, None] * coefficients[0, 1] + t_s[0][:, None] ** 2 * coefficients[0, 2]
    expected /= np.linalg.norm(expected, axis=1)[:, None]
    assert Drift(coefficients).at(t_s)[0] == pytest.approx(expected, abs=1e-14)


def test_jitter_moves_a_drifting_source_as_it_moves_a_star():
    """Both with a slow rate and the same oscillation: the mean position and the mean square agree to the 1e-4 of the
    sampling."""
    jitter, rate = oscillation(1, 12.0, 2e-3), np.array([0.0, 5e-3, 0.0])
    directions = PINHOLE.unproject(np.array([[511.5, 511.5], [700.0, 300.0]]))
    drift = Drift(directions[:, None])
    found, weights = drifting_paths(PINHOLE, drift, rate, 0.2, jitter=jitter)
    expected, star_weights = star_paths(PINHOLE, directions, rate, 0.2, jitter=jitter)
    assert weights @ found[0] == pytest.approx(star_weights @ expected[0], abs=1e-3)
    spread, star_spread = (
        np.average((path[0, :, 0] - 511.5) ** 2, weights=w) for path, w in ((found, weights), (expected, star_weights))
    )
    assert spread == pytest.approx(star_spread, rel=1e-4)
    assert spread > 7.0  # of an oscillation of 4 px, 8 over whole cycles; a path of 2 px alone has 0.3
