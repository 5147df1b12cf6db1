"""Triangles against brute force, and what the default identifier answers."""

import math
import sys

import numpy as np
import pytest

from startracker.catalog import load_catalog
from startracker.catalog.guide import GuideDatabase
from startracker.estimation.directions import focal_slopes
from startracker.geometry.attitude import Attitude
from startracker.geometry.camera import Camera
from startracker.identification import Observed, Prior, adaptive
from startracker.identification.adaptive import nearest_stars, pole_order
from startracker.identification.bayes_factor import count_table
from startracker.identification.other_stars import least_matches
from startracker.identification.pairs import separation
from startracker.identification.search_state import Guides, Limits, Pairs, Stars
from startracker.identification.triangles import PAIR_SIGMAS, first_triangles, similar_triangles
from startracker.settings import AdaptiveSettings
from startracker.solution import Status

CAMERA = Camera.from_fov(20.0, 512, 512)
SIGMA = 0.15 * CAMERA.pixel_rad
HOT = 80


@pytest.fixture(scope="module")
def guide():
    return GuideDatabase.build(load_catalog("hipparcos"), CAMERA, 4.5)


def seen(guide, attitude, sigma_px=0.0, seed=0, flux=True, camera=CAMERA):
    index, _, xy = guide.in_field(attitude.as_matrix(), 0.0, camera)
    xy = xy + sigma_px * np.random.default_rng(seed).standard_normal(xy.shape)
    signal = 10.0 ** (-0.4 * guide.v_mag[index]) if flux else None
    return index, Observed(CAMERA.unproject(xy), signal, np.full(len(xy), SIGMA))


def test_magnitudes_need_a_flux_that_is_one():
    vectors, sigma = np.zeros((3, 3)), np.ones(3)
    flux = np.array([100.0, 3.5, 1e-3])
    np.testing.assert_allclose(Observed(vectors, flux, sigma).magnitudes_or_nan(), -2.5 * np.log10(flux), rtol=1e-15)
    for wrong in (0.0, -1.0, np.nan, np.inf):
        seen = Observed(vectors, np.array([100.0, wrong, 1.0]), sigma)
        assert np.isnan(seen.magnitudes_or_nan()).all()
        assert seen.magnitudes() is None
    assert Observed(vectors, None, sigma).magnitudes() is None
    assert np.isnan(Observed(vectors, None, sigma).magnitudes_or_nan()).all()


def brute_force(vectors, directions, tolerance, focal_range):
    """Number of ordered guide triples that have the shape of three observed stars."""
    table = separation(directions[:, None], directions[None, :])
    np.fill_diagonal(table, 9.0)
    real = table[:, :, None], table[:, None, :], table[None, :, :]
    seen = [separation(vectors[i], vectors[j]) for i, j in ((0, 1), (0, 2), (1, 2))]
    error = [tolerance + 1.02e-4 * side for side in seen]
    good = np.ones((len(directions),) * 3, dtype=bool)
    if focal_range == 0.0:
        for side, other, slack in zip(seen, real, error, strict=True):
            good &= np.abs(side - other) <= slack
    else:
        ratio = [np.log(side / other) for side, other in zip(seen, real, strict=True)]
        slack = [wrong / side for wrong, side in zip(error, seen, strict=True)]
        for k in range(3):
            good &= np.abs(ratio[k]) <= focal_range + slack[k]
        for p, q in ((0, 1), (0, 2), (1, 2)):
            good &= np.abs(ratio[p] - ratio[q]) <= slack[p] + slack[q]
    sense = np.linalg.det(vectors)
    return sum(sense * np.linalg.det(directions[list(triple)]) > 0.0 for triple in np.argwhere(good))


@pytest.mark.parametrize("focal_range", [0.0, 0.02])
@pytest.mark.parametrize("seed", range(3))
def test_triangles_found_are_those_of_brute_force(seed, focal_range):
    sky = GuideDatabase.build(load_catalog("hipparcos"), CAMERA, 2.7)  # some hundred stars
    rng = np.random.default_rng(seed)
    corners = np.array([[0.0, 0.0, 1.0], [0.3, 0.05, 1.0], [-0.05, 0.35, 1.0]]) + 0.05 * rng.standard_normal((3, 3))
    vectors = corners / np.linalg.norm(corners, axis=1, keepdims=True)
    near = sky.pairs_within(10.0)  # of any length
    sigma = np.full(3, 0.005)
    unknown, even = np.full(3, np.nan), np.zeros((1, 3))
    stars = Stars(vectors, focal_slopes(vectors), sigma, unknown, count_table(3, 20), even)
    limits = Limits(1.0, focal_range, 99.0, 0.5, 1e12, np.eye(3), -2.0)
    pairs = Pairs(near.first, near.second, near.separation_rad)
    head = np.full(len(sky), -1, np.int32)
    directions = Guides(sky.directions, sky.v_mag)
    candidates, operations = similar_triangles(np.array([[0, 1, 2]]), stars, directions, pairs, limits, head)
    found = len(candidates.focal)
    tolerance = PAIR_SIGMAS * math.hypot(0.005, 0.005)
    expected = brute_force(vectors, sky.directions[sky.pattern], tolerance, focal_range)
    assert sorted(candidates.stars[0, [0, 1, 4]]) == [0, 1, 2]
    assert (head == -1).all()
    assert operations > 0.0
    assert expected > 0
    # the windows of a free focal length are those of the range itself: a few at its rim may be either way
    assert found == expected if focal_range == 0.0 else abs(found - expected) <= 0.15 * expected + 2


def test_the_first_triangles_are_small_ones_of_the_brightest_nine():
    vectors = CAMERA.unproject(np.random.default_rng(1).uniform(0, 511, (15, 2)))
    every = first_triangles(vectors, 0.4, 1000)
    assert len(every) == math.comb(9, 3)
    assert len({tuple(sorted(row)) for row in every.tolist()}) == len(every)
    assert every.max() == 8
    assert np.array_equal(first_triangles(vectors, 0.4, 10), every[:10])


def test_nearest_stars_are_those_of_a_tree():
    from scipy.spatial import cKDTree

    vectors = CAMERA.unproject(np.random.default_rng(2).uniform(0, 511, (40, 2)))
    assert np.array_equal(nearest_stars(vectors)[:, :7], cKDTree(vectors).query(vectors, 8)[1][:, 1:])


def test_least_matches_are_the_poisson_tails():
    from scipy.stats import poisson

    assert least_matches(1e9, 0.001) > 1e9  # nor does it look for the end of that
    for mean in (1e-4, 0.03, 0.5, 4.0, 90.0):
        for chance in (0.05, 0.001):
            hits = least_matches(mean, chance)
            assert poisson.sf(hits - 1, mean) <= chance or hits == 1
            assert hits == 1 or poisson.sf(hits - 2, mean) > chance


@pytest.mark.parametrize("flux", [True, False])
def test_a_field_is_identified(guide, flux):
    index, stars = seen(guide, Attitude.from_radec_roll(84.0, 2.0, 75.0), 0.2, flux=flux)
    found = adaptive(stars, guide)
    assert found.status is Status.SOLVED, found.reason
    assert np.array_equal(found.pairs[:, 1], index[found.pairs[:, 0]])
    assert len(found.pairs) >= 0.9 * len(index)
    assert found.focal == 1.0
    assert found.log_false_alarm < math.log(1e-7)
    assert "triangles" in found.steps[0]


@pytest.mark.parametrize("factor", [0.98, 1.01, 1.02])
def test_a_focal_length_that_is_off_is_found_along(guide, factor):
    real = Camera(CAMERA.fx * factor, CAMERA.fy * factor, CAMERA.cx, CAMERA.cy, 512, 512)
    index, stars = seen(guide, Attitude.from_radec_roll(84.0, 2.0, 75.0), 0.1, camera=real)
    found = adaptive(stars, guide)
    assert found.status is Status.SOLVED, found.reason
    assert found.focal == pytest.approx(factor, abs=1e-3)
    assert np.array_equal(found.pairs[:, 1], index[found.pairs[:, 0]])


def test_a_mirrored_field_is_none(guide):
    index, stars = seen(guide, Attitude.from_radec_roll(84.0, 2.0, 75.0))
    assert len(index) > 8
    mirrored = Observed(stars.vectors * (-1.0, 1.0, 1.0), stars.flux, stars.sigma_rad)
    assert adaptive(mirrored, guide).status is not Status.SOLVED


def test_a_prior_holds(guide):
    attitude = Attitude.from_radec_roll(84.0, 2.0, 75.0)
    _, stars = seen(guide, attitude, 0.2)
    three = Observed(stars.vectors[:3], None, stars.sigma_rad[:3])
    assert adaptive(three, guide).status is not Status.SOLVED
    assert adaptive(three, guide, None, Prior(attitude, math.radians(0.5))).status is Status.SOLVED
    elsewhere = Attitude.from_radec_roll(94.0, 2.0, 75.0)
    assert adaptive(stars, guide, None, Prior(elsewhere, math.radians(5.0))).status is Status.NO_MATCH
    assert adaptive(stars, guide, None, Prior(elsewhere, math.radians(15.0))).status is Status.SOLVED


@pytest.mark.parametrize(("count", "status"), [(0, Status.NO_STARS), (2, Status.TOO_FEW_STARS)])
def test_too_few_stars_have_a_status(guide, count, status):
    _, stars = seen(guide, Attitude.from_radec_roll(84.0, 2.0, 75.0))
    few = Observed(stars.vectors[:count], None, stars.sigma_rad[:count])
    assert adaptive(few, guide).status is status


def test_stars_in_one_place_or_in_a_line_are_no_match(guide):
    one = np.repeat(CAMERA.unproject([[200.0, 300.0]]), 6, axis=0)
    line = CAMERA.unproject(np.stack([np.linspace(20.0, 480.0, 6), np.full(6, 100.0)], axis=1))
    for vectors in (one, line):
        found = adaptive(Observed(vectors, None, np.full(6, SIGMA)), guide)
        assert found.status in (Status.NO_MATCH, Status.AMBIGUOUS)
        assert len(found.pairs) == 0


def test_a_tolerance_of_ones_own_is_the_only_one(guide):
    index, stars = seen(guide, Attitude.from_radec_roll(84.0, 2.0, 75.0), 0.2)
    found = adaptive(stars, guide, AdaptiveSettings(separation_tolerance_deg=0.1))
    assert found.status is Status.SOLVED
    assert len(found.pairs) >= 0.9 * len(index)
    assert "given tolerance" in found.steps[0]


def test_the_same_stars_give_the_same_answer(guide):
    _, stars = seen(guide, Attitude.from_radec_roll(200.0, -60.0, 5.0), 0.5)
    first, second = adaptive(stars, guide), adaptive(stars, guide)
    assert np.array_equal(first.pairs, second.pairs)
    assert first.log_false_alarm == second.log_false_alarm


def test_a_field_that_fits_as_stated_is_not_searched_to_the_end(monkeypatch):
    """Few true stars among many false ones: the long search for a rival changes nothing but the time."""
    guide = GuideDatabase.build(load_catalog("hipparcos"), Camera.from_fov(10.0, 512, 512), 6.0)
    rng = np.random.default_rng(5)
    module = sys.modules[nearest_stars.__module__]
    patient = 0
    for _ in range(200):
        matrix = Attitude(rng.normal(size=4)).as_matrix()
        index, vectors, _ = guide.in_field(matrix, -2.0)
        if len(index) != 5:
            continue
        camera = guide.camera
        xy = np.concatenate([camera.project(vectors), rng.uniform(0.0, 511.0, (40, 2))])
        seen = Observed(camera.unproject(xy), None, np.full(len(xy), 0.15 * camera.pixel_rad))
        quick = adaptive(seen, guide)
        with monkeypatch.context() as patch:
            patch.setattr(module, "_AS_STATED", -1.0)
            long = adaptive(seen, guide)
        assert quick.status is long.status
        assert quick.pairs.tolist() == long.pairs.tolist()
        patient += len(quick.steps) < len(long.steps)
        if patient == 2:
            break
    assert patient == 2


def test_true_stars_may_all_be_fainter_than_many_false_ones():
    """Hot pixels: neither poles nor confirming stars among the brightest points alone would find an attitude."""
    guide = GuideDatabase.build(load_catalog("hipparcos"), Camera.from_fov(10.0, 512, 512), 6.5)
    rng, camera, solved = np.random.default_rng(8), guide.camera, []
    while len(solved) < 10:
        index, _, xy = guide.in_field(Attitude(rng.normal(size=4)).as_matrix(), -2.0)
        if not 10 <= len(index) <= 14:
            continue
        xy = np.concatenate([rng.uniform(0.0, 511.0, (HOT, 2)), xy + rng.normal(0.0, 0.15, xy.shape)])
        flux = np.concatenate([rng.uniform(1.0, 10.0, HOT), 10.0 ** (-0.4 * guide.v_mag[index])])
        found = adaptive(Observed(camera.unproject(xy), flux, np.full(len(xy), 0.15 * camera.pixel_rad)), guide)
        true = found.pairs[found.pairs[:, 0] >= HOT]
        assert np.array_equal(true[:, 1], index[true[:, 0] - HOT])
        solved.append(found.status is Status.SOLVED)
    assert all(solved)


@pytest.mark.parametrize(("poles", "stars"), [(1, 1), (1, 9), (2, 9), (7, 9), (9, 9), (60, 74), (119, 120)])
def test_poles_are_the_brightest_and_others_evenly_among_the_rest(poles, stars):
    order = pole_order(poles, stars)
    assert len(order) == len(set(order)) == poles
    assert order[: (poles + 1) // 2] == list(range((poles + 1) // 2))
    rest = np.array([*order[(poles + 1) // 2 :], stars])
    if len(rest) > 1:
        assert rest[0] == (poles + 1) // 2
        assert np.ptp(np.diff(rest)) <= 1  # evenly
