"""Comparison of runs: which keys differ, ratios from paired trials, points of sweeps, and the page."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from simulator.checks import load_scenario
from simulator.study.axes import AXES
from simulator.study.pages.html import html_of
from simulator.study.point_statistics import point_statistics
from simulator.study.sweep.compare import compare, differences
from simulator.study.sweep.comparison_page import comparison_page
from startracker.errors import InputError

N = 400


def rows(scale, rng_seed=1, n=N, unsolved=()):
    """Trials whose errors are `scale` times those of any other call: made by hand, not by the simulator."""
    rng = np.random.default_rng(rng_seed)
    status = np.array(["solved"] * n, dtype=object)
    status[list(unsolved)] = "no_stars"
    columns = {
        "index": np.arange(n),
        "status": status,
        "wrong": np.zeros(n, dtype=bool),
        "stars_matched": np.full(n, 12),
        "render_ms": np.full(n, 20.0),
        "solve_ms": np.full(n, 5.0),
    }
    for axis in AXES:
        errors = scale * rng.normal(0, 1e-3, n)
        errors[list(unsolved)] = np.nan
        columns[f"error_{axis}_deg"] = errors
    return columns


def write_run(folder, overrides, columns, seed=1):
    folder.mkdir()
    scenario = load_scenario("tc211", overrides, seed=seed)
    (folder / "scenario.resolved.yaml").write_text(f"# boresight\n{scenario.to_yaml()}")
    (folder / "summary.json").write_text(json.dumps({"seed": seed, "trials_per_second": 12.5}))
    pq.write_table(pa.table(columns), folder / "trials.parquet")
    return str(folder)


def test_only_differing_keys_are_shown_names_apart(tmp_path):
    first = write_run(tmp_path / "a", [], rows(1.0))
    second = write_run(tmp_path / "b", ["optics.aperture_mm=12", "name=other"], rows(1.5))
    assert compare([first, second]).differences == {"optics.aperture_mm": (15, 12)}


def test_a_key_that_a_run_lacks_is_a_difference():
    found = differences([{"a": 1, "b": 2}, {"a": 1, "b": 2, "c": "null"}, {"a": 1, "b": 3}])
    assert found == {"b": (2, 2, 3), "c": (None, "null", None)}


def test_ratio_of_paired_trials_is_exact_where_the_intervals_are_not(tmp_path):
    # errors of the second run are 1.05 times the first's, trial by trial: the ratio has no scatter at all, while each
    # rms of 400 trials is only known to ±1.96 / sqrt(2 × 400) = ±7 %, so that the two intervals overlap
    first = write_run(tmp_path / "a", [], rows(1.0))
    second = write_run(tmp_path / "b", ["optics.aperture_mm=12"], rows(1.05))
    comparison = compare([first, second])
    assert comparison.ratios[0] is None
    for axis in AXES:
        assert comparison.ratios[1][axis] == pytest.approx((1.05, 1.05, 1.05), rel=1e-9)
        a, b = (run.statistics for run in comparison.runs)
        assert a[f"{axis}_rms_high_deg"] > b[f"{axis}_rms_low_deg"]


def test_only_trials_that_both_solved_are_paired(tmp_path):
    first = write_run(tmp_path / "a", [], rows(1.0, unsolved=range(50)))
    second = write_run(tmp_path / "b", [], rows(2.0, unsolved=range(30, 90)))
    assert compare([first, second]).ratios[1]["roll"][0] == pytest.approx(2.0, rel=1e-9)


def test_runs_of_other_seeds_are_not_paired(tmp_path):
    first = write_run(tmp_path / "a", [], rows(1.0))
    second = write_run(tmp_path / "b", [], rows(2.0), seed=2)
    comparison = compare([first, second])
    assert comparison.ratios[1] is None
    assert "no common trials" in html_of(comparison_page(comparison))


def test_intervals_hold_the_rms_that_was_drawn():
    # rms of 400 normal errors of sigma 1e-3: within 4 sigma / sqrt(2 N) = 14 % of sigma, and its interval about as wide
    # as theory's 2 × 1.96 / sqrt(2 N) = 13.9 % (the bootstrap's own scatter is below a quarter of that)
    statistics = point_statistics(rows(1.0), seed=1)
    for axis in AXES:
        assert statistics[f"{axis}_rms_deg"] == pytest.approx(1e-3, rel=4 / np.sqrt(2 * N))
        width = statistics[f"{axis}_rms_high_deg"] - statistics[f"{axis}_rms_low_deg"]
        assert width == pytest.approx(2 * 1.96 / np.sqrt(2 * N) * 1e-3, rel=0.25)
        assert statistics[f"{axis}_three_sigma_deg"] == 3 * statistics[f"{axis}_rms_deg"]
    # Wilson's interval of 400 of 400: 1 / (1 + z² / n) = 0.99049
    assert statistics["identification_rate_low"] == pytest.approx(0.99049, abs=1e-5)
    assert statistics["identification_rate_high"] == 1.0


def test_a_wrong_attitude_is_not_identified_and_no_solution_no_error():
    columns = rows(1.0, n=20, unsolved=range(15, 20))
    columns["wrong"][:3] = True
    statistics = point_statistics(columns, seed=1)
    assert (statistics["solved"], statistics["wrong"], statistics["identification_rate"]) == (15, 3, 12 / 20)
    nothing = point_statistics(rows(1.0, n=3, unsolved=range(3)), seed=1)
    assert nothing["roll_rms_deg"] is None
    assert nothing["identification_rate"] == 0.0


def test_page_names_the_runs_and_stands_alone(tmp_path):
    first = write_run(tmp_path / "a", [], rows(1.0))
    second = write_run(tmp_path / "b", ["tracker.centroider=maximum_likelihood"], rows(1.05, unsolved=range(N)))
    page = html_of(comparison_page(compare([first, second])))
    assert first in page
    assert "tracker.centroider" in page
    assert "maximum_likelihood" in page
    assert "<script" not in page
    assert 'src="http' not in page


@pytest.mark.parametrize(
    ("given", "words"),
    [(["nowhere", "a"], "no such folder"), (["."], "contains no results"), (["a"], "at least two runs")],
)
def test_mistakes_are_one_line(tmp_path, monkeypatch, given, words):
    monkeypatch.chdir(tmp_path)
    write_run(tmp_path / "a", [], rows(1.0))
    with pytest.raises(InputError, match=words) as caught:
        compare(given)
    assert len(str(caught.value).splitlines()) == 1
