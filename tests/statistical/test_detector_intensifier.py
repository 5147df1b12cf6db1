"""Image intensifier and video noise against theory: means, variances, excess noise, correlation.

A sample variance of n values of a nearly normal quantity has the relative standard deviation √(2/n); a mean the
standard deviation σ/√n. Tolerances are four of these.
"""

import numpy as np
import pytest

from simulator.build import detector_parameters
from simulator.detector.excess_noise import bunch_e, excess_noise_factor
from simulator.detector.intensifier import multiply
from simulator.detector.parameters import Intensifier, Video
from simulator.detector.video import video_signal
from simulator.randomness import stream
from simulator.scenario.schema import DetectorSection
from simulator.study.trials.bounds import pixel_variance_e2
from tests.detectors import build_fixed_pattern, detect

SIDE = 240


def detector(intensifier=None, **keys):
    plain = {
        "width": SIDE, "height": SIDE, "pixel_pitch_um": 10, "exposure_s": 0.1, "full_well_e": 1e12, "adc_bits": None,
        "gain_e_per_dn": 1.0,
    }  # fmt: skip
    return DetectorSection(**(plain | keys), intensifier=Intensifier(**(intensifier or {})))


def frame(section, mean_e, seed=1):
    mean = np.full((SIDE, SIDE), float(mean_e))
    return detect(mean, section, build_fixed_pattern(section, 1), lambda name: stream(seed, name, 0)).image


def blocks(image, size):
    """Sums over blocks of size × size pixels, the outermost ones left out."""
    count = SIDE // size
    return image.reshape(count, size, count, size).sum(axis=(1, 3))[1:-1, 1:-1].ravel()


@pytest.mark.parametrize("variance", [0.0, 0.5, 1.0])
def test_gain_of_one_electron_has_the_stated_moments(variance):
    n = 200_000
    section = Intensifier(gain=300.0, gain_variance=variance)
    for counts in (1.0, 7.0):
        gains = multiply(np.full(n, counts), section, np.random.default_rng(3))
        sigma = 300.0 * np.sqrt(variance * counts)
        assert gains.mean() == pytest.approx(300.0 * counts, abs=4.0 * sigma / np.sqrt(n) + 1e-9)
        # kurtosis of a gamma with shape k = counts/variance: 3 + 6/k; var(s²) = σ⁴ (kurtosis − 1) / n
        spread = sigma**2 * np.sqrt((2.0 + 6.0 * variance / counts) / n)
        assert gains.var() == pytest.approx(sigma**2, abs=4.0 * spread + 1e-9)
    assert multiply(np.zeros(5), section, np.random.default_rng(3)).tolist() == [0.0] * 5


@pytest.mark.parametrize(("gain", "variance"), [(400.0, 1.0), (5.0, 0.3)])
def test_noise_is_that_of_the_excess_noise_factor(gain, variance):
    section = detector({"gain": gain, "gain_variance": variance})
    image = frame(section, 20.0)
    n = image.size
    factor = 1.0 + variance + 1.0 / gain
    assert excess_noise_factor(section) == pytest.approx(factor)
    assert image.mean() == pytest.approx(20.0 * gain, abs=4.0 * gain * np.sqrt(20.0 * factor / n))
    # relative variance of the signal is F² / n photo-electrons; its fourth moment leaves 2 to 2.4 for 2 here
    measured = image.var() / image.mean() ** 2 * 20.0
    assert measured == pytest.approx(factor, rel=4.0 * np.sqrt(2.6 / n))
    assert image.var() / image.mean() == pytest.approx(bunch_e(section), rel=0.03)


def test_phosphor_keeps_the_noise_of_areas_and_correlates_neighbours():
    sigma, gain = 2.0, 100.0
    sharp, soft = (detector({"gain": gain, "phosphor_sigma_px": s}) for s in (0.0, sigma))
    plain, spread = frame(sharp, 30.0), frame(soft, 30.0)
    assert spread.mean() == pytest.approx(plain.mean(), rel=1e-3)  # light is conserved
    # of one pixel: F² G² n Σw², Σw² = 1/(4πσ²), less the counting that stays per pixel: G n
    photons = 2.0 * gain**2 * 30.0 / (4.0 * np.pi * sigma**2) + gain * 30.0
    effective = spread.size / (4.0 * np.pi * sigma**2)  # independent values
    assert spread.var() == pytest.approx(photons, rel=4.0 * np.sqrt(2.0 / effective))
    # sums over blocks wide against σ: a share 1 − 2σ/(√π b) each way of the variance stays within a block of side b
    wide, b = blocks(spread, 40), 40
    assert len(wide) == 16
    many = np.concatenate([blocks(frame(soft, 30.0, seed), 40) for seed in range(2, 14)])
    kept = (1.0 - 2.0 * sigma / (np.sqrt(np.pi) * b)) ** 2
    expected = b * b * (2.0 * gain**2 * 30.0 * kept + gain * 30.0)
    assert many.var() == pytest.approx(expected, rel=4.0 * np.sqrt(2.0 / len(many)))
    # neighbours k apart hang together by exp(−k²/4σ²)
    deviation = spread - spread.mean()
    correlation = (deviation[:, 2:] * deviation[:, :-2]).mean() / deviation.var()
    gaussian = 2.0 * gain**2 * 30.0 / (4.0 * np.pi * sigma**2) * np.exp(-4.0 / (4.0 * sigma**2)) / photons
    assert correlation == pytest.approx(gaussian, abs=4.0 / np.sqrt(effective))


def test_dark_counts_of_the_photocathode_add_to_the_light():
    section = detector({"gain": 50.0, "dark_e_s": 40.0})
    image = frame(section, 6.0)
    assert image.mean() == pytest.approx(50.0 * 10.0, abs=4.0 * 50.0 * np.sqrt(10.0 * 2.02 / image.size))


def test_without_noise_the_mean_is_multiplied_and_spread():
    section = detector({"gain": 50.0, "dark_e_s": 40.0, "phosphor_sigma_px": 1.5}, shot_noise=False)
    np.testing.assert_allclose(frame(section, 6.0), 500.0, rtol=1e-12)


def test_an_absent_intensifier_draws_nothing_and_changes_nothing():
    asked = []
    section = detector()

    def streams(name):
        asked.append(name)
        return stream(1, name, 0)

    mean = np.full((SIDE, SIDE), 30.0)
    image = detect(mean, section, build_fixed_pattern(section, 1), streams).image
    assert asked == ["shot_noise"]
    assert image.var() / image.mean() == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / image.size))
    assert bunch_e(section) == 1.0


@pytest.mark.parametrize("blur", [0.0, 1.2])
def test_video_noise_has_its_deviation_and_correlation(blur):
    noise = video_signal(np.zeros((400, 400)), Video(noise_dn=5.0, line_blur_px=blur), np.random.default_rng(2))
    effective = noise.size / max(1.0, 2.0 * np.sqrt(np.pi) * blur)
    # towards the ends of the lines mirrored noise adds up; they are left out
    inner = noise[:, 10:-10]
    assert inner.std() == pytest.approx(5.0, rel=4.0 / np.sqrt(2.0 * effective))
    for lag in (1, 2, 4):
        expected = np.exp(-(lag**2) / (4.0 * blur**2)) if blur else 0.0
        measured = (inner[:, lag:] * inner[:, :-lag]).mean() / 25.0
        # a sampled Gaussian of 1.2 px follows the law of the continuous one to 1e-3
        assert measured == pytest.approx(expected, abs=4.0 / np.sqrt(effective) + 1e-3)
    across = (inner[1:] * inner[:-1]).mean() / 25.0
    assert across == pytest.approx(0.0, abs=4.0 / np.sqrt(effective))


def test_video_spreads_along_lines_alone_and_keeps_the_signal():
    spot = np.zeros((21, 41))
    spot[10, 20] = 100.0
    seen = video_signal(spot, Video(line_blur_px=1.5), np.random.default_rng(2))
    assert seen.sum() == pytest.approx(100.0, rel=1e-12)
    assert np.count_nonzero(seen.sum(axis=1)) == 1
    columns = np.arange(41)
    assert (seen[10] * (columns - 20) ** 2).sum() / 100.0 == pytest.approx(1.5**2, rel=1e-3)


def test_eight_bits_round_and_clip_after_the_video():
    section = detector({"gain": 10.0}, adc_bits=8, gain_e_per_dn=2.0, offset_dn=20.0, video=Video(noise_dn=3.0))
    image = frame(section, 20.0)
    assert image.dtype == np.uint16
    assert image.max() <= 255
    bright = frame(section, 60.0)
    assert (bright == 255).mean() > 0.5
    # variance: light, video and the rounding's 1/12
    expected = 20.0 * 100.0 * 2.1 / 4.0 + 9.0 + 1.0 / 12.0
    assert image.var() == pytest.approx(expected, rel=4.0 * np.sqrt(2.4 / image.size))


def test_the_bounds_take_the_same_variance():
    section = detector(
        {"gain": 80.0, "gain_variance": 0.7, "dark_e_s": 30.0},
        adc_bits=10, gain_e_per_dn=20.0, offset_dn=40.0, read_noise_e=90.0, video=Video(noise_dn=2.0),
    )  # fmt: skip
    image = frame(section, 15.0).astype(float)
    stated = (
        pixel_variance_e2(np.array([15.0]), 0.0, np.array([0.0]), detector_parameters(section), 0.1)[0]
        * (80.0 / 20.0) ** 2
    )
    assert image.var() == pytest.approx(stated, rel=4.0 * np.sqrt(2.4 / image.size))
