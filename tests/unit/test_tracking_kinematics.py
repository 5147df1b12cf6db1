"""Kernels of the filter against matrix exponentials, SciPy's rotations and textbook updates; and what tracking takes
for an image, a duplicate or a streak."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from startracker.tracking.candidates import as_pixels, streak_px
from startracker.tracking.kinematics import correct, propagate, transition, turn_quaternion, vector_measurement
from startracker.tracking.mekf import chi_square_limit, rotation_between
from startracker.tracking.windows import first_of_each

RATES = {"still": np.zeros(3), "series": np.array([0.01, -0.02, 0.015]), "fast": np.array([0.3, -0.5, 0.4])}


def skew(v):
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def integrals(rate, dt):
    """Φ = exp(−K t), ∫Φ and ∫∫Φ as blocks of one matrix exponential (Van Loan 1978), ∫ (∫Φ)(∫Φ)ᵀ by Gauss nodes."""
    chain = np.zeros((9, 9))
    chain[:3, :3], chain[:3, 3:6], chain[3:6, 6:] = -skew(rate), np.eye(3), np.eye(3)

    def blocks(t):
        whole = expm(chain * t)
        return whole[:3, :3], whole[:3, 3:6], whole[:3, 6:]

    nodes, weights = np.polynomial.legendre.leggauss(12)
    once = [blocks(0.5 * dt * (1.0 + node))[1] for node in nodes]
    squared = sum(0.5 * dt * weight * psi @ psi.T for psi, weight in zip(once, weights, strict=True))
    return *blocks(dt), squared


@pytest.mark.parametrize("name", RATES)
@pytest.mark.parametrize("dt", [0.1, 1.0])
def test_transition_over_a_step(name, dt):
    """By series below 0.03 rad and closed forms above; both sides of the limit agree."""
    for found, expected in zip(transition(RATES[name], dt), integrals(RATES[name], dt), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-11 * np.abs(expected).max())


def test_series_and_closed_forms_meet():
    """At 0.03 rad the closed form of ∫∫∫∫ has lost 1e-16/0.03⁴: 1e-10."""
    axis = np.array([0.6, 0.0, 0.8])
    for low, high in zip(transition(axis * 0.0299999, 1.0), transition(axis * 0.0300001, 1.0), strict=True):
        np.testing.assert_allclose(low, high, atol=2e-7)
    for angle in (0.0299999, 0.0300001):
        for found, expected in zip(transition(axis * angle, 1.0), integrals(axis * angle, 1.0), strict=True):
            np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("states", [6, 9, 12])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_propagation_with_its_noise(states, sign):
    """Covariances by the transition of all states, and the noise of angle, rate and a rate that is not a state."""
    rng = np.random.default_rng(1)
    rate, dt, (angle, second, extra) = RATES["fast"], 0.7, (1e-6, 3e-5, 2e-5)
    root = rng.normal(size=(states, states)) * 1e-3
    quat = Rotation.from_rotvec([0.3, -0.2, 0.9]).as_quat()
    phi, psi, twice, squared = integrals(rate, dt)
    full = np.eye(states)
    full[:3, :3], full[:3, 3:6] = phi, sign * psi
    if states > 6:
        full[:3, 6:9] = sign * psi @ np.diag(rate)
    noise = np.zeros((states, states))
    noise[:3, :3] = angle * dt * np.eye(3) + (second + extra) * squared
    noise[3:6, 3:6] = second * dt * np.eye(3)
    noise[:3, 3:6], noise[3:6, :3] = sign * second * twice, sign * second * twice.T
    expected = full @ root @ root.T @ full.T + noise
    moved, found = propagate(quat, root @ root.T, rate, dt, sign, angle, second, extra)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(found, found.T, atol=0.0)
    attitude = Rotation.from_quat(quat).inv().as_matrix()
    turned = expm(-skew(rate) * dt) @ attitude
    np.testing.assert_allclose(Rotation.from_quat(moved).inv().as_matrix(), turned, atol=1e-12)


@pytest.mark.parametrize("size", [0.0, 1e-9, 0.99e-4, 1.01e-4, 0.3, 3.0])
def test_a_turned_quaternion(size):
    """Of unit length; by series below 1e-4 rad."""
    quat, vector = Rotation.from_rotvec([0.3, -0.2, 0.9]).as_quat(), size * np.array([0.48, -0.6, 0.64])
    found = turn_quaternion(quat, vector)
    expected = (Rotation.from_quat(quat) * Rotation.from_rotvec(vector)).as_quat()
    np.testing.assert_allclose(found * np.sign(found @ expected), expected, atol=1e-15)
    back = rotation_between(quat, found)
    np.testing.assert_allclose(back, vector, atol=1e-14)
    np.testing.assert_allclose(rotation_between(quat, -found), back, atol=1e-14)


@pytest.mark.parametrize(("axes", "states"), [(1, 6), (2, 6), (3, 6), (3, 9)])
def test_an_update_in_josephs_form(axes, states):
    """Distance, correction and covariance of the textbook; the innovation whitened in camera axes for three axes."""
    rng = np.random.default_rng(2)
    root = rng.normal(size=(states, states))
    p, turn = root @ root.T, np.linalg.qr(rng.normal(size=(3, 3)))[0][:axes]
    noise, innovation = np.diag(rng.uniform(0.5, 2.0, axes)), rng.normal(size=axes)
    h = np.zeros((axes, states))
    h[:, :3] = turn
    s = h @ p @ h.T + noise
    gain = p @ h.T @ np.linalg.inv(s)
    for given in (turn, h):
        distance2, change, after, white = correct(p, given, innovation, noise)
        assert distance2 == pytest.approx(innovation @ np.linalg.solve(s, innovation))
        np.testing.assert_allclose(change, gain @ innovation, atol=1e-12)
        np.testing.assert_allclose(after, (np.eye(states) - gain @ h) @ p, atol=1e-10)
        if axes == 3:
            factor = np.linalg.cholesky(turn.T @ s @ turn)
            np.testing.assert_allclose(white, np.linalg.solve(factor, turn.T @ innovation), atol=1e-10)
            assert white @ white == pytest.approx(distance2)
        else:
            assert np.isnan(white).all()
    refused = correct(p, turn, innovation, -100.0 * p.max() * np.eye(axes))
    assert math.isnan(refused[0])
    assert not refused[1].any()
    np.testing.assert_array_equal(refused[2], p)


@pytest.mark.parametrize("count", [1, 2, 6])
def test_an_attitude_error_measured_by_directions(count):
    """Exact directions of an attitude that is off by e, linearised near there, give e; their covariance is the inverse
    of Σ (I − p pᵀ)/σ² along its axes, of a single star two of the three."""
    rng = np.random.default_rng(3)
    quat, error = Rotation.from_rotvec([0.3, -0.2, 0.9]).as_quat(), np.array([2e-4, -3e-4, 1e-4])
    matrix = Rotation.from_quat(quat).inv().as_matrix()
    true = expm(-skew(error)) @ matrix
    seen = rng.normal(size=(count, 3)) * [0.1, 0.1, 0.0] + [0.0, 0.0, 1.0]
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    sigma = rng.uniform(1e-5, 3e-5, count)
    axes, innovation, noise = vector_measurement(quat, np.zeros(3), seen, seen @ true, sigma)
    assert axes.shape == ((2 if count == 1 else 3), 3)
    np.testing.assert_allclose(axes @ axes.T, np.eye(len(axes)), atol=1e-12)
    predicted = seen @ true @ matrix.T
    information = sum((np.eye(3) - np.outer(p, p)) / s**2 for p, s in zip(predicted, sigma, strict=True))
    np.testing.assert_allclose(
        np.diag(1.0 / noise.diagonal()), axes @ information @ axes.T, atol=1e-6 / sigma.min() ** 2
    )
    assert np.count_nonzero(noise) == len(axes)
    np.testing.assert_allclose(innovation, axes @ error, atol=3e-7)
    near, again, _ = vector_measurement(quat, error, seen, seen @ true, sigma)
    np.testing.assert_allclose(again, near @ error, atol=1e-10)


def test_a_gate_that_nothing_exceeds():
    assert chi_square_limit(3, 0.0) == math.inf
    assert chi_square_limit(3, 1e-6) == pytest.approx(30.6648, rel=1e-5)
    assert rotation_between(np.array([0.0, 0.0, 0.0, 1.0]), np.array([0.0, 0.0, 0.0, 1.0])).tolist() == [0.0, 0.0, 0.0]


# ---------------------------------------------------------------------- what is looked at
@pytest.mark.parametrize(
    ("image", "kind"),
    [
        (np.zeros((2, 3), np.uint8), np.uint8),
        (np.zeros((2, 3), np.int64), np.int64),
        (np.zeros((2, 3), np.float64), np.float64),
        (np.zeros((2, 3), np.float16), np.float32),
        (np.zeros((2, 3), ">u2"), np.float32),
        (np.zeros((2, 3), np.longdouble), np.float32),
        ([[1, 2], [3, 4]], np.int64),
        (np.zeros((2, 3), bool), None),
        (np.zeros((2, 3), complex), None),
        (np.zeros(3), None),
        (np.zeros((2, 3, 4)), None),
        ([[1, 2], [3]], None),
        ("text", None),
    ],
)
def test_what_is_an_image(image, kind):
    found = as_pixels(image)
    assert (found is None) if kind is None else found.dtype == kind


def test_masked_pixels_are_not_numbers():
    image = np.ma.masked_array(np.arange(6, dtype=np.uint16).reshape(2, 3), mask=[[0, 1, 0], [0, 0, 0]])
    found = as_pixels(image)
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, [[0.0, np.nan, 2.0], [3.0, 4.0, 5.0]])
    assert as_pixels(np.ma.masked_array(np.zeros((2, 2), np.uint8), mask=False)).dtype == np.uint8
    assert as_pixels(np.ma.masked_array(np.zeros((2, 2), bool), mask=True)) is None


def test_length_of_a_streak():
    """3 and 4 mrad/s across and 2 mrad/s about the boresight at half a radian: 5 + 1 mrad/s, for 2 s, in pixels."""
    tracker = SimpleNamespace(guide=SimpleNamespace(half_diagonal_rad=0.5), camera=SimpleNamespace(pixel_rad=1e-3))
    assert streak_px(tracker, np.array([3e-3, 4e-3, -2e-3]), 2.0) == pytest.approx(12.0)


def test_points_at_the_border_and_duplicates():
    """The lower border belongs to the image, the upper one does not; at the distance itself two are two."""
    for point, kept in (
        ((-0.5, 3.0), True), ((-0.51, 3.0), False), ((3.0, -0.5), True), ((3.0, -0.51), False),
        ((9.49, 3.0), True), ((9.5, 3.0), False), ((3.0, 7.49), True), ((3.0, 7.5), False),
    ):  # fmt: skip
        assert len(first_of_each(np.array([point]), 10.0, 8.0, 0.0, 1.0)) == kept, point
    for point, kept in (((1.5, 3.0), True), ((1.49, 3.0), False), ((7.49, 3.0), True), ((7.5, 3.0), False)):
        assert len(first_of_each(np.array([point]), 10.0, 8.0, 2.0, 1.0)) == kept, point
    for away, rows in (((1.0, 0.0), [0, 1]), ((0.99, 0.0), [0]), ((0.0, -0.99), [0]), ((0.5, -1.0), [0, 1])):
        xy = np.array([[4.0, 4.0], [4.0 + away[0], 4.0 + away[1]]])
        assert first_of_each(xy, 10.0, 8.0, 0.0, 1.0).tolist() == rows
