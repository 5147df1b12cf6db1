"""Map of defective pixels from successive frames: what stays bright or dark while the sky moves."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker.arguments import of_kind, real_array, real_number, whole_number
from startracker.core import FloatArray
from startracker.detection.bad_pixels import BadPixelCount, as_mask
from startracker.geometry.attitude import Attitude, camera_attitude
from startracker.geometry.camera import Camera

BoolImage = NDArray[np.bool_]

_TILES = 16
"""Tiles along each side of the image, in each of which the motion of the sky is determined."""
_STAR_PX = 3
"""Distance from a known star within which pixels are not tested."""


class DefectMap:
    """Counts defective pixels in frames between which the sky has moved.

    A pixel is only counted if the stars at its position have moved by `shift_px` since it was last counted: a star that
    stays on a pixel, or near the axis about which the camera rotates, is no defect.

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
        self._points = np.stack(np.meshgrid(x, y), axis=2)
        self._seen = np.zeros((_TILES, _TILES, 3, 3))
        """Attitude at which each tile was last counted."""
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
        """Least motion of stars in each tile since it was last counted, over its corners, edges and centre; a star that
        has left the field has moved."""
        moved = np.full((_TILES, _TILES), np.inf)
        for j in range(3):
            for i in range(3):
                points = self._points[j : j + 2 * _TILES - 1 : 2, i : i + 2 * _TILES - 1 : 2]
                vectors = self.camera.unproject(points.reshape(-1, 2)).reshape(_TILES, _TILES, 3)
                turned = np.einsum("ij,yxkj,yxk->yxi", matrix, self._seen, vectors)
                now = self.camera.project(turned.reshape(-1, 3)).reshape(points.shape)
                shift = np.hypot(*np.moveaxis(now - points, 2, 0))
                moved = np.minimum(moved, np.where(np.isfinite(shift), shift, np.inf))
        return moved
