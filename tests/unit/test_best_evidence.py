"""Of several hypotheses for a frame the one with the most evidence is answered, and none beyond doubt is refused."""

import math
from dataclasses import replace

import numpy as np
import pytest

from startracker import Attitude, Camera, StarTracker, Status
from startracker.centroid.result import Measured
from startracker.front_end import Clock, FoundStars
from startracker.identification import Identification

CAMERA = Camera.from_fov(15.0, 1024, 1024)
ATTITUDE = Attitude.from_radec_roll(85.0, 10.0, 30.0)


@pytest.fixture(scope="module")
def tracker():
    return StarTracker(CAMERA, magnitude_limit=7.0)


def field(tracker, skip, count):
    """Positions and fluxes of guide stars of the field, the brightest left out: no whole field by the rule for that."""
    index, _, xy = tracker.guide.in_field(ATTITUDE.as_matrix(), -5.0)
    chosen = slice(skip, skip + count)
    return xy[chosen], 1e6 * 10.0 ** (-0.4 * tracker.guide.v_mag[index[chosen]])


def hypothesis(rng, xy, flux, false, error_px):
    points = np.concatenate([xy + error_px * rng.standard_normal(xy.shape), rng.uniform(5.0, 1018.0, (false, 2))])
    signal = np.concatenate([flux, rng.choice(flux, false)])
    order = np.argsort(-signal)
    return FoundStars(Measured(points[order], signal[order], np.full(len(points), max(error_px, 0.02) ** 2)))


def answer(tracker, spots, streaks):
    return tracker._best_hypothesis([spots, replace(streaks, trailed=True)], None, None, Clock(), [])


@pytest.mark.parametrize("trails_first", [False, True])
def test_fifty_stars_do_not_give_way_to_eight_streaks(tracker, trails_first):
    rng = np.random.default_rng(1)
    xy, flux = field(tracker, 8, 50)
    spots = hypothesis(rng, xy, flux, 10, 0.03)
    near = xy[:8] + np.array([1.5, 0.8])  # eight streaks that fit the same field, all off alike
    streaks = hypothesis(rng, near, flux[:8], 38, 0.3)
    first, second = (streaks, spots) if trails_first else (spots, streaks)
    solution, seen = answer(tracker, first, second)
    assert solution.solved
    assert len(seen.stars.xy) == len(spots.stars.xy)
    assert solution.matched >= 45
    assert solution.log_false_alarm < -300.0
    assert math.degrees(ATTITUDE.angle_to(solution.attitude)) * 3600 < 5.0


def test_streaks_with_the_more_evidence_win_over_their_pieces(tracker):
    rng = np.random.default_rng(2)
    xy, flux = field(tracker, 0, 30)
    streaks = hypothesis(rng, xy, flux, 0, 0.2)
    pieces = hypothesis(rng, xy[10:21] + np.array([4.0, 0.0]), flux[10:21], 19, 1.5)
    solution, seen = answer(tracker, pieces, streaks)
    assert solution.solved
    assert seen.trailed
    assert math.degrees(ATTITUDE.angle_to(solution.attitude)) * 3600 < 40.0


def test_sixty_of_sixty_stars_are_answered_beside_streaks_that_are_no_sky(tracker):
    rng = np.random.default_rng(3)
    xy, flux = field(tracker, 8, 60)
    spots = hypothesis(rng, xy, flux, 0, 0.02)
    train = hypothesis(rng, rng.uniform(5.0, 1018.0, (12, 2)), np.full(12, flux.max()), 0, 0.1)
    solution, seen = answer(tracker, spots, train)
    assert solution.solved, solution.reason
    assert not seen.trailed
    assert solution.matched >= 58


def test_points_that_may_be_pieces_of_streaks_are_still_refused(tracker):
    """Eleven pieces of the fainter stars' streaks, all off by 60 px, among brighter pieces of others."""
    rng = np.random.default_rng(4)
    xy, flux = field(tracker, 12, 11)
    bright = rng.uniform(5.0, 1018.0, (30, 2))
    pieces = hypothesis(
        rng, np.concatenate([xy + np.array([60.0, 0.0]), bright]), np.append(flux, np.full(30, flux.max())), 0, 0.3
    )
    train = hypothesis(rng, rng.uniform(5.0, 1018.0, (12, 2)), np.full(12, flux.max()), 0, 0.1)
    solution, _ = answer(tracker, pieces, train)
    assert solution.status is Status.NO_MATCH
    assert "fragments of trails" in solution.reason


@pytest.mark.parametrize("inside_is_better", [True, False])
def test_a_doubtful_match_within_the_prior_gives_way_to_more_evidence_outside(tracker, monkeypatch, inside_is_better):
    xy, flux = field(tracker, 0, 40)
    index, _, _ = tracker.guide.in_field(ATTITUDE.as_matrix(), -5.0)
    true = np.stack([np.arange(40), index[:40]], axis=1)
    weak = Identification(Status.SOLVED, "inside", true[:3][:, [0, 1]] if inside_is_better else true[3:6], -17.0)
    strong = Identification(Status.SOLVED, "outside", true[6:], -10.0 if inside_is_better else -500.0)
    monkeypatch.setattr(tracker, "_identify", lambda o, g, s, prior: strong if prior is None else weak)
    solution = tracker.solve_centroids(xy, flux, prior=Attitude.from_radec_roll(85.0, 10.0, 31.0), prior_deg=3.0)
    assert solution.solved
    assert solution.prior_contradicted is not inside_is_better
    assert solution.log_false_alarm == (-17.0 if inside_is_better else -500.0)


def test_a_solution_without_the_brightest_guide_stars_is_not_the_last_hypothesis(tracker):
    """Fifty points are solved, of which none is one of the eight brightest stars; sixty trails have these as well."""
    rng = np.random.default_rng(4)
    xy, flux = field(tracker, 0, 60)
    spots = hypothesis(rng, xy[8:58], flux[8:58], 0, 0.03)
    streaks = hypothesis(rng, xy, flux, 0, 0.03)
    alone, _ = tracker._best_hypothesis([spots], None, None, Clock(), [])
    assert alone.solved
    solution, seen = answer(tracker, spots, streaks)
    assert solution.solved
    assert seen.trailed
    assert solution.matched > 55
