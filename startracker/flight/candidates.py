"""The default source of hypotheses: candidates by votes, confirmed by the other stars, in integers.

The rules are those of `startracker.identification.candidate_search`. The C (`c/adaptive/tracker_candidates.c`,
`tracker_confirm.c`) performs the same operations.
"""

from __future__ import annotations

import numpy as np

from startracker.core import IntArray
from startracker.flight.hypotheses import LARGEST_VARIANCE, SURE_BEYOND, Work, pair_frame
from startracker.flight.search_plan import Search
from startracker.flight.votes import vote_about

MOST_OTHERS = 48
CANDIDATE_STEPS, STAR_STEPS = 30, 60
"""Of a candidate, and of each star that may confirm it."""
_MOST_RATIO = 1 << 15


class CandidateWork(Work):
    """Searches of one identification: candidates, confirmed and verified."""

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
        if not all(self.fits_prior(star, t.guide[[k]], search)[0] for star, k in ((pole, u), (neighbour, w))):
            return
        frame, known = pair_frame(seen.direction[pole], seen.direction[neighbour]), pair_frame(*ends)
        if frame is None or known is None:
            return
        matrix = (frame.T @ known) >> 30
        if self.is_known(matrix, search):
            return
        others = np.array([s for s in range(len(seen)) if s not in (pole, neighbour, third)][:MOST_OTHERS], np.int64)
        self.steps += CANDIDATE_STEPS + STAR_STEPS * len(others)
        gate2 = self._gates(pole, neighbour, others, frame, search)
        if self._confirmed(matrix, others, gate2, search):
            self.verify(matrix, search.gates)

    def _gates(self, pole: int, neighbour: int, others: IntArray, frame: IntArray, search: Search) -> IntArray:
        """Squares (K,) of the gates of the other stars, 2⁻⁶⁰ rad²."""
        seen = self.seen
        shared = int(seen.variance[pole] + seen.variance[neighbour])
        along = (seen.direction[others] @ frame[1:].T) >> 30
        away2 = (along * along).sum(axis=1)
        apart2 = max(int(self.sides.chord[pole, neighbour]) ** 2 >> 20, 1)
        ratio = np.minimum((away2 >> 12) // apart2, _MOST_RATIO)
        variance = seen.variance[others] + (shared >> 2) + ((shared * ratio) >> 8)
        return np.asarray((np.minimum(variance, LARGEST_VARIANCE) >> 8) * search.gate2)

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


def _least(mean: int, largest: IntArray) -> int:
    """Fewest matches that occur by chance as rarely as required, by the largest mean for each number."""
    enough = np.flatnonzero(mean <= largest)
    return int(enough[0]) + 1 if len(enough) else len(largest) + 1
