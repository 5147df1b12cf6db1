"""Identification by triads (Yee 1999, section 2.3.4), accepted by probability.

1. Every triangle of the brightest stars is searched for in the sorted pairs of guide stars (`triad_search`): three
   separations, the rotations of two sides, the inner angles.
2. Triads are grouped by rotation, and the votes of a group, the largest first, name each star (`triad_votes`).
3. The attitude of each group that names three stars is verified against all stars of the field and accepted by
   probability (`acceptance`), while Yee 1999 accepts the largest group as it is.

The image is projected to the plane tangent to the sphere at the boresight, and the geometry is exact
(`FloatArithmetic(exact=True)`), so that separations can be matched within the centroids' errors: first those stated,
then 3 and 10 times those. Rotations refer to the celestial pole. Near it the meridians converge, and triads agree on a
rotation only if they share their first star; the groups are smaller there, but large enough.
"""

from __future__ import annotations

import math
from weakref import WeakKeyDictionary

import numpy as np

from startracker.catalog.guide import GuideDatabase, PairList
from startracker.estimation.wahba import fit_rotation
from startracker.identification.acceptance import SCALES, HypothesisPool, too_few, tried_scales
from startracker.identification.arithmetic import FloatArithmetic
from startracker.identification.observed import Identification, Observed, Prior
from startracker.identification.pairs import observed_pairs, pair_tolerance
from startracker.identification.triad_search import TriadLimits
from startracker.identification.triad_tables import TriadTables
from startracker.identification.triad_votes import match_triads
from startracker.settings import IdentificationSettings, TriadSettings
from startracker.solution import Status

_MOST_TRIPLED = 64
"""Largest number of stars that form triads, whatever the settings."""
_MOST_GROUPS = 12
"""Number of groups verified at one scale."""
_LOWEST = 0.2
"""Cosine of the angle to the boresight below which a star is not projected to the tangent plane."""
_COMBINE_PX = 4.0
"""Distance in the image, px, below which guide stars are merged; doubles that the camera does not resolve are merged
already."""
_ARITHMETIC = FloatArithmetic(exact=True)
_TABLES: WeakKeyDictionary[PairList, TriadTables] = WeakKeyDictionary()


def triads(
    observed: Observed,
    guide: GuideDatabase,
    settings: IdentificationSettings | None = None,
    prior: Prior | None = None,
) -> Identification:
    """Identify observed stars, lost in space or around a prior attitude.

    Parameters
    ----------
    observed : Observed
        Brightest first; the `settings.max_stars` brightest form triads, all are used in the verification.
    guide : GuideDatabase
        Guide stars in apparent directions for the observer.
    settings : TriadSettings
        `separation_tolerance_deg`, `rotation_tolerance_deg`, `enclosed_tolerance_deg`, `grouping_tolerance_deg`,
        `vote_number`, `three_stars`, `min_stars`, `max_stars`, `false_alarm_rate`.
    prior : Prior, optional
        Restricts the guide pairs to what the prior allows.

    Returns
    -------
    Identification
        Status, reason and pairs. Never raises for what was observed.
    """
    return _identify(observed, guide, TriadSettings.of(settings), prior)


def _identify(observed: Observed, guide: GuideDatabase, settings: TriadSettings, prior: Prior | None) -> Identification:
    least = max(settings.min_stars, 3)
    if len(observed) < least:
        return too_few(observed, least)
    pool = HypothesisPool(settings, prior, len(observed))
    most = min(settings.max_stars, _MOST_TRIPLED)
    before = np.flatnonzero(observed.vectors[:, 2] > _LOWEST)[:most]
    vectors = observed.vectors[before]
    pixel_deg = math.degrees(guide.camera.pixel_rad)
    # x along the columns, y up (against the rows), in units of the pixel's angle at the boresight.
    xy = vectors[:, :2] / vectors[:, 2:] * [1.0, -1.0] / guide.camera.pixel_rad
    fixed = settings.separation_tolerance_deg
    # A tolerance in degrees does not depend on the stated errors. One search is then enough, with the widest gate of
    # the verification, which narrows it by itself (`verify`).
    scales = tried_scales(observed, guide) if fixed is None else SCALES[-1:]
    tables = _tables(guide, prior)
    i, j, separations = observed_pairs(vectors)
    verdict = pool.outcome(observed)
    for scale in scales:
        tolerance = pair_tolerance(
            observed.sigma_rad[before] * scale, i, j, separations, None if fixed is None else math.radians(fixed)
        )
        limits = TriadLimits(
            separation_tolerance_deg=tuple(np.degrees(tolerance).tolist()),
            rotation_tolerance_deg=settings.rotation_tolerance_deg,
            enclosed_tolerance_deg=settings.enclosed_tolerance_deg,
            grouping_tolerance_deg=settings.grouping_tolerance_deg,
            vote_number=settings.vote_number,
            combine_px=_COMBINE_PX,
            three_stars=settings.three_stars,
            most_operations=max(pool.left, 0),
        )
        match = match_triads(tables, xy, (pixel_deg, pixel_deg), limits)
        pool.operations += match.triads.operations
        pool.cut_short = pool.cut_short or not match.triads.complete
        checked = 0
        for found in match.candidates():
            seen, stars = before[found.pairs[:, 0]], found.pairs[:, 1]
            weight = 1.0 / observed.sigma_rad[seen] ** 2
            matrix = fit_rotation(observed.vectors[seen], guide.directions[stars], weight)
            pool.check(matrix, observed, guide, scale)
            checked += 1
            if pool.decided or pool.cut_short or checked == _MOST_GROUPS:
                break
        sizes = match.triads.group_sizes
        pool.note(
            f"triads within {scale:g} stated errors: {len(match.triads)} in {len(sizes)} groups, the largest of "
            f"{sizes.max(initial=0)}; {checked} groups name three stars"
        )
        verdict = pool.outcome(observed)
        if verdict.status is Status.SOLVED or pool.cut_short:
            break
    return verdict


def _tables(guide: GuideDatabase, prior: Prior | None) -> TriadTables:
    """Tables of the guide stars, for the whole sky or around a prior attitude; indices are those of the guide stars."""
    pairs = guide.pairs if prior is None else guide.pairs_near(prior.attitude.boresight, prior.radius_rad)
    if pairs not in _TABLES:
        x, y, z = guide.directions.T
        sky = _ARITHMETIC.sky(np.degrees(np.arctan2(y, x)), np.degrees(np.arctan2(z, np.hypot(x, y))), 180.0)
        first, second = pairs.first.astype(np.int64), pairs.second.astype(np.int64)
        _TABLES[pairs] = TriadTables.of_pairs(_ARITHMETIC, guide.catalog.id, guide.v_mag, sky, first, second)
    return _TABLES[pairs]
