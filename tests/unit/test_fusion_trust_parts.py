"""Decisions of the filter of several heads, one by one, from states made for them."""

import math

import numpy as np
import pytest
from moving_heads import GYRO, SIGMA, three
from two_heads import ALONG_X, ARCSEC, turned

from startracker.fusion import Head
from startracker.fusion.alignments import AlignedMekf
from startracker.fusion.state import Anchor, HeadRecord, Measurement, Rival, Shift, State
from startracker.fusion.trust import (
    _anchored,
    _at_least_as_seen,
    _before,
    _bent,
    _decided,
    _distance2,
    _followed,
    _forgetting,
    _is_static,
    measured,
)
from startracker.fusion.windows import Finding
from startracker.geometry.attitude import Attitude
from startracker.tracking import RateNoise

NOW_S = 1000.0
START = Attitude([0.0, 0.0, 0.0, 1.0])


def mekf_of(heads=None, noise=GYRO, attitude=START):
    return AlignedMekf(three()[:2] if heads is None else heads, 0, attitude, np.eye(3) * SIGMA**2, noise)


def state(mekf, *records, **changes):
    records = records or (HeadRecord(used=50, used_s=NOW_S),) * 2
    return State(NOW_S, mekf, records, (None,) * len(records))._replace(**changes)


def shown(mekf, head, off_rad=(0.0, 0.0, 0.0), sigma=SIGMA):
    """What a head measures if it is off by a rotation about the axes of its camera."""
    return Measurement(head, turned(mekf.head_attitude(head), np.asarray(off_rad)), np.eye(3) * sigma**2)


# ---------------------------------------------------------------------- the motion that is assumed
@pytest.mark.parametrize(
    ("shift", "stated", "estimated", "expected"),
    [(10.0, 0.0, 0.0, 20.0), (10.0, 15.0, 0.0, 30.0), (1.0, 1.0, 40.0, 60.0), (7200.0, 0.0, 0.0, 3600.0)],
)
def test_a_motion_is_assumed_twice_as_large_as_seen(shift, stated, estimated, expected):
    """Or twice that assumed so far, or 1.5 times the one estimated; at most 1°. It has already happened."""
    heads = [three()[0], Head("b", ALONG_X, bending_sigma_rad=stated * ARCSEC, bending_s=500.0)]
    mekf = mekf_of(heads)
    if estimated:
        mekf.bend(1, 1.0 * ARCSEC, 500.0, at_once_rad=1.0)
        mekf.update_head(*shown(mekf, 1, (estimated * ARCSEC, 0.0, 0.0), 1e-3 * ARCSEC))
        assert mekf.bending_rad(1) == pytest.approx(estimated * ARCSEC, rel=1e-3)
    before = mekf.full_covariance
    after = _bent(mekf, 1, shift * ARCSEC, 50.0, resolved=False)
    assert after.bending_sigma_rad(1) == pytest.approx(expected * ARCSEC, rel=1e-3)
    assert after.bending_s(1) == (500.0 if stated else 200.0)
    assert _bent(mekf, 1, shift * ARCSEC, 200.0, resolved=False).bending_s(1) == 800.0
    free = _bent(mekf, 1, shift * ARCSEC, 200.0, resolved=True)  # diffuses as fast, and hardly comes back
    assert free.bending_sigma_rad(1) == pytest.approx(10.0 * expected * ARCSEC, rel=1e-3)
    assert free.bending_s(1) == 80_000.0
    grown = after.full_covariance[-3:, -3:]
    grown = grown - before[-3:, -3:] if stated else grown
    np.testing.assert_allclose(grown, np.eye(3) * (expected * ARCSEC) ** 2, rtol=2e-3, atol=1e-16)
    np.testing.assert_array_equal(mekf.full_covariance, before)


def test_the_assumed_motion_grows_with_the_estimated_one():
    mekf = mekf_of()
    mekf.bend(1, 10.0 * ARCSEC, 500.0, at_once_rad=1.0)
    for angle, grows in ((9.9, False), (12.0, True), (3599.0, True), (3601.0, False)):
        moved = mekf.copy()
        moved.update_head(*shown(moved, 1, (0.0, angle * ARCSEC, 0.0), 1e-4 * ARCSEC))
        seen_rad, sigma_rad = moved.bending_rad(1), moved.bending_sigma_rad(1)
        after = _at_least_as_seen(moved, 1)
        assert (after is not moved) is grows
        assert after.bending_sigma_rad(1) == pytest.approx(1.5 * seen_rad if grows else sigma_rad)
        assert after.bending_s(1) == 500.0
        added = np.diag(after.full_covariance - moved.full_covariance)[-3:]
        np.testing.assert_allclose(added, (0.5 * seen_rad) ** 2 if grows else 0.0, rtol=1e-6)


def test_a_motion_in_memory_is_told_as_large_as_it_is_by_now():
    mekf = mekf_of()
    mekf.bend(1, 10.0 * ARCSEC, 500.0, at_once_rad=1.0)
    mekf.update_head(*shown(mekf, 1, (0.0, 30.0 * ARCSEC, 0.0), 1e-4 * ARCSEC))
    seen_rad = mekf.bending_rad(1)
    for until_s, known_rad, told_rad in (
        (NOW_S, 1e-6, seen_rad),
        (NOW_S, 1.0, 1.0),
        (NOW_S - 1.0, 1e-6, 1e-6),
    ):
        record = HeadRecord(motion=Shift(known_rad, True, until_s))
        found = _followed(state(mekf, HeadRecord(), record))
        assert found.records[1].motion.shift_rad == told_rad
        assert (found.mekf is mekf) is (until_s < NOW_S)


def test_a_motion_is_forgotten_after_its_time():
    heads = [three()[0], Head("b", ALONG_X, bending_sigma_rad=3.0 * ARCSEC, bending_s=500.0)]
    mekf = mekf_of(heads)
    stated = HeadRecord(motion=Shift(1e-4, True, NOW_S))
    assert _forgetting(mekf, (HeadRecord(), stated), NOW_S + 1.0) is mekf
    mekf.bend(1, 50.0 * ARCSEC, 90.0)
    assert _forgetting(mekf, (HeadRecord(), stated), NOW_S) is mekf
    assert _forgetting(mekf, (HeadRecord(), HeadRecord()), NOW_S + 1.0) is mekf
    after = _forgetting(mekf, (HeadRecord(), stated), NOW_S + 1.0)
    assert (after.bending_sigma_rad(1), after.bending_s(1)) == (3.0 * ARCSEC, 500.0)
    assert mekf.bending_sigma_rad(1) == 50.0 * ARCSEC


# ---------------------------------------------------------------------- the filter of before
def test_the_filter_is_kept_every_32_attitudes_of_each_head():
    now = _anchored(state(mekf_of()))
    assert (len(now.anchors), now.anchored, now.anchors[0].since_s) == (1, 0, NOW_S)
    counts = []
    for k in range(1, 200):
        now = _anchored(now._replace(t_s=NOW_S + k))
        counts.append([one.since_s - NOW_S for one in now.anchors])
    assert counts[62] == [0.0]
    assert counts[63] == [0.0, 64.0]
    assert counts[127] == [64.0, 128.0]


def test_the_filter_from_before_a_contradiction_is_half_a_time_older():
    anchors = tuple(Anchor(mekf_of(), since_s) for since_s in (NOW_S - 300.0, NOW_S - 100.0))
    now = state(mekf_of(), anchors=anchors)

    def found(duration_s, heads=(0, 1)):
        return _before(now, Finding(heads, False, (1.0,) * len(heads), duration_s))

    assert found(66.0) is anchors[1]
    assert found(67.0) is anchors[0]
    assert found(200.0) is anchors[0]
    assert found(201.0) is None
    assert found(66.0, ()) is None


# ---------------------------------------------------------------------- which head it is
def test_the_difference_of_two_filters_counts_attitude_and_bias():
    one, other = mekf_of(), mekf_of()
    assert _distance2(one, other) == 0.0
    turned_by = np.array([2.0, -1.0, 0.5]) * SIGMA
    other = mekf_of(attitude=turned(START, turned_by))
    assert _distance2(one, other) == pytest.approx(float(turned_by @ turned_by) / SIGMA**2, rel=1e-6)
    other = one.copy()
    other._bias = one._bias + np.array([0.0, 3.0, 0.0]) * GYRO.bias_sigma_rad_s
    assert _distance2(one, other) == pytest.approx(9.0)


@pytest.mark.parametrize(("fitting", "other", "decided"), [(1.0, 60.0, True), (1.0, 20.0, False), (20.0, 60.0, False)])
def test_the_head_without_which_the_others_agree_with_the_gyro_has_moved(fitting, other, decided):
    """χ² of six: below 12.6 (5 %) for one rival, and above 38.3 (1e-6) for all others."""

    def rival(head, distance2):
        return Rival(head, mekf_of(attitude=turned(START, [math.sqrt(distance2) * SIGMA, 0.0, 0.0])))

    moving = HeadRecord(used=50, motion=Shift(20.0 * ARCSEC, False, NOW_S + 9.0))
    coasting, bent = Anchor(mekf_of(), NOW_S - 100.0), mekf_of()
    bent.bend(0, 1e-4, 77.0)
    bent.bend(1, 1e-4, 78.0)
    rivals = rival(0, other), rival(1, fitting)
    before = state(bent, moving, moving, rivals=rivals, coasting=coasting)
    after = _decided(before)
    if not decided:
        assert after is before
        return
    assert after.records[0].motion is None
    assert after.records[1].motion == moving.motion._replace(resolved=True)
    assert (after.rivals, after.coasting) == ((), None)
    assert after.mekf.bending_sigma_rad(1) == 20.0 * ARCSEC
    assert after.mekf.bending_s(1) == 78.0
    assert after.mekf.bending_sigma_rad(0) == 0.0
    np.testing.assert_array_equal(after.mekf.quat, rivals[1].mekf.quat)
    at_once = np.diag(after.mekf.full_covariance)[-3:]
    np.testing.assert_allclose(at_once, (40.0 * ARCSEC) ** 2)
    for alone in (before._replace(rivals=rivals[:1]), before._replace(coasting=None)):
        assert _decided(alone) is alone


# ---------------------------------------------------------------------- beyond the gate
@pytest.mark.parametrize(("sigmas", "static"), [(4.5, True), (4.7, False)])
def test_a_picture_is_static_within_the_errors_of_both_attitudes(sigmas, static):
    """χ² of three with 1e-4: 21.1, the square of 4.59, of the variances together."""
    mekf = mekf_of()
    off = sigmas * SIGMA * math.sqrt(1.0 + 9.0)
    assert _is_static(shown(mekf, 0), shown(mekf, 0, (0.0, off, 0.0), 3.0 * SIGMA)) is static


@pytest.mark.parametrize("noise", [GYRO, RateNoise(1e-6, 1e-4)])
def test_three_that_agree_restart_a_filter_that_nobody_else_confirms(noise):
    """An outlier more or less does not count; of two heads the one that others outvoted is realigned instead."""
    mekf = mekf_of(noise=noise)
    off = (0.01, 0.0, 0.0)
    for outvoted, outcomes in ((0, ["rejected"] * 2 + ["restarted"]), (1, ["rejected"] * 2 + ["realigned"])):
        records = HeadRecord(used=50, used_s=NOW_S - 50.0), HeadRecord(used=50, used_s=NOW_S - 9.0, outvoted=outvoted)
        now, found = state(mekf, *records), []
        for _ in range(3):
            now = measured(now, shown(mekf, 1, off), 1e-6)
            found.append(now.update.outcome)
        if outvoted:
            assert found[:2] == outcomes[:2]
            assert found[2] != "restarted"
        else:
            assert found == outcomes
            assert now.mekf.head_attitude(1).angle_to(shown(mekf, 1, off).attitude) < 3.0 * SIGMA
            assert [one.used for one in now.records] == [50, 51]
            assert [one.rejected for one in now.records] == [0, 0]
