"""From light to charge: what happens in a pixel while the shutter is open."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simulator.detector.poisson import draw_poisson


def photo_response(mean_e: NDArray[np.float64], prnu: NDArray[np.float64] | float) -> NDArray[np.float64]:
    """Mean photo-electrons of pixels that do not respond alike: mean × relative response, (H, W) electrons.

    The non-uniformity acts on the mean, before the shot noise: it changes how many photons are detected, and the
    detected ones stay Poisson-distributed (Janesick 2007, *Photon Transfer*).
    """
    return mean_e * prnu


def dark_signal(mean_e: NDArray[np.float64], dark_e: NDArray[np.float64] | float) -> NDArray[np.float64]:
    """Mean electrons of light and dark current together, (H, W) electrons."""
    return mean_e + dark_e


def shot_noise(mean_e: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    """Electrons collected: Poisson numbers of the means, (H, W), whole numbers.

    Photo-electrons and dark electrons are independent Poisson numbers, so that one draw of their summed mean has
    exactly the distribution of their sum. Raises `InputError` for a mean below zero or not a number.
    """
    return draw_poisson(mean_e, rng)


def full_well(electrons: NDArray[np.float64], full_well_e: float) -> NDArray[np.float64]:
    """Charge that a pixel holds: electrons above the full well are lost (lateral antiblooming), (H, W) electrons."""
    return np.minimum(electrons, full_well_e)
