"""The fit of `startracker.estimation.pose` against a plain NumPy twin, and what it rests on."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import f as f_distribution

from startracker import Attitude, Camera, StarTracker
from startracker.core import SPEED_OF_LIGHT_KM_S
from startracker.errors import InputError
from startracker.estimation import pose
from startracker.estimation.few_stars import few_stars_factor
from startracker.estimation.pose import Linearised, displacements, fit_pose
from startracker.geometry.image_map import pixel_slopes
from startracker.observer import Observer, aberrate, unknown_aberration
from startracker.solution import MatchedStars

CAMERA = Camera.from_fov(12.0, 1024, 1024)


def twin(residual, slopes, offset, covariance, extra, extra_sigma, trusted, first, models, shape=(1.0, 0.0, 1.0)):
    """Mean of the rotation and its covariance, by the equations of the module's docstring, model by model."""
    x, y = offset.T
    columns = [slopes[:, :, k] for k in range(3)] + [extra[:, :, k] for k in range(extra.shape[2])]
    columns += [offset, np.stack([x, -y], axis=1), np.stack([y, x], axis=1)]
    known, freedom = extra.shape[2], residual.size - 3.0
    unit = np.median(np.trace(covariance, axis1=1, axis2=2) / 2.0)
    priors = [
        extra_sigma,
        [*extra_sigma, pose.FOCAL_SIGMA if first == 0 else pose.FREE_FOCAL_SIGMA],
        [*extra_sigma, pose.FREE_FOCAL_SIGMA, pose.SHEAR_SIGMA, pose.SHEAR_SIGMA],
    ]
    weight, means, spreads = [], [], []
    for t, tau in enumerate(pose.SYSTEMATIC if trusted else [0.0]):
        inverse = np.linalg.inv(covariance + tau**2 * unit * np.array([shape[:2], shape[1:]]))
        big = np.zeros((residual.size, residual.size))
        for n in range(len(residual)):
            big[2 * n : 2 * n + 2, 2 * n : 2 * n + 2] = inverse[n]
        for m in range(first, models):
            size = (3 + known, 4 + known, 6 + known)[m]
            h = np.stack([c.reshape(-1) for c in columns[:size]], axis=1)
            precision = np.concatenate([np.zeros(3), 1.0 / np.array(priors[m], dtype=float) ** 2])
            normal = h.T @ big @ h + np.diag(precision)
            r = residual.reshape(-1)
            mean = np.linalg.solve(normal, h.T @ big @ r)
            chi2 = r @ big @ r - mean @ h.T @ big @ r
            log = np.linalg.slogdet(big)[1] + np.log(precision[3:]).sum() - np.linalg.slogdet(normal)[1]
            log -= (trusted + freedom) * np.log(trusted + chi2)
            prior = pose._PRIOR_OF_MODELS[m] + pose._PRIOR_OF_SYSTEMATIC[t] + np.log(pose.AS_ASSUMED)
            weight.append(0.5 * log + prior)
            factor = (trusted + chi2) / (trusted + freedom - (2.0 if trusted else 0.0))
            if not trusted:
                factor = max(factor, pose.UNKNOWN_FLOOR_PX**2 / unit)
            means.append(mean[:3])
            spreads.append(factor * np.linalg.inv(normal)[:3, :3])
            if m == 2:
                spreads[-1][2, 2] += mean[-1] ** 2
    weight = np.exp(np.array(weight) - max(weight))
    weight /= weight.sum()
    centre = weight @ np.array(means)
    away = np.array(means) - centre
    return centre, np.tensordot(weight, np.array(spreads), 1) + (away * weight[:, None]).T @ away


def problem(seed, stars, scale=0.0, columns=0):
    rng = np.random.default_rng(seed)
    vectors = CAMERA.unproject(rng.uniform(0, 1023, (stars, 2)))
    slopes, offset = pixel_slopes(vectors, CAMERA.image_map), CAMERA.project(vectors) - (CAMERA.cx, CAMERA.cy)
    half = rng.normal(size=(stars, 2, 2)) * 0.02
    covariance = half @ half.transpose(0, 2, 1) + 0.02**2 * np.eye(2)
    residual = np.einsum("nij,nj->ni", np.linalg.cholesky(covariance), rng.normal(size=(stars, 2))) + scale * offset
    extra = rng.normal(size=(stars, 2, columns))
    return Linearised(residual, slopes, offset, covariance, extra, np.full(columns, 0.05))


@pytest.mark.parametrize(("stars", "scale", "columns"), [(3, 0.0, 0), (8, 0.0, 1), (30, 3e-4, 0), (30, 0.0, 3)])
@pytest.mark.parametrize(("trusted", "first", "models"), [(20.0, 0, 3), (20.0, 1, 2), (0.0, 0, 3)])
def test_the_kernel_is_its_twin(stars, scale, columns, trusted, first, models):
    given = problem(stars, stars, scale, columns)
    found = fit_pose(given, trusted, first, models, 1)
    turn, covariance = twin(*given[:6], trusted, first, models)
    sigma = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(found.turn / sigma, turn / sigma, atol=1e-6)
    np.testing.assert_allclose(
        found.covariance / np.outer(sigma, sigma), covariance / np.outer(sigma, sigma), atol=1e-6
    )


def test_a_systematic_error_along_one_direction_is_told_so():
    """0.2 px along 30° where errors of 0.03 px are stated: the covariance is larger in that direction only."""
    direction = np.array([np.cos(np.pi / 6), np.sin(np.pi / 6)])
    rng, ratios = np.random.default_rng(31), []
    for seed in range(60):
        given = problem(seed, 40)
        given[0][:] += 0.2 * rng.normal(size=(40, 1)) * direction
        found = fit_pose(given, 20.0, 0, 3, 1)
        # about an axis across the boresight the image moves across that axis
        pixels = np.linalg.norm(given[1][:, :, :2], axis=(1, 2)).mean() / np.sqrt(2.0)
        along, across = np.array([-direction[1], direction[0]]), direction
        ratios.append([pixels * np.sqrt(40 * v @ found.covariance[:2, :2] @ v) for v in (along, across)])
    along, across = np.mean(ratios, axis=0)
    # the prior of the stated errors pulls it down
    assert along == pytest.approx(0.2, rel=0.2)
    assert across < 0.08  # 0.15 with a round one
    columns = pose._columns(given)
    iso = pose._fit_models(given, columns, 20.0, 0, 3, np.eye(2))
    shape = pose._shape_of_systematic(given[0], columns, iso)
    assert np.trace(shape) == pytest.approx(2.0)
    turn, covariance = twin(*given[:6], 20.0, 0, 3, (shape[0, 0], shape[0, 1], shape[1, 1]))
    np.testing.assert_allclose(found.turn, turn, rtol=1e-6)
    np.testing.assert_allclose(found.covariance, covariance, rtol=1e-6, atol=1e-9 * covariance.max())


def test_a_focal_length_that_is_off_is_found():
    given = problem(5, 30, 4e-4)
    found = fit_pose(given, 20.0, 0, 3, 1)
    # 30 stars of 0.03 px some 400 px from the centre tell it to 2e-6 or so; its prior pulls by less
    assert found.unknowns[0] == pytest.approx(4e-4, abs=2e-5)
    moved = displacements(given.offset, given.extra, found.unknowns)
    np.testing.assert_allclose(moved, 4e-4 * given[2], atol=0.02)
    assert found.systematic_px2 < 0.02**2


def test_where_nothing_is_wrong_the_covariance_is_the_plain_one():
    ratios = []
    for seed in range(200):
        given = problem(seed, 30)
        plain = np.linalg.inv(np.einsum("nki,nkl,nlj->ij", given[1], np.linalg.inv(given[3]), given[1]))
        ratios.append(np.diag(fit_pose(given, 20.0, 0, 3, 1).covariance) / np.diag(plain))
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.08)


def test_slopes_are_differences_of_turned_cameras():
    vectors = CAMERA.unproject([[100.0, 900.0], [512.0, 512.0]])
    slopes = pixel_slopes(vectors, CAMERA.image_map)
    turn = np.array([1e-6, -2e-6, 3e-6])
    moved = CAMERA.project(vectors - np.cross(turn, vectors)) - CAMERA.project(vectors)
    np.testing.assert_allclose(slopes @ turn, moved, atol=1e-7)


@pytest.mark.parametrize("freedom", [1, 3, 7, 57])
def test_few_stars_factor_is_the_quantile_of_f(freedom):
    # χ² of 3 exceeds 16.26624 once in 1000, and 11.34487 once in 100
    assert few_stars_factor(freedom) == pytest.approx(3.0 * f_distribution.isf(0.001, 3, freedom) / 16.26624, rel=1e-5)
    expected = 3.0 * f_distribution.isf(0.01, 3, freedom) / 11.34487
    assert few_stars_factor(freedom, 0.99) == pytest.approx(expected, rel=1e-5)


def test_unknown_aberration_is_the_scatter_over_the_year():
    rng = np.random.default_rng(6)
    attitude = Attitude.from_radec_roll(130.0, 55.0, 20.0)
    field = attitude.inverse.apply(CAMERA.unproject(rng.uniform(0, 1023, (40, 2))))
    angle, tilt = rng.uniform(0, 2 * np.pi, 4000), np.radians(23.4393)
    earth = 29.8 * np.stack([np.cos(angle), np.sin(angle) * np.cos(tilt), np.sin(angle) * np.sin(tilt)], axis=1)
    orbit = rng.normal(size=(4000, 3))
    velocity = earth + 7.6 * orbit / np.linalg.norm(orbit, axis=1, keepdims=True)
    vectors = attitude.apply(field)
    normal = np.einsum("nij,nik->jk", skew(vectors), skew(vectors))
    turns = []
    for v in velocity:
        moved = attitude.apply(aberrate(field, v)) - vectors
        turns.append(np.linalg.solve(normal, np.einsum("nij,ni->j", skew(vectors), moved)))
    found, expected = np.cov(np.array(turns).T), unknown_aberration(attitude.as_matrix())
    size = (29.8 / SPEED_OF_LIGHT_KM_S) ** 2
    # variances of 4000 numbers are good to 2.2 %; the field's size adds 1 %
    np.testing.assert_allclose(found / size, expected / size, atol=0.05)


def skew(v):
    """Matrices M (N, 3, 3) with M θ = −θ × v."""
    zero = np.zeros(len(v))
    x, y, z = v.T
    return np.stack([np.stack(r, axis=1) for r in ((zero, -z, y), (z, zero, -x), (-y, x, zero))], axis=1)


def test_a_rolling_shutter_is_part_of_the_camera(tmp_path):
    camera = Camera(2000.0, 2000.0, 511.5, 511.5, row_time_s=1e-5)
    camera.to_yaml(tmp_path / "camera.yaml")
    assert Camera.from_yaml(tmp_path / "camera.yaml") == camera
    with pytest.raises(InputError, match="row_time_s"):
        Camera(2000.0, 2000.0, 511.5, 511.5, row_time_s=np.inf)


@pytest.fixture(scope="module")
def tracker():
    return StarTracker(CAMERA, magnitude_limit=6.0)


@pytest.mark.parametrize("sigma", [-1.0, 0.0, np.nan, np.inf, [0.1, 0.2], "much", np.ones((20, 2))])
def test_errors_that_are_none_are_refused(tracker, sigma):
    _, _, xy = tracker.guide.in_field(Attitude.from_radec_roll(85.0, -2.0, 30.0).as_matrix())
    with pytest.raises(InputError, match="sigma_px"):
        tracker.solve_centroids(xy[:20], sigma_px=sigma)


def test_stated_errors_go_with_their_stars(tracker):
    """Stars of a tenth of the error decide; the list is given in any order, with points that are left out."""
    rng, attitude = np.random.default_rng(3), Attitude.from_radec_roll(85.0, -2.0, 30.0)
    index, _, xy = tracker.guide.in_field(attitude.as_matrix())
    sigma = np.where(np.arange(len(xy)) % 2, 0.02, 0.5)
    flux = 10.0 ** (-0.4 * tracker.guide.v_mag[index])
    seen = xy + sigma[:, None] * rng.normal(size=xy.shape)
    order = rng.permutation(len(xy) + 1)
    seen, sigma = np.vstack([seen, [[np.nan, 3.0]]])[order], np.append(sigma, 1.0)[order]
    observer = Observer(tracker.guide.epoch_jyear, np.zeros(3))
    solution = tracker.solve_centroids(seen, np.append(flux, 1.0)[order], sigma_px=sigma, observer=observer)
    error = attitude.rotation_vector_to(solution.attitude)
    assert error @ np.linalg.solve(solution.covariance, error) < 21.1  # χ² of 3 exceeds it once in 10⁴
    vectors = solution.camera.unproject(solution.stars.xy)
    assert solution.matched == len(xy)
    of_row = {tuple(p): s for p, s in zip(seen.tolist(), sigma, strict=True)}
    told = np.array([of_row[tuple(p)] for p in solution.stars.xy.tolist()])
    slopes = pixel_slopes(vectors, CAMERA.image_map)
    plain = np.linalg.inv(np.einsum("nki,n,nkj->ij", slopes, told**-2.0, slopes))
    np.testing.assert_allclose(np.diag(solution.covariance) / np.diag(plain), 1.0, atol=0.25)


def test_stars_left_out_of_the_fit():
    columns = (
        np.arange(6.0).reshape(3, 2),
        np.array([3, 5, 8]),
        np.array(["a", "b", "c"]),
        *np.ones((2, 3)),
        np.ones((3, 2)),
    )
    assert MatchedStars(*columns).used.all()
    stars = MatchedStars(*columns, np.array([True, False, True]))
    assert stars.fitted.catalog_id.tolist() == [3, 8]
    assert stars.fitted.used.all()
    assert len(MatchedStars.none().fitted) == 0


def test_matched_stars_of_guide_stars():
    catalog = SimpleNamespace(id=np.array([3, 5, 8]), star_name=np.array(["a", "b", "c"]))
    guide = SimpleNamespace(catalog=catalog, v_mag=np.array([1.0, 2.0, 3.0]))
    xy, residual_px = np.arange(4.0).reshape(2, 2), np.ones((2, 2))
    stars = MatchedStars.of(guide, np.array([2, 0]), xy, residual_px)
    assert (stars.catalog_id.tolist(), stars.name.tolist(), stars.v_mag.tolist()) == ([8, 3], ["c", "a"], [3.0, 1.0])
    assert stars.used.all()
    assert np.isnan([stars.flux, stars.sigma_px]).all()
    given = MatchedStars.of(guide, np.array([1]), xy[:1], residual_px[:1], flux=np.ones(1), used=np.array([False]))
    assert (given.flux.tolist(), given.used.tolist()) == ([1.0], [False])


def test_prior_probabilities_sum_to_one():
    """Of the models, and of the sizes of a systematic error if there is one; larger sizes are less probable."""
    models, sizes = np.exp(pose._PRIOR_OF_MODELS), np.exp(pose._PRIOR_OF_SYSTEMATIC)
    assert models.sum() == pytest.approx(1.0)
    assert (np.diff(models) < 0.0).all()
    assert sizes[0] == 1.0  # of none, given that there is none
    assert sizes[1:].sum() == pytest.approx(1.0)
    assert len(sizes) == len(pose.SYSTEMATIC)
    np.testing.assert_allclose(sizes[3:] / sizes[1:-2], 0.75)  # for each factor of two
    np.testing.assert_allclose(pose.SYSTEMATIC[3:] / pose.SYSTEMATIC[1:-2], 2.0)
    assert pose.SYSTEMATIC[:2].tolist() == [0.0, 0.2]
