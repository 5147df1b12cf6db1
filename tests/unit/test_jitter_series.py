"""Jitter as a time series: its spline and means, sequences that follow it, sections for single frames, mistakes."""

import math

import numpy as np
import pytest
from scipy.integrate import simpson

from simulator.checks import load_scenario
from simulator.mission.clock import Clock
from simulator.mission.jitter_table import read_jitter
from simulator.optics.jitter import Jitter
from simulator.optics.jitter_series import SampledJitter
from simulator.randomness import stream
from simulator.renderer import Renderer
from simulator.scenario.errors import ScenarioError
from simulator.study.sequence.frames import SequenceRunner
from startracker.errors import InputError

ARCSEC = math.pi / 648000.0
EPOCH = load_scenario("cubesat_ideal").epoch
WHEEL_HZ, AMPLITUDE = 35.0, (8.0, 5.0, 20.0)
STEP_S = 1.0 / WHEEL_HZ / 20.0


def wheel(t_s):
    """Angles (N, 3), arcseconds, of a wheel with a slow drift."""
    t = np.asarray(t_s)[:, None]
    return np.array(AMPLITUDE) * np.sin(2.0 * np.pi * WHEEL_HZ * t + np.arange(3)) + np.array([1.0, -2.0, 0.5]) * t


def table(tmp_path, first_s=-1.0, last_s=4.0, name="wheel.csv"):
    t_s = np.arange(first_s, last_s + 1e-9, STEP_S)
    rows = np.column_stack([t_s, wheel(t_s)])
    lines = ",".join(["t_s", "x_arcsec", "y_arcsec", "z_arcsec"])
    path = tmp_path / name
    path.write_text(lines + "\n" + "\n".join(",".join(f"{x:.12g}" for x in row) for row in rows) + "\n")
    return path


def series(tmp_path, **keys):
    return read_jitter(Jitter(series=str(table(tmp_path)), **keys), Clock(EPOCH))


def test_the_motion_between_samples_and_its_means(tmp_path):
    """20 samples a period: a cubic spline is good to (2π/20)⁴/384 of the amplitude, 3e-5; means by Simpson's rule."""
    motion = SampledJitter(series(tmp_path), 1.25, np.eye(3))
    t = np.linspace(-0.7, 0.7, 301)
    np.testing.assert_allclose(motion.at(t) / ARCSEC, wheel(1.25 + t), rtol=0, atol=1e-4 * max(AMPLITUDE))
    for exposure_s in (0.01, 0.2):
        mean = motion.mean(exposure_s)
        fine = np.linspace(-0.5, 0.5, 20_001) * exposure_s
        expected = simpson(motion.at(fine) / ARCSEC, x=fine, axis=0) / exposure_s
        np.testing.assert_allclose(mean / ARCSEC, expected, rtol=0, atol=1e-6)
        centred = motion.centred(exposure_s)
        assert np.abs(centred.mean(exposure_s)).max() < 1e-18
        np.testing.assert_allclose(centred.at(0.003), motion.at(0.003) - mean, rtol=0, atol=1e-18)
    np.testing.assert_allclose(motion.shifted(0.3).at(t[:9]), motion.at(t[:9] + 0.3), rtol=0, atol=1e-12 * ARCSEC)
    ends = motion.at(np.array([-0.1, 0.1]))
    np.testing.assert_allclose(motion.rate(0.2), (ends[1] - ends[0]) / 0.2, rtol=1e-12)
    # the rms rate of a sinusoid is 2π f A/√2; that of the drift is 1e-3 of it
    expected = 2.0 * np.pi * WHEEL_HZ * np.array(AMPLITUDE) / math.sqrt(2.0)
    np.testing.assert_allclose(motion.rms_rate_rad_s() / ARCSEC, expected, rtol=2e-3)
    assert motion.max_hz == pytest.approx(10.0 * WHEEL_HZ)


def test_body_axes(tmp_path):
    turned = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    given = Jitter(series="x", axes="body")
    section = series(tmp_path).section(given, stream(1, "jitter", 0), 0.2, turned)
    plain = SampledJitter(section.series, section.origin_s, np.eye(3))
    np.testing.assert_allclose(section.at(0.01), turned @ plain.at(0.01), rtol=1e-12)
    np.testing.assert_allclose(section.rms_rate_rad_s(), turned @ plain.rms_rate_rad_s(), rtol=1e-12)


def scenario(path, *overrides):
    small = ["detector.width=256", "detector.height=256", "pointing.error_deg=0"]
    return load_scenario("cubesat_ideal", [*small, f"pointing.jitter.series={path}", *overrides])


def test_a_sequence_follows_the_series_in_time(tmp_path):
    path = table(tmp_path)
    runner = SequenceRunner(scenario(path, "sequence.frames=5", "sequence.step_s=0.7", "sequence.start_s=0.5"))
    exposure_s = runner.renderer.exposure_s
    for k, (state, camera) in enumerate(zip(runner.states, runner.cameras, strict=True)):
        t = 0.5 + 0.7 * k
        fine = t + np.linspace(-0.5, 0.5, 20_001) * exposure_s
        mean = np.trapezoid(wheel(fine), fine, axis=0) / exposure_s
        np.testing.assert_allclose(state.camera.rotation_vector_to(camera) / ARCSEC, mean, rtol=0, atol=1e-3)
    tracked = list(runner.frames())[2]
    frame, truth = tracked.frame, tracked.truth
    np.testing.assert_allclose(truth.attitude.rotation_vector_to(runner.cameras[2]), 0.0, atol=1e-14)
    still = Renderer(
        load_scenario("cubesat_ideal", ["detector.width=256", "detector.height=256", "pointing.error_deg=0"])
    )
    image, _ = still.frame(2, at_s=runner.states[2].t_s, attitude=truth.attitude)
    assert (frame.image != image.image).any()
    late = scenario(path, "sequence.frames=7", "sequence.step_s=0.7")
    with pytest.raises(InputError, match=r"wheel.csv covers -1 to 4 s after the epoch; 4.1 s is outside"):
        SequenceRunner(late)


@pytest.mark.parametrize("shutter", ["global", "rolling"])
def test_single_frames_take_random_sections(shutter, tmp_path):
    renderer = Renderer(scenario(table(tmp_path), f"detector.shutter={shutter}", "detector.line_time_us=20"))
    origins = set()
    for index in range(4):
        jitter = renderer.scene(index).jitter
        again = renderer.scene(index).jitter
        assert jitter.origin_s == again.origin_s
        origins.add(jitter.origin_s)
        assert np.abs(jitter.mean(renderer.exposure_s)).max() < 1e-18
        renderer.frame(index)
    assert len(origins) == 4


def test_mistakes(tmp_path):
    path = table(tmp_path)
    with pytest.raises(
        ScenarioError, match=r"pointing.jitter.rms_arcsec: the jitter is already defined by pointing.ji"
    ):
        scenario(path, "pointing.jitter.rms_arcsec=[1, 1, 1]")
    with pytest.raises(ScenarioError, match=r"pointing.jitter.series: .*none.csv: cannot be read"):
        scenario(tmp_path / "none.csv")
    bad = tmp_path / "bad.csv"
    bad.write_text("t_s,x_arcsec,y_arcsec,z_arcsec\n0,1,2,3\n0.1,1,2\n")
    with pytest.raises(ScenarioError, match=r"pointing.jitter.series: .*bad.csv:3: 3 of 4 columns"):
        scenario(bad)
    short = table(tmp_path, 0.0, 0.05, "short.csv")
    with pytest.raises(InputError, match=r"short.csv: 0.05 s are shorter than the exposure"):
        Renderer(scenario(short)).scene(0)
