"""Confirmation of candidates by the other stars, and verification against all, within a budget of operations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from startracker.catalog.guide import GuideDatabase
from startracker.catalog.sky_view import SkyView
from startracker.core import FloatArray
from startracker.identification.acceptance import HypothesisPool, hypothesis_of
from startracker.identification.other_stars import NO_OCCUPANCY, Confirmation, Occupancy, next_confirmed, occupancy_map
from startracker.identification.search_state import Candidates, Limits, Stars
from startracker.identification.verification import GATE_SIGMAS, Verified, is_known, verify_attitude
from startracker.sorting import median

_VERIFY_FROM = 7.0
"""Least multiple of the stated errors with which a verification begins."""
_LEAST_LOG_B, _POOR_FIT, _BETTER = -5.0, 2.0, 3.0
"""ln B above which a hypothesis is kept; multiple of the stated errors above which the focal length may be wrong and is
fitted; and the gain in ln B by which that fit must be better."""
_SAME_SIGMAS = 3.0
_MAP_WORK = 20.0
"""Operations per guide star for computing an occupancy map."""


@dataclass
class SearchBudget:
    """Limits of one search, and the effort spent so far.

    Parameters
    ----------
    limits : Limits
    candidate_work : float
        Operations per candidate.
    star_work, mapped_work : float
        Operations per further star that is tested for a candidate, and per star that the occupancy map does not
        exclude; without a map, ``star_work * (1 + mapped_work)`` is counted.
    enough : int
        See `Confirmation`.
    """

    limits: Limits
    candidate_work: float
    star_work: float
    mapped_work: float
    enough: int = 0
    occupancy: Occupancy = NO_OCCUPANCY
    work: float = 0.0
    tried: int = 0
    found: int = 0
    kept: int = 0
    decided: bool = False

    @property
    def ended(self) -> bool:
        """Whether no other hypothesis can compete any more, or all operations are used up."""
        return self.decided or self.work > self.limits.work

    @property
    def confirmation(self) -> Confirmation:
        """Requirements for a candidate."""
        share = self.occupancy.share if self.occupancy.reach2 > 0.0 else self.star_work
        star_work = self.star_work + self.mapped_work * share
        gate = GATE_SIGMAS * self.limits.scale
        return Confirmation(gate, self.limits.chance, self.enough, self.occupancy, self.candidate_work, star_work)


def next_verified(
    candidates: Candidates,
    start: int,
    known: FloatArray,
    stars: Stars,
    sky: SkyView,
    confirmation: Confirmation,
    limits: Limits,
    work: float,
) -> tuple[int, Verified, float]:
    """First candidate from `start` on that other stars confirm and whose ln B exceeds the least.

    A poor fit is repeated with the focal length free. Attitudes that are already known (K, 3, 3) are skipped.

    Parameters
    ----------
    work : float
        Operations so far; the search ends when those of `limits` are reached.

    Returns
    -------
    Index of the next candidate; the verified hypothesis, with ln B below the least if there is none; operations.
    """
    # 1 − cos of the angle, to second order; two attitudes closer than this are the same.
    least_cosine = 1.0 - 0.5 * (_SAME_SIGMAS * limits.scale * stars.sigma[0]) ** 2
    scale, free, at = max(limits.scale, _VERIFY_FROM), limits.focal_range > 0.0, start
    found = Verified(-np.inf, np.empty((3, 3)), 0.0, scale, 0, np.empty((0, 2), np.int64), 0)
    while at < len(candidates.focal) and work <= limits.work and not found.log_b > _LEAST_LOG_B:
        at, matrix, taken = next_confirmed(candidates, at, stars, sky, confirmation, limits.work - work)
        work += taken
        if at < len(candidates.focal) and not is_known(matrix, known, least_cosine):
            focal = candidates.focal[at]
            for attempt in range(1 if free else 2):
                other = verify_attitude(matrix, focal, stars, sky, scale, free or attempt > 0)
                work += other.operations
                if attempt == 0 or other.log_b > found.log_b + _BETTER:
                    found = other
                if not (found.log_b > _LEAST_LOG_B and found.scale > _POOR_FIT):
                    break
                matrix, focal = found.matrix, 0.0
        at += 1
    return at, found, work


class Verifier:
    """Passes verified candidates on to the hypothesis pool."""

    def __init__(self, pool: HypothesisPool, guide: GuideDatabase, stars: Stars) -> None:
        self.pool, self._sky, self._stars = pool, guide.view, stars
        self._known, self._latest = np.empty((0, 3, 3)), list[FloatArray]()

    def map_sky(self, effort: SearchBudget, many: int, lever: float) -> None:
        """Compute an occupancy map if there have been many candidates, for position errors of `lever` times the stars'
        own."""
        if effort.occupancy.reach2 > 0.0 or effort.found < many:
            return
        gate = GATE_SIGMAS * effort.limits.scale
        effort.occupancy = occupancy_map(self._sky.directions, lever * gate * median(self._stars.sigma.copy()))
        effort.work += _MAP_WORK * len(self._sky.directions)

    def take(self, candidates: Candidates, effort: SearchBudget, work: float) -> None:
        """Verify the candidates that other stars confirm."""
        effort.work += work
        effort.found += len(candidates.focal)
        at = 0
        while at < len(candidates.focal) and not effort.ended:
            if self._latest:
                self._known, self._latest = np.concatenate([self._known, *self._latest]), []
            at, found, effort.work = next_verified(
                candidates, at, self._known, self._stars, self._sky, effort.confirmation, effort.limits, effort.work
            )
            if found.log_b > _LEAST_LOG_B:
                self._latest.append(found.matrix[None])
                effort.kept += 1
                self.pool.add(hypothesis_of(found))
                effort.decided |= found.log_b > self.pool.decisive_evidence

    def note(self, effort: SearchBudget, words: Callable[[], str]) -> bool:
        """Record a search; returns whether the pool is decided, so that further searches are not needed."""
        self.pool.operations += int(effort.work)
        found, kept = effort.found, effort.kept
        self.pool.note(lambda: f"{words()}, {found} similar ones in the sky, {kept} with some evidence")
        return self.pool.decided
