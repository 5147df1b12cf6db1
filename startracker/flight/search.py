"""The default identification of a flight build, in integers: candidates, confirmation, verification, acceptance.

The rules are those of `startracker.identification.adaptive`, `candidate_search` and `hypothesis`. The C
(`c/tracker_search.c`) performs the same operations.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from startracker.arrays import IntArray
from startracker.fixed_point.evidence import LOG_BITS, NEVER
from startracker.flight.apparent import FlightObserver
from startracker.flight.evidence import LOG_UP, Sight, log_down, log_sum_up
from startracker.flight.integers import cross, normalized
from startracker.flight.search_plan import QUICK, SEARCHES, Search
from startracker.flight.search_tables import DIRECTION_BITS, SearchTables
from startracker.flight.verifying import Verified, verify
from startracker.flight.votes import Stars, separations, vote_about

KEPT = 8
"""Hypotheses that are kept."""
MOST_OTHERS = 48
LEAST_EVIDENCE = -29545
"""log₂ e⁻⁵."""
SURE_BEYOND, RIVALS_BEYOND = 88640, 29547
"""15 and 5 / ln 2: margins to the limit beyond which no other attitude can compete, and with which a field that fits
the stated errors is not searched further."""
_AS_STATED = 3
"""Number of the width 2.2."""
_LOG_SIX_PI = 17352
"""log₂ 6π, rounded down."""
_MOST_RATIO, _LARGEST_VARIANCE = 1 << 15, 1 << 42
_ONE_RADIAN = 1 << 28
_ONE, _UNIT_TOLERANCE = 1 << 30, 1 << 20
CANDIDATE_STEPS, STAR_STEPS = 30, 60
"""Of a candidate, and of each star that may confirm it."""


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


class Found(NamedTuple):
    """Result of an identification.

    Parameters
    ----------
    reason : Reason
    matrix : (3, 3)
        Of the best attitude, 2.30.
    guide : (N,)
        Guide star of each star of the list, −1 for none.
    matched, evidence, chance, steps : int
        As in ``struct tracker_answer``.
    prior_contradicted : bool
    """

    reason: Reason
    matrix: IntArray
    guide: IntArray
    matched: int = 0
    evidence: int = 0
    chance: int = 0
    steps: int = 0
    prior_contradicted: bool = False


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


def _has_unit_rows(matrix: IntArray) -> bool:
    """Whether the rows of a matrix are unit vectors to 2⁻¹⁰: of others products would overflow."""
    if int(np.abs(matrix).max()) > _ONE + _UNIT_TOLERANCE:
        return False
    return bool((np.abs(((matrix * matrix).sum(axis=1) >> 30) - _ONE) <= _UNIT_TOLERANCE).all())


def identify(seen: Sight, stars: int, observer: FlightObserver, prior: FlightPrior | None, t: SearchTables) -> Found:
    """Identify observed stars, lost in space or around a prior.

    Parameters
    ----------
    seen : Sight
    stars : int
        In the list.
    observer : FlightObserver
    prior : FlightPrior, optional
        Ignored if its rows are not unit vectors, or its radius is 0.
    t : SearchTables
    """
    nothing = np.zeros((3, 3), np.int64), np.full(stars, -1, np.int64)
    if stars == 0:
        return Found(Reason.NOTHING_FOUND, *nothing)
    if len(seen) < t.least_stars:
        return Found(Reason.FEW_FOUND, *nothing)
    sides = separations(seen)
    if prior is None or prior.radius == 0 or not _has_unit_rows(prior.matrix):
        return _searched(seen, sides, stars, observer, None, t)[0]
    found, sure = _searched(seen, sides, stars, observer, prior, t)
    if sure:
        return found
    elsewhere, _ = _searched(seen, sides, stars, observer, None, t)
    steps = found.steps + elsewhere.steps
    better = found.reason is not Reason.ACCEPTED or elsewhere.chance < found.chance
    if elsewhere.reason is Reason.ACCEPTED and better:
        same = found.reason is Reason.ACCEPTED and bool(((found.guide >= 0) & (found.guide == elsewhere.guide)).any())
        return elsewhere._replace(steps=steps, prior_contradicted=not same)
    return found._replace(steps=steps)


def _searched(
    seen: Sight, sides: Stars, stars: int, observer: FlightObserver, prior: FlightPrior | None, t: SearchTables
) -> tuple[Found, bool]:
    """Result of all searches under one prior, and whether it is beyond doubt within it."""
    pool = Pool(len(seen), prior, t)
    work = _Work(pool, seen, sides, observer, t)
    if prior is not None:
        work.check_prior(prior)
    for number, search in enumerate(SEARCHES):
        if pool.beyond(SURE_BEYOND):
            break
        if number >= QUICK and pool.beyond(RIVALS_BEYOND) and pool.kept[0].width <= _AS_STATED:
            break
        work.run(search)
        if number >= QUICK and search.stated and pool.beyond(0):
            break
    reason, chance = pool.judge(work.steps)
    guide = np.full(stars, -1, np.int64)
    if not pool.kept:
        return Found(reason, np.zeros((3, 3), np.int64), guide, steps=work.steps), False
    best = pool.kept[0]
    guide[seen.listed] = best.guide
    matched = int((best.guide >= 0).sum())
    return Found(reason, best.matrix, guide, matched, best.evidence, chance, work.steps), pool.beyond(RIVALS_BEYOND)


class _Work:
    """Searches of one identification: candidates, confirmed and verified, into the pool."""

    def __init__(self, pool: Pool, seen: Sight, sides: Stars, observer: FlightObserver, t: SearchTables) -> None:
        self.pool, self.seen, self.sides, self.observer, self.tables = pool, seen, sides, observer, t
        self.steps = 0

    def check_prior(self, prior: FlightPrior) -> None:
        """Verify the prior itself, if its error is within the first gate."""
        if (prior.radius << 2) ** 2 <= 3969 * int(self.seen.variance[0]):
            self._verify(prior.matrix, 0)

    def run(self, search: Search) -> None:
        """One search."""
        most = self.steps + search.steps
        for pole in range(min(search.poles, len(self.seen))):
            if self.pool.beyond(SURE_BEYOND):
                return
            if self.steps > most:
                self.pool.cut_short |= bool(search.stated)
                return
            candidates = vote_about(pole, self.seen, self.sides, search, most - self.steps, self.tables)
            self.steps += candidates.steps
            for row in candidates.rows.tolist():
                if self.steps > most or self.pool.beyond(SURE_BEYOND):
                    break
                self._candidate(pole, row, search)

    def _candidate(self, pole: int, row: list[int], search: Search) -> None:
        """Confirm a candidate by the other stars, and verify it."""
        seen, t = self.seen, self.tables
        neighbour, u, w, third, _ = row
        ends = t.guide[u], t.guide[w]
        if not (self._fits_prior(pole, ends[0], search) and self._fits_prior(neighbour, ends[1], search)):
            return
        frame, known = pair_frame(seen.direction[pole], seen.direction[neighbour]), pair_frame(*ends)
        if frame is None or known is None:
            return
        matrix = (frame.T @ known) >> 30
        square = ((min(int(seen.variance[0]), _LARGEST_VARIANCE) >> 8) * search.gate2) >> 4
        if self.pool.is_known(matrix, square):
            return
        others = np.array([s for s in range(len(seen)) if s not in (pole, neighbour, third)][:MOST_OTHERS], np.int64)
        self.steps += CANDIDATE_STEPS + STAR_STEPS * len(others)
        gate2 = self._gates(pole, neighbour, others, frame, search)
        if self._confirmed(matrix, others, gate2, search):
            self._verify(matrix, search.gates)

    def _gates(self, pole: int, neighbour: int, others: IntArray, frame: IntArray, search: Search) -> IntArray:
        """Squares (K,) of the gates of the other stars, 2⁻⁶⁰ rad²."""
        seen = self.seen
        shared = int(seen.variance[pole] + seen.variance[neighbour])
        along = (seen.direction[others] @ frame[1:].T) >> 30
        away2 = (along * along).sum(axis=1)
        apart2 = max(int(self.sides.chord[pole, neighbour]) ** 2 >> 20, 1)
        ratio = np.minimum((away2 >> 12) // apart2, _MOST_RATIO)
        variance = seen.variance[others] + (shared >> 2) + ((shared * ratio) >> 8)
        return np.asarray((np.minimum(variance, _LARGEST_VARIANCE) >> 8) * search.gate2)

    def _confirmed(self, matrix: IntArray, others: IntArray, gate2: IntArray, search: Search) -> bool:
        """Whether enough of the other stars are near guide stars."""
        t = self.tables
        mean = int((gate2 >> 24).sum()) * len(t.guide) >> 22
        need = _least(mean, t.needed[search.chance])
        if search.enough:
            need = max(need, min(_least(mean, t.needed[-1]), search.enough))
        need = min(need, len(others))
        if need == 0:
            return True
        sky = (self.seen.direction[others] @ matrix) >> 30
        centre = sky.sum(axis=0) // len(sky)
        reach = max(int(np.abs(sky - centre).max()), 0) + int(np.sqrt(float(gate2.max()))) + 2
        near = t.guide[(np.abs(t.guide - centre) <= reach).all(axis=1)]
        apart = sky[:, None] - near[None]
        if not len(near):
            return False
        matches = int(((apart * apart).sum(axis=-1).min(axis=1) <= gate2).sum())
        return matches >= need

    def _fits_prior(self, star: int, guide: IntArray, search: Search) -> bool:
        """Whether a guide star can be where an observed star is, according to the prior."""
        prior = self.pool.prior
        if prior is None or prior.radius >= _ONE_RADIAN:
            return True
        apart = ((prior.matrix @ guide) >> 30) - self.seen.direction[star]
        square = int((apart * apart).sum())
        gate2 = (min(int(self.seen.variance[star]), _LARGEST_VARIANCE) >> 8) * search.gate2
        return square <= 2 * (prior.radius << 2) ** 2 + 4 * gate2  # (a + b)² ≤ 2 a² + 2 b²

    def _verify(self, matrix: IntArray, gates: int) -> None:
        found = verify(matrix, gates, self.seen, self.observer, self.tables)
        self.steps += found.steps
        self.pool.add(found)


def _least(mean: int, largest: IntArray) -> int:
    """Fewest matches that occur by chance as rarely as required, by the largest mean for each number."""
    enough = np.flatnonzero(mean <= largest)
    return int(enough[0]) + 1 if len(enough) else len(largest) + 1


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
