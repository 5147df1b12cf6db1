"""Finished trials are kept in few files, whole at any moment, and come back as they were."""

import contextlib
import itertools
import json
import os
import shutil

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from simulator.scenario import Scenario
from simulator.study.results_folder import unfinished_identity
from simulator.study.trials import parts
from simulator.study.trials.checked_files import DAMAGED_FOLDER
from simulator.study.trials.columns import Columns
from simulator.study.trials.parts import PARTS_FOLDER, PartStore, discard_parts
from startracker.errors import BoresightError, InputError


@pytest.fixture(scope="module")
def scenario():
    return Scenario.load("cubesat_ideal")


def rows(block):
    index = np.arange(block.start, block.stop)
    return pa.table({"index": index, "value": np.sin(index), "status": [f"s{i % 3}" for i in index]})


def cut(trials, rng, longest):
    edges = [0]
    while edges[-1] < trials:
        edges.append(min(trials, edges[-1] + int(rng.integers(1, longest + 1))))
    return [range(a, b) for a, b in itertools.pairwise(edges)]


def finish(store, folder, trials):
    """What a run leaves, as far as the store reads it."""
    checksum = store.write(folder / "trials.parquet", trials)
    (folder / "summary.json").write_text(json.dumps({"trials_sha256": checksum}))
    discard_parts(folder)


def files(folder):
    return sorted((folder / parts.PARTS_FOLDER).glob("*.parquet"))


@pytest.mark.parametrize("seed", range(4))
def test_blocks_in_any_order_come_back_by_index_from_few_files(scenario, tmp_path, monkeypatch, seed):
    monkeypatch.setattr(parts, "MERGE_EVERY", 8)
    monkeypatch.setattr(parts, "MERGED_TRIALS", 1000)
    rng = np.random.default_rng(seed)
    blocks = cut(3000, rng, 20)
    for i in range(0, len(blocks), 6):  # as workers finish them: nearly in order
        blocks[i : i + 6] = [blocks[i : i + 6][k] for k in rng.permutation(len(blocks[i : i + 6]))]
    store = PartStore(scenario, tmp_path, resume=False)
    most = 0
    for block in blocks:
        store.put(block, rows(block))
        most = max(most, len(files(tmp_path)))
    # per 1000 trials: merged parts of at least half of that, smaller ones by halves below, and 8 unmerged
    assert most <= 2 * 3 + 10 + 8 + 6
    assert store.missing(3000) == []
    assert store.table(3000).equals(rows(range(3000)))
    again = PartStore(scenario, tmp_path, resume=True)
    assert again.missing(3000) == []
    assert again.missing(3005) == [range(3000, 3005)]
    assert again.table(2500).equals(rows(range(2500)))


def test_the_file_does_not_depend_on_the_blocks(scenario, tmp_path, monkeypatch):
    monkeypatch.setattr(parts, "ROW_GROUP_TRIALS", 70)
    for name, longest in (("a", 9), ("b", 300)):
        store = PartStore(scenario, tmp_path / name, resume=False)
        for block in cut(1000, np.random.default_rng(1), longest):
            store.put(block, rows(block))
        store.write(tmp_path / f"{name}.parquet", 1000)
    assert (tmp_path / "a.parquet").read_bytes() == (tmp_path / "b.parquet").read_bytes()
    assert pq.ParquetFile(tmp_path / "a.parquet").num_row_groups == 15
    assert pq.read_table(tmp_path / "a.parquet").equals(rows(range(1000)))


def test_broken_parts_and_litter_are_run_again(scenario, tmp_path):
    store = PartStore(scenario, tmp_path, resume=False)
    for block in (range(10), range(10, 30), range(30, 40), range(50, 60)):
        store.put(block, rows(block))
    first, second, third, fourth = files(tmp_path)
    first.write_bytes(first.read_bytes()[:-20])
    second.write_bytes(b"")
    pq.write_table(rows(range(31, 41)), third)  # not what its name says
    (tmp_path / parts.PARTS_FOLDER / ".000000060-000000070.parquet.x1").write_bytes(b"half")
    again = PartStore(scenario, tmp_path, resume=True)
    assert again.missing(60) == [range(50)]
    assert files(tmp_path) == [fourth]
    assert len(list((tmp_path / parts.PARTS_FOLDER).iterdir())) == 2  # with the identity
    aside = tmp_path / DAMAGED_FOLDER
    assert sorted(path.name for path in aside.iterdir()) == [first.name, second.name, third.name]
    assert [note.split(": ")[0] for note in again.notes] == [str(first), str(second), str(third)]
    assert all(f"damaged: its contents do not match its checksum; moved to {aside}" in note for note in again.notes)


@pytest.mark.parametrize("seed", range(3))
def test_a_flipped_bit_anywhere_in_a_part_is_found(scenario, tmp_path, seed):
    """Arrow itself reads many of these without complaint, as other numbers."""
    store = PartStore(scenario, tmp_path, resume=False)
    store.put(range(40), rows(range(40)))
    (part,) = files(tmp_path)
    whole = part.read_bytes()
    rng = np.random.default_rng(seed)
    for _ in range(40):
        data = bytearray(whole)
        data[rng.integers(len(data))] ^= 1 << rng.integers(8)
        part.write_bytes(data)
        assert PartStore(scenario, tmp_path, resume=True).missing(40) == [range(40)]


def test_parts_that_are_damaged_or_deleted_while_a_run_goes_on_are_missing_again(scenario, tmp_path, monkeypatch):
    monkeypatch.setattr(parts, "MERGE_EVERY", 4)
    store = PartStore(scenario, tmp_path, resume=False)
    store.put(range(10), rows(range(10)))
    store.put(range(10, 20), rows(range(10, 20)))
    first, second = files(tmp_path)
    first.unlink()
    data = bytearray(second.read_bytes())
    data[len(data) // 2] ^= 4
    second.write_bytes(data)
    for start in (20, 30):  # the second one merges
        store.put(range(start, start + 10), rows(range(start, start + 10)))
    assert store.missing(40) == [range(20)]
    assert store.check()
    assert "is missing" in store.notes[0]
    assert "damaged" in store.notes[1]
    files(tmp_path)[0].write_bytes(b"")
    assert not store.check()
    assert store.missing(40) == [range(30)]


def test_a_kill_between_a_merge_and_its_clearing_up_doubles_nothing(scenario, tmp_path):
    store = PartStore(scenario, tmp_path, resume=False)
    for block in (range(10), range(10, 30), range(30), range(30, 40)):
        store.put(block, rows(block))
    again = PartStore(scenario, tmp_path, resume=True)
    assert [path.stem[:19] for path in files(tmp_path)] == ["000000000-000000030", "000000030-000000040"]
    assert again.table(40).equals(rows(range(40)))


def test_parts_of_another_scenario_are_refused_and_more_trials_are_not(scenario, tmp_path):
    PartStore(scenario, tmp_path, resume=False).put(range(5), rows(range(5)))
    assert PartStore(scenario.with_values(trials=7), tmp_path, resume=True).missing(7) == [range(5, 7)]
    for resume in (True, False):
        with pytest.raises(
            InputError, match=r"contains unfinished trials of another run \(scenario 'cubesat_ideal', seed 1, 7"
        ):
            PartStore(scenario.with_values(seed=scenario.seed + 1), tmp_path, resume)
    assert len(files(tmp_path)) == 1


def test_a_run_that_finished_nothing_stands_in_nobodys_way(scenario, tmp_path):
    PartStore(scenario, tmp_path, resume=False)
    store = PartStore(scenario.with_values(seed=scenario.seed + 1), tmp_path, resume=False)
    store.put(range(5), rows(range(5)))
    assert unfinished_identity(tmp_path / PARTS_FOLDER, "run").seed == scenario.seed + 1


def test_parts_without_an_identity_are_refused(scenario, tmp_path):
    PartStore(scenario, tmp_path, resume=False).put(range(5), rows(range(5)))
    (tmp_path / PARTS_FOLDER / "identity.json").unlink()
    with pytest.raises(InputError, match="unidentifiable unfinished trials"):
        PartStore(scenario, tmp_path, resume=False)


def test_results_that_stand_are_taken_over(scenario, tmp_path):
    store = PartStore(scenario, tmp_path, resume=False)
    store.put(range(5), rows(range(5)))
    finish(store, tmp_path, 5)
    again = PartStore(scenario, tmp_path, resume=True)
    assert again.missing(8) == [range(5, 8)]
    again.put(range(5, 8), rows(range(5, 8)))
    finish(again, tmp_path, 8)
    assert pq.read_table(tmp_path / "trials.parquet").equals(rows(range(8)))
    assert PartStore(scenario, tmp_path, resume=False).missing(8) == [range(8)]
    discard_parts(tmp_path)
    other = scenario.with_values(seed=scenario.seed + 1)
    assert PartStore(other, tmp_path, resume=True).missing(8) == [range(8)]
    assert pq.read_table(tmp_path / "trials.parquet").num_rows == 8  # nobody's to delete


@pytest.mark.parametrize("kept", range(6))
def test_a_kill_while_parts_are_removed_leaves_what_the_next_run_can_read(scenario, tmp_path, monkeypatch, kept):
    """The identity was removed in the order of the folder: parts without it were refused as unidentifiable."""
    store = PartStore(scenario, tmp_path, resume=False)
    for start in range(0, 20, 5):
        store.put(range(start, start + 5), rows(range(start, start + 5)))
    removed, unlink = [], os.unlink

    def killed(*arguments, **options):
        if len(removed) == kept:
            raise KeyboardInterrupt
        removed.append(arguments)
        unlink(*arguments, **options)

    with monkeypatch.context() as patch, contextlib.suppress(KeyboardInterrupt):
        patch.setattr("os.unlink", killed)
        discard_parts(tmp_path)
    assert len(removed) == min(kept, 5)  # four parts and the identity
    assert sum(map(len, PartStore(scenario, tmp_path, resume=True).missing(20))) == 5 * min(kept, 4)


def test_damaged_results_are_set_aside_and_not_taken_over(scenario, tmp_path):
    store = PartStore(scenario, tmp_path, resume=False)
    store.put(range(50), rows(range(50)))
    finish(store, tmp_path, 50)
    file = tmp_path / "trials.parquet"
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 16
    file.write_bytes(data)
    again = PartStore(scenario, tmp_path, resume=True)
    assert again.missing(50) == [range(50)]
    assert again.notes[0].startswith(f"{file}: is damaged")
    assert (tmp_path / DAMAGED_FOLDER / "trials.parquet").read_bytes() == data


def test_a_kill_while_results_are_moved_into_place_is_no_damage(scenario, tmp_path):
    """The summary is the new run's already, trials.parquet still the old one's; the parts have all trials."""
    store = PartStore(scenario, tmp_path, resume=False)
    store.put(range(5), rows(range(5)))
    finish(store, tmp_path, 5)
    store = PartStore(scenario, tmp_path, resume=False)
    store.put(range(8), rows(range(8)))
    checksum = store.write(tmp_path / parts.PARTS_FOLDER / "trials.parquet", 8)
    (tmp_path / "summary.json").write_text(json.dumps({"trials_sha256": checksum}))
    again = PartStore(scenario, tmp_path, resume=True)
    assert again.missing(8) == []
    assert again.notes == []
    assert pq.read_table(tmp_path / "trials.parquet").num_rows == 5


def test_unfinished_trials_are_taken_over_without_being_asked(scenario, tmp_path):
    PartStore(scenario, tmp_path, resume=False).put(range(5), rows(range(5)))
    again = PartStore(scenario, tmp_path, resume=False)
    assert again.missing(8) == [range(5, 8)]
    again.refuse_fewer(5)
    with pytest.raises(
        InputError, match=r"unfinished trials of a longer run \(scenario 'cubesat_ideal', seed 1, 5 trials"
    ):
        again.refuse_fewer(4)
    assert PartStore(scenario, tmp_path, resume=False, force=True).missing(8) == [range(8)]


def test_integers_meet_real_numbers(scenario, tmp_path):
    store = PartStore(scenario, tmp_path, resume=False)
    store.put(range(1), pa.table({"index": [0], "value": [1]}))
    store.put(range(1, 2), pa.table({"index": [1], "value": [1.5]}))
    store.write(tmp_path / "trials.parquet", 2)
    assert pq.read_table(tmp_path / "trials.parquet")["value"].to_pylist() == [1.0, 1.5]


def test_columns_are_read_when_asked_for(scenario, tmp_path, monkeypatch):
    table = rows(range(100))
    pq.write_table(table, tmp_path / "t.parquet", row_group_size=30)
    for columns in (Columns(tmp_path / "t.parquet"), Columns(table)):
        assert list(columns) == ["index", "value", "status"]
        assert len(columns) == 3
        assert "value" in columns
        assert "speed" not in columns
        assert columns.get("speed") is None
        assert np.array_equal(columns["value"], table["value"].to_numpy())
        assert columns["status"].tolist() == table["status"].to_pylist()
        assert columns["status"][0] is columns["status"][3]  # a million equal strings are one
        assert np.sum(columns["status"] == "s1") == 33
        assert columns.table().equals(table)
        with pytest.raises(ValueError, match="read-only"):
            columns["value"][0] = 1
    monkeypatch.setattr("simulator.study.trials.columns.CACHE_BYTES", 1000)
    columns = Columns(tmp_path / "t.parquet")
    assert columns["value"] is columns["value"]
    first = columns["index"]
    assert columns["value"] is not None
    assert columns["index"] is not first
    shutil.copy(tmp_path / "t.parquet", tmp_path / "copy.parquet")
    pq.write_table(rows(range(7)), tmp_path / "t.parquet")
    with pytest.raises(BoresightError, match="changed"):
        columns["status"]
