"""Controlled scans: the attitudes of successive frames move every star by the same fraction of a pixel.

A scan has constant steps (`STEP_PX`) of about a pixel, so that stars sample many pixels and all positions within a
pixel, and errors with the period of a pixel are not aliased to low spatial frequencies.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from startracker.attitude import Attitude

__all__ = ["STEP_PX", "ScanGeometry", "scan_attitudes", "scan_geometry"]

FloatArray = NDArray[np.float64]

STEP_PX = (1.184, 0.294)
"""Motion of the stars per frame along columns and rows, pixels. Of the harmonics of the pixel period, which such steps
alias to lower frequencies, the first two of either axis are at least 0.18 cycles per frame from zero, and the third and
fourth 0.12: above the cut-off, which is 0.076."""

CUT_PERIOD_PX = 16.0
"""Period that separates the spatial classes: "a few pixels" in ECSS-E-ST-60-20C Rev.1, 3.2.8.3, where the supplier
states it."""

PERIODS_PER_SCAN = 3.4
"""Length of a scan in such periods."""

LARGEST_SHARE = 0.4
"""Maximum length of a scan as a fraction of the shorter side of the detector, so that stars remain in the field."""


@dataclass(frozen=True)
class ScanGeometry:
    """A scan in pixels."""

    frames: int
    """Number of frames."""
    cut_period_px: float
    """Period that separates the FOV spatial error (longer) from the pixel spatial error (shorter)."""

    @property
    def step_px(self) -> float:
        """Length of a step."""
        return math.hypot(*STEP_PX)

    @property
    def length_px(self) -> float:
        """Length of the scan."""
        return self.frames * self.step_px


def scan_geometry(width: int, height: int) -> ScanGeometry:
    """Scan for a detector of `width` × `height` pixels."""
    length_px = min(PERIODS_PER_SCAN * CUT_PERIOD_PX, LARGEST_SHARE * min(width, height))
    frames = max(math.ceil(length_px / math.hypot(*STEP_PX)), 16)
    return ScanGeometry(frames, length_px / PERIODS_PER_SCAN)


def scan_attitudes(centre: Attitude, geometry: ScanGeometry, pixel_rad: tuple[float, float]) -> list[Attitude]:
    """Attitudes of a scan, about that of its middle.

    Parameters
    ----------
    centre : Attitude
        ICRS to camera.
    geometry : ScanGeometry
        Length of the scan.
    pixel_rad : (float, float)
        Angles of a pixel along columns and rows.
    """
    # a rotation of the camera by +θ about y moves the stars by −θ along x, about x by +θ along y
    step = np.array([STEP_PX[1] * pixel_rad[1], -STEP_PX[0] * pixel_rad[0], 0.0])
    offsets = np.arange(geometry.frames) - 0.5 * (geometry.frames - 1)
    return [Attitude.from_rotation_vector(k * step, "camera", "camera") @ centre for k in offsets]
