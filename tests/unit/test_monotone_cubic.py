"""The monotone cubic is SciPy's `PchipInterpolator`: the same slopes and values to rounding."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from simulator.sky.monotone import MonotoneCubic

X = np.array([-1.0, -0.4, 0.1, 0.2, 1.7, 2.0, 4.5])
CURVES = {
    "rising": np.exp(X),
    "wavy": np.sin(3.0 * X),
    "steps": np.array([0.0, 0.0, 1.0, 1.0, 5.0, 5.0, 5.0]),
    "one_bump": np.array([0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0]),
    "overshooting_ends": np.array([0.0, 1.0, -30.0, 4.0, 5.0, 30.0, 29.9]),
}


@pytest.mark.parametrize("name", CURVES)
def test_same_as_scipy(name):
    y = CURVES[name]
    at = np.concatenate([X, np.linspace(X[0], X[-1], 1001)])
    twin = PchipInterpolator(X, y)
    ours = MonotoneCubic.through(X, y)
    np.testing.assert_allclose(ours.slope, twin.derivative()(X), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(ours(at), twin(at), rtol=1e-12, atol=1e-12)


def test_every_column_is_a_curve_of_its_own():
    y = np.stack(list(CURVES.values()), axis=1)
    at = np.linspace(X[0], X[-1], 77)
    together = MonotoneCubic.through(X, y)(at)
    for k in range(y.shape[1]):
        np.testing.assert_array_equal(together[:, k], MonotoneCubic.through(X, y[:, k].copy())(at))


@pytest.mark.parametrize("seed", range(20))
def test_points_at_random(seed):
    rng = np.random.default_rng(seed)
    x, y = np.sort(rng.uniform(0.0, 1.0, 5)), rng.normal(size=5)
    at = rng.uniform(x[0], x[-1], 200)
    np.testing.assert_allclose(MonotoneCubic.through(x, y)(at), PchipInterpolator(x, y)(at), rtol=1e-9, atol=1e-11)
