"""Whether a solution explains the whole field: each condition at its limit."""

from types import SimpleNamespace

import numpy as np
import pytest

from startracker import Attitude, Camera, StarTracker
from startracker.field_solution import explains_bright_stars, misfit_px, strongest, trail_fragments_possible

CAMERA = Camera.from_fov(12.0, 512, 512)
ATTITUDE = Attitude.from_radec_roll(83.0, -1.0, 20.0)


@pytest.fixture(scope="module")
def guide():
    return StarTracker(CAMERA, magnitude_limit=6.5).guide


def solution(guide, flux=np.arange(10.0, 0.0, -1.0), residual_px=0.0, brightest=8):
    """Ten matched stars, among them some of the eight brightest of the field 12 px within the border."""
    index, _, _ = guide.in_field(ATTITUDE.as_matrix(), -12.0, CAMERA)
    chosen = [*index[8 - brightest : 8], *index[8 : 18 - brightest]]
    stars = SimpleNamespace(
        flux=flux,
        catalog_id=guide.catalog.id[chosen],
        fitted=SimpleNamespace(residual_px=np.tile([[0.6 * residual_px, -0.8 * residual_px]], (len(flux), 1))),
    )
    return SimpleNamespace(attitude=ATTITUDE, camera=CAMERA, stars=stars)


def spots(false):
    """The matched stars, and false ones brighter than any."""
    return np.concatenate([np.full(false, 99.0), np.arange(10.0, 0.0, -1.0)])


def test_the_rms_distance_from_the_predictions(guide):
    assert misfit_px(solution(guide, residual_px=2.5)) == pytest.approx(2.5)


@pytest.mark.parametrize(("false", "whole"), [(0, True), (7, True), (8, False)])
def test_two_fifths_of_the_bright_spots_are_matched(guide, false, whole):
    """Five of the ten matched stars are fainter than the sixth: five of 5 + 7 are 42 %, of 5 + 8 38 %."""
    for trailed in (False, True):
        assert explains_bright_stars(solution(guide), spots(false), guide, trailed) is whole


def test_points_must_fit_and_include_the_brightest_guide_stars(guide):
    assert explains_bright_stars(solution(guide, residual_px=2.99), spots(0), guide)
    assert not explains_bright_stars(solution(guide, residual_px=3.01), spots(0), guide)
    assert explains_bright_stars(solution(guide, brightest=5), spots(0), guide)
    assert not explains_bright_stars(solution(guide, brightest=4), spots(0), guide)
    # the ends of trails are uncertain, and others are cut by the border
    assert explains_bright_stars(solution(guide, residual_px=3.01, brightest=4), spots(0), guide, trailed=True)


def test_what_may_be_pieces_of_trails(guide):
    assert trail_fragments_possible(solution(guide, residual_px=3.01), spots(0), guide, streaked=False)
    assert not trail_fragments_possible(solution(guide, residual_px=2.99), spots(8), guide, streaked=False)
    assert trail_fragments_possible(solution(guide), spots(8), guide, streaked=True)
    assert not trail_fragments_possible(solution(guide, brightest=4), spots(0), guide, streaked=True)


def test_the_solved_one_with_the_strongest_evidence_is_answered():
    def tried(solved, log_false_alarm):
        return object(), SimpleNamespace(solved=solved, log_false_alarm=log_false_alarm)

    weak, strong, unsolved, none = tried(True, -20.0), tried(True, -90.0), tried(False, -300.0), tried(False, 0.0)
    assert strongest([weak, strong]) is strong
    assert strongest([strong, weak]) is strong
    assert strongest([unsolved, weak]) is weak
    assert strongest([unsolved, none]) is unsolved
    first, last = tried(False, 0.0), tried(False, 0.0)
    assert strongest([first, last]) is last
