"""Acceptance by probability: an attitude is believed only when chance cannot explain it and nothing competes.

Each hypothesis, however it was found, is refitted to all observed stars of the field and weighed (`evidence`). The
chance that any of the H hypotheses implied by the search gives such evidence on a random sky is at most H/Λ.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numpy.typing import NDArray

from startracker.catalog.guide import GuideDatabase
from startracker.identification.evidence import log_evidence, magnitude_ratio
from startracker.identification.observed import Identification, Observed, Prior
from startracker.settings import IdentificationSettings
from startracker.solution import Status

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SCALES = (1.0, 3.0, 10.0)
"""Multiples of the stated centroid errors that are tried in turn: 0.1 px stated and 1 px real is still identified."""
GATE_SIGMAS = 4.5


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
        ln Λ, less the price of having chosen among the scales and distractor shares.
    scale : float
        Which multiple of the stated errors explains it best.
    in_field : int
        Guide stars expected on the image.
    """

    matrix: FloatArray
    pairs: IntArray
    log_evidence: float
    scale: float
    in_field: int

    def agrees_with(self, other: Hypothesis) -> bool:
        """Whether two hypotheses are one and the same: most of the smaller one's pairs are shared."""
        mine = {(int(o), int(g)) for o, g in self.pairs}
        theirs = {(int(o), int(g)) for o, g in other.pairs}
        return len(mine & theirs) >= 0.5 * max(1, min(len(mine), len(theirs)))


def fit_rotation(observed: FloatArray, reference: FloatArray, weight: FloatArray) -> FloatArray:
    """Proper rotation (3, 3) with least weighted squares of observed − R · reference (Markley 1988, SVD)."""
    u, _, vt = np.linalg.svd((observed * weight[:, None]).T @ reference)
    u[:, 2] *= np.linalg.det(u) * np.linalg.det(vt)
    return np.asarray(u @ vt)


@njit(cache=True, error_model="numpy")
def nearest_unique(points: FloatArray, candidates: FloatArray, gate: FloatArray) -> tuple[IntArray, FloatArray]:
    """Nearest candidate (K, D) of each point (N, D) within its gate (N,), each candidate used once.

    Where two points claim one candidate the one nearer in units of its gate keeps it. Returns the index or −1 and
    the distance or inf, each (N,).
    """
    n, k = points.shape[0], candidates.shape[0]
    index = np.full(n, -1, np.int64)
    distance = np.full(n, np.inf)
    owner = np.full(k, -1, np.int64)
    for i in range(n):
        best, at = gate[i] ** 2, -1
        for j in range(k):
            d2 = 0.0
            for axis in range(points.shape[1]):
                d2 += (points[i, axis] - candidates[j, axis]) ** 2
                if d2 > best:
                    break
            if d2 <= best:
                best, at = d2, j
        if at < 0:
            continue
        rival = owner[at]
        if rival >= 0 and distance[rival] / gate[rival] <= np.sqrt(best) / gate[i]:
            continue
        if rival >= 0:
            index[rival], distance[rival] = -1, np.inf
        owner[at], index[i], distance[i] = i, at, np.sqrt(best)
    return index, distance


def verify(
    matrix: FloatArray, observed: Observed, guide: GuideDatabase, scale: float = SCALES[-1]
) -> Hypothesis | None:
    """Check an attitude against every observed star: match, refit until it stands still, weigh.

    Starts at `scale` times the stated errors and goes on to the smaller `SCALES`, keeping what has most evidence.

    Returns
    -------
    Hypothesis, or None when fewer than three stars agree.
    """
    magnitude = observed.magnitudes()
    everyone = 2 * len(observed) + 10  # fainter guide stars than these can hardly be among the observed
    best: Hypothesis | None = None
    prices = math.log(len(SCALES))
    for step in [s for s in SCALES[::-1] if s <= scale] or [scale]:
        sigma = observed.sigma_rad * step
        pairs = np.empty((0, 2), dtype=np.int64)
        current = matrix if best is None else best.matrix
        for round_ in range(6):
            field_index, vectors, _ = guide.in_field(current, margin_px=2.0)
            field_index, vectors = field_index[:everyone], vectors[:everyone]
            gate = GATE_SIGMAS * sigma * (2.0 if round_ == 0 and best is None else 1.0)
            index, distance = nearest_unique(observed.vectors, vectors, gate)
            matched = np.flatnonzero(index >= 0)
            if len(matched) < 3:
                break
            new = np.stack([matched, field_index[index[matched]]], axis=1)
            if np.array_equal(new, pairs):
                break
            pairs = new
            weight = 1.0 / sigma[matched] ** 2
            current = fit_rotation(observed.vectors[matched], guide.directions[pairs[:, 1]], weight)
        if len(matched) < 3:
            continue
        ratio = np.ones(len(observed))
        if magnitude is not None:
            v = np.full(len(observed), np.nan)
            v[matched] = guide.v_mag[field_index[index[matched]]]
            ratio = magnitude_ratio(magnitude, v, guide.v_mag[field_index])
        value = log_evidence(distance, sigma, guide.solid_angle_sr, len(field_index), ratio) - prices
        if best is None or value > best.log_evidence:
            best = Hypothesis(current, pairs, value, step, len(field_index))
    return best


@dataclass
class Bench:
    """Collects the hypotheses of one identification and judges them.

    Parameters
    ----------
    settings : IdentificationSettings
        For the false-alarm rate and the least number of stars.
    trials : dict
        For each scale searched, the hypotheses implied so far: two-star attitudes that the observed pairs allow. The
        choice among the scales is paid for in the evidence.
    """

    settings: IdentificationSettings
    trials: dict[float, float] = field(default_factory=dict)
    standing: list[Hypothesis] = field(default_factory=list)
    largest_group: int = 0

    def count(self, scale: float, trials: float) -> None:
        """Add hypotheses tried at a scale."""
        self.trials[scale] = self.trials.get(scale, 0.0) + trials

    def add(self, hypothesis: Hypothesis | None) -> None:
        """Take in a verified hypothesis; one that repeats another replaces it only when it is better."""
        if hypothesis is None:
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

    def log_chance(self, hypothesis: Hypothesis) -> float:
        """Logarithm of the bound on the chance of such evidence, ln H − ln Λ."""
        trials = self.trials.get(hypothesis.scale, max(self.trials.values(), default=1.0))
        return math.log(max(trials, 1e-300)) - hypothesis.log_evidence

    @property
    def surely(self) -> bool:
        """Whether the best one is so far beyond the limit that looking on is idle."""
        return bool(self.standing) and (
            self.log_chance(self.standing[0]) < math.log(self.settings.false_alarm_rate) - 15.0
            and self._gap > self._least_gap
        )

    @property
    def _gap(self) -> float:
        best = self.standing[0].log_evidence
        return best - max(self.standing[1].log_evidence, 0.0) if len(self.standing) > 1 else best

    @property
    def _least_gap(self) -> float:
        return -0.5 * math.log(self.settings.false_alarm_rate)

    def judge(self, observed: Observed, prior: Prior | None = None) -> Identification:
        """Solved, ambiguous or no match, with the reason in words."""
        seen = f"{len(observed)} stars seen"
        if prior is not None:
            seen += f", prior within {math.degrees(prior.radius_rad):.2g}°"
        if not self.standing:
            return Identification(
                Status.NO_MATCH, f"no attitude explains three stars: {seen}, largest match group {self.largest_group}"
            )
        best = self.standing[0]
        chance = self.log_chance(best)
        says = f"{len(best.pairs)} of {len(observed)} stars fit, {best.in_field} guide stars in that field"
        limit = self.settings.false_alarm_rate
        if len(best.pairs) < self.settings.min_stars or chance > 0.0:
            reason = f"best attitude is no better than chance: {says}; largest match group {self.largest_group}"
            return Identification(Status.NO_MATCH, reason, log_false_alarm=min(chance, 0.0))
        if chance > math.log(limit):
            reason = f"{says}: by chance with probability {_power(chance)}, above the limit of {limit:.0e}"
            return Identification(Status.AMBIGUOUS, reason, log_false_alarm=chance)
        if self._gap < self._least_gap:
            other = self.standing[1]
            reason = f"{says}, but another part of the sky fits {len(other.pairs)} stars nearly as well"
            return Identification(Status.AMBIGUOUS, reason, log_false_alarm=chance)
        reason = f"{says}; by chance with probability {_power(chance)}"
        return Identification(Status.SOLVED, reason, best.pairs, chance)


def _power(log_value: float) -> str:
    # e⁻²⁰⁰⁰ is no float
    exponent = math.floor(min(log_value, 0.0) / math.log(10.0))
    return f"1e{exponent}" if exponent < 0 else "1"
