"""Functions of time from values at regular dates, against what they stand for."""

import erfa
import numpy as np
import pytest

from simulator.interpolation import Nodes
from simulator.mission.clock import Clock
from simulator.mission.frames import true_of_date
from simulator.scenario import Scenario
from simulator.sky.ephemeris import tdb_jd

DAYS = np.random.default_rng(8).uniform(-18_000.0, 19_000.0, 200)


def test_matrices_of_single_instants_are_erfas():
    # 0.001 µas; the largest element of the difference was 1.4e-15 rad, some roundings of a sum of twelve
    clock = Clock(Scenario.load("cubesat").epoch)
    for days in (*DAYS / 10.0, 0.0, 0.5, 365.25):
        t_s = days * 86_400.0
        np.testing.assert_allclose(true_of_date(clock, t_s), erfa.pnm06a(*clock.tt_jd(t_s)), rtol=0.0, atol=5e-15)


def test_tdb_is_erfas():
    # rounding of the day's fraction, 1e-16 of some 2e4 days, is 0.3 µs; the difference of the scales itself is good to
    # 1e-15 s
    for days in DAYS:
        theirs = days + float(erfa.dtdb(2_451_545.0, days, 0.0, 0.0, 0.0, 0.0)) / 86_400.0
        assert tdb_jd(2_451_545.0, days) == (2_451_545.0, pytest.approx(theirs, rel=4e-16, abs=0.0))


@pytest.mark.parametrize("period_day", [3.5, 5.5, 13.66])
def test_left_of_an_oscillation_is_as_bounded(period_day):
    turn = 2.0 * np.pi / period_day
    nodes = Nodes(lambda jd1, jd2: np.array([np.sin(turn * (jd1 - 2_451_545.0 + jd2))]))
    off = [nodes.at(2_451_545.0, t)[0] - np.sin(turn * t) for t in np.linspace(-3.0, 3.0, 301)]
    assert np.max(np.abs(off)) <= 5.4e-5 * (np.pi / period_day) ** 12 + 2e-15


def test_dates_in_two_parts_are_one_date():
    nodes = Nodes(lambda jd1, jd2: np.array([jd1 - 2_451_545.0 + jd2, 1.0]))
    for jd1, jd2 in ((2_451_545.0, 10.25), (2_451_555.5, -0.25), (2_451_500.0, 55.25)):
        np.testing.assert_allclose(nodes.at(jd1, jd2), [10.25, 1.0], rtol=1e-14)
