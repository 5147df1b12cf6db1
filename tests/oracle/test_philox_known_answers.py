"""Philox-4x32-10 against the known answers of its authors, and which pixel takes which word.

Random123 (Salmon et al. 2011), tests/kat_vectors: the three vectors of philox4x32 with 10 rounds, as they are repeated
in the test suites of many libraries (TensorFlow among them). Bits, so that there is no tolerance.
"""

import numpy as np
import pytest

from simulator.detector.philox import fill_bits, further_bits
from simulator.detector.steps import TILE
from simulator.randomness import draw_key, stream

PI = (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344, 0xA4093822, 0x299F31D0)


def words(counter, lane, key):
    blocks = np.empty(20, dtype=np.uint32)
    fill_bits(np.array(key, dtype=np.uint64), np.uint64(counter), np.uint64(lane), blocks)
    return [int(word) for word in blocks[::5]]


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
    blocks = np.empty(400, dtype=np.uint32)
    fill_bits(key, np.uint64(2**32 - 50), np.uint64(3), blocks)
    for i in (0, 49, 50, 99):
        counter = 2**32 - 50 + i
        expected = philox_with_four_words((counter & 0xFFFFFFFF, counter >> 32, 3, 0), [int(word) for word in key])
        assert [int(word) for word in blocks[i::100]] == expected


def test_further_bits_are_those_of_lane_one():
    key = draw_key(stream(1, "key"))
    for pixel in (0, 5, 2**33 + 1):
        x0, x1, _, _ = philox_with_four_words((pixel & 0xFFFFFFFF, pixel >> 32, 1, 0), [int(word) for word in key])
        assert further_bits(key, pixel) == (((x0 | x1 << 32) >> 11) + 0.5) * 2.0**-53


def test_a_tile_is_blocks_of_four():
    assert TILE % 4 == 0
