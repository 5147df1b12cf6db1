"""Acceptance by probability: an attitude is believed only when chance cannot explain it and nothing competes.

Each hypothesis, however it was found, is refitted to all observed stars of the field and weighed (`bayes_factor`):
the more it explains, and the fewer rivals explain anything, the less is left to chance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from startracker.catalog.guide import GuideDatabase
from startracker.estimation.directions import focal_slopes
from startracker.identification.acceptance import SURE_BEYOND, accepts, log_chance, log_limit, power_of_ten
from startracker.identification.bayes_factor import count_table, largest_density
from startracker.identification.clustering_null import log_excess_density
from startracker.identification.observed import Identification, Observed, Prior
from startracker.identification.search_state import Stars
from startracker.identification.verification import (
    MOST_EXTRA,
    Verified,
    match_nearest,
    verify_attitude,
)
from startracker.kernels import kernel
from startracker.settings import IdentificationSettings
from startracker.solution import Status
from startracker.trace import Steps

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SCALES = (1.0, 3.0, 10.0)
"""Multiples of the stated centroid errors that are tried in turn: 0.1 px stated and 1 px real is still identified."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """An attitude with the pairs it explains.

    Parameters
    ----------
    matrix : (3, 3)
        ICRS to camera.
    pairs : int (M, 2)
        Observed and guide index.
    log_evidence : float
        ln B (`bayes_factor`).
    scale : float
        Which multiple of the stated errors explains it best.
    in_field : int
        Guide stars expected on the image, as many as can be among the observed.
    focal : float
        Factor of the focal length against the camera's; 1 where that fits.
    """

    matrix: FloatArray
    pairs: IntArray
    log_evidence: float
    scale: float
    in_field: int
    focal: float = 1.0

    def agrees_with(self, other: Hypothesis) -> bool:
        """Whether two hypotheses are one and the same: most of the smaller one's pairs are shared."""
        mine = {(int(o), int(g)) for o, g in self.pairs}
        theirs = {(int(o), int(g)) for o, g in other.pairs}
        return len(mine & theirs) >= 0.5 * max(1, min(len(mine), len(theirs)))


@kernel
def nearest_unique(points: FloatArray, candidates: FloatArray, gate: FloatArray) -> tuple[IntArray, FloatArray]:
    """Nearest candidate (K, D) of each point (N, D) within its gate (N,), each used once, as `match_nearest` has it.

    Returns the index or −1 and the distance or inf, each (N,).
    """
    index, distance = np.empty(len(points), np.int64), np.empty(len(points))
    match_nearest(points, candidates, gate, index, distance, np.empty(len(candidates), np.int64))
    return index, distance


def kernel_stars(observed: Observed, guide: GuideDatabase) -> Stars:
    """Observed stars as the kernels take them, kept with these."""
    area, kept = guide.solid_angle_sr, observed.kept
    if area not in kept:
        vectors, n = np.ascontiguousarray(observed.vectors, dtype=np.float64), len(observed)
        kept[area] = Stars(
            vectors,
            focal_slopes(vectors),
            np.ascontiguousarray(observed.sigma_rad, dtype=np.float64),
            observed.magnitudes_or_nan(),
            count_table(n, 2 * n + MOST_EXTRA),
            log_excess_density(vectors, area),
        )
    stars: Stars = kept[area]
    return stars


def verify(
    matrix: FloatArray,
    observed: Observed,
    guide: GuideDatabase,
    scale: float = SCALES[-1],
    focal: float | None = None,
) -> Hypothesis | None:
    """Check an attitude against every observed star: match, refit until it stands still, weigh.

    Parameters
    ----------
    matrix : (3, 3)
        ICRS to camera.
    observed, guide
        What was seen, and the sky.
    scale : float
        The first gate is 4.5 times this times the stated errors; narrower ones follow, and the one with most evidence
        is kept.
    focal : float, optional
        Factor of the focal length to start from, where that is fitted too (within some 2 %).

    Returns
    -------
    Hypothesis, or None when fewer than three stars agree.
    """
    return _verified(matrix, observed, guide, scale, focal)[0]


def _verified(
    matrix: FloatArray, observed: Observed, guide: GuideDatabase, scale: float, focal: float | None
) -> tuple[Hypothesis | None, int]:
    """What `verify` gives, and the operations it took."""
    found = verify_attitude(
        np.ascontiguousarray(matrix, dtype=np.float64),
        0.0 if focal is None else math.log(focal),
        kernel_stars(observed, guide),
        guide.view,
        float(scale),
        focal is not None,
    )
    return hypothesis_of(found), found.operations


def hypothesis_of(found: Verified) -> Hypothesis | None:
    """What `verify_attitude` says, as an object; None when fewer than three stars agree."""
    if not found.log_b > -math.inf:
        return None
    stars = np.flatnonzero(found.guide_of >= 0)
    pairs = np.stack([stars, found.guide_of[stars]], axis=1)
    return Hypothesis(found.matrix, pairs, found.log_b, found.scale, found.in_field, math.exp(found.focal))


def too_few(observed: Observed, least: int) -> Identification:
    """Answer where fewer stars were seen than a method needs."""
    reason = f"{len(observed)} stars seen, {least} are needed"
    return Identification(Status.NO_STARS if len(observed) == 0 else Status.TOO_FEW_STARS, reason)


@dataclass
class Bench:
    """Collects the hypotheses of one identification and judges them.

    Parameters
    ----------
    settings : IdentificationSettings
        For the false-alarm rate and the least number of stars.
    prior : Prior, optional
        Attitudes that can be: the fewer, the less is left to chance.
    stars : int
        Observed stars.
    operations : int
        Taken so far (`IdentificationSettings.max_operations`).
    cut_short : bool
        Whether something was left out for want of operations.
    """

    settings: IdentificationSettings
    prior: Prior | None = None
    stars: int = 3
    standing: list[Hypothesis] = field(default_factory=list)
    tried: list[str] = field(default_factory=list)
    operations: int = 0
    cut_short: bool = False

    @property
    def left(self) -> int:
        """Operations that the search may still take."""
        return self.settings.max_operations - self.operations

    def spend(self, operations: float) -> bool:
        """Count the operations of a step; False, and the search is `cut_short`, where there are not as many left."""
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
        """Take in an attitude as `verify` finds it, unless there are no operations left."""
        if self.left <= 0:
            self.cut_short = True
            return
        hypothesis, operations = _verified(matrix, observed, guide, scale, focal)
        self.operations += operations
        self.add(hypothesis)

    def add(self, hypothesis: Hypothesis | None) -> None:
        """Take in a verified hypothesis; one that repeats another replaces it only when it is better."""
        if hypothesis is None or not self._allowed(hypothesis):
            return
        for k, known in enumerate(self.standing):
            if known.agrees_with(hypothesis):
                if hypothesis.log_evidence > known.log_evidence:
                    self.standing[k] = hypothesis
                break
        else:
            self.standing.append(hypothesis)
        self.standing.sort(key=lambda h: -h.log_evidence)
        del self.standing[20:]

    def note(self, text: str) -> None:
        """Write down what was tried, for the explanation."""
        self.tried.append(text)

    @property
    def log_chance(self) -> float:
        """Logarithm of the chance that the best hypothesis is none: (1 + Σ B of the others) p / B, p the density."""
        if not self.standing:
            return 0.0
        best, *others = (h.log_evidence for h in self.standing)
        return log_chance(best, others, log_gain=self._gain, log_density=self._log_density)

    @property
    def surely(self) -> bool:
        """Whether the best one is so far beyond the limit that looking on is idle."""
        return bool(self.standing) and self.log_chance < self.limit - SURE_BEYOND

    @property
    def sure_evidence(self) -> float:
        """ln B from which a hypothesis without rivals is `surely`."""
        return SURE_BEYOND + self.least_evidence

    @property
    def least_evidence(self) -> float:
        """ln B from which a hypothesis without rivals is accepted."""
        return self._log_density - self.limit - self._gain

    @property
    def limit(self) -> float:
        """Logarithm of the chance that is still accepted."""
        return log_limit(self.settings)

    @property
    def _log_density(self) -> float:
        return math.log(largest_density(self.stars))

    @property
    def _gain(self) -> float:
        """What a prior adds to ln B: the share of all rotations that turn by less than its radius is (ρ − sin ρ)/π."""
        if self.prior is None:
            return 0.0
        radius = min(self.prior.radius_rad, math.pi)
        return -math.log((radius - math.sin(radius)) / math.pi if radius > 1e-3 else radius**3 / (6.0 * math.pi))

    def _allowed(self, hypothesis: Hypothesis) -> bool:
        if self.prior is None:
            return True
        turn = hypothesis.matrix @ self.prior.attitude.as_matrix().T
        return bool((np.trace(turn) - 1.0) / 2.0 >= math.cos(min(self.prior.radius_rad * 1.05, math.pi)))

    def judge(self, observed: Observed) -> Identification:
        """Solved, ambiguous, no match, or ended by the limit on operations, with the reason in words."""
        found = self._judge(observed)
        if found.status is Status.SOLVED:
            return found
        status, reason = found.status, found.reason
        if self.cut_short:
            limit = self.settings.max_operations
            reason = f"ended by the limit on its operations (max_operations {limit:.3g}); until then: {reason}"
            status = Status.SEARCH_LIMIT
        return replace(found, status=status, reason=reason, operations=self.operations)

    def _judge(self, observed: Observed) -> Identification:
        seen = f"{len(observed)} stars seen"
        if self.prior is not None:
            seen += f", prior within {math.degrees(self.prior.radius_rad):.2g}°"
        if not self.standing:
            return Identification(Status.NO_MATCH, f"no attitude explains three stars: {seen}", steps=tuple(self.tried))
        best, chance, limit = self.standing[0], self.log_chance, self.settings.false_alarm_rate
        says = f"{len(best.pairs)} of {len(observed)} stars fit, {best.in_field} guide stars in that field"
        steps = Steps(tuple(self.tried), partial(_described, tuple(self.standing[:3])))
        enough = len(best.pairs) >= self.settings.min_stars
        if enough and accepts(chance, self.settings):
            reason = f"{says}; by chance with probability {power_of_ten(chance)}"
            return Identification(Status.SOLVED, reason, best.pairs, chance, best.focal, steps, self.operations)
        if not enough or chance > self._log_density:
            reason = f"best attitude is no better than chance: {says}"
            return Identification(Status.NO_MATCH, reason, log_false_alarm=min(chance, 0.0), steps=steps)
        if len(self.standing) > 1 and self._log_density - best.log_evidence - self._gain <= self.limit:
            other = self.standing[1]
            reason = f"{says}, but another part of the sky fits {len(other.pairs)} stars nearly as well"
        else:
            reason = f"{says}: by chance with probability {power_of_ten(chance)}, above the limit of {limit:.0e}"
        return Identification(Status.AMBIGUOUS, reason, log_false_alarm=chance, steps=steps)


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
