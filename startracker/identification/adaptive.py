"""Default identification: a few triangles, then votes on each star, under successively wider assumptions.

The effort that a frame needs is not known in advance: a good frame is solved by its first triangle within the stated
errors; another has false stars, errors of pixels, or a focal length that is wrong by a percent. So for every assumption
a few triangles of the brightest stars are tried first. If they fail, one star after the other is used as the pole and
its neighbours vote on it (`pole_votes`), for as many stars as are needed to find any field that could be accepted
(`search_plan`). The first identification beyond doubt ends the search.

Pairs are matched as in Van Bezooijen 1989, triangles with confirming stars as in Mortari, Samaan, Bruccoleri & Junkins
2004, the pole star and its neighbours as in Padgett & Kreutz-Delgado 1997; the acceptance by the odds of the whole
field follows Lang et al. 2010.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from startracker.catalog.guide import GuideDatabase, PairList
from startracker.core import FloatArray, IntArray
from startracker.identification.acceptance import HypothesisPool, kernel_stars, too_few
from startracker.identification.candidate_search import SearchBudget, Verifier
from startracker.identification.observed import Identification, Observed, Prior
from startracker.identification.other_stars import MOST_STARS
from startracker.identification.pole_votes import VOTE_SIGMAS, VoteCounts, pair_bearings, vote_about
from startracker.identification.search_plan import (
    ROLLS,
    Plan,
    Setting,
    crowding_price,
    evidence_of_matches,
    fewest_matches,
    plan,
)
from startracker.identification.search_state import Guides, Limits, Pairs
from startracker.identification.triangles import PAIR_SIGMAS, first_triangles, similar_triangles
from startracker.identification.verification import GATE_SIGMAS
from startracker.settings import AdaptiveSettings, IdentificationSettings
from startracker.sorting import median

TIGHT, MIDDLE, WIDE = 2.2, 7.0, 16.0
"""Multiples of the stated errors: a stated error of 0.15 px becomes 0.33, 1 and 2.4 px."""
FOCAL_RANGE = 0.025
SHORT_SIDES = 0.6
"""Longest side, as a share of the field's diagonal, up to which pairs are listed: only the two shorter sides of a
triangle are looked up."""


class _Assumption(NamedTuple):
    """An assumption about errors and focal length, and the effort of the search under it.

    Parameters
    ----------
    words : str
        Description, for the explanation.
    multiple : float
        Largest multiple of the stated errors.
    focal_range : float
        Largest relative error of the focal length.
    residual : float
        Least multiple of the stated errors: smaller ones do not need this assumption.
    chance : float
        Largest probability that a false triangle or pair is passed on to verification.
    triangles : int
        Number of triangles of the brightest stars that are tried first.
    miss : float
        Largest probability that the search by votes misses a field with just enough true stars to be accepted.
    work : float
        Largest number of operations, divided by the square root of the number of stars, for the default
        `IdentificationSettings.max_operations`; it is proportional to that setting.
    """

    words: str
    multiple: float
    focal_range: float
    residual: float
    chance: float
    triangles: int
    miss: float
    work: float


_STATED = _Assumption("errors as stated", TIGHT, 0.0, 0.4, 0.02, 12, 0.0025, 4.5e6)
_THREE = _Assumption("errors three times as large", MIDDLE, 0.0, TIGHT, 0.005, 3, 0.02, 400e3)
_FOCAL = _Assumption(f"focal length wrong by up to {FOCAL_RANGE:.1%}", TIGHT, FOCAL_RANGE, 1.25, 0.01, 3, 0.05, 200e3)
_SEVEN = _Assumption("errors seven times as large", WIDE, 0.0, MIDDLE, 0.001, 0, 0.05, 600e3)
_QUICK, _THOROUGH = (_STATED, _THREE, _FOCAL), (_STATED, _THREE, _FOCAL, _SEVEN)
_BEYOND_RIVALS, _AS_STATED = 5.0, 2.2
"""Margin of acceptance (in ln of the chance) and multiple of the stated errors: an accepted field with this margin that
fits this well is not searched by votes, because a rival would need as much evidence."""
_MULTIPLES = (1.0, 1.5, 2.25, 3.5)
"""Multiples of the fewest true stars that could be accepted for which the search by votes is planned, under the stated
errors, if the fewest cannot be found within its operations."""
_WIDE_STARS = 25
_TRIANGLE_WORK, _TRIANGLE_STAR_WORK = 300.0, 50.0
_POLE_WORK, _POLE_STAR_WORK = 100.0, 25.0
_MANY_FOUND, _LEVER = 201, 2.25
"""Number of candidates of triangles after which an occupancy map is computed, and the multiple of the stars' errors
that it covers."""
_MANY_TRIED, _USUAL_LEVER = 60, 3.0
"""The same numbers for the votes."""
_CHANCE_FOR_RATE = 10.0
_USUAL_OPERATIONS = IdentificationSettings().max_operations
_NO_PRIOR = np.eye(3)
_BEARINGS: WeakKeyDictionary[PairList, tuple[NDArray[np.uint16], NDArray[np.uint16]]] = WeakKeyDictionary()


def adaptive(
    observed: Observed,
    guide: GuideDatabase,
    settings: IdentificationSettings | None = None,
    prior: Prior | None = None,
) -> Identification:
    """Identify observed stars, lost in space or around a prior attitude.

    Parameters
    ----------
    observed : Observed
        Observed stars, brightest first.
    guide : GuideDatabase
        Guide stars in apparent directions for the observer.
    settings : IdentificationSettings
        `false_alarm_rate`, `min_stars` and `magnitude_tolerance`; a `separation_tolerance_deg` replaces all tolerances
        that are tried otherwise.
    prior : Prior, optional
        Restricts guide stars and attitudes.

    Returns
    -------
    Identification
        Status, reason and pairs. Never raises for what was observed.
    """
    settings = AdaptiveSettings.of(settings)
    least = max(settings.min_stars, 3)
    if len(observed) < least:
        return too_few(observed, least)
    search = _Search(observed, guide, settings, prior)
    quick, thorough = _assumptions(settings, observed)
    if not any(search.triangles(assumption) for assumption in quick) and not search.fits_as_stated:
        any(search.votes(assumption) for assumption in thorough)
    return search.pool.outcome(observed)


def _assumptions(
    settings: AdaptiveSettings, observed: Observed
) -> tuple[tuple[_Assumption, ...], tuple[_Assumption, ...]]:
    """Assumptions in the order in which they are tried: with the first triangles, and with votes."""
    if settings.separation_tolerance_deg is None:
        return _QUICK, _THOROUGH
    # The user's tolerance is that of a separation, the assumption's an error of a direction.
    error = math.radians(settings.separation_tolerance_deg) / (PAIR_SIGMAS * math.sqrt(2.0))
    multiple = error / float(np.median(observed.sigma_rad))
    given = _STATED._replace(words="separations within the given tolerance", multiple=multiple)
    return (given,), (given,)


class _Search:
    """Searches of one identification and their results. Each search returns whether to stop."""

    def __init__(
        self, observed: Observed, guide: GuideDatabase, settings: AdaptiveSettings, prior: Prior | None
    ) -> None:
        self.pool = HypothesisPool(settings, prior, len(observed))
        self._observed, self._guide, self._settings = observed, guide, settings
        self._stars = kernel_stars(observed, guide)
        self._near = near = (
            guide.pairs_within(SHORT_SIDES)
            if prior is None
            else guide.pairs_near(prior.attitude.boresight, prior.radius_rad)
        )
        self._pairs = Pairs(near.first, near.second, near.separation_rad)
        self._guides = Guides(guide.directions, guide.v_mag)
        self._head = np.empty(len(guide), np.int32)
        self._head.fill(-1)
        self._verifier = Verifier(self.pool, guide, self._stars)

    @cached_property
    def _sigma(self) -> float:
        """Median of the stated standard errors, rad."""
        return float(median(self._stars.sigma.copy()))

    @cached_property
    def _nearest(self) -> IntArray:
        """Indices (N, N − 1) of the other stars in order of their distance from each."""
        return nearest_stars(self._observed.vectors[:MOST_STARS])

    @cached_property
    def _price(self) -> FloatArray:
        return crowding_price(self._stars.excess)

    @cached_property
    def _counts(self) -> VoteCounts:
        guides, (there, back) = len(self._guide), _bearings(self._near, self._guide)
        return VoteCounts(there, back, np.empty(guides, np.uint64), np.empty((guides, 4), np.uint64), self._head)

    @property
    def fits_as_stated(self) -> bool:
        """Whether the best hypothesis is accepted with a margin, and fits with the stated errors and focal length."""
        if not self.pool.log_chance < self.pool.limit - _BEYOND_RIVALS:
            return False
        best = self.pool.hypotheses[0]
        return best.focal == 1.0 and best.scale <= _AS_STATED

    def triangles(self, assumption: _Assumption) -> bool:
        """Search the first triangles of the brightest stars."""
        if self._exhausted():
            return True
        limits = self._limits(assumption)
        effort = SearchBudget(limits, _TRIANGLE_WORK, 0.0, _TRIANGLE_STAR_WORK)
        diagonal = 2.0 * self._guide.half_diagonal_rad
        triples = first_triangles(self._stars.vectors, diagonal, assumption.triangles)
        while effort.tried < len(triples) and not effort.ended:
            self._verifier.map_sky(effort, _MANY_FOUND, _LEVER)
            # The number doubles each time, because the first triangle is usually sufficient.
            some = triples[effort.tried : 2 * effort.tried + 1]
            candidates, work = similar_triangles(some, self._stars, self._guides, self._pairs, limits, self._head)
            effort.tried += len(some)
            self._verifier.take(candidates, effort, work)
        return self._verifier.note(effort, lambda: f"{assumption.words}: {effort.tried} triangles")

    def votes(self, assumption: _Assumption) -> bool:
        """Use one star after the other as the pole on which its neighbours vote."""
        if self._exhausted():
            return True
        votes, fewest = self._plan(assumption)
        # Wider assumptions are searched within their share of the operations; only an incomplete search with the stated
        # errors is reported.
        stated = assumption.residual < 1.0
        if votes.poles == 0:
            self.pool.cut_short |= stated and votes.cut_short
            return False
        limits = self._limits(assumption)
        nearest = self._nearest[:, : votes.neighbours]
        # The pair itself is not counted; one more may be missing if there is time to verify its candidates.
        enough = fewest - (2 if stated and votes.cut_short else 3)
        effort = SearchBudget(limits, _POLE_WORK, 1.0, _POLE_STAR_WORK, enough=enough)
        for pole in pole_order(votes.poles, len(self._nearest)):
            if effort.ended:
                break
            left = limits._replace(work=limits.work - effort.work)
            stars, sky = self._stars, self._guides
            candidates, work = vote_about(pole, nearest[pole], votes.votes, stars, sky, self._pairs, self._counts, left)
            effort.tried += 1
            if len(candidates.focal):
                self._verifier.map_sky(effort, _MANY_TRIED - len(candidates.focal), _USUAL_LEVER)
            self._verifier.take(candidates, effort, work)
        done = self._verifier.note(
            effort, lambda: f"{assumption.words}: {effort.tried} stars with {votes.neighbours} neighbours"
        )
        beyond = votes.cut_short or effort.work > limits.work
        if not done and (self.pool.left <= 0 or (stated and beyond)):
            self.pool.cut_short = True
        accepted = bool(self.pool.hypotheses) and self.pool.log_chance < self.pool.limit
        return done or (accepted and stated)

    def _exhausted(self) -> bool:
        self.pool.cut_short |= self.pool.left <= 0
        return self.pool.left <= 0

    def _plan(self, assumption: _Assumption) -> tuple[Plan, int]:
        """Plan of the search by votes, and the fewest true stars with which a field could be accepted."""
        observed, guide = self._observed, self._guide
        n, free = min(len(observed), MOST_STARS), assumption.focal_range > 0.0
        area, sigma = guide.solid_angle_sr, self._sigma
        side, guides = math.sqrt(area), len(guide)
        evidence = evidence_of_matches(
            len(observed),
            round(guides * area / (4.0 * math.pi)),
            round(math.log(area / sigma**2), 1),
            assumption.residual,
            4 if free else 3,
        )
        fewest = fewest_matches(evidence, self._price, self.pool.least_evidence)
        # Only the brightest stars are searched, and with them a part of the matches.
        fewest = max(fewest * n // len(observed), 3)
        if fewest > n:
            return Plan(0, 0, 0), fewest
        error = VOTE_SIGMAS * assumption.multiple * sigma * math.sqrt(2.0)
        widest = float(self._pairs.separation[-1]) if len(self._pairs.separation) else 1.0
        pairs = 4.0 * side * (error + assumption.focal_range * 0.5 * side) * len(self._pairs.separation) / widest**2
        rolls = 1.0 + 2.0 * error / (0.3 * side) * ROLLS / (2.0 * math.pi)
        gate = math.pi * (GATE_SIGMAS * assumption.multiple * sigma) ** 2 * guides / (4.0 * math.pi)
        setting = Setting(_rounded(pairs), guides, _rounded(rolls), _rounded(gate), assumption.chance)
        multiples = _MULTIPLES if assumption.residual < 1.0 else (1.0,)
        planned = plan(n, fewest, assumption.miss, _work(assumption, n), setting, multiples)
        return planned, fewest

    def _limits(self, assumption: _Assumption) -> Limits:
        pool, settings, matrix, cosine = self.pool, self._settings, _NO_PRIOR, -2.0
        if pool.prior is not None:
            largest = float(self._observed.sigma_rad.max())
            slack = pool.prior.radius_rad + 6.0 * assumption.multiple * largest + assumption.focal_range
            matrix, cosine = pool.prior.attitude.as_matrix(), math.cos(min(slack, math.pi))
        # With a high false-alarm rate, candidates that few other stars confirm are verified as well.
        chance = max(assumption.chance, _CHANCE_FOR_RATE * settings.false_alarm_rate)
        work = min(_work(assumption, len(self._observed)) * settings.max_operations / _USUAL_OPERATIONS, pool.left)
        multiple, focal_range = assumption.multiple, assumption.focal_range
        return Limits(multiple, focal_range, settings.magnitude_tolerance, chance, work, matrix, cosine)


def _work(assumption: _Assumption, stars: int) -> float:
    """Largest number of operations of a search.

    With many points, only the search with the stated errors is complete; with larger ones too many false candidates
    would pass.
    """
    return assumption.work * math.sqrt(
        stars if assumption.multiple == TIGHT and assumption.focal_range == 0.0 else min(stars, _WIDE_STARS)
    )


def _rounded(value: float) -> float:
    """Rounded to two digits, so that similar searches share a cached plan."""
    return float(f"{value:.1e}")


def _bearings(near: PairList, guide: GuideDatabase) -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
    bearings = _BEARINGS.get(near)
    if bearings is None:
        bearings = _BEARINGS[near] = pair_bearings(guide.directions, near.first, near.second)
    return bearings


def pole_order(poles: int, stars: int) -> list[int]:
    """Indices of the stars that are used as the pole.

    Half of them are the brightest, the others evenly spaced among the rest, because hot pixels may be brighter than all
    stars.
    """
    brightest = (poles + 1) // 2
    rest = poles - brightest
    return [*range(brightest), *(brightest + k * (stars - brightest) // rest for k in range(rest))]


def nearest_stars(vectors: FloatArray) -> IntArray:
    """Indices (N, N − 1) of the other stars for each star (N, 3), nearest first."""
    separation = np.linalg.norm(vectors[:, None] - vectors[None], axis=-1)
    # Its own distance sorts a star first in its row, which is then dropped.
    np.fill_diagonal(separation, -1.0)
    return np.argsort(separation, axis=1, kind="stable")[:, 1:]
