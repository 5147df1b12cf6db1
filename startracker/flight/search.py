"""The identification of a flight build, in integers: hypotheses, verification, acceptance.

The rules are those of `startracker.identification.adaptive` and `hypothesis`; the hypotheses are from the design's
identifier. The C (`c/tracker_search.c`) performs the same operations.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from startracker.core import IntArray
from startracker.flight.apparent import FlightObserver
from startracker.flight.candidates import CandidateWork
from startracker.flight.evidence import Sight
from startracker.flight.hypotheses import SURE_BEYOND, FlightPrior, Pool, Reason, Work
from startracker.flight.search_tables import SearchTables
from startracker.flight.triads import TriadWork
from startracker.flight.votes import Stars, separations

RIVALS_BEYOND = 29547
"""5 / ln 2: margin to the limit with which a field that fits the stated errors is not searched further."""
SOURCES: dict[str, type[Work]] = {"adaptive": CandidateWork, "triads": TriadWork}
"""What makes the hypotheses of an identifier."""
_AS_STATED = 3
"""Number of the width 2.2."""
_ONE, _UNIT_TOLERANCE = 1 << 30, 1 << 20


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
    sides = separations(seen, t)
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
    work = SOURCES[t.identifier](pool, seen, sides, observer, t)
    if prior is not None:
        work.check_prior(prior)
    for number, search in enumerate(t.searches):
        if pool.beyond(SURE_BEYOND):
            break
        if number >= t.quick and pool.beyond(RIVALS_BEYOND) and pool.kept[0].width <= _AS_STATED:
            break
        work.run(search)
        if number >= t.quick and search.stated and pool.beyond(0):
            break
    reason, chance = pool.judge(work.steps)
    guide = np.full(stars, -1, np.int64)
    if not pool.kept:
        return Found(reason, np.zeros((3, 3), np.int64), guide, steps=work.steps), False
    best = pool.kept[0]
    guide[seen.listed] = best.guide
    matched = int((best.guide >= 0).sum())
    return Found(reason, best.matrix, guide, matched, best.evidence, chance, work.steps), pool.beyond(RIVALS_BEYOND)
