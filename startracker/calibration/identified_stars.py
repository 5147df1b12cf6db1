"""Identified stars of one frame, as a calibration in flight takes them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from startracker.arguments import of_kind
from startracker.core import BoolArray, FloatArray, IntArray
from startracker.geometry.lens_fit import Matches
from startracker.solution import Solution
from startracker.tracker import StarTracker


@dataclass(frozen=True, eq=False)
class IdentifiedStars(Matches):
    """Stars of one frame: positions (M, 2) with standard errors, pixels, and apparent directions (M, 3), ICRS axes.

    The directions must include aberration: without it the focal length is wrong by up to 100 ppm.
    """

    catalog_id: IntArray
    """Number of each star, (M,), by which it is recognised in later frames."""
    flux: FloatArray
    """Signal, DN, (M,), of which only the order is used; NaN if not known."""

    @classmethod
    def of(cls, solution: Solution, tracker: StarTracker) -> IdentifiedStars:
        """The fitted stars of a solved frame; where their errors are not known, they are taken from the residuals."""
        of_kind("solution", solution, Solution)
        stars, guide = solution.stars.fitted, of_kind("tracker", tracker, StarTracker).guide
        sigma_px = stars.sigma_px
        if not np.isfinite(sigma_px).all():
            freedom = max(2 * len(stars) - 3, 1)
            sigma_px = np.full(len(stars), math.sqrt(float(np.sum(stars.residual_px**2)) / freedom))
        directions = guide.seen_by(solution.observer).directions[guide.rows_of(stars.catalog_id)]
        return cls(stars.xy, directions, sigma_px, stars.catalog_id, stars.flux)

    def __len__(self) -> int:
        return len(self.xy)

    def select(self, chosen: BoolArray) -> IdentifiedStars:
        """A selection of the stars."""
        measured = self.xy[chosen], self.directions[chosen], self.sigma_px[chosen]
        return IdentifiedStars(*measured, self.catalog_id[chosen], self.flux[chosen])
