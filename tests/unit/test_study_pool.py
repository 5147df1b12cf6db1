"""Blocks of trials on the processes of a pool: what is submitted, what a stop drops, and workers that die."""

import contextlib
import threading
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from types import SimpleNamespace

import pytest

import simulator.study.run as study_run
from simulator.scenario import Scenario
from simulator.study.trials import process_pool
from simulator.study.trials.blocks import MAX_ATTEMPTS, Blocks
from simulator.study.trials.process_pool import run_in_pool
from startracker.errors import BoresightError


class Pool:
    """Processes that finish their blocks one after the other, and of which some die."""

    def __init__(self, workers=2, dying=()):
        self.workers, self.dying = workers, list(dying)
        self.submitted, self.open, self.most, self.closed = [], [], 0, 0

    def submit(self, scenario, key, block):
        if "at once" in self.dying:
            self.dying.remove("at once")
            raise BrokenProcessPool
        future = Future()
        self.submitted.append(block)
        self.open.append((future, block))
        self.most = max(self.most, sum(not future.done() for future, _ in self.open))
        return future

    def finish_one(self):
        future, block = self.open.pop(0)
        if block.start in self.dying:
            self.dying.remove(block.start)
            future.set_exception(BrokenProcessPool())
        elif not future.cancelled():
            future.set_result(SimpleNamespace(block=block, seconds=1e-3))

    def close(self):
        self.closed += 1
        self.open.clear()


@pytest.fixture(autouse=True)
def plain(monkeypatch):
    """No scenario, and blocks of three trials."""
    monkeypatch.setattr(process_pool, "scenario_sha256", lambda scenario: "key")
    monkeypatch.setattr(process_pool, "warm_up", lambda scenario: None)
    monkeypatch.setattr(Blocks, "size", property(lambda self: 3))
    monkeypatch.setattr(Blocks, "finished", lambda self, result: None)


def run(monkeypatch, pool, trials, stop=None, at=None):
    """Blocks in the order in which they come back; a stop after some of them."""
    stop, found = stop or threading.Event(), []

    def waiting(pending, timeout, return_when):
        if pool.open:
            pool.finish_one()
        return {future for future in pending if future.done()}, set()

    monkeypatch.setattr(process_pool, "wait", waiting)
    for result in run_in_pool(None, Blocks([range(trials)]), pool, stop):
        found.append(result.block)
        if len(found) == at:
            stop.set()
    return found


@pytest.mark.parametrize(("trials", "blocks"), [(1, 1), (9, 3), (30, 10)])
def test_every_block_is_run_once_and_few_are_submitted_at_a_time(monkeypatch, trials, blocks):
    pool = Pool()
    found = run(monkeypatch, pool, trials)
    assert [number for block in found for number in block] == list(range(trials))
    assert len(pool.submitted) == blocks
    assert pool.most == min(blocks, 4)  # two for each worker
    assert pool.closed == 0


def test_a_stop_drops_what_has_not_been_started(monkeypatch):
    pool = Pool()
    found = run(monkeypatch, pool, 30, at=2)
    # those that were submitted and not running are cancelled
    assert found == [range(3), range(3, 6)]
    assert len(pool.submitted) == 5
    stopped = threading.Event()
    stopped.set()
    assert run(monkeypatch, Pool(), 30, stopped) == []


@pytest.mark.parametrize("dying", [(6,), ("at once",), (0, 6)])
def test_blocks_of_a_worker_that_died_are_run_again(monkeypatch, dying):
    pool = Pool(dying=dying)
    found = run(monkeypatch, pool, 15)
    assert sorted(number for block in found for number in block) == list(range(15))
    assert pool.closed == len(dying)


def test_a_block_of_which_workers_die_again_and_again_ends_the_run(monkeypatch):
    pool = Pool(workers=1, dying=[0] * MAX_ATTEMPTS)
    with pytest.raises(BoresightError, match=f"died {MAX_ATTEMPTS} times with the same trials"):
        run(monkeypatch, pool, 30)
    assert pool.closed == MAX_ATTEMPTS


@pytest.mark.parametrize(
    ("finished", "interrupted", "standing", "force", "written"),
    [
        (5, False, 9, False, True),
        (5, True, None, False, True),
        (5, True, 4, False, True),
        (5, True, 5, False, True),
        (5, True, 6, False, False),
        (5, True, 6, True, True),
    ],
)
def test_an_interrupted_run_replaces_no_results_of_more_trials(
    monkeypatch, tmp_path, finished, interrupted, standing, force, written
):
    """They are given back, and the folder is as it was."""
    before = None if standing is None else SimpleNamespace(amounts={"trials": standing})
    done = SimpleNamespace(finished=finished, interrupted=interrupted, table=None, store=SimpleNamespace(notes=[]))
    for name, replacement in {
        "results_folder": lambda folder, *_, **__: contextlib.nullcontext(folder),
        "run_identity": lambda *_: None,
        "run_trials": lambda *_, **__: done,
        "standing": lambda folder, kind: before,
        "_written": lambda *_: "written",
        "_summary": lambda *_: {},
        "Columns": lambda table: table,
    }.items():
        monkeypatch.setattr(study_run, name, replacement)
    found = study_run.run(Scenario.load("cubesat_ideal"), out=tmp_path, force=force)
    assert (found == "written") is written
    if not written:
        assert found.folder is None
    done.finished = 0
    with pytest.raises(BoresightError, match="no results"):
        study_run.run(Scenario.load("cubesat_ideal"), out=tmp_path, force=force)
