"""The shipped sequence with calibration in flight, rendered: what is found, and what the attitudes gain."""

import math

import numpy as np
import pytest

from simulator import Scenario, render
from simulator.study.axes import CAMERA_AXES
from simulator.study.sequence.frames import SequenceRunner
from simulator.study.sequence.run import run_sequence
from simulator.study.star_tracker import build_tracker
from startracker.tracking import TrackingSession

pytestmark = pytest.mark.system

FRAMES = 70


@pytest.fixture(scope="module")
def flown():
    """Columns of the sequence with a constant temperature and a wrong width of star images, its runner, and the errors
    (N, 3) of a session that knows the true camera, from the same frames."""
    scenario = Scenario.load(
        "thermal",
        overrides=[
            f"sequence.frames={FRAMES}",
            "sequence.step_s=20",
            "optics.thermal.swing_k=0",
            "tracker.centroid.psf_sigma_px=0.95",
        ],
    )
    runner = SequenceRunner(scenario)
    known = TrackingSession(build_tracker(scenario, runner.renderer.focal_plane.true_camera), runner.noise)
    rows, errors = [], []
    for k, tracked in enumerate(runner.frames()):
        rows.append(tracked.row)
        solution = known.update(tracked.frame, k * scenario.sequence.step_s)
        errors.append(np.degrees(runner.cameras[k].rotation_vector_to(solution.attitude)))
    columns = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    return columns, runner, np.array(errors)


def test_the_drift_of_the_lens_is_found_within_three_sigma(flown):
    """100 ppm and 1 µm (0.18 px): each parameter within 3σ in the end, the focal length known to a tenth of its drift
    and the principal point to a third."""
    columns, runner, _ = flown
    summary = runner.calibrated.summarise(columns)
    assert summary["frames_used"] == FRAMES
    for name, found in summary["parameters"].items():
        assert abs(found["error_sigmas"]) < 3.0, name
    assert summary["parameters"]["focal_length_ppm"]["true"] == pytest.approx(100.0, rel=1e-4)
    assert summary["parameters"]["focal_length_ppm"]["sigma"] < 10.0
    assert summary["parameters"]["principal_point_x_px"]["true"] == pytest.approx(1.0 / 5.5, rel=1e-6)
    assert summary["parameters"]["principal_point_x_px"]["sigma"] < 0.06
    assert summary["chi2"]["value"] < 18.5  # χ² of 4 exceeds it with probability 1e-3


def test_attitudes_return_to_those_of_a_known_camera(flown):
    """The same frames: the calibrated session against one with the true camera, over the second half. Their difference
    is the error of the lens, which the covariance states; about the boresight it is small against the noise."""
    columns, _, known = flown
    late = slice(FRAMES // 2, None)
    error = np.stack([columns[f"error_{axis}_deg"] for axis in CAMERA_AXES], axis=1)[late] * 3600.0
    sigma = np.stack([columns[f"sigma_{axis}_deg"] for axis in CAMERA_AXES], axis=1)[late] * 3600.0
    assert (np.abs(error) < 4.0 * sigma).all()
    rms, bound = np.sqrt(np.mean(error**2, axis=0)), np.sqrt(np.mean((known[late] * 3600.0) ** 2, axis=0))
    assert rms[2] == pytest.approx(bound[2], rel=0.1)
    decentring_arcsec = math.degrees(1.0 / 12e3) * 3600.0  # 1 µm of 12 mm: 17.2″
    assert rms[1] < decentring_arcsec / 4.0
    assert np.nanmean(columns["nees"][late]) < 3.0 * 3.0  # without calibration it is above 1,000


def test_width_and_defective_pixels_are_found(flown):
    columns, runner, _ = flown
    summary = runner.calibrated.summarise(columns)
    width = summary["psf_width_px"]
    assert abs(width["value"] - width["true"]) < 4.0 * width["sigma"] < 0.01
    assert runner.calibrated.calibration.centroiding(runner.tracker.centroid).psf_sigma_px == width["value"]
    pixels = summary["defective_pixels"]
    assert pixels["certain_mapped"] >= 0.9 * pixels["certain"] > 50
    assert pixels["sound_mapped"] == 0
    assert len(pixels["xy"]) == pixels["mapped"] == columns["defective_px"][-1]
    assert (np.diff(columns["defective_px"]) >= -5).all()


def test_results_and_page(tmp_path):
    scenario = Scenario.load("thermal", overrides=["sequence.frames=8"])
    sequence = run_sequence(scenario, out=tmp_path)
    page = (tmp_path / "sequence.html").read_text(encoding="utf-8")
    assert "Calibration in flight" in page
    assert "Principal point, columns" in page
    assert "defective pixels" in page
    assert f"{sequence.summary['in_flight_calibration']['chi2']['value']:.1f}" in page
    again = run_sequence(scenario)
    for name in sequence.frames.column_names:
        if not name.endswith("_ms"):
            assert sequence.frames[name].equals(again.frames[name]), name


def test_off_leaves_no_trace():
    """Without `use` the keys have no effect on any row, and there are no columns; without a swing its period has no
    effect on any pixel."""
    off = ["sequence.frames=4", "tracker.in_flight_calibration.use=false"]
    plain = run_sequence(Scenario.load("thermal", overrides=off))
    other = run_sequence(Scenario.load("thermal", overrides=[*off, "tracker.in_flight_calibration.shift_px=9"]))
    assert "in_flight_calibration" not in plain.summary
    assert not {"lens_updated", "focal_length_ppm", "defective_px"} & set(plain.frames.column_names)
    for name in plain.frames.column_names:
        if not name.endswith("_ms"):
            assert plain.frames[name].equals(other.frames[name]), name
    images = [
        render(Scenario.load("cubesat_ideal", overrides=keys), 3)[0].image
        for keys in ([], ["optics.thermal.swing_period_s=77", "optics.thermal.expansion_ppm_k=5"])
    ]
    assert np.array_equal(*images)


def test_the_temperature_swings():
    """T = mean + swing sin(2π t / period): a quarter of a period after the epoch the field is scaled by the whole
    swing, three quarters after it by the opposite; half a period after it nothing is changed."""
    keys = ["optics.thermal.expansion_ppm_k=50", "optics.thermal.swing_k=10", "optics.thermal.swing_period_s=4000"]
    scenario = Scenario.load("cubesat_ideal", overrides=keys)
    attitude = render(scenario, 0)[1].attitude
    scale = {}
    for quarter in range(4):
        frame, truth = render(scenario, 0, at_s=1000.0 * quarter, attitude=attitude)
        camera, sources = frame.camera, truth.sources
        ideal = camera.project(truth.attitude.apply(sources.direction)) - [camera.cx, camera.cy]
        offset = sources.xy - [camera.cx, camera.cy]
        scale[quarter] = float(np.sum(offset * ideal) / np.sum(ideal**2)) - 1.0
    assert [1e6 * scale[q] for q in range(4)] == pytest.approx([0.0, 500.0, 0.0, -500.0], abs=1e-3)
