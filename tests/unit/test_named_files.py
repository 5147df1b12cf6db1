"""Files that a scenario or a command names: only regular files up to a stated size are read, and every refusal is one
line that says what to give.

`/dev/zero` never ends; a pipe never answers; a sparse file of 20 GB has more than any limit and takes no space.
"""

import os
import zipfile
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from simulator.cli.centroid_list import read_centroids
from simulator.cli.image_files import is_our_frame
from simulator.cli.report_command import _read_json
from simulator.cli.stimulate_command import _pattern
from simulator.fits import read_fits
from simulator.live.stimulator.calibration import read_stimulator
from simulator.mission.attitudes import build_attitude_law
from simulator.mission.clock import Clock
from simulator.mission.element_list import ElementList
from simulator.mission.jitter_table import read_jitter
from simulator.mission.parameters import AttitudeSource, OrbitParameters, PointingParameters
from simulator.mission.trajectories import build_trajectory
from simulator.optics.curves import load_curve
from simulator.optics.jitter import Jitter, load_spectrum
from simulator.optics.stray_light import build_baffle
from startracker import Camera, read_image
from startracker.centroid.psf_model import load_psf
from startracker.errors import InputError

EPOCH = datetime(2026, 3, 21, 12, tzinfo=UTC)
CLOCK = Clock(EPOCH)
ORBIT = build_trajectory(OrbitParameters(), EPOCH)


def orbit(key):
    return lambda path: build_trajectory(OrbitParameters(**{key: str(path)}), EPOCH)


def attitude(key, **others):
    source = {key: None}
    return lambda path: build_attitude_law(
        PointingParameters(attitude=AttitudeSource(**(source | {key: str(path)} | others))), ORBIT
    )


READERS = {
    **{f"orbit.{key}": orbit(key) for key in ("tle", "omm", "oem", "spk", "csv")},
    **{f"attitude.{key}": attitude(key) for key in ("aem", "csv", "parquet")},
    "attitude.ck": attitude("ck", sclk="clock.tsc"),
    "sky.satellites": lambda path: ElementList.read(path, CLOCK, 30.0),
    "jitter.series": lambda path: read_jitter(Jitter(series=str(path)), CLOCK),
    "jitter.table": lambda path: load_spectrum(Jitter(psd="table", table=str(path))),
    "quantum_efficiency": lambda path: load_curve(str(path), "quantum_efficiency"),
    "transmission": lambda path: load_curve(str(path), "transmission"),
    "baffle.pst": lambda path: build_baffle(str(path), 30.0, 20.0, 25.0),
    "camera": Camera.from_yaml,
    "stimulator": read_stimulator,
    "pattern": _pattern,
    "centroid.psf": load_psf,
    "centroids": read_centroids,
    "image": read_image,
    "frame": read_fits,
    "is_our_frame": is_our_frame,
    "summary": lambda path: _read_json(path, set()),
}


@pytest.mark.parametrize("name", READERS)
def test_devices_pipes_folders_and_huge_files_are_refused(name, tmp_path):
    read = READERS[name]
    pipe, huge, folder = tmp_path / "pipe.csv", tmp_path / "huge.csv", tmp_path / "folder.csv"
    os.mkfifo(pipe)
    with huge.open("wb") as stream:
        stream.truncate(20_000_000_000)
    folder.mkdir()
    for path, message in (
        (Path("/dev/zero"), r"/dev/zero: is not a regular file .*; \S"),
        (pipe, r"pipe.csv: is not a regular file .*; \S"),
        (huge, r"huge.csv: has 20,000.0 MB, more than the [\d,]+ MB that are read; \S"),
        (folder, r"folder.csv: .*folder.*; \S"),
        (tmp_path / "none.csv", r"none.csv: (cannot be read \(No such file or directory\)|no such file); \S"),
    ):
        with pytest.raises(InputError, match=message) as error:
            read(path)
        assert "\n" not in str(error.value)


def test_a_file_that_grows_or_states_no_size_is_read_up_to_the_limit(tmp_path):
    """Files of /proc are regular and state a size of 0: what counts is what is read."""
    from startracker.files import read_bytes

    with pytest.raises(InputError, match=r"/proc/self/maps: is larger, more than the 0 MB that are read; give less"):
        read_bytes("/proc/self/maps", 10, "give less")
    (tmp_path / "ten").write_bytes(bytes(10))
    assert read_bytes(tmp_path / "ten", 10, "give less") == bytes(10)
    with pytest.raises(InputError, match=r"is not a file name; give less"):
        read_bytes("a\0b", 10, "give less")
    assert np.frombuffer(read_bytes(tmp_path / "ten", 11, "x"), np.uint8).sum() == 0


@pytest.mark.parametrize("name", ["camera", "stimulator", "pattern"])
@pytest.mark.parametrize("text", ["[" * 1_000, "a: [", "a: 2026-02-30", "a: b: c", "\0"])
def test_settings_that_are_not_yaml_are_one_line(name, text, tmp_path):
    (tmp_path / "x.yaml").write_text(text)
    with pytest.raises(InputError, match=r"x.yaml: (is not YAML|is nested too deeply|is not a pattern file)") as error:
        READERS[name](tmp_path / "x.yaml")
    assert "\n" not in str(error.value)


def test_an_endless_image_on_standard_input(tmp_path, monkeypatch):
    from simulator.cli import image_files

    monkeypatch.setattr(image_files, "IMAGE_BYTES", 1_000_000)
    with open("/dev/zero", encoding="utf-8") as endless:
        monkeypatch.setattr("sys.stdin", endless)
        with pytest.raises(InputError, match=r"-: standard input: is larger, more than the 1 MB that are read; send"):
            image_files.spooled([Path("-")], tmp_path)


def test_small_files_that_expand_without_end(tmp_path):
    """Three million rows of a constant are some kB of Parquet, 150 million zeros some 100 kB of a NumPy archive."""
    table, archive = tmp_path / "jitter.parquet", tmp_path / "psf.npz"
    pq.write_table(pa.table({"t_s": np.zeros(3_000_000)}), table)
    assert table.stat().st_size < 1_000_000
    with pytest.raises(InputError, match=r"jitter.parquet: has 3,000,000 rows, more than the 2,000,000 that are read"):
        READERS["jitter.series"](table)
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as stream:
        stream.writestr("table.npy", bytes(150_000_000))
    assert archive.stat().st_size < 1_000_000
    with pytest.raises(InputError, match=r"psf.npz' is not a star image .*150,000,000 bytes"):
        READERS["centroid.psf"](archive)
