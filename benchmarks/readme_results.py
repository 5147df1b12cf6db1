"""``python -m benchmarks.readme_results``: run the scenarios of README's table, and write the table.

The summaries, and the first frames of each run to compare with, are kept in ``readme_results.json`` beside this file;
tests/end_to_end/test_readme_results.py checks that README shows them and that the frames are still the same.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
from pathlib import Path
from typing import Any

from simulator import Scenario, run
from startracker import __version__
from startracker.core import ARCSEC_PER_DEG, Columns

ROOT = Path(__file__).resolve().parents[1]
RESULTS = Path(__file__).with_name("readme_results.json")
SCENARIOS = ("sunsat", "greyling1995", "cubesat", "cubesat_ideal")
TRIALS, SEED = 2000, 1
AXES = ("roll", "yaw", "pitch")
FIRST = 12
"""Frames of each run that are kept to compare with."""
BEGIN, END = "<!-- results: make readme-results -->", "<!-- end of results -->"


def scenario_of(name: str) -> Scenario:
    """A shipped scenario of the table."""
    return Scenario.load(str(ROOT / "scenarios" / f"{name}.yaml"))


def first_frames(columns: Columns, count: int = FIRST) -> list[dict[str, Any]]:
    """Status and errors, arcseconds, of the first frames of a run."""
    kept = []
    for k in range(count):
        row: dict[str, Any] = {"status": str(columns["status"][k])}
        if row["status"] == "solved":
            row |= {axis: round(float(columns[f"error_{axis}_deg"][k]) * ARCSEC_PER_DEG, 4) for axis in AXES}
        kept.append(row)
    return kept


def measured(name: str, workers: int) -> dict[str, Any]:
    """Results of one scenario as they are kept."""
    study = run(scenario_of(name), trials=TRIALS, seed=SEED, workers=workers)
    summary = study.summary
    return {
        "identification_rate": summary["identification_rate"],
        "wrong": summary["wrong"],
        "p997_arcsec": {
            axis: [
                round(value * ARCSEC_PER_DEG, 4)
                for value in (summary["errors_deg"][axis]["p997"], *summary["errors_deg"][axis]["p997_interval95"])
            ]
            for axis in AXES
        },
        "nees_mean": summary["nees"]["mean"],
        "first_frames": first_frames(study.columns),
    }


def table(results: dict[str, Any]) -> str:
    """README's table of the kept results."""
    requirement = scenario_of(SCENARIOS[0]).specification
    limits = " | ".join(f"{getattr(requirement, f'{axis}_deg') * ARCSEC_PER_DEG:.0f}″" for axis in AXES)
    rows = [
        "| scenario | identified | wrong | roll | yaw | pitch (about the boresight) |",
        "|---|---|---|---|---|---|",
        f"| specification | | | {limits} |",
    ]
    for name, found in results["scenarios"].items():
        digits = {"roll": 2, "yaw": 2, "pitch": 1}
        cells = [
            "{:.{n}f}″ ({:.{n}f} to {:.{n}f})".format(*found["p997_arcsec"][axis], n=digits[axis]) for axis in AXES
        ]
        rate = f"{100 * found['identification_rate']:.2f} %"
        rows.append(f"| `{name}` | {rate} | {found['wrong']} | {' | '.join(cells)} |")
    return "\n".join(rows)


def with_table(readme: str, results: dict[str, Any]) -> str:
    """README with the table between its marks."""
    before, rest = readme.split(BEGIN)
    return f"{before}{BEGIN}\n{table(results)}\n{END}{rest.split(END)[1]}"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.readme_results", description=__doc__)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    given = parser.parse_args()
    results: dict[str, Any] = {
        "version": __version__,
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "trials": TRIALS,
        "seed": SEED,
        "scenarios": {name: measured(name, given.workers) for name in SCENARIOS},
    }
    readme = ROOT / "README.md"
    text = with_table(readme.read_text(encoding="utf-8"), results)
    RESULTS.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    readme.write_text(text, encoding="utf-8")
    print(table(results))


if __name__ == "__main__":
    main()
