"""Sequences from scenario to files: tracked, deterministic, interrupted, blinded, drawn, from the command line."""

import json
import signal
import sys

import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image

from simulator import Scenario
from simulator.cli import _run
from simulator.study.sequence.frames import SequenceRunner
from simulator.study.sequence.run import run_sequence
from startracker.errors import BoresightError, InputError
from startracker.geometry.attitude import Attitude

pytestmark = pytest.mark.system

SMALL = [
    "detector.width=384",
    "detector.height=384",
    "optics.focal_length_mm=12",
    "optics.aperture_mm=12",
    "optics.distortion.k1=0",
    "sky.magnitude_limit=7",
    "detector.exposure_s=0.1",
    "sequence.frames=14",
]


def small(*overrides):
    return Scenario.load("cubesat_ideal", overrides=[*SMALL, *overrides])


def rows_of(table):
    return table.drop_columns([name for name in table.column_names if name.endswith("_ms")]).to_pylist()


def same(a, b):
    return a == b or (isinstance(a, float) and np.isnan(a) and np.isnan(b))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    scenario = small("tracker.prior=false", "sequence.dropouts=[{start_s: 3, duration_s: 1}]")
    return run_sequence(scenario, out=tmp_path_factory.mktemp("whole"), single=True, animate=True)


def test_tracked_with_a_dropout(whole):
    columns, summary = whole.columns, whole.summary
    assert columns["mode"][0] == "lost_in_space"
    assert (columns["mode"][[3, 4, 5, 10, 11]] == "tracking").all()
    assert (columns["status"][6:8] == "no_frame").all()
    assert (columns["mode"][6:8] == "coasting").all()
    assert summary["solved"] == 12
    assert summary["wrong"] == 0
    assert summary["stars_misidentified"] == 0
    assert summary["longest_outage_s"] == 1.0
    assert summary["time_in_mode_s"]["coasting"] == 1.0
    assert summary["single"]["solved"] == 12
    # while nothing is seen, the filter is less and less sure; then at once as sure as before
    sigma = columns["sigma_cross_x_deg"]
    assert sigma[5] < sigma[6] < sigma[7]
    assert sigma[8] < 2 * sigma[5]
    # body and camera errors are the same vector in other axes, and that from truth to estimate
    for k in (2, 9):
        true = Attitude([columns[f"true_q{a}"][k] for a in "xyzw"])
        found = Attitude([columns[f"q{a}"][k] for a in "xyzw"])
        camera = np.degrees(true.rotation_vector_to(found))
        assert np.allclose([columns[f"error_{a}_deg"][k] for a in ("cross_x", "cross_y", "about_boresight")], camera)
        assert columns["error_pitch_deg"][k] == pytest.approx(columns["error_about_boresight_deg"][k])
    assert summary["nees"]["mean"] < 15.0


def test_files(whole):
    assert set(whole.files) >= {"sequence.parquet", "sequence.json", "sequence.html", "sequence.gif"}
    assert rows_of(pq.read_table(whole.folder / "sequence.parquet"))[0]["index"] == 0
    assert json.loads((whole.folder / "sequence.json").read_text())["availability"] == pytest.approx(12 / 14)
    again = Scenario.load(whole.folder / "scenario.resolved.yaml")
    assert again == whole.scenario
    page = (whole.folder / "sequence.html").read_text()
    assert "85.71 %" in page
    assert "<script" not in page
    assert "http://" not in page.replace("http://www.w3.org", "")


def test_animation_shows_windows_and_stars(whole):
    with Image.open(whole.folder / "sequence.gif") as movie:
        assert movie.n_frames == 14
        counts = []
        for k in range(14):
            movie.seek(k)
            pixels = np.asarray(movie.convert("RGB")).astype(int)[38:-230]
            counts.append(
                [int((np.abs(pixels - colour).sum(axis=2) == 0).sum()) for colour in ([230, 159, 0], [86, 180, 233])]
            )
    windows, stars = np.array(counts).T
    assert windows[0] == 0  # lost in space: no windows yet
    assert stars[0] > 0
    assert (windows[3:6] > 100).all()
    assert windows[6] == stars[6] == 0


@pytest.mark.usefixtures("no_drawing")
def test_same_seed_same_rows(whole):
    again = rows_of(run_sequence(whole.scenario, single=True).frames)
    for a, b in zip(rows_of(whole.frames), again, strict=True):
        assert all(same(a[name], b[name]) for name in a)
    other = rows_of(run_sequence(whole.scenario.changed({"seed": 2, "sequence.frames": 4}), single=True).frames)
    assert other[3]["true_qx"] != again[3]["true_qx"]


@pytest.mark.usefixtures("no_drawing")
def test_interrupt_keeps_what_is_done(whole, tmp_path):
    def stop_at_five(done, total):
        if done == 5:
            signal.raise_signal(signal.SIGINT)

    part = run_sequence(whole.scenario, out=tmp_path, single=True, progress=stop_at_five)
    assert part.summary["interrupted"]
    assert (part.summary["frames"], part.summary["requested"]) == (5, 14)
    kept = rows_of(pq.read_table(tmp_path / "sequence.parquet"))
    for a, b in zip(kept, rows_of(whole.frames)[:5], strict=True):
        assert all(same(a[name], b[name]) for name in a)
    assert "interrupted: 5 of 14" in (tmp_path / "sequence.html").read_text()


def test_sun_in_the_field_is_a_status():
    # half an orbit after the node at 22 h the spacecraft stands in the daylight
    sequence = run_sequence(
        small(
            "pointing.target=Sun",
            "optics.baffle.pst=vane",
            "sequence.start_s=3000",
            "sequence.frames=3",
            "tracker.prior=false",
        )
    )
    columns = sequence.columns
    assert sequence.summary["solved"] == 0
    assert sequence.summary["availability"] == 0.0
    assert sequence.summary["first_solution_s"] is None
    assert (columns["mode"] == "none").all()
    assert "solved" not in columns["status"]
    assert all("sun" in names.lower() for names in columns["excluded"])


def test_slew_with_a_gyro():
    scenario = small(
        "sequence.slew.turn_deg=[0, 0, 1.5]",
        "sequence.slew.max_rate_deg_s=0.5",
        "sequence.slew.start_s=1",
        "sequence.gyro.use=true",
        "sequence.frames=16",
    )
    sequence = run_sequence(scenario)
    columns = sequence.columns
    assert sequence.summary["solved"] == 16
    assert sequence.summary["wrong"] == 0
    assert (columns["true_rate_y_deg_s"].max() > 0.45) or (columns["true_rate_y_deg_s"].min() < -0.45)
    # the gyro's rate is the mean over the step before: half a step of acceleration, 0.05°/s, and its noise
    rate = columns["rate_y_deg_s"][1:] - columns["true_rate_y_deg_s"][1:]
    assert np.abs(rate).max() < 0.05 + 0.01
    assert np.isfinite(columns["bias_x_deg_h"]).all()
    first, last = columns["sigma_bias_x_deg_h"][[0, -1]]
    assert last < first
    known = [columns[f"bias_{a}_deg_h"][-1] - columns[f"true_bias_{a}_deg_h"][-1] for a in "xyz"]
    sigma = [columns[f"sigma_bias_{a}_deg_h"][-1] for a in "xyz"]
    assert (np.abs(known) < 5 * np.array(sigma)).all()


def test_each_frame_is_smeared_by_its_own_rate():
    """A star's light spread over a streak of L pixels is no higher than 1/L of it: 3°/s for 0.1 s are 11 pixels."""
    overrides = ["sequence.rates=[{at_s: 0}, {at_s: 1, yaw_deg_s: 3}]", "sequence.frames=3"]
    runner = SequenceRunner(small("detector.hot_pixel_fraction=0", *overrides))
    peaks = [float(np.max(t.frame.image)) - float(np.median(t.frame.image)) for t in runner.frames()]
    assert peaks[2] < 0.5 * peaks[0]


def test_mp4_by_ffmpeg(monkeypatch, tmp_path):
    """A stand-in for ffmpeg that writes down how many bytes came, and one that fails."""
    program = tmp_path / "ffmpeg"
    program.write_text(
        f"#!{sys.executable}\nimport sys\ndata = sys.stdin.buffer.read()\n"
        "size = sys.argv[sys.argv.index('-s') + 1]\nopen(sys.argv[-1], 'w').write(f'{size} {len(data)}')\n"
    )
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    sequence = run_sequence(small("sequence.frames=2"), out=tmp_path / "out", animate=True)
    assert "sequence.mp4" in sequence.files
    size, count = (tmp_path / "out/sequence.mp4").read_text().split()
    width, height = (int(n) for n in size.split("x"))
    assert width % 2 == height % 2 == 0
    assert int(count) == 2 * width * height * 3
    program.write_text(f"#!{sys.executable}\nimport sys\nsys.exit('no such codec')\n")
    with pytest.raises(BoresightError, match="no such codec"):
        run_sequence(small("sequence.frames=1"), out=tmp_path / "other", animate=True)


@pytest.mark.parametrize("name", ["orbit", "slew"])
def test_shipped_sequences(name):
    """Their first frames; the slew begins at once."""
    scenario = Scenario.load(name, overrides=["sequence.slew.start_s=0", "sequence.frames=6"])
    summary = run_sequence(scenario).summary
    assert summary["wrong"] == 0
    assert summary["stars_misidentified"] == 0
    assert summary["solved"] == 6
    for axis in ("roll", "pitch", "yaw"):
        assert summary["errors_deg"][axis]["three_sigma"] < getattr(scenario.specification, f"{axis}_deg")


def test_contradictions_are_told():
    with pytest.raises(InputError, match="order of time"):
        small("sequence.rates=[{at_s: 3}, {at_s: 3, yaw_deg_s: 1}]")
    with pytest.raises(InputError, match="more than 170° per step"):
        small("sequence.slew.turn_deg=[0, 0, 90]", "sequence.slew.max_rate_deg_s=400")
    with pytest.raises(InputError, match="DE421"):
        small("sequence.start_s=1e10")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--sequence", "--trials", "5"], "--trials: has no effect with --sequence"),
        (["--frames", "5"], "--frames: requires --sequence"),
        (["--sequence", "--frames", "0"], "--frames: must be at least 1"),
        (["--sequence", "--step-s", "0"], "--step-s: must be above 0"),
    ],
)
def test_options_that_do_not_fit(arguments, words, capsys, tmp_path):
    assert _run(["run", "cubesat_ideal", *arguments, "--out", str(tmp_path / "out")]) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("no_drawing")
def test_command_line(tmp_path, capsys):
    options = [text for override in SMALL for text in ("--set", override)]
    assert (
        _run(
            [
                "run",
                "cubesat_ideal",
                *options,
                "--sequence",
                "--frames",
                "3",
                "--step-s",
                "0.25",
                "--out",
                str(tmp_path),
            ]
        )
        == 0
    )
    assert "Attitude available for 100.00 % of 0.75 s, none wrong" in " ".join(capsys.readouterr().out.split())
    assert pq.read_table(tmp_path / "sequence.parquet")["elapsed_s"].to_pylist() == [0.0, 0.25, 0.5]
