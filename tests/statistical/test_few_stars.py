"""Fields of few stars: one displaced star, errors that are not known or not as stated, and lenses that are not.

The normalised error squared (NEES) of an attitude exceeds 16.27 in 0.1 % of the cases if its covariance is true (χ² of
3 degrees of freedom). Of n fields more than k exceed it with the binomial probability of that many.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom, chi2

from simulator.scenario import Scenario
from simulator.study.trials.trial import TrialRunner
from startracker import Attitude, Camera, StarTracker
from startracker.centroid.result import Measured
from startracker.core import ARCSEC_RAD
from startracker.estimation import wahba_svd
from startracker.estimation.refine import refine
from startracker.observer import Observer

CAMERA = Camera.from_fov(12.0, 1024, 1024)
LIMIT = chi2.isf(0.001, 3)
SIGMA_PX = 0.02


@pytest.fixture(scope="module")
def tracker():
    return StarTracker(CAMERA, magnitude_limit=6.5)


@pytest.fixture(scope="module")
def observer(tracker):
    return Observer(tracker.guide.epoch_jyear, np.zeros(3))


def field(rng, guide, stars, camera=CAMERA):
    """Attitude, guide index and pixels of so many stars of a random field."""
    while True:
        attitude = Attitude(rng.normal(size=4))
        index, _, xy = guide.in_field(attitude.as_matrix(), -2.0, camera)
        if len(index) >= stars:
            chosen = np.sort(rng.choice(len(index), stars, replace=False))
            return attitude, index[chosen], xy[chosen]


def refined(guide, observer, index, xy, sigma_px):
    """Fit of identified stars; `sigma_px` None: of unknown errors."""
    pairs = np.stack([np.arange(len(index)), index], axis=1)
    variance = None if sigma_px is None else np.full(len(index), sigma_px**2)
    return refine(pairs, Measured(xy, variance_px2=variance), CAMERA, guide, wahba_svd, observer=observer)


def nees_of(error, covariance):
    return error @ np.linalg.solve(covariance, error)


def shift(rng, size):
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return size * np.array([np.cos(angle), np.sin(angle)])


def most_beyond(fields):
    """Number beyond the limit that 0.1 % of the fields exceeds with a probability of 1e-3."""
    return binom.isf(1e-3, fields, 1e-3)


def displaced(guide, observer, stars, stated, trials=40):
    """Ratio of the rms error with one of the stars displaced to that without, NEES, and whether the displaced one was
    used, at displacements of 5 to 1250 standard errors; `stated` is the stated error in units of the true one."""
    rng, clean, error, nees, used = np.random.default_rng(stars), [], [], [], []
    for size in SIGMA_PX * 5.0 * 2.0 ** np.arange(9):
        for _ in range(trials):
            attitude, index, xy = field(rng, guide, stars)
            xy = xy + rng.normal(0.0, SIGMA_PX, xy.shape)
            found = refined(guide, observer, index, xy, stated * SIGMA_PX)
            clean.append(attitude.rotation_vector_to(Attitude.from_matrix(found.matrix)))
            which = rng.integers(stars)
            xy[which] += shift(rng, size)
            found = refined(guide, observer, index, xy, stated * SIGMA_PX)
            error.append(attitude.rotation_vector_to(Attitude.from_matrix(found.matrix)))
            nees.append(nees_of(error[-1], found.covariance))
            used.append(which in found.pairs[found.used, 0])
    ratio = np.sqrt(np.mean(np.square(error), axis=0) / np.mean(np.square(clean), axis=0))
    return ratio, np.array(nees), np.array(used).reshape(9, trials).mean(axis=1)


@pytest.mark.parametrize("stated", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("stars", [5, 6, 8])
def test_one_displaced_star_costs_less_than_half(tracker, observer, stars, stated):
    """17, 12 and 4.6 times the error without it at 50 standard errors, with the displaced star used in all fits of five
    and six. Without this star the error of five is 1.2 times as large. Limits: 1.5, and three standard errors of the
    ratio of two rms values of 360, which have errors of 1/√(2 · 360) each, partly common: 0.06 · 1.5."""
    ratio, nees, used = displaced(tracker.guide.apparent_to(observer), observer, stars, stated)
    assert np.all(ratio < 1.5 + 3.0 * 0.06 * 1.5)
    assert used[3:].max() < 0.08  # from 40 standard errors on
    assert nees.mean() < 3.0 + 3.0 * np.sqrt(6.0 / len(nees))


def test_of_four_stars_the_covariance_contains_a_displaced_one(tracker, observer):
    """Which of four stars is displaced is uncertain where a displacement nearly fits that of another one."""
    _, nees, _ = displaced(tracker.guide.apparent_to(observer), observer, 4, 1.0, 120)
    assert nees.mean() < 3.0 + 3.0 * np.sqrt(6.0 / len(nees))
    # a displacement of 5 standard errors may be taken for errors of all stars: twice the errors of a true covariance
    assert np.count_nonzero(nees > chi2.isf(0.01, 3)) < binom.isf(1e-3, len(nees), 0.02)


@pytest.mark.parametrize("prior", [False, True])
@pytest.mark.parametrize("brightest", [False, True])
def test_lists_with_a_displaced_star(tracker, observer, prior, brightest):
    """As a user gives them: fluxes, a prior or none, displacements of 0.5 px and more beyond any identification."""
    rng, clean, error = np.random.default_rng(11), [], []
    guide = tracker.guide.apparent_to(observer)
    for k in range(240):
        attitude, index, xy = field(rng, guide, 7)
        xy, flux = xy + rng.normal(0.0, SIGMA_PX, xy.shape), 10.0 ** (-0.4 * guide.v_mag[index])
        given = {"sigma_px": SIGMA_PX, "observer": observer, "prior": attitude if prior else None}
        before = tracker.solve_centroids(xy, flux, **given)
        which = 0 if brightest else rng.integers(7)
        xy[which] += shift(rng, 0.5 * 2.0 ** (k % 7))
        after = tracker.solve_centroids(xy, flux, **given)
        if before.solved and after.solved:
            clean.append(attitude.rotation_vector_to(before.attitude))
            error.append(attitude.rotation_vector_to(after.attitude))
    assert len(clean) > 100
    ratio = np.sqrt(np.mean(np.square(error), axis=0) / np.mean(np.square(clean), axis=0))
    # three standard errors of the ratio, as above
    assert np.all(ratio < 1.5 * (1.0 + 3.0 / np.sqrt(len(clean))))


@pytest.mark.parametrize(("stars", "trials"), [(3, 2000), (4, 2000), (5, 2000), (8, 2000)])
def test_few_stars_of_unknown_errors_stay_within_the_limit(tracker, observer, stars, trials):
    """13, 17, 9 and 9 of 2,000 exceeded it with the factor for 99 % of the errors."""
    guide, rng, beyond = tracker.guide.apparent_to(observer), np.random.default_rng(5), 0
    for _ in range(trials):
        attitude, index, xy = field(rng, guide, stars)
        found = refined(guide, observer, index, xy + rng.normal(0.0, 0.2, xy.shape), None)
        error = attitude.rotation_vector_to(Attitude.from_matrix(found.matrix))
        beyond += nees_of(error, found.covariance) > LIMIT
    assert beyond <= most_beyond(trials)


def test_six_stars_of_a_distorting_lens_stay_within_the_limit(tracker, observer):
    """0.1 % at the corners, 0.7 px, which the camera does not know: 20 of 1,500 exceeded the limit."""
    guide, rng, beyond = tracker.guide.apparent_to(observer), np.random.default_rng(4), 0
    for _ in range(1500):
        attitude, index, xy = field(rng, guide, 6)
        offset = xy - 511.5
        xy = xy + 1e-3 * np.sum(offset**2, axis=1, keepdims=True) / (2.0 * 511.5**2) * offset
        found = refined(guide, observer, index, xy + rng.normal(0.0, 0.05, xy.shape), 0.05)
        error = attitude.rotation_vector_to(Attitude.from_matrix(found.matrix))
        beyond += nees_of(error, found.covariance) > LIMIT
    assert beyond <= most_beyond(1500)


@pytest.mark.parametrize(("stars", "most"), [(5, 0.03), (8, 0.02)])
def test_errors_twice_as_large_as_stated(tracker, observer, stars, most):
    """Mean NEES 4.5 and 4.0, and 4.1 % and 2.6 % beyond the limit of 0.1 %, when the factor of the errors had to come
    from the residuals of all fields alone.

    χ² of the residuals has 7 degrees of freedom for five stars. The rule c(χ²) for the factor of the covariance that
    is best for errors twice as large, with a mean NEES of 2.4 for errors as stated, leaves 1.3 % beyond (Lagrange's
    method on the densities of χ²₇ and 4 χ²₇); 0.2 % are reached with a mean NEES of 1.3, twice the covariance.
    """
    guide, rng, nees = tracker.guide.apparent_to(observer), np.random.default_rng(9), []
    for _ in range(1200):
        attitude, index, xy = field(rng, guide, stars)
        found = refined(guide, observer, index, xy + rng.normal(0.0, 0.1, xy.shape), 0.05)
        error = attitude.rotation_vector_to(Attitude.from_matrix(found.matrix))
        nees.append(nees_of(error, found.covariance))
    assert np.mean(nees) < 3.5
    assert np.mean(np.array(nees) > LIMIT) < most


@pytest.mark.parametrize("stars", [4, 5, 6, 8])
def test_errors_as_stated_are_not_widened_more_than_needed(tracker, observer, stars):
    guide, rng, nees = tracker.guide.apparent_to(observer), np.random.default_rng(6), []
    for _ in range(600):
        attitude, index, xy = field(rng, guide, stars)
        found = refined(guide, observer, index, xy + rng.normal(0.0, 0.1, xy.shape), 0.1)
        error = attitude.rotation_vector_to(Attitude.from_matrix(found.matrix))
        nees.append(nees_of(error, found.covariance))
    assert 2.0 < np.mean(nees) < 3.0 + 3.0 * np.sqrt(6.0 / 600)
    assert np.count_nonzero(np.array(nees) > LIMIT) <= most_beyond(600)


@pytest.mark.slow
def test_a_focal_length_fitted_to_eight_stars(tracker, observer):
    """4 % off, with `focal_error` 0.05: 26 of 1,452 exceeded the limit, as the error of the residuals was taken for
    certain."""
    camera = replace(CAMERA, fx=0.96 * CAMERA.fx, fy=0.96 * CAMERA.fy)
    free, rng, beyond, solved = (
        StarTracker(CAMERA, magnitude_limit=6.5, focal_error=0.05),
        np.random.default_rng(3),
        0,
        0,
    )
    guide = tracker.guide.apparent_to(observer)
    for _ in range(2000):
        attitude, index, xy = field(rng, guide, 8, camera)
        xy, flux = xy + rng.normal(0.0, 0.1, xy.shape), 10.0 ** (-0.4 * guide.v_mag[index])
        solution = free.solve_centroids(xy, flux, sigma_px=0.1, observer=observer)
        if solution.solved:
            solved += 1
            beyond += nees_of(attitude.rotation_vector_to(solution.attitude), solution.covariance) > LIMIT
    assert solved > 300
    assert beyond <= most_beyond(solved)


@pytest.mark.parametrize("trial", [36, 737, 1203, 1266, 1499, 1635])
def test_a_blend_among_five_to_thirteen_stars_of_a_frame(trial):
    """Frames of `sunsat.yaml` with one to three blends of 0.2 to 0.7 px, which pulled the attitude by 5.7″ to 10.3″;
    without these the errors are 0.3″ to 0.6″."""
    runner = TrialRunner(Scenario.load("scenarios/sunsat.yaml"))
    row = runner.run(trial)
    error = np.hypot(row["error_cross_x_deg"], row["error_cross_y_deg"])
    assert np.radians(error) / ARCSEC_RAD < 1.0
    assert row["nees"] < LIMIT
