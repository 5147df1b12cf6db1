"""Hypotheses of an identification in integers: verified attitudes, the strongest first, and their acceptance.

The rules are those of `startracker.identification.acceptance`. Whatever makes the hypotheses (`candidates`, `triads`)
gives attitudes to a `Work`. The C (`c/tracker_search.c`, `c/tracker_pair.c`) performs the same operations.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker.core import IntArray
from startracker.fixed_point.evidence import LOG_BITS, NEVER
from startracker.fixed_point.vectors import cross, normalized
from startracker.flight.apparent import FlightObserver
from startracker.flight.evidence import LOG_UP, Sight, log_down, log_sum_up
from startracker.flight.search_plan import Search
from startracker.flight.search_tables import DIRECTION_BITS, SearchTables
from startracker.flight.verifying import Verified, verify
from startracker.flight.votes import Stars

KEPT = 8
"""Hypotheses that are kept."""
LEAST_EVIDENCE = -29545
"""log₂ e⁻⁵."""
SURE_BEYOND = 88640
"""15 / ln 2: margin to the limit beyond which no other attitude can compete."""
LARGEST_VARIANCE = 1 << 42
_LOG_SIX_PI = 17352
"""log₂ 6π, rounded down."""
_ONE_RADIAN = 1 << 28


class Reason(IntEnum):
    """In the order of `enum tracker_reason`."""

    ACCEPTED = 0
    NOTHING_FOUND = 1
    FEW_FOUND = 2
    NO_HYPOTHESIS = 3
    WEAK_EVIDENCE = 4
    ABOVE_RATE = 5
    RIVAL = 6
    POSE_FAILED = 7
    STEPS_USED_UP = 8
    ROWS_MISSING = 9
    FRAME_UNIFORM = 10
    SATURATED_SHARE = 11


class FlightPrior(NamedTuple):
    """An attitude (3, 3) of 2.30 known a priori, and the largest rotation by which it may be wrong, rad, 28 fraction
    bits."""

    matrix: IntArray
    radius: int


class Pool:
    """Hypotheses of one identification, the strongest first."""

    def __init__(self, stars: int, prior: FlightPrior | None, t: SearchTables) -> None:
        self.tables, self.prior, self.stars = t, prior, stars
        self.kept: list[Verified] = []
        self.rest = NEVER
        self.cut_short = False
        self.gain = 0
        if prior is not None:
            log_radius = int(log_down(np.array(prior.radius), t)) + LOG_UP - (28 << LOG_BITS)
            self.gain = max(_LOG_SIX_PI - 3 * log_radius, 0)

    def add(self, found: Verified) -> None:
        """Add a verified attitude; one that repeats another replaces it only if it is better."""
        if found.evidence <= LEAST_EVIDENCE or not self._allowed(found.matrix):
            return
        for k, known in enumerate(self.kept):
            if _agree(known.guide, found.guide):
                if found.evidence > known.evidence:
                    self.kept[k] = found
                break
        else:
            self.kept.append(found)
        self.kept.sort(key=lambda h: -h.evidence)
        if len(self.kept) > KEPT:
            dropped = self.kept.pop()
            self.rest = int(log_sum_up(np.array(self.rest), np.array(dropped.evidence), self.tables))

    def _allowed(self, matrix: IntArray) -> bool:
        if self.prior is None:
            return True
        radius = self.prior.radius
        return radius >= _ONE_RADIAN or _rotation2(matrix, self.prior.matrix) <= 2 * ((radius * 1075) >> 10) ** 2

    @property
    def chance(self) -> int:
        """log₂ of the chance that the best hypothesis is wrong, rounded up; 0 without one."""
        if not self.kept:
            return 0
        others = np.array(log_sum_up(np.array(-self.gain), np.array(self.rest), self.tables))
        for rival in self.kept[1:]:
            others = log_sum_up(others, np.array(rival.evidence), self.tables)
        return int(self.tables.log_density[self.stars]) + int(others) - self.kept[0].evidence

    def beyond(self, margin: int) -> bool:
        """Whether the best one is accepted with a margin."""
        return bool(self.kept) and self.chance < self.tables.log_rate - margin

    def is_known(self, matrix: IntArray, square: int) -> bool:
        """Whether an attitude is one of the hypotheses."""
        return any(_rotation2(matrix, known.matrix) <= square for known in self.kept)

    def judge(self, steps: int) -> tuple[Reason, int]:
        """Reason, and the chance."""
        t = self.tables
        if not self.kept:
            return Reason.STEPS_USED_UP if self.cut_short else Reason.NO_HYPOTHESIS, 0
        best, chance = self.kept[0], self.chance
        matched = int((best.guide >= 0).sum())
        density = int(t.log_density[self.stars])
        if matched >= t.least_stars and chance <= t.log_rate:
            return Reason.ACCEPTED, chance
        if self.cut_short:
            return Reason.STEPS_USED_UP, chance
        if matched < t.least_stars or chance > density:
            return Reason.WEAK_EVIDENCE, chance
        alone = density - best.evidence - self.gain <= t.log_rate
        return Reason.RIVAL if alone and len(self.kept) > 1 else Reason.ABOVE_RATE, chance


def _agree(one: IntArray, other: IntArray) -> bool:
    """Whether two hypotheses share most of the smaller one's pairs."""
    shared = int(((one >= 0) & (one == other)).sum())
    return 2 * shared >= min(int((one >= 0).sum()), int((other >= 0).sum()))


def _rotation2(one: IntArray, other: IntArray) -> int:
    """Sum of the squared differences of two attitudes, 2⁻⁵⁶: twice the square of a small angle between them."""
    apart = (one - other) >> 2
    return sum(int(c) for c in (apart * apart).ravel())


class Work(ABC):
    """One identification: what is known of the stars, the hypotheses so far, and the steps done."""

    def __init__(self, pool: Pool, seen: Sight, sides: Stars, observer: FlightObserver, t: SearchTables) -> None:
        self.pool, self.seen, self.sides, self.observer, self.tables = pool, seen, sides, observer, t
        self.steps = 0

    @abstractmethod
    def run(self, search: Search) -> None:
        """One search."""

    def check_prior(self, prior: FlightPrior) -> None:
        """Verify the prior itself, if its error is within the first gate."""
        if (prior.radius << 2) ** 2 <= 3969 * int(self.seen.variance[0]):
            self.verify(prior.matrix, 0)

    def fits_prior(self, star: int, guides: IntArray, search: Search) -> NDArray[np.bool_]:
        """Mask (K,) of directions of guide stars (K, 3) that can be where an observed star is, by the prior."""
        prior = self.pool.prior
        if prior is None or prior.radius >= _ONE_RADIAN:
            return np.ones(len(guides), np.bool_)
        apart = ((guides @ prior.matrix.T) >> 30) - self.seen.direction[star]
        gate2 = gate_of(int(self.seen.variance[star]), search)
        # (a + b)² ≤ 2 a² + 2 b²
        return np.asarray((apart * apart).sum(axis=1) <= 2 * (prior.radius << 2) ** 2 + 4 * gate2)

    def is_known(self, matrix: IntArray, search: Search) -> bool:
        """Whether an attitude is one of the hypotheses, within the gate of the brightest star."""
        return self.pool.is_known(matrix, gate_of(int(self.seen.variance[0]), search) >> 4)

    def verify(self, matrix: IntArray, gates: int) -> None:
        """Verify an attitude from a row of gates on, and add it."""
        found = verify(matrix, gates, self.seen, self.observer, self.tables)
        self.steps += found.steps
        self.pool.add(found)


def gate_of(variance: int, search: Search) -> int:
    """Square of the gate of a star with this variance, 2⁻⁶⁰ rad²."""
    return (min(variance, LARGEST_VARIANCE) >> 8) * search.gate2


def pair_frame(p: IntArray, q: IntArray) -> IntArray | None:
    """Rows (3, 3) of 2.30: the midpoint of two directions, their difference, and the normal to both."""
    middle, apart = normalized(p + q, 1 << 20), _lengthened(q - p)
    if middle is None or apart is None:
        return None
    return np.stack([middle, apart, cross(middle, apart)])


def _lengthened(v: IntArray) -> IntArray | None:
    """Unit vector of a short difference: shifted left first, so that its direction keeps its precision."""
    largest = int(np.abs(v).max())
    if largest == 0:
        return None
    while largest < 1 << (DIRECTION_BITS - 1):
        v, largest = v << 1, largest << 1
    return normalized(v, 1)
