"""A study whose trials cost nothing, for tests of the engine that runs and keeps them.

`FakeRunner` makes rows with the columns of real ones from (seed, index) alone. As a script it runs such a study, in
processes that load this file too; as a preload of dask workers it gives them the same trials:

    python fake_study.py OUT TRIALS WORKERS SLEEP_S [resume]

With ``command`` at the end it is ``boresight run cubesat_ideal`` with such trials, and a page of one word.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import numpy as np

from simulator.scenario import Scenario
from simulator.study.axes import AXES, CAMERA_AXES
from simulator.study.trials import blocks, dask_pool, engine, process_pool

SLEEP_S = float(sys.argv[4]) if __name__ in {"__main__", "__mp_main__"} else 0.002


class FakeRunner:
    def __init__(self, scenario: Scenario) -> None:
        self.seed = scenario.seed

    def run(self, index: int) -> dict[str, object]:
        if SLEEP_S:
            time.sleep(SLEEP_S)
        values = np.random.Generator(np.random.Philox(key=[self.seed, index])).normal(size=40).tolist()
        row: dict[str, object] = {
            "index": index,
            "t_s": values[0],
            "true_ra_deg": 360.0 * values[1] % 360.0,
            "true_dec_deg": 8.6,
            "rate_deg_s": 0.06,
            "utc": f"2026-03-21T12:{index // 60 % 60:02d}:{index % 60:02d}.{index % 1000:03d}",
            "status": "solved" if values[1] < 2 else "too_few_stars",
            "reason": "" if values[1] < 2 else f"{index % 3} stars found",
            "misidentified": False,
            "inconsistent": False,
            "inconsistent_cause": "",
            "wrong": False,
            "stars_matched": 9 + index % 7,
            "stars_misidentified": 0,
            "stars_in_field": 20,
        }
        row |= {f"error_{axis}_deg": values[2 + k] * 1e-3 for k, axis in enumerate(AXES)}
        row |= {f"sigma_{axis}_deg": 1e-3 for axis in CAMERA_AXES}
        row |= {f"bound_{axis}_deg": 1e-3 for axis in CAMERA_AXES}
        row |= {f"q{k}": values[10 + k] for k in range(24)}
        row["nees"] = values[8] ** 2 + values[9] ** 2 + values[10] ** 2
        row |= {"render_ms": time.perf_counter(), "solve_ms": 1.0}
        return row


for module in (dask_pool, engine, process_pool):
    module.TrialRunner = FakeRunner


def run_study(out: str, trials: int, workers: int) -> None:
    folder = Path(out)
    folder.mkdir(exist_ok=True)
    done = engine.run_trials(
        Scenario.load("cubesat_ideal"), trials, workers=workers, folder=folder, resume="resume" in sys.argv,
        progress=lambda finished, _: print(finished, flush=True),
    )  # fmt: skip
    checksum = done.store.write(folder / "trials.parquet", trials)
    (folder / "summary.json").write_text(json.dumps({"trials_sha256": checksum}))
    engine.discard_parts(folder)


def run_command(out: str, trials: int, workers: int) -> int:
    from simulator.cli import _run
    from simulator.study.report import page

    page.report_html = lambda *_, **__: "page"
    return _run(["run", "cubesat_ideal", "--trials", str(trials), "--workers", str(workers), "--out", out])


if __name__ == "__main__":
    blocks.TARGET_S = 0.1  # many blocks in little time
    start = run_command if sys.argv[-1] == "command" else run_study
    sys.exit(start(sys.argv[1], int(sys.argv[2]), int(sys.argv[3])))
