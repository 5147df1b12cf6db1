"""From light to charge: what happens in a pixel while the shutter is open. Kernels work on runs of pixels; counting the
electrons is in `poisson.py`."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from simulator.detector.few import outside
from simulator.detector.steps import Collection

FloatArray = NDArray[np.float64]

_FINITE = np.finfo(np.float64).max


@numba.njit(cache=True, error_model="numpy")
def collect(mean_e: FloatArray, signal: FloatArray, how: Collection, first: int) -> bool:
    """Mean electrons of the pixels first, first + 1, …: light × response + dark signal; False where light cannot be.

    The non-uniformity of the response acts on the mean, before the shot noise: it changes how many photons are
    detected, and the detected ones stay Poisson-distributed (Janesick 2007, *Photon Transfer*). Photo-electrons and
    dark electrons are independent Poisson numbers, so that one draw of their summed mean has exactly the distribution
    of their sum.

    Parameters
    ----------
    mean_e : (N,) float64
        Takes them.
    signal : (N,) float64
        Light, finite and not negative, or any other signal where `how` does not say that it is light.
    how : Collection
        Response and dark signal of the image's pixels.
    first : int
        Number of the first pixel.
    """
    n = mean_e.size
    responses, darks_e = how.responses[first : first + n], how.darks_e[first : first + n]
    # the image and the maps lie in slow memory, and come at once sooner than one after the other
    if responses.size > 0 and darks_e.size > 0:
        for i in range(n):
            mean_e[i] = signal[i] * responses[i] + darks_e[i]
    elif responses.size > 0:
        for i in range(n):
            mean_e[i] = signal[i] * responses[i] + how.dark_e
    elif darks_e.size > 0:
        for i in range(n):
            mean_e[i] = signal[i] * how.response + darks_e[i]
    else:
        for i in range(n):
            mean_e[i] = signal[i] * how.response + how.dark_e
    return bool(not how.light or outside(signal, 0.0, _FINITE) == 0)


@numba.njit(cache=True, error_model="numpy")
def clip(electrons: FloatArray, full_well_e: float) -> None:
    """Charge (N,) that pixels hold, electrons, where a drain takes all above the full well."""
    for i in range(electrons.size):
        electrons[i] = min(electrons[i], full_well_e)
