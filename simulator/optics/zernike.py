"""Zernike polynomials on the unit disk in Noll's order, with the names of the classical aberrations."""

from __future__ import annotations

import math

import numpy as np

from startracker.core import FloatArray

NOLL = {
    "defocus": 4,
    "astigmatism_oblique": 5,
    "astigmatism": 6,
    "coma_y": 7,
    "coma_x": 8,
    "trefoil_y": 9,
    "trefoil_x": 10,
    "spherical": 11,
}
"""Noll's index of each name. θ is from +x (columns) to +y (rows): `astigmatism` is the cos 2θ term, `coma_x` and
`trefoil_x` the cosine terms, `astigmatism_oblique`, `coma_y` and `trefoil_y` the sine terms."""


def noll_order(index: int) -> tuple[int, int]:
    """(n, m) of Noll's index j ≥ 1; m ≥ 0 for the cosine term, m < 0 for the sine term (Noll 1976)."""
    # `rest` becomes the number of polynomials of the same n before this one.
    n = 0
    rest = index - 1
    while rest > n:
        n += 1
        rest -= n
    m = (n % 2) + 2 * ((rest + (n + 1) % 2) // 2)
    return n, m if index % 2 == 0 else -m


def zernike(index: int, x: FloatArray, y: FloatArray) -> FloatArray:
    """Zernike polynomial of Noll's index at points of the pupil.

    Z = √(n+1) R_n^m(ρ) {√2 cos mθ (even index), √2 sin mθ (odd index), 1 (m = 0)}, whose rms over the unit disk is 1:
    a coefficient in waves is the rms of its aberration in waves. The polynomials are those of the full disk, also if
    the pupil has an obscuration.

    Parameters
    ----------
    index : int
        Noll's index, from 1.
    x, y : arrays
        Points in units of the pupil's radius.

    Notes
    -----
    Noll 1976 (JOSA 66, 207).
    """
    n, m = noll_order(index)
    order = abs(m)
    square = x * x + y * y
    radial = np.zeros_like(square)
    for k in range((n - order) // 2 + 1):
        factor = (-1) ** k * math.comb(n - k, k) * math.comb(n - 2 * k, (n - order) // 2 - k)
        radial = radial + factor * square ** ((n - order) // 2 - k)  # without ρ^m
    if m == 0:
        return np.asarray(math.sqrt(n + 1.0) * radial)
    # (x + iy)^m = ρ^m (cos mθ + i sin mθ) supplies ρ^m, which the radial part omits.
    turning = (x + 1j * y) ** order
    return np.asarray(math.sqrt(2.0 * (n + 1.0)) * radial * (turning.real if m > 0 else turning.imag))


def wavefront(coefficients: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    """Wavefront error in waves at points of the pupil.

    Parameters
    ----------
    coefficients : (..., T) array
        Coefficients of Noll's indices 1 … T, waves rms.
    x, y : (M,) arrays
        Points in units of the pupil's radius.

    Returns
    -------
    (..., M) array
    """
    coefficients = np.asarray(coefficients, dtype=float)
    terms = np.array([zernike(index + 1, x, y) for index in range(coefficients.shape[-1])])
    return np.asarray(coefficients @ terms)
