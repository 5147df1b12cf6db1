"""The one rule of acceptance: an answer is accepted if it occurs by chance more rarely than the user allows.

With B the Bayes factor of the best answer and Bₖ those of its rivals the reported chance is

    p (1 + Σ Bₖ) / B

where p bounds the density of ln B over skies of the hypothesis (`bayes_factor.largest_density`); 1, the bound of
Markov, if that is not known. It holds for any B > p, below one as well, and so for every rate between 0 and 1. Prior
knowledge of the attitude enters as `log_gain`:

- the whole sky: B is an average over it; none.
- a cone about a prior attitude multiplies B and Bₖ by what it narrows the search.
- a prediction with its covariance: B is an average over that Gaussian (`startracker.tracking.evidence`); none.
- an unknown scale, where T patterns were tried without averaging over attitudes, divides them by T.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from startracker.identification.observed import Identification
from startracker.settings import IdentificationSettings
from startracker.solution import Solution, Status

SURE_BEYOND = 15.0
"""Margin to the limit (in ln of the chance) beyond which no other hypothesis can compete."""
WITHIN_PRIOR_BEYOND = 5.0
"""The same for an answer within a prior, which supports it as well; the whole sky costs up to 10⁹ operations."""


def log_chance(
    log_evidence: float, rivals: Sequence[float] = (), *, log_gain: float = 0.0, log_density: float = 0.0
) -> float:
    """ln of the chance that the best answer is wrong; above 0 if it means nothing.

    Parameters
    ----------
    log_evidence, rivals : float, sequence of float
        ln B of the best answer, and of its rivals.
    log_gain : float
        ln of the factor on all B: above 0 for a prior, below for patterns tried.
    log_density : float
        ln p.
    """
    if not rivals:
        return log_density - log_gain - log_evidence
    highest = max(-log_gain, *rivals)
    total = math.exp(-log_gain - highest) + sum(math.exp(rival - highest) for rival in rivals)
    return log_density + highest + math.log(total) - log_evidence


def log_limit(settings: IdentificationSettings) -> float:
    """ln of the largest chance that is accepted."""
    return math.log(settings.false_alarm_rate)


def is_beyond_doubt(
    found: Identification | Solution, settings: IdentificationSettings, beyond: float = SURE_BEYOND
) -> bool:
    """Whether an answer is accepted with such a margin that no other search can find more evidence."""
    return found.status is Status.SOLVED and found.log_false_alarm < log_limit(settings) - beyond


def accepts(chance: float, settings: IdentificationSettings) -> bool:
    """Whether an answer with this `log_chance` is accepted; NaN is not."""
    return chance <= log_limit(settings)


def power_of_ten(log_value: float) -> str:
    """A chance as text, rounded down to a power of ten: e⁻²⁰⁰⁰ is not a float."""
    exponent = math.floor(min(log_value, 0.0) / math.log(10.0))
    return f"1e{exponent}" if exponent < 0 else "1"
