"""Input and output of a search, as kernels take it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker.core import FloatArray
from startracker.identification.bayes_factor import CountTable


class Stars(NamedTuple):
    """Observed stars as kernels take them: vectors (N, 3), focal slopes (N, 3), sigma (N,) rad, magnitude (N,), the
    probabilities of their number, and how much denser than evenly they are spread (`clustering_null`)."""

    vectors: FloatArray
    slopes: FloatArray
    sigma: FloatArray
    magnitude: FloatArray
    counts: CountTable
    excess: FloatArray


class Pairs(NamedTuple):
    """Guide pairs by ascending separation, rad."""

    first: NDArray[np.int32]
    second: NDArray[np.int32]
    separation: NDArray[np.float32]


class Guides(NamedTuple):
    """Guide stars: unit vectors (G, 3), V (G,)."""

    directions: FloatArray
    v_mag: FloatArray


class Limits(NamedTuple):
    """Limits of a search.

    Parameters
    ----------
    scale : float
        Multiple of the stated errors.
    focal_range : float
        Largest relative error of the focal length; 0: known.
    magnitude_tolerance : float
        Between the brightness differences of two stars observed and catalogued.
    chance : float
        Largest probability that a false candidate is verified.
    work : float
        Operations after which it ends.
    prior : (3, 3)
        Attitude known a priori.
    prior_cosine : float
        Of the largest angle between a guide star and its position by the prior; −2: no prior.
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
        The two observed stars, their guide stars, and the observed star that confirms nothing as it made the candidate,
        or −1.
    focal : (K,)
        ln of the focal length's factor, observed over assumed.
    """

    stars: NDArray[np.int32]
    focal: FloatArray
