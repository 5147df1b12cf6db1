"""The default identification step by step: what is assumed, tried, confirmed and verified, and when it ends."""

import math
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import pdtr

from startracker import Attitude, Camera
from startracker.catalog import load_catalog
from startracker.catalog.guide import GuideDatabase
from startracker.estimation.directions import focal_slopes
from startracker.identification import about_knot as knots
from startracker.identification import candidate_search as checks
from startracker.identification.acceptance import Hypothesis, HypothesisPool
from startracker.identification.adaptive import _FOCAL, _SEVEN, _STATED, _THREE, _assumptions, _rounded, _Search, _work
from startracker.identification.candidate_search import SearchBudget, Verifier, next_verified
from startracker.identification.observed import Observed, Prior
from startracker.identification.other_stars import Occupancy
from startracker.identification.search_plan import (
    Plan,
    Setting,
    _poisson_quantile,
    crowding_price,
    evidence_of_matches,
    fewest_matches,
    plan,
)
from startracker.identification.search_state import Candidates, Limits
from startracker.identification.verification import Verified
from startracker.settings import AdaptiveSettings

module = sys.modules[_Search.__module__]  # the package names its function so, too
CAMERA = Camera.from_fov(10.0, 512, 512)
SIGMA = 0.15 * CAMERA.pixel_rad
LIMITS = Limits(2.2, 0.0, 99.0, 0.02, 1000.0, np.eye(3), -2.0)


@pytest.fixture(scope="module")
def guide():
    return GuideDatabase.build(load_catalog("hipparcos"), CAMERA, 6.0)


def observed(count=12, seed=1):
    xy = np.random.default_rng(seed).uniform(0.0, 511.0, (count, 2))
    sigma = np.full(count, SIGMA)
    sigma[0] *= 3.0
    return Observed(CAMERA.unproject(xy), None, sigma)


# ---------------------------------------------------------------------- order of the searches
@pytest.mark.parametrize(
    ("ends", "fits", "calls"),
    [
        ((), False, ["t1", "t2", "t3", "v1", "v2", "v3", "v4"]),
        (("t1",), False, ["t1"]),
        (("t3",), False, ["t1", "t2", "t3"]),
        ((), True, ["t1", "t2", "t3"]),
        (("v2",), False, ["t1", "t2", "t3", "v1", "v2"]),
    ],
)
def test_triangles_under_each_assumption_come_before_votes(monkeypatch, ends, fits, calls):
    names, seen = {_STATED: "1", _THREE: "2", _FOCAL: "3", _SEVEN: "4"}, []

    class Fake:
        fits_as_stated = fits
        pool = SimpleNamespace(outcome=lambda stars: ("outcome", len(stars)))

        def __init__(self, *given):
            pass

        def triangles(self, assumption):
            seen.append("t" + names[assumption])
            return seen[-1] in ends

        def votes(self, assumption):
            seen.append("v" + names[assumption])
            return seen[-1] in ends

    monkeypatch.setattr(module, "_Search", Fake)
    assert module.adaptive(observed(), None) == ("outcome", 12)
    assert seen == calls


def test_a_tolerance_of_the_user_is_the_only_assumption():
    """3.7 standard errors of a separation, √2 of those of a direction."""
    stars = observed()
    (quick,), thorough = _assumptions(AdaptiveSettings(separation_tolerance_deg=0.05), stars)
    assert thorough == (quick,)
    assert quick.multiple == pytest.approx(math.radians(0.05) / (3.7 * math.sqrt(2.0)) / SIGMA)
    assert quick._replace(words="", multiple=0.0) == _STATED._replace(words="", multiple=0.0)
    assert _assumptions(AdaptiveSettings(), stars) == ((_STATED, _THREE, _FOCAL), (_STATED, _THREE, _FOCAL, _SEVEN))


def hypothesis(evidence, focal=1.0, scale=1.25):
    pairs = np.column_stack([np.arange(8), np.arange(8)])
    return Hypothesis(np.eye(3), pairs, evidence, scale, 30, focal)


@pytest.mark.parametrize(
    ("beyond", "focal", "scale", "fits"),
    [
        (5.1, 1.0, 2.2, True),
        (4.9, 1.0, 2.2, False),
        (5.1, 1.001, 2.2, False),
        (5.1, 1.0, 2.3, False),
    ],
)
def test_an_answer_that_fits_as_stated(guide, beyond, focal, scale, fits):
    """Accepted with a margin of e^5, with the stated focal length and 2.2 times the errors at most."""
    search = _Search(observed(), guide, AdaptiveSettings(), None)
    assert not search.fits_as_stated
    search.pool.add(hypothesis(search.pool.least_evidence + beyond, focal, scale))
    assert search.fits_as_stated is fits


@pytest.mark.parametrize("stars", [12, 40])
@pytest.mark.parametrize(("share", "used"), [(1.0, 0), (0.01, 0), (1.0, 10**7)])
def test_limits_of_a_search(guide, stars, share, used):
    """Operations in proportion to those of the setting, no more than are left; a prior is widened by six errors and the
    range of the focal length."""
    usual = AdaptiveSettings().max_operations
    settings = AdaptiveSettings(max_operations=int(share * usual), false_alarm_rate=1e-4, magnitude_tolerance=0.7)
    search = _Search(observed(stars), guide, settings, None)
    search.pool.operations = search.pool.left - 123 if used else 0
    for assumption, work in (
        (_STATED, 4.5e6 * math.sqrt(stars)),
        (_THREE, 400e3 * math.sqrt(min(stars, 25))),
        (_FOCAL, 200e3 * math.sqrt(min(stars, 25))),
    ):
        assert _work(assumption, stars) == pytest.approx(work)
        found = search._limits(assumption)
        assert found.work == pytest.approx(123.0 if used else work * share, rel=1e-6)
        assert (found.scale, found.focal_range) == (assumption.multiple, assumption.focal_range)
        assert (found.magnitude_tolerance, found.prior_cosine) == (0.7, -2.0)
        assert found.chance == max(assumption.chance, 1e-3)
    often = _Search(observed(stars), guide, AdaptiveSettings(false_alarm_rate=0.01), None)
    assert often._limits(_STATED).chance == pytest.approx(0.1)
    attitude = Attitude.from_radec_roll(84.0, 2.0, 75.0)
    around = _Search(observed(stars), guide, settings, Prior(attitude, 0.1))._limits(_FOCAL)
    assert around.prior_cosine == pytest.approx(math.cos(0.1 + 6.0 * 2.2 * 3.0 * SIGMA + 0.025))
    np.testing.assert_array_equal(around.prior, attitude.as_matrix())
    whole = _Search(observed(stars), guide, settings, Prior(attitude, 3.13))._limits(_FOCAL)
    assert whole.prior_cosine == -1.0


@pytest.mark.parametrize("assumption", [_STATED, _FOCAL, _SEVEN])
@pytest.mark.parametrize("stars", [20, 150])
def test_the_plan_of_the_votes(guide, assumption, stars):
    """Pairs in the gate of a side, rolls that it covers, guide stars in the gate of a further star; of long lists the
    brightest 120 and their part of the matches."""
    seen = observed(stars)
    search = _Search(seen, guide, AdaptiveSettings(), None)
    found, fewest = search._plan(assumption)
    area, n, free = guide.solid_angle_sr, min(stars, 120), assumption.focal_range
    in_field = round(len(guide) * area / (4.0 * math.pi))
    log_area = round(math.log(area / SIGMA**2), 1)
    evidence = evidence_of_matches(stars, in_field, log_area, assumption.residual, 4 if free else 3)
    price = crowding_price(search._stars.excess)
    expected = max(fewest_matches(evidence, price, search.pool.least_evidence) * n // stars, 3)
    assert fewest == expected
    if expected > n:
        assert found == Plan(0, 0, 0)
        return
    side, near = math.sqrt(area), guide.pairs_within(0.6).separation_rad
    error = module.VOTE_SIGMAS * assumption.multiple * SIGMA * math.sqrt(2.0)
    density = len(near) / near[-1] ** 2  # pairs by the square of their separation
    setting = Setting(
        _rounded(2.0 * side * 2.0 * (error + free * 0.5 * side) * density),
        len(guide),
        _rounded(1.0 + 2.0 * error / (0.3 * side) / (2.0 * math.pi / 64)),
        _rounded(math.pi * (4.5 * assumption.multiple * SIGMA) ** 2 * len(guide) / (4.0 * math.pi)),
        assumption.chance,
    )
    multiples = (1.0, 1.5, 2.25, 3.5) if assumption is _STATED else (1.0,)
    assert found == plan(n, expected, assumption.miss, _work(assumption, n), setting, multiples)
    assert _rounded(123456.0) == 120000.0


def none_found(count=0):
    return Candidates(np.zeros((count, 5), np.int32), np.zeros(count))


def test_triangles_are_tried_in_doubling_numbers(guide, monkeypatch):
    search, sizes = _Search(observed(), guide, AdaptiveSettings(), None), []
    monkeypatch.setattr(module, "similar_triangles", lambda some, *_: (sizes.append(len(some)), (none_found(), 7.0))[1])
    assert not search.triangles(_STATED)
    assert sizes == [1, 2, 4, 5]  # twelve
    assert search.pool.operations == 28
    assert search.pool.tried[-1]() == "errors as stated: 12 triangles, 0 similar ones in the sky, 0 with some evidence"
    search.pool.operations = search.pool.settings.max_operations
    assert search.triangles(_STATED)
    assert search.pool.cut_short
    assert len(sizes) == 4


@pytest.mark.parametrize(
    ("planned", "assumption", "cut_short", "enough", "asked"),
    [
        (Plan(5, 4, 3), _STATED, False, 4, 5),
        (Plan(5, 4, 3, True), _STATED, True, 5, 5),
        (Plan(5, 4, 3, True), _THREE, False, 4, 5),
        (Plan(0, 0, 0, True), _STATED, True, None, 0),
        (Plan(0, 0, 0, True), _THREE, False, None, 0),
        (Plan(0, 0, 0), _STATED, False, None, 0),
    ],
)
def test_votes_about_as_many_poles_as_planned(guide, monkeypatch, planned, assumption, cut_short, enough, asked):
    """An incomplete search is reported under the stated errors only; there a confirmed star less is enough then."""
    search, poles, needed = _Search(observed(), guide, AdaptiveSettings(), None), [], []
    monkeypatch.setattr(search, "_plan", lambda _: (planned, 7))

    def vote(pole, neighbours, votes, *rest):
        poles.append((pole, neighbours.tolist(), votes, rest[-1].work))
        return none_found(), 100.0

    monkeypatch.setattr(module, "vote_about", vote)
    monkeypatch.setattr(
        search._verifier,
        "take",
        lambda c, effort, work: (needed.append(effort.enough), setattr(effort, "work", effort.work + work)),
    )
    assert not search.votes(assumption)
    assert search.pool.cut_short is cut_short
    assert len(poles) == asked
    if asked:
        assert [pole for pole, *_ in poles] == module.pole_order(5, 12)
        assert [around for _, around, _, _ in poles] == [search._nearest[pole, :4].tolist() for pole, *_ in poles]
        assert {votes for _, _, votes, _ in poles} == {3}
        np.testing.assert_allclose(np.diff([left for *_, left in poles]), -100.0)
        assert set(needed) == {enough}
        assert search.pool.operations == 500


def test_votes_end_when_an_answer_is_accepted_under_the_stated_errors(guide, monkeypatch):
    for assumption, beyond, done in (
        (_STATED, 0.1, True),
        (_STATED, -0.1, False),
        (_THREE, 0.1, False),
        (_THREE, 15.1, True),
    ):
        search = _Search(observed(), guide, AdaptiveSettings(), None)
        monkeypatch.setattr(search, "_plan", lambda _: (Plan(2, 4, 3), 7))
        monkeypatch.setattr(module, "vote_about", lambda *_: (none_found(), 1.0))
        search.pool.add(hypothesis(search.pool.least_evidence + beyond))
        assert search.votes(assumption) is done


def test_votes_that_use_up_their_operations(guide, monkeypatch):
    for assumption, reported in ((_STATED, True), (_THREE, False)):
        search = _Search(observed(), guide, AdaptiveSettings(), None)
        answer = none_found(), 0.6 * search._limits(assumption).work
        monkeypatch.setattr(search, "_plan", lambda _: (Plan(5, 4, 3), 7))
        monkeypatch.setattr(module, "vote_about", lambda *_, answer=answer: answer)
        assert not search.votes(assumption)
        assert search.pool.operations == int(2 * answer[1])
        assert search.pool.cut_short is reported


# ---------------------------------------------------------------------- candidates
def test_what_a_candidate_needs_and_costs():
    effort = SearchBudget(LIMITS, 300.0, 1.0, 50.0, 4)
    found = effort.confirmation
    assert (found.gate, found.chance, found.enough) == (pytest.approx(4.5 * 2.2), 0.02, 4)
    assert (found.candidate_work, found.star_work) == (300.0, 51.0)  # without a map, all stars are searched
    effort.occupancy = Occupancy(np.zeros(1, np.uint32), 1.0, 1.0, 0.1)
    assert effort.confirmation.star_work == 6.0
    effort.star_work = 0.0
    assert effort.confirmation.star_work == 5.0
    effort.occupancy = Occupancy(np.zeros(1, np.uint32), 1.0, -1.0, 0.1)
    assert effort.confirmation.star_work == 0.0
    assert not effort.ended
    effort.work = 1000.0
    assert not effort.ended
    effort.work = 1000.1
    assert effort.ended
    effort.work, effort.decided = 0.0, True
    assert effort.ended


def verified(log_b, scale=1.0, turn=0.0, focal=0.0):
    matrix = Rotation.from_rotvec([0.0, 0.0, turn]).as_matrix()
    return Verified(log_b, matrix, focal, scale, 9, np.array([[0, 1], [1, 2], [2, 3]]), 50)


class Sky:
    """Confirmation and verification of candidates, replaced by answers for each; the calls are recorded."""

    def __init__(self, monkeypatch, answers, confirmed=None):
        self.answers, self.asked, self.work = answers, [], []
        self.confirmed = list(range(len(answers))) if confirmed is None else confirmed
        monkeypatch.setattr(checks, "next_confirmed", self.confirm)
        monkeypatch.setattr(checks, "verify_attitude", self.verify)

    def confirm(self, candidates, at, stars, sky, confirmation, left):
        self.work.append(left)
        later = [k for k in self.confirmed if k >= at]
        self.now = later[0] if later else len(candidates.focal)
        return self.now, Rotation.from_rotvec([0.0, 0.0, 0.3 * self.now]).as_matrix(), 10.0

    def verify(self, matrix, focal, stars, sky, scale, free):
        self.asked.append((self.now, focal, scale, free, matrix))
        return self.answers[self.now].pop(0)


STARS = SimpleNamespace(sigma=np.array([1e-4, 5e-4, 2e-4]))


def search(start=0, count=3, known=None, limits=LIMITS, work=0.0):
    candidates = Candidates(np.zeros((count, 5), np.int32), np.array([0.01, 0.02, 0.03])[:count])
    known = np.empty((0, 3, 3)) if known is None else known
    return next_verified(candidates, start, known, STARS, None, None, limits, work)


def test_the_first_candidate_with_some_evidence(monkeypatch):
    """ln B above −5; others are verified and left, with their operations."""
    sky = Sky(monkeypatch, [[verified(-6.0)], [verified(-4.9)], [verified(9.0)]])
    at, found, work = search()
    assert (at, found.log_b, work) == (2, -4.9, 2 * 10.0 + 2 * 50)
    assert [asked[:4] for asked in sky.asked] == [(0, 0.01, 7.0, False), (1, 0.02, 7.0, False)]
    assert sky.work == [1000.0, 940.0]
    at, found, work = search(2)
    assert (at, found.log_b) == (3, 9.0)
    Sky(monkeypatch, [[verified(-5.0)]])
    assert search(0, 1)[1].log_b == -5.0
    Sky(monkeypatch, [[]], confirmed=[])
    at, found, work = search(0, 1)
    assert (at, found.log_b, work) == (2, -math.inf, 10.0)
    Sky(monkeypatch, [[verified(9.0)]])
    assert search(0, 1, limits=LIMITS._replace(scale=16.0))[1].log_b == 9.0


def test_a_poor_fit_is_repeated_with_a_free_focal_length(monkeypatch):
    """From the attitude found, and used if it is better by 3 in ln B; never if the focal length is free anyway."""
    for again, used in ((12.9, 10.0), (13.1, 13.1)):
        sky = Sky(monkeypatch, [[verified(10.0, 2.1, 0.5, 0.4), verified(again)]])
        _, found, work = search(0, 1)
        assert (found.log_b, work) == (used, 110.0)
        assert [(asked[1], asked[3]) for asked in sky.asked] == [(0.01, False), (0.0, True)]
        np.testing.assert_array_equal(sky.asked[1][4], verified(0.0, turn=0.5).matrix)
    for good in (verified(10.0, 2.0), verified(-5.1, 9.0)):
        sky = Sky(monkeypatch, [[good]])
        search(0, 1)
        assert len(sky.asked) == 1
    sky = Sky(monkeypatch, [[verified(10.0, 9.0)]])
    search(0, 1, limits=LIMITS._replace(focal_range=0.02, scale=9.0))
    assert [asked[2:4] for asked in sky.asked] == [(9.0, True)]


def test_known_attitudes_are_skipped(monkeypatch):
    """Within three times the errors of the brightest star."""
    same = 3.0 * 2.2 * 1e-4
    for off, skipped in ((0.99 * same, True), (1.01 * same, False)):
        sky = Sky(monkeypatch, [[verified(9.0)], [verified(8.0)], []])
        known = Rotation.from_rotvec([[0.0, 0.0, 2.0], [0.0, 0.0, off]]).as_matrix()
        assert search(known=known)[1].log_b == (8.0 if skipped else 9.0)
        assert sky.asked[0][0] == int(skipped)


def test_a_search_ends_with_its_operations(monkeypatch):
    sky = Sky(monkeypatch, [[verified(-9.0)], [verified(-9.0)], [verified(-9.0)]])
    at, _, work = search(work=950.0)
    assert (at, work, len(sky.asked)) == (1, 1010.0, 1)


def test_verified_candidates_become_hypotheses(guide, monkeypatch):
    """Their attitudes are known from then on; one with decisive evidence ends the search."""
    pool = HypothesisPool(AdaptiveSettings(), None, 12)
    stars = _Search(observed(), guide, AdaptiveSettings(), None)._stars
    verifier = Verifier(pool, guide, stars)
    enough = pool.decisive_evidence
    found = [
        (1, verified(9.0, turn=0.1), 20.0),
        (2, verified(-6.0, turn=0.2), 30.0),
        (3, verified(enough + 1.0, turn=0.3), 40.0),
    ]
    seen = []

    def next_one(candidates, at, known, *rest):
        seen.append((at, len(known), rest[-1]))
        return found[len(seen) - 1]

    monkeypatch.setattr(checks, "next_verified", next_one)
    effort = SearchBudget(LIMITS, 300.0, 1.0, 50.0)
    verifier.take(none_found(9), effort, 10.0)
    assert seen == [(0, 0, 10.0), (1, 1, 20.0), (2, 1, 30.0)]
    assert (effort.found, effort.kept, effort.work, effort.decided) == (9, 2, 40.0, True)
    assert len(pool.hypotheses) == 1  # the same pairs: the better one
    assert pool.hypotheses[0].log_evidence == enough + 1.0
    verifier.take(none_found(2), effort, 5.0)
    assert (len(seen), effort.found, effort.work) == (3, 11, 45.0)  # it has ended
    pool.operations = 100
    assert verifier.note(effort, lambda: "words")
    assert pool.operations == 145
    assert pool.tried[-1]() == "words, 11 similar ones in the sky, 2 with some evidence"


def test_the_sky_is_mapped_after_many_candidates(guide):
    verifier = Verifier(
        HypothesisPool(AdaptiveSettings(), None, 12), guide, _Search(observed(), guide, AdaptiveSettings(), None)._stars
    )
    effort = SearchBudget(LIMITS, 300.0, 1.0, 50.0)
    effort.found = 200
    verifier.map_sky(effort, 201, 2.25)
    assert (effort.occupancy.reach2, effort.work) == (-1.0, 0.0)
    effort.found = 201
    verifier.map_sky(effort, 201, 2.25)
    assert math.sqrt(effort.occupancy.reach2) == pytest.approx(2.25 * 4.5 * 2.2 * SIGMA)
    assert effort.work == 20.0 * len(guide)
    before = effort.occupancy
    verifier.map_sky(effort, 0, 9.0)
    assert effort.occupancy is before


# ---------------------------------------------------------------------- about a knot
def test_the_knot_is_the_half_nearest_to_the_median():
    at = np.array([0.0, 1.0, 2.0, 3.0, 10.0, -8.0, 2.1])
    vectors = np.column_stack([at, np.zeros(7), np.ones(7)])
    assert knots._inner_half(vectors).tolist() == [2, 6, 1, 3]
    assert len(knots._inner_half(vectors[:2])) == 2
    assert len(knots._inner_half(vectors[:3])) == 2


def test_pairings_that_others_support():
    """Within the tolerance in angle and in ln f, of other stars; one of those that agree, eight at most."""
    tolerance = 0.01

    def pairings(*rows):
        turns, log_focal, stars = zip(*rows, strict=True)
        matrix = Rotation.from_rotvec([[0.0, t, 0.0] for t in turns]).as_matrix()
        return knots._Pairings(matrix, np.array(log_focal), np.array(stars))

    one = pairings((0.0, 0.0, 0), (0.0099, 0.0, 1), (0.0101, 0.0, 2), (0.0, 0.0099, 3), (0.0, 0.0101, 4), (1.0, 0.0, 5))
    # the first agrees with two others; so does the second, and the third with the second only
    assert knots._most_supported(one, tolerance)[0] in (0, 1)
    assert 5 not in knots._most_supported(one, tolerance)
    same = pairings((0.0, 0.0, 0), (0.001, 0.0, 0), (1.0, 0.0, 1), (1.0, 0.001, 2), (1.001, 0.0, 3))
    chosen = knots._most_supported(same, tolerance)
    assert len(chosen) == 1  # of the other stars none supports the first two
    assert chosen[0] in (2, 3, 4)
    many = pairings(*[(0.2 * k, 0.0, s) for k in range(12) for s in (0, 1)])
    assert knots._most_supported(many, tolerance) == [0, 2, 4, 6, 8, 10, 12, 14]
    beyond = pairings((0.0, 0.0, 0), (0.0101, 0.0, 1), (0.5, 0.0, 2), (0.5, 0.0101, 3))
    assert knots._most_supported(beyond, tolerance) == []


@pytest.mark.parametrize("focal", [0.98, 1.0, 1.02])
def test_pairings_of_a_knot_and_another_star(guide, focal):
    """The centre and the star give the attitude and the focal length: among the pairings of a star is the true one."""
    attitude = Attitude.from_radec_roll(84.0, 2.0, 75.0)
    camera = Camera(CAMERA.fx * focal, CAMERA.fy * focal, CAMERA.cx, CAMERA.cy, 512, 512)
    index, vectors, _ = guide.in_field(attitude.as_matrix(), 30.0)
    seen = Observed(CAMERA.unproject(camera.project(vectors)), None, np.full(len(index), SIGMA))
    centre = np.argsort(np.linalg.norm(vectors - [0.0, 0.0, 1.0], axis=1))[:3]
    pairs = np.column_stack([centre, index[centre]])
    found = knots._pairings(pairs, seen, guide)
    slopes = focal_slopes(np.ascontiguousarray(seen.vectors))
    inner = pairs[knots._inner_half(seen.vectors[pairs[:, 0]])]
    assert np.isfinite(found.matrix).all()
    np.testing.assert_allclose(np.linalg.det(found.matrix), 1.0)
    assert np.abs(found.log_focal).max() <= knots.MOST_FOCAL_ERROR * 1.0001
    turns = np.array([Attitude.from_matrix(m).angle_to(attitude) for m in found.matrix])
    away = [
        n
        for n in range(len(index))
        if np.linalg.norm(seen.vectors[n] - seen.vectors[inner[:, 0]].mean(axis=0)) > 0.27 * guide.half_diagonal_rad
    ]
    assert set(found.star) <= set(range(len(index)))
    assert len(away) > 4
    for n in away[:8]:
        mine = found.star == n
        assert 0 < mine.sum() <= 24
        right = mine & (turns < 1e-3) & (np.abs(found.log_focal - math.log(focal)) < 1e-3)
        assert right.any()
        k = np.flatnonzero(right)[0]
        corrected = seen.vectors[n] + found.log_focal[k] * slopes[n]
        assert np.linalg.norm(found.matrix[k] @ guide.directions[index[n]] - corrected) < 1e-3


def test_the_quantile_of_a_count_is_the_smallest_that_reaches_the_probability():
    """At probabilities that a count has exactly, and just below and above."""
    mean = np.geomspace(0.05, 200.0, 60)
    for count in (0, 1, 2, 5, 11, 30):
        reached = pdtr(count, mean)
        for m, q in zip(mean, reached, strict=True):
            if 1e-6 < q < 1.0 - 1e-6:
                one = np.array([m])
                assert _poisson_quantile(q, one).tolist() == [count]
                assert _poisson_quantile(q * (1.0 - 1e-7), one).tolist() == [count]
                assert _poisson_quantile(q * (1.0 + 1e-7), one).tolist() == [count + 1]
