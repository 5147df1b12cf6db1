"""All outputs of the fit of a field, and the equations of matched directions, against their formulas."""

import math

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.special import gammaln

from startracker.estimation.directions import (
    fit_pairs,
    fit_turn,
    focal_slopes,
    normal_equations,
    pair_frame,
    pair_rotation,
)
from startracker.estimation.few_stars import few_stars_factor, of_unknown_errors, with_doubt
from startracker.estimation.pose import Linearised, Pose, fit_pose
from startracker.geometry.camera import Camera
from startracker.geometry.image_map import pixel_slopes

CAMERA = Camera.from_fov(12.0, 1024, 1024)


def problem(seed, stars, columns=0, noise=1.0, as_assumed=0.5):
    rng = np.random.default_rng(seed)
    vectors = CAMERA.unproject(rng.uniform(0, 1023, (stars, 2)))
    slopes, offset = pixel_slopes(vectors, CAMERA.image_map), CAMERA.project(vectors) - (CAMERA.cx, CAMERA.cy)
    half = rng.normal(size=(stars, 2, 2)) * 0.02
    covariance = half @ half.transpose(0, 2, 1) + 0.02**2 * np.eye(2)
    residual = noise * np.einsum("nij,nj->ni", np.linalg.cholesky(covariance), rng.normal(size=(stars, 2)))
    extra = rng.normal(size=(stars, 2, columns))
    return Linearised(residual, slopes, offset, covariance, extra, np.full(columns, 0.05), as_assumed)


def mixture(given, trusted, first, models):
    """Each model of the module's docstring: ln of its weight, mean, covariance with and without the camera's unknowns,
    factor, τ² and χ²."""
    x, y = given.offset.T
    columns = [given.slopes[:, :, k] for k in range(3)] + [given.extra[:, :, k] for k in range(given.extra.shape[2])]
    columns += [given.offset, np.stack([x, -y], axis=1), np.stack([y, x], axis=1)]
    known, nu, r = given.extra.shape[2], given.residual.size - 3.0, given.residual.reshape(-1)
    unit = np.median(np.trace(given.covariance, axis1=1, axis2=2) / 2.0)
    falling = 0.75 ** (0.5 * np.arange(19))
    prior_of_tau = np.concatenate([[given.as_assumed], (1.0 - given.as_assumed) * falling / falling.sum()])
    taus = np.concatenate([[0.0], 0.2 * 2.0 ** (0.5 * np.arange(19))]) if trusted else [0.0]
    for t, tau in enumerate(taus):
        big = np.zeros((r.size, r.size))
        for n, c in enumerate(given.covariance):
            big[2 * n : 2 * n + 2, 2 * n : 2 * n + 2] = np.linalg.inv(c + tau**2 * unit * np.eye(2))
        for m in range(first, models):
            priors = [*given.extra_sigma]
            priors += [[], [5e-4 if first == 0 else 1e-2], [1e-2, 1e-3, 1e-3]][m]
            h = np.stack([c.reshape(-1) for c in columns[: 3 + len(priors)]], axis=1)
            normal = h.T @ big @ h + np.diag([0.0] * 3 + [sigma**-2 for sigma in priors])
            mean = np.linalg.solve(normal, h.T @ big @ r)
            chi2 = r @ big @ r - mean @ h.T @ big @ r
            log = 0.5 * np.linalg.slogdet(big)[1] - np.sum(np.log(priors)) - 0.5 * np.linalg.slogdet(normal)[1]
            log -= 0.5 * (trusted + nu) * math.log(trusted + chi2)
            if trusted:
                log += gammaln(0.5 * (trusted + nu)) - gammaln(0.5 * trusted)
                log += 0.5 * (trusted * math.log(trusted) - nu * math.log(math.pi))
                factor = (trusted + chi2) / (trusted + nu - 2.0)
            else:
                factor = max(chi2 / nu, 0.003**2 / unit)
            whole = np.zeros((6 + known, 6 + known))
            whole[: len(mean), : len(mean)] = factor * np.linalg.inv(normal)
            padded = np.zeros(6 + known)
            padded[: len(mean)] = mean
            plain = factor * np.linalg.inv((h.T @ big @ h)[:3, :3])
            log += math.log([0.6, 0.3, 0.1][m] * prior_of_tau[t])
            yield log, padded, whole, plain, factor, factor * tau**2 * unit, chi2


@pytest.mark.parametrize(
    ("stars", "columns", "noise", "as_assumed"), [(4, 0, 1.0, 0.5), (9, 2, 3.0, 0.9), (25, 0, 1.5, 0.1)]
)
@pytest.mark.parametrize(("trusted", "first", "models"), [(20.0, 0, 3), (20.0, 1, 2), (0.0, 0, 3), (0.0, 1, 3)])
def test_every_output_is_that_of_the_mixture(stars, columns, noise, as_assumed, trusted, first, models):
    """With a round systematic error, as none here is significantly elongated: that has tests of its own."""
    given = problem(stars, stars, columns, noise, as_assumed)
    found = fit_pose(given, trusted, first, models, 1)
    log, mean, whole, plain, factor, systematic, chi2 = (
        np.array(column) for column in zip(*mixture(given, trusted, first, models), strict=True)
    )
    weight = np.exp(log - log.max())
    evidence = log.max() + math.log(weight.sum())
    weight /= weight.sum()
    centre = weight @ mean
    spread = np.tensordot(weight, whole, 1) + ((mean - centre) * weight[:, None]).T @ (mean - centre)
    covariance = spread[:3, :3].copy()
    covariance[2, 2] += weight @ mean[:, -1] ** 2
    sigma = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(found.turn / sigma, centre[:3] / sigma, atol=1e-6)
    size = np.outer(sigma, sigma)
    np.testing.assert_allclose(found.covariance / size, covariance / size, atol=1e-6)
    np.testing.assert_allclose(
        found.camera_part / size, (covariance - np.tensordot(weight, plain, 1)) / size, atol=1e-6
    )
    unit = np.sqrt(np.diag(spread)[3:]) + 1e-12
    np.testing.assert_allclose(found.unknowns / unit, centre[3:] / unit, atol=1e-6)
    np.testing.assert_allclose(found.unknowns_variance, np.diag(spread)[3:], rtol=1e-5, atol=1e-15)
    assert found.factor == pytest.approx(weight @ factor, rel=1e-6)
    assert found.systematic_px2 == pytest.approx(weight @ systematic, rel=1e-5, abs=1e-15)
    trace = np.trace(given.covariance, axis1=1, axis2=2) / 2.0
    np.testing.assert_allclose(found.sigma_px, np.sqrt(found.factor * trace + found.systematic_px2), rtol=1e-9)
    assert found.log_evidence == pytest.approx(evidence, abs=1e-6)
    assert found.chi2 == pytest.approx(chi2[0], rel=1e-6)


def test_unknown_errors_are_scaled_to_the_residuals():
    """To their mean square, at least 0.003 px, then to the factor of a first fit; in place."""
    for size in (0.3, 1e-5):
        given = problem(7, 6)
        given = given._replace(residual=size * given.residual / np.sqrt(np.mean(given.residual**2)))
        ratios = given.covariance / np.trace(given.covariance, axis1=1, axis2=2).mean()
        once = given._replace(covariance=ratios * max(size, 0.003) ** 2)
        first = fit_pose(once, 0.0, 0, 3, 1)
        twice = fit_pose(once._replace(covariance=once.covariance * first.factor), 0.0, 0, 3, 1)
        two = given._replace(covariance=ratios.copy())
        found = fit_pose(two, 0.0, 0, 3, 2)
        np.testing.assert_allclose(found.covariance, twice.covariance, rtol=1e-9)
        np.testing.assert_allclose(two.covariance, once.covariance * first.factor, rtol=1e-9)
        assert found.systematic_px2 == 0.0


# ---------------------------------------------------------------------- few stars
def pose_of(chi2):
    part = np.diag([1.0, 2.0, 3.0])
    nothing = np.zeros(3)
    return Pose(nothing, 10.0 * part, part, np.array([0.1, 0.2]), 0.0, 1.0, nothing, nothing, 0.0, chi2)


@pytest.mark.parametrize("stars", [1, 2, 3, 8])
def test_few_stars_have_larger_covariances(stars):
    """By F in place of χ² at 99.9 %; by as much as they are in doubt at 99 %; at least one degree of freedom."""
    freedom = max(2 * stars - 3, 1)
    factor = few_stars_factor(freedom)
    found = of_unknown_errors(pose_of(0.0), stars)
    np.testing.assert_allclose(found.covariance, factor * pose_of(0.0).covariance)
    np.testing.assert_allclose(found.camera_part, factor * pose_of(0.0).camera_part)
    np.testing.assert_allclose(found.sigma_px, math.sqrt(factor) * np.array([0.1, 0.2]))
    assert with_doubt(pose_of(0.1 * freedom), stars).covariance[0, 0] == 10.0
    sure = with_doubt(pose_of(1e4), stars)
    np.testing.assert_allclose(sure.covariance, few_stars_factor(freedom, 0.99) * pose_of(0.0).covariance)


# ---------------------------------------------------------------------- matched directions
def directions(rng, count, half=0.2):
    v = np.column_stack([rng.uniform(-half, half, (count, 2)), np.ones(count)])
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def test_focal_slopes_are_differences():
    v = directions(np.random.default_rng(1), 5, 0.8)
    step = 1e-6
    ends = []
    for sign in (1.0, -1.0):
        w = v * [1.0, 1.0, math.exp(sign * step)]
        ends.append(w / np.linalg.norm(w, axis=1, keepdims=True))
    np.testing.assert_allclose(focal_slopes(v), (ends[0] - ends[1]) / (2.0 * step), atol=1e-9)


@pytest.mark.parametrize("unknowns", [3, 4])
def test_normal_equations_of_matched_stars(unknowns):
    """b − p = δ × p − ε ∂b/∂ln f; stars without a partner do not count."""
    rng = np.random.default_rng(2)
    seen, predicted, sigma = directions(rng, 6), directions(rng, 4), rng.uniform(1e-5, 1e-4, 6)
    index, slopes = np.array([2, -1, 0, 3, -1, 0]), rng.normal(size=(6, 3))
    rows, rest = [], []
    for i, k in enumerate(index):
        if k >= 0:
            p = predicted[k]
            columns = [np.cross(axis, p) for axis in np.eye(3)] + ([-slopes[i]] if unknowns == 4 else [])
            rows.append(np.stack(columns, axis=1) / sigma[i])
            rest.append((seen[i] - p) / sigma[i])
    design, values = np.concatenate(rows), np.concatenate(rest)
    normal, right = normal_equations(seen, slopes, predicted, index, sigma, unknowns)
    np.testing.assert_allclose(normal, design.T @ design, rtol=1e-12, atol=1e-3)
    np.testing.assert_allclose(right, design.T @ values, rtol=1e-9, atol=1e-3)


def test_the_most_probable_turn():
    """The least squares of stars and prior together; their information is that of the stars alone."""
    rng = np.random.default_rng(3)
    known, true = directions(rng, 5), np.array([2e-3, -1e-3, 4e-3])
    sigma = rng.uniform(1e-4, 3e-4, 5)
    seen = Rotation.from_rotvec(true).apply(known) + 1e-4 * rng.normal(size=(5, 3))
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    root = np.linalg.cholesky(np.diag([1e6, 4e6, 2e5]) + 1e5)
    precision, index = root @ root.T, np.array([0, 1, -1, 3, 4])
    use = index >= 0

    def cost(turn):
        rest = (seen - Rotation.from_rotvec(turn).apply(known)) / sigma[:, None]
        return np.concatenate([rest[use].ravel(), root.T @ turn])

    best = least_squares(cost, np.zeros(3), xtol=1e-15, ftol=1e-15, gtol=1e-15, x_scale=1e-3)
    turn, covariance, information = fit_turn(seen, sigma, known, index, precision, np.full(3, 1e-3))
    np.testing.assert_allclose(turn, best.x, atol=3e-6)  # steps of 4 mrad are added, not composed: 4e-3² / 4
    predicted = Rotation.from_rotvec(turn).apply(known)[use]
    expected = sum((np.eye(3) - np.outer(p, p)) / s**2 for p, s in zip(predicted, sigma[use], strict=True))
    np.testing.assert_allclose(information, expected, rtol=1e-6, atol=1e-6 * expected.max())
    np.testing.assert_allclose(np.linalg.inv(covariance), expected + precision, rtol=1e-6, atol=1e-6 * expected.max())
    nothing = fit_turn(seen, sigma, known, np.array([0, -1, -1, -1, -1]), np.zeros((3, 3)), np.zeros(3))
    assert np.isnan(nothing[1]).all()


@pytest.mark.parametrize("apart", [1.0, 1e-6])
def test_a_frame_of_two_directions(apart):
    one = np.array([0.6, 0.0, 0.8])
    two = np.array([0.6 * math.cos(apart), 0.6 * math.sin(apart), 0.8])
    frame = pair_frame(one, two)
    np.testing.assert_allclose(frame.T @ frame, np.eye(3), atol=1e-15)
    np.testing.assert_array_equal(frame[:, 0], one)
    assert np.linalg.det(frame) < 0.0 or np.linalg.det(frame) == pytest.approx(1.0)
    assert frame[:, 1] @ np.cross(one, two) > 0.0
    assert frame[:, 2] @ two > 0.0
    turn = Rotation.from_rotvec([0.3, -1.0, 0.7])
    b = np.stack([turn.apply(one), turn.apply(two)])
    np.testing.assert_allclose(pair_rotation(b, np.stack([one, two]), 0, 1), turn.as_matrix(), atol=1e-9)


def test_attitude_of_pairs():
    """From the first star and the one farthest from it, or a given start; a pattern that does not match has none."""
    rng = np.random.default_rng(4)
    guides, turn = directions(rng, 9), Rotation.from_rotvec([0.3, -1.0, 0.7])
    seen = np.ascontiguousarray(turn.apply(guides)[::-1])
    pairs = np.array([[2, 6], [5, 3], [8, 0], [0, 8]])
    for start in (np.zeros((3, 3)), Rotation.from_rotvec([0.31, -1.0, 0.7]).as_matrix()):
        matrix, known = fit_pairs(pairs, seen, guides, np.full(9, 1e-4), start)
        np.testing.assert_allclose(matrix, turn.as_matrix(), atol=1e-12)
        np.testing.assert_array_equal(known, guides[pairs[:, 1]])
    for away, there in ((0.09, True), (0.12, False)):
        start = Rotation.from_rotvec([0.0, 0.0, away]).as_matrix() @ turn.as_matrix()
        assert bool(np.isfinite(fit_pairs(pairs, seen, guides, np.full(9, 1e-4), start)[0][0, 0])) is there
    wrong = np.array([[2, 0], [5, 3], [8, 6], [0, 4]])
    assert np.isnan(fit_pairs(wrong, seen, guides, np.full(9, 1e-4), np.zeros((3, 3)))[0][0, 0])
    # a start with a zero in its corner is one
    half_turn = Rotation.from_rotvec([0.0, 0.0, 0.5 * math.pi]).as_matrix()
    quarter = np.ascontiguousarray((half_turn @ guides.T).T)
    exact = fit_pairs(np.stack([np.arange(9)] * 2, axis=1), quarter, guides, np.full(9, 1e-4), half_turn)
    np.testing.assert_allclose(exact[0], half_turn, atol=1e-12)
