"""The command as a user meets it: exit status, one clear line for every mistake, nothing half-written."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image

from simulator.cli.application import run_application

ROOT = Path(__file__).resolve().parents[2]
CUBESAT = str(ROOT / "scenarios" / "cubesat_ideal.yaml")
TC211 = str(ROOT / "scenarios" / "tc211.yaml")  # small frames: quick


def boresight(*arguments, cwd, timeout=300):
    command = [sys.executable, "-m", "simulator.cli", *map(str, arguments)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(
        command, cwd=cwd, capture_output=True, text=True, timeout=timeout, env=environment, check=False
    )


@pytest.fixture
def command(capsys, monkeypatch):
    """Run a command as `boresight` does, in this process: without the two seconds of imports of another."""

    def run(*arguments, cwd):
        monkeypatch.chdir(cwd)
        status = run_application([str(argument) for argument in arguments])
        printed = capsys.readouterr()
        return subprocess.CompletedProcess(arguments, status, printed.out, printed.err)

    return run


def assert_one_clear_line(done, status=2):
    assert done.returncode == status, done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1, done.stderr


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rendered")
    done = boresight("render", CUBESAT, "--index", 3, "--out", "frame.fits", "--preview", "frame.png", cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder


def test_rendered_frame_is_solved_where_its_truth_says(rendered):
    from astropy.io import fits

    done = boresight("solve", "frame.fits", "--json", "--wcs", "wcs.fits", "--annotate", "solved.png", cwd=rendered)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["status"] == "solved"
    header = fits.getheader(rendered / "frame.fits", "TRUTH")
    assert found["dec_deg"] == pytest.approx(header["ATT_DEC"], abs=0.01)
    assert found["ra_deg"] == pytest.approx(header["ATT_RA"], abs=0.01)
    assert {"quaternion", "matched", "rmse_arcsec", "parity", "stars", "times_ms", "fov_deg", "roll_deg"} <= set(found)
    for picture in ("frame.png", "solved.png"):
        assert np.asarray(Image.open(rendered / picture)).std() > 5
    assert fits.getheader(rendered / "wcs.fits")["CTYPE1"].startswith("RA---TAN")


def test_run_leaves_its_four_files_and_says_the_same_on_one_and_two_workers(tmp_path, command, monkeypatch):
    for workers in (1, 2):
        done = command("run", CUBESAT, "--trials", 24, "--workers", workers, "--out", f"w{workers}", cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        assert "none wrong" in done.stdout
        monkeypatch.setattr("simulator.study.report.page.report_html", lambda *_, **__: "page")  # one is enough
    assert sorted(os.listdir(tmp_path / "w1")) == [
        "report.html",
        "scenario.resolved.yaml",
        "summary.json",
        "trials.parquet",
    ]
    one, two = (pq.read_table(tmp_path / f"w{w}" / "trials.parquet") for w in (1, 2))
    kept = [name for name in one.column_names if not name.endswith("_ms")]
    assert one.column_names == two.column_names
    assert one.select(kept).equals(two.select(kept))
    for name in kept:  # bytes, so that NaN and −0.0 count too
        for left, right in zip(one[name].chunks, two[name].chunks, strict=True):
            assert [b and b.to_pybytes() for b in left.buffers()] == [b and b.to_pybytes() for b in right.buffers()]
    summary = json.loads((tmp_path / "w1" / "summary.json").read_text())
    assert {
        "trials",
        "solved",
        "unsolved",
        "wrong",
        "identification_rate",
        "errors_deg",
        "trials_per_second",
        "seed",
        "version",
    } <= set(summary)
    for axis in ("roll", "pitch", "yaw", "cross_x", "cross_y", "about_boresight"):
        assert {"mean", "std", "rms", "p50", "p95", "p997", "max"} <= set(summary["errors_deg"][axis])
    page = (tmp_path / "w1" / "report.html").read_text()
    assert "http://" not in page.replace("http://www.w3.org", "")
    assert "https://" not in page
    again = command(
        "run", tmp_path / "w1" / "scenario.resolved.yaml", "--trials", 5, "--workers", 1, "--out", "again", cwd=tmp_path
    )
    assert again.returncode == 0, again.stderr


_INTERRUPTED_IMPORT = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in processes of a shell's background
class Finder:
    def find_spec(self, name, *more):
        if name == "{module}":
            signal.raise_signal(signal.SIGINT)
sys.meta_path.insert(0, Finder())
import simulator.cli
simulator.cli.main()
"""


@pytest.mark.parametrize(
    "module", ["startracker.errors", "typer", "simulator.cli.application", "numpy", "simulator.cli.run_command"]
)
def test_an_interrupt_during_the_imports_is_one_line(module, tmp_path):
    """Of the entry point, whose own import loads nothing but `simulator`, and of a command."""
    done = subprocess.run(
        [sys.executable, "-c", _INTERRUPTED_IMPORT.format(module=module), "run", TC211, "--trials", "2"],
        cwd=tmp_path, capture_output=True, text=True, timeout=300, env={**os.environ, "PYTHONPATH": str(ROOT)},
        check=False,
    )  # fmt: skip
    assert_one_clear_line(done, status=130)
    assert done.stderr == "boresight: interrupted\n"
    assert not done.stdout


@pytest.mark.slow  # with trials that cost nothing: test_study_kills.py
@pytest.mark.parametrize("workers", [1, 2])
def test_an_interrupt_keeps_the_finished_trials_and_resume_finishes_them(tmp_path, command, workers):
    interrupted = [
        sys.executable,
        "-m",
        "simulator.cli",
        "run",
        TC211,
        "--trials",
        "5000",
        "--workers",
        str(workers),
        "--out",
        "out",
    ]
    process = subprocess.Popen(
        interrupted, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    parts = tmp_path / "out" / ".trials-parts"
    deadline = time.monotonic() + 120
    while len(list(parts.glob("*.parquet"))) < 2 and time.monotonic() < deadline:
        time.sleep(0.05)
    finished = [part.stem.split("-")[:2] for part in parts.glob("*.parquet")]  # named by their first and last index
    os.killpg(process.pid, signal.SIGINT)
    output, errors = process.communicate(timeout=120)
    assert process.returncode == 130, errors
    assert "Traceback" not in errors
    kept = pq.read_table(tmp_path / "out" / "trials.parquet")
    assert len(finished) >= 2
    assert sum(int(stop) - int(start) for start, stop in finished) <= kept.num_rows < 5000
    assert "Interrupted" in output
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["interrupted"] is True
    assert summary["trials"] == kept.num_rows
    total = kept.num_rows // 20 * 20 + 30
    resumed = command("run", TC211, "--trials", total, "--workers", 1, "--resume", "--out", "out", cwd=tmp_path)
    assert resumed.returncode == 0, resumed.stderr
    whole = pq.read_table(tmp_path / "out" / "trials.parquet")
    assert whole["index"].to_pylist() == list(range(total))
    assert not parts.exists()


def test_mistakes_of_the_command_line(tmp_path, command):
    cases = [
        ("run", CUBESAT, "--trials", 0),
        ("run", CUBESAT, "--workers", 0),
        ("run", CUBESAT, "--trials", "many"),
        ("run", "missing.yaml"),
        ("run", CUBESAT, "--set", "optics.apperture_mm=3"),
        ("run", CUBESAT, "--out", "/proc/boresight"),
        ("render", CUBESAT, "--at", "noon"),
        ("render", CUBESAT, "--out", "missing/frame.fits"),
        ("render", CUBESAT, "--index", -1),
        ("solve",),
        ("solve", "missing.png"),
        ("solve", "missing.png", "--fov", 500),
        ("solve", "--centroids", "missing.csv", "--size", "10x10"),
        ("solve", "--centroids", "missing.csv", "--size", "10"),
        ("fly",),
        ("run", CUBESAT, "--fly"),
    ]
    for case in cases:
        assert_one_clear_line(command(*case, cwd=tmp_path))
        assert os.listdir(tmp_path) == [], case
    assert_one_clear_line(boresight("fly", cwd=tmp_path))  # the exit status of the process


def test_broken_empty_black_white_and_starless_images(tmp_path, command):
    folder = tmp_path / "images"
    folder.mkdir()
    noise = np.random.default_rng(3)
    broken = {"broken.png": b"\x89PNG\r\n\x1a\nnonsense", "empty.png": b"", "text.jpg": b"a cat"}
    for name, data in broken.items():
        (folder / name).write_bytes(data)
        assert_one_clear_line(command("solve", folder / name, cwd=tmp_path))
    pictures = {
        "black.png": np.zeros((200, 300), np.uint8),
        "white.png": np.full((200, 300), 255, np.uint8),
        "noise.png": noise.normal(60, 6, (200, 300)).clip(0, 255).astype(np.uint8),
        "gradient.png": np.add.outer(np.arange(200), np.arange(300)).astype(np.uint8),
    }
    for name, image in pictures.items():
        Image.fromarray(image).save(folder / name)
        done = command("solve", folder / name, "--json", cwd=tmp_path)
        assert done.returncode == 1, (name, done.stdout, done.stderr)
        found = json.loads(done.stdout)
        assert found["status"] != "solved"
        assert found["reason"]
        assert found["quaternion"] is None


def test_a_field_of_view_a_little_wrong_is_fitted(tmp_path, command):
    from startracker import Attitude, Camera, load_catalog

    camera, attitude = Camera.from_fov(10.0, 512, 512), Attitude.from_radec_roll(83.6, -1.0, 30.0)
    bright = load_catalog("hipparcos").brighter_than(6.0)
    seen = attitude.apply(bright.directions(2000.0))
    near = seen[:, 2] > 0.99
    xy = camera.project(seen[near])
    inside = camera.contains(xy)
    table = np.column_stack([xy, 10 ** (-0.4 * bright.v_mag[near])])[inside]
    np.savetxt(tmp_path / "stars.csv", table, delimiter=",", header="x,y,flux", comments="")
    for fov in ("10", "10.1"):
        done = command("solve", "--centroids", "stars.csv", "--fov", fov, "--size", "512x512", "--json", cwd=tmp_path)
        found = json.loads(done.stdout)
        assert found["status"] == "solved"
        assert found["fov_deg"] == pytest.approx(10.0, abs=0.01)
        # 1/50 pixel: the fit of one radial term to a lens that has none
        assert (found["ra_deg"], found["dec_deg"]) == pytest.approx((83.6, -1.0), abs=0.0004)


def test_help_names_every_command(tmp_path):
    done = boresight("--help", cwd=tmp_path)
    assert done.returncode == 0
    for command in ("run", "render", "solve", "validate", "show", "schema"):
        assert f" {command} " in done.stdout


def test_the_noiseless_plane_is_the_frame_without_its_noise(tmp_path, command):
    from astropy.io import fits

    done = command("render", TC211, "--noiseless", "--noiseless-plane", "--out", "f.fits", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    with fits.open(tmp_path / "f.fits") as units:
        assert [unit.name for unit in units] == ["PRIMARY", "TRUTH", "MEAN_E"]
        # everything off: one electron is one DN and the frame is the light itself, to the plane's float32
        assert np.allclose(units[0].data, units["MEAN_E"].data, rtol=1e-6)
    command("render", TC211, "--out", "g.fits", cwd=tmp_path)
    with fits.open(tmp_path / "g.fits") as units:
        assert len(units) == 2
