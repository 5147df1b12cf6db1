"""Null hypothesis of clustered points: how much denser than uniformly distributed the observed points are.

A cluster of points fits an open cluster of stars far more easily than points all over the image do: if the two clusters
coincide, each point has many neighbours to agree with. Under the null hypothesis of uniformly distributed points
(`bayes_factor`) this looks like evidence. So the density of the points themselves is a second null hypothesis: point i
has the density of the other points at its position, 0.9 q(xᵢ) + 0.1/A with

    q(xᵢ) = 1/(n − 1) Σ_{j ≠ i} 1/(π h²) (1 + d²ᵢⱼ/h²)⁻²

for each width h, and for the mean over the widths. Let B_m be the Bayes factor against null hypothesis m. The least of
all B_m is used, because whichever m is true, P(min B ≥ t) ≤ P(B_m ≥ t) ≤ 1/t.

Source of the leave-one-out density: Silverman 1986, Density Estimation for Statistics and Data Analysis, section 3.4.2.
The kernel is the bivariate t distribution with two degrees of freedom; its tails allow one width for clumps of many.
"""

from __future__ import annotations

import math

import numpy as np

from startracker._compiled import kernel, kernel_part
from startracker.core import FloatArray, IntArray

WIDTHS = 8
"""Number of widths, each half of the one before; the first is the points' rms distance from their mean."""
_EVEN = 0.1
"""Share of the points that are uniformly distributed."""


@kernel
def log_excess_density(points: FloatArray, area: float) -> FloatArray:
    """ln of the density of the other points at each point, times the area: above 0 where the points are crowded.

    Parameters
    ----------
    points : (N, D)
        Pixels, or unit vectors (distances are then chords).
    area : float
        Area of the image, in the unit of the points squared.

    Returns
    -------
    (WIDTHS + 1, N)
        One row for each width; the last is that of the mean over the widths.
    """
    n = len(points)
    out = np.zeros((WIDTHS + 1, n))
    if n < 2:
        return out
    extent2 = 0.0
    for axis in range(points.shape[1]):
        mean, square = 0.0, 0.0
        for i in range(n):
            mean += points[i, axis]
        mean /= n
        for i in range(n):
            square += (points[i, axis] - mean) ** 2
        extent2 += square / n
    if not extent2 > 0.0:
        return out
    h2 = np.empty(WIDTHS)
    for width in range(WIDTHS):
        h2[width] = extent2 / 4.0**width
    sums = np.zeros((n, WIDTHS))  # the widths side by side, several at a time
    for i in range(n):
        for j in range(i):
            d2 = 0.0
            for axis in range(points.shape[1]):
                d2 += (points[i, axis] - points[j, axis]) ** 2
            for width in range(WIDTHS):
                # The kernel (1 + d²/h²)⁻² / h², written with one division.
                value = h2[width] / ((h2[width] + d2) * (h2[width] + d2))
                sums[i, width] += value
                sums[j, width] += value
    scale = (1.0 - _EVEN) * area / (math.pi * (n - 1))
    for i in range(n):
        total = 0.0
        for width in range(WIDTHS):
            total += sums[i, width]
            out[width, i] = math.log(scale * sums[i, width] + _EVEN)
        out[WIDTHS, i] = math.log(scale * total / WIDTHS + _EVEN)
    return out


@kernel_part
def clustering_price(excess: FloatArray, matched: IntArray) -> float:
    """Difference of ln B from the null hypothesis of uniform points to the one that explains the matched points best.

    It is 0 or positive.

    Parameters
    ----------
    excess : (WIDTHS + 1, N)
        From `log_excess_density`.
    matched : (N,)
        Guide star of each point, or −1.
    """
    price = 0.0
    for model in range(len(excess)):
        total = 0.0
        for i in range(len(matched)):
            if matched[i] >= 0:
                total += excess[model, i]
        price = max(price, total)
    return price
