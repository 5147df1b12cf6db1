"""Rules of autonomous operation of a star sensor from frame to frame (Greyling 1995, sections 4.2.1 and 4.2.2).

Before a frame is passed to the tracker, in this order:

Sun        a frame with too many saturated pixels is rejected, and none is taken until the camera has rotated by more
than the Sun's diameter; repeated until it has passed Repeats    a frame with the same pixels as an earlier one is not
new, and no rule acts on it Moon       objects larger than a star are removed from the frame exposure   a frame whose
two brightest stars each have more than four saturated pixels is discarded, and the next exposure is shorter; if the
stars are faint, it is longer again

After the tracker: magnitudes by the calibrated relation, and the map of defective pixels, which are fixed while stars
move.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from hashlib import blake2b

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import binary_dilation, label

from startracker.core import FloatArray
from startracker.detection.background import Background, estimate
from startracker.detection.defect_map import DefectMap, mask_pixels
from startracker.display import fields_repr
from startracker.errors import InputError
from startracker.geometry.attitude import Attitude
from startracker.geometry.camera import Camera
from startracker.settings import DetectionSettings, OperationSettings
from startracker.solution import MatchedStars

BoolImage = NDArray[np.bool_]

_EIGHT = np.ones((3, 3), dtype=np.int8)
_MARGIN_PX = 2
"""Margin removed around a removed object, for its faint rim."""
_STAR_PX = 3
"""Distance from a matched star within which bright pixels are not tested for defects."""
_MULTIPLE = 1e-9
_REMEMBERED = 8
"""Number of frames remembered for repeats, as in a tracking session."""


@dataclass(frozen=True, eq=False)
class Verdict:
    """Result of the rules for a frame."""

    rule: str
    """The rule that acted: ``sun``, ``stale``, ``exposure``, ``moon``, or empty."""
    reason: str
    """Description of the finding."""
    image: NDArray[np.float32] | None
    """Frame for the tracker, (H, W), with NaN for unusable pixels; None: not used."""
    saturated_px: tuple[int, ...] = ()
    """Numbers of saturated pixels of saturated stars, in descending order; objects at the border are excluded."""
    cleared: BoolImage | None = field(default=None, repr=False)
    """Mask of pixels removed because of their size, (H, W); None: none."""

    __repr__ = fields_repr

    @property
    def cleared_px(self) -> int:
        """Number of removed pixels."""
        return 0 if self.cleared is None else int(self.cleared.sum())


class SensorOperation:
    """The rules, with their state between frames.

    Parameters
    ----------
    settings : OperationSettings
        Settings of the rules.
    detection : DetectionSettings
        Detection settings of the tracker: threshold, tile and largest star.
    camera : Camera
        The calibrated camera.
    exposure_s : float
        Initial and maximum exposure.

    Raises
    ------
    InputError
        For an exposure that is not positive.
    """

    def __init__(
        self, settings: OperationSettings, detection: DetectionSettings, camera: Camera, exposure_s: float
    ) -> None:
        if not (math.isfinite(exposure_s) and exposure_s > 0.0):
            raise InputError(f"the exposure must be positive; got {exposure_s}")
        self.settings, self.detection, self.camera = settings, detection, camera
        self.longest_s = exposure_s
        self.exposure_s = self._allowed(exposure_s)
        """Exposure of the next frame."""
        self._suspended_s = self._resume_s = -math.inf
        self._seen: deque[bytes] = deque(maxlen=_REMEMBERED)
        self._defects = DefectMap(
            camera,
            frames=settings.blemish_frames,
            share=settings.blemish_share,
            sigma=settings.blemish_sigma,
            shift_px=settings.blemish_shift_px,
            tile_px=detection.background_tile_px,
        )
        self.blemishes: BoolImage = self._defects.mask
        """Current map of defective pixels."""

    # ------------------------------------------------------------------ before the tracker
    def suspended(self, t_s: float) -> bool:
        """Whether operation is suspended at a time, seconds; setting the clock back to before the Sun's frame ends a
        suspension."""
        return self._suspended_s <= t_s < self._resume_s

    def judge(self, image: ArrayLike, t_s: float, saturation_dn: float, rate_rad_s: ArrayLike | None = None) -> Verdict:
        """Apply the rules to a frame taken with `exposure_s`, and set `exposure_s` for the next one.

        Parameters
        ----------
        image : array_like, shape (H, W)
            DN.
        t_s : float
            Time of the frame.
        saturation_dn : float
            DN of saturation.
        rate_rad_s : array_like, shape (3,), optional
            Rate of the camera, if known.
        """
        pixels = mask_pixels(image, self.blemishes)
        saturated = np.asarray(pixels >= saturation_dn)
        share = float(saturated.mean())
        if share > self.settings.sun_share:
            wait_s = self._suspension_s(rate_rad_s)
            self._suspended_s, self._resume_s = t_s, t_s + wait_s
            reason = (
                f"{100.0 * share:.1f} % of the pixels are saturated (Sun in the field); no frame for {wait_s:.3g} s"
            )
            return Verdict("sun", reason, None)
        digest = blake2b(np.ascontiguousarray(image).tobytes(), digest_size=16).digest()
        if digest in self._seen:  # its exposure and pixels have already been evaluated
            return Verdict("stale", "the frame has the same pixels as an earlier one", None)
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
                    f"next exposure {shorter_s:.3g} s instead of {exposure_s:.3g} s"
                )
                return Verdict("exposure", reason, None, most, cleared)
        if not most and self._faint(pixels, background, objects, stars, saturation_dn):
            self.exposure_s = self._longer()
        if cleared is None:
            return Verdict("", "", pixels, most)
        reason = f"{int(cleared.sum())} pixels of objects larger than {largest} pixels are removed"
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
        """Whether the peak of the brightest star is below the fraction of saturation at which the exposure is
        increased."""
        share = self.settings.lengthen_below
        if share <= 0.0 or self.exposure_s >= self.longest_s:
            return False
        bright = np.asarray(pixels > background.level + share * (saturation_dn - background.level))
        return not np.any(stars[objects[bright]] >= self.detection.min_pixels)

    def _allowed(self, exposure_s: float) -> float:
        """Longest permitted exposure not exceeding this one."""
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
        """Update the map of defective pixels with a frame, if the stars have moved since the last one used.

        Parameters
        ----------
        image : array_like, shape (H, W)
            The original frame.
        verdict : Verdict
            Result of `judge`; frames that were not used are ignored.
        attitude : Attitude, optional
            Attitude of the camera; without it the map is not updated.
        stars : MatchedStars
            Stars of the frame, around which bright pixels are ignored.
        """
        if verdict.image is not None and attitude is not None:
            self._defects.add(image, attitude, stars.xy, verdict.cleared)
            self.blemishes = self._defects.mask


def image_magnitudes(flux_dn: ArrayLike, gain_e_per_dn: float, exposure_s: float, zero_point: float) -> FloatArray:
    """Magnitudes by the calibrated relation, m = zero point − 2.5 lg(electrons per second); (N,), NaN without signal.

    Exact for stars of the calibration colour; others differ because of their spectra between V and the detector's band
    (Greyling 1995, section 3.4.3: a table of magnitude and output voltage).

    Parameters
    ----------
    flux_dn : (N,) array
        Signal above the background.
    gain_e_per_dn, exposure_s : float
        Gain and exposure of the frame.
    zero_point : float
        Magnitude that gives one electron per second.
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
    """Object number of each pixel, 0 for none, and number of pixels of each object, 0 for number 0."""
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
