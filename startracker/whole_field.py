"""Check whether a solution explains the whole field, or only fragments of trails near its stars."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from startracker.catalog.guide import GuideDatabase
from startracker.core import FloatArray
from startracker.front_end import FoundStars
from startracker.solution import Solution

MISFIT_PX = 3.0
"""Maximum rms residual of star centroids."""
_BRIGHTEST, _LEAST_SEEN, _BORDER_PX = 8, 0.6, 12.0
"""Number of brightest guide stars of a field, their minimum distance from the border, and the minimum fraction of them
that must be matched: seven or eight of eight in untrailed frames, three in fields found from fragments of trails."""
_LEAST_MATCHED = 0.4
"""Minimum fraction of matched spots among those brighter than the median matched star; fainter spots may be stars that
are not guide stars."""


def explains_bright_stars(solution: Solution, flux: FloatArray, guide: GuideDatabase, trailed: bool = False) -> bool:
    """Whether the residuals are those of stars, many of the bright spots are matched, and most of the brightest guide
    stars of the field are matched.

    For trails only the second condition is tested: the ends of long trails are uncertain, and others are cut by the
    border.
    """
    assert solution.attitude is not None
    stars = solution.stars
    if not _many_bright(flux, stars.flux):
        return False
    if trailed:
        return True
    if misfit_px(solution) > MISFIT_PX:
        return False
    index, _, _ = guide.in_field(solution.attitude.as_matrix(), -_BORDER_PX, solution.camera)
    brightest = set(guide.catalog.id[index[:_BRIGHTEST]].tolist())
    return len(brightest.intersection(stars.catalog_id.tolist())) >= _LEAST_SEEN * len(brightest)


def trail_fragments_possible(solution: Solution, flux: FloatArray, guide: GuideDatabase, streaked: bool) -> bool:
    """Whether the matched points may be fragments of trails with a common offset.

    They may if their residuals are larger than those of stars, or if the frame has streaks with a common motion
    (`streaked`) that do not match stars of the field, and most bright points are not matched. If most bright points of
    a frame are matched, they are stars.
    """
    if misfit_px(solution) > MISFIT_PX:
        return True
    return streaked and not _many_bright(flux, solution.stars.flux) and not explains_bright_stars(solution, flux, guide)


def strongest(tried: Sequence[tuple[FoundStars, Solution]]) -> tuple[FoundStars, Solution]:
    """The solution with the strongest evidence of several hypotheses for a frame, solved ones first; the last one if
    there is no evidence."""
    return min(reversed(tried), key=lambda one: (not one[1].solved, one[1].log_false_alarm))


def misfit_px(solution: Solution) -> float:
    """Rms distance of the fitted stars from their predicted positions."""
    residual = solution.stars.fitted.residual_px
    return math.sqrt(float(residual.ravel() @ residual.ravel()) / len(residual))


def _many_bright(spots: FloatArray, stars: FloatArray) -> bool:
    """Whether enough of the spots brighter than the median star are matched stars."""
    half = len(stars) // 2
    as_bright = np.count_nonzero(spots >= np.sort(stars)[half])
    return len(stars) - half >= _LEAST_MATCHED * float(as_bright)
