"""Running centroids in 10.22 against the sums of eqs. 2.1 and 2.2."""

import numpy as np
import pytest

from simulator.theses.yee1999.fixed_point.centroid import running_centroid
from simulator.theses.yee1999.fixed_point.formats import CENTROID, FixedPointOverflow


def test_against_exact_sums():
    rng = np.random.default_rng(6)
    for _ in range(200):
        count = int(rng.integers(1, 300))
        x0, y0 = rng.integers(-240, 240, 2)
        x, y = x0 + rng.integers(-9, 10, count), y0 + rng.integers(-9, 10, count)
        dn = rng.integers(1, 256, count)
        fixed = CENTROID.decode(running_centroid(x, y, dn))
        exact = np.array([(x * dn).sum(), (y * dn).sum()]) / dn.sum()
        assert np.abs(fixed - exact).max() < count * 2.0**-22
        if abs(x0) > 9:  # every truncation is towards the origin
            assert abs(fixed[0]) <= abs(exact[0]) + 1e-12


def test_one_pixel_and_symmetry():
    assert running_centroid([-3], [511], [200]).tolist() == [-3 * 2**22, 511 * 2**22]
    right = running_centroid([5, 6, 7], [0, 1, 0], [100, 7, 31])
    assert running_centroid([-5, -6, -7], [0, -1, 0], [100, 7, 31]).tolist() == (-right).tolist()
    assert running_centroid([4, 9], [4, 9], [10, 0]).tolist() == [4 * 2**22, 4 * 2**22]


def test_refusals():
    with pytest.raises(FixedPointOverflow, match=r"10\.22"):
        running_centroid([512], [0], [1])
    with pytest.raises(FixedPointOverflow, match="sum of the signals"):
        running_centroid([1, 1], [1, 1], [2**30, 2**30])
    for dn in ([], [0, 1], [1, -1]):
        with pytest.raises(ValueError, match="cluster"):
            running_centroid([1] * len(dn), [1] * len(dn), np.array(dn, dtype=np.int64))
    with pytest.raises(TypeError):
        running_centroid([1.5], [0], [1])
