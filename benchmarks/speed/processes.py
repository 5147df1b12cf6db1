"""What only whole processes show: starting up, two cores, memory."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

REPEATS = 5
TRIALS, REPORTED = 4000, 500
_RUN = """
import json, resource, sys, tempfile, time
from pathlib import Path
from benchmarks.speed.workload import small_scenario
from simulator.study.trials.engine import run_trials
workers, trials = int(sys.argv[1]), int(sys.argv[2])
seen = []
with tempfile.TemporaryDirectory() as folder:
    report = lambda done, _: seen.append((time.perf_counter(), done))
    run_trials(small_scenario(), trials, workers=workers, folder=Path(folder), progress=report)
# the first results came when every process was warm
(begin, early), (end, done) = seen[max(1, len(seen) // 4)], seen[-1]
most = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
print(json.dumps({"per_s": (done - early) / (end - begin), "megabytes": most / 1024}))
"""
_WITH_REPORT = """
import json, resource, sys, tempfile
from benchmarks.speed.workload import CUBESAT
from simulator import Scenario, run
with tempfile.TemporaryDirectory() as folder:
    run(Scenario.load(CUBESAT), int(sys.argv[2]), workers=int(sys.argv[1]), out=folder)
# a child counts what its parent had when it was started, so that the larger of the two is never too little
most = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
print(json.dumps({"megabytes": most / 1024}))
"""


def measure() -> dict[str, float]:
    """Seconds (the best of a few starts), trials per second and megabytes."""
    python = [sys.executable, "-c"]
    command = [sys.executable, "-m", "simulator.cli"]
    with tempfile.TemporaryDirectory() as folder:
        frame = [*command, "render", "cubesat", "--out", str(Path(folder) / "frame.fits")]
        _seconds(frame)  # the compiled kernels are kept from here on
        found = {
            "bare_python_s": _best([*python, "pass"]),
            "import_s": _best([*python, "import startracker"]),
            "import_tracker_s": _best([*python, "from startracker import StarTracker"]),
            "help_s": _best([*command, "--help"]),
            "first_frame_s": _best(frame),
        }
    _trials(_RUN, 2, TRIALS // 4)  # now also the kernels of the rarer frames are kept
    one, two = _trials(_RUN, 1, TRIALS), _trials(_RUN, 2, TRIALS)
    reported = [_trials(_WITH_REPORT, workers, REPORTED)["megabytes"] for workers in (1, 2)]
    return found | {
        "trials_per_s": one["per_s"],
        "two_cores": two["per_s"] / one["per_s"],
        "run_megabytes": max(one["megabytes"], two["megabytes"]),
        "report_megabytes": max(reported),
    }


def _best(command: list[str]) -> float:
    return min(_seconds(command) for _ in range(REPEATS))


def _seconds(command: list[str]) -> float:
    started = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - started


def _trials(script: str, workers: int, trials: int) -> dict[str, float]:
    answer = subprocess.run(
        [sys.executable, "-c", script, str(workers), str(trials)],
        check=True,
        capture_output=True,
        text=True,
        env=os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
    )
    found: dict[str, float] = json.loads(answer.stdout.splitlines()[-1])
    return found
