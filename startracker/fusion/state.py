"""What the filter of several heads knows at one time, and what its users see of it. All of it is immutable."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from startracker.core import FloatArray
from startracker.fusion.alignments import AlignedMekf
from startracker.geometry.attitude import Attitude
from startracker.tracking.mekf import Innovation

SCALES = (8, 32, 128, 512)
"""Numbers of frames over which the innovations of a head are averaged: fast motions show in few, slow ones in many."""


MOST_REJECTED = 3
"""Number of rejected attitudes that agree, after which the filter or the head is wrong."""
KNOWN = 10
"""Number of attitudes of a head that were used before it contradicts the others, for it to be the one that changed."""


class Measurement(NamedTuple):
    """Attitude measured by one head."""

    head: int
    attitude: Attitude
    """ICRS to its camera."""
    covariance: FloatArray
    """(3, 3): Of its error in camera axes, rad²."""


class Update(NamedTuple):
    """What a measurement did."""

    outcome: str
    """``started``, ``used``, ``rejected`` (beyond the gate), ``realigned`` (as the mounting of its head has changed),
    ``restarted`` (as the filter was wrong, and not the head), or ``too_late`` (older than the memory)."""
    innovation: Innovation | None = None
    """Comparison with the prediction; None for the first one, and one that is too late."""


class Window(NamedTuple):
    """Whitened innovations of a head, averaged with exponential weights over each of `SCALES`."""

    mean: FloatArray = np.zeros((len(SCALES), 3))
    frames: int = 0
    last: FloatArray = np.zeros(3)
    scatter: float = 1.0
    """Mean of the squares of the differences of successive ones, 1 if the stated noise is that of the head."""
    scatter_frames: int = 0
    factor: FloatArray = np.eye(3)
    """(3, 3): Cholesky factor of the last innovation covariance, body axes, rad."""
    first_s: float = math.nan
    last_s: float = -math.inf


class Shift(NamedTuple):
    """A mounting that is not as stated."""

    shift_rad: float
    """By how much it has moved."""
    resolved: bool
    """Whether other heads, or the prediction that this one had agreed with, show that it is this head that moved."""
    until_s: float
    """Time after which it is forgotten, unless it is seen again."""


class HeadRecord(NamedTuple):
    """History of one head."""

    used: int = 0
    """Number of attitudes that were used."""
    used_s: float = -math.inf
    """Time of the last of them."""
    rejected: int = 0
    """Number of successive attitudes beyond the gate."""
    outvoted: int = 0
    """Number of attitudes of other heads that were used since the first of these."""
    noise: float = 1.0
    """Factor on the stated covariance, as the scatter of the head requires."""
    step: Shift | None = None
    """A change of the alignment."""
    motion: Shift | None = None
    """A motion beyond the stated one."""
    window: Window = Window()


class Candidate(NamedTuple):
    """Another filter, started by an attitude that was rejected."""

    mekf: AlignedMekf
    since_s: float
    heads: frozenset[int]
    """Heads whose rejected attitudes it agrees with."""
    first: Measurement
    """The attitude that it began with."""
    agreeing: int = 1
    """Number of these attitudes."""
    wide: bool = False
    """Whether the gyro's bias, or the rate, was given up."""


class Anchor(NamedTuple):
    """The filter of an earlier time, propagated without measurements since."""

    mekf: AlignedMekf
    since_s: float


class Rival(NamedTuple):
    """The filter without one of several heads that contradict one another."""

    head: int
    mekf: AlignedMekf


class State(NamedTuple):
    """The filter after an event; filters are never modified."""

    t_s: float
    mekf: AlignedMekf | None
    records: tuple[HeadRecord, ...]
    candidates: tuple[Candidate | None, ...]
    """By the head that started them."""
    rivals: tuple[Rival, ...] = ()
    anchors: tuple[Anchor, ...] = ()
    """At most two, the older first."""
    coasting: Anchor | None = None
    """The filter from before a contradiction of heads, which `rivals` are compared with."""
    anchored: int = 0
    """Number of attitudes used since the newer one."""
    update: Update | None = None
    motion_until_s: float = -math.inf
    """Time until which stars and gyro (or the assumed constant rate) are regarded as contradictory."""

    def propagated(self, t_s: float, propagate: Callable[[AlignedMekf], AlignedMekf]) -> State:
        """The state at a later time, with all its filters."""
        assert self.mekf is not None
        candidates = tuple(one and one._replace(mekf=propagate(one.mekf)) for one in self.candidates)
        rivals = tuple(one._replace(mekf=propagate(one.mekf)) for one in self.rivals)
        anchors = tuple(one._replace(mekf=propagate(one.mekf)) for one in self.anchors)
        coasting = self.coasting and self.coasting._replace(mekf=propagate(self.coasting.mekf))
        mekf = propagate(self.mekf)
        return self._replace(
            t_s=t_s, mekf=mekf, candidates=candidates, rivals=rivals, anchors=anchors, coasting=coasting, update=None
        )


class HeadStatus(NamedTuple):
    """Status of one head."""

    state: str
    """``no_attitude``: none was used yet. ``consistent``. ``rejected``: its attitudes are beyond the gate, or the last
    ones were. ``moved``: its alignment has changed by more than stated. ``moving``: its mounting moves more than
    stated. ``noisy``: its attitudes scatter more than stated."""
    shift_rad: float = 0.0
    """How far the mounting is from where it was stated to be; 0 if it is there."""
    noise_factor: float = 1.0
    """Factor on the stated standard deviations."""


class FusionStatus(NamedTuple):
    """Whether the heads and the gyro agree."""

    state: str
    """``no_attitude``. ``consistent``. ``unverified``: nothing contradicts, but the attitudes are too few to show
    whether a mounting whose motion is not stated (`Head.bending_sigma_rad`) moves by more than the covariance says, or
    such a motion is suspected. ``head_flagged``: one head is not as stated, and the others or the gyro show which.
    ``heads_disagree``: heads contradict one another, and nothing shows which one is right: the attitude may be wrong by
    their difference. ``gyro_disagrees``: stars and gyro contradict one another."""
    reason: str
    """One line; empty if consistent."""
    heads: dict[str, HeadStatus]

    @property
    def trusted(self) -> bool:
        """Whether the data show that the attitude is within its covariance."""
        return self.state in ("consistent", "head_flagged")
