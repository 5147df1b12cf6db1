"""A million trials fit in 1 GB: measured on 50,000 and 200,000, and drawn on in a straight line."""

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = """
import resource, runpy, sys
from pathlib import Path

fake = runpy.run_path(sys.argv[1])
fake["FakeRunner"].run.__globals__["SLEEP_S"] = 0

from simulator.scenario import Scenario
from simulator.study import run as module
from simulator.study.run import run

scenario = Scenario.load("cubesat_ideal")
module._write_pages = lambda *_: [(_[3] / name).touch() for name in module.RESULT_FILES]
for trials in (50_000, 200_000):
    most = 0
    out = Path(sys.argv[2]) / str(trials)

    def count(done, total):
        global most
        most = max(most, len(list((out / ".trials-parts").iterdir())))

    study = run(scenario, trials, out=out, progress=count)
    assert study.summary["trials"] == trials
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, most)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="ru_maxrss is in kB on Linux only")
def test_a_million_trials_fit_in_one_gigabyte(tmp_path):
    fake = Path(__file__).with_name("fake_study.py")
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(fake), str(tmp_path)],
        cwd=Path(__file__).parents[2], capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    (few_mb, few_files), (many_mb, many_files) = ([float(v) for v in line.split()] for line in done.stdout.splitlines())
    assert many_mb + (many_mb - few_mb) / 150_000 * 800_000 < 1000
    # 50 new parts, one merged part for at least 25,000 trials, smaller ones by halves, and the key
    assert few_files <= 70
    assert many_files <= 80
