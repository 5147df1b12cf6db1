"""Misidentified, inconsistent, wrong: counts, rates, likely causes and words, from the columns of a study."""

import numpy as np
import pytest

from simulator.cli.verdicts import outcome_cell
from simulator.scenario import Scenario
from simulator.study.axes import AXES
from simulator.study.point_statistics import point_statistics
from simulator.study.report.content import outlier_positions
from simulator.study.specification.measured import judge_frames
from simulator.study.specification.outcome import (
    CAUSES,
    identified,
    inconsistency,
    outcome_counts,
    outcome_counts_text,
    outcome_flags,
    outcome_text,
)
from simulator.study.statistics import summarise

COUNT = 200


def trials(**changes):
    """Errors of 1″ about every axis, within 90″; the covariance states them as they are."""
    rng = np.random.default_rng(4)
    columns = {
        "index": np.arange(COUNT),
        "t_s": np.zeros(COUNT),
        "status": np.array(["solved"] * COUNT, dtype=object),
        "misidentified": np.zeros(COUNT, bool),
        "inconsistent": np.zeros(COUNT, bool),
        "inconsistent_cause": np.array([""] * COUNT, dtype=object),
        "wrong": np.zeros(COUNT, bool),
        "stars_matched": np.full(COUNT, 8),
        "stars_misidentified": np.zeros(COUNT, int),
        "nees": np.full(COUNT, 3.0),
        "render_ms": np.ones(COUNT),
        "solve_ms": np.ones(COUNT),
        **{f"error_{axis}_deg": rng.normal(0, 1 / 3600, COUNT) for axis in AXES},
    }
    return columns | changes


def with_inconsistent(causes, **changes):
    columns = trials(**changes)
    columns["inconsistent"][: len(causes)] = True
    columns["inconsistent_cause"][: len(causes)] = causes
    columns["nees"][: len(causes)] = 42.6
    return columns


def summary_of(columns, *overrides):
    scenario = Scenario.load("cubesat_ideal", ["specification.percentile=95", *overrides])
    return summarise(columns, judge_frames(scenario, columns), 1)


def test_an_inconsistent_attitude_within_the_specification_does_not_fail_it():
    summary = summary_of(with_inconsistent(["displaced", "displaced", "noise"]))
    assert (summary["misidentified"], summary["inconsistent"], summary["wrong"]) == (0, 3, 0)
    assert summary["verdict"]["verdict"] == "met"
    assert summary["identification_rate"] == 1.0
    found = summary["inconsistency"]
    assert (found["count"], found["rate"], found["beyond_limit"]) == (3, 0.015, 0)
    # Wilson 1927 for 3 of 200
    assert found["rate_interval95"] == pytest.approx([0.00511, 0.04317], abs=1e-5)
    assert found["causes"] == {"displaced": 2, "noise": 1}
    assert found["likely_cause"] == "displaced"
    assert found["text"].startswith(
        "Inconsistent with the stated covariance: 3 of 200 attitudes (1.50 %, 95 % interval 0.51 to 4.32 %)"
    )
    assert found["text"].endswith(f"likely cause: {CAUSES['displaced']} (2 of 3)")
    assert outcome_text(summary) == "none wrong, 3 inconsistent"
    assert outcome_counts_text(summary) == "0 wrong, 3 inconsistent"
    assert outcome_cell(summary) == "0 (3 inconsistent)"


def test_consistency_is_judged_where_it_is_specified():
    """3 of 200 are 0.51 to 4.32 %: beyond 0.5 %, within 5 %, and undecided for 2 %."""
    columns = with_inconsistent(["noise"] * 3)
    for limit, verdict in ((0.005, "not met"), (0.05, "met"), (0.02, "undecided")):
        summary = summary_of(columns, f"specification.inconsistent_rate={limit}")
        assert summary["specification"]["inconsistent_rate"]["value"] == 0.015
        assert summary["specification"]["inconsistent_rate"]["verdict"] == verdict
        assert summary["verdict"]["verdict"] == verdict


def test_a_misidentified_attitude_fails_the_specification_and_its_rate():
    columns = trials()
    columns["misidentified"][5] = columns["wrong"][5] = True
    columns["stars_misidentified"][5] = 2
    summary = summary_of(columns)
    assert summary["verdict"]["text"] == "Specification: not met: 1 wrong attitude (1 misidentified)"
    assert summary["identification_rate"] == 0.995
    assert summary["inconsistency"] is None
    assert outcome_text(summary) == "1 wrong (1 misidentified)"
    # 1 of 200: 0.09 to 2.8 %
    judged = summary_of(columns, "specification.wrong_rate=0.0005")["specification"]["wrong_rate"]
    assert (judged["value"], judged["verdict"]) == (0.005, "not met")


def test_a_gross_one_fails_the_specification_and_keeps_its_identification():
    columns = with_inconsistent(["displaced"])
    columns["wrong"][0] = True
    summary = summary_of(columns)
    said = "Specification: not met: 1 wrong attitude (1 inconsistent and beyond the specification)"
    assert summary["verdict"]["text"] == said
    assert summary["identification_rate"] == 1.0  # the stars are right
    assert outcome_text(summary) == "1 wrong (1 inconsistent and beyond the specification)"
    assert outcome_cell(summary) == "[red]1[/] (1 inconsistent)"
    assert outlier_positions(columns, summary)[0] == (0, "wrong")
    unknown = with_inconsistent(["unknown"], wrong=columns["wrong"])
    assert identified(unknown).sum() == COUNT - 1


def test_an_error_common_to_all_frames_is_a_cause():
    """5″ about one axis with a scatter of 1″, of which nothing else is known."""
    error = trials()["error_cross_y_deg"] + 5 / 3600
    found = inconsistency(with_inconsistent(["unknown"] * 150, error_cross_y_deg=error))
    assert found["likely_cause"] == "bias"
    # 5 ± 1/√200″, and the scatter ± 1/√400″: 5 σ
    assert "an error common to all frames of 5." in found["text"] or "of 4." in found["text"]
    assert "about cross y" in found["text"]
    # no bias: what is unknown is said to be
    assert inconsistency(with_inconsistent(["unknown"] * 150))["likely_cause"] == "unknown"
    # what most frames show comes first
    assert inconsistency(with_inconsistent(["noise"] * 100, error_cross_y_deg=error))["likely_cause"] == "noise"


def test_columns_of_earlier_versions_are_read():
    old = with_inconsistent(["noise"] * 3)
    for name in ("misidentified", "inconsistent", "inconsistent_cause"):
        del old[name]
    old["stars_misidentified"][7] = 1
    old["status"][0] = "no_match"
    old["wrong"][7] = True
    assert outcome_counts(old) == {"misidentified": 1, "inconsistent": 2, "wrong": 1}
    assert inconsistency(old)["likely_cause"] == "unknown"
    assert point_statistics(old, 1)["inconsistent"] == 2
    # a table of which only the oldest columns are left
    bare = {name: old[name] for name in ("status", "wrong")}
    assert [flags.sum() for flags in outcome_flags(bare)] == [0, 0, 1]


def test_inconsistent_trials_are_listed():
    summary = summary_of(with_inconsistent(["noise"]))
    assert [(entry["index"], entry["why"]) for entry in summary["outliers"]][:1] == [
        (0, "inconsistent with the stated covariance")
    ]
