"""Identification by match groups (Van Bezooijen 1989; Greyling 1995, section 5.2).

1. Every observed pair is looked up in the sorted guide pairs; each agreement makes two couples (observed, guide)
   support each other. A couple and all couples that support it form a match group.
2. Groups smaller than a threshold are discarded, also as members of others; the threshold starts two below the
   largest group and is lowered until a group is accepted.
3. Mutual validation and the mirror test: within a group the members must support each other, too.
4. The best groups, by size and then by the RSS of the errors of separations, are verified against all stars of the
   field and accepted by probability (`acceptance`); Greyling 1995 accepts the best group as it is.

Separations are first matched within the stated errors, then within 3 and 10 times those. If the brightest stars fail,
which happens if false ones are among them, the next brightest are tried.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from startracker.catalog.guide import GuideDatabase
from startracker.core import FloatArray, IntArray
from startracker.estimation.wahba import fit_rotation
from startracker.identification.acceptance import SCALES, HypothesisPool, too_few
from startracker.identification.match_kernels import (
    MAX_MEMBERS,
    Groups,
    Shapes,
    Windows,
    collect,
    group_sizes,
    mark,
    validate,
)
from startracker.identification.observed import Identification, Observed, Prior
from startracker.identification.pairs import observed_pairs, pair_tolerance, windows
from startracker.settings import IdentificationSettings, MatchGroupSettings
from startracker.solution import Status

_MOST_STARS = 64  # bits of a word
_MARK_WORK, _COLLECT_WORK, _COUPLE_WORK = 16.0, 64.0, 10.0
"""Operations per guide pair in a window, to mark and to collect it, and per comparison of two members of a group."""


def match_groups(
    observed: Observed,
    guide: GuideDatabase,
    settings: IdentificationSettings | None = None,
    prior: Prior | None = None,
) -> Identification:
    """Identify observed stars, lost in space or around a prior attitude.

    Parameters
    ----------
    observed : Observed
        Brightest first; the brightest `settings.max_stars` form match groups, and if these fail, as many that begin
        half that number further down; all stars are used in the verification.
    guide : GuideDatabase
        Guide stars in apparent directions for the observer.
    settings : MatchGroupSettings
        Tolerances and limits.
    prior : Prior, optional
        Restricts guide stars and couples to what the prior allows.

    Returns
    -------
    Identification
        Status, reason and pairs. Never raises for what was observed.
    """
    settings = MatchGroupSettings.of(settings)
    least = max(settings.min_stars, 3)
    n = min(settings.max_stars, _MOST_STARS)
    if min(len(observed), n) < least:
        return too_few(observed, least)
    pool = HypothesisPool(settings, prior, len(observed))
    scales = SCALES if settings.separation_tolerance_deg is None else SCALES[-1:]
    for skip in (0, n // 2):
        if skip and len(observed) < n + (n - skip) // 2:  # hardly a new star among them
            break
        part = slice(skip, skip + n)
        chosen = Observed(
            observed.vectors[part], None if observed.flux is None else observed.flux[part], observed.sigma_rad[part]
        )
        for scale in scales:
            search = _Search.prepare(chosen, guide, pool, scale)
            if search is None:
                return pool.outcome(observed)
            pool.note(f"match groups within {scale:g} stated errors: largest {search.largest} stars")
            decisive = 0
            for threshold in search.thresholds():
                for size, matrix in search.attitudes(threshold):
                    if size < decisive - 1:  # what comes now cannot compete
                        break
                    pool.check(matrix, observed, guide, scale)
                    if decisive == 0 and pool.decided:
                        decisive = size
                if decisive or pool.cut_short:
                    break
            verdict = pool.outcome(observed)
            if verdict.status is Status.SOLVED or pool.cut_short:
                return verdict
    return verdict


@dataclass(eq=False)
class _Search:
    """One search through the pairs at one tolerance."""

    observed: Observed
    guide: GuideDatabase
    pool: HypothesisPool
    windows: Windows
    tolerance: FloatArray
    separations: FloatArray
    sizes: IntArray
    given_out: set[bytes] = field(default_factory=set)

    @classmethod
    def prepare(
        cls,
        observed: Observed,
        guide: GuideDatabase,
        pool: HypothesisPool,
        scale: float,
    ) -> _Search | None:
        """Match the pairs and mark the couples; None if too few operations are left."""
        settings, prior = MatchGroupSettings.of(pool.settings), pool.prior
        vectors, sigma = observed.vectors, observed.sigma_rad * scale
        i, j, separations = observed_pairs(vectors)
        fixed = settings.separation_tolerance_deg
        tolerance = pair_tolerance(sigma, i, j, separations, None if fixed is None else math.radians(fixed))
        allowed = np.zeros((0, 0), dtype=bool)
        pairs = guide.pairs if prior is None else guide.pairs_near(prior.attitude.boresight, prior.radius_rad)
        if prior is not None:
            expected = vectors @ prior.attitude.as_matrix()
            slack = prior.radius_rad + float(tolerance.max())
            allowed = expected @ guide.directions.T >= math.cos(min(slack, math.pi))
        low, high = windows(pairs, separations, tolerance)
        if not pool.spend(_MARK_WORK * float(np.sum(high - low)) + len(observed) * len(guide)):
            return None
        magnitude, tolerance_mag = observed.magnitudes(), settings.magnitude_tolerance
        if magnitude is None:
            magnitude, tolerance_mag = np.zeros(len(observed)), math.inf
        partners = np.zeros((len(observed), len(guide)), dtype=np.uint64)
        marked = Windows(
            i, j, low, high, pairs.first, pairs.second, magnitude, guide.v_mag, float(tolerance_mag), allowed
        )
        mark(marked, partners)
        return cls(observed, guide, pool, marked, tolerance, separations, group_sizes(partners))

    @property
    def largest(self) -> int:
        """Number of stars in the largest match group."""
        return int(self.sizes.max())

    def thresholds(self) -> range:
        """Limits on the group size, in descending order from two below the largest group (or the setting, if lower)."""
        settings = MatchGroupSettings.of(self.pool.settings)
        least = max(settings.min_stars, 3)
        return range(max(least, min(settings.group_threshold, self.largest - 2)), least - 1, -1)

    def attitudes(self, threshold: int) -> Iterator[tuple[int, FloatArray]]:
        """Size and attitude of the validated groups, largest first; groups that were returned before are skipped."""
        for found in self._validated(threshold):
            code = found.tobytes()
            if code in self.given_out:
                continue
            self.given_out.add(code)
            seen = np.flatnonzero(found >= 0)
            weight = 1.0 / self.observed.sigma_rad[seen] ** 2
            matrix = fit_rotation(self.observed.vectors[seen], self.guide.directions[found[seen]], weight)
            yield len(seen), matrix

    def _validated(self, threshold: int) -> IntArray:
        """Guide star of each observed star, or −1, (K, n), for the groups whose members support each other, best
        first."""
        n, settings = len(self.observed), MatchGroupSettings.of(self.pool.settings)
        none = np.empty((0, n), dtype=np.int64)
        if not self.pool.spend(_COLLECT_WORK * float(np.sum(self.windows.high - self.windows.low))):
            return none
        kernel_obs, kernel_guide = np.nonzero(self.sizes >= threshold)
        group = np.full(self.sizes.shape, -1, dtype=np.int64)
        group[kernel_obs, kernel_guide] = np.arange(len(kernel_obs))
        start, members = collect(self.windows, group, len(kernel_obs))
        members_each = np.minimum(np.diff(start), MAX_MEMBERS).astype(float)
        if not self.pool.spend(_COUPLE_WORK * float(np.sum(members_each**2)) + n * len(kernel_obs)):
            return none
        i, j = self.windows.i, self.windows.j
        low, high = np.ones((2, n, n))
        mirror = np.zeros((n, n))
        low[i, j] = low[j, i] = np.cos(np.minimum(self.separations + self.tolerance, math.pi))
        high[i, j] = high[j, i] = np.cos(np.maximum(self.separations - self.tolerance, 0.0))
        # Height of the triangle over this base, in tolerances: if it is below one, its orientation is noise.
        mirror[i, j] = mirror[j, i] = np.sin(self.separations) * self.tolerance
        shapes = Shapes(self.observed.vectors, self.guide.directions, low, high, mirror)
        groups = Groups(kernel_obs, kernel_guide, start, members)
        size, rss, found = validate(groups, shapes, max(settings.min_stars, 3))
        order = np.lexsort((rss, -size))
        order = order[size[order] >= threshold]
        kept: list[int] = []
        per_star = np.zeros(n, dtype=int)
        for k in order:
            if per_star[kernel_obs[k]] < settings.max_groups_per_star:
                per_star[kernel_obs[k]] += 1
                kept.append(int(k))
        return np.asarray(found[kept])
