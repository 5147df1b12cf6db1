"""Philox-4x32-10 against the known answers of its authors, and the ziggurat against its published constants.

Random123 (Salmon et al. 2011), tests/kat_vectors: the three vectors of philox4x32 with 10 rounds, as they are repeated
in the test suites of many libraries (TensorFlow among them). Bits, so that there is no tolerance. Marsaglia & Tsang
(2000) print for 256 layers r = 3.6541528853610088 and the area v = 0.00492867323399; the tolerance is that of print.
"""

import numpy as np
import pytest

from simulator.detector.normal import LAYERS, TAIL_START, add_normal, draw_normal, ziggurat
from simulator.detector.philox import draw_key, fill_words
from simulator.randomness import stream

PI = (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344, 0xA4093822, 0x299F31D0)


def words(counter, lane, key):
    a, b = np.empty(5, dtype=np.uint64), np.empty(5, dtype=np.uint64)
    fill_words(np.array(key, dtype=np.uint64), np.uint64(counter), np.uint64(lane), a, b)
    return [int(word) >> shift & 0xFFFFFFFF for word in (a[0], b[0]) for shift in (0, 32)]


def philox_with_four_words(counter, key):
    """Philox as its paper has it, in plain integers: the fourth word of the counter, which ours leaves at zero."""
    x, k = list(counter), list(key)
    for _ in range(10):
        p, q = 0xD2511F53 * x[0], 0xCD9E8D57 * x[2]
        x = [q >> 32 ^ x[1] ^ k[0], q & 0xFFFFFFFF, p >> 32 ^ x[3] ^ k[1], p & 0xFFFFFFFF]
        k = [(k[0] + 0x9E3779B9) & 0xFFFFFFFF, (k[1] + 0xBB67AE85) & 0xFFFFFFFF]
    return x


@pytest.mark.parametrize(
    ("counter", "key", "answer"),
    [
        ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
        ((0xFFFFFFFF,) * 4, (0xFFFFFFFF,) * 2, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
        (PI[:4], PI[4:], (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1)),
    ],
)
def test_known_answers(counter, key, answer):
    assert philox_with_four_words(counter, key) == list(answer)
    if counter[3] == 0:
        assert words(counter[0] | counter[1] << 32, counter[2], key) == list(answer)
    # the kernel leaves the last word at zero: there it is held against the plain one, which the known answers bind
    assert words(counter[0] | counter[1] << 32, counter[2], key) == philox_with_four_words((*counter[:3], 0), key)


def test_counters_follow_one_another():
    key = draw_key(stream(1, "key"))
    a, b = np.empty(100, dtype=np.uint64), np.empty(100, dtype=np.uint64)
    fill_words(key, np.uint64(2**32 - 50), np.uint64(3), a, b)
    for i in (0, 49, 50, 99):
        counter = 2**32 - 50 + i
        expected = philox_with_four_words((counter & 0xFFFFFFFF, counter >> 32, 3, 0), [int(word) for word in key])
        assert [int(word) >> shift & 0xFFFFFFFF for word in (a[i], b[i]) for shift in (0, 32)] == expected


def test_ziggurat_is_the_published_one():
    width, sure, height = ziggurat()
    area = width[0] * np.exp(-0.5 * TAIL_START**2)
    assert area == pytest.approx(0.00492867323399, abs=1e-13)
    layers = width[1:-1] * np.diff(height[1:])
    np.testing.assert_allclose(layers, area, rtol=1e-9)
    assert width[-1] == 0.0
    assert height[-1] == 1.0
    assert sure.size == LAYERS
    assert np.all((sure >= 0.0) & (sure < 1.0))


def test_a_pixel_hangs_on_its_number_alone():
    short, long = draw_normal((5000,), stream(2, "n")), draw_normal((100, 301), stream(2, "n"))
    assert np.array_equal(short, long.ravel()[:5000])
    image = np.full((100, 301), 7.0)
    add_normal(image, 3.0, stream(2, "n"))
    np.testing.assert_allclose(image, 7.0 + 3.0 * long, rtol=0, atol=1e-14)
    with pytest.raises(ValueError, match="contiguous"):
        add_normal(image.T, 1.0, stream(2, "n"))
