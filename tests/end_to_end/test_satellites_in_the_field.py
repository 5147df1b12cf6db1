"""Satellites across the field: frames are solved from the stars, by the benchmark's frames and by a sequence."""

import pytest

from benchmarks.satellites import outcomes
from simulator.scenario import Scenario
from simulator.study.sequence.run import run_sequence

pytestmark = pytest.mark.system


def test_ten_satellites_do_not_hide_the_stars():
    none, ten = outcomes(Scenario.load("cubesat_ideal", ["tracker.prior=false"]), (0, 10), 12)
    for row in (none, ten):
        assert row["solved"] == row["trials"]
        assert row["wrong"] == row["misidentified"] == 0
    assert ten["matched_mean"] > 0.8 * none["matched_mean"]


def test_a_pass_of_the_constellation_is_tracked():
    """The eleven seconds in which five satellites cross the field."""
    scenario = Scenario.load("constellation", ["sequence.start_s=2005", "sequence.frames=11"])
    columns = run_sequence(scenario).columns
    assert columns["satellites_in_field"].max() == 5
    assert columns["bodies_in_field"].max() == 0
    assert set(columns["status"]) == {"solved"}
    assert not columns["wrong"].any()
    assert columns["stars_misidentified"].max() == 0
