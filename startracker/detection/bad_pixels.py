"""Bad pixels: found as what stays in place while the sky moves, and left out as not a number."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker.arguments import ABOVE_0, real_number, whole_number
from startracker.detection.background import as_image, estimate
from startracker.detection.thresholds import BAD_SHARE, FEWEST_FRAMES
from startracker.errors import InputError


def mask_pixels(image: ArrayLike, bad_pixels: ArrayLike | None) -> NDArray[np.float32]:
    """Image as float32 with NaN at the bad pixels, which every stage leaves out; the image given stays as it is.

    Parameters
    ----------
    image : array_like, shape (H, W)
        DN.
    bad_pixels : array_like of bool, shape (H, W), or None
        True where a pixel is not to be used.

    Raises
    ------
    InputError
        Not an image, or a mask of another shape.
    """
    pixels = as_image(image)
    if bad_pixels is None:
        return pixels
    mask = as_mask("the bad-pixel map", bad_pixels, pixels.shape)
    return np.where(mask, np.float32(np.nan), pixels)


def as_mask(name: str, given: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Argument as a mask of an image of this shape: truth values, or numbers, of which 0 is false.

    Raises
    ------
    InputError
        For anything else, or a mask of another shape.
    """
    try:
        mask = np.asarray(given)
    except (TypeError, ValueError):
        mask = np.empty(0, dtype=object)
    if mask.dtype.kind not in "buif":
        raise InputError(f"{name} must be an array of truth values")
    if mask.shape != shape:
        raise InputError(f"{name} is {mask.shape}, the image {shape}; they must agree")
    return mask.astype(np.bool_)


class BadPixelCount:
    """Counts, frame by frame, the pixels that are off by more than a threshold.

    Bright and dark are counted apart, so that a flickering pixel of both signs needs `share` of one.

    Parameters
    ----------
    sigma, share, tile_px
        As of `find_bad_pixels`.

    Raises
    ------
    InputError
        A share or a threshold that cannot be.
    """

    def __init__(self, sigma: float = 5.0, share: float = BAD_SHARE, tile_px: int = 64) -> None:
        self.sigma = real_number("sigma", sigma, least=ABOVE_0, finite=False)
        self.share = real_number("share", share, least=ABOVE_0, most=1.0)
        self.tile_px = whole_number("tile_px", tile_px, least=4)
        self.frames = 0
        self._seen, self._bright, self._dark = np.zeros((3, 0, 0), np.int32)

    def add(self, frame: ArrayLike, ignore: NDArray[np.bool_] | None = None) -> None:
        """Count a frame.

        Parameters
        ----------
        frame : array_like, shape (H, W)
            DN; pixels that are not finite count as bad.
        ignore : bool array, shape (H, W), optional
            Pixels that are not to be judged by this frame, such as those of known stars.

        Raises
        ------
        InputError
            A frame of another shape than those before.
        """
        pixels = as_image(frame)
        if self.frames == 0:
            self._seen, self._bright, self._dark = np.zeros((3, *pixels.shape), np.int32)
        elif pixels.shape != self._bright.shape:
            raise InputError(f"frame {self.frames} is {pixels.shape}, the first {self._bright.shape}; they must agree")
        background = estimate(pixels, self.tile_px)
        judged = np.ones(pixels.shape, np.bool_) if ignore is None else ~ignore
        limit = self.sigma * background.noise
        with np.errstate(invalid="ignore"):
            above, below = pixels > background.level + limit, pixels < background.level - limit
        if not np.isfinite(pixels.sum(dtype=np.float64)):
            blind = ~np.isfinite(pixels)
            above, below = above | blind, below | blind
        for count, beyond in ((self._bright, above), (self._dark, below)):
            count.ravel()[np.flatnonzero(beyond & judged)] += 1
        self._seen += judged
        self.frames += 1

    def bad(self, fewest_frames: int = FEWEST_FRAMES) -> NDArray[np.bool_]:
        """Pixels off in `share` of the frames that judge them, and in two at least; (H, W).

        Parameters
        ----------
        fewest_frames : int
            Frames that must judge a pixel.
        """
        bad = np.zeros(self._seen.shape, np.bool_)
        most = np.maximum(self._bright, self._dark).ravel()
        found = np.flatnonzero(most >= 2)
        seen = self._seen.ravel()[found]
        bad.ravel()[found] = (most[found] >= self.share * seen) & (seen >= fewest_frames)
        return bad


def find_bad_pixels(
    frames: Iterable[ArrayLike], sigma: float = 5.0, share: float = BAD_SHARE, tile_px: int = 64
) -> NDArray[np.bool_]:
    """Pixels that are off by more than `sigma` times the noise, the same way, in most frames of different pointing.

    A star crosses a pixel in one frame of several; a hot, dead or stuck pixel stays. Bright and dark are counted
    apart, so that a flickering pixel of both signs needs `share` of one. By chance a good pixel exceeds 5σ with
    3e-7 a frame: never three times. The frames should be moved by more than a star image from one another; where
    fewer than a quarter of them show the same sky, no star is taken for a bad pixel.

    Parameters
    ----------
    frames : iterable of array_like, shape (H, W)
        At least three; taken one by one, so that a generator holds but one in memory. Pixels that are not finite in
        `share` of the frames are bad.
    sigma : float
        Threshold, in units of the local noise.
    share : float
        Least share of the frames, above 0 and at most 1.
    tile_px : int
        As for `estimate`.

    Returns
    -------
    bool array, shape (H, W)

    Raises
    ------
    InputError
        Fewer than three frames, frames of different shapes, a share or threshold that cannot be.
    """
    counted = BadPixelCount(sigma, share, tile_px)
    if not isinstance(frames, Iterable):
        raise InputError(f"frames must be a list of images; got {type(frames).__name__}")
    for frame in frames:
        counted.add(frame)
    if counted.frames < FEWEST_FRAMES:
        raise InputError(f"bad pixels need at least {FEWEST_FRAMES} frames of different pointing; got {counted.frames}")
    return counted.bad()
