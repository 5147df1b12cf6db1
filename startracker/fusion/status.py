"""The status of the filter of several heads in words."""

from __future__ import annotations

import math

import numpy as np

from startracker.core import ARCSEC_RAD
from startracker.fusion.alignments import AlignedMekf
from startracker.fusion.state import KNOWN, MOST_REJECTED, FusionStatus, HeadRecord, HeadStatus, State
from startracker.fusion.windows import contradiction, unseen_shift
from startracker.tracking.mekf import chi_square_limit

_NOISY = 1.5
_FALSE_ALARM = 1e-6
_SUSPICION = 1e-4
"""Probability that the mean innovation of a consistent head exceeds, at one scale, the limit of a suspicion."""
_UNSEEN = math.sqrt(2.0)
"""Largest displacement, in standard deviations of the attitude about one axis, of a motion that need not be seen: a
sine of this amplitude adds 1 to the mean NEES of 3."""


def status_of(state: State, names: tuple[str, ...], t_s: float) -> FusionStatus:
    """Status of the filter at a time, from its state before it."""
    heads = {name: _head(record, t_s) for name, record in zip(names, state.records, strict=True)}
    if state.mekf is None:
        return FusionStatus("no_attitude", "no attitude has reached the filter", heads)
    far = [name for k, name in enumerate(names) if not state.records[k].step and _is_far(state.mekf, k)]
    for name in far:
        shift_rad = math.hypot(*state.mekf.alignment_rad(names.index(name)).tolist())
        heads[name] = heads[name]._replace(state="moved", shift_rad=shift_rad)
    moved = [name for name, one in heads.items() if one.state not in ("consistent", "no_attitude")]
    if not moved and _gyro_fits(state, t_s):
        unverified = _unverified(state)
        return FusionStatus("unverified" if unverified else "consistent", unverified, heads)
    said = [f"head {name} {_words(heads[name])}" for name in moved]
    if far or _disputed(state.records, t_s):
        remedy = "nothing shows which head is right; check the mountings, or state their motion (bending_sigma_rad)"
        return FusionStatus("heads_disagree", "; ".join([*said, remedy]), heads)
    if not _gyro_fits(state, t_s) or _all_rejected(state.records):
        return FusionStatus("gyro_disagrees", "; ".join([*said, _gyro_words(state.mekf)]), heads)
    return FusionStatus("head_flagged", "; ".join([*said, "the other heads and the gyro agree"]), heads)


def _unverified(state: State) -> str:
    """Why a motion of a mounting that is not stated could displace the attitude by more than its covariance says
    without having been seen; empty if it could not, and for a single head, whose mounting defines the axes."""
    mekf, limit = state.mekf, chi_square_limit(3, _SUSPICION)
    assert mekf is not None
    seen = [k for k, record in enumerate(state.records) if record.used]
    windows = [state.records[k].window for k in seen]
    if len(seen) < 2 or all(mekf.heads[k].bending_sigma_rad for k in seen):
        return ""
    if max(contradiction(one) for one in windows) > limit:
        return f"the heads differ more than {1.0 - _SUSPICION:.2%} of consistent ones: a mounting may be moving"
    unseen_rad = unseen_shift(windows, limit)
    if unseen_rad <= _UNSEEN * mekf.uncertainty_rad / math.sqrt(3.0):
        return ""
    return (
        f"a mounting may have moved, and the attitude with it by up to {unseen_rad / ARCSEC_RAD:.2g}″, which so few "
        "attitudes do not show; wait, or state how far mountings move (bending_sigma_rad)"
    )


def _is_far(mekf: AlignedMekf, head: int) -> bool:
    """Whether the alignment of a head is farther from its mounting than its stated standard deviation explains."""
    stated = mekf.heads[head]
    if not stated.alignment_sigma_rad or mekf.bending_sigma_rad(head) > stated.bending_sigma_rad:
        return False
    far2 = float(np.sum(mekf.alignment_rad(head) ** 2))
    return far2 > chi_square_limit(3, _FALSE_ALARM) * (stated.alignment_sigma_rad**2 + stated.bending_sigma_rad**2)


def _head(record: HeadRecord, t_s: float) -> HeadStatus:
    noise = math.sqrt(record.noise)
    shifts = [one for one in (record.step, record.motion) if one is not None and one.until_s >= t_s]
    shift_rad = max((one.shift_rad for one in shifts), default=0.0)
    if record.rejected >= MOST_REJECTED:
        return HeadStatus("rejected", shift_rad, noise)
    if shifts:
        return HeadStatus("moved" if shifts[0] is record.step else "moving", shift_rad, noise)
    if noise > _NOISY:
        return HeadStatus("noisy", 0.0, noise)
    return HeadStatus("no_attitude" if not record.used else "consistent", 0.0, noise)


def _disputed(records: tuple[HeadRecord, ...], t_s: float) -> bool:
    """Whether heads contradict one another without a majority."""
    for record in records:
        for one in (record.step, record.motion):
            if one is not None and one.until_s >= t_s and not one.resolved:
                return True
    trusted = [record for record in records if record.used and not record.rejected]
    return len(trusted) < 2 and any(
        record.rejected >= MOST_REJECTED and record.outvoted and record.used < KNOWN for record in records
    )


def _all_rejected(records: tuple[HeadRecord, ...]) -> bool:
    """Whether the last attitudes of all heads that gave any are rejected."""
    given = [record for record in records if record.used or record.rejected]
    return all(record.rejected >= MOST_REJECTED for record in given)


def _gyro_fits(state: State, t_s: float) -> bool:
    assert state.mekf is not None
    return state.motion_until_s < t_s and state.mekf.bias_excess <= 1.0


def _gyro_words(mekf: AlignedMekf) -> str:
    if not mekf.has_gyro:
        return "the stars do not move as steadily as RateNoise states"
    return "the stars do not move as the gyro says: a picture may be frozen, or the gyro be wrong by more than stated"


def _words(head: HeadStatus) -> str:
    if head.state == "rejected":
        return "contradicts the others"
    if head.state == "noisy":
        return f"scatters {head.noise_factor:.1f} times as much as stated"
    done = "has moved" if head.state == "moved" else "moves"
    return f"{done} by about {head.shift_rad / ARCSEC_RAD:.3g}″ on its mounting, more than stated"
