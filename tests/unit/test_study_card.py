"""The card that a notebook shows of a study: numbers, and the curves of its chart at known places."""

import re

import numpy as np
import pytest

from simulator.study.axes import BODY_AXES
from simulator.study.notebook import study_card

SUMMARY = {
    "name": "demo",
    "trials": 400,
    "seed": 7,
    "solved": 300,
    "misidentified": 0,
    "inconsistent": 0,
    "wrong": 0,
    "specification": {"roll": {"text": "roll: 99.7 % below 9″: met"}},
    "verdict": {"text": "Specification: met: smallest margin roll, 2 ×"},
}


def card(**errors_arcsec):
    columns = {f"error_{axis}_deg": np.asarray(errors_arcsec[axis]) / 3600.0 for axis in BODY_AXES}
    return study_card(SUMMARY, columns)


def curves(html):
    """Points (N, 2) of each curve."""
    found = re.findall(r'<polyline points="([^"]*)"', html)
    return [np.array([[float(x) for x in point.split(",")] for point in line.split()]) for line in found]


def test_the_chart_is_the_share_of_trials_below_an_error():
    """From 42 to 412 across for the decades 1″ to 100″, and 212 to 22 upwards for shares of zero to one; of the last
    decade up to the greatest error. Trials without an attitude, and the sign, do not count."""
    low = np.geomspace(1.0, 10.0, 101)
    roll = np.concatenate([low[::-1], [np.nan, 0.0]])
    html = card(roll=roll, pitch=-10.0 * low, yaw=np.geomspace(1.0, 100.0, 500))
    first, second, third = curves(html)
    assert (len(first), len(second), len(third)) == (101, 101, 200)
    assert first[0] == pytest.approx([42.0, 212.0 - 190.0 / 101.0], abs=0.06)
    assert first[50] == pytest.approx([42.0 + 370.0 / 4.0, 212.0 - 190.0 * 51.0 / 101.0], abs=0.06)
    assert first[-1] == pytest.approx([227.0, 22.0], abs=0.06)
    assert second[0][0] == pytest.approx(227.0, abs=0.06)
    assert second[-1] == pytest.approx([412.0, 22.0], abs=0.06)
    assert third[-1] == pytest.approx([412.0, 22.0], abs=0.06)
    labels = re.findall(r'<text x="([\d.]+)" y="([\d.]+)"[^>]*>([^<]+)</text>', html)
    shown = {text: (float(x), float(y)) for x, y, text in labels}
    assert shown["1″"] == pytest.approx((42.0, 226.0), abs=0.06)
    assert shown["10″"] == pytest.approx((227.0, 226.0), abs=0.06)
    assert shown["100″"] == pytest.approx((412.0, 226.0), abs=0.06)
    assert shown["50 %"] == pytest.approx((37.0, 120.5), abs=0.06)
    assert [shown[axis][0] for axis in ("roll", "pitch", "yaw")] == [77.0, 155.0, 233.0]


def test_the_card_has_numbers_specification_and_verdict():
    html = card(**{axis: [1.0, 2.0, 3.0] for axis in BODY_AXES})
    for text in ("Study of demo", "400, seed 7", "300, ", "99.7 % below 9″: met", "met: smallest margin roll, 2 ×"):
        assert text in html
    assert "<svg" in html


def test_a_chart_needs_two_errors_about_each_axis():
    assert "<svg" not in card(roll=[1.0, 2.0], pitch=[1.0, np.nan], yaw=[1.0, 2.0])
    assert "<svg" in card(roll=[1.0, 2.0], pitch=[1.0, 3.0, np.nan], yaw=[1.0, 2.0])
