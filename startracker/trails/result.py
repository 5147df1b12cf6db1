"""What is known of the trails of a frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from startracker.centroid.result import Centroids
from startracker.core import FloatArray
from startracker.display import fields_repr


@dataclass(frozen=True, eq=False)
class Trails:
    """Stars trailed along the motion of the frame.

    Parameters
    ----------
    centroids : Centroids
        Middles of the trails, where the stars stood in the middle of the exposure; brightest first.
    motion : (3,)
        (a, b, c): during the exposure what is at (x, y) from the image's middle moved by (a − c y, b + c x), pixels;
        forwards or backwards is not known.
    lengths : (N, 2)
        Of the trails along x and y, px.
    fitted_alone : bool (N,)
        Whether a trail's length and direction were fitted to itself, not taken from the motion.
    """

    centroids: Centroids
    motion: FloatArray
    lengths: FloatArray
    fitted_alone: NDArray[np.bool_]

    __repr__ = fields_repr
