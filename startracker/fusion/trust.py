"""What the filter of several heads does with an attitude: use it, reject it, or doubt the head, the gyro or itself.

An attitude beyond the gate is rejected. It also starts another filter, a candidate, or is added to those of earlier
rejected attitudes that it agrees with. When three attitudes agree with a candidate, either the filter is wrong or the
head that started it is. More heads agreeing with the candidate than with the filter since then restart the filter;
otherwise the mounting of the head has changed, and its alignment is estimated again. A head that others outvoted never
restarts the filter, whatever becomes of the others: its history is kept. Attitudes that do not agree with one another
and with the gyro, such as those of a frozen picture while the body rotates, do neither.

Within the gate, the averages of `windows` show motions of the mountings and noise beyond what is stated. The filter
then assumes a motion of the size that was seen, of one head if it is known which, and otherwise of all of them, the
first one included.
"""

from __future__ import annotations

import math
from typing import TypeGuard

import numpy as np

from startracker.fusion.alignments import AlignedMekf
from startracker.fusion.state import (
    KNOWN,
    MOST_REJECTED,
    Anchor,
    Candidate,
    HeadRecord,
    Measurement,
    Rival,
    Shift,
    State,
    Update,
    Window,
)
from startracker.fusion.windows import Finding, extended, finding, noise_factor, restarted
from startracker.tracking.mekf import GyroNoise, chi_square_limit, rotation_between

_LEAST_STEP_S = 1e-3
_LOSE_CONFIDENCE = 10.0
"""Factor on the covariance when a contradiction is found, as part of it is already in the state."""
_REMEMBERED = 20.0
_LEAST_REMEMBERED_S, _BODY_REMEMBERED_S = 3600.0, 300.0
"""A motion is assumed for 20 times as long as it took to be found, and at least so long."""
_LARGEST_FACTOR = 1e8
_LARGEST_RAD = math.radians(1.0)
"""Largest motion of a mounting that is assumed: one that moves farther is not one."""
_ANCHOR_FRAMES = 32
"""Number of attitudes of each head after which the filter is kept."""
_BEFORE = 1.5
"""A contradiction has begun this many times its averaging time before it is found."""
_UNSTEADY = 1e-3
"""Probability of the scatter of a head by which a motion of the body is attributed to its noise instead."""
_FADE = 1.0 / 256.0
"""Fraction by which the excess process noise is reduced with every attitude that is used."""
_STILL = 1e-4
"""Probability that the errors of two attitudes of a frozen picture differ by more than the limit."""
_MOST_DISTRUST = 100.0
_OF_ESTIMATE = 1.5
"""Ratio of the assumed standard deviation of a motion to the motion that is estimated."""
_ABSORBED = 2.5
"""Ratio of the displacement of the attitude by a steady motion of a mounting to the mean innovation that shows it: the
innovations are what the filter has not followed yet."""
_FREE = 10.0
"""Ratio of the standard deviation of a motion that need not come back to that of one that does."""
_AGREE, _CONTRADICT = 0.05, 1e-6
"""Probabilities of χ² for heads that agree with the gyro, and that do not."""


def measured(now: State, given: Measurement, gate: float) -> State:
    """State after a measurement.

    Parameters
    ----------
    now : State
        State at the time of the measurement, with an attitude.
    given : Measurement
        The measurement.
    gate : float
        Probability that the gate rejects a correct attitude.
    """
    head, t_s, mekf = given.head, now.t_s, now.mekf
    assert mekf is not None
    mekf = _forgetting(mekf, now.records, t_s)
    record = now.records[head]
    noisy = given._replace(covariance=given.covariance * record.noise)
    after = mekf.copy()
    innovation = after.update_head(*noisy, gate)
    spread = mekf.innovation_covariance(head, noisy.covariance)
    record = record._replace(window=extended(record.window, innovation, spread, t_s))
    found = finding((*now.records[:head], record, *now.records[head + 1 :]), head)
    # a filter that believes a noisy head wanders, as if the body did: the noise is sought first, and then less strictly
    unsteady = found is not None and not found.heads
    noise = noise_factor(record, given.covariance, *((_UNSTEADY,) if unsteady else ()))
    if noise != record.noise:
        if noise > record.noise:
            after.distrust(min(noise / record.noise, _MOST_DISTRUST))
        record, found = record._replace(noise=noise, window=Window()), None
    state = now._replace(rivals=_without(now.rivals, noisy))
    if innovation.accepted:
        after.noise_factor += _FADE * (1.0 - after.noise_factor)
        records = _counted(now.records, head, record, t_s)
        kept = tuple(None if k == head else one for k, one in enumerate(now.candidates))
        state = state._replace(mekf=after, records=records, candidates=kept, update=Update("used", innovation))
        state = _anchored(state)
    else:
        record = record._replace(rejected=record.rejected + 1)
        records = (*now.records[:head], record, *now.records[head + 1 :])
        state = state._replace(mekf=mekf, records=records, update=Update("rejected", innovation))
        state = _rejected(state, noisy, gate)
    state = _decided(state)
    restarts = state.update is not None and state.update.outcome in ("restarted", "realigned")
    return _followed(state) if found is None or restarts else _alarmed(state, found)


def _anchored(state: State) -> State:
    """Keep the filter from time to time, so that it is known how it was before a contradiction began."""
    assert state.mekf is not None
    if state.anchored + 1 < _ANCHOR_FRAMES * len(state.records) and state.anchors:
        return state._replace(anchored=state.anchored + 1)
    return state._replace(anchors=(*state.anchors[-1:], Anchor(state.mekf, state.t_s)), anchored=0)


def _before(state: State, found: Finding) -> Anchor | None:
    """The filter from before a contradiction of heads began, which has changed the state since; None if not known."""
    begun_s = state.t_s - _BEFORE * found.duration_s
    earlier = [one for one in state.anchors if one.since_s <= begun_s]
    return earlier[-1] if earlier and found.heads else None


def _doubted(state: State, found: Finding) -> AlignedMekf:
    """The filter with less confidence, as the contradiction has changed its state, the gyro's bias first."""
    assert state.mekf is not None
    mekf = state.mekf.copy()
    mekf.distrust(_LOSE_CONFIDENCE)
    if found.heads:
        wrong_rad = _ABSORBED * max(found.shift_rad)
        if min(record.used for record in state.records if record.used) < 2 * _ANCHOR_FRAMES:
            # the alignments were not known before the motion began, and have absorbed a part of it
            wrong_rad = max(wrong_rad, *(head.alignment_sigma_rad for head in mekf.heads))
        mekf.doubt(wrong_rad, max(found.shift_rad) / found.duration_s)
        for k, head in enumerate(mekf.heads):
            if head.alignment_sigma_rad:
                mekf.realign(k, wrong_rad)
    return mekf


def _counted(records: tuple[HeadRecord, ...], head: int, record: HeadRecord, t_s: float) -> tuple[HeadRecord, ...]:
    """Records after an attitude that was used."""
    mine = record._replace(used=record.used + 1, used_s=t_s, rejected=0, outvoted=0)
    return tuple(
        mine if k == head else one._replace(outvoted=one.outvoted + 1) if one.rejected else one
        for k, one in enumerate(records)
    )


def _forgetting(mekf: AlignedMekf, records: tuple[HeadRecord, ...], t_s: float) -> AlignedMekf:
    """The filter with the stated motion of the heads whose own has not been seen for long."""
    for k, record in enumerate(records):
        stated = mekf.heads[k]
        over = record.motion is not None and t_s > record.motion.until_s
        if over and mekf.bending_sigma_rad(k) != stated.bending_sigma_rad:
            mekf = mekf.copy()
            mekf.bend(k, stated.bending_sigma_rad, stated.bending_s)
    return mekf


# ---------------------------------------------------------------------- beyond the gate
def _rejected(state: State, given: Measurement, gate: float) -> State:
    """State after an attitude that was rejected: whether its head, or the filter, is wrong."""
    head = given.head
    candidates = [_joined(one, given, gate) if one is not None else None for one in state.candidates]
    own, old = candidates[head], state.candidates[head]
    if own is None or own is old:  # the first, or not where its earlier ones and the gyro say
        own = candidates[head] = _candidate(state, given, own)
    state = state._replace(candidates=tuple(candidates))
    record = state.records[head]
    best = max((c for c in candidates if c is not None and head in c.heads), key=lambda c: (len(c.heads), c.agreeing))
    if best.agreeing < MOST_REJECTED:
        return state
    against = [k for k, one in enumerate(state.records) if one.used_s >= best.since_s]
    if len(best.heads) > len(against) and (len(best.heads) > 1 or not record.outvoted):
        return _restarted(state, best)
    if own.agreeing >= MOST_REJECTED and not own.wide and (record.outvoted or against):
        return _realigned(state, given, gate)
    return state


def _joined(candidate: Candidate, given: Measurement, gate: float) -> Candidate:
    """A candidate with one more attitude, or itself if they do not agree."""
    after = candidate.mekf.copy()
    if not after.update_head(*given, gate).accepted:
        return candidate
    return candidate._replace(mekf=after, heads=candidate.heads | {given.head}, agreeing=candidate.agreeing + 1)


def _candidate(state: State, given: Measurement, before: Candidate | None) -> Candidate:
    """A filter that begins with an attitude that the candidate before, if any, does not agree with.

    The gyro is believed at first. If the next attitude does not fit, its bias is as uncertain as it was stated to be;
    and if that does not suffice, as their difference, provided that the picture moves: one that is static while the
    gyro shows a rotation is an old one. A rate that was only assumed to be constant is not believed, unless other heads
    just confirmed it.
    """
    mekf = state.mekf
    assert mekf is not None
    noise, second, wide = mekf.noise, None, before is not None
    off_rad = mekf.head_attitude(given.head).angle_to(given.attitude)
    off_rad_s = off_rad / max(state.t_s - max(record.used_s for record in state.records), _LEAST_STEP_S)
    if isinstance(noise, GyroNoise):
        second = noise.bias_sigma_rad_s if wide else None
        if before is not None and before.wide and not _is_static(before.first, given):
            second = max(noise.bias_sigma_rad_s, off_rad_s)
    elif wide or not state.records[given.head].outvoted:
        second, wide = max(noise.rate_sigma_rad_s, off_rad_s), True
    started = mekf.copy()
    started.restart(*given, second)
    return Candidate(started, state.t_s, frozenset({given.head}), given, wide=wide)


def _is_static(first: Measurement, second: Measurement) -> bool:
    """Whether two attitudes of a head are the same to within their errors."""
    turn = rotation_between(first.attitude.quat, second.attitude.quat)
    distance2 = float(turn @ np.linalg.solve(first.covariance + second.covariance, turn))
    return distance2 < chi_square_limit(3, _STILL)


def _restarted(state: State, best: Candidate) -> State:
    """The candidate becomes the filter; heads that agreed with the old one, and not with it, are as if rejected."""
    assert state.update is not None
    records = tuple(
        record._replace(used_s=state.t_s, used=record.used + 1, rejected=0, outvoted=0, window=restarted(record.window))
        if k in best.heads
        else record._replace(window=restarted(record.window))
        for k, record in enumerate(state.records)
    )
    nothing = (None,) * len(records)
    update = state.update._replace(outcome="restarted")
    return State(state.t_s, best.mekf, records, nothing, update=update)


def _realigned(state: State, given: Measurement, gate: float) -> State:
    """The alignment of the head is estimated again, as its attitudes agree with one another and with the gyro."""
    assert state.mekf is not None
    assert state.update is not None
    head, record = given.head, state.records[given.head]
    after = state.mekf.copy()
    shift_rad = after.head_attitude(head).angle_to(given.attitude)
    after.realign(head, shift_rad)
    innovation = after.update_head(*given, gate)
    if not innovation.accepted:
        return state
    others = sum(one.used_s > -math.inf and not one.rejected for k, one in enumerate(state.records) if k != head)
    resolved = record.used >= KNOWN or others > 1
    if record.step is not None:
        resolved = resolved and record.step.resolved
    record = record._replace(step=Shift(shift_rad, resolved, math.inf), window=restarted(record.window))
    records = _counted(state.records, head, record, state.t_s)
    candidates = tuple(None if k == head else one for k, one in enumerate(state.candidates))
    update = Update("realigned", innovation)
    return state._replace(mekf=after, records=records, candidates=candidates, update=update, anchors=(), anchored=0)


# ---------------------------------------------------------------------- within the gate, but not as stated
def _alarmed(state: State, found: Finding) -> State:
    """State after innovations that contradict the filter: a motion of mountings, or of the body, is assumed."""
    assert state.mekf is not None
    active = [k for k in found.heads if _is_active(state.records[k].motion, state.t_s)]
    known = [k for k in active if _is_resolved(state.records[k])]
    if len(known) == 1 and not found.resolved:
        shift_rad = found.shift_rad[found.heads.index(known[0])]
        found = found._replace(heads=(known[0],), resolved=True, shift_rad=(shift_rad,))
    before = _before(state, found)
    mekf = _doubted(state, found) if before is None else before.mekf
    least_s = _LEAST_REMEMBERED_S if found.heads else _BODY_REMEMBERED_S
    until_s = state.t_s + max(_REMEMBERED * found.duration_s, least_s)
    records = [record._replace(window=restarted(record.window)) for record in state.records]
    fresh = state._replace(anchors=(), anchored=0)
    if not found.heads:
        mekf.noise_factor = min(mekf.noise_factor * _LOSE_CONFIDENCE, _LARGEST_FACTOR)
        return fresh._replace(mekf=mekf, records=tuple(records), motion_until_s=until_s, rivals=(), coasting=None)
    if found.resolved:
        fresh = fresh._replace(rivals=(), coasting=None)
    elif before is not None and mekf.has_gyro:
        fresh = fresh._replace(rivals=tuple(Rival(k, mekf) for k in found.heads), coasting=before)
    for k, shift_rad in zip(found.heads, found.shift_rad, strict=True):
        mekf = _bent(mekf, k, shift_rad, found.duration_s, found.resolved)
        was = records[k].motion
        resolved = found.resolved and (not _is_active(was, state.t_s) or _is_resolved(records[k]))
        records[k] = records[k]._replace(motion=Shift(max(shift_rad, mekf.bending_rad(k)), resolved, until_s))
    return fresh._replace(mekf=mekf, records=tuple(records))


def _is_active(shift: Shift | None, t_s: float) -> TypeGuard[Shift]:
    return shift is not None and shift.until_s >= t_s


def _is_resolved(record: HeadRecord) -> bool:
    return record.motion is not None and record.motion.resolved


def _bent(mekf: AlignedMekf, head: int, shift_rad: float, duration_s: float, resolved: bool) -> AlignedMekf:
    """The filter with a larger motion of a mounting: at least that seen, and twice the one assumed so far.

    The mounting of a head that is known to be the one that moves need not come back: its process diffuses as fast, but
    hardly returns to zero. Otherwise its mean position would continue to define the axes of the body, and those
    alignments that were learned while it moved would follow it.
    """
    after = mekf.copy()
    before_rad = mekf.bending_sigma_rad(head)
    sigma_rad = max(2.0 * shift_rad, 2.0 * before_rad, _OF_ESTIMATE * mekf.bending_rad(head))
    correlation_s = max(4.0 * duration_s, mekf.bending_s(head) if before_rad else 0.0)
    sigma_rad = min(sigma_rad, max(_LARGEST_RAD, before_rad))
    free = _FREE if resolved else 1.0
    after.bend(head, free * sigma_rad, free**2 * correlation_s, at_once_rad=sigma_rad)
    return after


def _followed(state: State) -> State:
    """The motion that is assumed is at least as large as the one that is estimated by now."""
    assert state.mekf is not None
    mekf, records = state.mekf, list(state.records)
    for k, record in enumerate(state.records):
        if _is_active(record.motion, state.t_s):
            mekf, seen_rad = _at_least_as_seen(mekf, k), mekf.bending_rad(k)
            if seen_rad > record.motion.shift_rad:
                records[k] = record._replace(motion=record.motion._replace(shift_rad=seen_rad))
    return state._replace(mekf=mekf, records=tuple(records))


def _at_least_as_seen(mekf: AlignedMekf, head: int) -> AlignedMekf:
    """The filter with a motion of a mounting not smaller than the one that it estimates."""
    seen_rad = mekf.bending_rad(head)
    if not mekf.bending_sigma_rad(head) < seen_rad < _LARGEST_RAD:
        return mekf
    after = mekf.copy()
    after.bend(head, _OF_ESTIMATE * seen_rad, after.bending_s(head), at_once_rad=0.5 * seen_rad)
    return after


# ---------------------------------------------------------------------- which of the heads it is
def _without(rivals: tuple[Rival, ...], given: Measurement) -> tuple[Rival, ...]:
    """The rivals after a measurement, which the one without its head does not use."""
    after = []
    for one in rivals:
        mekf = one.mekf
        if one.head != given.head:
            mekf = mekf.copy()
            mekf.update_head(*given)
        after.append(one._replace(mekf=mekf))
    return tuple(after)


def _decided(state: State) -> State:
    """The head without which the others agree with the gyro, if they do so without no other one, is that which moves.

    The difference between a rival and the filter that was only propagated since before the contradiction has the
    covariance of the latter, or less, if the heads of the rival are as stated: χ² of the six states of attitude and
    bias.
    """
    coasting = state.coasting
    if coasting is None or len(state.rivals) < 2:
        return state
    bent = state.mekf
    assert bent is not None
    chi2 = {one.head: _distance2(coasting.mekf, one.mekf) for one in state.rivals}
    fitting = [k for k, value in chi2.items() if value < chi_square_limit(6, _AGREE)]
    contradicting = [k for k, value in chi2.items() if value > chi_square_limit(6, _CONTRADICT)]
    if len(fitting) != 1 or len(contradicting) != len(chi2) - 1:
        return state
    head = fitting[0]
    mekf = next(one.mekf for one in state.rivals if one.head == head).copy()
    records = []
    for k, record in enumerate(state.records):
        motion = record.motion
        if motion is not None:
            motion = motion._replace(resolved=True) if k == head else None
        if motion is not None:
            mekf.bend(k, max(motion.shift_rad, 1e-9), bent.bending_s(k), at_once_rad=2.0 * motion.shift_rad)
        records.append(record._replace(motion=motion, window=restarted(record.window)))
    return state._replace(mekf=mekf, records=tuple(records), rivals=(), coasting=None)


def _distance2(expected: AlignedMekf, found: AlignedMekf) -> float:
    """χ² of the difference of two filters in attitude and bias, with the covariance of the first."""
    turn = rotation_between(expected.quat, found.quat)
    difference = np.concatenate([turn, found.bias_rad_s - expected.bias_rad_s])
    return float(difference @ np.linalg.solve(expected.covariance, difference))
