"""From light to charge: what happens in a pixel while the shutter is open. Kernels work in place on runs of pixels;
counting the electrons is in `poisson.py`."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from simulator.detector.few import outside

FloatArray = NDArray[np.float64]

_FINITE = np.finfo(np.float64).max


@numba.njit(cache=True, error_model="numpy")
def is_light(mean_e: FloatArray) -> bool:
    """Whether all of the means (N,) are numbers, finite and not negative."""
    return bool(outside(mean_e, 0.0, _FINITE) == 0)


@numba.njit(cache=True, error_model="numpy")
def photo_response(mean_e: FloatArray, response: float, responses: FloatArray) -> None:
    """Mean photo-electrons (N,) of pixels that do not respond alike: mean × relative response.

    The non-uniformity acts on the mean, before the shot noise: it changes how many photons are detected, and the
    detected ones stay Poisson-distributed (Janesick 2007, *Photon Transfer*). `responses` (N,) has that of each pixel;
    where it is empty, `response` is that of all.
    """
    if responses.size == 0:
        for i in range(mean_e.size):
            mean_e[i] *= response
    else:
        for i in range(mean_e.size):
            mean_e[i] *= responses[i]


@numba.njit(cache=True, error_model="numpy")
def dark_signal(mean_e: FloatArray, dark_e: float, darks_e: FloatArray) -> None:
    """Mean electrons (N,) of light and dark current together; `darks_e` (N,), or where it is empty `dark_e` for all.

    Photo-electrons and dark electrons are independent Poisson numbers, so that one draw of their summed mean has
    exactly the distribution of their sum.
    """
    if darks_e.size == 0:
        for i in range(mean_e.size):
            mean_e[i] += dark_e
    else:
        for i in range(mean_e.size):
            mean_e[i] += darks_e[i]


@numba.njit(cache=True, error_model="numpy")
def clip(electrons: FloatArray, full_well_e: float) -> None:
    """Charge (N,) that pixels hold, electrons, where a drain takes all above the full well."""
    for i in range(electrons.size):
        electrons[i] = min(electrons[i], full_well_e)
