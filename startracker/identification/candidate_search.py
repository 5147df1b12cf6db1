"""Candidates confirmed by the other stars and verified against all, as far as a search's operations go."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from startracker.catalog.guide import GuideDatabase
from startracker.identification.hypothesis import Bench, hypothesis_of
from startracker.identification.marked_sky import mark_sky, no_marks
from startracker.identification.other_stars import Confirmation, next_confirmed
from startracker.identification.search_state import Candidates, Limits, Stars
from startracker.identification.verification import GATE_SIGMAS, verify_attitude

__all__ = ["Effort", "Verifier"]

FloatArray = NDArray[np.float64]

_VERIFY_FROM = 7.0
"""Least multiple of the stated errors that a verification begins with."""
_WORTH_A_LOOK, _POOR_FIT, _BETTER = -5.0, 2.0, 3.0
"""ln B from which a hypothesis is kept; where errors are so many times the stated ones, the focal length may be off: it
is fitted, and has to gain this much."""
_SAME_SIGMAS = 3.0
_MARK_WORK = 20.0
"""Operations of a guide star that is marked."""


class Effort:
    """What one search may do, and what it has done.

    Parameters
    ----------
    limits : Limits
    candidate_work : float
        Operations of a candidate.
    look_always, look_marked : float
        Of each further star looked at for it, and of one whose position is marked.
    enough : int
        See `Confirmation`.
    """

    def __init__(
        self, limits: Limits, candidate_work: float, look_always: float, look_marked: float, enough: int = 0
    ) -> None:
        self.limits, self._costs, self._enough = limits, (candidate_work, look_always, look_marked), enough
        self.marks, self.marked = no_marks(), look_always
        self.work, self.looked, self.found, self.kept, self.sure = 0.0, 0, 0, 0, False

    @property
    def ended(self) -> bool:
        """Whether nothing can compete any more, or all operations are used up."""
        return self.sure or self.work > self.limits.work

    @property
    def confirmation(self) -> Confirmation:
        """What is asked of a candidate."""
        candidate, always, marked = self._costs
        gate = GATE_SIGMAS * self.limits.scale
        look_work = always + marked * self.marked
        return Confirmation(gate, self.limits.chance_hits, self._enough, self.marks, candidate, look_work)


class Verifier:
    """Takes candidates to the bench."""

    def __init__(self, bench: Bench, guide: GuideDatabase, stars: Stars) -> None:
        self.bench, self._sky, self._stars = bench, guide.view, stars
        self._found: list[FloatArray] = []

    def mark(self, effort: Effort, many: int, lever: float) -> None:
        """Mark the sky once many candidates were found, for stars whose position errs by so many of their errors."""
        if effort.marks.reach2 > 0.0 or effort.found < many:
            return
        gate = GATE_SIGMAS * effort.limits.scale
        effort.marks = mark_sky(self._sky.directions, lever * gate * float(np.median(self._stars.sigma)))
        effort.marked = effort.marks.share
        effort.work += _MARK_WORK * len(self._sky.directions)

    def take(self, candidates: Candidates, effort: Effort, work: float) -> None:
        """Verify those candidates that other stars confirm."""
        effort.work += work
        if not len(candidates.focal):
            return
        effort.found += len(candidates.focal)
        confirmation, at = effort.confirmation, 0
        while at < len(candidates.focal) and not effort.ended:
            left = effort.limits.work - effort.work
            at, matrix, work = next_confirmed(candidates, at, self._stars, self._sky, confirmation, left)
            effort.work += work
            if at < len(candidates.focal):
                self._verify(matrix, float(candidates.focal[at]), effort)
            at += 1

    def _verify(self, matrix: FloatArray, focal: float, effort: Effort) -> None:
        """Verify an attitude against all stars, unless it is known; a poor fit with a free focal length, too."""
        limits, sky = effort.limits, self._sky
        least = 3.0 - (_SAME_SIGMAS * limits.scale * float(self._stars.sigma[0])) ** 2
        if any(float((matrix * known).sum()) > least for known in self._found):
            return
        scale, free = max(limits.scale, _VERIFY_FROM), limits.focal_range > 0.0
        found = verify_attitude(matrix, focal, self._stars, sky, scale, free)
        effort.work += found.operations
        if not free and found.log_b > _WORTH_A_LOOK and found.scale > _POOR_FIT:
            other = verify_attitude(found.matrix, 0.0, self._stars, sky, scale, True)
            effort.work += other.operations
            found = other if other.log_b > found.log_b + _BETTER else found
        if found.log_b > _WORTH_A_LOOK:
            self._found.append(found.matrix)
            effort.kept += 1
            self.bench.add(hypothesis_of(found))
            effort.sure |= found.log_b > self.bench.sure_evidence

    def note(self, effort: Effort, words: str) -> bool:
        """Write down what a search did; whether looking on is idle."""
        self.bench.operations += int(effort.work)
        self.bench.note(f"{words}, {effort.found} alike in the sky, {effort.kept} worth a look")
        return self.bench.surely
