"""Kernels of the searches against all combinations: confirmation by other stars, and triangles with a fourth star."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import poisson

from startracker.catalog import load_catalog
from startracker.catalog.guide import GuideDatabase
from startracker.estimation.directions import focal_slopes
from startracker.geometry.attitude import Attitude
from startracker.geometry.camera import Camera
from startracker.identification.bayes_factor import count_table
from startracker.identification.observed import Observed, Prior
from startracker.identification.other_stars import (
    NO_OCCUPANCY,
    Confirmation,
    midpoint_frame,
    next_confirmed,
    occupancy_map,
    other_stars,
    room,
)
from startracker.identification.pyramid import (
    _guide_pairs,
    _laid_on,
    _seen,
    search_pyramids,
)
from startracker.identification.search_state import Candidates, Stars
from startracker.settings import PyramidSettings

CAMERA = Camera.from_fov(25.0, 512, 512)


@pytest.fixture(scope="module")
def guide():
    return GuideDatabase.build(load_catalog("hipparcos"), CAMERA, 4.0)


def field(guide, ra_deg, noise_px=0.05, count=12, seed=1, dec_deg=5.0):
    """Attitude, directions of the brightest stars of a field in the camera, and their guide stars."""
    matrix = Attitude.from_radec_roll(ra_deg, dec_deg, 40.0).as_matrix()
    index, _, xy = guide.in_field(matrix)
    rng = np.random.default_rng(seed)
    xy = xy[:count] + rng.normal(0.0, noise_px, (min(count, len(xy)), 2))
    return matrix, CAMERA.unproject(xy), index[:count]


def stars_of(vectors, sigma):
    n = len(vectors)
    vectors = np.ascontiguousarray(vectors)
    return Stars(
        vectors, focal_slopes(vectors), sigma, np.full(n, np.nan), count_table(n, 2 * n + 10), np.zeros((1, n))
    )


# ---------------------------------------------------------------------- confirmation by other stars
def frame_of(p, q):
    middle, along = p + q, q - p
    middle, along = middle / np.linalg.norm(middle), along / np.linalg.norm(along)
    return np.array([middle, along, np.cross(middle, along)])


def test_other_stars_in_the_frame_of_a_pair(guide):
    """All but the pair and a third, with the errors of their own, of the midpoint and of the bearing at their lever."""
    _, vectors, _ = field(guide, 83.0, dec_deg=0.0)
    sigma = np.linspace(1e-4, 3e-4, len(vectors))
    stars, others = stars_of(vectors, sigma), room()
    frame = np.empty((3, 3))
    midpoint_frame(vectors[1], vectors[4], frame)
    np.testing.assert_allclose(frame, frame_of(vectors[1], vectors[4]), atol=1e-15)
    assert np.linalg.det(frame) == pytest.approx(1.0)
    count = other_stars(1, 4, 6, stars, 5.0, others)
    rest = [k for k in range(len(vectors)) if k not in (1, 4, 6)]
    assert count == len(rest)
    along = vectors[rest] @ frame.T
    np.testing.assert_allclose(others.along[:, :count], along.T, atol=1e-15)
    apart2 = np.sum((vectors[1] - vectors[4]) ** 2)
    shared = sigma[1] ** 2 + sigma[4] ** 2
    lever2 = np.sum(along[:, 1:] ** 2, axis=1) / apart2
    np.testing.assert_allclose(others.gate2[:count], 25.0 * (sigma[rest] ** 2 + shared * (0.25 + lever2)))
    assert other_stars(1, 4, -1, stars, 5.0, others) == len(vectors) - 2
    many = np.random.default_rng(2).normal(size=(140, 3))
    many /= np.linalg.norm(many, axis=1, keepdims=True)
    assert other_stars(0, 1, -1, stars_of(many, np.full(140, 1e-4)), 5.0, others) == 120


def least(mean, chance):
    """Fewest matches that occur by chance with at most this probability."""
    return next(k for k in range(200) if poisson.sf(k - 1, mean) <= chance)


@pytest.mark.parametrize("mapped", [False, True])
@pytest.mark.parametrize(("chance", "enough"), [(1e-3, 99), (1e-9, 99), (1e-9, 3)])
@pytest.mark.parametrize("focal", [0.0, 0.01])
def test_the_first_candidate_that_other_stars_confirm(guide, mapped, chance, enough, focal):
    """As many of the others near guide stars as chance requires, or as are enough; with the shorter image of a longer
    focal length, and with a map of the sky or without."""
    longer = Camera(CAMERA.fx * (1.0 + focal), CAMERA.fy * (1.0 + focal), CAMERA.cx, CAMERA.cy, 512, 512)
    matrix = Attitude.from_radec_roll(83.0, 0.0, 40.0).as_matrix()
    index, vectors, _ = guide.in_field(matrix, -20.0)
    seen = CAMERA.unproject(longer.project(vectors))[:10]
    rng = np.random.default_rng(3)
    seen[6:] = CAMERA.unproject(rng.uniform(50.0, 460.0, (len(seen) - 6, 2)))  # false ones
    sigma = np.full(len(seen), 2e-4)
    stars = stars_of(seen, sigma)
    rows = [(0, 1, int(a), int(b), -1) for a, b in rng.integers(len(guide), size=(40, 2)) if a != b]
    rows += [(0, 1, int(index[0]), int(index[1]), 2), (2, 3, int(index[2]), int(index[3]), -1)]
    candidates = Candidates(np.array(rows, np.int32), np.full(len(rows), focal))
    directions, expected = guide.directions, []
    for j, k, a, b, i in rows:
        rest = [s for s in range(len(seen)) if s not in (j, k, i)]
        along = seen[rest] @ frame_of(seen[j], seen[k]).T
        apart2 = np.sum((seen[j] - seen[k]) ** 2)
        gate2 = 36.0 * (sigma[rest] ** 2 + 8e-8 * (0.25 + np.sum(along[:, 1:] ** 2, axis=1) / apart2))
        placed = along * [1.0, 1.0 - focal, 1.0 - focal] @ frame_of(directions[a], directions[b])
        away2 = ((placed[:, None] - directions) ** 2).sum(axis=2).min(axis=1)
        mean = 0.25 * gate2.sum() * len(guide)
        need = min(max(least(mean, chance), min(least(mean, 1e-4), enough)), len(rest))
        expected.append(np.sum(away2 <= gate2) >= need)
    map_ = occupancy_map(directions, 3.0 * 6.0 * 2e-4) if mapped else NO_OCCUPANCY
    confirmation = Confirmation(6.0, chance, enough, map_, 100.0, 7.0)
    found, at = [], 0
    while at < len(rows):
        start = at
        at, attitude, work = next_confirmed(candidates, at, stars, guide.view, confirmation, 1e12)
        tried = range(start, min(at + 1, len(rows)))
        assert work == sum(100.0 + 7.0 * (len(seen) - 2 - (rows[t][4] >= 0)) for t in tried)
        if at < len(rows):
            found.append(at)
            j, k, a, b, _ = rows[at]
            ends = [seen[s] + focal * stars.slopes[s] for s in (j, k)]
            np.testing.assert_allclose(attitude, frame_of(*ends).T @ frame_of(directions[a], directions[b]), atol=1e-12)
        at += 1
    assert found == np.flatnonzero(expected).tolist()
    assert len(rows) - 1 in found or chance < 1e-6
    one = 100.0 + 7.0 * (len(seen) - 2)
    if not expected[0] and not expected[1]:
        assert next_confirmed(candidates, 0, stars, guide.view, confirmation, one - 1.0)[2] == one
        assert next_confirmed(candidates, 0, stars, guide.view, confirmation, one)[2] == 2.0 * one


# ---------------------------------------------------------------------- triangles with a fourth star
def angle(p, q):
    return 2.0 * np.arcsin(np.minimum(np.linalg.norm(p - q, axis=-1) / 2.0, 1.0))


def confirmed(seen, guide, rotation, corners, guides):
    """Further stars, of the first 24, that a guide star explains: near its position, and at the right separations."""
    directions, matches, looked = guide.directions, 0, 0
    v, sigma = seen.vectors, seen.sigma
    sides = [seen.separation[corners[a], corners[b]] for a, b in ((0, 1), (0, 2), (1, 2))]
    three = sum(sigma[c] for c in corners)
    for e in range(len(v)):
        if e in corners:
            continue
        if looked >= 24:
            break
        looked += 1
        if matches == 0 and looked > 8:
            break
        apart = np.array([np.linalg.norm(v[e] - v[c]) for c in corners])
        limit = 4.5 * np.hypot(sigma[e], sigma[list(corners)]) + 1.1e-4 * apart
        gate = 4.5 * (sigma[e] + three / 3.0 * (1.0 + apart.max() / min(sides)))
        near = directions @ (rotation.T @ v[e]) >= 1.0 - 0.5 * gate**2
        near[list(guides)] = False
        chords = np.stack([np.linalg.norm(directions - directions[g], axis=1) for g in guides], axis=1)
        matches += bool((near & (np.abs(chords - apart) <= limit).all(axis=1)).any())
    return matches


@pytest.mark.parametrize("noise_px", [0.05, 1.5])
@pytest.mark.parametrize(("ra_deg", "dec_deg"), [(83.0, 0.0), (255.0, -35.0)])
def test_triangles_are_those_of_all_guide_triples(guide, noise_px, ra_deg, dec_deg):
    """Sides within their tolerances and the same orientation; of those with a fourth star the six with most."""
    _, vectors, index = field(guide, ra_deg, noise_px, 9, dec_deg=dec_deg)
    observed = Observed(vectors, None, np.full(len(vectors), max(noise_px, 0.05) * CAMERA.pixel_rad))
    view, settings = guide.view, PyramidSettings()
    pairs = _guide_pairs(guide, None)
    seen = _seen(observed, 6, settings, 1.0)
    pattern = np.flatnonzero(guide.pattern)
    table = angle(guide.directions[pattern][:, None], guide.directions[pattern])
    total = 0
    for corners in ((0, 1, 2), (1, 3, 5), (2, 4, 5)):
        i, j, k = corners
        sense = np.linalg.det(vectors[list(corners)])
        sides = [seen.separation[a, b] for a, b in ((i, j), (i, k), (j, k))]
        slack = [seen.tolerance[a, b] for a, b in ((i, j), (i, k), (j, k))]
        ij, ik, jk = (np.abs(table - side) <= wrong for side, wrong in zip(sides, slack, strict=True))
        counts = []
        for a, b in np.argwhere(ij):
            for c in np.flatnonzero(ik[a] & jk[b]):
                if len({a, b, c}) < 3 or np.linalg.det(guide.directions[pattern[[a, b, c]]]) * sense <= 0.0:
                    continue
                guides = pattern[[a, b, c]]
                rotation = _laid_on(vectors[list(corners)], guide.directions[guides], np.array(sides))
                counts.append(confirmed(seen, guide, rotation, corners, guides))
        triples = np.array([corners])
        at, found, matrices, matches, left = search_pyramids(seen, triples, 0, pairs, view, 1, 10**9)
        best = sorted((c for c in counts if c >= 1), reverse=True)[:6]
        assert (at, found) == (1, len(best))
        assert matches[:found].tolist() == best
        total += found
        assert left < 10**9
        assert (pairs.head == -1).all()
        more = search_pyramids(seen, triples, 0, pairs, view, best[0] + 1 if best else 1, 10**9)
        assert more[1] == 0
        if noise_px < 1.0 and set(index[list(corners)]) <= set(pattern):
            true = Attitude.from_radec_roll(ra_deg, dec_deg, 40.0)
            assert Attitude.from_matrix(matrices[0]).angle_to(true) < 5.0 * CAMERA.pixel_rad
    assert total >= 3


def test_a_triangle_is_laid_on_by_its_longest_side():
    rng = np.random.default_rng(5)
    for k, pair in enumerate(((0, 1), (0, 2), (1, 2))):
        observed, reference = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in rng.normal(size=(2, 3, 3)))
        rotation = Rotation.random(rng=rng).as_matrix()
        reference[list(pair)] = observed[list(pair)] @ rotation  # the third star is elsewhere
        sides = np.array([0.1, 0.1, 0.1])
        sides[k] = 0.2
        np.testing.assert_allclose(_laid_on(observed, reference, sides), rotation, atol=1e-12)


def test_slender_triangles_and_used_budgets(guide):
    """Four standard errors high at least; a search ends when its steps are used up."""
    _, vectors, _ = field(guide, 83.0, 0.05, 9, dec_deg=0.0)
    observed = Observed(vectors, None, np.full(len(vectors), 0.05 * CAMERA.pixel_rad))
    pairs, view = _guide_pairs(guide, None), guide.view
    seen = _seen(observed, 6, PyramidSettings(), 1.0)
    i, j, k = 0, 1, 2
    sense = abs(np.linalg.det(vectors[[i, j, k]]))
    widest = max(seen.separation[i, j], seen.separation[i, k], seen.separation[j, k])
    for factor, tried in ((0.99, True), (1.01, False)):
        sigma = np.full(len(vectors), factor * sense / (4.0 * widest))
        left = search_pyramids(seen._replace(sigma=sigma), np.array([[i, j, k]]), 0, pairs, view, 1, 1000)[4]
        assert (left < 1000) is tried
    triples = np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4], [1, 2, 3]])
    at, found, *_, left = search_pyramids(seen, triples, 0, pairs, view, 99, 1)
    assert (at, found) == (1, 0)
    assert left <= 0
    assert search_pyramids(seen, triples, 3, pairs, view, 99, 10**9)[0] == 4
    assert search_pyramids(seen, triples, 4, pairs, view, 99, 10**9)[0] == 4


def test_pairs_around_a_prior_are_those_of_its_cone(guide):
    attitude = Attitude.from_radec_roll(83.0, 0.0, 40.0)
    prior = Prior(attitude, 0.05)
    near = _guide_pairs(guide, prior)
    inside = guide.directions @ attitude.boresight > math.cos(guide.half_diagonal_rad + 0.051)
    assert inside[near.first].all()
    assert inside[near.second].all()
    assert len(near.first) < len(_guide_pairs(guide, None).first)
    assert (near.head == -1).all()
