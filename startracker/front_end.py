"""From an image to star centroids: the stages before identification, for stars as points and as trails."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from startracker._compiled import clock
from startracker.centroid import Centroider
from startracker.centroid.result import Centroids, Measured
from startracker.core import FloatArray
from startracker.detection import Background, Detector, estimate
from startracker.detection.artefacts import fill_gaps, has_crowd, mask_impulses
from startracker.detection.background import Light, follow_structure, has_structure
from startracker.detection.components import find_trailed, trails_win
from startracker.detection.forms import motion_at
from startracker.detection.spots import Spots
from startracker.detection.values import Image
from startracker.errors import InputError
from startracker.explain import background_step, centroid_step, detection_steps, image_step
from startracker.geometry.camera import Camera
from startracker.inputs import CheckedImage, GivenImage, check_image, image_sample, saturation_message
from startracker.settings import CentroidSettings, DetectionSettings
from startracker.solution import Status
from startracker.trace import Step, Trace
from startracker.trails import Trails, find_trails, mid_exposure

_WHITE_SHARE = 0.5
"""Fraction of saturated pixels above which no stars are searched for."""
_FEWEST_STREAKS = 4


@dataclass
class Clock:
    """Time taken by each stage, milliseconds."""

    laps: dict[str, float] = field(default_factory=dict)
    start: float = field(default_factory=clock)
    last: float = field(default_factory=clock)

    def lap(self, name: str) -> None:
        """Assign the time since the last lap to a stage."""
        now = clock()
        self.laps[name] = (now - self.last) * 1e3
        self.last = now

    def times_ms(self) -> dict[str, float]:
        """All laps, and the total until now."""
        return {**self.laps, "total": (clock() - self.start) * 1e3}


@dataclass(frozen=True, eq=False)
class FoundStars:
    """Stars of an image under one hypothesis, brightest first, or the reason why there are none."""

    stars: Measured = field(default_factory=lambda: Measured(np.empty((0, 2)), np.empty(0), np.empty(0)))
    """Centroids with flux and errors."""
    trailed: bool = False
    """Whether the stars are measured as trails: the centroids are then their positions at mid-exposure."""
    saturated: int = 0
    """Number of saturated star images."""
    status: Status | None = None
    reason: str = ""
    """Set if the image cannot be used, as is the status."""
    saturated_share: float = 0.0
    saturation_dn: float = math.inf
    """Fraction of saturated pixels, and the saturation level."""


def find_stars(
    given: GivenImage,
    detect: Detector,
    measure: Centroider,
    detection: DetectionSettings,
    centroid: CentroidSettings,
    clock: Clock,
    camera: Camera | None = None,
    trace: Trace | None = None,
) -> FoundStars:
    """Stars of an image under the more likely hypothesis of `star_hypotheses`, which explains the parameters."""
    return next(star_hypotheses(given, detect, measure, detection, centroid, clock, camera, trace))


def star_hypotheses(
    given: GivenImage,
    detect: Detector,
    measure: Centroider,
    detection: DetectionSettings,
    centroid: CentroidSettings,
    clock: Clock,
    camera: Camera | None = None,
    trace: Trace | None = None,
) -> Iterator[FoundStars]:
    """Background, detection and centroids of an image: its stars as points and as trails, the more likely first.

    The second hypothesis is measured only on demand.

    Parameters
    ----------
    given : GivenImage
        The image (H, W) in any unit, NaN for bad pixels, and the known properties of its detector.
    detect, measure
        Methods of `startracker.detection` and `startracker.centroid`.
    clock : Clock
        Records the times of the stages.
    camera : Camera, optional
        If given, the image must have its shape, and trails are fitted (`startracker.trails`) with their midpoints
        corrected for the camera's projection. Otherwise there is one hypothesis, in which `measure` receives short
        trails as the detector found them.
    trace : list, optional
        The findings are appended to it.

    Yields
    ------
    FoundStars
        For an image that cannot be used it has a status; no error is raised.
    """
    trace = [] if trace is None else trace
    shape = None if camera is None else (camera.height, camera.width)
    found, fault = check_image(given.image, shape, given.saturation_dn)
    if found is None:
        yield FoundStars(status=Status.BAD_IMAGE, reason=fault)
        return
    share, level = found.saturated_share, found.saturation_dn
    trace.append(partial(image_step, found.pixels.shape, image_sample(found.pixels), share, level))
    if found.masked:
        trace.append(Step("image", f"{found.masked} pixels masked: their values cannot be caused by light"))
    if share > _WHITE_SHARE:
        yield FoundStars(status=Status.SATURATED, reason=saturation_message(share, level))
        return
    if found.highest == found.lowest:
        yield FoundStars(status=Status.NO_STARS, reason=f"every pixel is {found.highest:g}")
        return
    try:
        pixels, background, spots = _detect(found, detect, detection, given.saturation_dn, clock)
        trace.append(partial(background_step, background))
        frame = _FrameStars(given, found, pixels, background, spots, measure, detection, centroid, clock, camera, trace)
        hypotheses = frame.hypotheses()
        first = next(hypotheses)
    except InputError as error:
        yield FoundStars(status=Status.BAD_IMAGE, reason=str(error))
        return
    yield first
    yield from hypotheses


def _detect(
    found: CheckedImage, detect: Detector, detection: DetectionSettings, saturation_dn: float | None, clock: Clock
) -> tuple[Image, Background, Spots]:
    """Pixels (masked if most objects are hot pixels), their background and the candidates."""
    pixels = found.pixels
    background = _background(pixels, detection)
    clock.lap("background")
    spots = detect(fill_gaps(pixels) if found.gaps else pixels, background, detection, saturation_dn)
    # Masking changes the noise of the tiles, so the background is estimated and the detector run again.
    if has_crowd(spots, pixels.size):
        pixels, hot = mask_impulses(pixels, background)
        if hot:
            background = _background(pixels, detection)
            spots = detect(fill_gaps(pixels), background, detection, saturation_dn)
            spots = replace(spots, rejected={**spots.rejected, "hot pixel": hot})
    clock.lap("detection")
    return pixels, background, spots


def _background(pixels: Image, detection: DetectionSettings) -> Background:
    """Background of a frame in tiles, or on a finer scale if the tiles are too coarse."""
    background = estimate(pixels, detection.background_tile_px)
    return follow_structure(pixels, detection.background_tile_px) if has_structure(pixels, background) else background


@dataclass(frozen=True, eq=False)
class _FrameStars:
    """The stars of one frame as points and as trails, each of which is measured only on demand."""

    given: GivenImage
    checked: CheckedImage
    pixels: Image
    background: Background
    spots: Spots
    measure: Centroider
    detection: DetectionSettings
    centroid: CentroidSettings
    clock: Clock
    camera: Camera | None
    trace: Trace

    def hypotheses(self) -> Iterator[FoundStars]:
        """Points and trails, the more likely first; without a camera, the detector's result only."""
        spots = self.spots
        if self.camera is None:
            yield self.points(spots)
            return
        first: Callable[[], FoundStars | None] = partial(self.points, spots)
        second: Callable[[], FoundStars | None] = self.as_trails
        if spots.are_streaks:
            # The detector's own decision comes first; a decision about long trails needs them fitted.
            first, second = second, partial(self.points, spots.other or spots)
        elif (spots.direction_rad is not None or self._left_out_trails()) and self._trails_win():
            first, second = second, first
        yield first() or self.points(spots)
        other = second()
        if other is not None:
            yield other

    def _left_out_trails(self) -> bool:
        """Whether the detector rejected so many trails that they may be the stars."""
        streaks = self.spots.rejected.get("streak", 0)
        return self.spots.other is None and streaks >= max(_FEWEST_STREAKS, len(self.spots) // 4)

    def _trails_win(self) -> bool:
        trails, spots = self.trails, self.spots
        if trails is None:
            return False
        centre = trails.centroids.xy
        lengths = motion_at(centre - self._middle, trails.motion)
        return trails_win(centre, lengths, spots, fill_gaps(self.pixels), self.background)

    @property
    def _middle(self) -> FloatArray:
        return 0.5 * (np.array(self.pixels.shape[::-1], dtype=float) - 1.0)

    def points(self, spots: Spots) -> FoundStars:
        """Centroids of the candidates by the chosen method."""
        found = self.measure(self.pixels, self.background, spots, self.centroid, self.given.gain_e_per_dn)
        self.clock.lap("centroid")
        step = partial(detection_steps, spots, self.detection, self.background)
        return self._found(found, step, spots.are_streaks)

    @cached_property
    def trails(self) -> Trails | None:
        """Trails of the frame, or None if they share no common motion."""
        known = self.spots if self.spots.are_streaks else self.spots.other
        if known is None and self.spots.direction_rad is None:  # not every detector searches for them
            known = find_trailed(fill_gaps(self.pixels), self.background, self.detection, self.given.saturation_dn)
        found = find_trails(
            self.pixels, self.background, self.detection, self.given.saturation_dn, self.given.gain_e_per_dn,
            _lines(known), self.spots.direction_rad, self.camera,
        )  # fmt: skip
        self.clock.lap("trails")
        return found

    def as_trails(self) -> FoundStars | None:
        """Positions of the trailed stars at mid-exposure by the camera's projection; None if there are no trails."""
        assert self.camera is not None
        trails = self.trails
        if trails is None:  # short trails are then measured as the detector found them
            return self.points(self.spots) if self.spots.are_streaks else None
        stars = mid_exposure(trails, self.camera)
        length = float(np.hypot(*trails.motion[:2]))
        text = f"{len(stars)} trails with a common motion, {length:.1f} px at the image centre"
        return self._found(stars, partial(Step, "detection", text), True)

    def _found(self, stars: Centroids, step: Callable[[], Step | Sequence[Step]], trailed: bool) -> FoundStars:
        if self.centroid.camera_model_px > 0.0:
            stars = replace(stars, covariance=stars.covariance + self.centroid.camera_model_px**2 * np.eye(2))
        self.trace.extend((step, partial(centroid_step, stars)))
        variance = (stars.covariance[:, 0, 0] + stars.covariance[:, 1, 1]) / 2.0
        light = Light(self.pixels, self.background, self.detection.threshold_sigma)
        return FoundStars(
            Measured(stars.xy, stars.flux, variance, stars.covariance, stars.common_px2, stars.misfit, light),
            trailed,
            int(np.count_nonzero(stars.saturated)),
            saturated_share=self.checked.saturated_share,
            saturation_dn=self.checked.saturation_dn,
        )


def _lines(spots: Spots | None) -> FloatArray:
    """Midpoint x and y, and half the length along x and y, px, (N, 4) of the trails that the detector found."""
    if spots is None or spots.centre is None or spots.streak is None or not spots.streak.any():
        return np.empty((0, 4))
    return np.hstack([spots.centre, 0.5 * spots.streak])
