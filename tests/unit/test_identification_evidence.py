"""Evidence and acceptance of an attitude, written out by their formulas, and the pool of hypotheses that decides."""

import math
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import gammaln, logsumexp
from scipy.stats import norm

from startracker import Camera
from startracker.geometry.attitude import Attitude
from startracker.identification.acceptance import (
    SURE_BEYOND,
    Hypothesis,
    HypothesisPool,
    _describe,
    _gain,
    too_few,
    tried_scales,
)
from startracker.identification.bayes_factor import (
    DISTRACTORS,
    SCALE_LOG_PRIOR,
    SCALES,
    SEEN,
    Matched,
    count_table,
    largest_density,
    log_assignments,
    log_bayes_factor,
    log_magnitude_ratios,
)
from startracker.identification.observed import Observed, Prior, as_prior, usable_directions
from startracker.identification.search_plan import crowding_price, evidence_of_matches, fewest_matches
from startracker.settings import IdentificationSettings
from startracker.solution import Status


# ---------------------------------------------------------------------- Bayes factor
@cache
def weight_of(n, matches, depth):
    """ln of the probability that given guide stars of those within a depth are given ones of the n, the others none."""
    if matches > depth:
        return -math.inf
    found = logsumexp([math.log(w) + matches * math.log(p) + (depth - matches) * math.log1p(-p) for p, w in SEEN])
    others = logsumexp([math.log(w) - mean + (n - matches) * math.log(mean) for mean, w in DISTRACTORS])
    return found + others - gammaln(n + 1.0)


@cache
def total_of(n, depth):
    """ln of the probability of n stars, summed over all depths up to this one."""

    def ways(m, d):
        return math.log(math.comb(d, m)) + gammaln(n + 1.0) - gammaln(n - m + 1.0)

    return logsumexp([weight_of(n, m, d) + ways(m, d) for d in range(1, depth + 1) for m in range(min(n, d) + 1)])


def assignments(gain, rank, in_field, n):
    """ln of the ratio, averaged over the depths; for each depth the best number of the largest gains within it."""
    terms = []
    for depth in range(1, in_field + 1):
        within = sorted((g for g, r in zip(gain, rank, strict=True) if r < depth), reverse=True)
        terms.append(max(sum(within[:m]) + weight_of(n, m, depth) for m in range(len(within) + 1)))
    return logsumexp(terms) - total_of(n, in_field)


@pytest.mark.parametrize("seed", range(4))
def test_the_ratio_of_assignments_is_that_of_all_depths(seed):
    rng = np.random.default_rng(seed)
    n, in_field, m = 9, 12, 5
    gain, rank = np.sort(rng.normal(4.0, 5.0, m))[::-1].copy(), rng.permutation(in_field)[:m]
    found = log_assignments(gain, rank, in_field, count_table(n, 20))
    assert found == pytest.approx(assignments(gain, rank, in_field, n), rel=1e-10)


@pytest.mark.parametrize("free", [False, True])
@pytest.mark.parametrize("errors", [0.3, 1.2, 3.5])
def test_the_evidence_is_the_sum_over_widths_and_scatters(free, errors):
    """The width without magnitudes that fits best and its neighbours; with a Gaussian prior of the focal length."""
    rng = np.random.default_rng(int(10 * errors))
    n, in_field, area, focal_sigma = 10, 14, 0.03, 0.01
    sigma = rng.uniform(0.8e-4, 1.2e-4, n)
    distance = np.where(np.arange(n) < 6, errors * sigma * rng.rayleigh(1.0, n), np.inf)
    rank = rng.permutation(in_field)[:n]
    ratios = rng.normal(0.5, 0.5, (2, n))
    root = rng.normal(size=(4, 12)) * 1e4
    root[3] *= 0.02
    information = (root @ root.T)[: 3 + free, : 3 + free]
    counts = count_table(n, 2 * n + 10)
    found, width = log_bayes_factor(
        Matched(distance, rank, sigma, ratios), information, in_field, area, focal_sigma, counts
    )
    volumes, values = [], []
    for scale, log_prior in zip(SCALES, SCALE_LOG_PRIOR, strict=True):
        normal = information / scale**2
        if free:
            normal = normal + np.diag([0.0, 0.0, 0.0, focal_sigma**-2.0])
        unknowns = len(normal)
        volume = 0.5 * unknowns * math.log(2.0 * math.pi) - 0.5 * np.linalg.slogdet(normal)[1]
        volume -= math.log(8.0 * math.pi**2) + (math.log(focal_sigma * math.sqrt(2.0 * math.pi)) if free else 0.0)
        volumes.append(volume + log_prior)
        density = np.log(
            area * norm.pdf(distance[:6], scale=scale * sigma[:6]) / (math.sqrt(2.0 * math.pi) * scale * sigma[:6])
        )
        values.append(
            [
                volume + log_prior + assignments(density + more, rank[:6], in_field, n)
                for more in (0.0, ratios[0, :6], ratios[1, :6])
            ]
        )
    best = int(np.argmax([value[0] for value in values]))
    around = [value for s in range(max(best - 1, 0), min(best + 2, len(SCALES))) for value in values[s][1:]]
    assert width == SCALES[best]
    assert found == pytest.approx(logsumexp(around) - math.log(2.0), rel=1e-9)
    for nothing in (np.where(np.arange(n) < 2, distance, np.inf), distance):
        few = Matched(nothing, rank, sigma, ratios)
        assert (
            log_bayes_factor(few, information, 0 if nothing is distance else in_field, area, 0.01, counts)[0]
            == -math.inf
        )


@pytest.mark.parametrize("guides", [20, 60])
def test_magnitudes_are_compared_with_those_of_the_field(guides):
    """A core of 0.12 or 0.35 mag with wings of 1.5 mag, a fifth of it, and a floor; the density of the field from each
    second star or more; the first star pays the largest gain for the zero point."""
    rng = np.random.default_rng(guides)
    field = np.sort(rng.uniform(2.0, 7.0, guides))
    matched = np.full(12, -1)
    matched[[1, 3, 4, 7, 8]] = rng.permutation(guides)[:5]
    magnitude = rng.normal(20.0, 1.0, 12)
    seen = matched >= 0
    magnitude[seen] = field[matched[seen]] + 15.0 + np.array([0.1, -0.05, 0.0, 3.0, 0.3])
    zero = np.median(magnitude[seen] - field[matched[seen]])
    sample = field[:: max(1, guides // 24)]
    found = log_magnitude_ratios(magnitude, matched, field)
    for row, scatter in zip(found, (0.12, 0.35), strict=True):

        def density(d, scatter=scatter):
            return 0.8 * norm.pdf(d, scale=scatter) + 0.2 * norm.pdf(d, scale=1.5)

        likely = density(magnitude[seen] - field[matched[seen]] - zero)
        by_chance = density(magnitude[seen][:, None] - zero - sample).mean(axis=1)
        expected = np.log((likely + 1e-3) / (by_chance + 1e-3))
        expected[0] -= max(expected.max(), 0.0)
        np.testing.assert_allclose(row[seen], expected, rtol=1e-6)
        assert not row[~seen].any()
    two = np.where(np.arange(12) < 4, matched, -1)
    assert not log_magnitude_ratios(magnitude, two, field).any()


@pytest.mark.parametrize(("scale", "unknowns"), [(0.4, 3), (0.5, 4), (2.2, 3), (9.0, 3)])
def test_evidence_of_a_number_of_matches(scale, unknowns):
    """Perfect matches of a field of K stars, spread evenly over the brightnesses, at the nearest width."""
    n, in_field, log_area = 8, 11, 16.0
    found = evidence_of_matches(n, in_field, log_area, scale, unknowns)
    row = int(np.argmin(np.abs(SCALES - scale)))
    area = log_area - 2.0 * math.log(SCALES[row])
    assert (found[:3] == -math.inf).all()
    for m in range(3, n + 1):
        terms = []
        for depth in range(1, in_field + 1):
            within = m * depth // in_field
            terms.append(within * (area - math.log(2.0 * math.pi)) + weight_of(n, within, depth))
        volume = 0.5 * unknowns * math.log(2.0 * math.pi) - 1.5 * (area + math.log(m)) + 0.5 * math.log(6.0)
        expected = volume - math.log(8.0 * math.pi**2) + SCALE_LOG_PRIOR[row] + logsumexp(terms) - total_of(n, in_field)
        assert found[m] == pytest.approx(expected, rel=1e-10)
    assert (evidence_of_matches(4, 0, log_area, scale, unknowns) == -math.inf).all()
    assert (
        np.isfinite(evidence_of_matches(9, 4, log_area, scale, unknowns)).tolist()
        == [False] * 3 + [True] * 2 + [False] * 5
    )


def test_matches_that_are_enough_where_points_are_crowded():
    """The sum of the smallest excesses of each width, the largest of all widths, at least zero."""
    excess = np.array([[2.0, -1.0, 0.5], [-3.0, -3.0, -3.0], [0.1, 0.2, 0.3]])
    np.testing.assert_allclose(crowding_price(excess), [0.1, 0.3, 1.5])
    assert not crowding_price(-np.ones((2, 4))).any()
    evidence = np.array([-np.inf, 1.0, 5.0, 9.0])
    assert fewest_matches(evidence, np.zeros(3), 4.9) == 2
    assert fewest_matches(evidence, np.zeros(3), 5.0) == 3
    assert fewest_matches(evidence, np.array([0.0, 0.2, 0.0]), 4.9) == 3
    assert fewest_matches(evidence, np.zeros(3), 9.0) == 4


def test_density_of_the_evidence():
    assert largest_density(1) == largest_density(3) == pytest.approx(0.2 / 3.0)
    assert largest_density(10) == pytest.approx(0.02)
    assert largest_density(17) == largest_density(500) == 0.012


# ---------------------------------------------------------------------- hypotheses
SETTINGS = IdentificationSettings(false_alarm_rate=1e-6, min_stars=4, max_operations=1000)
OBSERVED = Observed(np.tile([0.0, 0.0, 1.0], (10, 1)), None, np.full(10, 1e-4))


def hypothesis(evidence, stars=6, first=0, matrix=None, **changes):
    pairs = np.column_stack([np.arange(stars), first + np.arange(stars)])
    values = {"scale": 1.25, "in_field": 30} | changes
    return Hypothesis(np.eye(3) if matrix is None else matrix, pairs, evidence, **values)


def pool(*hypotheses, prior=None, settings=SETTINGS, **changes):
    found = HypothesisPool(settings, prior, 10, **changes)
    for one in hypotheses:
        found.add(one)
    return found


def test_the_gain_of_a_prior_is_the_share_of_rotations():
    rng = np.random.default_rng(1)
    quats = rng.normal(size=(200_000, 4))
    angle = 2.0 * np.arccos(np.abs(quats[:, 0]) / np.linalg.norm(quats, axis=1))
    share = np.mean(angle < 1.0)
    # of 2e5 rotations, 5 % are within 1 rad: three standard deviations are 3 %
    assert math.exp(-_gain(Prior(None, 1.0))) == pytest.approx(share, rel=0.03)
    assert _gain(None) == 0.0
    assert _gain(Prior(None, math.pi)) == _gain(Prior(None, 9.0)) == pytest.approx(0.0)
    assert _gain(Prior(None, 0.9999e-3)) == pytest.approx(_gain(Prior(None, 1.0001e-3)), abs=1e-3)
    assert _gain(Prior(None, 1e-5)) == pytest.approx(-math.log(1e-15 / (6.0 * math.pi)))


def test_evidence_that_is_needed():
    """p / (rate · gain), and e^15 times as much for an end of the search."""
    radius = 0.2
    for prior in (None, Prior(Attitude([0.0, 0.0, 0.0, 1.0]), radius)):
        gain = 0.0 if prior is None else -math.log((radius - math.sin(radius)) / math.pi)
        needed = math.log(0.02) - math.log(1e-6) - gain
        found = pool(prior=prior)
        assert found.least_evidence == pytest.approx(needed)
        assert found.decisive_evidence == pytest.approx(needed + SURE_BEYOND)
        for more, decided in ((-0.01, False), (0.01, True)):
            one = pool(hypothesis(needed + SURE_BEYOND + more), prior=prior)
            assert one.decided is decided
            two = pool(hypothesis(needed + more), prior=prior)
            assert (two.outcome(OBSERVED).status is Status.SOLVED) is decided
            assert two.log_chance == pytest.approx(math.log(0.02) - gain - needed - more)
    assert not pool().decided
    assert pool().log_chance == 0.0


def test_hypotheses_that_agree_are_one():
    """Half of the pairs of the smaller one; the better of two stays, the list is by evidence and of twenty."""
    first = hypothesis(20.0)
    assert first.agrees_with(hypothesis(9.0, 3, 0))
    half = hypothesis(9.0, 4, 0)
    half.pairs[:2, 1] += 100
    assert first.agrees_with(half)
    half.pairs[2, 1] += 100
    assert not first.agrees_with(half)
    assert not first.agrees_with(hypothesis(9.0, 0))
    found = pool(first, hypothesis(25.0, 5), hypothesis(19.0, 5, 50), hypothesis(30.0, 5, 90), hypothesis(12.0, 5))
    assert [one.log_evidence for one in found.hypotheses] == [30.0, 25.0, 19.0]
    found.add(None)
    assert len(found.hypotheses) == 3
    many = pool(*[hypothesis(float(k), 4, 100 * k) for k in range(25)])
    assert [one.log_evidence for one in many.hypotheses] == [float(k) for k in range(24, 4, -1)]


def test_hypotheses_outside_a_prior_are_none():
    """Rotations of up to 1.05 times its radius."""
    start = Attitude.from_radec_roll(40.0, 20.0, 10.0)
    prior = Prior(start, 0.1)
    for angle, inside in ((0.1049, True), (0.1051, False)):
        turned = Attitude.from_rotation_vector([0.0, angle, 0.0], "camera", "camera") @ start
        assert prior.allows(turned.as_matrix()) is inside
        assert len(pool(hypothesis(20.0, matrix=turned.as_matrix()), prior=prior).hypotheses) == int(inside)
    whole = Attitude.from_rotation_vector([math.pi, 0.0, 0.0], "camera", "camera") @ start
    assert Prior(start, math.pi).allows(whole.as_matrix())


@pytest.mark.parametrize(
    ("hypotheses", "changes", "status", "words"),
    [
        ((), {}, Status.NO_MATCH, "no attitude explains three stars: 10 stars seen"),
        ((hypothesis(20.0),), {}, Status.SOLVED, "6 of 10 stars fit, 30 guide stars in that field; by chance with"),
        ((hypothesis(20.0, 3),), {}, Status.NO_MATCH, "best attitude is no better than chance: 3 of 10"),
        ((hypothesis(-0.1),), {}, Status.NO_MATCH, "no better than chance"),
        ((hypothesis(0.1),), {}, Status.AMBIGUOUS, "by chance with probability 1e-2, above the limit of 1e-06"),
        ((hypothesis(20.0), hypothesis(16.0, 5, 50)), {}, Status.AMBIGUOUS, "another part of the sky fits 5 stars"),
        ((hypothesis(8.0), hypothesis(7.0, 5, 50)), {}, Status.AMBIGUOUS, "above the limit of 1e-06"),
        ((hypothesis(8.0),), {"cut_short": True}, Status.SEARCH_LIMIT, "(max_operations 1e+03); until then: 6 of 10"),
        ((hypothesis(20.0),), {"cut_short": True}, Status.SOLVED, "1e-11"),
        ((), {"prior": Prior(Attitude([0.0, 0.0, 0.0, 1.0]), 0.02)}, Status.NO_MATCH, "stars seen, prior within 1.1°"),
    ],
)  # fmt: skip
def test_the_judgement_of_a_pool(hypotheses, changes, status, words):
    found = pool(*hypotheses, operations=321, **changes).outcome(OBSERVED)
    assert (found.status, found.operations) == (status, 321)
    assert words in found.reason
    assert len(found.pairs) == (6 if status is Status.SOLVED else 0)
    assert found.log_false_alarm <= 0.0


def test_operations_are_counted_to_their_limit():
    found = pool()
    assert found.spend(600.7)
    assert (found.operations, found.left, found.cut_short) == (600, 400, False)
    assert not found.spend(400.1)
    assert (found.operations, found.cut_short) == (600, True)
    exact = pool()
    assert exact.spend(1000)
    exact.check(None, None, None)  # nothing is verified when nothing is left
    assert exact.cut_short
    assert not exact.hypotheses


def test_hypotheses_in_words():
    matrix = Attitude.from_radec_roll(300.5, -20.25, 5.0).as_matrix()
    assert _describe(hypothesis(33.333, 5, matrix=matrix, scale=2.2)) == (
        "hypothesis at RA 300.500°, Dec -20.250°: 5 stars fit within 2.2 stated errors, 30 guide stars expected; "
        "e^33.3 times likelier than chance"
    )


# ---------------------------------------------------------------------- observed stars
def test_errors_that_are_tried():
    """1, 3 and 10 times the stated ones, as far as they remain a hundredth of half the diagonal."""
    guide = SimpleNamespace(half_diagonal_rad=0.1)
    for sigma, scales in ((0.9e-4, (1.0, 3.0, 10.0)), (1.1e-4, (1.0, 3.0)), (3.4e-4, (1.0,)), (2e-3, (1.0,))):
        observed = Observed(np.zeros((3, 3)), None, np.array([sigma, 0.1, 1e-9]))
        assert tried_scales(observed, guide) == scales
    assert too_few(Observed(np.zeros((0, 3)), None, np.zeros(0)), 4).status is Status.NO_STARS
    few = too_few(Observed(np.zeros((2, 3)), None, np.zeros(2)), 4)
    assert (few.status, few.reason) == (Status.TOO_FEW_STARS, "2 stars seen, 4 are needed")


def test_a_prior_may_be_wrong_about_all_axes():
    attitude = Attitude.from_radec_roll(40.0, 20.0, 10.0)
    assert as_prior(None, 5.0) is None
    assert as_prior(attitude, 5.0).radius_rad == pytest.approx(math.radians(5.0) * math.sqrt(3.0))
    assert as_prior(attitude, 170.0).radius_rad == math.pi
    assert as_prior(attitude, 5.0).attitude == attitude


def test_magnitudes_of_observed_stars():
    vectors, sigma = np.zeros((3, 3)), np.ones(3)
    np.testing.assert_allclose(Observed(vectors, np.array([1.0, 100.0, 1e-2]), sigma).magnitudes(), [0.0, -5.0, 5.0])
    for flux in (None, np.array([1.0, 0.0, 2.0]), np.array([1.0, 2.0, math.inf]), np.array([math.nan, 2.0, 2.0])):
        observed = Observed(vectors, flux, sigma)
        assert observed.magnitudes() is None
        assert np.isnan(observed.magnitudes_or_nan()).all()
    assert Observed(np.zeros((0, 3)), np.zeros(0), np.zeros(0)).magnitudes().shape == (0,)


def test_directions_that_can_be_used():
    """Of errors below 5 px, and where the lens model has a direction."""
    camera = Camera.from_fov(10.0, 500, 400)
    xy, stated = np.array([[10.0, 20.0], [250.0, 200.0], [90.0, 9.0], [5.0, 5.0]]), np.array([0.1, 4.99, 5.0, np.nan])
    directions, usable, chosen, sigma = usable_directions(xy, stated, 2e-4, camera.image_map)
    assert usable.tolist() == [0, 1]
    np.testing.assert_allclose(directions, camera.unproject(xy))
    np.testing.assert_array_equal(chosen, directions[:2])
    np.testing.assert_allclose(sigma, [2e-5, 4.99 * 2e-4])
