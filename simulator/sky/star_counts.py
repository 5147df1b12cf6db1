"""Number of stars on the sky by magnitude, to V = 16.

The counts are from Tycho-2 and UCAC4 together over the whole sky (H. Kleijn, "Counting stars",
hnsky.com/star_count.htm). Tycho-2 is complete to V = 11; UCAC4's magnitudes are of a band between V and R, in which
stars are brighter, so that the counts of fainter stars are upper limits. Between whole magnitudes the logarithm is
interpolated.
"""

from __future__ import annotations

import math

import numpy as np

from startracker.core import FloatArray

_V = np.arange(4.0, 17.0)
_COUNT = (558, 1744, 5326, 16503, 48559, 139375, 382925, 1048084, 2955951, 7346735, 17214116, 39387795, 88896114)
_LOG_COUNT = np.log(np.array(_COUNT, dtype=float))

FAINTEST_V = float(_V[-1])
"""End of the table."""

SKY_SQUARE_DEGREES = 4.0 * math.pi / math.radians(1.0) ** 2
_STEP = 0.02


def _count(v_mag: float | FloatArray) -> FloatArray:
    return np.asarray(np.exp(np.interp(v_mag, _V, _LOG_COUNT)))


def count_between(brightest: float, faintest: float) -> float:
    """Mean number of stars with `brightest` < V ≤ `faintest` in a square degree, over the whole sky."""
    return float(_count(faintest) - _count(brightest)) / SKY_SQUARE_DEGREES


def light_between_s10(brightest: float, faintest: float) -> float:
    """Mean surface brightness of these stars over the whole sky, S10: stars of V = 10 per square degree."""
    # The integral over magnitudes is a sum over steps of 0.02 mag, each with the light of its middle.
    edges = np.linspace(brightest, faintest, max(2, math.ceil((faintest - brightest) / _STEP) + 1))
    middle = 0.5 * (edges[1:] + edges[:-1])
    return float(np.diff(_count(edges)) @ 10.0 ** (-0.4 * (middle - 10.0))) / SKY_SQUARE_DEGREES


def draw_magnitudes(share: FloatArray, brightest: float, faintest: float) -> FloatArray:
    """Magnitudes (N,) of stars between two limits, by the inverse of the cumulative counts at uniform deviates (N,)."""
    low, high = _count(brightest), _count(faintest)
    return np.asarray(np.interp(np.log(low + share * (high - low)), _LOG_COUNT, _V))
