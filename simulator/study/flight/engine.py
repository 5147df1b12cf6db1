"""The flight build as the tracker of a study: the compiled C with the interface of `StarTracker`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulator.study.flight.library import NO_PRIOR, FlightLibrary, Known
from simulator.study.flight.program import ProgramAnswer, velocity_of
from startracker.arguments import real_array
from startracker.catalog.guide import GuideDatabase
from startracker.core import FloatArray
from startracker.display import described
from startracker.errors import InputError
from startracker.field_solution import unsolved
from startracker.flight.apparent import epoch_of
from startracker.flight.design import FlightDesign
from startracker.flight.following import RADIUS_BITS
from startracker.flight.search_tables import LOG_BITS
from startracker.flight.stars import StarList
from startracker.front_end import Clock
from startracker.geometry.attitude import Attitude
from startracker.identification.acceptance import power_of_ten
from startracker.identification.observed import Prior, as_prior
from startracker.inputs import given_image, prior_of, shape_fault
from startracker.observer import Observer, observer_of
from startracker.solution import MatchedStars, Solution, Status

_ONE = 1 << 30
_SAYS = {
    "accepted": "{matched} of {stars} stars identified; by chance with probability {chance}",
    "nothing_found": "no star exceeds the threshold of detection",
    "few_found": "{stars} stars found, of which fewer than are needed have a known error",
    "no_hypothesis": "no attitude explains three of {stars} stars",
    "weak_evidence": "the best attitude is no better than chance: {matched} of {stars} stars fit",
    "above_rate": "{matched} of {stars} stars fit: by chance with probability {chance}, above the false-alarm rate",
    "rival": "{matched} of {stars} stars fit, but another attitude fits nearly as well",
    "pose_failed": "the identified stars fit no attitude",
    "steps_used_up": "the steps of the search were used up; {matched} of {stars} stars fit the best attitude",
    "rows_missing": "the frame has fewer rows than the camera",
    "frame_uniform": "all pixels have the same value",
    "saturated_share": "a large part of the frame is saturated",
    "unexplained": "{matched} of {stars} stars fit, but bright stars and bright guide stars are unexplained",
    "few_disagree": "{matched} of {stars} stars fit, but one of so few is off by more than its stated error allows",
    "another_field": "{matched} of {stars} stars fit, but of the others most are those of another field",
}
"""Text of each ``enum tracker_reason``."""


class FlightEngine:
    """Solves frames with the compiled flight build of one camera.

    Parameters
    ----------
    design : FlightDesign
        The camera and the settings that it was made for.
    guide : GuideDatabase
        Guide stars at the epoch of their catalogue, with which the residuals of the identified stars are computed.
    library : FlightLibrary
        The compiled C.
    """

    def __init__(self, design: FlightDesign, guide: GuideDatabase, library: FlightLibrary) -> None:
        self.design, self.guide, self.library = design, guide, library
        self.camera, self.detection = design.camera, design.detection

    def __repr__(self) -> str:
        return described("FlightEngine", repr(self.camera), f"{len(self.guide):,} guide stars", self.library.version)

    # ------------------------------------------------------------------ as `StarTracker`
    def solve(
        self,
        image: Any,
        *,
        prior: Attitude | None = None,
        prior_deg: float | None = None,
        lost_in_space: bool = False,
        observer: Observer | None = None,
        saturation_dn: float | None = None,
        gain_e_per_dn: float | None = None,
    ) -> Solution:
        """Attitude from an image; parameters as in `StarTracker.solve`. Gain and saturation are those of the design.

        In the times of the stages, ``detection`` is reading the rows with their background, and ``identification`` is
        everything from the last row to the answer: centroids, identification and attitude.
        """
        clock, given = Clock(), given_image(image, observer, None, saturation_dn, gain_e_per_dn)
        hint = as_prior(*prior_of(image, prior, prior_deg, lost_in_space))
        known = known_of(given.observer)._replace(prior=prior_numbers(hint))
        if fault := self.read(given.image, known):
            return self.refused(Status.BAD_IMAGE, fault, clock)
        clock.lap("detection")
        answer, stars = self.library.finish()
        clock.lap("identification")
        return self.solution(answer, stars, given.observer, clock)

    def solve_centroids(
        self,
        xy: ArrayLike,
        flux: ArrayLike,
        *,
        sigma_px: ArrayLike = 0.1,
        prior: Attitude | None = None,
        prior_deg: float = 1.0,
        observer: Observer | None = None,
    ) -> Solution:
        """Attitude from star positions, brightest first; parameters as in `StarTracker.solve_centroids`."""
        clock, hint = Clock(), as_prior(prior, prior_deg)
        answer, stars = self.library.solve_stars(
            star_list(xy, flux, sigma_px), known_of(observer)._replace(prior=prior_numbers(hint))
        )
        clock.lap("identification")
        return self.solution(answer, stars, observer_of(observer, None), clock)

    # ------------------------------------------------------------------ parts that `FlightSession` shares
    def read(self, image: Any, known: Known) -> str:
        """Give the rows of an image to the library; returns why its shape does not fit the camera, or an empty text."""
        pixels: NDArray[Any] = np.asarray(image)
        if fault := shape_fault(pixels.shape, (self.camera.height, self.camera.width)):
            return fault
        if pixels.dtype != np.uint16:
            pixels = np.clip(np.rint(pixels), 0, 65535)
        self.library.read(np.ascontiguousarray(pixels, dtype=np.uint16), known)
        return ""

    def refused(self, status: Status, reason: str, clock: Clock) -> Solution:
        """Solution of a frame that is not solved."""
        return unsolved(self.camera, status, reason, clock)

    def solution(
        self, answer: ProgramAnswer, stars: StarList, observer: Observer | None, clock: Clock, note: str = ""
    ) -> Solution:
        """Solution of an answer."""
        counts, camera, attitude = answer.counts, self.camera, answer.attitude
        log_chance = counts["chance"] / float(1 << LOG_BITS) * math.log(2.0)
        words = {**counts, "chance": power_of_ten(log_chance)}
        outside = counts["contradicted"] == 1
        reason = _SAYS[answer.reason].format(**words) + ("; found outside the prior" if outside else "") + note
        return Solution(
            Status(answer.status),
            reason,
            attitude=attitude,
            covariance=answer.covariance_rad2 if attitude else None,
            stars=self._matched(stars, answer.numbers, attitude, observer) if attitude else MatchedStars.none(),
            centroids=stars.xy_px,
            fov_deg=camera.fov_deg,
            parity=camera.parity,
            times_ms=clock.times_ms(),
            camera=camera,
            log_false_alarm=min(log_chance, 0.0),
            operations=counts["steps"],
            prior_contradicted=outside,
            observer=observer,
        )

    def _matched(
        self, stars: StarList, numbers: Sequence[int], attitude: Attitude, observer: Observer | None
    ) -> MatchedStars:
        """Identified stars, with residuals from the guide stars' apparent positions for the observer."""
        named = np.flatnonzero(np.array(numbers))
        rows = self.guide.rows_of(np.array(numbers, dtype=np.int64)[named])
        apparent = self.guide.apparent_to(observer).directions[rows]
        xy = stars.xy_px[named]
        residual_px = xy - self.camera.project(attitude.apply(apparent))
        return MatchedStars.of(
            self.guide,
            rows,
            xy,
            residual_px,
            flux=stars.flux_dn[named],
            sigma_px=np.sqrt(stars.variance_px2[named]),
        )


def known_of(observer: Observer | None) -> Known:
    """Epoch and velocity of an observer, as integers for the library."""
    if observer is None:
        return Known()
    return Known(velocity_of(observer.velocity_km_s), epoch_of(observer.epoch_jyear))


def prior_numbers(prior: Prior | None) -> tuple[int, ...]:
    """Integers of a prior, `NO_PRIOR` for None."""
    if prior is None:
        return NO_PRIOR
    matrix = np.rint(prior.attitude.as_matrix() * _ONE).astype(np.int64).ravel().tolist()
    return (*matrix, round(prior.radius_rad * (1 << RADIUS_BITS)))


def star_list(xy: ArrayLike, flux: ArrayLike, sigma_px: ArrayLike) -> StarList:
    """Integers of star positions (N, 2), fluxes (N,) and standard errors on one axis; positions that are not
    finite are left out.

    Raises
    ------
    InputError
        If the shapes do not match.
    """
    points = real_array("centroids", xy, finite=False).reshape(-1, 2)
    try:
        signal = np.broadcast_to(real_array("fluxes", flux, finite=False), len(points))
        sigma: FloatArray = np.broadcast_to(real_array("sigma_px", sigma_px, finite=False), len(points))
    except ValueError:
        raise InputError("there must be a flux and an error for every centroid") from None
    good = np.isfinite(points).all(axis=1) & np.isfinite(signal) & np.isfinite(sigma)
    order = np.argsort(-signal[good], kind="stable")
    return StarList.of(points[good][order], signal[good][order], sigma[good][order] ** 2)
