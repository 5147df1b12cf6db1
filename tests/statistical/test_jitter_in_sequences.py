"""Jitter of a sequence: one process through all frames, which the gyro measures too, with the spectrum asked for."""

import math

import numpy as np
import pytest
from scipy.signal import periodogram, welch
from star_sequences import SMALL_CAMERA, pooled_nees

from simulator import Scenario
from simulator.optics.jitter import Jitter, draw_jitter, load_spectrum
from simulator.randomness import stream
from simulator.study.sequence.frames import SequenceRunner
from simulator.study.sequence.run import run_sequence

ARCSEC = math.pi / 648000.0
QUIET_GYRO = [
    "sequence.gyro.use=true",
    "sequence.gyro.angle_random_walk_deg_sqrt_h=1e-12",
    "sequence.gyro.bias_deg_h=0",
    "sequence.gyro.bias_instability_deg_h=0",
]


def runner_of(*overrides):
    return SequenceRunner(Scenario.load("cubesat_ideal", overrides=[*SMALL_CAMERA, *overrides]))


def jittered(runner):
    """Rotation vectors (N, 3) of the true attitudes against the motion without jitter, camera axes."""
    pairs = zip(runner.states, runner.cameras, strict=True)
    return np.array([state.camera.rotation_vector_to(camera) for state, camera in pairs])


def test_shifted_path_is_the_same_process():
    path = draw_jitter(Jitter(rms_arcsec=(2.0, 3.0, 10.0)), load_spectrum(Jitter()), stream(1, "x", 0))
    t = np.linspace(-3.0, 3.0, 31)
    for shift in (0.0, 0.4, 1e4):
        np.testing.assert_allclose(path.shifted(shift).at(t), path.at(t + shift), rtol=0, atol=1e-8 * ARCSEC)
    slope = np.gradient(path.at(np.linspace(-0.05, 0.05, 2001)), 0.1 / 2000, axis=0).mean(axis=0)
    # the ends' one-sided differences, two of 2001, are off by some of the rms rate
    assert (np.abs(path.rate(0.1) - slope) < 2e-3 * path.rms_rate_rad_s()).all()


def test_a_sinusoid_moves_as_one(tmp_path):
    """100″ at 0.02 Hz: between frames 0.5 s apart at most 2 A sin(π f dt), A its amplitude; the exposure's mean is
    less by 1 − sinc(f T) = 6e-6. Drawn anew for each frame it moved by 182″."""
    (tmp_path / "slow.csv").write_text("0.0199999,0\n0.02,1\n0.0200001,0\n", encoding="utf-8")
    runner = runner_of(
        "pointing.jitter.rms_arcsec=[100, 100, 0]",
        "pointing.jitter.psd=table",
        f"pointing.jitter.table={tmp_path / 'slow.csv'}",
        "sequence.frames=160",
        *QUIET_GYRO,
    )
    angles = jittered(runner) / ARCSEC
    t = 0.5 * np.arange(160)
    basis = np.stack([np.cos(2 * np.pi * 0.02 * t), np.sin(2 * np.pi * 0.02 * t)], axis=1)
    for axis in (0, 1):
        fit, *_ = np.linalg.lstsq(basis, angles[:, axis], rcond=None)
        # lines within 1e-7 Hz of 0.02 Hz go out of step by 2π · 1e-7 · 80 s = 5e-5 of the amplitude
        np.testing.assert_allclose(basis @ fit, angles[:, axis], atol=2e-4 * np.hypot(*fit))
        most = 2.0 * np.hypot(*fit) * math.sin(math.pi * 0.02 * 0.5)
        steps = np.abs(np.diff(angles[:, axis]))
        assert steps.max() == pytest.approx(most, rel=0.01)
        assert most < 25.0
    assert np.abs(angles[:, 2]).max() < 1e-9
    # and the rate of it is that of the truth
    rate = np.degrees([r - s.rate_camera_rad_s for r, s in zip(runner.rates, runner.states, strict=True)])
    np.testing.assert_allclose(rate[1:-1, 0], np.gradient(angles[:, 0], 0.5)[1:-1] / 3600.0, rtol=0.02, atol=1e-5)


def test_gyro_measures_the_jitter():
    """Without noise of its own: its rate over a step turns the true attitude at one frame into that at the next."""
    overrides = "pointing.jitter.rms_arcsec=[60, 20, 40]", "pointing.jitter.corner_hz=0.3", "sequence.frames=30"
    runner = runner_of(*overrides, *QUIET_GYRO)
    for k in range(29):
        turn = runner.cameras[k].rotation_vector_to(runner.cameras[k + 1])
        np.testing.assert_allclose(runner.gyro[k] * 0.5, turn, atol=1e-6 * ARCSEC)
    assert np.abs(np.diff(jittered(runner), axis=0)).max() > 10.0 * ARCSEC


def test_frames_have_the_attitudes_of_the_process():
    """The truth of rendered frames, and what an operated camera takes at its own exposures."""
    overrides = "pointing.jitter.rms_arcsec=[60, 20, 40]", "pointing.jitter.corner_hz=0.3", "sequence.frames=4"
    for operated in ("false", "true"):
        runner = runner_of(*overrides, f"sequence.operation.use={operated}")
        for k, tracked in enumerate(runner.frames()):
            quat = np.array([tracked.row[f"true_q{c}"] for c in "xyzw"])
            np.testing.assert_allclose(abs(quat @ runner.cameras[k].quat), 1.0, atol=1e-14)


def test_scale_factors_of_the_gyro():
    plain, scaled = (
        runner_of(*QUIET_GYRO, "sequence.frames=5", f"sequence.gyro.scale_factor_ppm={ppm}") for ppm in (0, 10_000)
    )
    share = scaled.gyro / plain.gyro - 1.0
    np.testing.assert_allclose(share, np.tile(share[0], (4, 1)), atol=1e-6)
    assert (np.abs(share[0]) < 0.04).all()
    assert np.abs(share[0]).max() > 1e-3
    assert scaled.noise.scale_sigma == 0.01
    assert plain.noise.scale_sigma == 0.0


DRIFT_AND_WHEELS = [(0.01, 500.0), (0.1, 5.0), (1.0, 0.05), (10.0, 5e-4), (29.0, 6e-5), (30.0, 0.01), (60.0, 0.01)]
"""A drift of density 1/f², and wheels from 30 to 60 Hz with 1 % of its variance: one is seen from frame to frame, the
other within an exposure."""


@pytest.fixture(scope="module")
def wide(tmp_path_factory):
    """A realisation of `DRIFT_AND_WHEELS` for a sequence, with its spectrum; rms 100″ about each axis."""
    path = tmp_path_factory.mktemp("jitter") / "wide.csv"
    points = np.log(DRIFT_AND_WHEELS)
    f = np.unique(np.concatenate([np.geomspace(0.01, 60.0, 4000), [30.0]]))
    power = np.exp(np.interp(np.log(f), *points.T))
    path.write_text("\n".join(f"{x:.9g},{y:.9g}" for x, y in zip(f, power, strict=True)), encoding="utf-8")
    section = Jitter(rms_arcsec=(100.0, 100.0, 100.0), psd="table", table=str(path))
    spectrum = load_spectrum(section)
    return draw_jitter(section, spectrum, stream(3, "jitter", 0), over_sequence=True), spectrum


def ratio_tolerance(segments, lines):
    """4.5 σ of the mean of periodograms of half-overlapping Hann segments, of which 1/1.06 are independent (Welch
    1967), of a sum of lines of fixed amplitudes: relative variance 1/K; and one line more or less of those in a
    bin."""
    return 4.5 * math.sqrt(1.06 / segments) + 1.0 / lines


def test_one_realisation_has_the_rms_asked_for(wide):
    """Each of 1,024 parts may be off by itself, at random: 1/1024^1.5; with the curvature of the density within them
    0.1 %, of which 4."""
    path, _ = wide
    variance = (path.cosine_rad**2 + path.sine_rad**2) / 2.0 / (100.0 * ARCSEC) ** 2
    np.testing.assert_allclose(variance.sum(axis=0), 1.0, rtol=0, atol=4e-3)
    # the wheels' share by the table, which they keep in every realisation
    wheels = np.sum(variance * (path.frequency_hz > 29.5), axis=0)
    fine = np.linspace(29.5, 60.0, 20_001)
    np.testing.assert_allclose(wheels, np.trapezoid(wide[1].per_hz(fine), fine), rtol=0.05)


def test_power_spectrum_over_frames(wide):
    """Welch's spectrum of one sequence's mean angles against the density times sinc²(f T), folded at the Nyquist
    frequency; of a density as 1/f² the window's width adds 1/k² at bin k."""
    path, spectrum = wide
    step_s, exposure_s, size, frames = 0.5, 0.2, 256, 8192
    angles = np.array([path.shifted(k * step_s).mean(exposure_s) for k in range(frames)]) / ARCSEC
    # a second run has the same bytes, of whatever part
    np.testing.assert_array_equal(path.shifted(7 * step_s).mean(exposure_s), angles[7] * ARCSEC)
    f, power = welch(angles, 1.0 / step_s, nperseg=size, axis=0, detrend=False)
    images = np.abs(f + np.arange(-40, 41)[:, None] / step_s)  # both signs of the frequency
    folded = np.sum(spectrum.per_hz(images) * np.sinc(images * exposure_s) ** 2, axis=0) * 100.0**2
    k = np.arange(len(f))
    inside = (k >= 8) & (f < 0.95)
    expected = (folded * (1.0 + 1.0 / np.maximum(k, 1) ** 2))[inside]
    lines = 512.0 * f[1] / (f[inside] * 5.0 * math.log(10.0)) * 2.0  # of the logarithmic half alone, in two bins
    allowed = ratio_tolerance(3 * (frames // (size // 2) - 1), np.maximum(lines, 1.0))
    ratio = power.mean(axis=1)[inside] / expected
    assert (np.abs(ratio - 1.0) < allowed).all()
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.03)
    # consecutive frames belong together: their difference is that of the density, 2 ∫ s (1 − cos 2π f dt) df
    fine = np.geomspace(0.01, 60.0, 400_001)
    seen = spectrum.per_hz(fine) * np.sinc(fine * exposure_s) ** 2 * (1.0 - np.cos(2.0 * np.pi * fine * step_s))
    step = math.sqrt(2.0 * np.trapezoid(seen, fine)) * 100.0
    assert step < 30.0  # and not √2 · 100″, of angles drawn anew
    np.testing.assert_allclose(np.diff(angles, axis=0).std(axis=0), step, rtol=0.1)


def test_power_spectrum_within_exposures(wide):
    """Periodograms of the angles within 120 exposures of 0.5 s of one sequence, in the band of the wheels, whose lines
    are 4 a bin and more; linear motion is removed, whose leakage falls as 1/k⁶."""
    path, spectrum = wide
    step_s, n = 0.5 / 100, 100
    within = (np.arange(n) - (n - 1) / 2.0) * step_s
    spectra = []
    for k in range(120):
        angles = path.shifted(0.7 * k).at(within) / ARCSEC
        f, power = periodogram(angles, 1.0 / step_s, window="hann", detrend="linear", axis=0)
        spectra.append(power.mean(axis=1))
    inside = (f > 33.0) & (f < 57.0)
    ratio = np.mean(spectra, axis=0)[inside] / (spectrum.per_hz(f[inside]) * 100.0**2)
    lines = 1024.0 * f[1] / (60.0 * 5.0 * math.log(10.0)) * 2.0
    assert (np.abs(ratio - 1.0) < ratio_tolerance(3 * 120, lines)).all()
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.05)


def test_a_realisation_does_not_depend_on_the_number_of_frames():
    """An interrupted sequence has the frames of a longer one, of the same bytes."""
    overrides = "pointing.jitter.rms_arcsec=[60, 20, 40]", "sequence.step_s=0.25"
    short, long = (runner_of(*overrides, f"sequence.frames={n}") for n in (5, 40))
    for k in range(5):
        np.testing.assert_array_equal(short.cameras[k].quat, long.cameras[k].quat)
        np.testing.assert_array_equal(short.rates[k], long.rates[k])
    first, again = (next(iter(runner.frames())) for runner in (short, long))
    np.testing.assert_array_equal(first.frame.image, again.frame.image)


def test_power_spectrum_of_a_sequence():
    """Welch's spectrum of the frames' angles against the density times sinc²(f T), folded at the Nyquist frequency.

    40 realisations of 3 axes and 4 half-overlapping segments, some 3 of them independent, on random lines: the
    relative error of a bin is 1/√360 = 5.3 %, and as much again from the lines; 4.5 of both together is 34 %. Over all
    bins inside, some 90, the mean is good to 0.8 %, and the window's smoothing of the curved density to 0.5 %; 3 of
    both are 3 %.
    """
    section = Jitter(rms_arcsec=(2.0, 2.0, 2.0), psd="lorentz", corner_hz=1.0)
    spectrum, step_s, exposure_s, n = load_spectrum(section), 0.05, 0.04, 320
    powers = []
    for seed in range(40):
        path = draw_jitter(section, spectrum, stream(seed, "jitter", 0), over_sequence=True)
        angles = sequence_of_means(path, step_s * np.arange(n), exposure_s)
        np.testing.assert_allclose(path.shifted(7 * step_s).mean(exposure_s), angles[7], atol=1e-9 * ARCSEC)
        f, power = welch(angles / ARCSEC, 1.0 / step_s, nperseg=128, axis=0, detrend=False)
        powers.append(power.mean(axis=1))
    inside = (f > 0.4) & (f < 7.4)  # the band ends at 8 Hz, below the Nyquist frequency of 10
    expected = 4.0 * spectrum.per_hz(f[inside]) * np.sinc(f[inside] * exposure_s) ** 2
    ratio = np.mean(powers, axis=0)[inside] / expected
    np.testing.assert_allclose(ratio, 1.0, atol=0.34)
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.03)


def sequence_of_means(path, t_s, exposure_s):
    """Means over exposures (N, 3) about the times (N,), by the sum of the lines written out."""
    phase = 2.0 * np.pi * t_s[:, None, None] * path.frequency_hz
    shares = np.sinc(path.frequency_hz * exposure_s)
    return np.sum(shares * (path.cosine_rad * np.cos(phase) + path.sine_rad * np.sin(phase)), axis=1)


@pytest.mark.slow
@pytest.mark.parametrize("gyro", ["true", "false"])
def test_filter_agrees_with_a_camera_that_shakes(gyro):
    """20″ (0.3 px) of jitter: with a gyro it is measured, without one it is noise of the motion, of which `auto` knows.

    NEES of two sequences of 40 frames; that of a filter without a gyro may be cautious: its model of the jitter is a
    wandering rate.
    """
    sequences = []
    for seed in (1, 2):
        overrides = "pointing.jitter.rms_arcsec=[20, 20, 20]", "sequence.frames=40", f"seed={seed}"
        overrides = [*SMALL_CAMERA, *overrides, f"sequence.gyro.use={gyro}"]
        sequences.append(run_sequence(Scenario.load("cubesat_ideal", overrides=overrides)))
        assert sequences[-1].summary["solved"] == 40
    mean, number = pooled_nees(sequences)
    deviation = 4.0 * math.sqrt(6.0 / number)
    assert mean < 3.0 + deviation
    assert mean > (3.0 - deviation if gyro == "true" else 1.0)
