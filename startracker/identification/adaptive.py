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
from functools import lru_cache
from itertools import combinations
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from startracker.catalog.guide import GuideDatabase, PairList
from startracker.identification.hypothesis import Bench, hypothesis_of, kernel_stars, too_few
from startracker.identification.observed import Identification, Observed, Prior
from startracker.identification.pole_votes import VOTE_SIGMAS, pair_bearings, search_poles
from startracker.identification.search_plan import ROLLS, Plan, evidence_of_matches, fewest_matches, plan
from startracker.identification.search_state import Finds, Limits, Pairs
from startracker.identification.triangles import PAIR_SIGMAS, search_triangles, triangle_costs
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
_MOST_STARS, _WIDE_STARS = 120, 25
_BRIGHT = 9
_LEAST_SIDE = 0.12
_MOST_FINDS = 12
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
        self._finds, self._count = _no_finds(len(observed)), 0

    @property
    def fits_as_stated(self) -> bool:
        """Whether what was found is accepted with something to spare, and needs no larger errors nor another focus."""
        if not self.bench.log_chance < self.bench.limit - _BEYOND_RIVALS:
            return False
        best = self.bench.standing[0]
        return best.focal == 1.0 and best.scale <= _AS_STATED

    def triangles(self, assumption: _Assumption) -> bool:
        """Look up the first triangles of the brightest stars."""
        if self.bench.left <= 0:
            self.bench.cut_short = True
            return True
        triangles = first_triangles(self._observed.vectors, 2.0 * self._guide.half_diagonal_rad, assumption.triangles)
        limits = _limits(self.bench, self._observed, assumption)
        return self._take(
            search_triangles(triangles, self._stars, self._guide.view, self._pairs, limits, self._finds, self._count),
            f"{assumption.words}: {{looked}} triangles",
        )

    def votes(self, assumption: _Assumption) -> bool:
        """Take one star after the other for the pole that its neighbours vote about."""
        if self.bench.left <= 0:
            self.bench.cut_short = True
            return True
        votes, fewest = self._plan(assumption)
        # wider assumptions are tried as far as their share goes; that the stated one is not is told
        stated = assumption.residual < 1.0
        if votes.poles == 0:
            self.bench.cut_short |= stated and votes.cut_short
            return False
        limits = _limits(self.bench, self._observed, assumption)
        nearest = nearest_stars(self._observed.vectors[:_MOST_STARS], votes.neighbours)
        before = self.bench.operations
        done = self._take(
            search_poles(
                np.arange(votes.poles),
                nearest,
                votes.votes,
                fewest,
                self._stars,
                self._guide.view,
                self._pairs,
                _bearings(self._near, self._guide),
                limits,
                self._finds,
                self._count,
            ),
            f"{assumption.words}: {{looked}} stars with {votes.neighbours} neighbours",
        )
        beyond = votes.cut_short or self.bench.operations - before > limits.work
        if not done and (self.bench.left <= 0 or (stated and beyond)):
            self.bench.cut_short = True
        accepted = bool(self.bench.standing) and self.bench.log_chance < self.bench.limit
        return done or (accepted and stated)

    def _plan(self, assumption: _Assumption) -> tuple[Plan, int]:
        observed, guide, bench = self._observed, self._guide, self.bench
        n, free = min(len(observed), _MOST_STARS), assumption.focal_range > 0.0
        area, sigma = guide.solid_angle_sr, float(np.median(observed.sigma_rad))
        side, guides = math.sqrt(area), len(guide)
        evidence = evidence_of_matches(
            len(observed),
            round(guides * area / (4.0 * math.pi)),
            round(math.log(area / sigma**2), 1),
            assumption.residual,
            4 if free else 3,
        )
        fewest = fewest_matches(evidence, self._stars.excess, bench.least_evidence)
        # of those only the brightest are looked at
        fewest = max(fewest * n // len(observed), 3)
        if fewest > n:
            return Plan(0, 0, 0), fewest
        error = VOTE_SIGMAS * assumption.multiple * sigma * math.sqrt(2.0)
        widest = float(self._pairs.separation[-1]) if len(self._pairs.separation) else 1.0
        pairs = 4.0 * side * (error + assumption.focal_range * 0.5 * side) * len(self._pairs.separation) / widest**2
        rolls = 1.0 + 2.0 * error / (0.3 * side) * ROLLS / (2.0 * math.pi)
        gate = math.pi * (GATE_SIGMAS * assumption.multiple * sigma) ** 2 * guides / (4.0 * math.pi)
        planned = plan(
            n,
            fewest,
            assumption.miss,
            _work(assumption, n),
            pairs=_rounded(pairs),
            guides=guides,
            rolls=_rounded(rolls),
            gate=_rounded(gate),
            rare=assumption.chance_hits,
        )
        return planned, fewest

    def _take(self, searched: tuple[int, int, int, float], words: str) -> bool:
        """Take in what a search found."""
        count, looked, found, operations = searched
        self.bench.operations += int(operations)
        words = words.format(looked=looked)
        self.bench.note(f"{words}, {found} alike in the sky, {count - self._count} worth a look")
        self._count = count
        for row in range(count):
            self.bench.add(hypothesis_of(tuple(column[row] for column in self._finds)))
        return self.bench.surely


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


def nearest_stars(vectors: FloatArray, count: int) -> IntArray:
    """The `count` nearest others (N, count) of each star (N, 3)."""
    separation = np.linalg.norm(vectors[:, None] - vectors[None], axis=-1)
    np.fill_diagonal(separation, -1.0)
    return np.ascontiguousarray(np.argsort(separation, axis=1, kind="stable")[:, 1 : count + 1])


def _limits(bench: Bench, observed: Observed, turn: _Assumption) -> Limits:
    prior, matrix, cosine = bench.prior, _NO_PRIOR, -2.0
    if prior is not None:
        slack = prior.radius_rad + 6.0 * turn.multiple * float(observed.sigma_rad.max()) + turn.focal_range
        matrix, cosine = prior.attitude.as_matrix(), math.cos(min(slack, math.pi))
    tolerance, sure = AdaptiveSettings.of(bench.settings).magnitude_tolerance, bench.sure_evidence
    # who accepts much by chance wants what few other stars confirm to be looked at, too
    chance_hits = max(turn.chance_hits, _HITS_FOR_RATE * bench.settings.false_alarm_rate)
    work = min(_work(turn, len(observed)) * bench.settings.max_operations / _USUAL_OPERATIONS, bench.left)
    return Limits(turn.multiple, turn.focal_range, tolerance, chance_hits, sure, work, matrix, cosine)


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


def _no_finds(n: int) -> Finds:
    """Room for hypotheses; whoever looks at it knows how many there are."""
    h = _MOST_FINDS
    return Finds(
        np.empty(h), np.empty((h, 3, 3)), np.empty(h), np.empty(h), np.empty(h, np.int64), np.empty((h, n), np.int64)
    )
