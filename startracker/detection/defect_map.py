"""Map of defective pixels from successive frames: a defect keeps its pixel while the stars move."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker.arguments import ABOVE_0, of_kind, real_array, real_number, whole_number
from startracker.core import FloatArray
from startracker.detection.background import as_image, estimate
from startracker.detection.thresholds import BAD_SHARE, FEWEST_FRAMES
from startracker.errors import InputError
from startracker.geometry.attitude import Attitude, camera_attitude
from startracker.geometry.camera import Camera


def mask_pixels(image: ArrayLike, bad_pixels: ArrayLike | None) -> NDArray[np.float32]:
    """The image as float32 with NaN at the bad pixels, which every stage ignores; the argument is not changed.

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
    """Convert an argument to a mask of an image of this shape: truth values, or numbers of which 0 is false.

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
    """Count, frame by frame, the pixels that deviate from the background by more than a threshold.

    Bright and dark deviations are counted separately, so that a pixel that flickers both ways must reach `share` in one
    direction.

    Parameters
    ----------
    sigma, share, tile_px
        See `find_bad_pixels`.

    Raises
    ------
    InputError
        A share or a threshold out of range.
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
            Pixels that this frame does not test, such as around known stars.

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
        # A sum that is finite proves that every pixel is, at a fraction of the cost of testing each.
        if not np.isfinite(pixels.sum(dtype=np.float64)):
            blind = ~np.isfinite(pixels)
            above, below = above | blind, below | blind
        for count, beyond in ((self._bright, above), (self._dark, below)):
            # Few pixels deviate, so adding at their indices is faster than adding the whole masks.
            count.ravel()[np.flatnonzero(beyond & judged)] += 1
        self._seen += judged
        self.frames += 1

    def bad(self, fewest_frames: int = FEWEST_FRAMES) -> NDArray[np.bool_]:
        """Mask (H, W) of the pixels that deviate in `share` of the frames that test them, and in two at least.

        Parameters
        ----------
        fewest_frames : int
            Least number of frames that must test a pixel.
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
    """Mask of the pixels that deviate by more than `sigma` times the noise, in one direction, in most frames.

    The frames must have different pointings: a star crosses a pixel in one frame of several, while a hot, dead or stuck
    pixel stays. Bright and dark deviations are counted separately, so that a pixel that flickers both ways must reach
    `share` in one direction. A good pixel exceeds 5σ by chance with a probability of 3e-7 per frame, and so never three
    times. The pointings should differ by more than a star image; if fewer than a quarter of the frames show the same
    sky, no star is mistaken for a bad pixel.

    Parameters
    ----------
    frames : iterable of array_like, shape (H, W)
        At least three. They are read one by one, so that a generator needs memory for one only. Pixels that are not
        finite in `share` of the frames are bad.
    sigma : float
        Threshold, in units of the local noise.
    share : float
        Least fraction of the frames, above 0 and at most 1.
    tile_px : int
        As for `estimate`.

    Returns
    -------
    bool array, shape (H, W)

    Raises
    ------
    InputError
        Fewer than three frames, frames of different shapes, a share or threshold out of range.
    """
    counted = BadPixelCount(sigma, share, tile_px)
    if not isinstance(frames, Iterable):
        raise InputError(f"frames must be a list of images; got {type(frames).__name__}")
    for frame in frames:
        counted.add(frame)
    if counted.frames < FEWEST_FRAMES:
        raise InputError(f"bad pixels need at least {FEWEST_FRAMES} frames of different pointing; got {counted.frames}")
    return counted.bad()


BoolImage = NDArray[np.bool_]

_TILES = 16
"""Tiles along each side of the image, in each of which the motion of the sky is determined."""
_STAR_PX = 3
"""Distance from a known star within which pixels are not tested."""


class DefectMap:
    """Counts defective pixels in frames between which the sky has moved.

    A pixel is only counted if the stars at its position have moved by `shift_px` since it was last counted: a star that
    stays on a pixel, or near the axis about which the camera rotates, is not a defect.

    Parameters
    ----------
    camera : Camera
        The calibrated camera.
    frames : int
        Minimum number of frames that must test a pixel; 0: nothing is mapped.
    share : float
        Fraction of these in which it must be bright, or dark.
    sigma : float
        Threshold in units of the local noise.
    shift_px : float
        Motion of the stars between two counts, pixels; more than the diameter of a star image.
    tile_px : int
        Size of the tiles of the background (`startracker.detection.background`).
    """

    def __init__(
        self, camera: Camera, *, frames: int, share: float, sigma: float, shift_px: float, tile_px: int = 64
    ) -> None:
        self.camera = of_kind("camera", camera, Camera)
        self.frames = whole_number("frames", frames, least=0)
        self.shift_px = real_number("shift_px", shift_px, least=0.0)
        self.mask: BoolImage = np.zeros((camera.height, camera.width), np.bool_)
        """Defective pixels, (H, W)."""
        self._count = BadPixelCount(sigma, share, tile_px)
        x, y = (np.linspace(-0.5, side - 0.5, 2 * _TILES + 1) for side in (camera.width, camera.height))
        # Corners, centres of the sides and centre of each tile, shared between neighbouring tiles.
        self._points = np.stack(np.meshgrid(x, y), axis=2)
        self._seen = np.zeros((_TILES, _TILES, 3, 3))
        """Attitude matrix at which each tile was last counted, (tiles, tiles, 3, 3)."""
        self._never = np.ones((_TILES, _TILES), np.bool_)

    @property
    def xy(self) -> NDArray[np.int64]:
        """Columns and rows (N, 2) of the defective pixels."""
        return np.argwhere(self.mask)[:, ::-1]

    def add(self, image: ArrayLike, attitude: Attitude, stars_xy: FloatArray, ignore: BoolImage | None = None) -> None:
        """Count a frame where the sky has moved since the last count, and update `mask`.

        Parameters
        ----------
        image : array_like, shape (H, W)
            DN, without a mask.
        attitude : Attitude
            ICRS to camera.
        stars_xy : array, shape (M, 2)
            Pixels of the known stars, which are not tested.
        ignore : bool array, shape (H, W), optional
            Further pixels that are not tested.
        """
        if self.frames == 0:
            return
        matrix = camera_attitude("attitude", attitude).as_matrix()
        stars_xy = real_array("stars_xy", stars_xy, (None, 2))
        ignore = None if ignore is None else as_mask("ignore", ignore, self.mask.shape)
        moved = self._never | (self._motion_px(matrix) >= self.shift_px)
        if not moved.any():
            return
        self._seen[moved], self._never[moved] = matrix, False
        untested = np.zeros(self.mask.shape, np.bool_)
        rows, columns = (np.linspace(0, side, _TILES + 1).round().astype(int) for side in self.mask.shape)
        for j, i in np.argwhere(~moved):
            untested[rows[j] : rows[j + 1], columns[i] : columns[i + 1]] = True
        if ignore is not None:
            untested |= ignore
        for x, y in np.rint(stars_xy).astype(int):
            untested[max(y - _STAR_PX, 0) : y + _STAR_PX + 1, max(x - _STAR_PX, 0) : x + _STAR_PX + 1] = True
        self._count.add(image, untested)
        if self._count.frames >= self.frames:
            self.mask = self._count.bad(self.frames)

    def _motion_px(self, matrix: FloatArray) -> FloatArray:
        """Least motion of the stars in each tile since it was last counted, px, (tiles, tiles).

        It is taken over the corners, the centres of the sides and the centre of a tile; a star that has left the field
        counts as moved.
        """
        moved = np.full((_TILES, _TILES), np.inf)
        for j in range(3):
            for i in range(3):
                points = self._points[j : j + 2 * _TILES - 1 : 2, i : i + 2 * _TILES - 1 : 2]
                vectors = self.camera.unproject(points.reshape(-1, 2)).reshape(_TILES, _TILES, 3)
                # The attitude now times the transpose of the earlier one takes directions of then to directions of now.
                turned = np.einsum("ij,yxkj,yxk->yxi", matrix, self._seen, vectors)
                now = self.camera.project(turned.reshape(-1, 3)).reshape(points.shape)
                shift = np.hypot(*np.moveaxis(now - points, 2, 0))
                moved = np.minimum(moved, np.where(np.isfinite(shift), shift, np.inf))
        return moved
