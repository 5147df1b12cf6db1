"""Identification by pyramids (Mortari, Samaan, Bruccoleri & Junkins 2004, Navigation 51, 171).

1. Triangles of observed stars in the smart order (i, i + dj, i + dj + dk), which leaves a false star behind quickly.
2. Each side's range of guide pairs from the k-vector; the guide triangles that close and turn the same way round.
3. A fourth star at the right separations from all three corners confirms a triangle; how many do ranks the rivals.
4. The attitude of what is confirmed best is checked against all stars of the field and accepted by probability
   (`hypothesis`), where the paper is content with the expected frequency of random pyramids.

Errors as stated are assumed first, then 3 and 10 times those; a few triangles each, then more.
"""

from __future__ import annotations

import math
from weakref import WeakKeyDictionary

import numpy as np

from startracker.catalog.guide import GuideDatabase, PairList
from startracker.identification.hypothesis import SCALES, Bench, too_few
from startracker.identification.kvector import KVector, k_vector
from startracker.identification.observed import Identification, Observed, Prior
from startracker.identification.pairs import pair_tolerance, separation
from startracker.identification.pyramid_kernels import GuidePairs, Seen, search_pyramids, smart_triples
from startracker.settings import IdentificationSettings, PyramidSettings
from startracker.solution import Status

__all__ = ["pyramid"]

_ROUNDS = ((60, 3, 500_000), (400, 2, 500_000), (100_000, 1, 500_000))
"""Triangles up to which each round goes, stars that must confirm one, and steps it may take, for each scale."""
_MOST_TRIPLED = 64
"""Stars that make triangles at most, whatever the settings: 42,000 triangles."""
_STEP_WORK = 10
"""Operations of a step."""
_MOST_CHECKED = 12  # confirmed triangles checked in a round at one scale
_WIDEST = 0.01
"""Errors are not assumed larger than this share of the field's half diagonal (3.6 px of 512), unless stated so."""
_INDEXES: WeakKeyDictionary[PairList, KVector] = WeakKeyDictionary()


def pyramid(
    observed: Observed,
    guide: GuideDatabase,
    settings: IdentificationSettings | None = None,
    prior: Prior | None = None,
) -> Identification:
    """Identify observed stars, lost in space or around a prior attitude.

    Parameters
    ----------
    observed : Observed
        Brightest first; the `settings.max_stars` brightest make triangles, all confirm and
        verify. Magnitudes are looked at in the verification alone.
    guide : GuideDatabase
        As the observer sees it.
    settings : PyramidSettings
        `separation_tolerance_deg`, `min_stars`, `max_stars`, `false_alarm_rate`.
    prior : Prior, optional
        Confines the guide pairs to what the prior allows.

    Returns
    -------
    Identification
        Status, reason and pairs. Never raises for what was observed.
    """
    settings = PyramidSettings.of(settings)
    least = max(settings.min_stars, 3)
    if len(observed) < least:
        return too_few(observed, least)
    bench = Bench(settings, prior, len(observed))
    pairs = guide.pairs if prior is None else guide.pairs_near(prior.attitude.boresight, prior.radius_rad)
    index = _INDEXES.get(pairs)
    if index is None:
        index = _INDEXES[pairs] = k_vector(pairs.separation_rad.astype(np.float64))
    n = min(len(observed), settings.max_stars, _MOST_TRIPLED)
    triples = smart_triples(n)
    table = GuidePairs(pairs.first, pairs.second, index, np.full(len(guide), -1, dtype=np.int64))
    view = guide.view
    scales: tuple[float, ...] = SCALES if settings.separation_tolerance_deg is None else SCALES[-1:]
    largest = _WIDEST * guide.half_diagonal_rad / float(np.median(observed.sigma_rad))
    scales = tuple(scale for scale in scales if scale <= largest) or scales[:1]
    seen = {scale: _seen(observed, n, settings, scale) for scale in scales}
    for most, confirming, budget in _ROUNDS:
        stop, needed = min(most, len(triples)), max(1, min(confirming, len(observed) - 3))
        for scale in scales:
            reached, checked, best = 0, 0, 0
            left = min(budget, bench.left // _STEP_WORK)
            bench.cut_short = bench.cut_short or left <= 0
            while reached < stop and left > 0 and checked < _MOST_CHECKED:
                found = search_pyramids(seen[scale], triples[:stop], reached, table, view, needed, left)
                reached, finds, matrices, confirmed, after = found
                bench.operations += _STEP_WORK * (left - after)
                left = after
                for f in range(finds):
                    if confirmed[f] < best - 1:  # what is confirmed by fewer cannot compete
                        break
                    best = max(best, int(confirmed[f]))
                    checked += 1
                    bench.check(matrices[f], observed, guide, scale)
                if finds and bench.surely:
                    return bench.judge(observed)
            bench.note(
                f"pyramids within {scale:g} stated errors: {reached} of {len(triples)} triangles, "
                + (f"the best confirmed by {best} further stars" if best else "none confirmed by a fourth star")
            )
        verdict = bench.judge(observed)
        if verdict.status is Status.SOLVED or bench.cut_short:
            break
    return verdict


def _seen(observed: Observed, n: int, settings: PyramidSettings, scale: float) -> Seen:
    """Stars, separations and tolerances at a multiple of the stated errors."""
    vectors = np.ascontiguousarray(observed.vectors, dtype=np.float64)
    sigma = np.ascontiguousarray(observed.sigma_rad, dtype=np.float64) * scale
    i, j = np.indices((n, n)).reshape(2, -1)
    apart = separation(vectors[i], vectors[j])
    fixed = settings.separation_tolerance_deg
    tolerance = pair_tolerance(sigma, i, j, apart, None if fixed is None else math.radians(fixed))
    return Seen(vectors, sigma, apart.reshape(n, n), tolerance.reshape(n, n))
