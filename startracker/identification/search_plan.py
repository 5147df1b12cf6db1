"""How many true stars an accepted answer needs, and the cheapest search that rarely misses that many.

Of n points, m of which are true, H are used as the pole, and the L nearest neighbours of each vote. A pole is a true
star with a probability of m/n, and about (m − 1) L/(n − 1) of its neighbours are true. Let h be the (binomial)
probability that these are enough for the required votes; the field is then missed with a probability of (1 − H h/n)^m.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc, pdtr, pdtrc, pdtrik  # scipy.stats would take 36 MB and half a second to load

from startracker.core import FloatArray
from startracker.identification.bayes_factor import SCALE_LOG_PRIOR, SCALES, count_table
from startracker.identification.verification import MOST_EXTRA

ROLLS = 64
"""Number of rolls that the votes for a guide star distinguish."""
MOST_VOTES = 8
_NEIGHBOURS = (2, 3, 4, 5, 6, 7, 8, 10, 12, 15, 19, 24, 30, 38, 48, 60, 76, 96, 119)
_PAIR_NS, _CANDIDATE_NS, _STAR_NS = 12.0, 700.0, 6.0
"""Cost, ns, of a guide pair, of an attitude that is tried, and of a guide star whose votes are counted."""
_LOG_SPHERE_OF_ROTATIONS, _LOG_2PI = math.log(8.0 * math.pi**2), math.log(2.0 * math.pi)


class Plan(NamedTuple):
    """A search by votes.

    Number of stars used as the pole, number of their nearest neighbours that vote, number of votes that must agree, and
    whether more poles would be needed than the permitted cost allows.
    """

    poles: int
    neighbours: int
    votes: int
    cut_short: bool = False


def crowding_price(excess: FloatArray) -> FloatArray:
    """Least reduction of ln B (n,) of 1 to n matches for crowded points, from `excess` (widths, n) (`clustering_null`).

    For each number of matches it is that of the points that are crowded least.
    """
    return np.asarray(np.maximum(np.cumsum(np.sort(excess, axis=1), axis=1).max(axis=0), 0.0))


def fewest_matches(evidence: FloatArray, price: FloatArray, least_log_b: float) -> int:
    """Fewest matches for which ln B exceeds a limit; one more than the number of stars if none is sufficient.

    Parameters
    ----------
    evidence, price : (n + 1,), (n,)
        Results of `evidence_of_matches` and `crowding_price`.
    least_log_b : float
        Limit on ln B.
    """
    enough = np.flatnonzero(evidence[1:] - price > least_log_b)
    return int(enough[0]) + 1 if len(enough) else len(evidence)


@lru_cache(maxsize=512)
def evidence_of_matches(n: int, in_field: int, log_area: float, scale: float, unknowns: int) -> FloatArray:
    """ln B (n + 1,) of 0 to n matches among n points distributed over the image.

    It assumes a field with the average number of guide stars, of which the observed ones are distributed evenly over
    the brightnesses, and a fit that is perfect at `scale` times the stated errors (`bayes_factor.log_bayes_factor`).

    Parameters
    ----------
    n, in_field : int
        Number of observed stars, and of guide stars in the field.
    log_area : float
        ln of the image's area in units of the squared stated error.
    scale : float
        Multiple of the stated errors.
    unknowns : int
        3, or 4 if the focal length is fitted too.
    """
    counts = count_table(n, 2 * n + MOST_EXTRA)
    row = int(np.argmin(np.abs(SCALES - scale)))
    log_area -= 2.0 * math.log(SCALES[row])
    depths = np.arange(1, min(in_field, 2 * n + MOST_EXTRA) + 1)
    out = np.full(n + 1, -np.inf)
    for m in range(3, min(n, len(depths)) + 1):  # none in a field without guide stars
        # For m stars distributed over a square, the information on the roll is 1/6 of that on the other two angles.
        volume = 0.5 * unknowns * _LOG_2PI - 1.5 * (log_area + math.log(m)) + 0.5 * math.log(6.0)
        within = m * depths // depths[-1]
        value = within * (log_area - _LOG_2PI) + counts.log_weight[depths, within]
        average = float(np.logaddexp.reduce(value) - counts.log_total[depths[-1]])
        out[m] = volume - _LOG_SPHERE_OF_ROTATIONS + SCALE_LOG_PRIOR[row] + average
    return out


class Setting(NamedTuple):
    """Conditions of a search by votes.

    Parameters
    ----------
    pairs : float
        Number of guide pairs for a neighbour at a distance of the field's width; it is proportional to the distance.
    guides : int
        Number of guide stars.
    rolls : float
        Number of the 64 rolls that a vote covers.
    gate : float
        Expected number of guide stars by chance in the gate of a star close to the pair.
    rare : float
        Largest probability that a false attitude is verified.
    """

    pairs: float
    guides: int
    rolls: float
    gate: float
    rare: float


@lru_cache(maxsize=1024)
def plan(n: int, fewest: int, miss: float, most_ns: float, setting: Setting, multiples: tuple[float, ...]) -> Plan:
    """Cheapest search that misses `fewest` true stars of n with a probability of at most `miss`.

    If that is too expensive, it is the search that misses the multiples of `fewest` least often on average.

    Parameters
    ----------
    n, fewest, miss
        See the module's description.
    most_ns : float
        Largest cost, ns.
    setting : Setting
    multiples : tuple of float
        Multiples of `fewest`; the first is 1.
    """
    pairs, guides, rolls, gate, rare = setting
    neighbours = np.array([count for count in _NEIGHBOURS if count < n - 1] + [n - 1])[:, None]
    votes = np.arange(2, min(fewest - 1, MOST_VOTES) + 1)[None, :]
    true = np.minimum(np.ceil(fewest * np.array(multiples)), n)[:, None, None]
    # bdtrc is the survival function of the binomial distribution, pdtrc that of the Poisson distribution.
    found = bdtrc(np.minimum(votes - 1, neighbours), neighbours, (true - 1.0) / (n - 1)) * (votes <= neighbours)
    # The L nearest of n on a square lie within a circle of L/n of its area, at a mean distance of 2/3 of its radius.
    looked = pairs * neighbours * (2.0 / 3.0) * np.sqrt(neighbours / n / math.pi)
    by_chance = pdtrc(votes - 1, 2.0 * looked * rolls / (ROLLS * guides)) * ROLLS * guides * votes
    each = _PAIR_NS * looked + _CANDIDATE_NS * by_chance + _STAR_NS * guides
    # (1 − H h/n)^m = miss, solved for H.
    enough = np.ceil(n * (1.0 - miss ** (1.0 / fewest)) / np.maximum(found[0], 1e-9))
    poles = np.minimum(np.minimum(enough, most_ns // each), n)
    # The other stars are about half a field's width from the pair, so that the pair's error is multiplied by a long
    # lever.
    others = (n - 2) * gate * (1.5 + 0.5 * n * math.pi / neighbours)
    hopeless = (_poisson_quantile(1.0 - rare, others) + 1 > true - 2) | (found == 0.0)
    missed = np.maximum((1.0 - poles / n * found) ** true, miss)
    certain = np.where(hopeless, 1.0, missed).mean(axis=0)
    order = np.lexsort([(poles * each).ravel(), missed.mean(axis=0).ravel(), certain.ravel()])
    row, column = np.unravel_index(order[0], each.shape)
    cut_short = bool(poles[row, column] < min(enough[row, column], n))
    return Plan(int(poles[row, column]), int(neighbours[row, 0]), int(votes[0, column]), cut_short)


def _poisson_quantile(q: float, mean: NDArray[np.float64]) -> NDArray[np.float64]:
    """Smallest count k with P(N ≤ k) ≥ q for a Poisson-distributed N."""
    k = np.ceil(pdtrik(q, mean))
    below = np.maximum(k - 1.0, 0.0)
    return np.asarray(np.where(pdtr(below, mean) >= q, below, k))
