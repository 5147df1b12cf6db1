"""The rival estimators agree where they must: all geometries, to rounding over the extent of the stars."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from startracker.errors import InputError
from startracker.estimation import METHODS, davenport, plate_constants, quest, star_pair, triad, wahba_svd
from startracker.estimation import wahba as wahba_module

ARCSEC = np.pi / 648000
OPTIMAL = ["svd", "davenport", "quest", "esoq2"]


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def noisy_case(rng, directions, sigma):
    """Observed and reference directions with errors of `sigma` rad, at a random attitude."""
    truth = Rotation.random(rng=rng).as_matrix()
    return unit(directions + sigma * rng.normal(size=directions.shape)), directions @ truth


def geometries():
    rng = np.random.default_rng(11)
    angle = np.linspace(-0.08, 0.08, 9)
    yield "field", unit(np.column_stack([rng.uniform(-0.08, 0.08, (12, 2)), np.ones(12)])), 0.1
    yield "sphere", unit(rng.normal(size=(12, 3))), 1.0
    yield "two", unit(np.array([[0.05, 0, 1], [-0.05, 0.01, 1]])), 0.1
    yield "two nearly coincident", unit(np.array([[0.3, 0, 1], [0.3 + 1e-4, 0, 1]])), 1e-4
    yield "line through the centre", unit(np.column_stack([angle, 0.5 * angle, np.ones(9)])), 0.1
    yield "great circle", np.column_stack([np.cos(40 * angle), np.sin(40 * angle), np.zeros(9)]), 1.0
    yield "corner", unit(np.column_stack([0.08 + rng.uniform(0, 0.005, (7, 2)), np.ones(7)])), 4e-3
    yield "one apart", unit(np.array([[0, 0, 1], [1e-5, 0, 1], [0, 1e-5, 1], [0.1, 0, 1]])), 0.1
    yield "opposite", unit(np.array([[0, 0, 1], [0, 0, -1], [1e-3, 0, 1.0]])), 1e-3


@pytest.mark.parametrize(("name", "directions", "extent"), list(geometries()), ids=[case[0] for case in geometries()])
@pytest.mark.parametrize("weights", ["even", "uneven"])
def test_the_optimal_ones_agree(name, directions, extent, weights):
    rng = np.random.default_rng([len(name), len(weights)])
    count = len(directions)
    for _ in range(30):
        sigma = np.full(count, ARCSEC) if weights == "even" else ARCSEC * 10.0 ** rng.uniform(-2, 2, count)
        # errors a thousandth of the extent at most
        observed, reference = noisy_case(rng, directions, 1e-3 * extent * sigma[:, None] / sigma.max())
        found = [METHODS[method](observed, reference, sigma) for method in OPTIMAL]
        for estimate in found[1:]:
            turn = estimate.matrix @ found[0].matrix.T
            vector = 0.5 * np.array([turn[1, 2] - turn[2, 1], turn[2, 0] - turn[0, 2], turn[0, 1] - turn[1, 0]])
            # rounding of the directions over their extent; uneven weights leave the turn to a star of 1e-4 the σ⁻¹
            assert np.abs(vector).max() < 2e-13 / extent * (1 if weights == "even" else 100)
            assert np.allclose(estimate.covariance, found[0].covariance, rtol=1e-12)


@pytest.mark.parametrize("method", OPTIMAL)
def test_half_turns_about_every_axis(method):
    # and near them, where QUEST without sequential rotations divides by zero
    rng = np.random.default_rng(12)
    observed = unit(np.column_stack([rng.uniform(-0.08, 0.08, (6, 2)), np.ones(6)]))
    axes = np.vstack([np.eye(3), -np.eye(3), unit(rng.normal(size=(60, 3)))])
    for axis in axes:
        for short in (0.0, 1e-15, 1e-9, 1e-5, 1e-2):
            truth = Rotation.from_rotvec((np.pi - short) * axis).as_matrix()
            found = METHODS[method](observed, observed @ truth, np.full(6, ARCSEC)).matrix
            assert np.abs(found - truth).max() < 1e-13


@pytest.mark.parametrize("method", OPTIMAL)
@pytest.mark.parametrize("angle", [0.0, 1e-16, 1e-9, 1e-4])
def test_no_turn_at_all(method, angle):
    # ESOQ2's matrix vanishes for the identity unless the frame is turned first
    rng = np.random.default_rng(13)
    observed = unit(np.column_stack([rng.uniform(-0.08, 0.08, (6, 2)), np.ones(6)]))
    for axis in np.vstack([np.eye(3), unit(rng.normal(size=(10, 3)))]):
        truth = Rotation.from_rotvec(angle * axis).as_matrix()
        assert np.abs(METHODS[method](observed, observed @ truth, ARCSEC).matrix - truth).max() < 1e-13


@pytest.mark.parametrize("method", ["quest", "esoq2"])
def test_before_the_last_newton_step_the_closed_forms_are_right_already(method, monkeypatch):
    # all over the sphere nothing is lost: the step on the rotation must not be what makes the answer right
    kernel = getattr(wahba_module, f"_{method}_rotation")
    globals_ = dict(kernel.__globals__, _finish=lambda matrix, *_: matrix)
    bare = type(kernel)(kernel.__code__, globals_)
    rng = np.random.default_rng(14)
    for _ in range(200):
        observed, reference = noisy_case(rng, unit(rng.normal(size=(8, 3))), 0.01)
        sigma = np.full(8, 0.01)
        assert np.abs(bare(observed, reference, sigma) - davenport(observed, reference, sigma).matrix).max() < 1e-12


def test_largest_eigenvalue_against_lapack():
    rng = np.random.default_rng(15)
    for _ in range(200):
        observed, reference = noisy_case(rng, unit(rng.normal(size=(6, 3))), 0.1)
        weight = np.full(6, 1 / 6)
        profile = (weight[:, None] * observed).T @ reference
        value, settled = wahba_module.largest_eigenvalue(profile)
        z = np.array([profile[1, 2] - profile[2, 1], profile[2, 0] - profile[0, 2], profile[0, 1] - profile[1, 0]])
        k = np.block([[profile + profile.T - np.trace(profile) * np.eye(3), z[:, None]], [z, np.trace(profile)]])
        assert settled
        assert value == pytest.approx(np.linalg.eigvalsh(k)[-1], abs=1e-13)


@pytest.mark.parametrize("method", OPTIMAL)
@pytest.mark.parametrize("separation", [1e-6, 1e-7, 1e-8])
def test_stars_so_close_that_the_moments_lose_the_turn(method, separation):
    # two stars 2 mas to 0.2″ apart: the turn about them is still known to 1e-16 over the separation
    rng = np.random.default_rng(16)
    observed = unit(np.array([[0.1, 0.2, 1], [0.1 + separation, 0.2, 1]]))
    for truth in Rotation.random(20, rng=rng).as_matrix():
        found = METHODS[method](observed, observed @ truth, ARCSEC).matrix
        assert np.abs(found - truth).max() < 2e-15 / separation


@pytest.mark.parametrize("method", METHODS)
def test_a_duplicate_counts_as_a_better_star(method):
    rng = np.random.default_rng(17)
    directions = unit(np.column_stack([rng.uniform(-0.08, 0.08, (5, 2)), np.ones(5)]))
    observed, reference = noisy_case(rng, directions, 1e-5)
    sigma = np.full(5, 1e-5)
    once = sigma.copy()
    once[0] /= np.sqrt(2)
    twice = [0, 0, 1, 2, 3, 4]
    doubled = METHODS[method](observed[twice], reference[twice], sigma[twice])
    if method in ("triad", "star_pair"):
        assert np.allclose(doubled.matrix, METHODS[method](observed, reference, sigma).matrix, atol=1e-14)
    else:
        single = METHODS[method](observed, reference, once)
        assert np.allclose(doubled.matrix, single.matrix, atol=1e-13)
        assert np.allclose(doubled.covariance, single.covariance, rtol=1e-9)


@pytest.mark.parametrize("method", ["triad", "star_pair", "plate_constants"])
def test_none_is_better_than_optimal(method):
    rng = np.random.default_rng(18)
    for _ in range(20):
        observed = unit(np.column_stack([rng.uniform(-0.3, 0.3, (6, 2)), np.ones(6)]))
        sigma = ARCSEC * rng.uniform(1, 20, 6)
        excess = METHODS[method](observed, observed, sigma).covariance - wahba_svd(observed, observed, sigma).covariance
        assert np.linalg.eigvalsh(excess).min() > -1e-9 * sigma.max() ** 2


def test_triad_lays_the_better_star_on_exactly():
    rng = np.random.default_rng(19)
    observed, reference = noisy_case(rng, unit(np.array([[0.1, 0, 1], [-0.1, 0.05, 1]])), 1e-3)
    matrix = triad(observed, reference, [2e-3, 1e-3]).matrix
    assert np.allclose(matrix @ reference[1], observed[1], atol=1e-15)
    # the other one lies on the great circle that it should
    pole = np.cross(observed[1], observed[0])
    assert abs(pole @ (matrix @ reference[0])) < 1e-15
    pair = star_pair(observed, reference, [1e-3, 1e-3]).matrix
    assert np.abs(pair - matrix).max() > 1e-5  # the symmetric variant shares the error out


def test_plate_constants_leave_the_scale_free():
    # a focal length 1 % wrong moves an off-centre Wahba fit, no plate
    rng = np.random.default_rng(20)
    truth = Rotation.random(rng=rng).as_matrix()
    plane = rng.uniform(-0.05, 0.05, (9, 2))
    true = unit(np.column_stack([plane, np.ones(9)]))
    stretched = unit(np.column_stack([1.01 * plane, np.ones(9)]))
    error = plate_constants(stretched, true @ truth, ARCSEC).matrix @ truth.T - np.eye(3)
    mean = plane.mean(axis=0)
    # the centre of the stars itself moved by 1 % of where it is
    assert error[0, 2] == pytest.approx(0.01 * mean[0], abs=1e-6)
    assert error[1, 2] == pytest.approx(0.01 * mean[1], abs=1e-6)
    assert abs(error[0, 1]) < 1e-5


def test_plate_constants_say_what_they_cannot():
    with pytest.raises(InputError, match="within 78°"):
        plate_constants(np.vstack([np.eye(3), -np.eye(3)]), np.vstack([np.eye(3), -np.eye(3)]), 1e-3)
    mirrored = unit(np.array([[0.1, 0, 1], [-0.1, 0, 1], [0, 0.1, 1], [0, -0.1, 1]]))
    with pytest.raises(InputError, match="do not match"):
        plate_constants(mirrored, mirrored * [1, -1, 1], 1e-3)


def test_mirrored_stars_never_give_a_mirror():
    observed = unit(np.column_stack([np.random.default_rng(5).uniform(-0.1, 0.1, (9, 2)), np.ones(9)]))
    for method in (*OPTIMAL, "triad", "star_pair"):
        matrix = METHODS[method](observed, observed * [1, -1, 1], 1e-5).matrix
        assert np.linalg.det(matrix) == pytest.approx(1.0, abs=1e-12)


def test_equal_largest_eigenvalues_still_give_a_rotation():
    # reference directions that fit two attitudes equally well: QUEST's Newton meets a double root
    observed = np.eye(3)
    reference = -np.eye(3)
    for method in OPTIMAL:
        matrix = METHODS[method](observed, reference, 1e-3).matrix
        assert np.allclose(matrix @ matrix.T, np.eye(3), atol=1e-12)
        assert np.isfinite(matrix).all()
    assert quest(observed, reference, 1e-3).covariance.shape == (3, 3)


def test_the_covariance_is_that_of_each_paper():
    """By the singular values of B, the eigenvalues of K and the sum over the stars: equal where residuals are zero."""
    rng = np.random.default_rng(21)
    for _ in range(20):
        sigma = rng.uniform(0.001, 0.003, 9)
        observed, reference = noisy_case(rng, unit(rng.normal(size=(9, 3))), 0.0)
        profile = (sigma[:, None] ** -2 * observed).T @ reference
        u, s, vt = np.linalg.svd(profile)
        s[2] *= np.linalg.det(u) * np.linalg.det(vt)
        # Markley 1988: variances 1/(sum of the other two singular values) about the columns of U
        markley = u @ np.diag([1 / (s[1] + s[2]), 1 / (s[2] + s[0]), 1 / (s[0] + s[1])]) @ u.T
        # Davenport: variances 2/(λ₁ − λₖ)
        z = np.array([profile[1, 2] - profile[2, 1], profile[2, 0] - profile[0, 2], profile[0, 1] - profile[1, 0]])
        trace = np.trace(profile)
        value = np.linalg.eigvalsh(np.block([[profile + profile.T - trace * np.eye(3), z[:, None]], [z, trace]]))
        # Shuster & Oh 1981
        information = sum((np.eye(3) - np.outer(b, b)) / e**2 for b, e in zip(observed, sigma, strict=True))
        for method in (*OPTIMAL, "field_fit"):
            covariance = METHODS[method](observed, reference, sigma).covariance
            assert np.allclose(covariance, np.linalg.inv(information), rtol=1e-9, atol=0)
            assert np.allclose(covariance, markley, rtol=1e-7, atol=1e-9 * markley.max())
            assert np.allclose(np.linalg.eigvalsh(covariance), 2 / (value[3] - value[:3]), rtol=1e-9, atol=0)
