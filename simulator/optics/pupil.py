"""Fraunhofer diffraction: from the wavefront in the pupil to the intensity in the image."""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import roots_legendre

from simulator.optics.zernike import wavefront
from startracker.core import FloatArray

ComplexArray = NDArray[np.complex128]

TERMS = 11
"""Number of Zernike terms of a wavefront: Noll's 1 (piston) to 11 (spherical)."""


@functools.lru_cache(maxsize=256)
def legendre(count: int) -> tuple[FloatArray, FloatArray]:
    """Points and weights of Gauss–Legendre quadrature on −1 … 1; cached, because computing a few hundred of them takes
    as long as an image.

    SciPy finds them as eigenvalues of a tridiagonal matrix; NumPy treats it as a full one and takes 50 times as long.
    """
    nodes, weights = roots_legendre(count)
    nodes.flags.writeable = weights.flags.writeable = False
    return nodes, weights


def disk_nodes(count: int, radius: float = 1.0) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points and weights that integrate smooth functions over a disk.

    Along y Gauss–Chebyshev points of the second kind, whose weight √(1 − y²) is half the length of the chord; along
    each chord Gauss–Legendre points. Exact for polynomials, and exponentially convergent for typical wavefronts.

    Returns
    -------
    y : (count,) array
    x, weight : (count, count) arrays
        Points of each chord; their weights sum to π radius².
    """
    angle = np.pi * np.arange(1, count + 1) / (count + 1)
    y = np.cos(angle)
    nodes, weights = legendre(count)
    weight_y = np.pi / (count + 1) * np.sin(angle) ** 2  # for ∫ √(1−y²) g(y) dy
    x = np.sin(angle)[:, None] * nodes
    return radius * y, radius * x, radius**2 * weight_y[:, None] * weights


def intensity(
    coefficients: FloatArray, x: FloatArray, y: FloatArray, obscuration: float = 0.0, *, centred: bool = True
) -> FloatArray:
    """Point-spread function of an aberrated lens by Fraunhofer diffraction.

    E(x) = ∫ exp(2πi W(ρ)) exp(−iπ x·ρ) d²ρ over the pupil ε ≤ |ρ| ≤ 1, x in units of λN, and I = |E|²/(4π(1−ε²)),
    whose integral over the plane is 1 (Born & Wolf, § 9.1). A slope ∂W/∂ρ displaces light by 2 ∂W/∂ρ λN. The integral
    is a matrix Fourier transform (Soummer et al. 2007, Opt. Express 15, 15935) on Gaussian instead of equidistant
    points of the pupil, which is accurate at its round edges: errors are below 1e-9 of the peak.

    Parameters
    ----------
    coefficients : (Q, T) array
        Zernike coefficients (Noll 1 … T), waves rms, of Q wavefronts.
    x, y : (X,), (Y,) arrays
        Points along columns and rows, units of λN.
    obscuration : float
        Central obscuration, fraction of the diameter.
    centred : bool
        Shift the geometric centroid of the image to 0. Without the shift, Zernike coma displaces the centroid by 4√2 λN
        per wave rms.

    Returns
    -------
    (Q, Y, X) array
    """
    coefficients = np.atleast_2d(np.asarray(coefficients, dtype=float))
    shift = mean_slope(coefficients, obscuration) if centred else np.zeros((len(coefficients), 2))
    furthest = max(float(np.abs(x).max()), float(np.abs(y).max()), 1.0)
    reach = furthest + geometric_radius(coefficients) + 2.0 * float(np.abs(shift).max())
    field = _field(coefficients, shift, x, y, 1.0, reach)
    if obscuration > 0.0:  # the amplitude of an annulus is that of the full disk minus that of the obscuration
        field -= _field(coefficients, shift, x, y, obscuration, reach)
    return np.asarray((field.real**2 + field.imag**2) / (4.0 * math.pi * (1.0 - obscuration**2)))


def mean_slope(coefficients: FloatArray, obscuration: float = 0.0) -> FloatArray:
    """Mean of ∂W/∂ρ over the pupil (waves), (Q, 2): half the position of the centroid in λN."""
    # Mean over an annulus: that of the disk minus that of the hole, weighted by their areas.
    low, high = _mean_slope(coefficients, obscuration), _mean_slope(coefficients, 1.0)
    if obscuration == 0.0:
        return high
    return np.asarray((high - obscuration**2 * low) / (1.0 - obscuration**2))


def geometric_radius(coefficients: FloatArray) -> float:
    """Radius of the geometric image about the position of an ideal image, in λN: the largest 2 |∂W/∂ρ|."""
    y, x, _ = disk_nodes(24)
    slopes = _slopes(np.atleast_2d(coefficients), x.ravel(), np.repeat(y, 24))
    return float(2.0 * np.hypot(*slopes).max(initial=0.0))


def _mean_slope(coefficients: FloatArray, radius: float) -> FloatArray:
    if radius == 0.0:
        return np.zeros((len(coefficients), 2))
    y, x, weight = disk_nodes(12, radius)
    slopes = _slopes(coefficients, x.ravel(), np.repeat(y, 12))
    return np.stack([slope @ weight.ravel() for slope in slopes], axis=1) / (math.pi * radius**2)


def _slopes(coefficients: FloatArray, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """∂W/∂x, ∂W/∂y by central differences, accurate to 1e-9 of W for these polynomials of fourth degree."""
    step = 1e-4
    return (
        (wavefront(coefficients, x + step, y) - wavefront(coefficients, x - step, y)) / (2 * step),
        (wavefront(coefficients, x, y + step) - wavefront(coefficients, x, y - step)) / (2 * step),
    )


def _field(
    coefficients: FloatArray, shift: FloatArray, x: FloatArray, y: FloatArray, radius: float, reach: float
) -> ComplexArray:
    """Amplitude (Q, Y, X) of a disk of the pupil.

    The four pupil points ±x on the chords ±y have the same cosines and sines, as have the points ±x of the image; each
    is computed once.
    """
    half = math.ceil(math.pi * reach * radius / 4.0) + 12  # points for half of the phase range, and a margin
    count = 2 * half
    node_y, node_x, weight = disk_nodes(count, radius)
    flat_y = np.repeat(node_y, count)
    waves = wavefront(coefficients, node_x.ravel(), flat_y) - shift @ np.stack([node_x.ravel(), flat_y])
    pupil = (weight.ravel() * np.exp(2j * math.pi * waves)).reshape(-1, count, count)
    # The parts of the pupil that are even and odd in x go with cosines and sines.
    right, left = pupil[..., half:], pupil[..., half - 1 :: -1]
    even, odd = _pairs(right + left), _pairs(right - left)
    mirrored = len(x) > 1 and np.array_equal(x, -x[::-1])
    some_x = x[len(x) // 2 :] if mirrored else x
    cosines = np.empty((half, even.shape[1], len(some_x)))
    sines = np.empty_like(cosines)
    for chord in range(half):  # one chord at a time, because the tables of all would take hundreds of MB
        table = _phasors(node_x[chord, half:], some_x)
        np.matmul(even[chord], table.real, out=cosines[chord])
        np.matmul(odd[chord], table.imag, out=sines[chord])  # the phase is −πx·ρ, hence the sign below
    symmetric, antisymmetric = _unpaired(cosines), _unpaired(sines)
    chords = symmetric + 1j * antisymmetric  # (Q, chord, X)
    if mirrored:
        opposite = (symmetric - 1j * antisymmetric)[..., ::-1]
        chords = np.concatenate([opposite[..., : len(x) // 2], chords], axis=-1)
    along_y = np.exp(-1j * math.pi * np.outer(y, node_y))
    return np.asarray(np.matmul(along_y, chords))


def _pairs(light: ComplexArray) -> FloatArray:
    """(Q, chord, point) → (chord of y > 0, 4Q, point): real and imaginary parts of the chords at ±y."""
    half = light.shape[1] // 2
    both = np.concatenate([light[:, :half], light[:, : half - 1 : -1]])
    return np.ascontiguousarray(np.concatenate([both.real, both.imag]).transpose(1, 0, 2))


def _unpaired(parts: FloatArray) -> ComplexArray:
    """The inverse of `_pairs` for results: (chord of y > 0, 4Q, X) → (Q, chord, X), complex."""
    real, imaginary = np.split(parts.transpose(1, 0, 2), 2)
    above, below = np.split(real + 1j * imaginary, 2)
    return np.concatenate([above, below[:, ::-1]], axis=1)


def _phasors(nodes: FloatArray, x: FloatArray) -> ComplexArray:
    """exp(−iπ nodes x), (..., X)."""
    # On a uniform grid, exp(i(a + b)) = exp(ia) exp(ib) gives the table as a product of two short ones, which is ten
    # times as fast as the exponentials.
    block = 16
    steps = np.diff(x)
    if len(x) <= 2 * block or float(np.ptp(steps)) > 1e-12 * float(np.abs(x).max()):
        return np.asarray(np.exp(-1j * math.pi * nodes[..., None] * x))
    coarse = np.exp(-1j * math.pi * nodes[..., None] * x[::block])
    fine = np.exp(-1j * math.pi * nodes[..., None] * (np.arange(block) * steps.mean()))
    table = coarse[..., :, None] * fine[..., None, :]
    return np.asarray(table.reshape(*nodes.shape, -1)[..., : len(x)])
