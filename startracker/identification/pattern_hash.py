"""Identification by patterns of four stars, found by their shape in a hash table.

1. Sets of four of the brightest observed stars are tried in an order in which the faintest star changes last, so that a
   set without a false star among the bright ones follows soon.
2. The bin of the pattern's shape, and all neighbouring bins within the tolerance, are looked up (`pattern_table`). A
   pattern that agrees in all six edges, in size within the range of the focal length, and in orientation (mirror images
   are rejected) gives an attitude.
3. A candidate whose other stars match guide stars more often than by chance is verified against all stars of the field
   and accepted by probability (`acceptance`).

Tolerances are first those of the stated errors, then three and ten times as large. The work is limited. The method is
that of tetra3's documentation (Pettersson 2019, ESA) after Brown, Stubis & Cahoy 2017 (TETRA).
"""

from __future__ import annotations

import math

import numpy as np

from startracker.catalog.guide import GuideDatabase
from startracker.identification.acceptance import SCALES, HypothesisPool, too_few
from startracker.identification.observed import Identification, Observed, Prior
from startracker.identification.pattern_kernels import PatternFinds, Plan, search_patterns
from startracker.identification.pattern_table import pattern_table
from startracker.settings import IdentificationSettings, PatternHashSettings

FOCAL_RANGE = 0.025
MOST_STARS = 40
_WORK = {1.0: 3e6, 3.0: 3e6, 10.0: 5e6}
_ROOM = 8
_MOST_VERIFIED = 24
_PASSING, _STRONG = -1.0, -8.0
_FEW_STARS = 10
"""Number of stars up to which a pattern is verified even if no other star agrees, because there may be no other true
star."""


def pattern_hash(
    observed: Observed,
    guide: GuideDatabase,
    settings: IdentificationSettings | None = None,
    prior: Prior | None = None,
) -> Identification:
    """Identify observed stars, lost in space or around a prior attitude.

    Parameters
    ----------
    observed : Observed
        Brightest first; sets of the brightest are tried first. The focal length may be wrong by 2.5 %.
    guide : GuideDatabase
        Guide stars in apparent directions for the observer. Their table of patterns is computed once and cached in the
        user's folder.
    settings : PatternHashSettings
        `min_stars` and `false_alarm_rate`.
    prior : Prior, optional
        Attitudes outside it are rejected.

    Returns
    -------
    Identification
        Status, reason and pairs. Never raises for what was observed.
    """
    settings = PatternHashSettings.of(settings)
    least = max(settings.min_stars, 4)
    if len(observed) < least:
        return too_few(observed, least)
    pool = HypothesisPool(settings, prior, len(observed))
    table, sky = pattern_table(guide), guide.view
    vectors, sigma = np.ascontiguousarray(observed.vectors), observed.sigma_rad
    finds = PatternFinds(np.empty(_ROOM), np.empty((_ROOM, 3, 3)), np.empty(_ROOM))
    known = np.empty((0, 3, 3))
    for scale in SCALES:
        stars, work, looked = np.arange(4), min(_WORK[scale], float(pool.left)), 0
        pool.cut_short = pool.cut_short or work <= 0.0
        while work > 0.0 and stars[3] < min(len(observed), MOST_STARS) and len(known) < _MOST_VERIFIED:
            plan = _plan(scale, work, observed, prior)
            count, patterns, left = search_patterns(vectors, sigma, table, sky, plan, stars, known, finds)
            pool.operations += int(work - left)
            work = left
            looked += patterns
            for k in np.argsort(finds.score[:count]):
                focal = float(finds.focal[k])
                pool.check(finds.matrix[k], observed, guide, SCALES[-1], None if focal == 1.0 else focal)
                known = np.concatenate([known, finds.matrix[k : k + 1]])
            if pool.decided:
                break
        pool.note(f"errors {scale:g} times as stated: {looked} patterns looked up, {len(known)} attitudes checked")
        if pool.hypotheses and pool.log_chance <= pool.limit:
            break
    return pool.outcome(observed)


def _plan(scale: float, work: float, observed: Observed, prior: Prior | None) -> Plan:
    matrix, cosine = np.eye(3), -2.0
    if prior is not None:
        slack = prior.radius_rad * 1.05 + 10.0 * scale * float(observed.sigma_rad.max()) + FOCAL_RANGE
        matrix, cosine = np.ascontiguousarray(prior.attitude.as_matrix()), math.cos(min(slack, math.pi))
    passing = 0.0 if len(observed) <= _FEW_STARS else _PASSING
    return Plan(scale, FOCAL_RANGE, MOST_STARS, work, passing, _STRONG, matrix, cosine)
