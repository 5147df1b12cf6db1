"""Hypotheses of displaced stars, and the factors of the covariance of few stars."""

import math

import numpy as np
import pytest
from scipy.stats import chi2

from startracker import Camera
from startracker.estimation.few_stars import doubt_of_stated_errors, with_doubt
from startracker.estimation.outliers import MOST_STARS, average, is_suspicious, log_weight, rows_of
from startracker.estimation.pose import TRUSTED, Linearised, Pose, fit_pose
from startracker.geometry.image_map import pixel_slopes

CAMERA = Camera.from_fov(12.0, 1024, 1024)
SIGMA_PX = 0.02


def stars_of(seed, count, displaced_px=0.0):
    """Stars of the true attitude with errors as stated, the last of them displaced along x."""
    rng = np.random.default_rng(seed)
    vectors = CAMERA.unproject(rng.uniform(0.0, 1023.0, (count, 2)))
    residual = rng.normal(0.0, SIGMA_PX, (count, 2))
    residual[-1, 0] += displaced_px
    offset = CAMERA.project(vectors) - (CAMERA.cx, CAMERA.cy)
    covariance = np.tile(SIGMA_PX**2 * np.eye(2), (count, 1, 1))
    slopes = pixel_slopes(vectors, CAMERA.image_map)
    return Linearised(residual, slopes, offset, covariance, np.empty((count, 2, 0)), np.empty(0))


def fit_of(stars):
    return lambda rows: fit_pose(rows_of(stars, rows), TRUSTED, 0, 3, 1)


@pytest.mark.parametrize("count", [5, 8])
def test_a_displaced_star_is_left_out(count):
    stars = stars_of(6, count, 1.0)
    pose, used = average(stars, fit_of(stars))
    assert used.tolist() == [True] * (count - 1) + [False]
    alone = fit_of(stars)(np.arange(count - 1))
    np.testing.assert_allclose(pose.turn, alone.turn)  # no other hypothesis has a twentieth of its weight
    np.testing.assert_allclose(pose.covariance, alone.covariance)


def test_two_displaced_stars_are_left_out():
    stars = stars_of(2, 8, 1.0)
    stars.residual[0, 1] -= 0.6
    _, used = average(stars, fit_of(stars))
    assert used.tolist() == [False] + [True] * 6 + [False]


def test_errors_of_all_stars_are_no_displaced_star():
    stars = stars_of(3, 10)
    stars.residual[:] *= 5.0
    _, used = average(stars, fit_of(stars))
    assert used.all()


def test_a_displacement_that_is_uncertain_enlarges_the_covariance():
    """The covariance of the mixture exceeds that of each hypothesis by the scatter of their means."""
    larger = 0
    for seed in range(40):
        stars = stars_of(seed, 5, 6.0 * SIGMA_PX)
        pose, used = average(stars, fit_of(stars))
        best = fit_of(stars)(np.flatnonzero(used))
        larger += not np.allclose(pose.turn, best.turn)
        np.testing.assert_allclose(pose.camera_part - best.camera_part, pose.covariance - best.covariance, atol=1e-20)
    assert larger > 10


def test_evidence_is_comparable_between_numbers_of_stars():
    """p(S) of the stars is p(S without one) times the predictive density of this one: for errors as stated, its mean
    over draws is the density's own, ∫ q² dr, of a Gaussian 1/(4π |Σ|^(1/2)), to a few tens of per cent."""
    ratios = []
    for seed in range(300):
        stars = stars_of(seed, 12)
        fits = fit_of(stars)
        less = fits(np.arange(11))
        spread = stars.slopes[-1] @ less.covariance @ stars.slopes[-1].T + stars.covariance[-1]
        expected = 1.0 / (4.0 * math.pi * math.sqrt(np.linalg.det(spread)))
        ratios.append(math.exp(fits(np.arange(12)).log_evidence - less.log_evidence) / expected)
    # the density varies uniformly between 0 and twice its mean: standard error 1/√(3 · 300) = 3 %
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.2)


def test_weight_of_a_set_of_stars_is_that_of_the_search():
    stars = stars_of(5, 8, 1.0)
    used = np.arange(8) < 7
    without, everyone = (log_weight(stars, mask, fit_of(stars)(np.flatnonzero(mask))) for mask in (used, used | True))
    assert without > everyone + 10.0


def test_chi2_is_that_of_the_calibrated_camera():
    stars = stars_of(7, 9)
    h, r = stars.slopes.reshape(-1, 3), stars.residual.reshape(-1)
    left = r - h @ np.linalg.lstsq(h, r, rcond=None)[0]
    pose = fit_of(stars)(np.arange(9))
    assert pose.chi2 == pytest.approx(left @ left / SIGMA_PX**2, rel=1e-6)
    assert is_suspicious(pose._replace(chi2=chi2.isf(0.049, 15)), 9)
    assert not is_suspicious(pose._replace(chi2=chi2.isf(0.051, 15)), 9)
    assert not is_suspicious(pose._replace(chi2=1e6), 3)
    assert not is_suspicious(pose._replace(chi2=1e6), MOST_STARS + 1)


# α(0.05) = 0.289 and α(0.01) = 0.111 (Sellke, Bayarri & Berger 2001, table 1)
@pytest.mark.parametrize(("p", "doubt"), [(0.9, 0.0), (0.37, 0.0), (0.05, 1 - 2 * 0.289), (0.01, 1 - 2 * 0.111)])
def test_doubt_by_the_lowest_probability_of_the_stated_errors(p, doubt):
    assert doubt_of_stated_errors(chi2.isf(p, 7), 7) == pytest.approx(doubt, abs=1e-3)
    assert doubt_of_stated_errors(1e5, 7) == 1.0


def test_doubt_enlarges_all_covariances_alike():
    pose = fit_of(stars_of(8, 5))(np.arange(5))
    wide = with_doubt(pose._replace(chi2=1e5), 5)
    # 3 F₀.₉₉(3, 7)/χ²₀.₉₉(3) = 3 · 8.4513/11.3449
    factor = 2.2348
    np.testing.assert_allclose(wide.covariance, factor * pose.covariance, rtol=1e-3)
    np.testing.assert_allclose(wide.camera_part, factor * pose.camera_part, rtol=1e-3)
    np.testing.assert_allclose(wide.sigma_px, math.sqrt(factor) * pose.sigma_px, rtol=1e-3)
    assert with_doubt(pose._replace(chi2=5.0), 5).covariance is pose.covariance


def made_fit(log_evidence, turn=0.0, unknowns=None):
    """A fit with a given evidence and turn about x, of fields that the average passes on."""
    unknowns = np.zeros(3) if unknowns is None else unknowns
    covariance = np.diag([1.0, 2.0, 3.0]) * 1e-10
    turns, none = np.array([turn, 0.0, 0.0]), np.zeros(0)
    return Pose(turns, covariance, 0.1 * covariance, none, 0.01, 2.0, unknowns, unknowns, log_evidence, 0.0)


def test_the_price_of_a_displaced_star_is_its_prior_and_the_density_of_its_residual():
    """ε / (1 − ε) of 5 %, over 2π |S|^½ ln(d_max/d_min) (χ² + 4), S from the fit, the stated errors and τ²."""
    stars = stars_of(8, 5)
    extra = np.random.default_rng(1).normal(size=(5, 2, 1))
    stars = stars._replace(extra=extra, extra_sigma=np.ones(1))
    fit = made_fit(-3.0, 2e-5, np.array([0.02, 1e-4, -2e-4, 3e-4]))
    used = np.array([True, False, True, True, False])
    expected = -3.0
    for k in (1, 4):
        x, y = stars.offset[k]
        moved = [x * (1e-4 - 2e-4) + y * 3e-4, x * 3e-4 + y * (1e-4 + 2e-4)] + 0.02 * extra[k, :, 0]
        away = stars.residual[k] - stars.slopes[k] @ fit.turn - moved
        spread = stars.slopes[k] @ fit.covariance @ stars.slopes[k].T + (2.0 * SIGMA_PX**2 + 0.01) * np.eye(2)
        square = away @ np.linalg.solve(spread, away)
        density = 2.0 * math.pi * math.sqrt(np.linalg.det(spread)) * 3.5 * (square + 4.0)
        expected += math.log(0.05 / 0.95 / density)
    assert log_weight(stars, used, fit) == pytest.approx(expected, rel=1e-9)


def test_the_average_is_over_hypotheses_of_a_twentieth_of_the_best_and_more():
    """Mean and covariance of the mixture of fits whose weights are prescribed, three of them beside the first."""
    stars = stars_of(9, 5)
    everyone = np.arange(5)
    price = [log_weight(stars, everyone != k, made_fit(0.0, turn=1e-5 * k)) for k in range(5)]
    shares = [0.8, 0.5, 0.0501, 0.0499, 1e-9]

    def fit(rows):
        left_out = np.setdiff1d(everyone, rows)
        if len(left_out) == 0:
            return made_fit(0.0)
        k = int(left_out[0])
        return made_fit(math.log(shares[k]) - price[k], turn=1e-5 * k)

    pose, used = average(stars, fit)
    assert used.all()
    weight, turns = np.array([1.0, 0.8, 0.5, 0.0501]), 1e-5 * np.array([0.0, 0.0, 1.0, 2.0])
    weight /= weight.sum()
    mean = weight @ turns
    assert pose.turn == pytest.approx([mean, 0.0, 0.0])
    scatter = np.diag([weight @ (turns - mean) ** 2, 0.0, 0.0])
    np.testing.assert_allclose(pose.covariance, np.diag([1.0, 2.0, 3.0]) * 1e-10 + scatter, rtol=1e-9, atol=1e-25)
    np.testing.assert_allclose(pose.camera_part, np.diag([1.0, 2.0, 3.0]) * 1e-11 + scatter, rtol=1e-9, atol=1e-25)


@pytest.mark.parametrize(("stars", "compared"), [(3, False), (4, True), (12, True), (13, False)])
def test_hypotheses_are_compared_of_four_to_twelve_stars(stars, compared):
    fit = made_fit(0.0)._replace(chi2=chi2.isf(0.04, 2 * stars - 3))
    assert bool(is_suspicious(fit, stars)) is compared


@pytest.mark.parametrize("count", [5, 9])
def test_a_fit_does_not_depend_on_the_orientation_of_the_image(count):
    """A frame rotated by 90°, with unknown errors along one axis only: the same fit, about rotated axes."""
    rng = np.random.default_rng(10 + count)
    xy = rng.uniform(0.0, 1023.0, (count, 2))
    centre = np.array([CAMERA.cx, CAMERA.cy])
    rotation = np.array([[0.0, -1.0], [1.0, 0.0]])
    errors = np.column_stack([rng.normal(0.0, 0.05, count), np.zeros(count)])
    fits = []
    for turned in (np.eye(2), rotation):
        vectors = CAMERA.unproject(centre + (xy - centre) @ turned.T)
        stars = Linearised(
            errors @ turned.T,
            pixel_slopes(vectors, CAMERA.image_map),
            CAMERA.project(vectors) - centre,
            np.tile(np.eye(2), (count, 1, 1)),
            np.empty((count, 2, 0)),
            np.empty(0),
        )
        fits.append(fit_pose(stars, 0.0, 0, 3, 2))
    one, other = fits
    assert other.factor == pytest.approx(one.factor, rel=1e-9)
    assert other.chi2 == pytest.approx(one.chi2, rel=1e-9)
    assert other.log_evidence == pytest.approx(one.log_evidence, rel=1e-9)
    np.testing.assert_allclose(other.sigma_px, one.sigma_px, rtol=1e-9)
    axes = np.eye(3)
    axes[:2, :2] = rotation
    np.testing.assert_allclose(other.turn, axes @ one.turn, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(other.covariance, axes @ one.covariance @ axes.T, rtol=1e-6, atol=1e-18)
