"""From light to charge: what happens in a pixel while the shutter is open. Each step works in place."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simulator.detector.poisson import draw_poisson


def photo_response(mean_e: NDArray[np.float64], prnu: NDArray[np.float64] | float) -> NDArray[np.float64]:
    """Mean photo-electrons of pixels that do not respond alike: mean × relative response, (H, W) electrons.

    The non-uniformity acts on the mean, before the shot noise: it changes how many photons are detected, and the
    detected ones stay Poisson-distributed (Janesick 2007, *Photon Transfer*).
    """
    mean_e *= prnu
    return mean_e


def dark_signal(mean_e: NDArray[np.float64], dark_e: NDArray[np.float64] | float) -> NDArray[np.float64]:
    """Mean electrons of light and dark current together, (H, W) electrons."""
    mean_e += dark_e
    return mean_e


def shot_noise(mean_e: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    """Electrons collected: Poisson numbers of the means, (H, W), whole numbers.

    Photo-electrons and dark electrons are independent Poisson numbers, so that one draw of their summed mean has
    exactly the distribution of their sum. Raises `InputError` for a mean below zero or not a number.
    """
    return draw_poisson(mean_e, rng, in_place=True)
