"""What identification must not depend on: the order of the centroids, the roll, the unit of the flux."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from startracker import Attitude, Camera, StarTracker
from startracker.geometry.attitude import rotation_vector_to_matrix
from startracker.identification.unknown_scale.quads import quad_codes, sky_codes

seeds = st.integers(0, 2**32 - 1)


@pytest.fixture(scope="module")
def tracker():
    return StarTracker(Camera.from_fov(15.0, 400, 400), magnitude_limit=5.5)


def field(tracker, attitude):
    index, _, xy = tracker.guide.in_field(attitude.as_matrix())
    return tracker.guide.catalog.id[index], xy, 10.0 ** (-0.4 * tracker.guide.v_mag[index])


@settings(max_examples=25, deadline=None)
@given(seed=seeds, scale=st.floats(1e-6, 1e9))
def test_order_and_unit_of_the_flux_mean_nothing(tracker, seed, scale):
    rng = np.random.default_rng(seed)
    _, xy, flux = field(tracker, Attitude(rng.normal(size=4)))
    xy = xy + rng.normal(0, 0.1, xy.shape)
    first = tracker.solve_centroids(xy, flux)
    order = rng.permutation(len(xy))
    second = tracker.solve_centroids(xy[order], scale * flux[order])
    assert second.status is first.status
    if first.solved:
        assert set(second.stars.catalog_id) == set(first.stars.catalog_id)
        assert first.attitude.angle_to(second.attitude) < 1e-9


@settings(max_examples=25, deadline=None)
@given(seed=seeds)
def test_the_roll_means_nothing(tracker, seed):
    """Turning the camera by a right angle turns the image and the attitude, and changes nothing else."""
    rng = np.random.default_rng(seed)
    _, xy, flux = field(tracker, Attitude(rng.normal(size=4)))
    xy = np.clip(xy + rng.normal(0, 0.1, xy.shape), 0.0, 399.0)
    first = tracker.solve_centroids(xy, flux)
    turned = np.stack([399.0 - xy[:, 1], xy[:, 0]], axis=1)
    second = tracker.solve_centroids(turned, flux)
    assert second.status is first.status
    if first.solved:
        assert set(second.stars.catalog_id) == set(first.stars.catalog_id)
        assert first.attitude.boresight == pytest.approx(second.attitude.boresight, abs=1e-9)


@settings(max_examples=50, deadline=None)
@given(seed=seeds, scale=st.floats(1e-3, 1e3))
def test_codes_keep_under_shift_turn_scale_and_order(seed, scale):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(4, 2))
    angle = rng.uniform(0, 2 * np.pi)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    order = rng.permutation(4)
    other = (scale * points @ turn.T + rng.normal(size=2) * scale)[order]
    label = np.arange(4)
    code, stars, base = quad_codes(points[None], label[None])
    code2, stars2, base2 = quad_codes(other[None], label[order][None])
    np.testing.assert_allclose(code2, code, atol=1e-9)
    assert base2[0] == pytest.approx(scale * base[0])
    # near-ties may turn over the labels; without one they are the same stars
    if abs(code[0, 0] - code[0, 2]) > 1e-6 and abs(code[0, 0] + code[0, 2] - 1) > 1e-6:
        assert stars2.tolist() == stars.tolist()
    assert code[0, 0] <= code[0, 2] + 1e-12
    assert code[0, 0] + code[0, 2] <= 1 + 1e-12


@settings(max_examples=30, deadline=None)
@given(seed=seeds)
def test_sky_codes_keep_under_rotation_and_differ_mirrored(seed):
    rng = np.random.default_rng(seed)
    vectors = np.array([0.0, 0.0, 1.0]) + rng.normal(0, 0.1, (4, 3))
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    matrix = rotation_vector_to_matrix(rng.normal(size=3))
    quad = np.arange(4)[None]
    code, _, angle = sky_codes(vectors, quad)
    turned, _, same = sky_codes(vectors @ matrix.T, quad)
    np.testing.assert_allclose(turned, code, atol=1e-9)
    assert same == pytest.approx(angle)
    mirrored, _, _ = sky_codes(vectors * np.array([-1.0, 1.0, 1.0]), quad)
    # x and y change places in the frame of A and B; then the order of the two ends and of C and D is made anew
    swapped = code.reshape(2, 2)[:, ::-1]
    if swapped[:, 0].sum() > 1.0:
        swapped = 1.0 - swapped
    np.testing.assert_allclose(mirrored.reshape(2, 2), swapped[np.argsort(swapped[:, 0])], atol=1e-9)
