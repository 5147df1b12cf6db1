"""Streams against NumPy's own SeedSequence and Philox (numpy 2.x): the same bits, word for word."""

import pickle
import zlib

import numpy as np
import pytest

from simulator.randomness import DEVICE, stream

SEEDS = (0, 1, 7, 2**32 - 1, 2**32, 2**40 + 5, 2**64 + 3, 2**128 - 1, 2**130 + 77, 2**200)
TRIALS = (DEVICE, 0, 1, 5, 10**6, 2**32 - 2, 2**32 - 1, 2**33, 2**70)


@pytest.mark.parametrize("seed", SEEDS)
def test_streams_are_those_of_a_seed_sequence(seed):
    for stage in ("", "shot_noise", "Zufall ä"):
        for trial in TRIALS:
            key = np.random.SeedSequence(entropy=seed, spawn_key=(zlib.crc32(stage.encode()), trial + 1))
            expected = np.random.Generator(np.random.Philox(key))
            assert np.array_equal(
                stream(seed, stage, trial).integers(0, 2**64, 9, np.uint64), expected.integers(0, 2**64, 9, np.uint64)
            )


def test_children_are_those_of_the_seed_sequence():
    """As SciPy's samplers ask for them."""
    expected = np.random.SeedSequence(entropy=3, spawn_key=(zlib.crc32(b"a"), 5))
    own = stream(3, "a", 4)
    for theirs, child in zip(expected.spawn(2) + expected.spawn(1), own.spawn(2) + own.spawn(1), strict=True):
        assert child.random() == np.random.Generator(np.random.Philox(theirs)).random()
    for words, kind in ((2, np.uint64), (4, np.uint32), (9, np.uint32), (5, np.uint64)):
        sequence = stream(3, "a", 4).bit_generator.seed_seq
        assert np.array_equal(sequence.generate_state(words, kind), expected.generate_state(words, kind))


def test_a_stream_can_be_sent():
    there = stream(3, "pointing", 4)
    there.random(3)
    assert pickle.loads(pickle.dumps(there)).random() == there.random()


@pytest.mark.parametrize(("seed", "trial"), [(-1, 0), (0, DEVICE - 1)])
def test_numbers_below_zero_are_no_seeds(seed, trial):
    with pytest.raises(ValueError, match="from 0"):
        stream(seed, "a", trial)
