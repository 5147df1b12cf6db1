"""Numbers counted outside a range, against NumPy, in all types that kernels ask about."""

import numpy as np
import pytest

from simulator.detector.simd import BLOCK, outside
from simulator.randomness import stream


@pytest.mark.parametrize("kind", [np.float64, np.float32, np.int32])
@pytest.mark.parametrize("size", [0, 1, BLOCK - 1, BLOCK, 1000])
def test_how_many(kind, size):
    numbers = stream(1, "few").integers(-5, 6, size).astype(kind)
    for low, high in ((-5, 5), (0, 5), (-2, 2), (3, 3)):
        assert outside(numbers, kind(low), kind(high)) == np.sum((numbers < low) | (numbers > high))


def test_what_is_no_number_lies_nowhere():
    assert outside(np.array([1.0, np.nan, np.inf, -np.inf]), -np.inf, np.inf) == 1
    assert outside(np.array([1.0, np.nan, np.inf, -np.inf]), 1.0, 1.0) == 3
