"""Frames that stand in for the thesis' pictures: rendered, found with its detector, put into its method and ours.

The pictures themselves are not to be had. `Shown` is what both methods see of a rendered frame: the clusters of bright
pixels, in the thesis' order (the most pixels first) and its coordinates.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulator.frame import Frame, FrameTruth
from simulator.theses.yee1999.picture import Analysis, Picture, centred, plain_number
from startracker.attitude import Attitude, radec_to_direction
from startracker.detection import estimate, find_clusters
from startracker.settings import DetectionSettings

__all__ = ["Shown", "misplaced", "off_deg", "show"]

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Shown:
    """A rendered frame and the star images found in it.

    Parameters
    ----------
    frame : Frame
        The image.
    truth : FrameTruth
        Where the camera looked.
    picture : Picture
        Centroids for the thesis' method, most pixels first.
    xy : (N, 2)
        The same as columns and rows.
    pixels : int (N,)
        Pixels of each.
    """

    frame: Frame
    truth: FrameTruth
    picture: Picture
    xy: FloatArray
    pixels: NDArray[np.int64]


def show(
    frame: Frame, truth: FrameTruth, detection: DetectionSettings, fov_deg: tuple[float, float], most: int = 12
) -> Shown:
    """Find the star images of a frame by clustering.

    Parameters
    ----------
    frame, truth : Frame, FrameTruth
        From the renderer.
    detection : DetectionSettings
        τ, threshold, fewest pixels.
    fov_deg : (float, float)
        Field that the thesis' method takes for its scale.
    most : int
        Star images given to the methods.
    """
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


def misplaced(analysis: Analysis, shown: Shown, radius_px: float) -> int:
    """Image stars that were given a catalogue star which the camera truly saw elsewhere, beyond a radius."""
    found = [(star, number) for star, number in enumerate(analysis.matches) if number is not None]
    if not found:
        return 0
    places = analysis.catalog.places([plain_number(number) for _, number in found])
    directions = radec_to_direction(*np.radians(analysis.catalog.sky_deg[places]).T)
    true_xy = shown.frame.camera.project(shown.truth.attitude.apply(directions))
    far = np.hypot(*(true_xy - shown.xy[[star for star, _ in found]]).T)
    return int(np.count_nonzero(~(far <= radius_px)))
