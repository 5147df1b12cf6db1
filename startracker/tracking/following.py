"""Match of a frame with the prediction, and filter update with its stars."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from startracker.arrays import FloatArray, IntArray
from startracker.camera import Camera
from startracker.identification.acceptance import log_chance, power_of_ten
from startracker.solution import MatchedStars, Solution, Status
from startracker.tracker import StarTracker
from startracker.tracking.looking import Expected, Seen
from startracker.tracking.matching import track
from startracker.tracking.mekf import Innovation, Mekf

_LEAST_WORTH = math.log(100.0)
"""Minimum evidence for a filter update with stars that are too few for an attitude."""
_REJECT_SIGMAS = 3.7
_FEWEST_TO_REJECT = 4
_RAYLEIGH_MEDIAN = math.sqrt(2.0 * math.log(2.0))


@dataclass(frozen=True, eq=False)
class Followed:
    """A frame matched with the prediction: the updated filter, and the stars used.

    `log_chance` is that of `startracker.identification.acceptance`. The prior is the prediction's Gaussian, over which
    the Bayes factor of `startracker.tracking.evidence` is integrated; there is no other prior, and no competing
    hypothesis.
    """

    filter: Mekf
    innovation: Innovation
    seen: Seen
    expected: Expected
    stars: IntArray
    partner: IntArray
    residual_px: FloatArray
    log_chance: float

    def solution(self, tracker: StarTracker, covariance: FloatArray, note: str, times_ms: dict[str, float]) -> Solution:
        """Solution of the frame: attitude of the filter, the given covariance (3, 3), and the stars.

        The note is appended to the reason.
        """
        camera, guide, seen, stars = tracker.camera, tracker.guide, self.seen, self.stars
        chosen = self.expected.index[self.partner]
        return Solution(
            Status.SOLVED,
            f"tracked: {len(stars)} of {len(seen.xy)} stars at predicted positions, {len(self.expected.index)} "
            f"expected; chance probability {power_of_ten(self.log_chance)}" + note,
            self.filter.attitude,
            covariance,
            MatchedStars(
                seen.xy[stars],
                guide.catalog.id[chosen],
                guide.catalog.star_name[chosen],
                guide.v_mag[chosen],
                seen.flux[stars],
                self.residual_px,
                sigma_px=seen.sigma_px[stars],
            ),
            seen.xy,
            camera.fov_deg,
            camera.parity,
            times_ms,
            camera,
            log_false_alarm=self.log_chance,
        )


def follow(prediction: Mekf, camera: Camera, seen: Seen, expected: Expected, false_rejection: float) -> Followed | None:
    """Match with the prediction and update the filter; None if too few stars match, or the matched ones contradict it.

    Parameters
    ----------
    prediction : Mekf
        Filter at the time of the frame; not modified.
    camera : Camera
        Camera of the tracker.
    seen, expected : Seen, Expected
        Detected stars, and guide stars at their predicted positions.
    false_rejection : float
        Probability of rejecting a correct measurement (`TrackingSettings`).
    """
    if not len(seen.xy):
        return None
    pixel = camera.pixel_rad
    partner, _, _, evidence = track(
        seen.vectors, seen.gate_px * pixel, expected.predicted, prediction.attitude_covariance, seen.area_sr
    )
    if not evidence >= _LEAST_WORTH:
        return None
    stars = np.flatnonzero(partner >= 0)
    while True:
        after = prediction.copy()
        reference = expected.directions[partner[stars]]
        innovation = after.update_vectors(seen.vectors[stars], reference, seen.sigma_px[stars] * pixel, false_rejection)
        if not innovation.accepted:
            return None
        residual = seen.xy[stars] - camera.project(reference @ after.matrix.T)
        good = _fitting(residual, seen.sigma_px[stars])
        if good.all():
            break
        stars = stars[good]
    return Followed(after, innovation, seen, expected, stars, partner[stars], residual, log_chance(evidence))


def _fitting(residual: FloatArray, sigma: FloatArray) -> NDArray[np.bool_]:
    """Stars (M,) whose residual is below 3.7 standard errors, the stated ones or those of the frame if larger."""
    length = np.hypot(residual[:, 0], residual[:, 1]) / sigma
    if len(length) < _FEWEST_TO_REJECT or float(length.max()) <= _REJECT_SIGMAS:
        return np.ones(len(length), np.bool_)
    limit = _REJECT_SIGMAS * max(float(np.median(length)) / _RAYLEIGH_MEDIAN, 1.0)
    good = np.asarray(length <= limit)
    if good.sum() < _FEWEST_TO_REJECT:
        return np.ones(len(length), np.bool_)
    return good
