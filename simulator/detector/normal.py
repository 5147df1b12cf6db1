"""Exact normal numbers for an image, each from the number of its pixel: the ziggurat of Marsaglia & Tsang (2000).

The area under exp(−x²/2) is covered by 256 layers of equal area. A layer is chosen by 8 bits of a word and a place in
it by 53; in 98.5 % of cases the place lies under the curve beyond doubt. Otherwise it is compared with the curve, or
drawn from the tail, with bits of the pixel's own further counters. Exact to the resolution of 53 bits, as NumPy's own.
"""

from __future__ import annotations

import math
from functools import cache

import numba
import numpy as np
from numpy.typing import NDArray

from simulator.detector.philox import Words, block, draw_key, fill_words, to_unit

FloatArray = NDArray[np.float64]

LAYERS = 256
TAIL_START = 3.6541528853610088
"""Where the tail begins, for 256 layers (Marsaglia & Tsang 2000)."""
_PAIRS = 2048  # pairs of pixels at a time: their words stay in the cache
_LAYER_BITS, _SIGN_BIT, _ONE = np.uint64(0xFF), np.uint64(0x100), np.uint64(1)


def add_normal(image: FloatArray, sigma: float, rng: np.random.Generator) -> None:
    """Add independent normal numbers of mean 0 to an image, in place.

    Parameters
    ----------
    image : (...) float64, contiguous
        Changed in place. Pixel k (in memory order) takes number k of the stream, whatever its value.
    sigma : float
        Standard deviation.
    rng : numpy.random.Generator
        The stream; gives the key.
    """
    if not image.flags.c_contiguous:
        raise ValueError("add_normal works in place on C-contiguous arrays only")
    _add_normal(image.reshape(-1), sigma, draw_key(rng), *ziggurat())


def draw_normal(shape: tuple[int, ...], rng: np.random.Generator) -> FloatArray:
    """Standard normal numbers, those that `add_normal` adds with the same stream."""
    numbers = np.zeros(shape)
    add_normal(numbers, 1.0, rng)
    return numbers


@cache
def ziggurat() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Layers of the ziggurat.

    Returns
    -------
    width : (LAYERS + 1,) float64
        x of each layer, falling; that of the lowest counts its tail in: area / f(TAIL_START). The last is 0.
    sure : (LAYERS,) float64
        Share of each layer that lies under the curve whatever the height.
    height : (LAYERS + 1,) float64
        f(x) = exp(−x²/2) at each x; 0 for the lowest.
    """
    area = TAIL_START * math.exp(-0.5 * TAIL_START**2) + math.sqrt(math.pi / 2) * math.erfc(TAIL_START / math.sqrt(2))
    width = np.zeros(LAYERS + 1)
    width[0] = area / math.exp(-0.5 * TAIL_START**2)
    width[1] = TAIL_START
    for i in range(2, LAYERS):
        width[i] = math.sqrt(-2.0 * math.log(area / width[i - 1] + math.exp(-0.5 * width[i - 1] ** 2)))
    height = np.exp(-0.5 * width**2)
    height[0] = 0.0
    tables = (width, width[1:] / width[:-1], height)
    for table in tables:
        table.setflags(write=False)
    return tables


@numba.njit(cache=True, error_model="numpy")
def _add_normal(
    image: FloatArray, sigma: float, key: Words, width: FloatArray, sure: FloatArray, height: FloatArray
) -> None:
    n = image.size
    a = np.empty(_PAIRS, dtype=np.uint64)
    b = np.empty(_PAIRS, dtype=np.uint64)
    for start in range(0, n, 2 * _PAIRS):
        pairs = min(_PAIRS, (n - start + 1) // 2)
        fill_words(key, np.uint64(start // 2), np.uint64(0), a[:pairs], b[:pairs])
        for i in range(min(2 * _PAIRS, n - start)):
            word = b[i >> 1] if i & 1 else a[i >> 1]
            layer = word & _LAYER_BITS
            u = to_unit(word)
            if u < sure[layer]:
                x = u * width[layer]
            else:
                x = slow_path(word, np.uint64(start + i), key, width, sure, height)
                word = np.uint64(0) if x >= 0.0 else _SIGN_BIT
                x = abs(x)
            image[start + i] += -sigma * x if word & _SIGN_BIT else sigma * x


@numba.njit(cache=True, error_model="numpy")
def slow_path(
    word: np.uint64,
    pixel: np.uint64,
    key: Words,
    width: FloatArray,
    sure: FloatArray,
    height: FloatArray,
) -> float:
    """Normal number of a word that is not settled at once, with bits of the pixel's lanes 1, 2, …"""
    lane = np.uint64(0)
    while True:
        layer = word & _LAYER_BITS
        sign = -1.0 if word & _SIGN_BIT else 1.0
        x = to_unit(word) * width[layer]
        if to_unit(word) < sure[layer]:
            return float(sign * x)
        lane += _ONE
        a, b = block(key[0], key[1], pixel, lane)
        if layer == 0:
            while True:  # tail (Marsaglia 1964): 1 − u, so that the logarithm is finite
                x = -math.log(1.0 - to_unit(a)) / TAIL_START
                y = -math.log(1.0 - to_unit(b))
                if y + y > x * x:
                    return sign * (TAIL_START + x)
                lane += _ONE
                a, b = block(key[0], key[1], pixel, lane)
        low, high = height[layer], height[layer + _ONE]
        if low + to_unit(a) * (high - low) < math.exp(-0.5 * x * x):
            return float(sign * x)
        word = b
