"""Photon-transfer analysis of a detector from pairs of flats and darks (Janesick 2001; EMVA 1288).

Only digital numbers are used, as in a laboratory: flats are frames of uniform light, darks and biases are frames
without light. Two frames of one level have the same fixed pattern and independent noise. Their difference has twice the
variance of the noise, and the covariance of their pixels is the variance of the pattern. Every result has a standard
error.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from startracker.core import FloatArray
from startracker.display import fields_repr

Image = NDArray[Any]
Pair = tuple[Image, Image]

QUANTISATION_DN2 = 1.0 / 12.0
"""Variance of rounding to integer DN."""


@dataclass(frozen=True)
class Measured:
    """A value and its standard error."""

    value: float
    error: float


@dataclass(frozen=True, eq=False)
class PhotonTransfer:
    """A photon-transfer curve and the parameters of its linear part."""

    signal_dn: FloatArray
    """(L,): Mean above the bias at each level."""
    variance_dn2: FloatArray
    """(L,): Variance of the noise at each level, without the fixed pattern."""
    used: NDArray[np.bool_]
    """(L,): Whether a level is in the linear part."""
    gain_e_per_dn: Measured
    """Electrons per DN: 1 / slope."""
    read_noise_e: Measured
    """Noise of the bias pair, without the noise of rounding."""

    __repr__ = fields_repr


def pair_statistics(pair: Pair) -> tuple[Measured, Measured, Measured]:
    """Mean, variance of the noise and variance of the pattern of two frames of one level, DN and DN².

    With a the first and b the second frame, these are the mean of (a + b)/2, var(a − b)/2 and cov(a, b). The error of
    the mean is that of the noise, as the pattern is the same in all frames. The errors of the variances follow from the
    scatter of the squares and products, so no distribution is assumed.
    """
    a, b = np.asarray(pair[0], dtype=np.float64).ravel(), np.asarray(pair[1], dtype=np.float64).ravel()
    n = a.size
    # The pattern is common to both frames and cancels in the difference; the noise is independent and does not
    # contribute to the covariance.
    a, b = a - a.mean(), b - b.mean()
    squares, products = 0.5 * (a - b) ** 2, a * b
    noise = float(squares.sum()) / (n - 1)
    mean = 0.5 * (float(np.mean(pair[0])) + float(np.mean(pair[1])))
    return (
        Measured(mean, math.sqrt(noise / 2.0 / n)),
        Measured(noise, float(squares.std()) / math.sqrt(n)),
        Measured(float(products.sum()) / (n - 1), float(products.std()) / math.sqrt(n)),
    )


def photon_transfer(flats: Sequence[Pair], bias: Pair, *, quantised: bool = True) -> PhotonTransfer:
    """Gain and read noise from the mean–variance curve.

    The curve σ² = S / K + σ_r², with the signal S above the bias and the gain K in electrons per DN, is fitted by
    weighted least squares to the bias and the levels up to that with the largest variance, above which the detector
    saturates.

    Parameters
    ----------
    flats : sequence of pairs
        Two frames at each of two or more levels of light, in any order.
    bias : pair
        Two frames without light and dark current.
    quantised : bool
        Whether the frames have integer DN, so that 1/12 DN² of the variance is rounding.
    """
    dark, dark_noise, _ = pair_statistics(bias)
    levels = sorted((pair_statistics(pair) for pair in flats), key=lambda level: level[0].value)
    signal = np.array([level[0].value - dark.value for level in levels])
    variance = np.array([level[1].value for level in levels])
    error = np.array([level[1].error for level in levels])
    used = np.arange(signal.size) <= int(np.argmax(variance))

    # A weighted straight line; the bias pair is its point at zero signal.
    x = np.concatenate([[0.0], signal[used]])
    y = np.concatenate([[dark_noise.value], variance[used]])
    weight = 1.0 / np.concatenate([[dark_noise.error], error[used]]).clip(1e-12) ** 2
    mean_x, mean_y = np.average(x, weights=weight), np.average(y, weights=weight)
    spread = np.sum(weight * (x - mean_x) ** 2)
    slope = float(np.sum(weight * (x - mean_x) * (y - mean_y)) / spread)
    gain = Measured(1.0 / slope, 1.0 / math.sqrt(spread) / slope**2)  # error of 1/slope by propagation

    read2 = max(dark_noise.value - (QUANTISATION_DN2 if quantised else 0.0), 0.0)
    read = gain.value * math.sqrt(read2)
    read_error = math.hypot(0.5 * gain.value * dark_noise.error / math.sqrt(read2), read * gain.error / gain.value)
    return PhotonTransfer(signal, variance, used, gain, Measured(read, read_error))


def response_nonuniformity(flat: Pair, dark: Pair) -> Measured:
    """PRNU: relative standard deviation of the response, √(cov(flat) − cov(dark)) / (mean(flat) − mean(dark)).

    The dark pair has the exposure of the flats.
    """
    return _nonuniformity(flat, dark)


def dark_nonuniformity(dark: Pair, bias: Pair) -> Measured:
    """DSNU: standard deviation of the dark current relative to its mean, from long darks and biases."""
    return _nonuniformity(dark, bias)


def full_well(saturated: Pair, bias: Pair, gain_e_per_dn: Measured) -> Measured:
    """Full well, electrons: the mean of strongly saturated flats, above the bias.

    The converter must not saturate first, and the pixels must drain or clip.
    """
    full, dark = pair_statistics(saturated)[0], pair_statistics(bias)[0]
    signal, error = full.value - dark.value, math.hypot(full.error, dark.error)
    value = signal * gain_e_per_dn.value
    return Measured(value, math.hypot(error * gain_e_per_dn.value, signal * gain_e_per_dn.error))


def dark_doubling_c(darks: Sequence[Pair], temperature_c: Sequence[float], bias: Pair) -> Measured:
    """Doubling temperature of the dark signal: ln 2 / slope of ln(dark) over temperature, weighted.

    Parameters
    ----------
    darks : sequence of pairs
        Two darks of the same exposure at each temperature.
    temperature_c : sequence of float
        Their temperatures, two or more different ones.
    bias : pair
        Two biases.
    """
    zero = pair_statistics(bias)[0]
    means = [pair_statistics(pair)[0] for pair in darks]
    signal = np.array([mean.value - zero.value for mean in means])
    relative = np.array([math.hypot(mean.error, zero.error) for mean in means]) / signal
    t, y, weight = np.asarray(temperature_c, dtype=np.float64), np.log(signal), 1.0 / relative**2
    mean_t, mean_y = np.average(t, weights=weight), np.average(y, weights=weight)
    spread = np.sum(weight * (t - mean_t) ** 2)
    slope = float(np.sum(weight * (t - mean_t) * (y - mean_y)) / spread)
    return Measured(math.log(2.0) / slope, math.log(2.0) / slope**2 / math.sqrt(spread))


def _nonuniformity(bright: Pair, dark: Pair) -> Measured:
    (high, _, pattern), (low, _, below) = pair_statistics(bright), pair_statistics(dark)
    signal = high.value - low.value
    variance = max(pattern.value - below.value, 0.0)
    error = math.hypot(pattern.error, below.error)
    value = math.sqrt(variance) / signal
    # The error of a square root near zero cannot be propagated linearly; the root of the variance's error bounds it.
    spread = error / (2.0 * math.sqrt(variance)) if variance > error else math.sqrt(error)
    return Measured(value, math.hypot(spread, value * math.hypot(high.error, low.error)) / signal)
