"""The frames of the benchmark show what their names say."""

import numpy as np
import pytest

from benchmarks.cases import chosen
from benchmarks.frames import CASES, COSMIC_RAYS, Bench, FrameRow, table_row


@pytest.fixture(scope="module")
def bench():
    return Bench(CASES["Moon at the edge"], "match_groups")


def _sources(bench, index):
    at_s, attitude = bench._placed(index)
    names = list(bench.case.bodies)
    directions = np.array(bench._directions(names, at_s))
    sun = bench._directions(["Sun"], at_s)[0]
    return bench.renderer.camera.project(attitude.apply(directions)), directions, sun


def test_the_moon_stands_on_the_edge_away_from_the_sun(bench):
    camera = bench.renderer.camera
    sides = set()
    for index in range(12):
        (xy,), (direction,), sun = _sources(bench, index)
        assert camera.contains(xy[None], 1e-6).all()
        to_edge = [xy[0] + 0.5, camera.width - 0.5 - xy[0], xy[1] + 0.5, camera.height - 0.5 - xy[1]]
        assert min(to_edge) == pytest.approx(0.0, abs=1e-6)
        assert np.degrees(np.arccos(direction @ sun)) > 30
        sides.add(int(np.argmin(to_edge)))
    assert len(sides) >= 3


def test_a_frame_is_judged_against_its_truth(bench):
    row = bench.row(0)
    assert row.outcome == "identified"
    assert row.true_stars > 10
    assert row.cross_arcsec < 5.0


def test_jupiter_and_venus_share_a_field():
    bench = Bench(CASES["Jupiter and Venus in the field"], "match_groups")
    together = sum(bench.renderer.camera.contains(_sources(bench, index)[0]).all() for index in range(10))
    assert together >= 6  # their middle is anywhere on the image: near its edge one of them can fall outside


def test_radiation_and_rates_reach_the_scenario():
    scenario = CASES[f"{COSMIC_RAYS} cosmic rays"].scenario("match_groups")
    detector = scenario.detector
    area_cm2 = (detector.width * 5.5e-4) * (detector.height * 5.5e-4)
    assert detector.cosmic_rays.rate_cm2_s * area_cm2 * detector.exposure_s == pytest.approx(COSMIC_RAYS)
    turning = CASES["10 deg/s"].scenario("match_groups").pointing.rate_deg_s
    assert np.linalg.norm(turning) == pytest.approx(10.0)
    assert turning[1] == 0.0  # the boresight
    assert not CASES["0 deg/s"].scenario("match_groups").tracker.prior


def test_a_case_is_chosen_by_its_name_or_a_part_of_it():
    names = list(CASES)
    assert chosen(["0 deg/s"], names) == ["0 deg/s"]
    assert chosen(["Moon", "cosmic"], names) == ["Moon at the edge", f"{COSMIC_RAYS} cosmic rays"]
    assert chosen([], names) == names


def test_a_wrong_frame_fails_the_row():
    rows = [FrameRow(k, "identified", 20, 1.0, 5.0, 10.0) for k in range(199)]
    case = CASES["0 deg/s"]
    assert table_row(case, rows)[-1] == "ok"
    assert table_row(case, [*rows, FrameRow(199, "wrong", 20, 900.0, 5.0, 10.0)])[-1] == "FALLS SHORT"
    few = [*rows[:190], *(FrameRow(k, "no_match", 20, np.nan, np.nan, 10.0) for k in range(10))]
    assert table_row(case, few)[-1] == "FALLS SHORT"
    assert "10 no_match" in table_row(case, few)


@pytest.mark.parametrize(("case", "index"), [("10 deg/s", 84), ("10 deg/s, 0.05 s", 2)])
def test_pieces_of_streaks_make_no_wrong_attitude(case, index):
    """Frames whose streaks were found in pieces, all off by half a streak, and gave the right field 1° aside."""
    assert Bench(CASES[case], "adaptive").row(index).outcome != "wrong"
