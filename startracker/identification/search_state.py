"""Input and output of a search, in the form that kernels read."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker.core import FloatArray
from startracker.identification.bayes_factor import CountTable


class Stars(NamedTuple):
    """Observed stars in the form that kernels read.

    Vectors (N, 3), focal slopes (N, 3), sigma (N,), rad, magnitude (N,), the probabilities of their number, and their
    excess density (`clustering_null`).
    """

    vectors: FloatArray
    slopes: FloatArray
    sigma: FloatArray
    magnitude: FloatArray
    counts: CountTable
    excess: FloatArray


class Pairs(NamedTuple):
    """Guide pairs in ascending order of separation, rad."""

    first: NDArray[np.int32]
    second: NDArray[np.int32]
    separation: NDArray[np.float32]


class Guides(NamedTuple):
    """Guide stars: unit vectors (G, 3) and V magnitudes (G,)."""

    directions: FloatArray
    v_mag: FloatArray


class Limits(NamedTuple):
    """Limits of a search.

    Parameters
    ----------
    scale : float
        Multiple of the stated errors.
    focal_range : float
        Largest relative error of the focal length; 0 if it is known.
    magnitude_tolerance : float
        Largest difference between the brightness differences of two stars, observed and catalogued, mag.
    chance : float
        Largest probability that a false candidate is verified.
    work : float
        Number of operations after which the search ends.
    prior : (3, 3)
        A priori attitude.
    prior_cosine : float
        Cosine of the largest angle between a guide star and its position from the prior; −2 if there is no prior.
    """

    scale: float
    focal_range: float
    magnitude_tolerance: float
    chance: float
    work: float
    prior: FloatArray
    prior_cosine: float


class Candidates(NamedTuple):
    """Pairs of observed stars with the guide stars that they may be.

    Parameters
    ----------
    stars : int32 (K, 5)
        The two observed stars, their guide stars, and a third observed star that cannot confirm the candidate, because
        the candidate was derived from it; −1 if there is none.
    focal : (K,)
        ln of the ratio of the observed to the assumed focal length.
    """

    stars: NDArray[np.int32]
    focal: FloatArray
