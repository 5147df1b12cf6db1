"""Files are whole or not there."""

import os
import stat

import pytest

from simulator.paths import make_folder, write_atomically
from startracker.errors import InputError


def test_written_file_is_whole_and_readable_by_others(tmp_path):
    target = tmp_path / "a.txt"
    write_atomically(target, "one")
    write_atomically(target, b"two")
    assert target.read_bytes() == b"two"
    assert stat.S_IMODE(target.stat().st_mode) == 0o644
    assert os.listdir(tmp_path) == ["a.txt"]


def test_failed_write_leaves_the_old_file_and_no_litter(tmp_path, monkeypatch):
    target = tmp_path / "a.txt"
    write_atomically(target, "old")

    def full_disk(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full_disk)
    with pytest.raises(InputError, match="No space left on device"):
        write_atomically(target, "new")
    assert target.read_text() == "old"
    assert os.listdir(tmp_path) == ["a.txt"]


def test_missing_folder_is_one_clear_line(tmp_path):
    with pytest.raises(InputError, match="cannot be written"):
        write_atomically(tmp_path / "missing" / "a.txt", "x")


def test_folder_in_the_way_of_a_file(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="choose another --out"):
        make_folder(tmp_path / "file" / "out")
    assert make_folder(tmp_path / "new" / "deep").is_dir()
