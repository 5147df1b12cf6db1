"""Display and collimator: between display pixels and the directions that a tracker behind the collimator sees.

Seen through its collimator a display is at infinity, and its pixels are directions as those of a camera are: the
collimator's focal length over the pixel pitch is the focal length in pixels. A display that is not perpendicular to
the axis is a tilted image plane (OpenCV's ``tauX`` and ``tauY``: the distorted ray meets the tilted plane).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from startracker.arguments import of_kind, pair, real_array, real_number, whole_number
from startracker.core import FloatArray
from startracker.errors import InputError
from startracker.geometry.camera import Camera


@dataclass(frozen=True)
class DisplayGeometry:
    """Map between display pixels and directions in the collimator's frame.

    Axes of that frame as the tracker sees the display: +z towards the display along the optical axis, +x along
    increasing columns (against them for a mirrored display, parity −1), +y along increasing rows.

    Parameters
    ----------
    collimator : Camera
        Display and collimator as a pinhole camera: focal length over pitch, principal point (where the optical axis
        meets the display) and size in display pixels, the collimator's distortion.
    tilt_deg : tuple of float
        Rotation of the display's plane about x and y, degrees, in the sense of OpenCV's ``tauX`` and ``tauY``; below
        45°.

    Raises
    ------
    InputError
        For a fisheye, or a tilt out of range.
    """

    collimator: Camera
    tilt_deg: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        of_kind("collimator", self.collimator, Camera)
        object.__setattr__(self, "tilt_deg", pair("tilt_deg", self.tilt_deg))
        if self.collimator.projection != "pinhole":
            raise InputError("a collimator is a pinhole; projection must be pinhole")
        if not all(math.isfinite(tilt) and abs(tilt) < 45.0 for tilt in self.tilt_deg):
            raise InputError(f"the tilt of a display must be below 45°; got {self.tilt_deg}")

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows of the display."""
        return self.collimator.width, self.collimator.height

    @cached_property
    def _plane(self) -> FloatArray:
        """Homography (3, 3) from display pixels without tilt to those with it."""
        one, two = np.radians(self.tilt_deg)
        about_x = np.array([[1, 0, 0], [0, np.cos(one), np.sin(one)], [0, -np.sin(one), np.cos(one)]])
        about_y = np.array([[np.cos(two), 0, -np.sin(two)], [0, 1, 0], [np.sin(two), 0, np.cos(two)]])
        turn = about_y @ about_x
        onto = np.array([[turn[2, 2], 0, -turn[0, 2]], [0, turn[2, 2], -turn[1, 2]], [0, 0, 1]])
        c = self.collimator
        scale = np.array([[c.parity * c.fx, 0, c.cx], [0, c.fy, c.cy], [0, 0, 1]])
        return np.asarray(scale @ onto @ turn @ np.linalg.inv(scale))

    def to_pixels(self, directions: ArrayLike) -> FloatArray:
        """Display pixels (N, 2) of directions (N, 3) in the collimator's frame; NaN behind the lens.

        Pixels outside the display are given as they are.
        """
        return _mapped(self._plane, self.collimator.project(directions))

    def to_directions(self, pixels: ArrayLike) -> FloatArray:
        """Unit vectors (N, 3) in the collimator's frame of display pixels (N, 2): inverse of `to_pixels`."""
        xy = np.atleast_2d(real_array("pixels", pixels, finite=False))
        if xy.ndim != 2 or xy.shape[1] != 2:
            raise InputError(f"pixels must have the shape (N, 2); got {xy.shape}")
        return self.collimator.unproject(_mapped(np.linalg.inv(self._plane).astype(float), xy))


def _mapped(homography: FloatArray, xy: FloatArray) -> FloatArray:
    out = xy @ homography[:2, :2].T + homography[:2, 2]
    return np.asarray(out / (xy @ homography[2, :2] + homography[2, 2])[:, None])


def nominal_geometry(size: tuple[int, int], pitch_um: float, focal_mm: float) -> DisplayGeometry:
    """Geometry by the data sheets: centred, perpendicular, without distortion.

    Raises
    ------
    InputError
        For a pitch or a focal length that is not positive.
    """
    width, height = (whole_number("size", side, least=1) for side in pair("size", size))
    pitch_um, focal_mm = real_number("pitch_um", pitch_um), real_number("focal_mm", focal_mm)
    if not (pitch_um > 0 and focal_mm > 0 and math.isfinite(focal_mm / pitch_um)):
        raise InputError(f"pitch and focal length must be positive; got {pitch_um:g} µm and {focal_mm:g} mm")
    focal = 1e3 * focal_mm / pitch_um
    return DisplayGeometry(Camera(focal, focal, (width - 1) / 2, (height - 1) / 2, width, height))


def with_parity(geometry: DisplayGeometry, parity: int) -> DisplayGeometry:
    """The geometry of a display seen directly (+1) or in a mirror (−1)."""
    return replace(geometry, collimator=replace(geometry.collimator, parity=parity))
