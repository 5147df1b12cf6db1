"""Gaussian deviates for an image by inversion of the distribution function, from the random bits of each pixel.

A random 32-bit integer w represents the probability u = (w + ½)/2³². In the central part, for all but 1 pixel in 4,000,

    x = Φ⁻¹(u) = (2u − 1) P(−ln 4u(1 − u)),

with P a polynomial of degree 10 in single precision (the form is that of Giles 2010, "Approximating the erfinv
function"; the coefficients were fitted to 9e-8): |x − Φ⁻¹(u)| < 1e-6, so that the error of the distribution function is
below 4e-7. In the tails, where 32 bits are too coarse, 53 more bits of the pixel are used, and the inverse is computed
in double precision: beyond 3.66 σ the deviates are exact, up to 10 σ.
"""

from __future__ import annotations

import math

import numpy as np

from simulator.detector.philox import Bits, further_bits
from simulator.detector.simd import BLOCK, fma, outside, polynomial, singles
from simulator.randomness import Key
from startracker._compiled import kernel, kernel_part
from startracker.core import FloatArray, SingleArray

TAIL = np.float32(3.66)
"""Deviation, in standard deviations, at which the tails begin."""
WORD = 2.0**-32

_P = singles(
    5.538620913011903e-10, -6.931944184747422e-10, -4.949062150374e-08, 2.966971531025157e-07, 7.115696431741468e-07,
    -2.22371866131e-05, 1.6799162282434642e-04, -2.8766899738652606e-04, -0.01021186580633677, 0.3229416960379922,
    2.628710547034861,
)  # fmt: skip
_CENTRE = np.float32(4.0)
# ln(1 + z) = z − z²/2 + z³ L(z) for √½ ≤ 1 + z < √2 (Moshier, Cephes: logf)
_L = singles(
    7.0376836292e-2, -1.1514610310e-1, 1.1676998740e-1, -1.2420140846e-1, 1.4249322787e-1, -1.6668057665e-1,
    2.0000714765e-1, -2.4999993993e-1, 3.3333331174e-1,
)  # fmt: skip
_LN2, _ROOT_HALF, _MANTISSA, _BITS = np.float32(math.log(2.0)), np.int32(0x3F3504F3), np.int32(0x7FFFFF), np.int32(23)
_MIDDLE, _LARGEST, _SIGN = np.uint32(2**31), np.int32(2**31 - 1), np.int32(31)
_ONE, _HALF, _UNIT, _TWICE = np.float32(1.0), np.float32(0.5), np.float32(2.0**-32), np.float32(2.0**-31)


@kernel_part
def _log(y: np.float32) -> np.float32:
    """Natural logarithm in single precision, vectorised by the compiler."""
    # Subtracting the bits of √½ before the exponent is split off leaves a mantissa from √½ to √2, where the series
    # converges fastest.
    bits = np.int32(np.float32(y).view(np.int32) - _ROOT_HALF)
    exponent = np.float32(np.int32(bits >> _BITS))
    z = np.int32((bits & _MANTISSA) + _ROOT_HALF).view(np.float32) - _ONE
    logarithm: np.float32 = fma(exponent, _LN2, fma(z * z, fma(z, polynomial(z, _L), -_HALF), z))
    return logarithm


@kernel_part
def _words_to_middle(word: np.uint32) -> np.int32:
    """Number of integers between this one and the centre, 0 to 2³¹ − 1, int32."""
    # As a signed number relative to the centre, a negative one is inverted: −1 − w, without a branch.
    centred = np.int32(word ^ _MIDDLE)
    return np.int32(centred ^ np.int32(centred >> _SIGN))


@kernel_part
def tail_words(word: np.uint32) -> np.int32:
    """Number of integers beyond this one on its side of the centre, 0 to 2³¹ − 1, int32."""
    return np.int32(_LARGEST - _words_to_middle(word))


@kernel
def gaussian_from_bits(bits: Bits, out: SingleArray) -> None:
    """Write Φ⁻¹((bits + ½)/2³²) in single precision to `out` (≥ N,); in the tails the result is only a value beyond
    `TAIL`, to be replaced by `settle_tails`."""
    for i in range(bits.size):
        x = (np.float32(_words_to_middle(bits[i])) + _HALF) * _TWICE  # |2u − 1|
        p = (np.float32(tail_words(bits[i])) + _HALF) * _UNIT  # the smaller of u and 1 − u
        # The polynomial is in −ln 4u(1 − u), shifted to the middle of its range for accuracy.
        t = -_log(np.float32(4.0) * p * (_ONE - p)) - _CENTRE
        number = x * polynomial(t, _P)
        out[i] = number if bits[i] >= _MIDDLE else -number


@kernel
def upper_quantile(p: float) -> float:
    """x ≥ 0 with 1 − Φ(x) = p, 0 < p ≤ ½, in double precision: two steps of Halley's method from an approximation
    accurate to 4.5e-4 (Abramowitz & Stegun 1964, 26.2.23)."""
    t = math.sqrt(-2.0 * math.log(p))
    x = t - (2.515517 + t * (0.802853 + t * 0.010328)) / (1.0 + t * (1.432788 + t * (0.189269 + t * 0.001308)))
    for _ in range(2):
        step = (0.5 * math.erfc(x * math.sqrt(0.5)) - p) * math.sqrt(2.0 * math.pi) * math.exp(0.5 * x * x)
        x += step / (1.0 - 0.5 * x * step)
    return x


@kernel_part
def add_gaussian(signal: FloatArray, sigma: float, key: Key, first: int, bits: Bits, deviate: SingleArray) -> None:
    """Add Gaussian noise of mean 0 to the pixels first, first + 1, …, in place.

    Parameters
    ----------
    signal : (N,) float64
        Modified in place.
    sigma : float
        Standard deviation.
    key : (2,) uint64
        Key of the stream.
    first : int
        Number of the first pixel.
    bits : (≥ N,) uint32
        Random bits of the pixels.
    deviate : (≥ N,) float32
        Scratch space.
    """
    n = signal.size
    gaussian_from_bits(bits, deviate)
    settle_tails(deviate[:n], key, first, bits)
    for i in range(n):
        signal[i] += sigma * np.float64(deviate[i])


@kernel_part
def settle_tails(deviate: SingleArray, key: Key, first: int, bits: Bits) -> None:
    """Replace deviates beyond `TAIL` by those in double precision, with additional bits of the pixels."""
    # Tails are rare: most blocks are skipped after a vectorised test.
    for start in range(0, deviate.size, BLOCK):
        if outside(deviate[start : start + BLOCK], -TAIL, TAIL) > 0:
            for i in range(start, min(start + BLOCK, deviate.size)):
                if abs(deviate[i]) > TAIL:
                    x = upper_quantile((tail_words(bits[i]) + further_bits(key, first + i)) * WORD)
                    deviate[i] = x if bits[i] >= _MIDDLE else -x
