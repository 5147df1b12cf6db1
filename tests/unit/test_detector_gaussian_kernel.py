"""The normal kernel against SciPy's inverse of the distribution function; no randomness involved but in the words."""

import numpy as np
from scipy.special import log_ndtr, ndtri, ndtri_exp

from simulator.detector.gaussian import TAIL, add_gaussian, gaussian_from_bits, tail_words, upper_quantile
from simulator.detector.philox import further_bits
from simulator.detector.simd import fma
from simulator.randomness import draw_key, stream


def from_words(words):
    out = np.empty(words.size, dtype=np.float32)
    gaussian_from_bits(words, out)
    return out


def test_the_middle():
    rng = stream(1, "words")
    words = np.concatenate(
        [rng.integers(0, 2**32, 2_000_000), 2**31 + np.arange(-5000, 5000), np.linspace(2**20, 2**32 - 2**20, 10_001)]
    ).astype(np.uint32)
    exact = ndtri((words + 0.5) / 2**32)
    middle = np.abs(exact) < TAIL
    # The polynomial is good to 9e-8; five roundings of 6e-8 follow one another.
    np.testing.assert_allclose(from_words(words)[middle], exact[middle], rtol=3.9e-7, atol=0)


def test_the_two_sides_mirror_each_other():
    words = stream(2, "words").integers(0, 2**32, 100_000).astype(np.uint32)
    assert np.array_equal(from_words(words), -from_words(~words))
    assert np.array_equal([tail_words(w) for w in words[:100]], np.minimum(words, ~words)[:100])


def test_every_word_of_the_tail_is_known_as_one():
    words = np.arange(2**20, dtype=np.uint32)
    numbers = from_words(words)
    edge = np.flatnonzero(-numbers > TAIL).max()
    assert np.all(-numbers[: edge + 1] > TAIL)
    assert abs(edge / 2**32 / np.exp(log_ndtr(-float(TAIL))) - 1) < 1e-4


def test_the_tails():
    rng = stream(3, "tails")
    words = np.concatenate([rng.integers(0, 500_000, 3000), rng.integers(2**32 - 500_000, 2**32, 3000), [0, 2**32 - 1]])
    words = words.astype(np.uint32)
    key, first = draw_key(stream(3, "key")), 7
    signal = np.zeros(words.size)
    add_gaussian(signal, 1.0, key, first, words, np.empty(words.size, dtype=np.float32))
    fraction = np.array([further_bits(key, first + i) for i in range(words.size)])
    exact = np.where(words < 2**31, 1.0, -1.0) * ndtri((np.minimum(words, ~words) + fraction) / 2**32)
    np.testing.assert_allclose(signal, exact, rtol=1e-7)


def test_the_quantile_of_a_double():
    logarithm = np.concatenate([np.linspace(np.log(0.5), -30.0, 2000), np.linspace(-30.0, -600.0, 100)])
    own = np.array([upper_quantile(p) for p in np.exp(logarithm)])
    np.testing.assert_allclose(own, -ndtri_exp(logarithm), rtol=1e-13, atol=1e-15)


def test_fused_multiply_add_rounds_once():
    import numba

    @numba.njit
    def fused(a, b, c):
        return fma(a, b, c)

    a, c = np.float32(1 + 2.0**-12), np.float32(-1 - 2.0**-11)  # a² is half a step of its last bit above −c
    assert fused(a, a, c) == np.float32(2.0**-24)
    assert a * a + c == 0.0
