"""The same rows on a dask cluster, whatever happens to its workers."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from simulator.scenario import Scenario
from simulator.study.sweep.run import plan_sweep, run_sweep
from simulator.study.trials import dask_pool
from simulator.study.trials.blocks import run_block
from simulator.study.trials.engine import run_trials
from startracker.errors import InputError

pytestmark = pytest.mark.system

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = Path(__file__).with_name("fake_study.py")
TRIALS = 1000


@pytest.fixture(params=["threads", pytest.param("processes", marks=pytest.mark.slow)])
def cluster(request, tmp_path, monkeypatch):
    """Address of a scheduler with two workers, whose trials cost nothing, and a function that ends one of them.

    Threads of this process, connected by TCP, may leave, and their blocks go to the other. Processes, whose start takes
    30 CPU seconds, are killed.
    """
    monkeypatch.setattr(dask_pool, "CONNECT_S", 60.0)
    with _threads(monkeypatch) if request.param == "threads" else _processes(tmp_path) as made:
        yield made


@contextlib.contextmanager
def _threads(monkeypatch):
    from distributed import Client, LocalCluster

    monkeypatch.setattr(dask_pool, "TrialRunner", _fake_runner())
    with LocalCluster(2, 1, processes=False, protocol="tcp://", host="127.0.0.1", dashboard_address=None) as cluster:

        def retire_a_worker():
            with Client(cluster, set_as_default=False) as client:
                client.retire_workers([min(client.nthreads())])

        yield cluster.scheduler_address, retire_a_worker


@contextlib.contextmanager
def _processes(tmp_path):
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "DASK_DISTRIBUTED__ADMIN__LOG_FORMAT": "%(message)s"}
    file = tmp_path / "scheduler.json"
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "env": environment, "cwd": tmp_path}
    dask = [sys.executable, "-m", "dask"]
    scheduler = [*dask, "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", file]
    worker = [*dask, "worker", "--scheduler-file", file, "--nthreads", "1", "--no-dashboard", "--preload", SCRIPT]
    processes = [subprocess.Popen(command, **quiet) for command in (scheduler, [*worker, "--nworkers", "2"])]
    try:
        deadline = time.monotonic() + 60
        while not file.exists() or not file.read_text().endswith("}"):
            assert time.monotonic() < deadline
            time.sleep(0.05)
        address = json.loads(file.read_text())["address"]

        def kill_a_worker():
            from distributed import Client

            with Client(address, set_as_default=False) as client:
                os.kill(min(client.run(os.getpid).values()), signal.SIGKILL)

        yield address, kill_a_worker
    finally:
        for process in reversed(processes):
            process.send_signal(signal.SIGINT)
        for process in processes:
            process.wait(timeout=30)


def test_a_sweep_runs_on_a_cluster_and_tells_when_there_is_none(cluster, tmp_path, monkeypatch):
    address, _ = cluster
    plan = plan_sweep("cubesat_ideal", ["optics.aperture_mm=15,16"], trials=40)
    sweep = run_sweep(plan, tmp_path / "sweep", dask=address)
    assert sweep.trials.num_rows == 80
    assert not any(point["status"] == "refused" for point in sweep.table["points"])
    monkeypatch.setattr(dask_pool, "CONNECT_S", 0.5)
    with pytest.raises(InputError, match="no scheduler responds"):
        run_sweep(plan, tmp_path / "other", dask="tcp://127.0.0.1:1")


def test_same_rows_on_a_cluster_that_loses_a_worker(cluster, tmp_path):
    address, end_a_worker = cluster
    ended = []

    def lose_a_worker(done, _):
        if not ended and done > 100:
            ended.append(done)
            end_a_worker()

    scenario = Scenario.load("cubesat_ideal")
    done = run_trials(scenario, TRIALS, dask=address, folder=tmp_path, progress=lose_a_worker)
    assert ended
    assert done.finished == TRIALS
    assert done.workers in (1, 2)  # as many as there were at the last look
    runner = _fake_runner()(scenario)
    wanted = run_block(runner.run, range(TRIALS)).table
    kept = [name for name in wanted.column_names if not name.endswith("_ms")]
    assert done.table.select(kept).equals(wanted.select(kept))


def _fake_runner():
    import runpy

    from simulator.study.trials import engine, process_pool

    before = engine.TrialRunner
    try:
        return runpy.run_path(str(SCRIPT))["FakeRunner"]
    finally:
        for module in (engine, process_pool, dask_pool):
            module.TrialRunner = before


def test_no_package_no_scheduler_and_no_version_in_common_are_one_line(monkeypatch):
    scenario = Scenario.load("cubesat_ideal")
    monkeypatch.setattr(dask_pool, "CONNECT_S", 0.5)
    for address in ("tcp://127.0.0.1:1", "nonsense://x"):
        with pytest.raises(InputError, match="no scheduler responds") as told:
            run_trials(scenario, 10, dask=address)
        assert "\n" not in str(told.value)
    with pytest.raises(InputError, match="install the same on all"):
        dask_pool._run_block(scenario, "key", "0.0.0", range(3))
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"pip install 'boresight\[dask\]'"):
        run_trials(scenario, 10, dask="tcp://127.0.0.1:8786")
