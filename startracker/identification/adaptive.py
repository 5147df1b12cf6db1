"""The default identification: a few triangles, then votes about each star, under assumptions that widen by turns.

What a frame needs is not known beforehand: a good one is solved by its first triangle within the stated errors,
another has false stars, errors of pixels, or a focal length a percent off. So every assumption gets a few triangles of
the brightest stars. Where that does not do, stars are taken for the pole one after the other and their neighbours vote
about it (`pole_votes`), of as many stars as are needed to find what could be accepted at all (`search_plan`). The first
identification beyond doubt ends it.

From Van Bezooijen 1989 it has the match of pairs, from Mortari, Samaan, Bruccoleri & Junkins 2004 the triangle with
confirming stars, from Padgett & Kreutz-Delgado 1997 the pole star and its neighbours, and from Lang et al. 2010 the
acceptance by the odds of the whole field.
"""

from __future__ import annotations

import math
from functools import cached_property, lru_cache
from itertools import combinations
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from startracker.catalog.guide import GuideDatabase, PairList
from startracker.identification.candidate_search import Effort, Verifier
from startracker.identification.hypothesis import Bench, kernel_stars, too_few
from startracker.identification.observed import Identification, Observed, Prior
from startracker.identification.pole_votes import VOTE_SIGMAS, BallotBox, pair_bearings, vote_about
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
from startracker.identification.triangles import PAIR_SIGMAS, triangle_costs, triangles_alike
from startracker.identification.verification import GATE_SIGMAS
from startracker.settings import AdaptiveSettings, IdentificationSettings

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

TIGHT, MIDDLE, WIDE = 2.2, 7.0, 16.0
"""Multiples of the stated errors: 0.15 px stated becomes 0.33, 1 and 2.4 px."""
FOCAL_RANGE = 0.025
SHORT_SIDES = 0.6
"""Share of the field's diagonal up to which pairs are listed: of a triangle the two shorter sides are looked up."""


class _Assumption(NamedTuple):
    """What is taken for true, and how much is done about it.

    Parameters
    ----------
    words : str
        To be read by people.
    multiple : float
        Of the stated errors, at most.
    focal_range : float
        Largest relative error of the focal length.
    residual : float
        Multiple of the stated errors, at least: smaller ones need no such assumption.
    chance_hits : float
        How often chance may let a triangle or a pair pass on to verification.
    triangles : int
        Of the brightest stars, looked up first.
    miss : float
        Chance with which the search by votes may miss a field that has just enough true stars to be accepted.
    work : float
        Operations at most, over the root of the number of stars, where `IdentificationSettings.max_operations` is as
        usual; else in proportion.
    """

    words: str
    multiple: float
    focal_range: float
    residual: float
    chance_hits: float
    triangles: int
    miss: float
    work: float


_STATED = _Assumption("errors as stated", TIGHT, 0.0, 0.4, 0.02, 12, 0.0025, 3e6)
_THREE = _Assumption("errors three times as large", MIDDLE, 0.0, TIGHT, 0.005, 3, 0.02, 400e3)
_FOCAL = _Assumption(f"focal length off by up to {FOCAL_RANGE:.1%}", TIGHT, FOCAL_RANGE, 1.25, 0.01, 3, 0.05, 200e3)
_SEVEN = _Assumption("errors seven times as large", WIDE, 0.0, MIDDLE, 0.001, 0, 0.05, 600e3)
_QUICK, _THOROUGH = (_STATED, _THREE, _FOCAL), (_STATED, _THREE, _FOCAL, _SEVEN)
_BEYOND_RIVALS, _AS_STATED = 5.0, 2.2
"""A field that is accepted with so much (in ln of the chance) to spare, and fits within so many stated errors, is
searched by votes no longer: a rival would have to explain that much beyond chance."""
_MULTIPLES = (1.0, 1.5, 2.25, 3.5)
"""Of the fewest true stars that could be accepted: what the search by votes is planned for, where errors are as stated
and the fewest are not to be found within its operations."""
_MOST_STARS, _WIDE_STARS = 120, 25
_BRIGHT = 9
_LEAST_SIDE = 0.12
_TRIANGLE_WORK, _TRIANGLE_LOOK_WORK = 300.0, 50.0
_POLE_WORK, _POLE_LOOK_WORK = 100.0, 25.0
_MANY_FOUND, _LEVER = 201, 2.25
"""Candidates of triangles after which the sky is marked, for stars whose position errs by so many of their errors."""
_MANY_TRIED, _USUAL_LEVER = 60, 3.0
"""The same of the votes."""
_HITS_FOR_RATE = 10.0
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
        Brightest first.
    guide : GuideDatabase
        As the observer sees it.
    settings : IdentificationSettings
        Its `false_alarm_rate`, `min_stars` and `magnitude_tolerance`; a `separation_tolerance_deg` sets the one
        tolerance that is tried.
    prior : Prior, optional
        Confines guide stars and attitudes.

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
    return search.bench.judge(observed)


def _assumptions(
    settings: AdaptiveSettings, observed: Observed
) -> tuple[tuple[_Assumption, ...], tuple[_Assumption, ...]]:
    """Assumptions in the order in which they are tried: by the first triangles, and by votes."""
    if settings.separation_tolerance_deg is None:
        return _QUICK, _THOROUGH
    # the user's tolerance is that of a separation
    error = math.radians(settings.separation_tolerance_deg) / (PAIR_SIGMAS * math.sqrt(2.0))
    multiple = error / float(np.median(observed.sigma_rad))
    given = _STATED._replace(words="separations within the tolerance given", multiple=multiple)
    return (given,), (given,)


class _Search:
    """One identification's searches and what they found. Each search says whether looking on is idle."""

    def __init__(
        self, observed: Observed, guide: GuideDatabase, settings: AdaptiveSettings, prior: Prior | None
    ) -> None:
        self.bench = Bench(settings, prior, len(observed))
        self._observed, self._guide = observed, guide
        self._stars = kernel_stars(observed, guide)
        self._near = near = (
            guide.pairs_within(SHORT_SIDES)
            if prior is None
            else guide.pairs_near(prior.attitude.boresight, prior.radius_rad)
        )
        self._pairs = Pairs(near.first, near.second, near.separation_rad)
        self._guides = Guides(guide.directions, guide.v_mag)
        self._head = np.full(len(guide), -1, np.int32)
        self._verifier = Verifier(self.bench, guide, self._stars)

    @cached_property
    def _sigma(self) -> float:
        """Stated standard error of most stars, rad."""
        return float(np.median(self._stars.sigma))

    @cached_property
    def _nearest(self) -> IntArray:
        """The other stars by their distance from each."""
        return nearest_stars(self._observed.vectors[:_MOST_STARS])

    @cached_property
    def _price(self) -> FloatArray:
        return crowding_price(self._stars.excess)

    @cached_property
    def _box(self) -> BallotBox:
        guides, (there, back) = len(self._guide), _bearings(self._near, self._guide)
        return BallotBox(there, back, np.empty((guides, 4), np.uint64), np.empty(guides, np.bool_), self._head)

    @property
    def fits_as_stated(self) -> bool:
        """Whether what was found is accepted with something to spare, and needs no larger errors nor another focus."""
        if not self.bench.log_chance < self.bench.limit - _BEYOND_RIVALS:
            return False
        best = self.bench.standing[0]
        return best.focal == 1.0 and best.scale <= _AS_STATED

    def triangles(self, assumption: _Assumption) -> bool:
        """Look up the first triangles of the brightest stars."""
        if self._exhausted():
            return True
        limits = _limits(self.bench, self._observed, assumption)
        vectors, diagonal = self._observed.vectors, 2.0 * self._guide.half_diagonal_rad
        effort = Effort(limits, _TRIANGLE_WORK, 0.0, _TRIANGLE_LOOK_WORK)
        triples = first_triangles(vectors, diagonal, assumption.triangles)
        while effort.looked < len(triples) and not effort.ended:
            self._verifier.mark(effort, _MANY_FOUND, _LEVER)
            some = triples[effort.looked : 2 * effort.looked + 1]  # the first does mostly
            candidates, work = triangles_alike(some, self._stars, self._guides, self._pairs, limits, self._head)
            effort.looked += len(some)
            self._verifier.take(candidates, effort, work)
        return self._verifier.note(effort, f"{assumption.words}: {effort.looked} triangles")

    def votes(self, assumption: _Assumption) -> bool:
        """Take one star after the other for the pole that its neighbours vote about."""
        if self._exhausted():
            return True
        votes, fewest = self._plan(assumption)
        # wider assumptions are tried as far as their share goes; that the stated one is not is told
        stated = assumption.residual < 1.0
        if votes.poles == 0:
            self.bench.cut_short |= stated and votes.cut_short
            return False
        limits = _limits(self.bench, self._observed, assumption)
        nearest = self._nearest[:, : votes.neighbours]
        effort = Effort(limits, _POLE_WORK, 1.0, _POLE_LOOK_WORK, enough=fewest - 3)
        for pole in range(votes.poles):
            if effort.ended:
                break
            left = limits._replace(work=limits.work - effort.work)
            stars, sky = self._stars, self._guides
            candidates, work = vote_about(pole, nearest[pole], votes.votes, stars, sky, self._pairs, self._box, left)
            effort.looked += 1
            if len(candidates.focal):
                self._verifier.mark(effort, _MANY_TRIED - len(candidates.focal), _USUAL_LEVER)
            self._verifier.take(candidates, effort, work)
        done = self._verifier.note(
            effort, f"{assumption.words}: {effort.looked} stars with {votes.neighbours} neighbours"
        )
        beyond = votes.cut_short or effort.work > limits.work
        if not done and (self.bench.left <= 0 or (stated and beyond)):
            self.bench.cut_short = True
        accepted = bool(self.bench.standing) and self.bench.log_chance < self.bench.limit
        return done or (accepted and stated)

    def _exhausted(self) -> bool:
        self.bench.cut_short |= self.bench.left <= 0
        return self.bench.left <= 0

    def _plan(self, assumption: _Assumption) -> tuple[Plan, int]:
        observed, guide, bench = self._observed, self._guide, self.bench
        n, free = min(len(observed), _MOST_STARS), assumption.focal_range > 0.0
        area, sigma = guide.solid_angle_sr, self._sigma
        side, guides = math.sqrt(area), len(guide)
        evidence = evidence_of_matches(
            len(observed),
            round(guides * area / (4.0 * math.pi)),
            round(math.log(area / sigma**2), 1),
            assumption.residual,
            4 if free else 3,
        )
        fewest = fewest_matches(evidence, self._price, bench.least_evidence)
        # of those only the brightest are looked at
        fewest = max(fewest * n // len(observed), 3)
        if fewest > n:
            return Plan(0, 0, 0), fewest
        error = VOTE_SIGMAS * assumption.multiple * sigma * math.sqrt(2.0)
        widest = float(self._pairs.separation[-1]) if len(self._pairs.separation) else 1.0
        pairs = 4.0 * side * (error + assumption.focal_range * 0.5 * side) * len(self._pairs.separation) / widest**2
        rolls = 1.0 + 2.0 * error / (0.3 * side) * ROLLS / (2.0 * math.pi)
        gate = math.pi * (GATE_SIGMAS * assumption.multiple * sigma) ** 2 * guides / (4.0 * math.pi)
        setting = Setting(_rounded(pairs), guides, _rounded(rolls), _rounded(gate), assumption.chance_hits)
        multiples = _MULTIPLES if assumption.residual < 1.0 else (1.0,)
        planned = plan(n, fewest, assumption.miss, _work(assumption, n), setting, multiples)
        return planned, fewest


def _work(assumption: _Assumption, stars: int) -> float:
    """Operations that a search may take: among many points the errors are as stated, or else too many go astray."""
    return assumption.work * math.sqrt(
        stars if assumption.multiple == TIGHT and assumption.focal_range == 0.0 else min(stars, _WIDE_STARS)
    )


def _rounded(value: float) -> float:
    """To two digits, so that plans can be kept."""
    return float(f"{value:.1e}")


def _bearings(near: PairList, guide: GuideDatabase) -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
    bearings = _BEARINGS.get(near)
    if bearings is None:
        bearings = _BEARINGS[near] = pair_bearings(guide.directions, near.first, near.second)
    return bearings


def nearest_stars(vectors: FloatArray) -> IntArray:
    """The others (N, N − 1) of each star (N, 3), the nearest first."""
    separation = np.linalg.norm(vectors[:, None] - vectors[None], axis=-1)
    np.fill_diagonal(separation, -1.0)
    return np.argsort(separation, axis=1, kind="stable")[:, 1:]


def _limits(bench: Bench, observed: Observed, turn: _Assumption) -> Limits:
    prior, matrix, cosine = bench.prior, _NO_PRIOR, -2.0
    if prior is not None:
        slack = prior.radius_rad + 6.0 * turn.multiple * float(observed.sigma_rad.max()) + turn.focal_range
        matrix, cosine = prior.attitude.as_matrix(), math.cos(min(slack, math.pi))
    tolerance = AdaptiveSettings.of(bench.settings).magnitude_tolerance
    # who accepts much by chance wants what few other stars confirm to be looked at, too
    chance_hits = max(turn.chance_hits, _HITS_FOR_RATE * bench.settings.false_alarm_rate)
    work = min(_work(turn, len(observed)) * bench.settings.max_operations / _USUAL_OPERATIONS, bench.left)
    return Limits(turn.multiple, turn.focal_range, tolerance, chance_hits, work, matrix, cosine)


def first_triangles(vectors: FloatArray, diagonal_rad: float, count: int) -> IntArray:
    """Triangles (T, 3) of the brightest nine stars, those first that are looked up quickly.

    The fewer guide pairs have a side's length the quicker that is, and small triangles agree by chance more seldom;
    very small ones say little of the attitude and come last.
    """
    triples = _triples(min(len(vectors), _BRIGHT))
    order = np.argsort(triangle_costs(triples, vectors, _LEAST_SIDE * diagonal_rad), kind="stable")
    return triples[order[:count]]


@lru_cache(maxsize=16)
def _triples(n: int) -> IntArray:
    """Triples (T, 3) of n stars, brightest first."""
    triples = np.array(list(combinations(range(n), 3)), dtype=np.int64)
    return triples[np.argsort(triples[:, 2], kind="stable")]
