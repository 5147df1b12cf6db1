"""Match of a frame with the prediction, and filter update with its stars."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc

from startracker.core import FloatArray, IntArray
from startracker.errors import InputError
from startracker.estimation import Estimator
from startracker.estimation.image_errors import rotation_of_shift
from startracker.estimation.wahba import wahba_svd
from startracker.geometry.attitude import matrix_to_quat
from startracker.geometry.camera import Camera
from startracker.geometry.image_map import to_pixels
from startracker.identification.acceptance import log_chance, power_of_ten
from startracker.observer import Observer
from startracker.solution import MatchedStars, Solution, Status
from startracker.tracker import StarTracker
from startracker.tracking.candidates import Candidates, Expected
from startracker.tracking.matching import GATE2, track
from startracker.tracking.mekf import Innovation, Mekf
from startracker.unexplained import LEAST_SHARE, Unexplained, is_part_hidden, unexplained_of

_LEAST_WORTH = math.log(100.0)
"""Minimum evidence for a filter update with stars that are too few for an attitude."""
_REJECT_SIGMAS = 3.7
_FEWEST_TO_REJECT = 4
_FEWEST_FOR_ATTITUDE = 3
_BESIDE_CHANCE = 0.01
"""Probability by chance below which stars are beside guide stars."""
_RAYLEIGH_MEDIAN = math.sqrt(2.0 * math.log(2.0))


@dataclass(frozen=True, eq=False)
class Followed:
    """A frame matched with the prediction: the updated filter, and the stars used.

    `log_chance` is that of `startracker.identification.acceptance`. The prior is the prediction's Gaussian, over which
    the Bayes factor of `startracker.tracking.matching` is integrated; there is no other prior, and no competing
    hypothesis.
    """

    filter: Mekf
    innovation: Innovation
    seen: Candidates
    expected: Expected
    stars: IntArray
    partner: IntArray
    residual_px: FloatArray
    log_chance: float
    is_selective: bool
    """Whether stars beside their guide stars are left out (`leaves_out_stars`)."""

    def is_doubtful(self, camera: Camera) -> bool:
        """Whether only the tracker can judge the frame: bright stars stay unexplained, perhaps as they are those of
        another field, or stars are left out that larger errors would explain."""
        left = self.unexplained(camera)
        return self.is_selective or left.contradicts or left.is_doubtful or left.is_uneven

    def unexplained(self, camera: Camera) -> Unexplained:
        """Bright stars that the match leaves unexplained (`startracker.unexplained`)."""
        positions, matched = self._guide_stars(camera)
        found, flux = np.zeros(len(self.seen.xy), np.bool_), self.seen.flux
        found[self.stars] = True
        order = np.argsort(-flux, kind="stable")  # NaN, as not known, leaves the order of the list
        return unexplained_of(self.seen.xy[order], found[order], positions, matched)

    def hides_a_part(self, camera: Camera) -> bool:
        """Whether the guide stars of a part of the image were not found in their windows, so that it must be seen what
        is there instead."""
        return self.seen.windows > 0 and is_part_hidden(*self._guide_stars(camera))

    def _guide_stars(self, camera: Camera) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Positions (K, 2) of the bright guide stars, and which are matched."""
        positions = to_pixels(self.expected.directions @ self.filter.matrix.T, camera.image_map)
        matched = np.zeros(len(positions), np.bool_)
        matched[self.partner] = True
        return positions, matched

    def star_attitude(self, camera: Camera) -> tuple[FloatArray, FloatArray] | None:
        """Attitude of the stars alone, without the prediction: quaternion (4,), ICRS to camera, and covariance (3, 3),
        rad²; None for fewer than three stars."""
        if len(self.stars) < _FEWEST_FOR_ATTITUDE:
            return None
        observed, reference = self.seen.vectors[self.stars], self.expected.directions[self.partner]
        found = wahba_svd(observed, reference, self.seen.sigma_px[self.stars] * camera.pixel_rad)
        return matrix_to_quat(found.matrix), found.covariance

    def solution(
        self,
        tracker: StarTracker,
        covariance: FloatArray,
        note: str,
        times_ms: dict[str, float],
        observer: Observer | None,
    ) -> Solution:
        """Solution of the frame: attitude of the filter, the given covariance (3, 3), and the stars.

        The note is appended to the reason.
        """
        camera, guide, seen, stars = tracker.camera, tracker.guide, self.seen, self.stars
        chosen = self.expected.index[self.partner]
        matched = MatchedStars.of(
            guide, chosen, seen.xy[stars], self.residual_px, flux=seen.flux[stars], sigma_px=seen.sigma_px[stars]
        )
        return Solution(
            status=Status.SOLVED,
            reason=f"tracked: {len(stars)} of {len(seen.xy)} stars at predicted positions, {len(self.expected.index)} "
            f"expected; chance probability {power_of_ten(self.log_chance)}" + note,
            attitude=self.filter.attitude,
            covariance=covariance,
            stars=matched,
            centroids=seen.xy,
            fov_deg=camera.fov_deg,
            parity=camera.parity,
            times_ms=times_ms,
            camera=camera,
            log_false_alarm=self.log_chance,
            observer=observer,
            catalog=guide.catalog.provenance,
        )


def follow(
    prediction: Mekf,
    camera: Camera,
    seen: Candidates,
    expected: Expected,
    false_rejection: float,
    estimator: Estimator | None = None,
) -> Followed | None:
    """Match with the prediction and update the filter; None if too few stars match, or the matched ones contradict it.

    Parameters
    ----------
    prediction : Mekf
        Filter at the time of the frame; not modified.
    camera : Camera
        Camera of the tracker.
    seen, expected : Candidates, Expected
        Detected stars, and guide stars at their predicted positions.
    false_rejection : float
        Probability of rejecting a correct measurement (`TrackingSettings`).
    estimator : Estimator, optional
        Method that gives the measured attitude of the matched stars; None: the filter is updated with the stars
        themselves, which is the weighted fit of all of them with the prediction. A single star, from which no method
        has an attitude, always updates the filter itself. Stars from which the method has no attitude do not match.
    """
    if not len(seen.xy):
        return None
    pixel = camera.pixel_rad
    partner, _, _, evidence = track(
        seen.vectors, seen.gate_px * pixel, expected.predicted, prediction.attitude_covariance, seen.area_sr
    )
    if not evidence >= _LEAST_WORTH:
        return None
    stars = (partner >= 0).nonzero()[0]
    common = None if seen.common_px2 is None else rotation_of_shift(seen.common_px2, camera)
    while True:
        after, sigma_px = prediction.copy(), seen.sigma_px[stars]
        reference = expected.directions[partner[stars]]
        innovation = after.update_stars(seen.vectors[stars], reference, sigma_px * pixel, false_rejection, common)
        if not innovation.accepted:
            return None
        residual = seen.xy[stars] - to_pixels(reference @ after.matrix.T, camera.image_map)
        good = _fitting(residual, sigma_px)
        if good is None or good.all():
            break
        stars = stars[good]
    if estimator is not None and len(stars) > 1:
        try:
            estimate = estimator(seen.vectors[stars], reference, sigma_px * pixel)
        except InputError:
            return None
        after = prediction.copy()
        covariance = estimate.covariance if common is None else estimate.covariance + common
        innovation = after.update_attitude(estimate.matrix, covariance, false_rejection)
        if not innovation.accepted:
            return None
        residual = seen.xy[stars] - to_pixels(reference @ after.matrix.T, camera.image_map)
    return Followed(
        filter=after,
        innovation=innovation,
        seen=seen,
        expected=expected,
        stars=stars,
        partner=partner[stars],
        residual_px=residual,
        log_chance=log_chance(evidence),
        is_selective=leaves_out_stars(prediction, after, seen, expected, stars, partner[stars], pixel),
    )


def leaves_out_stars(
    prediction: Mekf,
    after: Mekf,
    seen: Candidates,
    expected: Expected,
    stars: IntArray,
    partner: IntArray,
    pixel_rad: float,
) -> bool:
    """Whether stars that are not matched are beside guide stars that are not, closer than false stars are by chance.

    A match with a prediction assumes errors as stated. If they are larger, or the focal length is wrong, the stars that
    agree are those of one part of the image, with an attitude of their own, and the others are beside their guide
    stars. The tracker, which weighs larger errors and other focal lengths, decides between the two.

    Of n unmatched stars any is closer than d to one of K guide stars by chance with the probability p = K π d² / A,
    with A the area searched, and m of them with that of the binomial distribution. A star counts only where the
    prediction allows it to be its guide star: beside a position that is known, it is a blend or a false one. A few
    stars beside many that match are blends as well (`LEAST_SHARE`).

    Parameters
    ----------
    prediction, after : Mekf
        Before and after the update with the matched stars.
    seen, expected : Candidates, Expected
        Detected stars, and guide stars at their predicted positions.
    stars, partner : (M,)
        Matched rows of both.
    pixel_rad : float
        Of the camera.
    """
    others = np.setdiff1d(np.arange(len(seen.xy)), stars)
    guides = np.setdiff1d(np.arange(len(expected.index)), partner)
    if not len(others) or not len(guides):
        return False
    moved = expected.directions[guides] @ after.matrix.T
    apart2 = np.sum((seen.vectors[others][:, None] - moved) ** 2, axis=2)
    nearest = np.argmin(apart2, axis=1)
    chance = len(guides) * math.pi * apart2[np.arange(len(others)), nearest] / seen.area_sr
    fewest = math.ceil(LEAST_SHARE * len(stars))
    if not _are_beside(chance, len(others), fewest):
        return False
    allowed = _allows(prediction, seen, expected, others, guides[nearest], pixel_rad)
    return _are_beside(chance[allowed], len(others), fewest)


def _are_beside(chance: FloatArray, number: int, fewest: int) -> bool:
    """Whether at least some of a number of stars are closer to guide stars than by chance, each with its own chance."""
    closest = np.sort(chance[chance < 1.0])
    more_than = np.arange(fewest - 1, len(closest))
    return bool((bdtrc(more_than, number, closest[more_than]) < _BESIDE_CHANCE).any())


def _allows(
    prediction: Mekf, seen: Candidates, expected: Expected, stars: IntArray, guides: IntArray, pixel_rad: float
) -> NDArray[np.bool_]:
    """Whether each star may be a guide star, both (N,), with the errors of the prediction and of the star."""
    towards = expected.predicted[guides]
    away = seen.vectors[stars] - towards
    moved = np.cross(towards[:, None], np.eye(3)).transpose(0, 2, 1)  # by a rotation about each axis
    variance = (seen.sigma_px[stars] * pixel_rad) ** 2
    covariance = moved @ prediction.attitude_covariance @ moved.transpose(0, 2, 1)
    covariance += variance[:, None, None] * np.eye(3)
    distance2 = np.einsum("ni,ni->n", away, np.linalg.solve(covariance, away[..., None])[..., 0])
    return np.asarray(distance2 <= GATE2)


def _fitting(residual: FloatArray, sigma: FloatArray) -> NDArray[np.bool_] | None:
    """Stars (M,) whose residual is below 3.7 standard errors, the stated ones or those of the frame if larger; None:
    all."""
    length = np.hypot(residual[:, 0], residual[:, 1]) / sigma
    if len(length) < _FEWEST_TO_REJECT or max(length.tolist()) <= _REJECT_SIGMAS:
        return None
    limit = _REJECT_SIGMAS * max(float(np.median(length)) / _RAYLEIGH_MEDIAN, 1.0)
    good = np.asarray(length <= limit)
    return None if good.sum() < _FEWEST_TO_REJECT else good
