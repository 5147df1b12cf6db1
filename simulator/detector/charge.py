"""Conversion of light to mean charge during the exposure, as kernels for runs of pixels; shot noise is in
`poisson.py`."""

from __future__ import annotations

import numpy as np

from simulator.detector.steps import Collection
from startracker._compiled import kernel_part
from startracker.core import FloatArray

_FINITE = np.finfo(np.float64).max


@kernel_part
def collect(mean_e: FloatArray, signal: FloatArray, how: Collection, exposure_s: float, first: int) -> bool:
    """Mean electrons of the pixels first, first + 1, …: light × response + dark current × exposure.

    Returns False if light is negative or not finite.

    The non-uniformity of the response acts on the mean, before the shot noise, because it changes the number of
    detected photons, which remains Poisson-distributed (Janesick 2007, *Photon Transfer*). Photo-electrons and dark
    electrons are independent Poisson variables, so one deviate with the sum of their means has exactly the distribution
    of their sum.

    Parameters
    ----------
    mean_e : (N,) float64
        Output.
    signal : (N,) float64
        Light, which must be finite and not negative; if `how.is_light` is false, any signal.
    how : Collection
        Response and dark current of the pixels.
    exposure_s : float
        Exposure time.
    first : int
        Number of the first pixel.
    """
    n = mean_e.size
    # Without a map the neutral array of one tile is used for every tile, so its offset is 0.
    at_response, at_dark = first * how.response_mapped, first * how.dark_mapped
    response, dark_e_s = how.response_map[at_response : at_response + n], how.dark_map_e_s[at_dark : at_dark + n]
    # A 32-bit count instead of a branch, which would keep the compiler from vectorising the loop.
    rejected = np.int32(0)
    for i in range(n):
        light = signal[i]
        mean_e[i] = light * (how.response * response[i]) + exposure_s * (how.dark_e_s + dark_e_s[i])
        rejected = np.int32(rejected + np.int32(not ((light >= 0.0) & (light <= _FINITE))))
    return bool(not how.is_light or rejected == 0)


@kernel_part
def clip(electrons: FloatArray, full_well_e: float) -> None:
    """Limit charge (N,), electrons, to the full well, with all of the excess drained."""
    for i in range(electrons.size):
        electrons[i] = min(electrons[i], full_well_e)
