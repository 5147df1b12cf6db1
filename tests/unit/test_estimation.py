"""Attitude estimators: exact rotations, 180°, corners of the field, two stars, bad input."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from startracker.errors import InputError
from startracker.estimation import METHODS, pitch_error_deg, star_pair, wahba_svd
from startracker.estimation.wahba import attitude_covariance
from startracker.geometry.attitude import Attitude

ARCSEC = np.pi / 648000


def field(rng, count, half_deg=5.0, offset_deg=(0.0, 0.0)):
    """Directions (count, 3) about +z, or about a point away from it."""
    angles = np.radians(rng.uniform(-half_deg, half_deg, (count, 2)) + offset_deg)
    vectors = np.column_stack([np.tan(angles), np.ones(count)])
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def check_rotation(matrix):
    assert np.allclose(matrix @ matrix.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(matrix) > 0


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("count", [2, 3, 20])
@pytest.mark.parametrize("offset", [(0, 0), (4, 4), (-4.5, 4.5), (30, 0)])
def test_exact_rotations_come_back(method, count, offset):
    rng = np.random.default_rng([count, abs(int(offset[0]))])
    for truth in Rotation.random(20, rng=rng).as_matrix():
        observed = field(rng, count, 0.4 if offset != (0, 0) else 5.0, offset)
        estimate = METHODS[method](observed, observed @ truth, np.full(count, ARCSEC))
        check_rotation(estimate.matrix)
        separation = np.arccos(np.clip(observed @ observed.T, -1, 1)).max()
        # rounding of the directions, 1e-16, over the separation, and its square for Wahba's B matrix
        assert np.abs(estimate.matrix - truth).max() < 1e-14 / separation**2


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("axis", np.vstack([np.eye(3), [[1, 1, 0], [1, -2, 3]]]).tolist())
def test_half_turns(method, axis):
    truth = Rotation.from_rotvec(np.pi * np.array(axis) / np.linalg.norm(axis)).as_matrix()
    observed = field(np.random.default_rng(1), 8)
    assert np.allclose(METHODS[method](observed, observed @ truth, np.full(8, ARCSEC)).matrix, truth, atol=1e-11)


@pytest.mark.parametrize("method", [name for name in METHODS if name != "plate_constants"])  # no plane holds these
def test_all_round_the_sky_and_opposite_pairs(method):
    rng = np.random.default_rng(2)
    observed = np.vstack([np.eye(3), -np.eye(3)])
    truth = Rotation.random(rng=rng).as_matrix()
    assert np.allclose(METHODS[method](observed, observed @ truth, np.full(6, ARCSEC)).matrix, truth, atol=1e-14)


@pytest.mark.parametrize("method", METHODS)
def test_length_does_not_matter_and_input_is_not_touched(method):
    rng = np.random.default_rng(3)
    truth = Rotation.random(rng=rng).as_matrix()
    observed = field(rng, 6)
    b, r, s = observed * rng.uniform(0.1, 9, (6, 1)), observed @ truth * 7, np.full(6, ARCSEC)
    for array in (b, r, s):
        array.flags.writeable = False
    assert np.allclose(METHODS[method](b, r, s).matrix, truth, atol=1e-12)


def test_weights_follow_the_standard_deviations():
    # a star with a hundred times the error pulls by a ten-thousandth
    rng = np.random.default_rng(4)
    observed = field(rng, 10)
    moved = observed.copy()
    moved[0] += [1e-3, 0, 0]
    sigma = np.full(10, ARCSEC)
    even = Attitude.from_matrix(wahba_svd(moved, observed, sigma).matrix).angle_to(Attitude([0, 0, 0, 1]))
    sigma[0] *= 100
    weighted = Attitude.from_matrix(wahba_svd(moved, observed, sigma).matrix).angle_to(Attitude([0, 0, 0, 1]))
    assert weighted < even / 1000


def test_mirrored_stars_never_give_a_mirror():
    observed = field(np.random.default_rng(5), 9)
    check_rotation(wahba_svd(observed, observed * [1, -1, 1], np.full(9, ARCSEC)).matrix)


def test_covariance_against_the_inverse():
    rng = np.random.default_rng(6)
    observed, sigma = field(rng, 12), ARCSEC * rng.uniform(1, 30, 12)
    information = sum((np.eye(3) - np.outer(b, b)) / s**2 for b, s in zip(observed, sigma, strict=True))
    assert np.allclose(wahba_svd(observed, observed, sigma).covariance, np.linalg.inv(information), rtol=1e-9)


def test_covariance_of_two_stars_equals_the_star_pair_about_the_boresight():
    # two stars: Wahba's weighting differs from the pair's midpoint only across the line
    observed, sigma = field(np.random.default_rng(7), 2), ARCSEC * np.array([2.0, 5.0])
    svd, pair = wahba_svd(observed, observed, sigma), star_pair(observed, observed, sigma)
    middle = observed.sum(axis=0) / np.linalg.norm(observed.sum(axis=0))
    assert middle @ pair.covariance @ middle == pytest.approx(middle @ svd.covariance @ middle, rel=1e-9)
    assert np.linalg.eigvalsh(pair.covariance - svd.covariance).min() > -1e-6 * ARCSEC**2  # never better than optimal


@pytest.mark.parametrize("separation", [1e-3, 1e-5, 1e-7])
def test_covariance_of_nearly_parallel_directions_is_large_and_right(separation):
    # about the mid-direction σ²/(2 sin²(θ/2)): the pseudo-inverse would have said 0 or less
    observed = np.array([[separation / 2, 0, 1], [-separation / 2, 0, 1]])
    observed /= np.linalg.norm(observed, axis=1, keepdims=True)
    covariance = attitude_covariance(observed, np.full(2, ARCSEC))
    assert covariance[2, 2] == pytest.approx(ARCSEC**2 / (2 * (separation / 2) ** 2), rel=1e-5)
    assert covariance[0, 0] == pytest.approx(ARCSEC**2 / 2, rel=1e-5)
    assert wahba_svd(observed, observed, np.full(2, ARCSEC)).covariance[2, 2] == covariance[2, 2]
    assert star_pair(observed, observed, np.full(2, ARCSEC)).covariance[2, 2] == pytest.approx(
        covariance[2, 2], rel=1e-5
    )


def test_pair_chosen_is_the_widest_of_equals_and_shuns_a_bad_star():
    observed = np.array([[-0.08, 0, 1], [0.08, 0.001, 1], [0.0, 0.05, 1], [0.02, 0.01, 1]])
    observed /= np.linalg.norm(observed, axis=1, keepdims=True)
    sigma = np.full(4, ARCSEC)
    moved = observed.copy()
    moved[2:] += 0.01  # what the other stars say must not matter
    assert np.allclose(star_pair(moved, observed, sigma).matrix, np.eye(3), atol=1e-12)
    sigma[0] *= 50
    moved = observed.copy()
    moved[[0, 3]] += 0.01
    assert np.allclose(star_pair(moved, observed, sigma).matrix, np.eye(3), atol=1e-12)


def test_pair_turns_the_plane_as_the_thesis_does():
    # small field at the boresight: the pitch θ = ρ − ξ of eqs. 5.6 to 5.8, and the shift of the stars turned by it
    # (eqs. 5.9 to 5.12) for roll and yaw; the plane differs from the sphere by the cube of the field, 1e-6 for 0.01 rad
    rng = np.random.default_rng(8)
    for turn in rng.uniform(-np.pi, np.pi, 20):
        truth = Attitude.from_rotation_vector([2e-4, -3e-4, 0], "b", "c") @ Attitude.from_rotation_vector(
            [0, 0, turn], "a", "b"
        )
        reference = field(rng, 2, 0.5)
        observed = truth.apply(reference)
        plane_f, plane_g = observed[:, :2] / observed[:, 2:], reference[:, :2] / reference[:, 2:]
        rho = np.arctan2(*(plane_f[1] - plane_f[0])[::-1])
        xi = np.arctan2(*(plane_g[1] - plane_g[0])[::-1])
        theta = rho - xi
        rotation = np.array([[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]])
        shift = plane_f.mean(axis=0) - rotation @ plane_g.mean(axis=0)
        thesis = Attitude.from_rotation_vector([shift[1], -shift[0], 0], "b", "c")
        thesis = thesis @ Attitude.from_rotation_vector([0, 0, -theta], "a", "b")
        found = Attitude.from_matrix(star_pair(observed, reference, np.full(2, ARCSEC)).matrix, "a", "c")
        assert found.angle_to(truth) < 1e-12
        cross = found.rotation_vector_to(thesis)
        assert np.abs(cross[:2]).max() < 1e-6
        assert abs(cross[2]) < 1e-4


def test_pitch_error_falls_with_separation():
    error = pitch_error_deg(np.arange(1.0, 11), np.arange(1.0, 11), 0.002)
    assert np.all(np.diff(error) < 0)
    assert pitch_error_deg(1.0, 1.0, 0.0) == 0.0


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("observed", "reference", "sigma", "match"),
    [
        (np.empty((0, 3)), np.empty((0, 3)), np.empty(0), "two observed directions; got 0"),
        (np.eye(3)[:1], np.eye(3)[:1], np.ones(1), "two observed directions; got 1"),
        (np.eye(3)[[0, 0]], np.eye(3)[[0, 1]], np.ones(2), "two distinct observed"),
        (np.eye(3)[[0, 1]], np.eye(3)[[2, 2]], np.ones(2), "two distinct reference"),
        (np.eye(3)[[0, 0]] * [[1], [-1]], np.eye(3)[:2], np.ones(2), "two distinct observed"),
        (np.ones((3, 3)), np.ones((3, 3)), np.ones(3), "lie along one axis"),
        (np.eye(3), np.eye(3)[:2], np.ones(3), "must both be"),
        (np.eye(3)[:, :2], np.eye(3)[:, :2], np.ones(3), "must both be"),
        (np.eye(3), np.eye(3), np.ones(2), "as many standard deviations"),
        (np.eye(3), np.eye(3), np.zeros(3), "positive and finite"),
        (np.eye(3), np.eye(3), -np.ones(3), "positive and finite"),
        (np.eye(3), np.eye(3), np.full(3, np.nan), "positive and finite"),
        (np.eye(3) * np.nan, np.eye(3), np.ones(3), "finite and not zero"),
        (np.eye(3) * 0, np.eye(3), np.ones(3), "finite and not zero"),
    ],
)
def test_unusable_input(method, observed, reference, sigma, match):
    with pytest.raises(InputError, match=match):
        METHODS[method](observed, reference, sigma)


@pytest.mark.parametrize("method", METHODS)
def test_one_sigma_for_all(method):
    observed = field(np.random.default_rng(9), 5)
    one = METHODS[method](observed, observed, ARCSEC)
    assert np.array_equal(one.covariance, METHODS[method](observed, observed, np.full(5, ARCSEC)).covariance)
