"""Hypotheses of displaced stars, and the factors of the covariance of few stars."""

import math

import numpy as np
import pytest
from scipy.stats import chi2

from startracker import Camera
from startracker.estimation.few_stars import doubt_of_stated_errors, with_doubt
from startracker.estimation.pose import TRUSTED, Linearised, fit_pose
from startracker.geometry.image_map import pixel_slopes
from startracker.outliers import MOST_STARS, average, is_suspicious, log_weight, rows_of

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
