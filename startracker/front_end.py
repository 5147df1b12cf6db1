"""From an image to centroids, and centroids made fit for use: what comes before identification."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from startracker.camera import Camera
from startracker.centroid import Centroider
from startracker.centroid.result import Centroids
from startracker.centroid.streaks import Streaks, find_streaks
from startracker.detection import Background, Detector, estimate
from startracker.detection.components import find_smeared
from startracker.detection.defects import fill_gaps, has_crowd, mask_extremes, mask_impulses
from startracker.detection.smear import motion_at
from startracker.detection.spots import Spots
from startracker.detection.structure import follow_structure, has_structure
from startracker.detection.values import Image, as_pixels, whole_range
from startracker.errors import InputError
from startracker.explain import background_step, centroid_step, detection_steps, image_sample, image_step
from startracker.settings import CentroidSettings, DetectionSettings
from startracker.solution import Status
from startracker.trace import Step, Steps

__all__ = ["Clock", "FoundStars", "clean_centroids", "find_stars", "look_again", "stated_variance"]

FloatArray = NDArray[np.float64]

SAME_STAR_PX = 0.75
"""Two centroids closer than this are one star found twice."""
SATURATED_SHARE = 0.05
"""Share of saturated pixels above which an image that cannot be solved is called saturated."""
# The C library gives large freed blocks back to the system, and fetching a frame's pages anew costs as much as looking
# at it. Freeing one block of 31 MB, never touched, makes glibc keep up to twice that; elsewhere it does nothing.
np.empty(31 << 20, np.uint8)

_WHITE_SHARE = 0.5
_FEWEST_STREAKS = 4


@dataclass
class Clock:
    """Milliseconds of each stage."""

    laps: dict[str, float] = field(default_factory=dict)
    start: float = field(default_factory=time.perf_counter)
    last: float = field(default_factory=time.perf_counter)

    def lap(self, name: str) -> None:
        """The time since the last lap goes to a stage."""
        now = time.perf_counter()
        self.laps[name] = (now - self.last) * 1e3
        self.last = now

    def times_ms(self) -> dict[str, float]:
        """All laps, and the total until now."""
        return {**self.laps, "total": (time.perf_counter() - self.start) * 1e3}


@dataclass(frozen=True, eq=False)
class FoundStars:
    """Stars of an image, brightest first, or why there are none.

    Parameters
    ----------
    xy : (N, 2)
        Pixels.
    flux : (N,)
        DN.
    variance_px2 : (N,)
        Of a centroid, on one axis.
    status, reason : Status or None, str
        Set where the image cannot be used.
    saturated_share, saturation_dn : float
        Share of pixels at saturation, and that level.
    steps : sequence of Step
        What was found, in words.
    saturated : int
        Saturated star images.
    pixels, background : array (H, W) and Background, optional
        For a second look.
    smeared : bool
        Whether the stars seem to be streaks.
    covariance_px2 : (N, 2, 2), optional
        Of a centroid; None: `variance_px2` on both axes.
    lines : (N, 4)
        Middle x and y and half the length along x and y of the streaks that share one motion.
    streaks : Centroids, optional
        Where these are the points of a smeared frame: the streaks as the centroider measures them.
    common_px2 : (2, 2), optional
        Covariance of an error that all centroids share (`Centroids.common_px2`).
    """

    xy: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    flux: FloatArray = field(default_factory=lambda: np.empty(0))
    variance_px2: FloatArray = field(default_factory=lambda: np.empty(0))
    status: Status | None = None
    reason: str = ""
    saturated_share: float = 0.0
    saturation_dn: float = math.inf
    steps: Sequence[Step] = ()
    saturated: int = 0
    pixels: Image | None = None
    background: Background | None = None
    smeared: bool = False
    lines: FloatArray = field(default_factory=lambda: np.empty((0, 4)))
    covariance_px2: FloatArray | None = None
    streaks: Centroids | None = None
    common_px2: FloatArray | None = None


def find_stars(
    image: ArrayLike,
    detect: Detector,
    measure: Centroider,
    detection: DetectionSettings,
    centroid: CentroidSettings,
    clock: Clock,
    *,
    shape: tuple[int, int] | None = None,
    saturation_dn: float | None = None,
    gain_e_per_dn: float | None = None,
    points: bool = False,
) -> FoundStars:
    """Background, detection and centroids of an image.

    Parameters
    ----------
    image : array_like, shape (H, W)
        Any unit; NaN marks bad pixels.
    detect, measure
        Methods of `startracker.detection` and `startracker.centroid`.
    shape : (H, W), optional
        What the camera has; another is no image of it.
    clock : Clock
        Takes the times.
    points : bool
        Give the points of a smeared frame, too: the streaks are then those of `look_again`.

    Returns
    -------
    FoundStars
        Never raises for what the image shows.
    """
    survey, fault = _survey(image, shape, saturation_dn)
    if survey is None:
        return FoundStars(status=Status.BAD_IMAGE, reason=fault)
    pixels, share, level = survey.pixels, survey.saturated_share, survey.saturation_dn
    steps: list[Callable[[], Step | Sequence[Step]]] = [
        partial(image_step, pixels.shape, image_sample(pixels), share, level)
    ]
    if survey.masked:
        text = f"{survey.masked} pixels left out: no light gives such values beside the others"
        steps.append(partial(Step, "image", text))
    if share > _WHITE_SHARE:
        return FoundStars(status=Status.SATURATED, reason=says_saturated(share, level), steps=Steps(*steps))
    if survey.highest == survey.lowest:
        reason = f"every pixel is {survey.highest:g}"
        return FoundStars(status=Status.NO_STARS, reason=reason, steps=Steps(*steps))
    try:
        background = _background(pixels, detection)
        clock.lap("background")
        whole = fill_gaps(pixels) if survey.gaps else pixels
        spots = detect(whole, background, detection, saturation_dn)
        if has_crowd(spots, pixels.size):
            pixels, hot = mask_impulses(pixels, background)
            if hot:
                background = _background(pixels, detection)
                spots = detect(fill_gaps(pixels), background, detection, saturation_dn)
                spots = replace(spots, rejected={**spots.rejected, "hot pixel": hot})
        steps.append(partial(background_step, background))
        clock.lap("detection")
        trails = spots if spots.are_streaks else spots.other
        smeared = spots.are_streaks or (trails is None and _left_out_streaks(spots))
        streaks = None
        if points and spots.are_streaks and spots.other is not None:
            streaks, spots = measure(pixels, background, spots, centroid, gain_e_per_dn), spots.other
        steps.append(partial(detection_steps, spots, detection, background))
        found = measure(pixels, background, spots, centroid, gain_e_per_dn)
        clock.lap("centroid")
    except InputError as error:
        return FoundStars(status=Status.BAD_IMAGE, reason=str(error), steps=Steps(*steps))
    steps.append(partial(centroid_step, found))
    variance = np.trace(found.covariance, axis1=1, axis2=2) / 2.0
    return FoundStars(
        found.xy,
        found.flux,
        variance,
        saturated_share=share,
        saturation_dn=level,
        steps=Steps(*steps),
        saturated=int(np.count_nonzero(found.saturated)),
        pixels=pixels,
        background=background,
        smeared=smeared,
        lines=_lines(trails),
        streaks=streaks,
        covariance_px2=found.covariance,
        common_px2=found.common_px2,
    )


def _background(pixels: Image, detection: DetectionSettings) -> Background:
    """Background of a frame; where its tiles are too coarse for what is in them, one that follows it."""
    background = estimate(pixels, detection.background_tile_px)
    return follow_structure(pixels, detection.background_tile_px) if has_structure(pixels, background) else background


def _left_out_streaks(spots: Spots) -> bool:
    """Whether the detector left out so many streaks that they may be the stars."""
    return spots.rejected.get("streak", 0) >= max(_FEWEST_STREAKS, len(spots) // 4)


def _lines(spots: Spots | None) -> FloatArray:
    """What the motion of the frame has drawn of its stars, see `FoundStars`."""
    if spots is None or spots.centre is None or spots.streak is None or not spots.streak.any():
        return np.empty((0, 4))
    return np.hstack([spots.centre, 0.5 * spots.streak])


def look_again(
    first: FoundStars,
    detection: DetectionSettings,
    camera: Camera,
    clock: Clock,
    *,
    saturation_dn: float | None = None,
    gain_e_per_dn: float | None = None,
) -> FoundStars | None:
    """Stars drawn out by the camera's turn (`startracker.centroid.streaks`): for frames that are smeared, or unsolved.

    Parameters
    ----------
    first : FoundStars
        The first look.
    detection, camera, clock, saturation_dn, gain_e_per_dn
        As before.

    Returns
    -------
    FoundStars or None
        None where the frame has no such streaks.
    """
    if first.pixels is None or first.background is None:
        return None
    lines = first.lines
    if not len(lines):  # not every detector looks for them
        smeared = find_smeared(fill_gaps(first.pixels), first.background, detection, saturation_dn)
        lines = lines if smeared is None else _lines(smeared)
    streaks = find_streaks(first.pixels, first.background, detection, saturation_dn, gain_e_per_dn, lines)
    clock.lap("streaks")
    if streaks is not None:
        stars, length = streaks.centroids, float(np.hypot(*streaks.motion[:2]))
        middle = 0.5 * np.array([camera.width - 1.0, camera.height - 1.0])
        xy = stars.xy - _bow(stars.xy, camera, streaks, middle)
        text = f"{len(stars)} streaks of one motion, {length:.1f} px in the middle of the image"
    elif first.streaks is not None:
        stars, length = first.streaks, 2.0 * float(np.median(np.hypot(*lines[:, 2:].T)))
        xy, text = stars.xy, f"{len(stars)} streaks of one motion, about {length:.1f} px long"
    else:
        return None
    return FoundStars(
        xy,
        stars.flux,
        np.trace(stars.covariance, axis1=1, axis2=2) / 2.0,
        saturated_share=first.saturated_share,
        saturation_dn=first.saturation_dn,
        steps=Steps(Step("detection", text), partial(centroid_step, stars)),
        saturated=int(np.count_nonzero(stars.saturated)),
        covariance_px2=stars.covariance,
    )


def _bow(xy: FloatArray, camera: Camera, streaks: Streaks, middle: FloatArray) -> FloatArray:
    """How far the middle of a streak lies from where its star stood at mid-exposure (N, 2), pixels.

    The image of a steady turn neither runs evenly nor straight: along the streak the middle is that of its ends, across
    it the mean of an arc, which lies at two thirds of its height.
    """
    a, b, c = streaks.motion
    here = camera.unproject(xy)
    half = 0.5 * np.array([-b / camera.fy, a / camera.fx, c])
    angle = float(np.linalg.norm(half))
    if angle < 1e-12:
        return np.zeros_like(xy)
    axis = half / angle
    ends = []
    for turn in (angle, -angle):
        along = (here @ axis)[:, None] * axis
        turned = (here - along) * math.cos(turn) + np.cross(axis, here) * math.sin(turn) + along
        ends.append(camera.project(turned))
    off = 0.5 * (ends[0] + ends[1]) - xy
    direction = motion_at(xy - middle, streaks.motion)
    direction /= np.maximum(np.hypot(*direction.T), 1e-12)[:, None]
    along = (off * direction).sum(axis=1)[:, None] * direction
    bow = along + (off - along) / 3.0
    return np.where(np.isfinite(bow), bow, 0.0)


def clean_centroids(xy: ArrayLike, flux: ArrayLike | None, camera: Camera) -> tuple[FloatArray, FloatArray | None]:
    """Centroids (N, 2) fit for use, brightest first, and their flux: finite, on the image, no star twice.

    A flux that is not a positive number counts as the faintest of all.
    """
    try:
        points = np.asarray(plain(xy), dtype=float)
        signal = None if flux is None else np.asarray(plain(flux), dtype=float).reshape(-1)
    except (TypeError, ValueError):
        raise InputError("centroids and fluxes must be numbers: xy with the shape (N, 2), flux with (N,)") from None
    if points.size == 0:
        points = points.reshape(0, 2)
    if points.ndim != 2 or points.shape[1] != 2:
        raise InputError(f"centroids must have the shape (N, 2), columns x and y; got {points.shape}")
    if signal is not None and len(signal) != len(points):
        raise InputError(f"there are {len(points)} centroids, but {len(signal)} fluxes")
    keep = np.flatnonzero(np.isfinite(points).all(axis=1) & camera.contains(points))
    points = points[keep]
    if signal is not None:
        signal = signal[keep]
        good = np.isfinite(signal) & (signal > 0)
        if good.any():
            signal = np.where(good, signal, signal[good].min() * 0.5)
            # position breaks ties, so that the order of the rows means nothing
            order = np.lexsort((points[:, 0], points[:, 1], -signal))
            points, signal = points[order], signal[order]
        else:
            signal = None
    alone = _first_of_each(points)
    return points[alone], None if signal is None else signal[alone]


def stated_variance(sigma_px: ArrayLike | None, xy: ArrayLike, kept: FloatArray) -> FloatArray | None:
    """Variance (M,), pixels², of the centroids `kept` (M, 2) by `clean_centroids` of those given, from their stated
    standard errors: one of each, or one for all; None where none is stated.

    Raises
    ------
    InputError
        For a shape that does not fit, or an error that is not positive and finite.
    """
    if sigma_px is None:
        return None
    points = np.asarray(xy, dtype=float).reshape(-1, 2)
    try:
        sigma = np.asarray(sigma_px, dtype=float)
    except (TypeError, ValueError):
        raise InputError("sigma_px must be numbers: the standard error of each centroid on one axis, pixels") from None
    if sigma.shape not in ((), (len(points),)):
        raise InputError(f"there are {len(points)} centroids, but sigma_px has the shape {sigma.shape}")
    if sigma.size and not (np.isfinite(sigma) & (sigma > 0.0)).all():
        raise InputError("sigma_px must be positive and finite, pixels")
    row = {(x, y): k for k, (x, y) in reversed(list(enumerate(points.tolist())))}  # the first of equal ones
    chosen = [row[x, y] for x, y in kept.tolist()]
    return np.asarray(np.broadcast_to(sigma, len(points))[chosen] ** 2)


@njit(cache=True, error_model="numpy")
def _first_of_each(points: FloatArray) -> NDArray[np.bool_]:
    """Points (N,) without another before them that is nearer than `SAME_STAR_PX` on both axes."""
    alone = np.ones(len(points), np.bool_)
    order = np.argsort(points[:, 0])
    for first in range(len(points)):  # from left to right: what is near on x follows
        i = order[first]
        for second in range(first + 1, len(points)):
            j = order[second]
            if points[j, 0] - points[i, 0] >= SAME_STAR_PX:
                break
            if abs(points[i, 1] - points[j, 1]) < SAME_STAR_PX:
                alone[max(i, j)] = False
    return alone


def plain(values: ArrayLike) -> NDArray[Any]:
    """An array with NaN where a masked array (`numpy.ma`) is masked; anything else as it is."""
    if not isinstance(values, np.ma.MaskedArray):
        return np.asarray(values)
    if values.dtype.kind not in "buif" or not np.ma.is_masked(values):
        return np.asarray(values.data)
    kind = np.float64 if values.dtype.itemsize > 2 else np.float32  # which hold all the numbers exactly
    return np.asarray(np.ma.filled(values.astype(kind), np.nan))


@dataclass(frozen=True, eq=False)
class _Survey:
    """A usable image as uint16 or float32, NaN where not finite or of a value that no light gives, of which there are
    `masked`; its range; its saturated share and that level; whether it has NaN."""

    pixels: Image
    lowest: float
    highest: float
    saturated_share: float
    saturation_dn: float
    masked: int = 0
    gaps: bool = False


def _survey(image: ArrayLike, shape: tuple[int, int] | None, saturation_dn: float | None) -> tuple[_Survey | None, str]:
    """What an image is, or why it is none.

    The saturation is the level given, the largest number of an unsigned type, or a flat top.
    """
    try:
        as_given = np.asanyarray(image)
        given = plain(as_given)
        if given.dtype.kind not in "buif":
            return None, f"an image needs real numbers; got {given.dtype}"
    except (TypeError, ValueError):
        return None, "an image must be an array of numbers"
    if given.ndim != 2:
        return None, f"an image must have two dimensions (rows, columns); got {given.shape}"
    pixels = as_pixels(given)
    if shape is not None and given.shape != shape:
        return None, (
            f"the image is {given.shape[1]}×{given.shape[0]} pixels, the camera {shape[1]}×{shape[0]}: "
            "give the camera that took it"
        )
    if not given.size:
        return None, "no pixel of the image is a finite number"
    level = saturation_dn
    if level is None and as_given.dtype.kind == "u":
        level = float(np.iinfo(as_given.dtype).max)
    if level is not None and pixels.dtype == np.uint16:
        least, most, full = whole_range(pixels, float(level))
        return _Survey(pixels, float(least), float(most), full / pixels.size, level), ""
    # whole numbers need no search for what is not finite, and have their range in a quarter of the time
    plane = given if given.dtype.kind in "ui" else pixels
    lowest, highest = float(np.float32(plane.min())), float(np.float32(plane.max()))
    gaps = not (math.isfinite(lowest) and math.isfinite(highest))  # NaN makes both NaN
    if gaps:
        pixels = np.where(np.isfinite(pixels), pixels, np.float32(np.nan))
        lowest, highest = float(np.fmin.reduce(pixels, axis=None)), float(np.fmax.reduce(pixels, axis=None))
        if not math.isfinite(highest):
            return None, "no pixel of the image is a finite number"
    pixels, masked = mask_extremes(pixels, lowest, highest)
    if masked:
        lowest, highest = float(np.fmin.reduce(pixels, axis=None)), float(np.fmax.reduce(pixels, axis=None))
    if level is None:
        level = highest if highest > 0 else math.inf
    full = np.count_nonzero(pixels >= level) if highest >= level else 0
    return _Survey(pixels, lowest, highest, full / pixels.size, level, masked, gaps or masked > 0), ""


def says_saturated(share: float, level: float) -> str:
    """The finding in words."""
    return f"{100 * share:.0f} % of the pixels are at or above {level:g}: saturated; expose for less time"
