"""The null hypothesis of clustered points: how much denser than evenly spread the observed points are.

A cluster of points fits an open cluster of stars far more easily than points spread over the whole image do: with one
cluster on the other each point has many neighbours to agree with. Under the null hypothesis of evenly spread points
(`bayes_factor`) that looks like evidence. So the points' own density is a second null hypothesis: point i has the
density of the others there, 0.9 q(xᵢ) + 0.1/A with

    q(xᵢ) = 1/(n − 1) Σ_{j ≠ i} 1/(π h²) (1 + d²ᵢⱼ/h²)⁻²

for each width h, and for the mean over the widths. With B_m the Bayes factor against the null hypothesis m the least of
all B_m is taken: whichever m holds, P(min B ≥ t) ≤ P(B_m ≥ t) ≤ 1/t.

Source of the leave-one-out density: Silverman 1986, Density Estimation for Statistics and Data Analysis, section 3.4.2;
the kernel is the bivariate t distribution with two degrees of freedom, whose tails let one width serve clumps of many.
"""

from __future__ import annotations

import math

import numpy as np

from startracker.core import FloatArray, IntArray
from startracker.kernels import kernel_part

WIDTHS = 8
"""Each half of the one before, the first being the points' root mean square distance from their middle."""
_EVEN = 0.1
"""Share of the points that lie anywhere."""


@kernel_part
def log_excess_density(points: FloatArray, area: float) -> FloatArray:
    """ln of the density of the other points at each point, times the area: above 0 where the points are crowded.

    Parameters
    ----------
    points : (N, D)
        Pixels, or unit vectors; distances are chords.
    area : float
        Of the image, in the unit of the points squared.

    Returns
    -------
    (WIDTHS + 1, N)
        One row a width; the last is that of the mean over the widths.
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
    """By how much ln B of a match is less under the null hypothesis that explains the matched points best; 0 or more.

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
