"""Attitude: what must hold for every rotation, with SciPy's `Rotation` as the independent twin.

SciPy's rotations turn vectors, ours turn coordinates: the matrix of our quaternion q is SciPy's of q, transposed.
Tolerances count rounding errors, u = 1.1e-16 each. An element of a matrix from a quaternion: each component carries 4 u
from its normalisation, its square 9 u, two squares doubled and taken from one 37 u = 4e-15; compared between two such
matrices 8e-15, between products of them 3e-14. A unit vector from two angles: 4 u a component, with the angles' own
rounding 8 u = 1e-15.
"""

import math

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from startracker.errors import FrameMismatchError, InputError
from startracker.geometry.attitude import (
    Attitude,
    direction_to_radec,
    matrix_to_quat,
    quat_multiply,
    quat_to_matrix,
    radec_to_direction,
    rotation_vector_to_matrix,
)

component = st.floats(-1.0, 1.0, allow_subnormal=False)
quats = (
    st.tuples(component, component, component, component)
    .map(np.array)
    .filter(lambda q: np.linalg.norm(q) > 1e-3)
    .map(lambda q: q / np.linalg.norm(q))
)
# where formulas break: identity, half turns about each axis and about none, the smallest angles
HALF_TURNS = [np.array(q, dtype=float) for q in ([1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0.6, -0.8, 0, 0])]
special = st.sampled_from([*HALF_TURNS, np.array([0, 0, 0, 1.0]), np.array([1e-9, 0, 0, 1.0])])
rotations = st.one_of(quats, special).map(lambda q: q / np.linalg.norm(q))
vectors = st.tuples(*[st.floats(-10.0, 10.0)] * 3).map(np.array)
ra_deg = st.one_of(
    st.floats(0.0, 360.0, exclude_max=True), st.sampled_from([0.0, 90.0, 180.0, 270.0, 1e-13, 359.9999999])
)
dec_deg = st.one_of(
    st.floats(-90.0, 90.0), st.sampled_from([-90.0, 90.0, 0.0, 89.9999999, -89.9999999, 90 - 1e-12, 1e-300])
)


def scipy_matrix(quat):
    return Rotation.from_quat(quat).as_matrix().T


# ---------------------------------------------------------------- kernels
@given(quats, st.floats(-12.0, 12.0))
def test_a_stored_attitude_is_read_back_bit_by_bit(quat, exponent):
    attitude = Attitude(quat * 10.0**exponent)
    np.testing.assert_array_equal(Attitude(attitude.quat).quat, attitude.quat)
    assert attitude.quat @ attitude.quat == pytest.approx(1.0, rel=0.0, abs=9e-16)  # 4 eps


@given(rotations)
def test_matrix_of_a_quaternion_and_back(quat):
    matrix = quat_to_matrix(quat)
    np.testing.assert_allclose(matrix, scipy_matrix(quat), atol=8e-15)
    back = matrix_to_quat(matrix)
    assert back[3] >= 0
    assert abs(back @ quat) == pytest.approx(1.0, abs=3e-14)  # q and −q are the same rotation
    np.testing.assert_allclose(quat_to_matrix(back), matrix, atol=8e-15)


@given(rotations, rotations)
def test_product_of_quaternions_is_that_of_matrices(second, first):
    np.testing.assert_allclose(
        quat_to_matrix(quat_multiply(second, first)), scipy_matrix(second) @ scipy_matrix(first), atol=3e-14
    )


@given(vectors)
@example(np.array([math.pi, 0, 0]))
@example(np.array([0.0, 0, 0]))
@example(np.array([0, 2 * math.pi, 0]))
@example(np.array([1e-9, 2e-9, 0]))
def test_rotation_vector_turns_the_frame_right_handedly(vector):
    np.testing.assert_allclose(
        rotation_vector_to_matrix(vector), Rotation.from_rotvec(vector).as_matrix().T, atol=3e-14
    )


@given(ra_deg, dec_deg)
def test_direction_round_trip(ra, dec):
    direction = radec_to_direction(math.radians(ra), math.radians(dec))
    assert np.linalg.norm(direction) == pytest.approx(1.0, abs=1e-15)
    ra_back, dec_back = direction_to_radec(3.7 * direction)
    assert 0.0 <= ra_back < 2 * math.pi
    np.testing.assert_allclose(radec_to_direction(ra_back, dec_back), direction, atol=1e-15)
    assert math.degrees(dec_back) == pytest.approx(dec, abs=1e-13)


def test_right_ascension_never_rounds_up_to_a_full_turn():
    # −1e-17 + 2π is 2π in floating point
    ra, _ = direction_to_radec(np.array([[1.0, -1e-17, 0.0], [1.0, -0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]))
    assert np.all((ra >= 0.0) & (ra < 2 * math.pi))
    assert not np.signbit(ra).any()


# ---------------------------------------------------------------- boresight and roll
@given(ra_deg, dec_deg, st.floats(0.0, 360.0, exclude_max=True))
@example(0.0, 90.0, 0.0)
@example(123.0, -90.0, 45.0)
@example(0.0, 0.0, 180.0)
def test_radec_roll_round_trip(ra, dec, roll):
    attitude = Attitude.from_radec_roll(ra, dec, roll)
    assert 0.0 <= attitude.ra_deg < 360.0
    assert 0.0 <= attitude.roll_deg < 360.0
    assert attitude.dec_deg == pytest.approx(dec, abs=1e-13 if abs(dec) < 89 else 3e-14 / 1e-2)
    again = Attitude.from_radec_roll(attitude.ra_deg, attitude.dec_deg, attitude.roll_deg)
    # also at the poles, where RA and roll are one angle shared between two names
    assert attitude.angle_to(again) < 3e-14
    if abs(dec) < 89.9:
        for given_deg, found in ((ra, attitude.ra_deg), (roll, attitude.roll_deg)):
            assert abs((found - given_deg + 180.0) % 360.0 - 180.0) < 1e-13 / math.cos(math.radians(dec)) * 10


@given(ra_deg, dec_deg, st.floats(0.0, 360.0))
def test_camera_axes_on_the_sky(ra, dec, roll):
    """SciPy's Euler angles: axes turned by RA about z, by −Dec about the new y: boresight, east, north."""
    attitude = Attitude.from_radec_roll(ra, dec, roll)
    boresight, east, north = Rotation.from_euler("ZY", [ra, -dec], degrees=True).as_matrix().T
    psi = math.radians(roll)
    up = math.cos(psi) * north + math.sin(psi) * east
    matrix = attitude.as_matrix()
    np.testing.assert_allclose(matrix[2], boresight, atol=3e-14)
    np.testing.assert_allclose(-matrix[1], up, atol=3e-14)
    # seen from inside the sphere, east is to the left of north
    np.testing.assert_allclose(-matrix[0], math.cos(psi) * east - math.sin(psi) * north, atol=3e-14)


@given(rotations)
def test_any_attitude_is_given_by_its_three_angles(quat):
    attitude = Attitude(quat)
    angles = Attitude.from_radec_roll(attitude.ra_deg, attitude.dec_deg, attitude.roll_deg)
    assert attitude.angle_to(angles) < 3e-14


# ---------------------------------------------------------------- the value object
@given(rotations, rotations, vectors)
def test_composition_and_inverse(first, second, vector):
    one, two = Attitude(first, "icrs", "body"), Attitude(second, "body", "camera")
    both = two @ one
    assert (both.source, both.target) == ("icrs", "camera")
    np.testing.assert_allclose(both.as_matrix(), scipy_matrix(second) @ scipy_matrix(first), atol=3e-14)
    np.testing.assert_allclose(both.apply(vector), two.apply(one.apply(vector)), atol=1e-13)
    np.testing.assert_allclose(both.inverse.apply(both.apply(vector)), vector, atol=1e-13)
    assert (both.inverse.source, both.inverse.target) == ("camera", "icrs")
    assert (both.inverse @ both).angle_to(Attitude(np.array([0, 0, 0, 1.0]), "icrs", "icrs")) < 3e-14


@given(rotations, vectors)
def test_apply_takes_any_shape(quat, vector):
    many = np.broadcast_to(vector, (2, 4, 3))
    np.testing.assert_allclose(Attitude(quat).apply(many)[1, 3], scipy_matrix(quat) @ vector, atol=1e-13)


@given(rotations, vectors)
def test_rotation_vector_between_attitudes(quat, vector):
    """The error of an estimate turned from the truth by a known vector of any length up to π."""
    angle = np.linalg.norm(vector)
    assume(angle > 0)
    vector = vector / angle * (angle % math.pi)
    truth = Attitude(quat)
    estimate = Attitude.from_rotation_vector(vector, "camera", "camera") @ truth
    found = truth.rotation_vector_to(estimate)
    expected = Rotation.from_matrix(estimate.as_matrix() @ truth.as_matrix().T).inv().as_rotvec()
    assert np.linalg.norm(found) <= math.pi * (1 + 1e-15)
    # close to a half turn the axis has two directions: compare the turns themselves
    np.testing.assert_allclose(rotation_vector_to_matrix(found), rotation_vector_to_matrix(vector), atol=3e-14)
    if np.linalg.norm(vector) < 3.0:
        np.testing.assert_allclose(found, vector, atol=3e-14)
        np.testing.assert_allclose(found, expected, atol=3e-14)
    assert truth.angle_to(estimate) == pytest.approx(np.linalg.norm(vector), abs=3e-14)


@pytest.mark.parametrize("axis", [[1, 0, 0], [0, -1, 0], [0, 0, 1], [0.6, 0, -0.8], [1, 1, 1]])
@given(quat=rotations)
def test_half_turn(axis, quat):
    axis = np.array(axis) / np.linalg.norm(axis)
    truth = Attitude(quat)
    found = truth.rotation_vector_to(Attitude.from_rotation_vector(math.pi * axis, "camera", "camera") @ truth)
    assert np.linalg.norm(found) == pytest.approx(math.pi, abs=3e-14)
    assert abs(found @ axis) == pytest.approx(math.pi, abs=1e-13)


@pytest.mark.parametrize("angle_rad", [0.0, 1e-300, 1e-160, 1e-12, 1e-8, 1e-4])
def test_smallest_errors_keep_their_digits(angle_rad):
    # against the identity, so that nothing but the formula can lose them
    identity = Attitude(np.array([0, 0, 0, 1.0]))
    vector = angle_rad * np.array([0.6, 0.0, -0.8])
    estimate = Attitude.from_rotation_vector(vector, "camera", "camera") @ identity
    np.testing.assert_allclose(identity.rotation_vector_to(estimate), vector, rtol=1e-14, atol=0)


@given(rotations)
def test_sign_and_length_of_the_quaternion_do_not_matter(quat):
    one, two = Attitude(quat), Attitude(-17.5 * quat)
    np.testing.assert_allclose(one.as_matrix(), two.as_matrix(), atol=8e-15)
    assert one.as_quat()[3] >= 0
    assert np.linalg.norm(one.as_quat()) == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize("scale", [1e-200, 1e200])
def test_quaternions_of_any_finite_length(scale):
    quat = np.array([0.5, -0.5, 0.5, 0.5])
    np.testing.assert_allclose(Attitude(scale * quat).as_quat(), quat, atol=1e-15)


# ---------------------------------------------------------------- refusals
def test_frames_that_do_not_join():
    mounting = Attitude(np.array([0, 0, 0, 1.0]), "body", "camera")
    level = Attitude(np.array([0, 0, 0, 1.0]), "icrs", "local_level")
    with pytest.raises(FrameMismatchError, match="'local_level' is not 'body'"):
        _ = mounting @ level
    with pytest.raises(FrameMismatchError, match="cannot be compared"):
        mounting.rotation_vector_to(level)
    with pytest.raises(FrameMismatchError):
        mounting.angle_to(mounting.inverse)


@pytest.mark.parametrize("quat", [[0, 0, 0, 0], [0, 0, math.nan, 1], [0, math.inf, 0, 1], [0, 0, 1], [[0, 0, 0, 1]]])
def test_quaternions_that_are_none(quat):
    with pytest.raises(InputError, match="finite, non-zero quaternion"):
        Attitude(np.array(quat, dtype=float))


@pytest.mark.parametrize(
    "matrix",
    [
        np.diag([1.0, 1, -1]),
        2 * np.eye(3),
        np.eye(2),
        np.full((3, 3), math.nan),
        np.array([[1, 1e-5, 0], [0, 1, 0], [0, 0, 1]]),
    ],
)
def test_matrices_that_are_no_rotation(matrix):
    with pytest.raises(InputError, match="orthogonal"):
        Attitude.from_matrix(matrix)


def test_nothing_can_be_changed_afterwards():
    source = np.array([0, 0, 0, 1.0])
    attitude = Attitude(source)
    source[0] = 5.0
    assert attitude.as_quat()[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        attitude.as_quat()[0] = 1.0
    with pytest.raises(AttributeError):
        attitude.quat = source
