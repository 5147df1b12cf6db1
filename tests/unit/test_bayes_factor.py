"""The Bayes factor of an attitude: its parts against sums, NumPy twins and exact expectations."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import binom, poisson

from startracker.catalog import load_catalog
from startracker.catalog.guide import GuideDatabase
from startracker.geometry.attitude import Attitude, rotation_vector_to_matrix
from startracker.geometry.camera import Camera
from startracker.identification import Observed
from startracker.identification.acceptance import verify
from startracker.identification.bayes_factor import (
    DISTRACTORS,
    SCALE_LOG_PRIOR,
    SEEN,
    count_table,
    log_assignments,
    log_determinant,
    log_magnitude_ratios,
)

CAMERA = Camera.from_fov(10.0, 512, 512)


@pytest.fixture(scope="module")
def guide():
    return GuideDatabase.build(load_catalog("hipparcos"), CAMERA, 6.5)


def test_prior_weights_sum_to_one():
    for weights in ([w for _, w in SEEN], [w for _, w in DISTRACTORS], np.exp(SCALE_LOG_PRIOR)):
        assert sum(weights) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("size", [1, 3, 4])
def test_the_determinant_is_numpys(size):
    rng = np.random.default_rng(size)
    a = rng.standard_normal((size, 9))
    matrix = a @ a.T
    assert log_determinant(matrix) == pytest.approx(np.linalg.slogdet(matrix)[1], rel=1e-12)
    assert log_determinant(-np.eye(size)) == -math.inf


@pytest.mark.parametrize("depth", [1, 4, 9])
def test_the_number_of_stars_has_the_probability_of_a_binomial_and_a_poisson_one(depth):
    for n in (0, 3, 12):
        table = count_table(n, depth)
        below = np.logaddexp.reduce(table.log_total[depth - 1 : depth]) if depth > 1 else -math.inf
        found = math.exp(table.log_total[depth]) - math.exp(below)
        expected = sum(
            p_weight * weight * binom.pmf(k, depth, p) * poisson.pmf(n - k, mean)
            for p, p_weight in SEEN
            for mean, weight in DISTRACTORS
            for k in range(min(n, depth) + 1)
        )
        assert found == pytest.approx(expected, rel=1e-9)


def test_random_places_have_a_mean_likelihood_ratio_of_at_most_one():
    """E[Λ] = 1 for all assignments together; with the best choice of each number alone it is a little less."""
    rng = np.random.default_rng(5)
    n, k, sigma, trials = 4, 3, 0.05, 20000  # in units of the image's side
    guides = rng.random((k, 2))
    counts = count_table(n, 20)
    values = np.empty(trials)
    for trial in range(trials):
        stars = rng.random((n, 2))
        # on a torus, so that the Gaussians' integrals over the image are one
        away = np.abs(stars[:, None] - guides[None])
        d2 = np.sum(np.minimum(away, 1.0 - away) ** 2, axis=2)
        gain, rank, free = [], [], set(range(k))
        for star in range(n):
            best = min(free, key=lambda g: d2[star, g], default=None)
            if best is not None and d2[star, best] < (4.5 * sigma) ** 2:
                free.discard(best)
                gain.append(-0.5 * d2[star, best] / sigma**2 - math.log(2.0 * math.pi * sigma**2))
                rank.append(best)
        order = np.argsort(gain)[::-1]
        gain, rank = np.array(gain)[order], np.array(rank, dtype=np.int64)[order]
        values[trial] = math.exp(log_assignments(gain, rank, k, counts))
    spread = values.std() / math.sqrt(trials)
    assert values.mean() < 1.0 + 4.0 * spread
    assert values.mean() > 0.2  # not so small that nothing would ever be identified


def test_magnitudes_tell_when_they_fit_and_count_for_nothing_when_unknown():
    rng = np.random.default_rng(2)
    field = np.sort(rng.uniform(2.0, 6.5, 40))
    matched = np.sort(rng.choice(40, 10, replace=False)).astype(np.int64)
    fits = log_magnitude_ratios(field[matched] + 17.0 + 0.1 * rng.standard_normal(10), matched, field)
    shuffled = log_magnitude_ratios(rng.permutation(field[matched]) + 17.0, matched, field)
    assert fits[0].sum() > 8.0
    assert shuffled[0].sum() < 0.0
    assert not log_magnitude_ratios(np.full(10, np.nan), matched, field).any()
    assert not log_magnitude_ratios(field[:10], np.full(10, -1), field).any()


def test_magnitudes_belong_to_their_stars_in_whatever_order_they_come():
    rng = np.random.default_rng(6)
    field = np.sort(rng.uniform(2.0, 6.5, 40))
    matched = rng.choice(40, 9, replace=False).astype(np.int64)
    magnitude = field[matched] + rng.normal(17.0, 0.5, 9)
    order = np.append(0, 1 + rng.permutation(8))  # the first star pays for the zero point
    ratios = log_magnitude_ratios(magnitude, matched, field)
    np.testing.assert_allclose(log_magnitude_ratios(magnitude[order], matched[order], field), ratios[:, order])


def test_a_rough_attitude_becomes_that_of_least_squares(guide):
    rng = np.random.default_rng(4)
    matrix = Attitude.from_radec_roll(100.0, 40.0, 20.0).as_matrix()
    index, _, xy = guide.in_field(matrix)
    xy = xy + 0.3 * rng.standard_normal(xy.shape)
    vectors = CAMERA.unproject(xy)
    stars = Observed(vectors, 10.0 ** (-0.4 * guide.v_mag[index]), np.full(len(xy), 0.15 * CAMERA.pixel_rad))
    off = rotation_vector_to_matrix(2.0 * CAMERA.pixel_rad * rng.standard_normal(3))
    found, _ = verify(off @ matrix, stars, guide, 7.0)
    assert found is not None
    assert np.array_equal(found.pairs[:, 0], np.arange(len(xy)))
    assert np.array_equal(found.pairs[:, 1], index)
    expected, _ = Rotation.align_vectors(vectors, guide.directions[index])
    # Gauss–Newton stops when the pairs stand still, one step before the last digit
    assert np.abs(found.matrix - expected.as_matrix()).max() < 1e-3 * CAMERA.pixel_rad
    assert found.scale in (1.25, 2.2)  # 0.3 px real, 0.15 px stated
    assert found.log_evidence > 100.0


def test_the_focal_length_is_fitted_where_it_may_be_off(guide):
    rng = np.random.default_rng(6)
    real = Camera(CAMERA.fx * 1.015, CAMERA.fy * 1.015, CAMERA.cx, CAMERA.cy, 512, 512)
    matrix = Attitude.from_radec_roll(250.0, -30.0, 200.0).as_matrix()
    index, _, xy = guide.in_field(matrix, 0.0, real)
    vectors = CAMERA.unproject(xy + 0.1 * rng.standard_normal(xy.shape))
    stars = Observed(vectors, None, np.full(len(xy), 0.15 * CAMERA.pixel_rad))
    held, free = (verify(matrix, stars, guide, 7.0, focal)[0] for focal in (None, 1.0))
    # standard error of ln f: 0.1 px over the radii's root sum of squares, and the prior's pull on 1.5 sigma
    radii = np.hypot(*(xy - 255.5).T)
    sigma = 0.1 / math.sqrt(np.sum(radii**2))
    assert free.focal == pytest.approx(1.015, abs=4.0 * sigma + 1e-4)
    assert free.log_evidence > held.log_evidence + 20.0
    assert len(free.pairs) == len(index)


def test_an_attitude_elsewhere_has_no_evidence(guide):
    rng = np.random.default_rng(8)
    xy = rng.uniform(0.0, 511.0, (20, 2))
    stars = Observed(CAMERA.unproject(xy), None, np.full(20, 0.15 * CAMERA.pixel_rad))
    found = [verify(Rotation.random(rng=rng).as_matrix(), stars, guide, 7.0)[0] for _ in range(200)]
    assert max((h.log_evidence for h in found if h is not None), default=-99.0) < 0.0
