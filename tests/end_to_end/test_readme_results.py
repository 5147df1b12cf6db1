"""README's table of results: as the committed runs have it, and these as the tracker of today gives.

The first frames of each run are run again. Their errors agree to 0.02″ + 1 %: the last digits of a sum depend on the
processor's vector instructions, and a pixel's noise may then be rounded to another digital number.
"""

import json

import pytest

from benchmarks.readme_results import AXES, FIRST, RESULTS, ROOT, SCENARIOS, SEED, first_frames, scenario_of, with_table
from simulator import run

KEPT = json.loads(RESULTS.read_text(encoding="utf-8"))


def test_readme_shows_the_committed_runs():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert with_table(readme, KEPT) == readme
    assert tuple(KEPT["scenarios"]) == SCENARIOS


@pytest.mark.parametrize("name", SCENARIOS)
def test_committed_runs_are_of_this_version(name):
    """Otherwise: make readme-results."""
    found = first_frames(run(scenario_of(name), trials=FIRST, seed=SEED).columns)
    for now, kept in zip(found, KEPT["scenarios"][name]["first_frames"], strict=True):
        assert now["status"] == kept["status"]
        for axis in AXES:
            assert now.get(axis, 0.0) == pytest.approx(kept.get(axis, 0.0), rel=0.01, abs=0.02)
