"""Controlled scans: the attitudes of successive frames move every star by the same fraction of a pixel.

A scan has constant steps (`STEP_PX`) of about a pixel, so that stars sample many pixels and all positions within a
pixel, and errors with the period of a pixel are not aliased to low spatial frequencies. It is repeated in several
passes; in those with other pixels the stars are also at other positions within the pixels (`phase_shifts_px`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from startracker.core import FloatArray
from startracker.geometry.attitude import Attitude

STEP_PX = (1.184, 0.294)
"""Motion of the stars per frame along columns and rows, pixels. Of the harmonics of the pixel period, which such steps
alias to lower frequencies, the first two of either axis are at least 0.18 cycles per frame from zero, and the third and
fourth 0.12."""

PASSES, SAME_PIXELS = 4, 2
"""Passes of a scan, and how many of them, the first, have the pixels of the device; the others have other pixels."""

PHASE_CYCLES = (16 / 45, 11 / 45)
"""Cycles per frame of the phase shifts along columns and rows, as `phase_shifts_px` rounds them. The second harmonics
of the shifted scan, whose steps are 1.540 and 0.538 pixels, are at least 0.1 cycles per frame from the first and second
ones of the unshifted scan on both axes; the first and third ones cancel."""

CUT_PERIOD_PX = 1.66
"""Period that separates FOV spatial (longer) and pixel spatial errors ("a few pixels" in ECSS-E-ST-60-20C Rev.1,
3.2.8.3, where the supplier states it). Of a repeated error of the period p the covariance with the shifted passes
retains the mean of cos 2πs/p over shifts s of −0.5 to 0.5 pixels, sinc 1/p: half of its power at this period, 90 % at
4 pixels, 99 % at 13, and nothing at the period of a pixel and its harmonics."""

LENGTH_PX = 54.0
"""Length of a scan."""

LARGEST_SHARE = 0.4
"""Maximum length of a scan as a fraction of the shorter side of the detector, so that stars remain in the field."""


@dataclass(frozen=True)
class ScanGeometry:
    """A scan in pixels."""

    frames: int
    """Number of frames."""

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
    length_px = min(LENGTH_PX, LARGEST_SHARE * min(width, height))
    return ScanGeometry(max(math.ceil(length_px / math.hypot(*STEP_PX)), 16))


def phase_shifts_px(geometry: ScanGeometry) -> FloatArray:
    """Shifts (passes, frames, 2) of the stars along columns and rows, pixels from −0.5 to 0.5.

    The first passes have none. Those with other pixels have shifts that run evenly through the pixel during the scan,
    so that the stars have no harmonic of the pixel period in common with the first passes, and differ from each other
    by half a pixel on both axes, so that harmonics of odd order cancel in their mean frame by frame.
    """
    at = np.arange(geometry.frames)[:, None]
    running = at * np.round(np.array(PHASE_CYCLES) * geometry.frames) / geometry.frames
    shifts = np.zeros((PASSES, geometry.frames, 2))
    for number in range(SAME_PIXELS, PASSES):
        shifts[number] = (running + (number - SAME_PIXELS) / (PASSES - SAME_PIXELS)) % 1.0 - 0.5
    return shifts


def scan_attitudes(centre: Attitude, geometry: ScanGeometry, pixel_rad: tuple[float, float]) -> list[list[Attitude]]:
    """Attitudes of the passes of a scan, about the attitude at its middle.

    Parameters
    ----------
    centre : Attitude
        ICRS to camera.
    geometry : ScanGeometry
        Length of the scan.
    pixel_rad : (float, float)
        Angles of a pixel along columns and rows.
    """
    along = (np.arange(geometry.frames) - 0.5 * (geometry.frames - 1))[:, None] * np.array(STEP_PX)
    # a rotation of the camera by +θ about y moves the stars by −θ along x, about x by +θ along y
    turns = (along + phase_shifts_px(geometry))[..., ::-1] * np.array([pixel_rad[1], -pixel_rad[0]])
    return [
        [Attitude.from_rotation_vector(np.array([*turn, 0.0]), "camera", "camera") @ centre for turn in of_pass]
        for of_pass in turns
    ]
