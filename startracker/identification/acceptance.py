"""Acceptance by probability: an attitude is accepted if the chance of a coincidence is below the user's limit.

Let B be the Bayes factor of the best answer and Bₖ those of its rivals. The reported chance is

    p (1 + Σ Bₖ) / B

where p bounds the density of ln B over skies under the hypothesis (`bayes_factor.largest_density`), or is 1 (Markov's
bound) if that is unknown. It is valid for any B > p, including B < 1, and so for every limit between 0 and 1. Prior
knowledge of the attitude enters as `log_gain`:

- the whole sky: none, because B is an average over all attitudes.
- a cone around a prior attitude: B and Bₖ are multiplied by the factor by which it restricts the attitudes.
- a prediction with its covariance: none, because B is an average over that Gaussian (`startracker.tracking.matching`).
- an unknown scale: if T patterns were tried without an average over attitudes, B and Bₖ are divided by T.

Each hypothesis, however it was found, is fitted to all observed stars of the field and its Bayes factor is computed
(`bayes_factor`): the more stars it explains, and the fewer its rivals explain, the less probable is a coincidence.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from startracker._compiled import kernel
from startracker.catalog.guide import GuideDatabase
from startracker.core import FloatArray, IntArray
from startracker.estimation.directions import focal_slopes
from startracker.identification.bayes_factor import count_table, largest_density
from startracker.identification.clustering_null import log_excess_density
from startracker.identification.observed import Identification, Observed, Prior, magnitudes_of
from startracker.identification.search_state import Stars
from startracker.identification.verification import MOST_EXTRA, Verified, verify_attitude
from startracker.settings import IdentificationSettings
from startracker.solution import Solution, Status
from startracker.trace import Steps

SURE_BEYOND = 15.0
"""Margin to the limit (in ln of the chance) beyond which no other hypothesis can compete."""
WITHIN_PRIOR_BEYOND = 5.0
"""The same margin for an answer within a prior, which supports it as well; searching the whole sky costs up to 10⁹
operations."""


def log_chance(
    log_evidence: float, rivals: Sequence[float] = (), *, log_gain: float = 0.0, log_density: float = 0.0
) -> float:
    """ln of the chance that the best answer is wrong; above 0 if the answer is meaningless.

    Parameters
    ----------
    log_evidence, rivals : float, sequence of float
        ln B of the best answer, and of each rival.
    log_gain : float
        ln of the factor on all B: above 0 for a prior, below 0 for patterns tried.
    log_density : float
        ln of the bound p on the density.
    """
    if not rivals:
        return log_density - log_gain - log_evidence
    # log-sum-exp of 1 / gain and all rivals, relative to the highest, because B may be e²⁰⁰⁰.
    highest = max(-log_gain, *rivals)
    total = math.exp(-log_gain - highest) + sum(math.exp(rival - highest) for rival in rivals)
    return log_density + highest + math.log(total) - log_evidence


def log_limit(settings: IdentificationSettings) -> float:
    """ln of the largest chance that is accepted."""
    return math.log(settings.false_alarm_rate)


def passes_confirmation_threshold(
    found: Identification | Solution, settings: IdentificationSettings, beyond: float = SURE_BEYOND
) -> bool:
    """Whether an answer is accepted with so large a margin that no other search can find more evidence."""
    return found.status is Status.SOLVED and found.log_false_alarm < log_limit(settings) - beyond


def accepts(chance: float, settings: IdentificationSettings) -> bool:
    """Whether an answer with this `log_chance` is accepted; never for NaN."""
    return chance <= log_limit(settings)


def power_of_ten(log_value: float) -> str:
    """A chance as text, rounded down to a power of ten; e⁻²⁰⁰⁰ cannot be represented as a float."""
    exponent = math.floor(min(log_value, 0.0) / math.log(10.0))
    return f"1e{exponent}" if exponent < 0 else "1"


SCALES: tuple[float, ...] = (1.0, 3.0, 10.0)
"""Multiples of the stated centroid errors that are tried in turn: with 0.1 px stated and 1 px actual, stars are still
identified."""
WIDEST_SHARE = 0.01
"""Largest error that is assumed, as a share of the field's half diagonal (3.6 px of 512), unless more is stated."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """An attitude with the pairs of stars that it explains.

    Parameters
    ----------
    matrix : (3, 3)
        ICRS to camera.
    pairs : int (M, 2)
        Observed and guide index.
    log_evidence : float
        ln B (`bayes_factor`).
    scale : float
        Multiple of the stated errors that fits best.
    in_field : int
        Number of guide stars expected on the image, limited to what can be among the observed ones.
    focal : float
        Ratio of the focal length to the camera's; 1 if that fits.
    """

    matrix: FloatArray
    pairs: IntArray
    log_evidence: float
    scale: float
    in_field: int
    focal: float = 1.0

    def agrees_with(self, other: Hypothesis) -> bool:
        """Whether two hypotheses are the same: at least half of the pairs of the smaller one are shared."""
        mine = {(int(o), int(g)) for o, g in self.pairs}
        theirs = {(int(o), int(g)) for o, g in other.pairs}
        return len(mine & theirs) >= 0.5 * max(1, min(len(mine), len(theirs)))


def kernel_stars(observed: Observed, guide: GuideDatabase) -> Stars:
    """Observed stars in the form that kernels read, cached in `observed`."""
    area, kept = guide.solid_angle_sr, observed.kept
    if area not in kept:
        n, vectors = len(observed), np.ascontiguousarray(observed.vectors, dtype=np.float64)
        sigma = np.ascontiguousarray(observed.sigma_rad, dtype=np.float64)
        slopes, excess, magnitude = _derived(vectors, observed.flux_or_nan(), area)
        counts = count_table(n, 2 * n + MOST_EXTRA)
        kept[area] = Stars(vectors, slopes, sigma, magnitude, counts, excess)
    stars: Stars = kept[area]
    return stars


@kernel
def _derived(vectors: FloatArray, flux: FloatArray, area: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """`focal_slopes`, `log_excess_density` and `magnitudes_of` of the stars in one call, which compiles one kernel."""
    return focal_slopes(vectors), log_excess_density(vectors, area), magnitudes_of(flux)


def verify(
    matrix: FloatArray,
    observed: Observed,
    guide: GuideDatabase,
    scale: float = SCALES[-1],
    focal: float | None = None,
) -> tuple[Hypothesis | None, int]:
    """Verify an attitude against every observed star: match, refit until the match no longer changes, compute ln B.

    Parameters
    ----------
    matrix : (3, 3)
        ICRS to camera.
    observed, guide
        Observed stars, and guide stars.
    scale : float
        The first gate is 4.5 × `scale` × the stated errors; narrower ones follow, and the one with the largest ln B is
        used.
    focal : float, optional
        Initial ratio of the focal length if that is fitted too (within some 2 %).

    Returns
    -------
    Hypothesis, or None if fewer than three stars agree; and the number of operations.
    """
    start, free = np.ascontiguousarray(matrix, dtype=np.float64), focal is not None
    log_focal = 0.0 if focal is None else math.log(focal)
    found = verify_attitude(start, log_focal, kernel_stars(observed, guide), guide.view, float(scale), free)
    return hypothesis_of(found), found.operations


def hypothesis_of(found: Verified) -> Hypothesis | None:
    """Result of `verify_attitude` as an object; None if fewer than three stars agree."""
    if not found.log_b > -math.inf:
        return None
    return Hypothesis(
        matrix=found.matrix,
        pairs=found.pairs,
        log_evidence=found.log_b,
        scale=found.scale,
        in_field=found.in_field,
        focal=math.exp(found.focal),
    )


def tried_scales(observed: Observed, guide: GuideDatabase) -> tuple[float, ...]:
    """The `SCALES` with which the errors remain a small share of the field's half diagonal; at least the first."""
    largest = WIDEST_SHARE * guide.half_diagonal_rad / float(np.median(observed.sigma_rad))
    return tuple(scale for scale in SCALES if scale <= largest) or SCALES[:1]


def too_few(observed: Observed, least: int) -> Identification:
    """Result if fewer stars were observed than a method needs."""
    reason = f"{len(observed)} stars seen, {least} are needed"
    return Identification(Status.NO_STARS if len(observed) == 0 else Status.TOO_FEW_STARS, reason)


@dataclass
class HypothesisPool:
    """The hypotheses of one identification, and the decision between them.

    Parameters
    ----------
    settings : IdentificationSettings
        Supplies the false-alarm rate and the least number of stars.
    prior : Prior, optional
        The smaller the range of possible attitudes, the fewer coincidences are possible.
    stars : int
        Number of observed stars.
    hypotheses : list of Hypothesis
        Those with the strongest evidence, in descending order.
    tried : list
        What was tried: texts, or functions that return one, which are evaluated only for an explanation.
    operations : int
        Operations used so far (`IdentificationSettings.max_operations`).
    cut_short : bool
        Whether the search was incomplete because its operations were used up.
    """

    settings: IdentificationSettings
    prior: Prior | None = None
    stars: int = 3
    hypotheses: list[Hypothesis] = field(default_factory=list)
    tried: list[str | Callable[[], str]] = field(default_factory=list)
    operations: int = 0
    cut_short: bool = False

    def __post_init__(self) -> None:
        self.limit = log_limit(self.settings)
        """ln of the largest chance that is accepted."""
        self._log_density, self._gain = math.log(largest_density(self.stars)), _gain(self.prior)
        self.least_evidence = self._log_density - self.limit - self._gain
        """ln B above which a hypothesis without rivals is accepted."""
        self.decisive_evidence = SURE_BEYOND + self.least_evidence
        """ln B above which a hypothesis without rivals is `decided`."""

    @property
    def left(self) -> int:
        """Operations that the search may still use."""
        return self.settings.max_operations - self.operations

    def spend(self, operations: float) -> bool:
        """Count the operations of a step, or return False and set `cut_short` if fewer are left."""
        if operations > self.left:
            self.cut_short = True
            return False
        self.operations += int(operations)
        return True

    def check(
        self,
        matrix: FloatArray,
        observed: Observed,
        guide: GuideDatabase,
        scale: float = SCALES[-1],
        focal: float | None = None,
    ) -> None:
        """Verify an attitude and add it, unless no operations are left."""
        if self.left <= 0:
            self.cut_short = True
            return
        hypothesis, operations = verify(matrix, observed, guide, scale, focal)
        self.operations += operations
        self.add(hypothesis)

    def add(self, hypothesis: Hypothesis | None) -> None:
        """Add a verified hypothesis; if it agrees with one that is known, the better of the two is used."""
        if hypothesis is None or not (self.prior is None or self.prior.allows(hypothesis.matrix)):
            return
        for k, known in enumerate(self.hypotheses):
            if known.agrees_with(hypothesis):
                if hypothesis.log_evidence > known.log_evidence:
                    self.hypotheses[k] = hypothesis
                break
        else:
            self.hypotheses.append(hypothesis)
        if len(self.hypotheses) > 1:
            self.hypotheses.sort(key=lambda h: -h.log_evidence)
            del self.hypotheses[20:]  # weaker ones contribute nothing to the sum of rivals

    def note(self, text: str | Callable[[], str]) -> None:
        """Record what was tried, for the explanation."""
        self.tried.append(text)

    @property
    def log_chance(self) -> float:
        """ln of the chance that the best hypothesis is wrong: p (1 + Σ B of the others) / B."""
        if not self.hypotheses:
            return 0.0
        best, *others = (h.log_evidence for h in self.hypotheses)
        return log_chance(best, others, log_gain=self._gain, log_density=self._log_density)

    @property
    def decided(self) -> bool:
        """Whether the best hypothesis exceeds the limit so far that no other can compete."""
        return bool(self.hypotheses) and self.log_chance < self.limit - SURE_BEYOND

    def outcome(self, observed: Observed) -> Identification:
        """Outcome with its reason: solved, ambiguous, no match, or ended by the limit on operations."""
        found = self._outcome(observed)
        if found.status is Status.SOLVED:
            return found
        status, reason = found.status, found.reason
        if self.cut_short:
            limit = self.settings.max_operations
            reason = f"ended by the limit on its operations (max_operations {limit:.3g}); until then: {reason}"
            status = Status.SEARCH_LIMIT
        return replace(found, status=status, reason=reason, operations=self.operations)

    def _outcome(self, observed: Observed) -> Identification:
        seen = f"{len(observed)} stars seen"
        if self.prior is not None:
            seen += f", prior within {math.degrees(self.prior.radius_rad):.2g}°"
        if not self.hypotheses:
            return Identification(
                Status.NO_MATCH, f"no attitude explains three stars: {seen}", steps=Steps(*self.tried)
            )
        best, chance, limit = self.hypotheses[0], self.log_chance, self.settings.false_alarm_rate
        says = f"{len(best.pairs)} of {len(observed)} stars fit, {best.in_field} guide stars in that field"
        steps = Steps(*self.tried, partial(_described, tuple(self.hypotheses[:3])))
        enough = len(best.pairs) >= self.settings.min_stars
        if enough and accepts(chance, self.settings):
            reason = f"{says}; by chance with probability {power_of_ten(chance)}"
            return Identification(
                status=Status.SOLVED,
                reason=reason,
                pairs=best.pairs,
                log_false_alarm=chance,
                focal=best.focal,
                steps=steps,
                operations=self.operations,
            )
        if not enough or chance > self._log_density:
            reason = f"best attitude is no better than chance: {says}"
            return Identification(Status.NO_MATCH, reason, log_false_alarm=min(chance, 0.0), steps=steps)
        # Without its rivals the best hypothesis would be accepted, so they are the reason.
        if len(self.hypotheses) > 1 and self._log_density - best.log_evidence - self._gain <= self.limit:
            other = self.hypotheses[1]
            reason = f"{says}, but another part of the sky fits {len(other.pairs)} stars nearly as well"
        else:
            reason = f"{says}: by chance with probability {power_of_ten(chance)}, above the limit of {limit:.0e}"
        return Identification(Status.AMBIGUOUS, reason, log_false_alarm=chance, steps=steps)


def _gain(prior: Prior | None) -> float:
    """Gain in ln B from a prior: a fraction (ρ − sin ρ)/π of all rotations is by less than its radius ρ."""
    if prior is None:
        return 0.0
    radius = min(prior.radius_rad, math.pi)
    # The difference cancels for small radii, where the first term of its series is ρ³/6.
    return -math.log((radius - math.sin(radius)) / math.pi if radius > 1e-3 else radius**3 / (6.0 * math.pi))


def _described(hypotheses: tuple[Hypothesis, ...]) -> tuple[str, ...]:
    return tuple(map(_describe, hypotheses))


def _describe(hypothesis: Hypothesis) -> str:
    x, y, z = hypothesis.matrix[2].tolist()
    ra, dec = math.degrees(math.atan2(y, x)) % 360.0, math.degrees(math.asin(max(-1.0, min(1.0, z))))
    return (
        f"hypothesis at RA {ra:.3f}°, Dec {dec:+.3f}°: {len(hypothesis.pairs)} stars fit within "
        f"{hypothesis.scale:g} stated errors, {hypothesis.in_field} guide stars expected; "
        f"e^{hypothesis.log_evidence:.1f} times likelier than chance"
    )
