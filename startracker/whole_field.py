"""Whether a solution explains a whole field, or only pieces of streaks that lie near its stars."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from startracker.catalog.guide import GuideDatabase
from startracker.front_end import FoundStars
from startracker.solution import Solution

__all__ = ["MISFIT_PX", "best_look", "is_whole", "may_be_pieces", "misfit_px"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

MISFIT_PX = 3.0
"""Centroids of an image that are off by more than this are not those of stars."""
_BRIGHTEST, _LEAST_SEEN, _BORDER_PX = 8, 0.6, 12.0
"""Of so many of the brightest guide stars of a field, so far from its border, this share is seen, or it may be smeared:
seven or eight of eight in frames that are not, three in fields found from pieces of streaks."""
_LEAST_MATCHED = 0.4
"""Share of the bright spots that the stars of a field make where nothing else is the matter with the frame: of those as
bright as half of these stars are, as fainter ones may be stars that are no guide stars."""


def is_whole(solution: Solution, flux: FloatArray, guide: GuideDatabase, trailed: bool = False) -> bool:
    """Whether spots of such a flux are where the solution puts its stars, many of the bright ones are stars, and most
    of the brightest stars of the field are among them.

    Of trails only that many of the bright ones are stars: the ends of long ones are uncertain, the border cuts others.
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


def may_be_pieces(solution: Solution, flux: FloatArray, guide: GuideDatabase, streaked: bool) -> bool:
    """Whether the points that were matched may be pieces of streaks, all off alike.

    They may where they fit worse than stars do; and where the frame has streaks of one motion (`streaked`), which are
    no stars of the field themselves, and most bright points are not matched. Points that are most of a frame's bright
    ones are stars, whatever else there is.
    """
    if misfit_px(solution) > MISFIT_PX:
        return True
    return streaked and not _many_bright(flux, solution.stars.flux) and not is_whole(solution, flux, guide)


def best_look(looks: Sequence[tuple[FoundStars, Solution]]) -> tuple[FoundStars, Solution]:
    """Of several looks at one frame the solved one with the most evidence; the last where none is solved."""
    solved = [look for look in looks if look[1].solved]
    return min(solved, key=lambda look: look[1].log_false_alarm) if solved else looks[-1]


def misfit_px(solution: Solution) -> float:
    """Root mean square distance of the fitted stars from where the solution puts them."""
    residual = solution.stars.fitted.residual_px
    return math.sqrt(float(residual.ravel() @ residual.ravel()) / len(residual))


def _many_bright(spots: FloatArray, stars: FloatArray) -> bool:
    """Whether enough of the spots that are as bright as the brighter half of the stars are these."""
    half = len(stars) // 2
    as_bright = np.count_nonzero(spots >= np.sort(stars)[half])
    return len(stars) - half >= _LEAST_MATCHED * float(as_bright)
