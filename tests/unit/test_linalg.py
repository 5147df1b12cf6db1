"""Linear algebra of kernels against NumPy and SciPy, and matrices that are not positive definite."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from startracker.geometry.linalg import (
    chord,
    cross,
    factorise,
    inverse,
    log_determinant,
    rotate_back,
    rotated,
    solve,
    substitute,
    transform,
    triple_product,
)


def positive(size, seed=0, scale=1.0):
    rng = np.random.default_rng(size + 100 * seed)
    root = rng.normal(size=(size, size)) + 2.0 * np.eye(size)
    return scale * (root @ root.T)


@pytest.mark.parametrize("scale", [1e-18, 1.0, 1e18])
@pytest.mark.parametrize("size", [1, 2, 3, 5, 9])
def test_a_positive_definite_system(size, scale):
    """In any unit: radians squared or pixels to the minus two."""
    matrix = positive(size, scale=scale)
    right = np.random.default_rng(1).normal(size=size)
    expected = np.linalg.solve(matrix, right)
    np.testing.assert_allclose(solve(matrix, right), expected, rtol=1e-9)
    found, log_det = inverse(matrix, size)
    np.testing.assert_allclose(found @ matrix, np.eye(size), atol=1e-9)
    np.testing.assert_array_equal(found, found.T)
    assert log_det == pytest.approx(np.linalg.slogdet(matrix)[1], rel=1e-12, abs=1e-12)
    assert log_determinant(matrix) == pytest.approx(log_det, rel=1e-12, abs=1e-12)
    factor = matrix.copy()
    assert factorise(factor, size)
    np.testing.assert_allclose(np.tril(factor), np.linalg.cholesky(matrix), rtol=1e-9)
    substitute(factor, size, right)
    np.testing.assert_allclose(right, expected, rtol=1e-9)
    # the leading block alone
    if size > 1:
        block, block_det = inverse(matrix, size - 1)
        np.testing.assert_allclose(block @ matrix[:-1, :-1], np.eye(size - 1), atol=1e-9)
        assert block_det == pytest.approx(np.linalg.slogdet(matrix[:-1, :-1])[1], rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("scale", [1e-18, 1.0, 1e18])
@pytest.mark.parametrize(("rest", "regular"), [(1e-12, True), (1e-15, False), (0.0, False), (-1e-3, False)])
def test_a_pivot_that_is_rounding_error_is_no_inverse(rest, regular, scale):
    """What elimination leaves of a diagonal element counts from 1e-14 of it on."""
    matrix = scale * np.array([[4.0, 2.0, 1.0], [2.0, 1.0 + rest, 0.5], [1.0, 0.5, 3.0]])
    assert factorise(matrix.copy(), 3) is regular
    assert np.isfinite(solve(matrix, np.ones(3))).all() == regular
    found, log_det = inverse(matrix, 3)
    assert np.isfinite(found).all() == regular
    assert math.isfinite(log_det) is regular
    assert math.isfinite(log_determinant(matrix)) is regular
    if not regular:
        assert np.isnan(solve(matrix, np.ones(3))).all()
        assert np.isnan(log_det)
        assert log_determinant(matrix) == -math.inf
    assert not factorise(np.array([[-1.0]]), 1)
    assert not factorise(np.array([[math.nan]]), 1)


def test_three_vectors():
    rng = np.random.default_rng(2)
    a, b, c = rng.normal(size=(3, 3))
    np.testing.assert_allclose(cross(a, b), np.cross(a, b))
    assert triple_product(a, b, c) == pytest.approx(a @ np.cross(b, c))
    assert chord(a, b) == pytest.approx(np.linalg.norm(a - b))
    matrix, vectors = rng.normal(size=(3, 3)), rng.normal(size=(7, 3))
    out = np.empty((7, 3))
    transform(matrix, vectors, out)
    np.testing.assert_allclose(out, vectors @ matrix.T)
    np.testing.assert_allclose(rotate_back(matrix, a), matrix.T @ a)


@pytest.mark.parametrize("vector", [(0.0, 0.0, 0.0), (1e-9, -2e-9, 3e-9), (0.3, -0.5, 0.8), (0.0, math.pi, 0.0)])
def test_rotations_by_a_vector_are_rodrigues(vector):
    matrix = np.random.default_rng(3).normal(size=(3, 3))
    expected = Rotation.from_rotvec(vector).as_matrix() @ matrix
    np.testing.assert_allclose(rotated(matrix, *vector), expected, atol=1e-14)
