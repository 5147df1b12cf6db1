"""States of the heads in the filter of a body, against the covariance of the errors that they stand for."""

import math

import numpy as np
import pytest
from moving_heads import ALONG_Y, GYRO, SIGMA
from two_heads import ALONG_X, ARCSEC, turned

from startracker.fusion import Head
from startracker.fusion.alignments import AlignedMekf
from startracker.geometry.attitude import Attitude
from startracker.tracking import GyroNoise, RateNoise

TILTED = Attitude.from_rotation_vector([0.4, -0.9, 1.3], "body", "camera")
NOISE = np.array([[4.0, 1.0, 0.0], [1.0, 9.0, -2.0], [0.0, -2.0, 25.0]]) * ARCSEC**2
START = Attitude.from_radec_roll(200.0, -30.0, 70.0)
NO_SCALE = GyroNoise(angle_random_walk=1e-5, rate_random_walk=1e-7, bias_sigma_rad_s=5e-5, scale_sigma=0.0)
HEADS = (
    Head("a", TILTED, 30.0 * ARCSEC, (2.0 * ARCSEC, 0.0, 3.0 * ARCSEC), 50.0, 20.0 * ARCSEC, 400.0),
    Head("b", ALONG_X),
    Head("c", ALONG_Y, 60.0 * ARCSEC, bending_sigma_rad=10.0 * ARCSEC, bending_s=700.0),
)
"""States after those of the body: alignment and correlated error of the first, alignment of the last, and the motion of
both."""
OWN = np.array([*[30.0] * 3, 2.0, 0.0, 3.0, *[60.0] * 3, *[20.0] * 3, *[10.0] * 3]) * ARCSEC
COLUMNS = {0: (9, 18, 12), 1: (), 2: (15, 21)}
"""First columns of the states of each head: those of the mounting, and the correlated error."""


def mekf_of(noise=GYRO, head=0, heads=HEADS):
    return AlignedMekf(heads, head, START, NOISE, noise)


def started(head, body):
    """Covariance of all errors after the first attitude: θ = Mᵀ (noise − those of the head)."""
    count = 9 + len(OWN)
    sources = np.zeros((count + 3, count + 3))
    sources[:3, :3], sources[12:, 12:] = NOISE, np.diag(OWN**2)
    sources[3 : 3 + len(body), 3 : 3 + len(body)] = np.diag(body)
    matrix = HEADS[head].mounting.as_matrix().T
    from_sources = np.zeros((count, count + 3))
    from_sources[:3, :3] = matrix
    for column in COLUMNS[head]:
        from_sources[:3, 3 + column : 6 + column] = -matrix
    from_sources[3:9, 3:9], from_sources[9:, 12:] = np.eye(6), np.eye(len(OWN))
    return from_sources @ sources @ from_sources.T


@pytest.mark.parametrize("head", [0, 1, 2])
@pytest.mark.parametrize(
    ("noise", "body"),
    [
        (GYRO, [5e-5**2] * 3 + [1e-3**2] * 3),
        (NO_SCALE, [5e-5**2] * 3),
        (RateNoise(1e-6, 1e-4), [1e-4**2] * 3),
    ],
)
def test_the_first_attitude_is_correlated_with_the_states_of_its_head(head, noise, body):
    mekf = mekf_of(noise, head)
    np.testing.assert_allclose(mekf.full_covariance, started(head, body), rtol=1e-12, atol=1e-24)
    assert (HEADS[head].mounting @ mekf.attitude).angle_to(START) < 1e-12
    assert mekf.head_attitude(head).angle_to(START) < 1e-12


@pytest.mark.parametrize("head", [0, 2])
def test_covariances_of_a_head_and_of_its_innovation(head):
    """The attitude of a head has the errors of the body and of its mounting; what it measures has also the correlated
    error and the noise."""
    mekf = mekf_of(head=1)
    mekf.predict(3.0, [0.01, -0.02, 0.005])
    full = mekf.full_covariance
    axes = np.zeros((3, len(full)))
    axes[:, :3] = HEADS[head].mounting.as_matrix()
    for column in COLUMNS[head][:2]:
        axes[:, column : column + 3] = np.eye(3)
    np.testing.assert_allclose(mekf.head_covariance(head), axes @ full @ axes.T, rtol=1e-10)
    np.testing.assert_allclose(
        mekf.alignment_sigma_rad(head) ** 2,
        np.full(3, HEADS[head].alignment_sigma_rad ** 2 + HEADS[head].bending_sigma_rad ** 2),
    )
    for column in COLUMNS[head][2:]:
        axes[:, column : column + 3] = np.eye(3)
    matrix = HEADS[head].mounting.as_matrix()
    expected = matrix.T @ (axes @ full @ axes.T + NOISE) @ matrix
    np.testing.assert_allclose(mekf.innovation_covariance(head, NOISE), expected, rtol=1e-10, atol=1e-22)


@pytest.mark.parametrize("head", [0, 1, 2])
def test_an_attitude_corrects_all_states(head):
    """Kalman's update with a difference so small that it is linear: of attitude, bias, mountings and processes."""
    mekf = mekf_of(head=1)
    mekf.predict(3.0, [0.01, -0.02, 0.005])
    full, matrix = mekf.full_covariance, HEADS[head].mounting.as_matrix()
    axes = np.zeros((3, len(full)))
    axes[:, :3] = matrix
    for column in COLUMNS[head]:
        axes[:, column : column + 3] = np.eye(3)
    off = np.array([2.0, -1.0, 3.0]) * 1e-8
    gain = full @ axes.T @ np.linalg.inv(axes @ full @ axes.T + NOISE)
    change = gain @ off
    before = mekf.copy()
    innovation = mekf.update_head(head, turned(mekf.head_attitude(head), off), NOISE)
    assert innovation.accepted
    assert innovation.distance2 == pytest.approx(off @ np.linalg.solve(axes @ full @ axes.T + NOISE, off), rel=1e-6)
    np.testing.assert_allclose(mekf.full_covariance, full - gain @ axes @ full, rtol=1e-7, atol=1e-8 * full[0, 0])
    np.testing.assert_allclose(before.attitude.rotation_vector_to(mekf.attitude), change[:3], atol=1e-14)
    np.testing.assert_allclose(mekf.bias_rad_s, change[3:6], atol=1e-16)
    for k, columns in COLUMNS.items():
        moved = sum((change[at : at + 3] for at in columns[:2]), np.zeros(3))
        np.testing.assert_allclose(mekf.alignment_rad(k), moved, atol=1e-14)
        bent = change[columns[1] : columns[1] + 3] if columns else np.zeros(3)
        assert mekf.bending_rad(k) == pytest.approx(math.hypot(*bent), rel=1e-6)
    # the correlated error is part of what the head is expected to measure, but not of its attitude
    again = mekf.copy()
    expected = turned(mekf.head_attitude(0), change[12:15])
    assert again.update_head(0, expected, NOISE).distance2 < 1e-12
    gated = before.copy()
    far = turned(before.head_attitude(head), off * 1e5)
    assert not gated.update_head(head, far, NOISE, 0.5).accepted
    assert gated.attitude.angle_to(before.attitude) == 0.0


def test_processes_between_measurements():
    """Gauss–Markov: covariances fall by e^(−t/τ), twice as fast towards the variance of the process;
    estimates fall, and the mounting returns by as much."""
    mekf = mekf_of(head=1)
    for head, off in ((0, (30.0, -20.0, 10.0)), (2, (-15.0, 25.0, 5.0))):
        mekf.update_head(head, turned(mekf.head_attitude(head), np.array(off) * ARCSEC), NOISE)
    before, rate, step_s = mekf.full_covariance, np.array([0.01, -0.02, 0.005]), 30.0
    alone = mekf.copy()
    alone._correlated = tuple(one._replace(at=None) for one in alone._correlated)
    alone._bending = tuple(one._replace(at=None) for one in alone._bending)
    alone.predict(step_s, rate)  # the body, with constant states of the heads
    bent = [mekf._bending[k].value_rad for k in (0, 2)]
    correlated, mountings = mekf._correlated[0].value_rad, [mekf.mounting(k) for k in range(3)]
    mekf.predict(step_s, rate)
    kept, fresh = np.ones(len(before)), np.zeros(len(before))
    for at, tau_s, sigma in ((12, 50.0, (2.0, 0.0, 3.0)), (18, 400.0, (20.0,) * 3), (21, 700.0, (10.0,) * 3)):
        kept[at : at + 3] = math.exp(-step_s / tau_s)
        fresh[at : at + 3] = (1.0 - math.exp(-2.0 * step_s / tau_s)) * (np.array(sigma) * ARCSEC) ** 2
    expected = alone.full_covariance * np.outer(kept, kept) + np.diag(fresh)
    np.testing.assert_allclose(mekf.full_covariance, expected, rtol=1e-10, atol=1e-24)
    np.testing.assert_allclose(mekf._correlated[0].value_rad, correlated * math.exp(-step_s / 50.0))
    assert np.abs(correlated).max() > 0.01 * ARCSEC
    for k, value, tau_s in ((0, bent[0], 400.0), (2, bent[1], 700.0)):
        assert math.hypot(*value) > 0.5 * ARCSEC
        np.testing.assert_allclose(mekf._bending[k].value_rad, value * math.exp(-step_s / tau_s))
        back = mountings[k].rotation_vector_to(mekf.mounting(k))
        np.testing.assert_allclose(back, -(1.0 - math.exp(-step_s / tau_s)) * value, rtol=1e-6, atol=1e-15)
    assert mekf.mounting(1).angle_to(mountings[1]) == 0.0


@pytest.mark.parametrize("noise", [GYRO, NO_SCALE])
def test_states_that_are_added_in_flight(noise):
    """A motion or an alignment of a head that stated none, with three states each; more variance if they exist."""
    plain = Head("b", ALONG_X)
    mekf = mekf_of(noise, 0, (plain, Head("c", ALONG_Y)))
    body = len(mekf.full_covariance)
    assert body == (9 if noise is GYRO else 6)
    before = mekf.full_covariance
    mekf.realign(1, 7.0 * ARCSEC)
    mekf.bend(0, 3.0 * ARCSEC, 80.0, at_once_rad=2.0 * ARCSEC)
    full = mekf.full_covariance
    assert full.shape == (15, 15)
    np.testing.assert_array_equal(full[:body, :body], before)
    np.testing.assert_allclose(np.diag(full)[9:], np.repeat([7.0 * ARCSEC, 2.0 * ARCSEC], 3) ** 2)
    assert np.count_nonzero(full - np.diag(np.diag(full))) == np.count_nonzero(before - np.diag(np.diag(before)))
    assert (mekf.bending_sigma_rad(0), mekf.bending_s(0)) == (3.0 * ARCSEC, 80.0)
    assert (mekf.bending_sigma_rad(1), mekf.bending_s(1)) == (0.0, 900.0)
    mekf.realign(1, 24.0 * ARCSEC)
    mekf.bend(0, 5.0 * ARCSEC, 90.0)
    np.testing.assert_allclose(np.diag(mekf.full_covariance)[9:], np.repeat([25.0 * ARCSEC, 2.0 * ARCSEC], 3) ** 2)
    mekf.predict(1e9)
    np.testing.assert_allclose(np.diag(mekf.full_covariance)[9:], np.repeat([25.0 * ARCSEC, 5.0 * ARCSEC], 3) ** 2)
    # an attitude of each then corrects its own
    mekf = mekf_of(noise, 0, (plain, Head("c", ALONG_Y)))
    mekf.realign(1, 1.0)
    off = np.array([30.0, -20.0, 10.0]) * ARCSEC
    mekf.update_head(1, turned(mekf.head_attitude(1), off), NOISE)
    np.testing.assert_allclose(mekf.alignment_rad(1), off, atol=1e-3 * ARCSEC)
    np.testing.assert_array_equal(mekf.alignment_rad(0), np.zeros(3))


@pytest.mark.parametrize("second", [None, 3e-4])
def test_a_restart_keeps_what_is_known_of_the_heads(second):
    """States of the heads with their covariance; of the gyro all, or a new bias and the scale factors as stated."""
    mekf = mekf_of(head=1)
    for k in range(4):
        mekf.predict(20.0, np.roll([0.02, -0.01, 0.005], k))
        for head in (2, 0, 1):
            mekf.update_head(head, turned(mekf.head_attitude(head), np.array([3.0, -2.0, k]) * ARCSEC), NOISE)
    before, bias = mekf.full_covariance, mekf.bias_rad_s
    mountings, process = [mekf.mounting(k) for k in range(3)], mekf._correlated[0].value_rad
    given = Attitude.from_radec_roll(10.0, 20.0, 30.0)
    mekf.restart(0, given, NOISE, second)
    full, matrix = mekf.full_covariance, mountings[0].as_matrix().T
    np.testing.assert_allclose(full[9:, 9:], before[9:, 9:], rtol=1e-12)
    own = np.zeros((3, len(before) - 9))
    for column in COLUMNS[0]:
        own[:, column - 9 : column - 6] = np.eye(3)
    np.testing.assert_allclose(full[:3, 9:], -matrix @ own @ before[9:, 9:], rtol=1e-9, atol=1e-22)
    np.testing.assert_allclose(full[:3, :3], matrix @ (NOISE + own @ before[9:, 9:] @ own.T) @ matrix.T, rtol=1e-9)
    assert not full[3:9, 9:].any()
    assert not full[:3, 3:9].any()
    if second is None:
        np.testing.assert_array_equal(full[3:9, 3:9], before[3:9, 3:9])
        assert np.abs(before[3:6, 6:9]).max() > 0.0
    else:
        np.testing.assert_allclose(full[3:9, 3:9], np.diag(np.repeat([second, 1e-3], 3) ** 2))
    np.testing.assert_array_equal(mekf.bias_rad_s, bias)
    for k in range(3):
        assert mekf.mounting(k).angle_to(mountings[k]) == 0.0
    assert turned(mekf.head_attitude(0), process).angle_to(given) < 1e-12
    assert math.hypot(*process) > 0.01 * ARCSEC


def test_a_large_correction_is_linearised_about_its_result():
    """Two heads of which the second is off by degrees about all axes: both its alignment and the body's attitude are
    then those that the attitudes show, as the first head is exact."""
    heads = (Head("b", ALONG_X), Head("c", ALONG_Y, math.radians(20.0)))
    mekf = AlignedMekf(heads, 0, START, np.eye(3) * SIGMA**2, GYRO)
    off = np.radians([9.0, -7.0, 5.0])
    seen = turned(ALONG_Y @ mekf.attitude, off)
    mekf.update_head(1, seen, np.eye(3) * SIGMA**2)
    assert mekf.head_attitude(1).angle_to(seen) < 0.01 * ARCSEC
    np.testing.assert_allclose(mekf.alignment_rad(1), off, atol=1e-3 * ARCSEC)
    assert mekf.head_attitude(0).angle_to(START) < 1e-3 * ARCSEC
