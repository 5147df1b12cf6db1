"""Locks and identities of results folders, without a second process of the package."""

import json
import os
import platform
import subprocess
import sys
from dataclasses import replace

import pytest

from simulator.scenario import Scenario
from simulator.study.folder_lock import LOCK_FILE, Owner, folder_lock
from simulator.study.results_folder import Identity, refuse_other_files, results_folder, scenario_sha256, study_folder
from startracker.errors import InputError

posix = pytest.mark.skipif(sys.platform == "win32", reason="processes of other hosts and of Windows are not examined")


@pytest.fixture
def ended():
    """ID of a process that has ended."""
    with subprocess.Popen([sys.executable, "-c", ""]) as process:
        process.wait()
    return process.pid


@posix
def test_an_owner_is_gone_if_its_process_is(ended):
    own = Owner.this_process()
    assert own == Owner(os.getpid(), platform.node(), own.started)
    assert not own.is_gone
    assert replace(own, pid=ended).is_gone
    assert not replace(own, pid=ended, host="elsewhere").is_gone  # cannot be known
    assert not replace(own, started="").is_gone
    if own.started:  # on Linux: a later process with the same ID
        assert replace(own, started=own.started + "1").is_gone


@posix
def test_the_lock_of_an_ended_process_is_taken_over_and_removed(ended, tmp_path):
    path = tmp_path / LOCK_FILE
    path.write_text(json.dumps({"pid": ended, "host": platform.node(), "started": "1"}))
    with folder_lock(tmp_path):
        assert json.loads(path.read_text())["pid"] == os.getpid()
        message = f"in use by process {os.getpid()} on this machine; wait until it has finished"
        with pytest.raises(InputError, match=message), folder_lock(tmp_path):
            pass
        assert path.exists()  # the refused one leaves the lock of the other
    assert not path.exists()


def test_the_lock_of_another_host_is_kept(ended, tmp_path):
    path = tmp_path / LOCK_FILE
    path.write_text(json.dumps({"pid": ended, "host": "elsewhere", "started": "1"}))
    message = rf"process {ended} on host 'elsewhere'; .* has ended, remove .*{LOCK_FILE}"
    with pytest.raises(InputError, match=message), folder_lock(tmp_path):
        pass
    assert path.exists()


@pytest.mark.parametrize("text", ["", "{", "[]", '{"pid": 1}', '{"pid": "x", "host": "a", "started": "b"}'])
def test_an_incomplete_lock_is_that_of_nobody(text, tmp_path):
    (tmp_path / LOCK_FILE).write_text(text)
    with folder_lock(tmp_path):
        pass
    assert not (tmp_path / LOCK_FILE).exists()


@pytest.mark.parametrize(
    "found", [None, [], "identity", {}, {"identity": 4}, {"identity": {}}, {"identity": {"amounts": [1]}}]
)
def test_json_without_an_identity_is_refused(found):
    with pytest.raises(ValueError, match="no identity"):
        Identity.from_dict("trials", found)


def test_an_identity_comes_back_from_json_and_names_its_amounts():
    given = Identity("trials", "cubesat", 7, "ab", {"trials": 400, "frames": 0}, "1.2")
    again = Identity.from_dict("trials", {"identity": json.loads(json.dumps(given.to_dict()))})
    assert again == given
    assert str(given) == "scenario 'cubesat', seed 7, 400 trials, boresight 1.2"
    partial = Identity.from_dict("trials", {"identity": {"amounts": {"trials": "3"}}})
    assert (partial.scenario, partial.sha256, partial.amounts) == ("unknown", "unknown", {"trials": 3})


def test_the_hash_is_of_values_files_and_options_but_not_of_the_number_of_trials():
    scenario = Scenario.load("cubesat_ideal")
    digest = scenario_sha256(scenario)
    assert scenario_sha256(scenario.with_values(trials=999)) == digest
    assert scenario_sha256(scenario.with_values(seed=99)) != digest
    assert scenario_sha256(scenario, grid=3) not in (digest, scenario_sha256(scenario, grid=4))
    refuse_other_files(scenario, digest)
    with pytest.raises(InputError, match=r"its files \(none found\) were changed during the run"):
        refuse_other_files(scenario, "0" * 64)


def test_resume_and_force_exclude_each_other(tmp_path):
    identity = Identity("run", "cubesat", 7, "ab", {"trials": 4})
    both = results_folder(tmp_path / "out", identity, resume=True, force=True)
    with pytest.raises(InputError, match="--resume and --force: use only one of them"), both:
        pass
    for options in ({}, {"resume": True}, {"force": True}):
        with results_folder(tmp_path / "out", identity, **options) as folder:
            assert (folder / LOCK_FILE).exists()


def test_the_folder_of_a_study_has_its_identity(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    scenario = Scenario.load("cubesat_ideal")
    with study_folder("coverage", scenario, None, False, grid=3) as (folder, identity):
        assert folder.resolve() == tmp_path / "out" / "cubesat_ideal-coverage"
        assert identity == Identity("coverage", "cubesat_ideal", scenario.seed, scenario_sha256(scenario, grid=3), {})
    with study_folder("budget", scenario, tmp_path / "other", True, {"trials": 4}) as (folder, identity):
        assert folder == tmp_path / "other"
        assert (identity.kind, identity.amounts) == ("budget", {"trials": 4})
