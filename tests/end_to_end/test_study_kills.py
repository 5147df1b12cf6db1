"""Nothing finished is lost, and nothing broken is left, whenever a run is killed, loses a worker or fills the disk."""

import errno
import json
import os
import platform
import re
import signal
import subprocess
import sys
import threading
import time
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from simulator import paths
from simulator.scenario import Scenario
from simulator.study import run as run_module
from simulator.study.folder_lock import LOCK_FILE
from simulator.study.results_folder import scenario_sha256
from simulator.study.run import RESULT_FILES, run
from simulator.study.trials import dask_pool, engine, parts, process_pool
from simulator.study.trials.blocks import run_block
from simulator.study.trials.checked_files import DAMAGED_FOLDER
from startracker._version import __version__
from startracker.errors import BoresightError, InputError

pytestmark = pytest.mark.system

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
    store = parts.PartStore(Scenario.load("cubesat_ideal"), None, resume=False)
    fake = runner(Scenario.load("cubesat_ideal"))
    result = run_block(fake.run, range(TRIALS))
    store.put(result.block, result.table)
    return store.table(TRIALS)


def start(folder, workers, *options, sleep_s=0.001):
    command = [sys.executable, str(SCRIPT), str(folder), str(TRIALS), str(workers), str(sleep_s), *options]
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
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


@pytest.mark.parametrize(
    ("seed", "most_kills"), [(1, 2), *(pytest.param(seed, 40, marks=pytest.mark.slow) for seed in (2, 3, 4, 5))]
)
def test_a_run_killed_again_and_again_ends_with_the_same_rows(tmp_path, undisturbed, seed, most_kills):
    rng = np.random.default_rng(seed)
    kills = 0
    for attempt in range(40):
        process = start(tmp_path, 2 if attempt % 4 == 3 or kills == 2 else 1, *["resume"][:attempt])
        process.stdout.readline()  # the first words: how many trials were found
        wait_s = float(rng.uniform(0.05, 0.5)) * 1.1**attempt  # a slow machine ends later, but ends
        try:
            process.wait(timeout=wait_s if kills < most_kills else None)
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


@pytest.mark.parametrize("workers", [pytest.param(1, marks=pytest.mark.slow), 2])
def test_an_interrupt_keeps_the_finished_trials_and_resume_finishes_them(
    tmp_path, undisturbed, runner, monkeypatch, workers
):
    """Ctrl-C in a terminal goes to all processes of the command."""
    process = start(tmp_path, workers, "command", sleep_s=0.02)  # 12 s: a loaded machine interrupts late
    wait_for_parts(tmp_path, process, 2)
    finished = [part.stem.split("-")[:2] for part in (tmp_path / parts.PARTS_FOLDER).glob("*.parquet")]
    os.killpg(process.pid, signal.SIGINT)
    output, errors = process.communicate(timeout=120)
    assert process.returncode == 130, errors
    assert "Traceback" not in errors
    assert "Interrupted" in output
    kept = pq.read_table(tmp_path / "trials.parquet")
    # parts are named by their first and last trial
    assert sum(int(stop) - int(start) for start, stop in finished) <= kept.num_rows < TRIALS
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["interrupted"] is True
    assert summary["trials"] == kept.num_rows
    monkeypatch.setattr("simulator.study.report.page.report_html", lambda *_, **__: "page")
    firsts = []
    run(Scenario.load("cubesat_ideal"), TRIALS, out=tmp_path, resume=True, progress=lambda done, _: firsts.append(done))
    assert firsts[0] == kept.num_rows
    assert_same(tmp_path / "trials.parquet", undisturbed)
    assert not (tmp_path / parts.PARTS_FOLDER).exists()


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="finds the workers in /proc")
def test_a_worker_killed_costs_only_time_and_workers_end_with_their_parent(tmp_path, undisturbed, runner):
    process = start(tmp_path, 2, sleep_s=0.01)
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
    done = engine.run_trials(Scenario.load("cubesat_ideal"), TRIALS, folder=tmp_path, resume=True)
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
    scenario = Scenario.load("cubesat_ideal")
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
        with pytest.raises(InputError, match=r"No space left on device.*finished trials are kept.*--resume") as told:
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
    assert {"trials.parquet", "report.html", "identity.json"} <= places
    assert any(name.count("-") for name in places)  # a part


def test_results_of_an_earlier_run_stand_until_the_new_ones_do(tmp_path, runner, monkeypatch):
    monkeypatch.setattr("simulator.study.report.page.report_html", lambda *_, **__: "page")
    scenario = Scenario.load("cubesat_ideal")
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


def test_a_part_damaged_under_way_is_named_set_aside_and_computed_again(tmp_path, undisturbed, runner, monkeypatch):
    monkeypatch.setattr("simulator.study.report.page.report_html", lambda *_, **__: "page")
    monkeypatch.setattr("simulator.study.trials.blocks.MOST_TRIALS", 100)
    monkeypatch.setattr(parts, "MERGE_EVERY", 4)
    rng = np.random.default_rng(1)
    harmed = []

    def harm(done, _):
        """Flip a bit of a part, or delete it: early ones before they are merged, late ones after."""
        found = sorted((tmp_path / parts.PARTS_FOLDER).glob("*.parquet"))
        if len(harmed) < 4 and found and done >= (len(harmed) + 1) * TRIALS // 4:
            part = found[rng.integers(len(found))]
            harmed.append(part.name)
            if len(harmed) % 2:
                part.unlink()
            else:
                data = bytearray(part.read_bytes())
                data[rng.integers(len(data))] ^= 1 << rng.integers(8)
                part.write_bytes(data)

    study = run(Scenario.load("cubesat_ideal"), TRIALS, out=tmp_path, progress=harm)
    assert len(harmed) == 4
    assert [Path(note.split(": ")[0]).name for note in study.notes] == harmed
    assert all(note.endswith("its trials are computed again") for note in study.notes)
    assert_same(tmp_path / "trials.parquet", undisturbed)
    aside = [path.name for path in (tmp_path / DAMAGED_FOLDER).iterdir()]
    assert sorted(aside) == sorted(harmed[1::2])


def test_a_disk_that_damages_everything_ends_in_one_line(tmp_path, runner, monkeypatch):
    def harm(done, _):
        for part in (tmp_path / parts.PARTS_FOLDER).glob("*.parquet"):
            part.write_bytes(b"")

    with pytest.raises(BoresightError, match=r"damaged.*is the disk failing\?") as told:
        run(Scenario.load("cubesat_ideal"), 20, out=tmp_path, progress=harm)
    assert "\n" not in str(told.value)


def snapshot(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


@pytest.mark.parametrize("resume", [True, False])
def test_results_of_another_or_longer_run_are_not_replaced(tmp_path, runner, monkeypatch, resume):
    monkeypatch.setattr("simulator.study.report.page.report_html", lambda *_, **__: "page")
    scenario = Scenario.load("cubesat_ideal")
    run(scenario, 40, out=tmp_path)
    before = snapshot(tmp_path)
    stands = re.escape("(scenario 'cubesat_ideal', seed 1, 40 trials, boresight ")
    others = {
        f"{tmp_path}: contains the results of another run {stands}": (scenario.with_values(seed=9), 40),
        f"a run with other values, options or input files {stands}": (
            Scenario.load("cubesat_ideal", ["optics.aperture_mm=31"]),
            40,
        ),
        f"contains the results of a longer run {stands}.* than the requested 20 trials": (scenario, 20),
    }
    for message, (other, trials) in others.items():
        with pytest.raises(InputError, match=message) as told:
            run(other, trials, out=tmp_path, resume=resume)
        assert re.search("another --out, or replace them with --force$", str(told.value))
        assert snapshot(tmp_path) == before
    monkeypatch.setattr("simulator.study.results_folder.__version__", "9.9")
    with pytest.raises(InputError, match=f"another run {stands}"):
        run(scenario, 40, out=tmp_path, resume=resume)
    assert snapshot(tmp_path) == before
    monkeypatch.undo()
    monkeypatch.setattr("simulator.study.report.page.report_html", lambda *_, **__: "page")
    for module in (engine, process_pool, dask_pool):
        monkeypatch.setattr(module, "TrialRunner", runner)
    assert run(scenario, 40, out=tmp_path).summary["trials"] == 40  # the very same may
    assert run(scenario, 60, out=tmp_path, resume=resume).summary["trials"] == 60  # and more of it
    assert run(scenario.with_values(seed=9), 20, out=tmp_path, force=True).summary["seed"] == 9
    with pytest.raises(InputError, match="--resume and --force"):
        run(scenario, 40, out=tmp_path, resume=True, force=True)


def test_an_interrupted_rerun_leaves_longer_results_in_place(tmp_path, runner, monkeypatch):
    monkeypatch.setattr("simulator.study.report.page.report_html", lambda *_, **__: "page")
    monkeypatch.setattr("simulator.study.trials.blocks.MOST_TRIALS", 10)
    scenario = Scenario.load("cubesat_ideal")
    run(scenario, 200, out=tmp_path)
    before = snapshot(tmp_path)

    def interrupt(done, _):
        if done >= 100:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.01)

    study = run(scenario, 200, out=tmp_path, progress=interrupt)
    assert study.folder is None
    assert study.summary["interrupted"]
    assert 100 <= study.summary["trials"] < 200
    assert snapshot(tmp_path) == before
    finished = []
    run(scenario, 200, out=tmp_path, progress=lambda done, _: finished.append(done))
    assert finished[0] == study.summary["trials"]  # without --resume too


def test_a_changed_file_of_the_scenario_is_another_run(tmp_path, runner, monkeypatch):
    monkeypatch.setattr("simulator.study.report.page.report_html", lambda *_, **__: "page")
    for key, first, second in [
        ("detector.quantum_efficiency", "wavelength_nm,qe\n400,0.5\n900,0.5\n", "wavelength_nm,qe\n400,0.5\n900,0.4\n"),
        ("optics.transmission", "wavelength_nm,t\n400,0.5\n900,0.5\n", "wavelength_nm,t\n400,0.5\n900,0.4\n"),
        ("optics.baffle.pst", "angle_deg,pst\n0,1\n90,1e-9\n", "angle_deg,pst\n0,1\n90,1e-8\n"),
        ("pointing.jitter.table", "frequency_hz,psd\n0,1\n9,1\n", "frequency_hz,psd\n0,1\n9,2\n"),
    ]:
        file = tmp_path / f"{key}.csv"
        file.write_text(first)
        folder = tmp_path / key.replace(".", "-")
        scenario = Scenario.load("cubesat_ideal", [f"{key}={file}"])
        run(scenario, 5, out=folder)
        run(scenario, 6, out=folder, resume=True)
        file.write_text(second)
        with pytest.raises(InputError, match="results of a run with other values, options or input files"):
            run(scenario, 10, out=folder, resume=True)
        engine.run_trials(scenario, 4, folder=tmp_path / f"unfinished-{key}")
        file.write_text(first)
        with pytest.raises(InputError, match="unfinished trials of a run with other values"):
            engine.run_trials(scenario, 10, folder=tmp_path / f"unfinished-{key}", resume=True)


def test_a_folder_in_use_is_refused_and_a_dead_owner_is_not(tmp_path, runner, monkeypatch):
    monkeypatch.setattr("simulator.study.report.page.report_html", lambda *_, **__: "page")
    scenario = Scenario.load("cubesat_ideal")

    def second(done, _):
        with pytest.raises(InputError, match=f"{tmp_path}: in use by process {os.getpid()} on this machine"):
            run(scenario, 10, out=tmp_path, force=True)

    run(scenario, 10, out=tmp_path, progress=second)
    assert not (tmp_path / LOCK_FILE).exists()
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    lock = {"pid": process.pid, "host": platform.node(), "started": "1"}
    (tmp_path / LOCK_FILE).write_text(json.dumps(lock))
    run(scenario, 10, out=tmp_path)
    (tmp_path / LOCK_FILE).write_text(json.dumps(lock | {"pid": os.getpid(), "started": "1"}))  # its number again
    run(scenario, 10, out=tmp_path)
    (tmp_path / LOCK_FILE).write_text('{"pid": 12')  # a kill while it was written
    run(scenario, 10, out=tmp_path)
    (tmp_path / LOCK_FILE).write_text(json.dumps(lock | {"host": "elsewhere"}))
    with pytest.raises(InputError, match=rf"process {process.pid} on host 'elsewhere'.*remove {tmp_path / LOCK_FILE}$"):
        run(scenario, 10, out=tmp_path)


@pytest.mark.parametrize("module", [process_pool, dask_pool])
def test_a_worker_with_another_file_runs_nothing(tmp_path, runner, monkeypatch, module):
    file = tmp_path / "qe.csv"
    file.write_text("wavelength_nm,qe\n400,0.5\n900,0.5\n")
    scenario = Scenario.load("cubesat_ideal", [f"detector.quantum_efficiency={file}"])
    key = scenario_sha256(scenario)
    monkeypatch.setattr(module, "_local", threading.local())
    version = [__version__] if module is dask_pool else []
    assert module._run_block(scenario, key, *version, range(2)).block == range(2)
    file.write_text("wavelength_nm,qe\n400,0.5\n900,0.4\n")
    monkeypatch.setattr(module, "_local", threading.local())
    with pytest.raises(InputError, match=rf"\({file}\) were changed during the run, or differ on"):
        module._run_block(scenario, key, *version, range(2))
