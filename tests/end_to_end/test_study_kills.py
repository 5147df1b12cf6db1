"""Nothing finished is lost, and nothing broken is left, whenever a run is killed, loses a worker or fills the disk."""

import errno
import os
import signal
import subprocess
import sys
import time
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from simulator import paths
from simulator.scenario import Scenario
from simulator.study import run as run_module
from simulator.study.run import RESULT_FILES, run
from simulator.study.trials import dask_pool, engine, parts, process_pool
from simulator.study.trials.blocks import run_block
from startracker.errors import InputError

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = Path(__file__).with_name("fake_study.py")
TRIALS = 1200


@pytest.fixture(scope="module")
def runner():
    before = {module: module.TrialRunner for module in (engine, process_pool, dask_pool)}
    specification = spec_from_file_location("fake_study", SCRIPT)
    module = module_from_spec(specification)
    specification.loader.exec_module(module)
    module.SLEEP_S = 0
    yield module.FakeRunner
    for patched, original in before.items():
        patched.TrialRunner = original


@pytest.fixture(scope="module")
def undisturbed(runner, tmp_path_factory):
    store = parts.PartStore(Scenario.load("cubesat"), None, resume=False)
    fake = runner(Scenario.load("cubesat"))
    result = run_block(fake.run, range(TRIALS))
    store.put(result.block, result.table)
    return store.table(TRIALS)


def start(folder, workers, *, resume=False, sleep_s=0.001):
    command = [sys.executable, str(SCRIPT), str(folder), str(TRIALS), str(workers), str(sleep_s)]
    return subprocess.Popen(
        [*command, *(["resume"] if resume else [])], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip


def assert_same(path, undisturbed):
    table = pq.read_table(path)
    kept = [name for name in undisturbed.column_names if not name.endswith("_ms")]
    assert table.column_names == undisturbed.column_names
    for name in kept:  # bytes, so that NaN and −0.0 count too
        left, right = (t[name].combine_chunks() for t in (table, undisturbed))
        assert left.type == right.type
        assert [b and b.to_pybytes() for b in left.buffers()] == [b and b.to_pybytes() for b in right.buffers()], name


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3, 4, 5))])
def test_a_run_killed_again_and_again_ends_with_the_same_rows(tmp_path, undisturbed, seed):
    rng = np.random.default_rng(seed)
    kills = 0
    for attempt in range(40):
        process = start(tmp_path, workers=2 if attempt % 4 == 3 else 1, resume=attempt > 0)
        process.stdout.readline()  # the first words: how many trials were found
        try:
            process.wait(timeout=float(rng.uniform(0.05, 0.9)))
        except subprocess.TimeoutExpired:
            process.kill()
            kills += 1
        errors = process.communicate()[1]
        assert "Traceback" not in errors
        if process.returncode == 0:
            break
    assert process.returncode == 0
    assert kills >= 2
    assert_same(tmp_path / "trials.parquet", undisturbed)
    assert not (tmp_path / parts.PARTS_FOLDER).exists()


def workers_of(pid):
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return [int(child) for child in children if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes()]


def wait_for_parts(folder, process, number):
    while len(list((folder / parts.PARTS_FOLDER).glob("*.parquet"))) < number:
        time.sleep(0.02)
        assert process.poll() is None, process.communicate()[1]


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="finds the workers in /proc")
def test_a_worker_killed_costs_only_time_and_workers_end_with_their_parent(tmp_path, undisturbed, runner):
    process = start(tmp_path, workers=2, sleep_s=0.01)
    wait_for_parts(tmp_path, process, 3)
    killed = workers_of(process.pid)
    assert len(killed) == 2
    os.kill(killed[0], signal.SIGKILL)
    had = len(list((tmp_path / parts.PARTS_FOLDER).glob("*.parquet")))
    wait_for_parts(tmp_path, process, had + 6)  # more than were under way: others go on
    workers = workers_of(process.pid)
    assert len(workers) == 2
    assert not {*workers} & {*killed}
    process.kill()
    assert "Traceback" not in process.communicate()[1]
    deadline = time.monotonic() + 20
    while any(Path(f"/proc/{pid}").exists() for pid in workers) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not [pid for pid in workers if Path(f"/proc/{pid}").exists()]
    done = engine.run_trials(Scenario.load("cubesat"), TRIALS, folder=tmp_path, resume=True)
    assert 0 < done.taken_over < TRIALS
    done.store.write(tmp_path / "trials.parquet", TRIALS)
    assert_same(tmp_path / "trials.parquet", undisturbed)


class SmallDisk:
    """A disk with room for so many bytes."""

    def __init__(self, room):
        self.room, self.written, self.open = room, 0, os.fdopen

    def fdopen(self, handle, *mode):
        disk, stream = self, self.open(handle, *mode)

        class Stream:
            def __enter__(self):
                return self

            def __exit__(self, *_):
                stream.close()

            def __getattr__(self, name):
                return getattr(stream, name)

            def write(self, data):
                disk.written += memoryview(data).nbytes
                if disk.written > disk.room:
                    stream.write(bytes(data)[: max(0, disk.room - disk.written)])
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
                return stream.write(data)

        return Stream()


def test_a_full_disk_is_one_clear_line_wherever_it_happens(tmp_path, undisturbed, runner, monkeypatch):
    monkeypatch.setattr(parts, "MERGE_EVERY", 3)
    monkeypatch.setattr("simulator.study.trials.blocks.MOST_TRIALS", 60)
    monkeypatch.setattr("simulator.study.report.page.report_html", lambda *_, **__: "page" * 1000)
    scenario = Scenario.load("cubesat")
    whole = SmallDisk(1 << 40)
    monkeypatch.setattr(paths.os, "fdopen", whole.fdopen)
    wanted = run(scenario, TRIALS, out=tmp_path / "whole").summary
    places, last = set(), 0
    # places along the way, and among the last: page, scenario, summary
    rooms = [*np.linspace(0, whole.written - 40_000, 9).astype(int)]
    rooms += [whole.written - before_end for before_end in (25_000, 12_000, 2000)]
    for k, room in enumerate(rooms):
        folder = tmp_path / f"full{k}"
        monkeypatch.setattr(paths.os, "fdopen", SmallDisk(int(room)).fdopen)
        with pytest.raises(
            InputError, match=r"No space left on device.*the finished trials are kept.*--resume"
        ) as told:
            run(scenario, TRIALS, out=folder)
        assert "\n" not in str(told.value)
        places.add(Path(str(told.value).split(":")[0]).name)
        kept = folder / parts.PARTS_FOLDER
        assert [path.name for path in folder.iterdir()] == [parts.PARTS_FOLDER]
        for path in kept.glob("*.parquet"):
            pq.read_table(path)  # none is broken
        assert not [path.name for path in kept.iterdir() if path.name.startswith(".")]
        monkeypatch.setattr(paths.os, "fdopen", whole.open)
        found = TRIALS - sum(map(len, parts.PartStore(scenario, folder, resume=True).missing(TRIALS)))
        assert found >= last  # more room, more kept
        last = found
        again = run(scenario, TRIALS, out=folder, resume=True)
        assert sorted(path.name for path in folder.iterdir()) == sorted(RESULT_FILES)
        assert_same(folder / "trials.parquet", undisturbed)
        assert again.summary["errors_deg"] == wanted["errors_deg"]
    assert last == TRIALS
    assert {"trials.parquet", "report.html", "scenario.sha256"} <= places
    assert any(name.count("-") for name in places)  # a part


def test_results_of_an_earlier_run_stand_until_the_new_ones_do(tmp_path, runner, monkeypatch):
    monkeypatch.setattr("simulator.study.report.page.report_html", lambda *_, **__: "page")
    scenario = Scenario.load("cubesat")
    run(scenario, 50, out=tmp_path)
    before = {name: (tmp_path / name).read_bytes() for name in RESULT_FILES}
    monkeypatch.setattr(run_module, "_write_pages", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        run(scenario, 60, out=tmp_path)
    assert {name: (tmp_path / name).read_bytes() for name in RESULT_FILES} == before
    monkeypatch.undo()
    monkeypatch.setattr("simulator.study.report.page.report_html", lambda *_, **__: "page")
    monkeypatch.setattr(engine, "TrialRunner", None)  # all 60 are there: no trial may be run
    study = run(scenario, 60, out=tmp_path, resume=True)
    assert study.summary["trials"] == 60
    assert study.columns["index"].tolist() == list(range(60))
    assert study.trials.num_rows == 60


def test_resuming_a_finished_run_starts_nothing(tmp_path, runner, monkeypatch):
    scenario = Scenario.load("sunsat")
    first = engine.run_trials(scenario, 3, folder=tmp_path)
    assert first.finished == 3

    def started(*_args):
        raise AssertionError("nothing is left to run")

    monkeypatch.setattr(engine, "WorkerPool", started)
    monkeypatch.setattr(engine, "TrialRunner", started)
    again = engine.run_trials(scenario, 3, folder=tmp_path, resume=True)
    assert (again.finished, again.taken_over) == (3, 3)
