"""The words of the filter of several heads, and the tests of each head's innovations, from states made for them."""

import math
from dataclasses import replace

import numpy as np
import pytest
from moving_heads import ALONG_Y, GYRO, SIGMA, three
from scipy.special import chdtri
from two_heads import ALONG_X, ALONG_Z, ARCSEC, turned

from startracker.fusion import Head
from startracker.fusion.alignments import AlignedMekf
from startracker.fusion.state import SCALES, HeadRecord, Measurement, Shift, State, Window
from startracker.fusion.status import status_of
from startracker.fusion.trust import measured
from startracker.fusion.windows import extended, finding, noise_factor, restarted
from startracker.geometry.attitude import Attitude
from startracker.tracking import RateNoise
from startracker.tracking.kinematics import turn_quaternion
from startracker.tracking.mekf import Innovation

NOW_S = 100.0
USED = HeadRecord(used=50, used_s=NOW_S)
OUT = HeadRecord(used=50, rejected=3, outvoted=1)
NEW_OUT = OUT._replace(used=9)
MOVED = Shift(30.0 * ARCSEC, True, math.inf)
NO_GYRO = RateNoise(1e-6, 1e-4)


def mekf_of(heads, noise=GYRO):
    return AlignedMekf(heads, 0, Attitude([0.0, 0.0, 0.0, 1.0]), np.eye(3) * SIGMA**2, noise)


def status(*records, noise=GYRO, bending_rad=1e-9, **changes):
    """Status of heads whose mountings state a motion, so that none of the unstated kind has to be excluded."""
    heads = [replace(head, bending_sigma_rad=bending_rad) for head in three()[: len(records)]]
    state = State(NOW_S, mekf_of(heads, noise), records, (None,) * len(records))
    return status_of(state._replace(**changes), ("a", "b", "c")[: len(records)], NOW_S)


@pytest.mark.parametrize(
    ("records", "state", "heads"),
    [
        ((USED, USED), "consistent", ("consistent", "consistent")),
        ((USED, HeadRecord()), "consistent", ("consistent", "no_attitude")),
        ((USED, HeadRecord(rejected=2)), "consistent", ("consistent", "no_attitude")),
        # one that contradicts the others is to blame if it is known, or if two others agree
        ((USED, OUT), "head_flagged", ("consistent", "rejected")),
        ((USED, OUT._replace(used=10)), "head_flagged", ("consistent", "rejected")),
        ((USED, NEW_OUT), "heads_disagree", ("consistent", "rejected")),
        ((USED, NEW_OUT._replace(rejected=2)), "consistent", ("consistent", "consistent")),
        ((USED, NEW_OUT._replace(outvoted=0)), "head_flagged", ("consistent", "rejected")),
        ((USED, USED, NEW_OUT), "head_flagged", ("consistent", "consistent", "rejected")),
        ((USED, USED._replace(rejected=1), NEW_OUT), "heads_disagree", ("consistent", "consistent", "rejected")),
        ((USED, HeadRecord(), NEW_OUT), "heads_disagree", ("consistent", "no_attitude", "rejected")),
        # all of them against the filter: the gyro
        ((OUT, OUT), "gyro_disagrees", ("rejected", "rejected")),
        ((OUT, HeadRecord()), "gyro_disagrees", ("rejected", "no_attitude")),
        ((OUT, HeadRecord(rejected=1)), "head_flagged", ("rejected", "no_attitude")),
        # a motion, as long as it is remembered
        ((USED, USED._replace(step=MOVED)), "head_flagged", ("consistent", "moved")),
        ((USED, USED._replace(motion=MOVED)), "head_flagged", ("consistent", "moving")),
        ((USED, USED._replace(step=MOVED, motion=MOVED)), "head_flagged", ("consistent", "moved")),
        ((USED, USED._replace(motion=MOVED._replace(resolved=False))), "heads_disagree", ("consistent", "moving")),
        ((USED, USED._replace(step=MOVED._replace(resolved=False))), "heads_disagree", ("consistent", "moved")),
        ((USED, USED._replace(motion=MOVED._replace(until_s=NOW_S))), "head_flagged", ("consistent", "moving")),
        ((USED, USED._replace(motion=Shift(1.0, False, NOW_S))), "heads_disagree", ("consistent", "moving")),
        ((USED, USED._replace(motion=Shift(1.0, False, NOW_S - 1.0))), "consistent", ("consistent", "consistent")),
        ((USED, USED._replace(noise=2.24)), "consistent", ("consistent", "consistent")),
        ((USED, USED._replace(noise=2.26)), "head_flagged", ("consistent", "noisy")),
    ],
)
def test_the_status_follows_from_the_history_of_the_heads(records, state, heads):
    found = status(*records)
    assert found.state == state
    assert tuple(one.state for one in found.heads.values()) == heads
    assert (found.reason == "") is (state == "consistent")


def test_the_status_says_how_far_and_how_noisy():
    found = status(USED, USED._replace(motion=MOVED, step=MOVED._replace(shift_rad=12.0 * ARCSEC)))
    assert found.heads["b"].shift_rad == 30.0 * ARCSEC
    assert (
        found.reason
        == "head b has moved by about 30″ on its mounting, more than stated; the other heads and the gyro agree"
    )
    found = status(USED, USED._replace(noise=9.0))
    assert found.heads["b"].noise_factor == 3.0
    assert found.reason.startswith("head b scatters 3.0 times as much as stated; ")
    assert status(USED, OUT).reason.startswith("head b contradicts the others; ")


def test_two_heads_without_a_history_are_not_verified():
    found = status(USED, USED, bending_rad=0.0)
    assert found.state == "unverified"
    assert not found.trusted
    assert found.reason.startswith("a mounting may have moved")
    assert status(USED, HeadRecord(), bending_rad=0.0).state == "consistent"  # one head defines the axes
    assert status(USED, NEW_OUT, bending_rad=0.0).state == "heads_disagree"


def test_a_gyro_that_contradicts_the_stars():
    assert status(USED, USED, motion_until_s=NOW_S - 1.0).state == "consistent"
    for noise, word in ((GYRO, "as the gyro says"), (NO_GYRO, "as steadily as RateNoise states")):
        found = status(USED, USED, noise=noise, motion_until_s=NOW_S)
        assert found.state == "gyro_disagrees"
        assert word in found.reason


@pytest.mark.parametrize(("sigmas", "state"), [(5.5, "unverified"), (5.6, "heads_disagree")])
@pytest.mark.parametrize("bending", [0.0, 1.0, 3.0])
def test_an_alignment_that_is_farther_than_stated(sigmas, state, bending):
    """χ² of three components with a false alarm of 1e-6 is 30.7, the square of 5.54; both variances count."""
    assert math.sqrt(chdtri(3, 1e-6)) == pytest.approx(5.54, abs=0.01)
    mekf = mekf_of(three()[:2])
    mekf.update_head(1, turned(ALONG_X @ mekf.attitude, [1e-3, 0.0, 0.0]), np.eye(3) * SIGMA**2)
    found_rad = math.hypot(*mekf.alignment_rad(1))
    alignment_rad = found_rad / sigmas / math.hypot(1.0, bending)
    bending_rad = bending * alignment_rad
    mekf.heads = (mekf.heads[0], Head("b", ALONG_X, alignment_rad, bending_sigma_rad=bending_rad))
    if bending:
        mekf.bend(1, bending_rad, 1000.0)
    found = status(USED, USED, mekf=mekf)
    assert found.state == state
    if state != "unverified":
        assert found.heads["b"] == ("moved", pytest.approx(found_rad), 1.0)
        assert found.heads["a"].state == "consistent"
        # what is a step already, or moves by more than stated, is told as such
        assert status(USED, USED._replace(step=MOVED), mekf=mekf).state == "head_flagged"
        mekf.bend(1, 1.1 * bending_rad + 1e-6, 1000.0)
        assert status(USED, USED, mekf=mekf).state == "unverified"
    mekf.heads = (mekf.heads[0], Head("b", ALONG_X))
    assert status(USED, USED, mekf=mekf).state == "unverified"


def window(mean, frames=8, scatter=1.0, scale=0, last_s=NOW_S, step_s=1.0, sigma=1.0):
    """Averages of which those over `SCALES[scale]` frames are given, in units of `sigma`."""
    means = np.zeros((len(SCALES), 3))
    means[scale] = mean
    return Window(
        means, frames, np.zeros(3), scatter, frames, np.eye(3) * sigma, last_s - (frames - 1) * step_s, last_s
    )


def records(*windows, **changes):
    return tuple(HeadRecord(used=50, window=one)._replace(**changes) for one in windows)


def spread_of(frames, scale=0):
    """Standard deviation of an average over `SCALES[scale]` frames with exponential weights after some frames."""
    weight = 2.0 / (SCALES[scale] + 1.0)
    weights = weight * (1.0 - weight) ** np.arange(frames)
    return math.sqrt(np.sum(weights**2))


@pytest.mark.parametrize("frames", [8, 40])
@pytest.mark.parametrize("scale", [0, 2])
def test_a_mean_is_compared_with_its_own_scatter(frames, scale):
    sigma = spread_of(frames, scale)
    for length, seen in ((5.5, False), (5.6, True)):
        mean = np.array([0.0, length * sigma, 0.0])
        found = finding(records(window(mean, frames, scale=scale)), 0)
        assert (found is not None) is seen
        assert finding(records(window(mean, 7, scale=scale)), 0) is None
        # a head that scatters 1.5 times as much as stated has means that do
        assert finding(records(window(mean, frames, 1.5, scale)), 0) is None
        assert (finding(records(window(mean, frames, 0.5, scale)), 0) is not None) is seen
    assert found == ((), True, (), min(SCALES[scale], frames) * 1.0)
    assert finding(records(window(mean, frames, scale=scale, step_s=2.0)), 0).duration_s == 2.0 * found.duration_s


def test_heads_whose_means_agree_show_a_motion_of_the_body():
    off = np.array([7.0, 0.0, 0.0]) * spread_of(8)
    assert finding(records(window(off), window(off)), 0).heads == ()
    assert finding(records(window(off), window(off), window(off)), 0).heads == ()
    # of two that differ, either may have moved; the shift is that between them, with the size of the innovations
    found = finding(records(window(off, sigma=2.0), window(np.zeros(3), sigma=2.0)), 0)
    assert found == ((0, 1), False, pytest.approx((2.0 * off[0],) * 2), 8.0)
    # an average that is too short, or of long ago, does not count; one of the same time does
    assert finding(records(window(off), window(np.zeros(3), 3)), 0).heads == ()
    assert finding(records(window(off), window(np.zeros(3), 4)), 0).heads == (0, 1)
    assert finding(records(window(off), window(np.zeros(3), last_s=NOW_S - 8.5)), 0).heads == ()
    assert finding(records(window(off), window(np.zeros(3), last_s=NOW_S - 7.5)), 0).heads == (0, 1)


def test_of_three_heads_the_one_that_differs_has_moved():
    off, still = np.array([7.0, 0.0, 0.0]) * spread_of(8), window(np.zeros(3))
    for k in range(3):
        windows = [still] * 3
        windows[k] = window(off)
        assert finding(records(*windows), k) == ((k,), True, (pytest.approx(off[0]),), 8.0)
    # three that all differ: it waits until the mean is clear, and then any of them may have
    three_ways = (window(off), window(-off), window(np.roll(off, 1)))
    assert finding(records(*three_ways), 0) is None
    found = finding(records(window(1.2 * off), window(-1.2 * off), window(1.2 * np.roll(off, 1))), 0)
    assert (found.heads, found.resolved) == ((0, 1, 2), False)
    total = -1.2 * off + 1.2 * np.roll(off, 1)
    assert found.shift_rad[0] == pytest.approx(np.linalg.norm(1.2 * off - 0.5 * total))
    # the more certain head weighs more
    sure = window(np.roll(off, 1), sigma=0.1)._replace(mean=10.0 * window(np.roll(off, 1)).mean)
    found = finding(records(window(1.2 * off), window(-1.2 * off), sure), 0)
    common = (sure.factor @ sure.mean[0] * 100.0 - 1.2 * off) / 101.0
    assert found.shift_rad[0] == pytest.approx(np.linalg.norm(1.2 * off - common))


def test_averages_after_an_innovation():
    before = Window()
    first = extended(before, Innovation(True, 1.0, 3, np.array([1.0, 0.0, 0.0])), 4.0 * np.eye(3), 5.0)
    np.testing.assert_allclose(first.mean[:, 0], [2.0 / (n + 1.0) for n in SCALES])
    assert (first.frames, first.scatter, first.scatter_frames, first.first_s, first.last_s) == (1, 1.0, 0, 5.0, 5.0)
    np.testing.assert_array_equal(first.factor, 2.0 * np.eye(3))
    second = extended(first, Innovation(True, 9.0, 3, np.array([-2.0, 0.0, 0.0])), np.eye(3), 7.0)
    assert (second.frames, second.scatter_frames, second.first_s, second.last_s) == (2, 1, 5.0, 7.0)
    assert second.scatter == 3.0**2 / 6.0  # the first difference replaces the assumed 1
    third = extended(second, Innovation(True, 4.0, 3, np.array([-2.0, 0.0, 0.0])), np.eye(3), 8.0)
    assert third.scatter == 0.5 * second.scatter
    # the mean of all at first, and with exponential weights over 64 frames in the long run
    for frames, weight in ((9, 0.1), (31, 1.0 / 32.0), (40, 2.0 / 65.0), (500, 2.0 / 65.0)):
        long = extended(
            second._replace(scatter=2.0, scatter_frames=frames), Innovation(True, 1.0, 3, np.ones(3)), np.eye(3), 8.0
        )
        assert long.scatter == pytest.approx(2.0 + weight * ((3.0**2 + 2.0) / 6.0 - 2.0))
    # an outlier is cut, one beyond belief or without a prediction ignored
    cut = extended(before, Innovation(False, 900.0, 3, np.array([0.0, 30.0, 0.0])), np.eye(3), 5.0)
    np.testing.assert_allclose(cut.last, [0.0, 5.5, 0.0])
    for white, distance2 in ((np.ones(3), 1e3), (np.ones(3), math.nan), (None, 1.0)):
        assert extended(before, Innovation(False, distance2, 3, white), np.eye(3), 5.0) is before
    again = restarted(third)
    assert (again.frames, again.scatter, again.scatter_frames) == (0, third.scatter, third.scatter_frames)


def test_noise_that_the_scatter_requires():
    own, wide = np.eye(3), 2.0 * np.eye(3)  # the innovation's variance is four times that of the head

    def factor(scatter, frames=64, noise=1.0, **more):
        return noise_factor(
            HeadRecord(noise=noise, window=Window(scatter=scatter, scatter_frames=frames, factor=wide)), own, **more
        )

    high = chdtri(128, 1e-6) / 128
    assert factor(0.999 * high) == 1.0
    assert factor(1.001 * high) == pytest.approx(1.0 + 4.0 * (1.001 * high - 1.0))
    assert factor(1.001 * high, noise=3.0) == pytest.approx(3.0 + 4.0 * (1.001 * high - 1.0))
    assert factor(1.001 * high, 200) == factor(1.001 * high)  # more frames than are averaged do not count
    assert factor(1.001 * high, 30) == 1.0
    assert factor(100.0, 3) == 1.0
    assert factor(100.0, 4) > 100.0
    assert factor(1e6) == 1e4
    assert factor(chdtri(128, 1e-3) / 128 * 1.001, false_alarm=1e-3) > 1.0
    # a head that scatters less than it was given credit for is believed again, never more than it states
    low = chdtri(128, 0.99) / 128
    assert factor(0.999 * low) == 1.0
    assert factor(0.999 * low, noise=9.0) == pytest.approx(9.0 * 0.999 * low)
    assert factor(1.001 * low, noise=9.0) == 9.0
    assert factor(0.01, noise=9.0) == 1.0


def test_the_spread_of_an_innovation_and_of_an_alignment():
    """A head that is known to 60″ and that moves by 40″ about each of its axes."""
    heads = [three()[0], Head("b", ALONG_Y, 60.0 * ARCSEC, bending_sigma_rad=40.0 * ARCSEC)]
    mekf = mekf_of(heads)
    np.testing.assert_allclose(mekf.alignment_sigma_rad(1), np.full(3, math.hypot(60.0, 40.0) * ARCSEC))
    np.testing.assert_array_equal(mekf.alignment_sigma_rad(0), np.zeros(3))
    noise = np.diag([1.0, 4.0, 9.0]) * SIGMA**2
    matrix = ALONG_Y.as_matrix()
    expected = np.eye(3) * (SIGMA**2 + (60.0**2 + 40.0**2) * ARCSEC**2) + matrix.T @ noise @ matrix
    np.testing.assert_allclose(mekf.innovation_covariance(1, noise), expected, rtol=1e-12, atol=1e-22)


def test_only_attitudes_of_others_after_a_rejected_one_outvote_it():
    """`outvoted` counts those used since the head was last rejected; a head that was not rejected is not outvoted."""
    heads, covariance = three()[:2], np.eye(3) * SIGMA**2
    state = State(0.0, mekf_of(heads), (HeadRecord(used=1),) * 2, (None, None))
    honest = Measurement(0, ALONG_Z @ state.mekf.attitude, covariance)
    after = measured(state, honest, 1e-6)
    assert [one.outvoted for one in after.records] == [0, 0]
    wrong = Measurement(1, turned(ALONG_X @ state.mekf.attitude, [0.1, 0.0, 0.0]), covariance)
    rejected = measured(after, wrong, 1e-6)
    assert [(one.rejected, one.outvoted) for one in rejected.records] == [(0, 0), (1, 0)]
    again = measured(measured(rejected, honest, 1e-6), honest, 1e-6)
    assert [(one.rejected, one.outvoted) for one in again.records] == [(0, 0), (1, 2)]
    good = measured(again, Measurement(1, ALONG_X @ state.mekf.attitude, covariance), 1e-6)
    assert [(one.used, one.rejected, one.outvoted) for one in good.records] == [(4, 0, 0), (2, 0, 0)]


def test_a_motion_known_to_be_of_one_head_stays_that_of_this_head():
    """What follows within its time is attributed to it, though of two heads the means do not show which moves."""
    heads, covariance = three()[:2], np.eye(3) * SIGMA**2
    state = State(NOW_S, mekf_of(heads), (HeadRecord(used=50, used_s=NOW_S),) * 2, (None, None))
    for resolved in (True, False):
        before = list(state.records)
        full = window(np.array([9.0, 0.0, 0.0]) * spread_of(8), sigma=SIGMA)
        before[0] = before[0]._replace(window=full, motion=Shift(1e-6, resolved, NOW_S + 5.0))
        before[1] = before[1]._replace(window=window(np.zeros(3), sigma=SIGMA))
        given = Measurement(0, ALONG_Z @ state.mekf.attitude, covariance)
        found = measured(state._replace(records=tuple(before)), given, 1e-6)
        assert found.records[0].motion.shift_rad > 1e-6
        assert found.records[0].motion.resolved is resolved
        assert (found.records[1].motion is None) is resolved
        assert found.records[0].motion.until_s >= NOW_S + 3600.0


def with_value(processes, head, value):
    return (*processes[:head], processes[head]._replace(value_rad=value), *processes[head + 1 :])


def test_a_mounting_that_bent_returns_to_where_it_was():
    """Its estimated motion falls by e within the stated time, and the mounting by as much as the motion."""
    mekf, moved = mekf_of(three(bending_sigma_rad=1e-4, bending_s=40.0)), np.array([1e-3, -2e-3, 5e-4])
    mekf._bending = with_value(mekf._bending, 1, moved)
    before = mekf.mounting(1)
    mekf.predict(40.0, np.zeros(3))
    expected = turn_quaternion(np.array(before.quat), -(1.0 - math.exp(-1.0)) * moved)
    assert mekf.mounting(1).angle_to(Attitude(expected, "body", "camera")) < 1e-12
    assert mekf.bending_rad(1) == pytest.approx(math.hypot(*moved) / math.e)


def test_an_error_of_a_head_that_stays_is_taken_from_its_attitude():
    error, truth = np.array([2e-3, 1e-3, -3e-3]), Attitude.from_radec_roll(30.0, 40.0, 50.0)
    mekf = mekf_of(three())
    mekf._correlated = with_value(mekf._correlated, 1, error)
    measured = Attitude(turn_quaternion(np.array(truth.quat), error))
    body, _ = mekf._from_head(1, measured, np.eye(3) * SIGMA**2)
    assert (mekf.mounting(1) @ body).angle_to(truth) < 1e-12
