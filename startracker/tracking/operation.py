"""Rules by which a star sensor operates itself from frame to frame (Greyling 1995, sections 4.2.1 and 4.2.2).

Before a frame goes to the tracker, in this order:

Sun        a frame of which too many pixels are saturated is rejected, and none is taken until the camera has turned by
           more than the Sun's diameter; so on until it has passed
Repeats    a frame with the same pixels as one before is no new frame, and no rule acts on it
Moon       anything larger than a star is cleared from the frame
exposure   a frame whose two brightest stars each have more than four saturated pixels is discarded, and the next one
           exposed for less; where the stars are faint, for longer again

And after it: magnitudes by the calibrated relation, and the map of defective pixels, which stay while stars move.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from hashlib import blake2b

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import binary_dilation, label

from startracker.attitude import Attitude
from startracker.camera import Camera
from startracker.detection.background import Background, estimate
from startracker.detection.bad_pixels import BadPixelCount, mask_pixels
from startracker.display import fields_repr
from startracker.errors import InputError
from startracker.settings import DetectionSettings, OperationSettings
from startracker.solution import MatchedStars

__all__ = ["SensorOperation", "Verdict", "image_magnitudes", "saturated_near"]

FloatArray = NDArray[np.float64]
BoolImage = NDArray[np.bool_]

_EIGHT = np.ones((3, 3), dtype=np.int8)
_MARGIN_PX = 2
"""Cleared around what is cleared: its faint rim."""
_STAR_PX = 3
"""About a matched star a bright pixel says nothing of the pixel."""
_MULTIPLE = 1e-9
_REMEMBERED = 8
"""Frames that are known again, as in a tracking session."""


@dataclass(frozen=True, eq=False)
class Verdict:
    """What the rules make of a frame."""

    rule: str
    """The rule that acted: ``sun``, ``stale``, ``exposure``, ``moon``, or empty."""
    reason: str
    """The finding in words."""
    image: NDArray[np.float32] | None
    """Frame for the tracker, NaN where it is not to be used, (H, W); None: not used at all."""
    saturated_px: tuple[int, ...] = ()
    """Saturated pixels of the stars that have any, most first; what touches the border is no whole star."""
    cleared: BoolImage | None = field(default=None, repr=False)
    """What was cleared for its size, (H, W); None: nothing."""

    __repr__ = fields_repr

    @property
    def cleared_px(self) -> int:
        """Number of cleared pixels."""
        return 0 if self.cleared is None else int(self.cleared.sum())


class SensorOperation:
    """The rules, with what they remember from frame to frame.

    Parameters
    ----------
    settings : OperationSettings
        The rules' numbers.
    detection : DetectionSettings
        Of the tracker: threshold, tile and largest star.
    camera : Camera
        The calibrated camera.
    exposure_s : float
        First exposure, and the longest.

    Raises
    ------
    InputError
        For an exposure that is not positive.
    """

    def __init__(
        self, settings: OperationSettings, detection: DetectionSettings, camera: Camera, exposure_s: float
    ) -> None:
        if not (math.isfinite(exposure_s) and exposure_s > 0.0):
            raise InputError(f"an exposure lasts more than zero seconds; got {exposure_s}")
        self.settings, self.detection, self.camera = settings, detection, camera
        self.longest_s = exposure_s
        self.exposure_s = self._allowed(exposure_s)
        """Exposure of the next frame."""
        self.blemishes: BoolImage = np.zeros((camera.height, camera.width), np.bool_)
        """Map of defective pixels so far."""
        self._suspended_s = self._resume_s = -math.inf
        self._seen: deque[bytes] = deque(maxlen=_REMEMBERED)
        self._count = BadPixelCount(settings.blemish_sigma, settings.blemish_share, detection.background_tile_px)
        self._counted_at: Attitude | None = None

    # ------------------------------------------------------------------ before the tracker
    def suspended(self, t_s: float) -> bool:
        """Whether no frame is to be taken at a time, seconds; a clock set back to before the Sun's frame ends that."""
        return self._suspended_s <= t_s < self._resume_s

    def judge(self, image: ArrayLike, t_s: float, saturation_dn: float, rate_rad_s: ArrayLike | None = None) -> Verdict:
        """Apply the rules to a frame taken with `exposure_s`, which is then that of the next one.

        Parameters
        ----------
        image : array_like, shape (H, W)
            DN.
        t_s : float
            Its time.
        saturation_dn : float
            DN from which on a pixel counts as saturated.
        rate_rad_s : array_like, shape (3,), optional
            Camera's rate where known.
        """
        pixels = mask_pixels(image, self.blemishes)
        saturated = np.asarray(pixels >= saturation_dn)
        share = float(saturated.mean())
        if share > self.settings.sun_share:
            wait_s = self._suspension_s(rate_rad_s)
            self._suspended_s, self._resume_s = t_s, t_s + wait_s
            reason = f"{100.0 * share:.1f} % of the pixels are saturated: the Sun; no frame for {wait_s:.3g} s"
            return Verdict("sun", reason, None)
        digest = blake2b(np.ascontiguousarray(image).tobytes(), digest_size=16).digest()
        if digest in self._seen:  # the exposure that it shows was judged already, and its pixels were counted
            return Verdict("stale", "the frame has the same pixels as one before", None)
        self._seen.append(digest)
        background = estimate(pixels, self.detection.background_tile_px)
        objects, size = _objects(pixels, background, self.detection.threshold_sigma)
        largest = self.settings.clear_pixels or self.detection.max_pixels
        cleared = self._cleared(objects, size > largest)
        if cleared is not None:
            pixels = np.where(cleared, np.float32(np.nan), pixels)
        stars = np.where(size > largest, 0, size)
        counts = np.bincount(objects[saturated], minlength=len(size))[: len(size)]
        counts = np.where((stars > 0) & ~_at_border(objects, len(size)), counts, 0)
        most = tuple(int(n) for n in np.sort(counts[counts > 0])[::-1])
        limit = self.settings.saturated_pixels
        exposure_s = self.exposure_s
        if len(most) > 1 and most[1] > limit:
            shorter_s = self._shorter()
            if shorter_s < exposure_s:
                self.exposure_s = shorter_s
                reason = (
                    f"the two brightest stars have {most[0]} and {most[1]} saturated pixels, more than {limit}: "
                    f"exposed for {shorter_s:.3g} s in place of {exposure_s:.3g} s"
                )
                return Verdict("exposure", reason, None, most, cleared)
        if not most and self._faint(pixels, background, objects, stars, saturation_dn):
            self.exposure_s = self._longer()
        if cleared is None:
            return Verdict("", "", pixels, most)
        reason = f"{int(cleared.sum())} pixels of what is larger than {largest} pixels are cleared"
        return Verdict("moon", reason, pixels, most, cleared)

    def _suspension_s(self, rate_rad_s: ArrayLike | None) -> float:
        rate = 0.0 if rate_rad_s is None else float(np.linalg.norm(np.asarray(rate_rad_s, dtype=float)))
        longest = self.settings.longest_suspension_s
        turn = math.radians(self.settings.suspend_turn_deg)
        return turn / rate if rate * longest > turn else longest

    def _cleared(self, objects: NDArray[np.int32], large: BoolImage) -> BoolImage | None:
        if not large.any():
            return None
        return np.asarray(binary_dilation(large[objects], _EIGHT, iterations=_MARGIN_PX))

    def _faint(
        self,
        pixels: NDArray[np.float32],
        background: Background,
        objects: NDArray[np.int32],
        stars: NDArray[np.int64],
        saturation_dn: float,
    ) -> bool:
        """Whether the brightest star's peak stays below the share of saturation from which on it is left alone."""
        share = self.settings.lengthen_below
        if share <= 0.0 or self.exposure_s >= self.longest_s:
            return False
        bright = np.asarray(pixels > background.level + share * (saturation_dn - background.level))
        return not np.any(stars[objects[bright]] >= self.detection.min_pixels)

    def _allowed(self, exposure_s: float) -> float:
        """Longest exposure allowed that is no longer than this one."""
        step = self.settings.exposure_step_s
        if step <= 0.0:
            return max(exposure_s, self.settings.shortest_exposure_s)
        fewest = max(1, math.ceil(self.settings.shortest_exposure_s / step - _MULTIPLE))
        return max(fewest, math.floor(exposure_s / step * (1.0 + _MULTIPLE))) * step

    def _shorter(self) -> float:
        return self._allowed(self.exposure_s * self.settings.shorten)

    def _longer(self) -> float:
        return self._allowed(min(self.longest_s, self.exposure_s / self.settings.shorten))

    # ------------------------------------------------------------------ after it
    def learn(self, image: ArrayLike, verdict: Verdict, attitude: Attitude | None, stars: MatchedStars) -> None:
        """Update the map of defective pixels with a frame, if the sky has moved since the last one that was used.

        Parameters
        ----------
        image : array_like, shape (H, W)
            The frame as it came.
        verdict : Verdict
            What `judge` made of it; one that was not used is ignored.
        attitude : Attitude, optional
            Of the camera; without one nothing is learnt.
        stars : MatchedStars
            Those of the frame, about which bright pixels say nothing.
        """
        if self.settings.blemish_frames == 0 or verdict.image is None or attitude is None:
            return
        if self._counted_at is not None and self._shift_px(self._counted_at, attitude) < self.settings.blemish_shift_px:
            return
        self._counted_at = attitude
        ignore = np.zeros(self.blemishes.shape, np.bool_) if verdict.cleared is None else verdict.cleared.copy()
        for x, y in np.rint(stars.xy).astype(int):
            ignore[max(y - _STAR_PX, 0) : y + _STAR_PX + 1, max(x - _STAR_PX, 0) : x + _STAR_PX + 1] = True
        self._count.add(image, ignore)
        if self._count.frames >= self.settings.blemish_frames:
            self.blemishes = self._count.bad(self.settings.blemish_frames)

    def _shift_px(self, before: Attitude, now: Attitude) -> float:
        """Median shift of stars over the field between two attitudes, pixels; those that leave it count as far."""
        camera = self.camera
        x, y = np.meshgrid(np.linspace(0, camera.width - 1, 4), np.linspace(0, camera.height - 1, 4))
        pixels = np.stack([x.ravel(), y.ravel()], axis=1)
        vectors = now.apply(before.inverse.apply(camera.unproject(pixels)))
        shift = np.hypot(*(camera.project(vectors) - pixels).T)
        return float(np.median(np.where(np.isfinite(shift), shift, np.inf)))


def image_magnitudes(flux_dn: ArrayLike, gain_e_per_dn: float, exposure_s: float, zero_point: float) -> FloatArray:
    """Magnitudes by the calibrated relation, m = zero point − 2.5 lg(electrons per second); (N,), NaN without signal.

    Exact for stars of the colour of calibration; others differ by what their spectra do between V and the detector's
    band (Greyling 1995, section 3.4.3: a table of magnitude against output voltage).

    Parameters
    ----------
    flux_dn : (N,) array
        Signal above the background.
    gain_e_per_dn, exposure_s : float
        Of the frame.
    zero_point : float
        Magnitude that leaves one electron a second.
    """
    rate = np.asarray(flux_dn, dtype=float) * (gain_e_per_dn / exposure_s)
    return zero_point - 2.5 * np.log10(np.where(rate > 0.0, rate, np.nan))


def saturated_near(image: ArrayLike, xy: ArrayLike, saturation_dn: float, half_px: int = _STAR_PX) -> BoolImage:
    """Whether a saturated pixel lies within `half_px` of points (N, 2): (N,) bool."""
    pixels = np.asarray(image)
    centres = np.rint(np.asarray(xy, dtype=float).reshape(-1, 2)).astype(int)
    found = np.zeros(len(centres), np.bool_)
    for k, (x, y) in enumerate(centres):
        window = pixels[max(y - half_px, 0) : y + half_px + 1, max(x - half_px, 0) : x + half_px + 1]
        found[k] = bool(np.any(window >= saturation_dn))
    return found


def _objects(
    pixels: NDArray[np.float32], background: Background, threshold_sigma: float
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Object number of each pixel, 0 for none, and pixels of each object, 0 for number 0."""
    with np.errstate(invalid="ignore"):
        above = pixels > background.level + threshold_sigma * background.noise
    objects, count = label(above, structure=_EIGHT)
    size = np.bincount(objects.ravel(), minlength=count + 1)
    size[0] = 0
    return objects, size


def _at_border(objects: NDArray[np.int32], count: int) -> BoolImage:
    """Whether each object touches the border of the image; (count,)."""
    at = np.zeros(count, np.bool_)
    for line in (objects[0], objects[-1], objects[:, 0], objects[:, -1]):
        at[line] = True
    return at
