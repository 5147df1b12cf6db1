"""Two rendered heads on one body: solved separately, fused, delayed, blinded, interrupted, reported."""

import json
import math
import signal

import numpy as np
import pyarrow.parquet as pq
import pytest
from star_sequences import SMALL_CAMERA

from simulator import Scenario
from simulator.cli import _run
from simulator.study.sequence.heads import HeadsRunner
from simulator.study.sequence.run import run_sequence
from startracker.errors import InputError
from startracker.geometry.attitude import Attitude

pytestmark = pytest.mark.system

GYRO = "sequence.gyro={use: true, angle_random_walk_deg_sqrt_h: 0.01, bias_deg_h: 5, scale_factor_ppm: 300}"
A = "name: a, mounting: orbit_normal"
B = "name: b, mounting: zenith, alignment_sigma_arcsec: 60, optics: {focal_length_mm: 14}, detector: {exposure_s: 0.05}"


def pair(*overrides, a=A, b=B, frames=14):
    heads = f"heads=[{{{a}}}, {{{b}}}]"
    return Scenario.load(
        "cubesat_ideal", overrides=[*SMALL_CAMERA, GYRO, heads, f"sequence.frames={frames}", *overrides]
    )


def rows_of(table):
    return table.drop_columns([name for name in table.column_names if name.endswith("_ms")]).to_pylist()


def same(a, b):
    return all(a[n] == b[n] or (isinstance(a[n], float) and math.isnan(a[n]) and math.isnan(b[n])) for n in a)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    b = f"{B}, time_offset_s: 0.2, delay_s: 0.8, dropouts: [{{start_s: 3, duration_s: 2}}]"
    return run_sequence(pair(b=b), out=tmp_path_factory.mktemp("whole"), animate=True, ccsds=True)


def test_columns_of_each_head_and_fused(whole):
    columns, summary = whole.columns, whole.summary
    assert (columns["status"] == "solved").all()
    assert (columns["mode"] == "prior").all()
    assert (columns["head_a_update"][1:] == "used").all()
    assert columns["head_a_update"][0] == "started"
    blind = columns["head_b_status"] == "no_frame"
    assert np.flatnonzero(blind).tolist() == [6, 7, 8, 9]  # 3.2 s to 4.7 s
    assert (columns["head_b_update"][blind] == "").all()
    assert (columns["head_b_update"][~blind] == "used").all()
    np.testing.assert_allclose(columns["head_b_elapsed_s"], columns["elapsed_s"] + 0.2)
    assert (columns["stars_matched"] == columns["head_a_stars_matched"] + columns["head_b_stars_matched"]).all()
    assert summary["heads"]["b"]["solved"] == 10
    assert summary["heads"]["b"]["longest_outage_s"] == 2.0
    assert summary["heads"]["a"]["filter"]["started"] == 1
    assert summary["wrong"] == summary["heads"]["a"]["wrong"] == summary["heads"]["b"]["wrong"] == 0
    # body and camera errors are the same vector, that from truth to estimate; so are those of a head
    for k in (2, 13):
        true = Attitude([columns[f"true_q{i}"][k] for i in "xyzw"])
        found = Attitude([columns[f"q{i}"][k] for i in "xyzw"])
        camera = np.degrees(true.rotation_vector_to(found))
        assert np.allclose([columns[f"error_{x}_deg"][k] for x in ("cross_x", "cross_y", "about_boresight")], camera)
    # each head is worst about its own boresight: −z of the body for b, +y for a
    rms = {h: [summary["heads"][h]["errors_deg"][x]["rms"] for x in ("roll", "pitch", "yaw")] for h in "ab"}
    assert int(np.argmax(rms["a"])) == 1
    assert int(np.argmax(rms["b"])) == 2


def test_alignment_and_gyro_errors_are_found(whole):
    """Drawn with the standard deviations that the filter assumes; 4.5 σ each, of which one in 10,000 of 9 is beyond."""
    columns = whole.columns
    kinds = [f"head_b_{{}}alignment_{i}_arcsec" for i in "xyz"]
    kinds += [f"{{}}bias_{i}_deg_h" for i in "xyz"] + [f"{{}}scale_{i}_ppm" for i in "xyz"]
    for kind in kinds:
        off = columns[kind.format("")][-1] - columns[kind.format("true_")][-1]
        assert abs(off) < 4.5 * columns[kind.format("sigma_")][-1], kind
    for i in "xyz":
        assert np.ptp(columns[f"head_b_true_alignment_{i}_arcsec"]) == 0.0
        assert columns[f"head_b_sigma_alignment_{i}_arcsec"][-1] < 20.0
    assert abs(whole.summary["heads"]["b"]["alignment_arcsec"]["x"]["true"]) > 0.0


def test_files(whole):
    assert set(whole.files) >= {"sequence.parquet", "sequence.html", "sequence.gif", "true.aem", "estimated.acm"}
    assert json.loads((whole.folder / "sequence.json").read_text())["heads"]["a"]["solved"] == 14
    assert Scenario.load(whole.folder / "scenario.resolved.yaml") == whole.scenario
    page = (whole.folder / "sequence.html").read_text()
    for text in ("Roll, heads and fused", "Alignment of b", "Accuracy of the heads", "Bias about the body"):
        assert text in page
    assert "Alignment of a" not in page


@pytest.mark.usefixtures("no_drawing")
def test_same_seed_same_rows_and_interruption_keeps_what_is_done(whole, tmp_path):
    def stop_at_five(done, total):
        if done == 5:
            signal.raise_signal(signal.SIGINT)

    part = run_sequence(whole.scenario, out=tmp_path, progress=stop_at_five)
    assert (part.summary["frames"], part.summary["interrupted"]) == (5, True)
    kept = rows_of(pq.read_table(tmp_path / "sequence.parquet"))
    assert all(same(a, b) for a, b in zip(kept, rows_of(whole.frames)[:5], strict=True))
    again = rows_of(run_sequence(whole.scenario, out=tmp_path).frames)  # continues with the same command
    assert all(same(a, b) for a, b in zip(again, rows_of(whole.frames), strict=True))


def test_heads_have_noise_of_their_own_under_one_sky():
    """Two cameras of one kind and mounting: the same stars, other noise and other hot pixels."""
    scenario = pair(b="name: b, mounting: orbit_normal", frames=1)
    cameras = HeadsRunner(scenario).cameras
    images, truths = zip(*(camera.take(0, HeadsRunner(scenario).exposed(0, 0)) for camera in cameras), strict=True)
    np.testing.assert_array_equal(truths[0].sources.xy, truths[1].sources.xy)
    np.testing.assert_array_equal(truths[0].mean_electrons, truths[1].mean_electrons)
    noise = [np.asarray(image.image, dtype=float) for image in images]
    assert np.corrcoef(noise[0][:40].ravel(), noise[1][:40].ravel())[0, 1] < 0.5
    dark = [camera.renderer.detector.pattern.dark_e_s for camera in cameras]
    assert not np.array_equal(dark[0], dark[1])


def test_delayed_attitudes_give_the_same_filter():
    """What arrives late and out of order ends in the same state, to the last bit, if the same frames were solved."""
    ends, solved = [], []
    for delays in ((0.0, 0.0), (1.3, 0.1)):
        a, b = (
            f"{text}, delay_s: {delay}" for text, delay in zip((A, f"{B}, time_offset_s: 0.25"), delays, strict=True)
        )
        runner = HeadsRunner(pair(a=a, b=b, frames=8))
        rows = [tracked.row for tracked in runner.frames()]
        mekf = runner.fusion.estimate(runner.ends_s[-1])
        ends.append(np.concatenate([mekf.quat, mekf.bias_rad_s, mekf.scale, mekf.full_covariance.ravel()]))
        solved.append([[row[f"head_{h}_{axis}"] for h in "ab" for axis in ("error_roll_deg", "nees")] for row in rows])
    np.testing.assert_array_equal(solved[0], solved[1])
    np.testing.assert_array_equal(ends[0], ends[1])


def test_shaken_and_smeared_by_the_same_motion():
    """Jitter of 20″ of the body is in the frames of both heads and in the gyro: all errors remain as stated."""
    columns = run_sequence(
        pair("pointing.jitter={rms_arcsec: [20, 20, 20], corner_hz: 0.5, psd: lorentz, axes: body}", frames=10)
    ).columns
    assert (columns["status"] == "solved").all()
    assert (columns["nees"] < 31.0).all()
    for head in "ab":
        assert (columns[f"head_{head}_nees"] < 31.0).all()
    step = np.diff(columns["true_ra_deg"]) * 3600.0
    assert np.std(step) > 5.0


def test_mounting_that_bends():
    """A rotation of up to 60″ about the y axis of each camera: the attitudes of the cameras are right, that of the body
    is off by it."""
    bent = "pointing.thermo_elastic={amplitude_arcsec: [0, 60, 0], reference: node}"
    columns = run_sequence(pair(bent, frames=3)).columns
    assert (columns["status"] == "solved").all()
    rotation = columns["mounting_y_deg"] * 3600.0
    assert np.abs(rotation).min() > 10.0
    assert np.abs(columns["error_cross_y_deg"]).max() * 3600.0 < 10.0
    np.testing.assert_allclose(np.abs(columns["error_yaw_deg"]) * 3600.0, np.abs(rotation), atol=10.0)
    for head in "ab":
        assert np.abs(columns[f"head_{head}_error_cross_y_deg"]).max() * 3600.0 < 10.0


def test_without_a_gyro_and_without_a_prior():
    scenario = pair("sequence.gyro.use=false", "tracker.prior=false", frames=6)
    columns = run_sequence(scenario).columns
    assert columns["head_a_mode"][0] == "lost_in_space"
    assert (columns["status"] == "solved").all()
    assert not any("bias" in name or "scale" in name for name in columns)
    assert (columns["nees"] < 31.0).all()


def test_before_the_first_attitude_arrives():
    columns = run_sequence(pair(a=f"{A}, delay_s: 0.7", b=f"{B}, delay_s: 0.7", frames=5)).columns
    assert columns["status"].tolist() == ["waiting", "waiting", "solved", "solved", "solved"]
    assert columns["mode"].tolist()[:2] == ["none", "none"]
    assert np.isnan(columns["qw"][:2]).all()


def test_one_camera_has_no_columns_of_heads():
    scenario = Scenario.load("cubesat_ideal", overrides=[*SMALL_CAMERA, "sequence.frames=2"])
    sequence = run_sequence(scenario)
    assert not any("head" in name or "scale" in name for name in sequence.columns)
    assert "heads" not in sequence.summary


@pytest.mark.usefixtures("no_drawing")
def test_on_the_command_line(capsys, tmp_path):
    assert _run(["run", "two_heads", "--sequence", "--frames", "3", "--out", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert "Heads: errors of single frames" in out
    assert "Alignment of zenith" in out
    with pytest.raises(InputError, match="frame by frame"):
        run_sequence(Scenario.load("two_heads", overrides=["sequence.frames=1"]), single=True)
