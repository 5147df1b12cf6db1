"""`centre.m` of Greyling 1995, appendix B: noise with its expression and seed, and the choice of the central pixel.

The script puts a Gaussian of I₀ = 10 on the 5 × 5 pixels around its own pixel of an 11 × 11 frame, adds noise to the
frame, takes the brightest pixel as the centre and computes the first moment of the 5 × 5 pixels around it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulator.theses.greyling1995.blur import OFFSETS, THESIS_SIGMA
from simulator.theses.greyling1995.star_images import Path, star_stamps
from startracker.centroid.bias import moment_bias
from startracker.core import FloatArray, IntArray

LISTING_SIGMA, LISTING_SEED, LISTING_PEAK = 1.325, 5, 10.0
LISTING_OFFSETS: FloatArray = np.arange(51.0) * 0.01
NOISE_MIDDLE = 0.05
"""n = A (rand − 0.05): the noise ranges from −0.05 A to 0.95 A, with a mean of 0.45 A instead of 0."""

_SIDE, _MIDDLE, _HALF = 11, 5, 2
_MODULUS, _MULTIPLIER = 2**31 - 1, 16807


def matlab_rand(seeds: ArrayLike, count: int) -> FloatArray:
    """Uniform deviates (S, count) of Matlab 4's ``rand`` after ``rand('seed', s)``, with integers s ≥ 1.

    s ← 7⁵ s mod (2³¹ − 1), the deviate is s / (2³¹ − 1): S. K. Park and K. W. Miller 1988, Comm. ACM 31, 1192.
    """
    state = np.atleast_1d(np.asarray(seeds, dtype=np.int64))
    out = np.empty((count, len(state)))
    for step in range(count):
        state = _MULTIPLIER * state % _MODULUS
        out[step] = state
    return np.ascontiguousarray(out.T) / _MODULUS


def central_pixels(frames: FloatArray) -> tuple[IntArray, IntArray]:
    """Row and column, each (N,), of the brightest pixel; of equal ones the first in column order, as with Matlab's
    ``max``."""
    columns = frames.max(axis=1).argmax(axis=1)
    return frames[np.arange(len(frames)), :, columns].argmax(axis=1), columns


def first_moments(frames: FloatArray, rows: IntArray, columns: IntArray) -> FloatArray:
    """First moments (N,) along x of the 5 × 5 pixels around given ones, relative to the centre of the frame, pixels."""
    steps = np.arange(-_HALF, _HALF + 1)
    y, x = rows[:, None, None] + steps[:, None], columns[:, None, None] + steps
    window = frames[np.arange(len(frames))[:, None, None], y, x]
    return np.asarray(columns - _MIDDLE + (window * steps).sum(axis=(1, 2)) / window.sum(axis=(1, 2)))


def noise_errors(
    snr_db: float,
    seeds: ArrayLike = LISTING_SEED,
    sigma_px: float = LISTING_SIGMA,
    offsets: FloatArray = LISTING_OFFSETS,
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Errors (S, N) along x, pixels, minus those without noise; and a mask of stars with the wrong central pixel.

    The SNR is I₀ divided by the range A of the noise; the script's factor of 0.1 is 40 dB. `seeds` (S,) are those of
    ``rand``; the noise of the stars at the `offsets` (N,) is generated in their order. Table 4.1 has a width of 1.23.
    """
    margin = _MIDDLE - _HALF
    stars = LISTING_PEAK * np.pad(star_stamps(offsets, sigma_px), ((0, 0), (margin, margin), (margin, margin)))
    clean = first_moments(stars, *central_pixels(stars))
    deviates = matlab_rand(seeds, len(offsets) * _SIDE**2).reshape(-1, len(offsets), _SIDE, _SIDE)
    noise = LISTING_PEAK * 10.0 ** (-snr_db / 20.0) * (deviates.swapaxes(2, 3) - NOISE_MIDDLE)
    errors, wrong = [], []
    for one in noise:
        rows, columns = central_pixels(stars + one)
        errors.append(clean - first_moments(stars + one, rows, columns))
        wrong.append((columns != _MIDDLE) | (rows != _MIDDLE))
    return np.array(errors), np.array(wrong)


def smeared_frames(path: Path, offsets: FloatArray, sigma_px: float) -> FloatArray:
    """Frames (N, 11, 11) of stars smeared along a path, with all of their light in the frame (eq. 4.11), peak 1 at
    rest."""
    way, weights = path
    pixels = np.arange(_SIDE) - float(_MIDDLE)
    x = np.exp(-0.5 * ((pixels - (offsets[:, None] + way[:, 0])[..., None]) / sigma_px) ** 2)
    y = np.exp(-0.5 * ((pixels - way[:, 1][:, None]) / sigma_px) ** 2)
    return np.asarray(np.einsum("k,kj,nki->nji", weights, y, x))


def smear_errors(path: Path, *, other_of_equal: bool = False) -> FloatArray:
    """Errors (11,) along x of smeared stars by the brightest pixel, minus the bias of Table 4.1 for the true offset.

    A star at half a pixel has two equal pixels for any direction of the smear, as they are symmetric about its centre.
    The left one is correct, as the offsets of Table 4.1 are measured from it. The right one (`other_of_equal`) causes
    the "spikes" of Fig. 4.12.
    """
    frames = smeared_frames(path, OFFSETS, THESIS_SIGMA)
    rows = np.full(len(frames), _MIDDLE)
    columns = np.full(len(frames), _MIDDLE)
    if other_of_equal:
        columns[np.isclose(frames[:, _MIDDLE, _MIDDLE + 1], frames[:, _MIDDLE, _MIDDLE], rtol=1e-9)] += 1
    bias = moment_bias(OFFSETS, THESIS_SIGMA, 2 * _HALF + 1, integrated=False)
    return np.asarray(OFFSETS - first_moments(frames, rows, columns) - bias)


def lower_equal_peaks(frame_dn: FloatArray, levels: int = 1) -> FloatArray:
    """A digitised frame (H, W) with a unique highest pixel: the first of equal ones in reading order.

    `levels`, 1 to 3 in section 4.3.1, are subtracted from each of the others.
    """
    out = np.array(frame_dn, dtype=float)
    peaks = np.flatnonzero(out.ravel() == out.max())
    out.ravel()[peaks[1:]] -= levels
    return out
