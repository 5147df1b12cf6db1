"""Pyramid identification on scenes made here: right, never wrong, with and without a prior."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from startracker.catalog import load_catalog
from startracker.catalog.guide import GuideDatabase
from startracker.geometry.attitude import Attitude
from startracker.geometry.camera import Camera
from startracker.identification.observed import Observed, Prior
from startracker.identification.pairs import find_range
from startracker.identification.pyramid import _guide_pairs, _seen, pyramid, search_pyramids, smart_triples
from startracker.settings import PyramidSettings
from startracker.solution import Status

SETTINGS = PyramidSettings()


@pytest.fixture(scope="module")
def guide():
    return GuideDatabase.build(load_catalog("bsc5"), Camera.from_fov(10.0, 512, 512), 6.5)


def scene(guide, rng, noise_px, false=0, dropped=0.0, flux=True):
    """Attitude matrix, observed stars and the true guide star of each (−1: false)."""
    matrix = Rotation.random(rng=rng).as_matrix()
    index, _, xy = guide.in_field(matrix)
    keep = rng.random(len(index)) >= dropped
    index, xy = index[keep], xy[keep]
    magnitude = np.concatenate([guide.v_mag[index] + rng.normal(0, 0.1, len(index)), rng.uniform(2, 6.5, false)])
    points = np.concatenate([xy + rng.normal(0, noise_px, xy.shape), rng.uniform(0, 511, (false, 2))])
    true = np.concatenate([index, np.full(false, -1)])
    order = np.argsort(magnitude)
    sigma = np.full(len(order), max(noise_px, 0.05) * guide.camera.pixel_rad)
    vectors = guide.camera.unproject(points[order])
    return matrix, Observed(vectors, 10 ** (-0.4 * magnitude[order]) if flux else None, sigma), true[order]


def test_smart_triples_are_all_triples_once():
    triples = smart_triples(7)
    assert len(triples) == math.comb(7, 3) == len({tuple(t) for t in triples.tolist()})
    assert (np.diff(triples, axis=1) > 0).all()
    assert triples[:6].tolist() == [[0, 1, 2], [1, 2, 3], [2, 3, 4], [3, 4, 5], [4, 5, 6], [0, 1, 3]]


@pytest.mark.parametrize(("noise_px", "false", "dropped"), [(0.1, 0, 0.0), (0.3, 3, 0.2), (1.0, 0, 0.0)])
def test_scenes(guide, noise_px, false, dropped):
    rng = np.random.default_rng([21, false])
    solved = possible = 0
    for _ in range(25):
        _, observed, true = scene(guide, rng, noise_px, false, dropped)
        found = pyramid(observed, guide, SETTINGS)
        possible += (true >= 0).sum() >= 6
        if found.status is Status.SOLVED:
            solved += 1
            # a false star can fall on a guide star that was dropped or left out; most pairs are true
            assert (true[found.pairs[:, 0]] == found.pairs[:, 1]).mean() > 0.8
    assert solved >= possible - 1


def test_errors_larger_than_stated(guide):
    # 0.1 px stated, 0.6 px real: the second and third scale find them
    rng = np.random.default_rng(22)
    solved = 0
    for _ in range(10):
        _, observed, true = scene(guide, rng, 0.6)
        understated = Observed(observed.vectors, observed.flux, observed.sigma_rad / 6.0)
        found = pyramid(understated, guide, SETTINGS)
        if found.status is Status.SOLVED:
            solved += 1
            assert (true[found.pairs[:, 0]] == found.pairs[:, 1]).mean() > 0.8
    assert solved >= 9


@pytest.mark.parametrize("flux", [True, False])
def test_a_prior_confines_and_helps(guide, flux):
    rng = np.random.default_rng(23)
    for _ in range(8):
        matrix, observed, true = scene(guide, rng, 0.3, false=3, flux=flux)
        if (true >= 0).sum() < 6:
            continue
        near = Attitude.from_matrix(Rotation.from_rotvec([0.005, -0.004, 0.006]).as_matrix() @ matrix)
        found = pyramid(observed, guide, SETTINGS, Prior(near, math.radians(1.0)))
        assert found.status is Status.SOLVED
        assert (true[found.pairs[:, 0]] == found.pairs[:, 1]).mean() > 0.8
        far = Attitude.from_matrix(Rotation.from_rotvec([0.5, -0.4, 0.6]).as_matrix() @ matrix)
        assert pyramid(observed, guide, SETTINGS, Prior(far, math.radians(1.0))).status is not Status.SOLVED


@pytest.mark.parametrize("count", [8, 15, 25])
def test_random_points_are_never_accepted(guide, count):
    rng = np.random.default_rng([24, count])
    for _ in range(4):
        vectors = guide.camera.unproject(rng.uniform(0, 511, (count, 2)))
        flux = 10 ** (-0.4 * np.sort(rng.uniform(2, 6.5, count)))
        found = pyramid(Observed(vectors, flux, np.full(count, 0.3 * guide.camera.pixel_rad)), guide, SETTINGS)
        assert found.status is not Status.SOLVED
        assert found.reason


def test_hopeless_input_has_a_status(guide):
    pixel = guide.camera.pixel_rad
    line = guide.camera.unproject(np.column_stack([np.linspace(10, 500, 8), np.full(8, 255.5)]))
    same = np.repeat(line[:1], 6, axis=0)
    for vectors in (line, same):
        found = pyramid(Observed(vectors, None, np.full(len(vectors), 0.1 * pixel)), guide, SETTINGS)
        assert found.status in (Status.NO_MATCH, Status.AMBIGUOUS)
    assert pyramid(Observed(line[:2], None, np.full(2, pixel)), guide, SETTINGS).status is Status.TOO_FEW_STARS
    assert pyramid(Observed(np.empty((0, 3)), None, np.empty(0)), guide, SETTINGS).status is Status.NO_STARS


def test_a_triangle_ends_when_the_budget_is_used_up(guide):
    """Of a triangle with thousands of candidates, the ranges of its two pairs alone use up the budget."""
    _, observed, _ = scene(guide, np.random.default_rng(11), 0.3)
    seen = _seen(observed, 6, PyramidSettings(separation_tolerance_deg=0.2), 10.0)
    table, triples = _guide_pairs(guide, None), smart_triples(6)[:1]
    i, j, k = triples[0]
    ranges = 0
    for other in (j, k):
        side, tolerance = seen.separation[i, other], seen.tolerance[i, other]
        low, high = find_range(table.vector, side - tolerance, side + tolerance)
        ranges += high - low
    assert ranges > 1000
    reached, *_, left = search_pyramids(seen, triples, 0, table, guide.view, 1, 10)
    assert (reached, 10 - left) == (1, ranges)
    assert (table.head == -1).all()
