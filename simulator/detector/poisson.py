"""Exact Poisson deviates for an image of means by inversion, from a uniform deviate of each pixel.

The deviate N is the smallest n with P(≤ n) > u for u = (w + f)/2³². The random 32-bit integer w is sufficient for
nearly every pixel; for the others 53 more bits f are used. Three methods give the same result:

- Means from `LOWEST` to `HIGHEST`: P(< x) = u, continued from integer n to real x by the incomplete gamma function, has
  the uniform expansion x = λ g(s) + b(s) + c(s)/λ, s = Φ⁻¹(u)/√λ (Temme 1992; Giles 2016, "Algorithm 955: approximation
  of the inverse Poisson cumulative distribution function"); its polynomials were fitted to 1.6e-3/λ. If x differs by
  more than 2e-3/λ + 2e-5 + 2.5e-7 λ from an integer (the last two terms for single precision), N is its integer part.
- Lower means: u is compared with P(≤ 0), P(≤ 1), … in single precision; the result is used if u is not within
  `_MARGIN_LOW` of any of them.
- All other pixels (1 in 1,000, the tails and the cores of bright stars): the distribution function is evaluated in
  double precision (`quantile`).

Approximations only serve to decide quickly, with margins for their errors, so the deviates are exact to double
precision. The Gaussian approximation of the Poisson distribution is not used anywhere.
"""

from __future__ import annotations

import math

import numpy as np

from simulator.detector.gaussian import TAIL, WORD, gaussian_from_bits, tail_words, upper_quantile
from simulator.detector.philox import Bits, further_bits
from simulator.detector.simd import BLOCK, fma, outside, polynomial, singles
from simulator.randomness import Key
from startracker._compiled import kernel, kernel_part
from startracker.core import FloatArray, SingleArray

LARGEST_MEAN = 1e18
"""Largest mean whose Poisson deviates fit into 64 bits."""
LOWEST, HIGHEST = np.float32(6.0), np.float32(65536.0)
"""Range of means for the expansion."""
LOW_NUMBERS = 16
"""Largest number tested by the comparison for low means; larger ones have a probability of 1e-4."""

_MARGIN, _MARGIN_EACH, _MARGIN_SHARE = np.float32(2e-5), np.float32(2e-3), np.float32(2.5e-7)
_MARGIN_LOW = np.float32(2e-6)
_FEW = 256
"""There is no separate pass for low (or high) means if they are fewer than one in this number."""
_OPEN = np.float32(-1.0)  # marks a pixel that is not decided yet
_LOWER_HALF, _BELOW_LOWEST = np.uint32(2**31), np.float32(2.0**-32)
_DECIDE, _ROUNDING = 4096.0, 2.0**40
_A = singles(
    -5.8597872e-05, 0.00054183431, -0.0006608383, 0.00015250674, -0.0011268197, 0.0037486294, -0.013889015, 0.16666667
)  # fmt: skip
_B = singles(-0.0045050602, 0.0046913608, 0.0074305549, -0.0064341256, 0.0080365973, -0.027776094, 0.33333333)
_C = singles(-0.026661108, 0.022937551, -0.0186457)
_EXP_MINUS = singles(-1.0 / 5040, 1.0 / 720, -1.0 / 120, 1.0 / 24, -1.0 / 6, 0.5, -1.0, 1.0)
_LOG2_E, _LN2, _EXPONENT, _BITS = (
    np.float32(1.0 / math.log(2.0)),
    np.float32(math.log(2.0)),
    np.int32(127),
    np.int32(23),
)
_ZERO, _ONE, _MOST = np.float32(0.0), np.float32(1.0), np.float32(np.inf)
_STIRLING = np.array(
    [
        math.nan, 0.08106146679532726, 0.0413406959554093, 0.02767792568499834,
        0.020790672103765093, 0.016644691189821193, 0.013876128823070748, 0.01189670994589177,
        0.010411265261972096, 0.009255462182712733, 0.00833056343336287, 0.007573675487951841,
        0.00694284010720953, 0.006408994188004207, 0.0059513701127588475, 0.005554733551962801,
    ]
)  # fmt: skip
"""ln n! − (n + ½) ln n + n − ½ ln 2π for n = 0 to 15."""


@kernel
def shot_noise(signal: FloatArray, key: Key, first: int, bits: Bits, mean: SingleArray, number: SingleArray) -> bool:
    """Replace the means of the pixels first, first + 1, … by Poisson deviates; returns False if one of the means is
    negative, NaN or above `LARGEST_MEAN`.

    Parameters
    ----------
    signal : (N,) float64
        Means; modified in place.
    key : (2,) uint64
        Key of the stream.
    first : int
        Number of the first pixel.
    bits : (≥ N,) uint32
        Random bits of the pixels.
    mean, number : (≥ N,) float32
        Scratch space.
    """
    n = signal.size
    if outside(signal, 0.0, LARGEST_MEAN) > 0:
        return False
    for i in range(n):
        mean[i] = np.float32(signal[i])
    # Counted in 32 bits without a branch, so that the compiler vectorises the loop.
    low = np.int32(0)
    for i in range(n):
        low = np.int32(low + np.int32(mean[i] < LOWEST))
    if _FEW * (n - low) > n:
        gaussian_from_bits(bits, number)
        expand(mean, number[:n])
    else:
        for i in range(n):
            number[i] = _OPEN
    if _FEW * low > n:
        compare(bits[:n], mean, number)
    settle(signal, key, first, bits, number)
    return True


@kernel_part
def settle(signal: FloatArray, key: Key, first: int, bits: Bits, number: SingleArray) -> None:
    """Replace the means by the deviates found, and by exact quantiles for the other pixels."""
    for start in range(0, signal.size, BLOCK):
        stop = min(start + BLOCK, signal.size)
        if outside(number[start:stop], _ZERO, _MOST) > 0:
            for i in range(start, stop):
                if number[i] < _ZERO:
                    signal[i] = quantile(bits[i], further_bits(key, first + i), signal[i])
    for i in range(signal.size):
        signal[i] = np.float64(number[i]) if number[i] >= _ZERO else signal[i]


@kernel
def expand(mean: SingleArray, number: SingleArray) -> None:
    """Replace the Gaussian quantiles in `number` by Poisson quantiles of the expansion, or by −1 if it does not decide
    them."""
    for i in range(number.size):
        rate, w = mean[i], number[i]
        root = np.float32(math.sqrt(rate))
        each = _ONE / root
        s = w * each
        a, b, c = polynomial(s, _A), polynomial(s, _B), polynomial(s, _C)
        square = each * each
        x = rate + fma(w, fma(w, a, root), fma(c, square, b))
        whole = np.float32(np.floor(x))
        margin = fma(_MARGIN_SHARE, rate, fma(_MARGIN_EACH, square, _MARGIN))
        # & instead of `and`, which would branch and prevent vectorisation.
        settled = (x - whole > margin) & (x - whole < _ONE - margin) & (abs(w) < TAIL)
        number[i] = whole if settled & (x > _ZERO) & (rate >= LOWEST) & (rate < HIGHEST) else _OPEN


@kernel_part
def _exp_minus(rate: np.float32) -> np.float32:
    """exp(−λ) = 2⁻ᵐ exp(−r), |r| ≤ ½ ln 2, in single precision, vectorised."""
    # The factor 2⁻ᵐ is made of its bits: the exponent of a float, biased by 127.
    m = np.float32(np.rint(rate * _LOG2_E))
    r = fma(-m, _LN2, rate)
    power: np.float32 = polynomial(r, _EXP_MINUS) * np.int32((_EXPONENT - np.int32(m)) << _BITS).view(np.float32)
    return power


@kernel_part
def _next(
    rate: np.float32,
    u: np.float32,
    k: int,
    probability: np.float32,
    cumulative: np.float32,
    number: np.float32,
    near: np.float32,
) -> tuple[np.float32, np.float32, np.float32, np.float32]:
    """One step of `compare`: update the probability of k, the cumulative probability, the count of those below u, and
    the distance of u from the nearest of them."""
    probability = probability * (rate * np.float32(1.0 / k))
    cumulative = cumulative + probability
    return (
        probability,
        cumulative,
        number + (_ONE if u > cumulative else _ZERO),
        min(near, np.float32(abs(u - cumulative))),
    )


@kernel_part
def compare(bits: Bits, mean: SingleArray, number: SingleArray) -> None:
    """Write the quantiles of the means below `LOWEST` to `number`, −1 if not decided; others are unchanged."""
    # The quantile is the number of n with P(≤ n) < u. All 16 are compared for every pixel, without a branch.
    for i in range(bits.size):
        rate = mean[i]
        p = _exp_minus(rate)
        u = np.float32(bits[i]) * _BELOW_LOWEST
        c, n, near = p, _ONE if u > p else _ZERO, np.float32(abs(u - p))
        for k in range(1, LOW_NUMBERS + 1):
            p, c, n, near = _next(rate, u, k, p, c, n, near)
        found = n if (near > _MARGIN_LOW) & (n <= np.float32(LOW_NUMBERS)) else _OPEN
        number[i] = found if rate < LOWEST else number[i]


@kernel
def quantile(word: np.uint32, fraction: float, mean: float) -> float:
    """Smallest n with P(≤ n) > u, u = (word + fraction)/2³², from the distribution function in double precision.

    The search starts at the Cornish–Fisher expansion (Giles 2016), which is accurate to 1e-4 for means from 4,096 and
    then usually sufficient. Beyond 2⁴⁰, where double precision cannot resolve the probability of single integers, the
    expansion is used alone; it is correct to the rounding of a double.
    """
    if mean == 0.0:
        return 0.0
    # The smaller of u and 1 − u keeps its relative precision in both tails; the search is on that side.
    lower = word < _LOWER_HALF
    tail = (tail_words(word) + (fraction if lower else 1.0 - fraction)) * WORD
    w = upper_quantile(tail)
    w = -w if lower else w
    root, w2 = math.sqrt(mean), w * w
    x = mean + root * w + (1.0 / 3 + w2 / 6)
    if mean >= _DECIDE:
        x += -w * (1.0 / 36 + w2 / 72) / root + (w2 * w2 / 270 + w2 * (7.0 / 810) - 8.0 / 405) / mean
        near = abs(x - np.rint(x))
        if (near > 1e-4 + 1e-15 * mean and abs(w) < 6.0) or mean > _ROUNDING:
            return float(math.floor(x))
    n = max(float(math.floor(x)), 0.0)
    if lower:
        n = min(n, float(math.floor(mean)))  # half of the deviates exceed λ − 1 for any λ
        below = cumulative(n, mean)
        # Down while the next smaller n still satisfies P(≤ n) > u, then up until it does.
        while n > 0 and below - probability(n, mean) > tail:
            below -= probability(n, mean)
            n -= 1.0
        while below <= tail:
            n += 1.0
            below += probability(n, mean)
    else:
        above = exceeding(n, mean)
        while n > 0 and above + probability(n, mean) < tail:
            above += probability(n, mean)
            n -= 1.0
        while above >= tail:
            n += 1.0
            above -= probability(n, mean)
    return n


@kernel
def probability(n: float, mean: float) -> float:
    """Poisson probability of n, computed from its distance to the peak to avoid cancellation (Loader 2000)."""
    if n == 0.0:
        return math.exp(-mean)
    # Loader's form: P(n) = exp(−δ(n) − D(n)) / √(2πn), with δ the error of Stirling's formula and the deviance
    # D = n ln(n/λ) + λ − n.
    if n < 16.0:
        stirling = _STIRLING[int(n)]
    else:
        square = 1.0 / (n * n)
        stirling = (1.0 / 12 - square * (1.0 / 360 - square * (1.0 / 1260 - square / 1680))) / n
    difference = n - mean
    if abs(difference) < 0.1 * (n + mean):  # n ln(n/λ) + λ − n as a series
        v = difference / (n + mean)
        deviance, term, square = difference * v, 2.0 * n * v, v * v
        for j in range(3, 1000, 2):
            term *= square
            before = deviance
            deviance += term / j
            if deviance == before:
                break
    else:
        deviance = n * math.log(n / mean) - difference
    return math.exp(-stirling - deviance) / math.sqrt(2.0 * math.pi * n)


@kernel_part
def cumulative(n: float, mean: float) -> float:
    """P(≤ n) of the Poisson distribution: the probability of n times the sum of the ratios to it."""
    term, total, k = 1.0, 1.0, n
    while k > 0.0 and term > 1e-17 * total:
        term *= k / mean
        total += term
        k -= 1.0
    return float(probability(n, mean) * total)


@kernel_part
def exceeding(n: float, mean: float) -> float:
    """P(> n) of the Poisson distribution: the probability of n + 1 times the sum of the ratios to it."""
    term, total, k = 1.0, 1.0, n + 2.0
    while term > 1e-17 * total:
        term *= mean / k
        total += term
        k += 1.0
    return float(probability(n + 1.0, mean) * total)
