"""The votes of a star's neighbours against brute force, and what a search by them needs."""

import math

import numpy as np
import pytest
from scipy.stats import hypergeom

from startracker.catalog import load_catalog
from startracker.catalog.guide import GuideDatabase
from startracker.estimation.directions import focal_slopes
from startracker.geometry.attitude import Attitude
from startracker.geometry.camera import Camera
from startracker.identification.acceptance import HypothesisPool, kernel_stars, verify
from startracker.identification.adaptive import nearest_stars
from startracker.identification.bayes_factor import count_table, largest_density
from startracker.identification.candidate_search import SearchBudget, Verifier
from startracker.identification.observed import Observed
from startracker.identification.pairs import separation
from startracker.identification.pole_votes import VOTE_SIGMAS, VoteCounts, pair_bearings, vote_about
from startracker.identification.search_plan import Setting, crowding_price, evidence_of_matches, fewest_matches, plan
from startracker.identification.search_state import Guides, Limits, Pairs, Stars
from startracker.settings import AdaptiveSettings

CAMERA = Camera.from_fov(20.0, 512, 512)
SIGMA = 0.15 * CAMERA.pixel_rad


@pytest.fixture(scope="module")
def guide():
    return GuideDatabase.build(load_catalog("hipparcos"), CAMERA, 4.5)


def searched(guide, stars, limits, nearest, need):
    """Candidates about each pole, and the operations."""
    near = guide.pairs_within(10.0)  # of any length
    pairs = Pairs(near.first, near.second, near.separation_rad)
    there, back = pair_bearings(guide.directions, near.first, near.second)
    g, sky = len(guide), Guides(guide.directions, guide.v_mag)
    counts = VoteCounts(there, back, np.empty(g, np.uint64), np.empty((g, 4), np.uint64), np.full(g, -1, np.int32))
    found = [vote_about(k, row, need, stars, sky, pairs, counts, limits) for k, row in enumerate(nearest)]
    assert (counts.head == -1).all()
    return [candidates for candidates, _ in found], sum(work for _, work in found)


def turn_from_north(v, w):
    """Bearing of w at v in a tangent frame of another make: east and north."""
    east = np.array([-v[1], v[0], 0.0])
    return math.atan2(w @ np.cross(v, east), w @ east)


def test_bearings_differ_as_those_from_north_do(guide):
    rng = np.random.default_rng(1)
    first = rng.integers(len(guide), size=300).astype(np.int32)
    second, third = ((first + step) % len(guide) for step in (np.int32(7), np.int32(19)))
    sky = guide.directions
    one, two = (pair_bearings(sky, first, other)[0].astype(float) for other in (second, third))
    for k in range(len(first)):
        real = turn_from_north(sky[first[k]], sky[third[k]]) - turn_from_north(sky[first[k]], sky[second[k]])
        error = (two[k] - one[k]) * 2.0 * math.pi / 65536 - real
        assert abs(math.remainder(error, 2.0 * math.pi)) < 2.0e-4
    assert np.array_equal(pair_bearings(sky, first, second)[1], pair_bearings(sky, second, first)[0])


@pytest.mark.parametrize("seed", range(3))
def test_two_votes_are_the_triangles_of_brute_force(seed):
    sky = GuideDatabase.build(load_catalog("hipparcos"), CAMERA, 3.2)  # some two hundred stars
    rng = np.random.default_rng(seed)
    corners = np.array([[0.0, 0.0, 1.0], [0.3, 0.05, 1.0], [-0.05, 0.35, 1.0]]) + 0.05 * rng.standard_normal((3, 3))
    vectors = corners / np.linalg.norm(corners, axis=1, keepdims=True)
    sigma = np.full(3, 0.008)
    stars = Stars(vectors, focal_slopes(vectors), sigma, np.full(3, np.nan), count_table(3, 20), np.zeros((1, 3)))
    limits = Limits(1.0, 0.0, 99.0, 0.5, 1e12, np.eye(3), -2.0)
    (candidates,), operations = searched(sky, stars, limits, np.array([[1, 2]]), 2)
    real = separation(sky.directions[:, None], sky.directions[None, :])
    sides = [float(separation(vectors[0], vectors[k])) for k in (1, 2)]
    error = [VOTE_SIGMAS * math.hypot(0.008, 0.008) + 1.02e-4 * side for side in sides]
    use = np.flatnonzero(sky.pattern)
    far, expected = int(sides[1] > sides[0]), 0
    seen = [turn_from_north(vectors[0] @ TILT, vectors[k] @ TILT) for k in (1, 2)]
    for a in use:
        one, two = ([b for b in use if b != a and abs(real[a, b] - sides[k]) <= error[k]] for k in (0, 1))
        rolls = [
            np.array([turn_from_north(sky.directions[a], sky.directions[b]) - seen[k] for b in group])
            for k, group in enumerate((one, two))
        ]
        if len(one) and len(two):
            apart = np.abs((rolls[far][:, None] - rolls[1 - far][None, :] + math.pi) % (2.0 * math.pi) - math.pi)
            slack = sum(error[k] / math.sin(sides[k]) for k in (0, 1))
            expected += int((apart <= slack).any(axis=1).sum())
    assert operations > 0.0
    assert expected > 20
    assert abs(len(candidates.focal) - expected) <= 0.02 * expected + 1  # bearings are rounded


TILT = Attitude.from_radec_roll(10.0, 20.0, 30.0).as_matrix()
"""Turns the camera's axis away from the pole, where there is no north."""


@pytest.mark.parametrize("factor", [1.0, 0.98, 1.02])
def test_votes_alone_find_a_field_among_as_many_false_stars(guide, factor):
    attitude = Attitude.from_radec_roll(84.0, 2.0, 75.0)
    camera = Camera(CAMERA.fx * factor, CAMERA.fy * factor, CAMERA.cx, CAMERA.cy, 512, 512)
    index, _, xy = guide.in_field(attitude.as_matrix(), 0.0, camera)
    rng = np.random.default_rng(4)
    xy = np.concatenate([rng.uniform(0.0, 511.0, xy.shape), xy + 0.1 * rng.standard_normal(xy.shape)])
    observed = Observed(CAMERA.unproject(xy), None, np.full(len(xy), SIGMA))
    limits = Limits(2.2, 0.025 if factor != 1.0 else 0.0, 2.0, 0.01, 1e12, np.eye(3), -2.0)
    stars = kernel_stars(observed, guide)
    pool = HypothesisPool(AdaptiveSettings(), None, len(xy))
    verifier = Verifier(pool, guide, stars)
    candidates, _ = searched(guide, stars, limits, nearest_stars(observed.vectors), 4)
    for found in candidates:
        verifier.take(found, SearchBudget(limits, 100.0, 1.0, 25.0, enough=3), 0.0)
    best = pool.hypotheses[0]
    assert best.focal == pytest.approx(factor, abs=2e-3)
    guides = np.full(len(xy), -1)
    guides[best.pairs[:, 0]] = best.pairs[:, 1]
    assert (guides[len(index) :] == index).mean() > 0.9  # a false star may be the nearer one


def test_fewest_matches_are_those_of_whole_fields(guide):
    """Of fields with few true stars and perfect places the evidence is that of `verify`, to some matches."""
    rng = np.random.default_rng(6)
    enough = []
    for _ in range(120):
        axis = rng.standard_normal(3)
        ra, dec = math.degrees(math.atan2(axis[1], axis[0])), math.degrees(math.atan2(axis[2], np.hypot(*axis[:2])))
        attitude = Attitude.from_radec_roll(ra, dec, rng.uniform(0.0, 360.0))
        index, _, true = guide.in_field(attitude.as_matrix())
        if len(index) < 12:
            continue
        for m in range(3, 12):
            chosen = true[np.sort(rng.permutation(len(index))[:m])]
            xy = np.concatenate([chosen, rng.uniform(0.0, 511.0, (20 - m, 2))])
            observed = Observed(CAMERA.unproject(xy), None, np.full(20, SIGMA))
            found, _ = verify(attitude.as_matrix(), observed, guide)
            if found is not None and found.log_evidence > math.log(largest_density(20)) - math.log(1e-7):
                enough.append(m)
                break
    in_field = round(len(guide) * guide.solid_angle_sr / (4.0 * math.pi))
    evidence = evidence_of_matches(20, in_field, math.log(guide.solid_angle_sr / SIGMA**2), 0.4, 3)
    expected = fewest_matches(evidence, np.zeros(20), math.log(largest_density(20)) - math.log(1e-7))
    assert len(enough) >= 15
    assert abs(expected - np.median(enough)) <= 1.0


def test_crowded_points_need_more_matches():
    evidence = evidence_of_matches(20, 30, 15.0, 0.4, 3)
    even, crowded, clump = (crowding_price(np.full((1, 20), excess)) for excess in (0.0, 5.0, 50.0))
    assert fewest_matches(evidence, even, 12.0) < fewest_matches(evidence, crowded, 12.0)
    assert fewest_matches(evidence, clump, 12.0) == 21


SETTING = Setting(pairs=3e3, guides=8800, rolls=1.1, gate=1e-4, rare=0.02)


@pytest.mark.parametrize(("n", "fewest"), [(8, 5), (15, 6), (40, 7)])
def test_a_plan_misses_as_seldom_as_it_says(n, fewest):
    """Simulated: stars are true at random, and so are the neighbours of each."""
    miss = 0.02
    planned = plan(n, fewest, miss, 1e9, SETTING, (1.0,))
    rng = np.random.default_rng(n)
    missed, trials = 0, 4000
    for _ in range(trials):
        true = rng.permutation(n) < fewest
        found = False
        for pole in np.flatnonzero(true[: planned.poles]):
            around = rng.permutation(np.delete(true, pole))[: planned.neighbours]
            found |= int(around.sum()) >= planned.votes
        missed += not found
    assert missed / trials <= 1.5 * miss + 3.0 * math.sqrt(miss / trials)
    assert hypergeom.sf(planned.votes - 1, n - 1, fewest - 1, planned.neighbours) > 0.1


def test_a_plan_keeps_to_what_it_may_cost():
    free = plan(40, 7, 0.0025, 1e9, SETTING, (1.0,))
    bound = plan(40, 7, 0.0025, 1e6, SETTING, (1.0,))
    none = plan(40, 7, 0.0025, 1e3, SETTING, (1.0,))
    assert none.poles == 0 < bound.poles < free.poles <= 40


def test_a_plan_that_cannot_find_the_fewest_looks_for_more():
    crowded, most = SETTING._replace(gate=5.8e-4), (1.0, 2.0, 4.0)
    fewest = plan(120, 4, 0.0025, 33e6, crowded, (1.0,))
    assert fewest.cut_short
    assert plan(120, 4, 0.0025, 33e6, crowded, most).poles > 10 * fewest.poles
    # where the fewest are found, so are more
    assert plan(15, 6, 0.02, 1e9, SETTING, most) == plan(15, 6, 0.02, 1e9, SETTING, (1.0,))
