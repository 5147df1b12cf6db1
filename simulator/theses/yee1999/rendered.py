"""Frames that stand in for the thesis' pictures: rendered, found with its detector, put into its method and ours.

The pictures themselves are not to be had. `Shown` is what both methods see of a rendered frame: the clusters of bright
pixels, in the thesis' order (the most pixels first) and its coordinates.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from simulator.frame import Frame, FrameTruth
from simulator.theses.tables import FloatArray, IntArray
from simulator.theses.yee1999.picture import Analysis, Options, Picture, analyse, centred
from startracker.attitude import Attitude, radec_to_direction
from startracker.detection import estimate, find_clusters
from startracker.settings import DetectionSettings
from startracker.solution import Solution
from startracker.tracker import StarTracker


class Shown(NamedTuple):
    """A rendered frame and the star images found in it, most pixels first: centroids for the thesis' method, the same
    (N, 2) as columns and rows, and the pixels (N,) of each."""

    frame: Frame
    truth: FrameTruth
    picture: Picture
    xy: FloatArray
    pixels: IntArray


def show(
    frame: Frame, truth: FrameTruth, detection: DetectionSettings, fov_deg: tuple[float, float], most: int = 12
) -> Shown:
    """Find the star images of a frame by clustering, at most so many; `fov_deg` gives the thesis' method its scale."""
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
    """A rendered frame, by its number from 1, solved by the thesis' method and by the star tracker alone."""

    image: int
    shown: Shown
    analysis: Analysis
    solution: Solution

    @property
    def hers_off_deg(self) -> float:
        """Distance of her method's centre from the true boresight; NaN where it finds none."""
        plate = self.analysis.plate
        return math.nan if plate is None else off_deg(self.shown.truth.attitude, plate.center_deg)

    @property
    def ours_off_deg(self) -> float:
        """The same of the tracker."""
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
    """Angle between the true boresight and a solution's, degrees; NaN where it is not solved."""
    return off_deg(truth, np.array([solution.ra_deg, solution.dec_deg])) if solution.solved else math.nan
