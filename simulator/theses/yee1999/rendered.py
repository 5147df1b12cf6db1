"""Frames that replace the pictures of the thesis: rendered, detected by its detector, and solved by its method and
ours.

The pictures themselves are not available. `Shown` is the input of both methods from a rendered frame: the clusters of
bright pixels, in the order of the thesis (most pixels first) and its coordinates.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from simulator.frame import Frame, FrameTruth
from simulator.theses.yee1999.picture import Analysis, Options, Picture, analyse, centred
from startracker.arrays import FloatArray, IntArray
from startracker.attitude import Attitude, radec_to_direction
from startracker.detection import estimate, find_clusters
from startracker.settings import DetectionSettings
from startracker.solution import Solution
from startracker.tracker import StarTracker


class Shown(NamedTuple):
    """A rendered frame and the star images found in it, most pixels first: centroids for the thesis' method, the same
    (N, 2) as columns and rows, and number of pixels (N,) of each."""

    frame: Frame
    truth: FrameTruth
    picture: Picture
    xy: FloatArray
    pixels: IntArray


def show(
    frame: Frame, truth: FrameTruth, detection: DetectionSettings, fov_deg: tuple[float, float], most: int = 12
) -> Shown:
    """Find up to a number of star images of a frame by clustering; `fov_deg` defines the scale of the thesis'
    method."""
    image = frame.image.astype(np.float32)
    background = estimate(image, detection.background_tile_px)
    spots = find_clusters(image, background, detection, frame.saturation_dn)
    order = np.argsort(-spots.pixels, kind="stable")[:most]
    assert spots.centre is not None
    size = (image.shape[1], image.shape[0])
    xy = spots.centre[order]
    return Shown(frame, truth, Picture(centred(xy, size, "corner"), size, fov_deg), xy, spots.pixels[order])


def off_deg(truth: Attitude, center_deg: FloatArray) -> float:
    """Angle between the true boresight and a centre (right ascension, declination), degrees."""
    direction = radec_to_direction(*np.radians(center_deg))
    across = float(np.linalg.norm(np.cross(direction, truth.boresight)))
    return math.degrees(math.atan2(across, float(direction @ truth.boresight)))


class SolvedFrame(NamedTuple):
    """A rendered frame, by its number from 1, solved by the thesis' method and by the star tracker."""

    image: int
    shown: Shown
    analysis: Analysis
    solution: Solution

    @property
    def hers_off_deg(self) -> float:
        """Distance of the centre of the thesis' method from the true boresight; NaN without a centre."""
        plate = self.analysis.plate
        return math.nan if plate is None else off_deg(self.shown.truth.attitude, plate.center_deg)

    @property
    def ours_off_deg(self) -> float:
        """The same for the tracker."""
        return tracker_off_deg(self.shown.truth.attitude, self.solution)

    @property
    def off_deg(self) -> tuple[float, float]:
        """Both."""
        return self.hers_off_deg, self.ours_off_deg


def solve_shown(image: int, shown: Shown, options: Options, tracker: StarTracker) -> SolvedFrame:
    """Solve a frame by both methods, the tracker from its pixels."""
    frame = shown.frame
    solution = tracker.solve(
        frame.image, observer=frame.observer, saturation_dn=frame.saturation_dn, gain_e_per_dn=frame.gain_e_per_dn
    )
    return SolvedFrame(image, shown, analyse(shown.picture, options), solution)


def tracker_off_deg(truth: Attitude, solution: Solution) -> float:
    """Angle between the true boresight and a solution's, degrees; NaN if it is not solved."""
    return off_deg(truth, np.array([solution.ra_deg, solution.dec_deg])) if solution.solved else math.nan
