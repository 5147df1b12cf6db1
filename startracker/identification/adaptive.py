"""The default identification: triangles, brightest stars first, under assumptions that widen by turns.

What a frame needs is not known beforehand: a good one is solved by its first triangle within the stated errors,
another has false stars, errors of pixels, or a focal length a percent off. So every assumption gets a few triangles in
the first turn and more in later ones; the first identification beyond doubt ends it.

From Van Bezooijen 1989 it has the match of pairs, from Mortari, Samaan, Bruccoleri & Junkins 2004 the triangle with
confirming stars, and from Lang et al. 2010 the acceptance by the odds of the whole field.
"""

from __future__ import annotations

import math
from functools import lru_cache
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker.catalog.guide import GuideDatabase
from startracker.identification.hypothesis import Bench, hypothesis_of, kernel_stars, too_few
from startracker.identification.observed import Identification, Observed, Prior
from startracker.identification.search_state import Finds, Limits, Pairs
from startracker.identification.triangles import PAIR_SIGMAS, search_triangles, triangle_costs
from startracker.settings import IdentificationSettings

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

TIGHT, MIDDLE, WIDE = 2.2, 7.0, 16.0
"""Multiples of the stated errors: 0.15 px stated becomes 0.33, 1 and 2.4 px."""
FOCAL_RANGE = 0.025
SHORT_SIDES = 0.6
"""Share of the field's diagonal up to which pairs are listed: of a triangle the two shorter sides are looked up."""


class _Turn(NamedTuple):
    """One turn of a search.

    Parameters
    ----------
    assumption : str
        What is taken for true, in words.
    multiple : float
        Of the stated errors.
    focal_range : float
        Largest relative error of the focal length.
    chance_hits : float
        How often chance may let a triangle pass on to verification.
    fewest : int
        True stars below which an attitude is hardly ever accepted with such errors.
    triangles : int
        Looked up under this assumption by the end of the turn, at most.
    work : float
        Operations at most, where `IdentificationSettings.max_operations` is as usual; else in proportion.
    """

    assumption: str
    multiple: float
    focal_range: float
    chance_hits: float
    fewest: int
    triangles: int
    work: float


_STATED = _Turn("errors as stated", TIGHT, 0.0, 0.02, 3, 12, 5e6)
_THREE = _Turn("errors three times as large", MIDDLE, 0.0, 0.005, 6, 4, 5e6)
_FOCAL = _Turn(f"focal length off by up to {FOCAL_RANGE:.1%}", TIGHT, FOCAL_RANGE, 0.01, 5, 6, 5e6)
_SEVEN = _Turn("errors seven times as large", WIDE, 0.0, 0.001, 8, 2, 20e6)
_TURNS = (
    _STATED,
    _THREE,
    _FOCAL,
    _SEVEN,
    _STATED._replace(triangles=60, work=20e6),
    _THREE._replace(triangles=24, work=20e6),
    _STATED._replace(triangles=20000, work=150e6),
    _THREE._replace(triangles=60, work=20e6),
    _FOCAL._replace(triangles=20, work=10e6),
    _SEVEN._replace(triangles=10, work=30e6),
)
_THOROUGH_FROM, _BEYOND_RIVALS, _AS_STATED = 6, 5.0, 2.2
"""From this turn on a field that is accepted with so much (in ln of the chance) to spare, and fits within so many
stated errors, is looked at no longer: a rival would have to explain that much beyond chance, and has not shown in 60
triangles of the brightest stars nor under the other assumptions."""
_MOST_TRIPLES = 20000
_CROWDED, _FEWER_TRIPLES = 40, 1500
_MOST_STARS = 120
_BRIGHT = 9
_LEAST_SIDE = 0.12
_MOST_FINDS = 12
_HITS_FOR_RATE = 10.0
_USUAL_OPERATIONS = IdentificationSettings().max_operations
_NO_PRIOR = np.eye(3)


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
    settings = settings or IdentificationSettings()
    least = max(settings.min_stars, 3)
    if len(observed) < least:
        return too_few(observed, least)
    bench = Bench(settings, prior, len(observed))
    stars = kernel_stars(observed, guide)
    near = (
        guide.pairs_within(SHORT_SIDES)
        if prior is None
        else guide.pairs_near(prior.attitude.boresight, prior.radius_rad)
    )
    pairs = Pairs(near.first, near.second, near.separation_rad)
    triangles = _Triangles(observed.vectors, 2.0 * guide.half_diagonal_rad)
    finds = _no_finds(len(observed))
    count, kept = 0, 0
    done: dict[str, int] = {}
    for number, turn in enumerate(_turns(settings, observed)):
        if number >= _THOROUGH_FROM and _fits_as_stated(bench):
            break
        start, stop = done.get(turn.assumption, 0), min(turn.triangles, len(triangles), _enough(turn, len(observed)))
        if start >= stop:
            continue
        if bench.left <= 0:
            bench.cut_short = True
            break
        limits = _limits(bench, observed, turn)
        count, looked, found, operations = search_triangles(
            triangles.part(start, stop), stars, guide.view, pairs, limits, finds, count
        )
        done[turn.assumption] = start + looked
        bench.operations += int(operations)
        bench.note(f"{turn.assumption}: {looked} triangles, {found} alike in the sky, {count - kept} worth a look")
        kept = count
        for row in range(count):
            bench.add(hypothesis_of(tuple(column[row] for column in finds)))
        if bench.surely:
            break
        if start + looked < stop and (bench.left <= 0 or turn.triangles >= _MOST_TRIPLES):
            bench.cut_short = True
        everything = turn.multiple == TIGHT and start + looked >= len(triangles)
        if everything and bench.standing and bench.log_chance < bench.limit:
            break
    return bench.judge(observed)


def _fits_as_stated(bench: Bench) -> bool:
    """Whether what was found is accepted with something to spare, and needs neither larger errors nor another focus."""
    if not bench.log_chance < bench.limit - _BEYOND_RIVALS:
        return False
    best = bench.standing[0]
    return best.focal == 1.0 and best.scale <= _AS_STATED


def _turns(settings: IdentificationSettings, observed: Observed) -> tuple[_Turn, ...]:
    """Assumptions in the order in which they are tried."""
    if settings.separation_tolerance_deg is None:
        return _TURNS
    # the user's tolerance is that of a separation
    error = math.radians(settings.separation_tolerance_deg) / (PAIR_SIGMAS * math.sqrt(2.0))
    multiple = error / float(np.median(observed.sigma_rad))
    return (_TURNS[6]._replace(assumption="separations within the tolerance given", multiple=multiple),)


def _enough(turn: _Turn, stars: int) -> int:
    """Triangles after which one of true stars alone has been missed with e^−6, if there are as many as are needed."""
    if stars < turn.fewest:
        return 0
    return math.ceil(6.0 * math.comb(stars, 3) / math.comb(turn.fewest, 3))


def _limits(bench: Bench, observed: Observed, turn: _Turn) -> Limits:
    prior, matrix, cosine = bench.prior, _NO_PRIOR, -2.0
    if prior is not None:
        slack = prior.radius_rad + 6.0 * turn.multiple * float(observed.sigma_rad.max()) + turn.focal_range
        matrix, cosine = prior.attitude.as_matrix(), math.cos(min(slack, math.pi))
    tolerance, sure = bench.settings.magnitude_tolerance, bench.sure_evidence
    # who accepts much by chance wants what few other stars confirm to be looked at, too
    chance_hits = max(turn.chance_hits, _HITS_FOR_RATE * bench.settings.false_alarm_rate)
    work = min(turn.work * bench.settings.max_operations / _USUAL_OPERATIONS, bench.left)
    return Limits(turn.multiple, turn.focal_range, tolerance, chance_hits, sure, work, matrix, cosine)


@lru_cache(maxsize=128)
def _triples(n: int) -> tuple[IntArray, IntArray]:
    """Triples (T, 3) of the brightest few of n stars, and of all the others, as many as are ever looked up."""
    few = np.array(list(combinations(range(min(n, _BRIGHT)), 3)), dtype=np.int64)
    few = few[np.argsort(few[:, 2], kind="stable")]
    pairs = np.stack(np.tril_indices(n, -1), axis=1, dtype=np.int64)  # (j, i) by j, i < j
    rest = np.concatenate(
        [np.empty((0, 3), np.int64), *(_third(pairs[: k * (k - 1) // 2], k) for k in range(_BRIGHT, n))]
    )
    most = _MOST_TRIPLES if n > _CROWDED else _FEWER_TRIPLES
    if len(rest) > most:  # the brighter may all be false: any of them, the same every time
        rest = rest[np.sort(np.random.default_rng(n).permutation(len(rest))[:most])]
    return few, rest.reshape(-1, 3)


def _third(pairs: IntArray, k: int) -> IntArray:
    """Triples (P, 3) of pairs (P, 2), the larger number first, and a star beyond them."""
    return np.stack([pairs[:, 1], pairs[:, 0], np.full(len(pairs), k)], axis=1)


class _Triangles:
    """Triangles of one frame's stars in the order in which they are looked up: of the brightest nine, then of all.

    Of each the small ones come first: the fewer guide pairs have a side's length the quicker it is looked up, and small
    triangles agree by chance more seldom; very small ones say little of the attitude and come last.
    """

    def __init__(self, vectors: FloatArray, diagonal_rad: float) -> None:
        few, self._rest = _triples(min(len(vectors), _MOST_STARS))
        self._vectors, self._least_rad = vectors, _LEAST_SIDE * diagonal_rad
        self._few = few[np.argsort(self._cost(few), kind="stable")]
        self._all: IntArray | None = None

    def __len__(self) -> int:
        return len(self._few) + len(self._rest)

    def part(self, start: int, stop: int) -> IntArray:
        if stop <= len(self._few):
            return self._few[start:stop]
        if self._all is None:
            order = np.argsort(self._cost(self._rest), kind="stable")
            self._all = np.concatenate([self._few, self._rest[order]])
        return self._all[start:stop]

    def _cost(self, triples: IntArray) -> FloatArray:
        return np.asarray(triangle_costs(triples, self._vectors, self._least_rad))


def _no_finds(n: int) -> Finds:
    """Room for hypotheses; whoever looks at it knows how many there are."""
    h = _MOST_FINDS
    return Finds(
        np.empty(h), np.empty((h, 3, 3)), np.empty(h), np.empty(h), np.empty(h, np.int64), np.empty((h, n), np.int64)
    )
