"""What the filter of several heads believes after an attitude beyond the gate, and after a contradiction within it."""

import math

import numpy as np
import pytest
from moving_heads import ALONG_Y, GYRO, SIGMA, three
from two_heads import ALONG_X, ALONG_Z, ARCSEC, turned

from startracker.fusion import Head
from startracker.fusion.alignments import AlignedMekf
from startracker.fusion.state import Anchor, Candidate, HeadRecord, Measurement, Rival, Shift, State, Update, Window
from startracker.fusion.trust import (
    _alarmed,
    _candidate,
    _counted,
    _doubted,
    _joined,
    _realigned,
    _rejected,
    _restarted,
    _without,
    measured,
)
from startracker.fusion.windows import Finding
from startracker.geometry.attitude import Attitude
from startracker.tracking import RateNoise

NOW_S = 1000.0
START = Attitude([0.0, 0.0, 0.0, 1.0])
NO_GYRO = RateNoise(1e-6, 1e-4)
OFF = (0.01, 0.0, 0.0)
USED = HeadRecord(used=200, used_s=NOW_S - 1.0)
FULL = Window(np.ones((4, 3)), 40, np.ones(3), 1.25, 39)


def mekf_of(heads=None, noise=GYRO, attitude=START):
    return AlignedMekf(three()[:2] if heads is None else heads, 0, attitude, np.eye(3) * SIGMA**2, noise)


def state(mekf, *records, **changes):
    records = records or (USED,) * len(mekf.heads)
    return State(NOW_S, mekf, records, (None,) * len(records), update=Update("rejected"))._replace(**changes)


def shown(mekf, head, off_rad=(0.0, 0.0, 0.0), sigma=SIGMA):
    """What a head measures if it is off by a rotation about the axes of its camera."""
    return Measurement(head, turned(mekf.head_attitude(head), np.asarray(off_rad)), np.eye(3) * sigma**2)


# ---------------------------------------------------------------------- within the gate
@pytest.mark.parametrize(("used", "alignment"), [(64, 0.0), (63, 60.0), (63, 900.0)])
def test_the_filter_is_doubted_by_the_motion_that_it_followed(used, alignment):
    """Covariance × 10, and then the attitude by 2½ times the motion that was seen, the bias by its rate; so are the
    alignments. Motions seen before 64 attitudes of a head that has given any are in the alignments from the start."""
    heads = [Head("a", ALONG_Z), Head("b", ALONG_X, max(alignment, 1.0) * ARCSEC), Head("c", ALONG_Y)]
    mekf = mekf_of(heads)
    records = HeadRecord(used=500), HeadRecord(used=used), HeadRecord()
    found = Finding((0, 1), False, (20.0 * ARCSEC, 30.0 * ARCSEC), 40.0)
    doubted = _doubted(state(mekf, *records), found)
    wrong = max(75.0, alignment) * ARCSEC if used < 64 else 75.0 * ARCSEC
    added = np.zeros(12)
    added[:3], added[3:6], added[6:9], added[9:] = wrong**2, (30.0 * ARCSEC / 40.0) ** 2, 1e-3**2, wrong**2
    np.testing.assert_allclose(doubted.full_covariance, 10.0 * mekf.full_covariance + np.diag(added), rtol=1e-12)
    body = _doubted(state(mekf, *records), Finding((), True, (), 40.0))
    np.testing.assert_allclose(body.full_covariance, 10.0 * mekf.full_covariance, rtol=1e-12)


@pytest.mark.parametrize(("duration_s", "lasts_s"), [(5.0, 300.0), (40.0, 800.0)])
def test_a_motion_of_the_body_raises_the_process_noise(duration_s, lasts_s):
    """Tenfold, to a limit; for twenty times as long as it took to be seen, and five minutes at least."""
    mekf = mekf_of()
    mekf.noise_factor = 3.0
    anchors = (Anchor(mekf, 0.0),)
    rivals = (Rival(0, mekf), Rival(1, mekf))
    now = state(
        mekf, *(USED._replace(window=FULL),) * 2, anchors=anchors, anchored=7, rivals=rivals, coasting=anchors[0]
    )
    after = _alarmed(now, Finding((), True, (), duration_s))
    assert after.mekf.noise_factor == 30.0
    assert mekf.noise_factor == 3.0
    assert after.motion_until_s == NOW_S + lasts_s
    assert (after.anchors, after.anchored, after.rivals, after.coasting) == ((), 0, (), None)
    for record in after.records:
        assert (record.window.frames, record.window.scatter, record.window.scatter_frames) == (0, 1.25, 39)
        assert record.motion is None
    np.testing.assert_allclose(after.mekf.full_covariance, 10.0 * mekf.full_covariance)
    mekf.noise_factor = 2e7
    assert _alarmed(state(mekf), Finding((), True, (), 5.0)).mekf.noise_factor == 1e8


@pytest.mark.parametrize(("duration_s", "lasts_s"), [(5.0, 3600.0), (200.0, 4000.0)])
@pytest.mark.parametrize("resolved", [True, False])
def test_a_motion_of_heads_is_assumed_and_remembered(duration_s, lasts_s, resolved):
    """For twenty times as long as it took, an hour at least. If nothing shows which head it is, the filter of before
    goes on without each of them, and without any."""
    mekf, before = mekf_of(), mekf_of(attitude=turned(START, [1e-6, 0.0, 0.0]))
    anchor = Anchor(before, NOW_S - 1.5 * duration_s)
    heads = (1,) if resolved else (0, 1)
    found = Finding(heads, resolved, (30.0 * ARCSEC, 20.0 * ARCSEC)[: len(heads)], duration_s)
    old = (Rival(0, mekf),)
    now = state(
        mekf, *(USED._replace(window=FULL),) * 2, anchors=(anchor,), rivals=old, coasting=anchor, motion_until_s=5.0
    )
    after = _alarmed(now, found)
    for k in range(2):
        record = after.records[k]
        assert record.window.frames == 0
        if k in heads:
            shift = found.shift_rad[heads.index(k)]
            assert record.motion == Shift(shift, resolved, NOW_S + lasts_s)
            assert after.mekf.bending_sigma_rad(k) == pytest.approx((10.0 if resolved else 1.0) * 2.0 * shift)
        else:
            assert record.motion is None
            assert after.mekf.bending_sigma_rad(k) == 0.0
    assert after.mekf.attitude.angle_to(before.attitude) < 1e-12  # that of before the motion, not the one it changed
    assert after.motion_until_s == 5.0
    assert (after.anchors, after.anchored) == ((), 0)
    if resolved:
        assert (after.rivals, after.coasting) == ((), None)
    else:
        assert after.coasting is anchor
        assert [(one.head, one.mekf) for one in after.rivals] == [(0, before), (1, before)]
    young = _alarmed(now._replace(anchors=(anchor._replace(since_s=NOW_S - 1.4 * duration_s),)), found)
    assert young.rivals == (() if resolved else old)
    assert young.mekf.attitude.angle_to(mekf.attitude) < 1e-12


def test_without_a_gyro_no_rivals_are_kept():
    """Without it nothing says where the body is but the heads themselves."""
    mekf = mekf_of(noise=NO_GYRO)
    now = state(mekf, anchors=(Anchor(mekf, 0.0),))
    after = _alarmed(now, Finding((0, 1), False, (1e-4, 1e-4), 10.0))
    assert (after.rivals, after.coasting) == ((), None)


@pytest.mark.parametrize(
    ("motions", "heads", "resolved"),
    [
        ((None, None), (0, 1), (False, False)),
        ((Shift(1e-4, True, NOW_S), None), (0,), (True,)),
        ((Shift(1e-4, True, NOW_S - 1.0), None), (0, 1), (False, False)),  # forgotten
        ((Shift(1e-4, False, NOW_S), None), (0, 1), (False, False)),
        ((Shift(1e-4, True, NOW_S), Shift(1e-4, True, NOW_S)), (0, 1), (False, False)),
        ((Shift(1e-4, True, NOW_S), Shift(1e-4, False, NOW_S)), (0,), (True,)),
    ],
)
def test_of_heads_that_disagree_the_one_known_to_move_is_to_blame(motions, heads, resolved):
    mekf = mekf_of()
    now = state(mekf, *(USED._replace(motion=one) for one in motions))
    after = _alarmed(now, Finding((0, 1), False, (30.0 * ARCSEC, 20.0 * ARCSEC), 50.0))
    moved = [k for k in range(2) if after.mekf.bending_sigma_rad(k) > 0.0]
    assert tuple(moved) == heads
    assert tuple(after.records[k].motion.resolved for k in heads) == resolved
    for k in heads:
        assert after.records[k].motion.shift_rad == (30.0, 20.0)[k] * ARCSEC
        assert after.records[k].motion.until_s == NOW_S + 3600.0


@pytest.mark.parametrize(
    ("was", "resolved"),
    [
        (None, True),
        (Shift(1e-4, True, NOW_S), True),
        (Shift(1e-4, False, NOW_S), False),  # it was in doubt, and may be another one's still
        (Shift(1e-4, False, NOW_S - 1.0), True),
    ],
)
def test_a_motion_in_doubt_stays_so_while_it_is_remembered(was, resolved):
    mekf = mekf_of()
    mekf.bend(1, 1e-5, 100.0, at_once_rad=1.0)
    mekf.update_head(*shown(mekf, 1, (4e-4, 0.0, 0.0)))
    seen_rad = mekf.bending_rad(1)
    after = _alarmed(state(mekf, USED, USED._replace(motion=was)), Finding((1,), True, (1e-4,), 9.0))
    assert after.records[1].motion == Shift(pytest.approx(seen_rad, rel=1e-6), resolved, NOW_S + 3600.0)
    assert seen_rad > 2e-4


# ---------------------------------------------------------------------- beyond the gate
def test_other_filters_take_only_what_they_agree_with():
    mekf = mekf_of()
    candidate = Candidate(mekf, NOW_S, frozenset({0}), shown(mekf, 0), 2)
    assert _joined(candidate, shown(mekf, 1, (1.0, 0.0, 0.0)), 1e-6) is candidate
    after = _joined(candidate, shown(mekf, 1, (1e-6, 0.0, 0.0)), 1e-6)
    assert (after.heads, after.agreeing, after.since_s) == ({0, 1}, 3, NOW_S)
    assert np.trace(after.mekf.full_covariance) < np.trace(mekf.full_covariance)
    assert after.first is candidate.first


def test_rivals_take_what_is_not_of_their_head():
    mekf = mekf_of()
    rivals = _without((Rival(0, mekf), Rival(1, mekf)), shown(mekf, 1, (1e-5, 0.0, 0.0)))
    assert rivals[1].mekf is mekf
    expected = mekf.copy()
    expected.update_head(*shown(mekf, 1, (1e-5, 0.0, 0.0)))
    np.testing.assert_array_equal(rivals[0].mekf.full_covariance, expected.full_covariance)
    np.testing.assert_array_equal(rivals[0].mekf.quat, expected.quat)
    assert [one.head for one in rivals] == [0, 1]


def test_records_after_an_attitude_that_was_used():
    records = HeadRecord(used=3), HeadRecord(used=4, rejected=2, outvoted=5), HeadRecord(used=7, rejected=1, outvoted=1)
    mine = records[1]._replace(noise=2.0)
    after = _counted(records, 1, mine, 77.0)
    assert after[0] is records[0]
    assert after[1] == mine._replace(used=5, used_s=77.0, rejected=0, outvoted=0)
    assert after[2] == records[2]._replace(outvoted=2)


@pytest.mark.parametrize(
    ("before", "off_s", "second"),
    [
        (None, 2.0, None),  # the bias is believed, with its covariance
        ("narrow", 2.0, GYRO.bias_sigma_rad_s),
        ("wide", 2.0, 0.005),  # 0.01 rad since the last attitude of any head, 2 s ago
        ("wide", 1e3, GYRO.bias_sigma_rad_s),
        ("static", 2.0, GYRO.bias_sigma_rad_s),
    ],
)
def test_a_filter_that_begins_with_a_rejected_attitude(before, off_s, second):
    """Its bias is as uncertain as it was, then as stated, and then as the difference, if the picture moves."""
    mekf = mekf_of()
    mekf.predict(5.0, [0.001, 0.002, -0.001])
    for _ in range(3):
        mekf.update_head(*shown(mekf, 0))
    records = HeadRecord(used=9, used_s=NOW_S - 50.0), HeadRecord(used=9, used_s=NOW_S - off_s)
    if off_s > 50.0:
        records = records[1], records[1]
    given = shown(mekf, 1, OFF)
    first = given if before == "static" else shown(mekf, 1, (0.02, 0.0, 0.0))
    old = None if before is None else Candidate(mekf, 0.0, frozenset({1}), first, wide=before != "narrow")
    found = _candidate(state(mekf, *records), given, old)
    expected = mekf.copy()
    expected.restart(*given, second)
    np.testing.assert_allclose(found.mekf.full_covariance, expected.full_covariance, rtol=1e-9)
    assert found.mekf.head_attitude(1).angle_to(given.attitude) < 1e-12
    assert (found.since_s, found.heads, found.first, found.agreeing) == (NOW_S, {1}, given, 1)
    assert found.wide is (before is not None)


@pytest.mark.parametrize(
    ("before", "outvoted", "second"),
    [
        (False, 0, 0.005),  # an assumed rate is not believed
        (False, 1, None),  # unless another head has just confirmed it
        (True, 1, 0.005),
    ],
)
def test_a_filter_without_a_gyro_that_begins_with_a_rejected_attitude(before, outvoted, second):
    mekf = mekf_of(noise=NO_GYRO)
    given, old = shown(mekf, 1, OFF), Candidate(mekf, 0.0, frozenset({1}), shown(mekf, 1), wide=False)
    records = HeadRecord(used=9, used_s=NOW_S - 50.0), HeadRecord(used=9, used_s=NOW_S - 2.0, outvoted=outvoted)
    found = _candidate(state(mekf, *records), given, old if before else None)
    expected = mekf.copy()
    expected.restart(*given, second)
    np.testing.assert_allclose(found.mekf.full_covariance, expected.full_covariance, rtol=1e-9)
    assert found.wide is (second is not None)


def test_two_attitudes_at_one_time_are_a_millisecond_apart():
    mekf = mekf_of(noise=NO_GYRO)
    records = HeadRecord(used=9, used_s=NOW_S), HeadRecord(used=9, used_s=NOW_S)
    found = _candidate(state(mekf, *records), shown(mekf, 1, OFF), None)
    np.testing.assert_allclose(np.diag(found.mekf.full_covariance)[3:6], 10.0**2, rtol=1e-6)


def test_a_restart_counts_for_the_heads_that_agree():
    """Of the others only the averages begin again."""
    mekf = mekf_of(three())
    mounted = Shift(1e-3, True, math.inf)
    records = tuple(
        HeadRecord(used=5 + k, used_s=9.0, rejected=3, outvoted=2, step=mounted, window=FULL) for k in range(3)
    )
    other = mekf_of(three(), attitude=turned(START, OFF))
    now = state(mekf, *records, motion_until_s=NOW_S + 9.0, anchors=(Anchor(mekf, 1.0),), anchored=3)
    after = _restarted(now, Candidate(other, 0.0, frozenset({0, 2}), shown(other, 0), 3))
    assert after.mekf is other
    assert [one.used for one in after.records] == [6, 6, 8]
    assert [one.used_s for one in after.records] == [NOW_S, 9.0, NOW_S]
    assert [(one.rejected, one.outvoted) for one in after.records] == [(0, 0), (3, 2), (0, 0)]
    assert [(one.window.frames, one.window.scatter_frames, one.step) for one in after.records] == [(0, 39, mounted)] * 3
    assert after.update.outcome == "restarted"
    assert (after.candidates, after.anchors, after.anchored, after.rivals) == ((None,) * 3, (), 0, ())


@pytest.mark.parametrize(
    ("used", "others", "step", "resolved"),
    [
        (10, 1, None, True),  # the head was known
        (9, 1, None, False),
        (9, 2, None, True),  # two others agree
        (10, 1, Shift(1.0, False, math.inf), False),  # it was in doubt before
        (10, 1, Shift(1.0, True, math.inf), True),
        (9, 1, Shift(1.0, True, math.inf), False),
    ],
)
def test_a_mounting_that_has_jumped(used, others, step, resolved):
    """Its alignment is estimated again, with an uncertainty of the jump, which is remembered for good."""
    mekf = mekf_of(three()[: others + 1])
    given = shown(mekf, others, OFF)
    records = [USED] * others + [HeadRecord(used=used, used_s=3.0, rejected=2, outvoted=4, step=step, window=FULL)]
    candidate = Candidate(mekf, 0.0, frozenset({0}), given)
    now = state(mekf, *records, candidates=(candidate,) * (others + 1), anchors=(Anchor(mekf, 1.0),), anchored=3)
    after = _realigned(now, given, 1e-6)
    record = after.records[others]
    assert record.step == Shift(pytest.approx(0.01, rel=1e-6), resolved, math.inf)
    assert (record.used, record.used_s, record.rejected, record.outvoted) == (used + 1, NOW_S, 0, 0)
    assert (record.window.frames, record.window.scatter_frames) == (0, 39)
    assert after.candidates == (*[candidate] * others, None)
    assert after.update.outcome == "realigned"
    assert after.update.innovation.accepted
    assert (after.anchors, after.anchored) == ((), 0)
    np.testing.assert_allclose(after.mekf.alignment_rad(others), OFF, rtol=1e-3, atol=1e-6)
    # others that were themselves rejected, or that have given nothing, do not count
    if used == 9 and others == 2:
        for worse in (USED._replace(rejected=1), HeadRecord()):
            doubtful = _realigned(now._replace(records=(worse, *records[1:])), given, 1e-6)
            assert doubtful.records[2].step.resolved is False
    # an attitude that even then does not fit changes nothing
    assert _realigned(now, given, 0.999) is now


def agreeing(mekf, given, heads, count, since_s=NOW_S - 5.0, wide=False):
    """A filter that has the rejected attitudes of some heads, and will have the next."""
    other = mekf.copy()
    other.restart(*given, None)
    return Candidate(other, since_s, frozenset(heads), given, count, wide)


@pytest.mark.parametrize(
    ("heads", "count", "used_s", "outvoted", "wide", "outcome"),
    [
        ((1,), 1, NOW_S - 9.0, 0, False, "rejected"),  # two, and three are needed
        ((1,), 2, NOW_S - 9.0, 0, False, "restarted"),
        ((1,), 2, NOW_S - 9.0, 1, False, "realigned"),  # others outvoted it
        ((1,), 2, NOW_S - 5.0, 0, False, "realigned"),  # one other was used since: as many against it as for
        ((1,), 2, NOW_S - 5.0, 0, True, "rejected"),  # with any rate it fits anything
        ((1,), 2, NOW_S - 9.0, 0, True, "restarted"),
        ((1, 2), 2, NOW_S - 5.0, 1, False, "restarted"),  # two against one
        ((1, 2), 1, NOW_S - 5.0, 1, False, "rejected"),
    ],
)
def test_whether_the_filter_or_the_head_is_wrong(heads, count, used_s, outvoted, wide, outcome):
    mekf = mekf_of(three())
    given = shown(mekf, 1, OFF)
    records = (
        HeadRecord(used=50, used_s=used_s),
        HeadRecord(used=50, used_s=NOW_S - 20.0, rejected=2, outvoted=outvoted),
        HeadRecord(used=50, used_s=NOW_S - 20.0),
    )
    candidates = (None, agreeing(mekf, given, heads, count, wide=wide), None)
    after = _rejected(state(mekf, *records, candidates=candidates), given, 1e-6)
    assert after.update.outcome == outcome
    if outcome == "rejected":
        assert after.candidates[1].agreeing == count + 1
        assert after.mekf is mekf


def test_of_candidates_the_one_of_more_heads_is_best():
    """And of as many heads the one with more attitudes; others do not lose theirs."""
    mekf = mekf_of(three())
    given = shown(mekf, 1, OFF)
    records = (HeadRecord(used=50, used_s=NOW_S - 5.0),) + (HeadRecord(used=50, used_s=NOW_S - 20.0, outvoted=1),) * 2
    alone, both = agreeing(mekf, given, (1,), 7), agreeing(mekf, given, (2,), 2)
    after = _rejected(state(mekf, *records, candidates=(None, alone, both)), given, 1e-6)
    assert after.update.outcome == "restarted"
    assert [one.rejected for one in after.records] == [0, 0, 0]
    assert [one.used for one in after.records] == [50, 51, 51]
    fresh = _rejected(state(mekf, *records), given, 1e-6)
    assert [one is None for one in fresh.candidates] == [True, False, True]
    assert (fresh.candidates[1].agreeing, fresh.candidates[1].wide) == (1, False)
    elsewhere = agreeing(mekf, shown(mekf, 1, (0.5, 0.0, 0.0)), (1,), 2)
    again = _rejected(state(mekf, *records, candidates=(None, elsewhere, None)), given, 1e-6)
    assert (again.candidates[1].agreeing, again.candidates[1].wide) == (1, True)
    assert again.update.outcome == "rejected"


# ---------------------------------------------------------------------- noise
def test_a_head_that_scatters_more_than_stated():
    """The filter that believed it is distrusted as much, a hundredfold at most; its averages begin again; the excess
    process noise falls by a 256th with every attitude that is used."""
    mekf = mekf_of()
    mekf.noise_factor = 257.0
    loud = Window(np.zeros((4, 3)), 40, np.zeros(3), 9.0, 64, np.eye(3) * SIGMA * math.sqrt(2.0), 0.0, NOW_S)
    given = shown(mekf, 0)
    for scatter, most in ((9.0, 100.0), (900.0, 100.0)):
        record = USED._replace(window=loud._replace(scatter=scatter, last=np.full(3, math.sqrt(2.0 * scatter))))
        after = measured(state(mekf, record, USED), given, 1e-6)
        noise = after.records[0].noise
        assert noise > 5.0
        assert after.mekf.noise_factor == 256.0
        used = mekf.copy()
        used.update_head(*given)
        np.testing.assert_allclose(after.mekf.full_covariance, min(noise, most) * used.full_covariance, rtol=1e-9)
        assert after.records[0].window.frames == after.records[0].window.scatter_frames == 0
        assert after.update.outcome == "used"
    quiet = USED._replace(noise=4.0, window=loud._replace(scatter=0.2, last=np.zeros(3)))
    after = measured(state(mekf, quiet, USED), given, 1e-6)
    used = mekf.copy()
    used.update_head(0, given.attitude, 4.0 * given.covariance)
    assert after.records[0].noise == 1.0
    np.testing.assert_allclose(after.mekf.full_covariance, used.full_covariance, rtol=1e-9)
