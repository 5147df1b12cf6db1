"""Photon transfer: flats and darks analysed as a laboratory does (EMVA 1288; Janesick 2007) give the detector back.

Only the frames' numbers are read here, never the truth beside them. Seeds are fixed; every tolerance is 4σ of the
estimate, σ derived at its place. N is the number of pixels.
"""

import numpy as np
import pytest

from simulator.randomness import stream
from simulator.scenario.schema import DetectorSection
from tests.detectors import build_fixed_pattern, detect

SIDE = 256
N = SIDE * SIDE
GAIN, OFFSET, READ, FULL_WELL = 4.0, 200.0, 9.0, 12_000.0
# Relative σ of a variance estimated from N normal numbers: √(2/N); of a standard deviation: half that.
REL_VARIANCE = np.sqrt(2 / N)


def camera(**keys):
    base = {
        "width": SIDE,
        "height": SIDE,
        "pixel_pitch_um": 5.5,
        "exposure_s": 1.0,
        "gain_e_per_dn": GAIN,
        "offset_dn": OFFSET,
        "read_noise_e": READ,
        "full_well_e": FULL_WELL,
        "temperature_c": 25.0,
    }
    return DetectorSection(**(base | keys))


def expose(section, mean_e, count, first=0):
    pattern = build_fixed_pattern(section, 42)
    light = np.full((SIDE, SIDE), float(mean_e))
    return np.array(
        [
            detect(light, section, pattern, lambda name, k=k: stream(42, name, k)).image
            for k in range(first, first + count)
        ],
        dtype=np.float64,
    )


def temporal_variance(pair):
    """Variance of one frame from the difference of two, in which the fixed pattern drops out."""
    return np.var(pair[1] - pair[0]) / 2


def test_read_noise_and_offset():
    bias = expose(camera(), 0.0, 2)
    variance = temporal_variance(bias) - 1 / 12  # the converter's rounding, 2.25 DN of noise making it uniform
    assert np.sqrt(variance) * GAIN == pytest.approx(READ, rel=4 * REL_VARIANCE / 2 * 1.02)  # 1.02: the 1/12 added
    assert bias.mean() == pytest.approx(OFFSET, abs=4 * READ / GAIN / np.sqrt(2 * N))


def test_gain_from_the_slope_of_variance_against_mean():
    section = camera(prnu=0.01, dark_current_e_s=50.0, dsnu=0.3)
    dark = expose(section, 0.0, 2)
    estimates, sigmas = [], []
    for level in (500, 1000, 2000, 4000, 8000):
        flat = expose(section, level, 2, first=2 * level)
        shot = temporal_variance(flat) - temporal_variance(dark)
        estimates.append((flat.mean() - dark.mean()) / shot)
        # The variances of flat and dark carry √(2/N) each of themselves.
        sigmas.append(GAIN * REL_VARIANCE * np.hypot(temporal_variance(flat), temporal_variance(dark)) / shot)
    weights = 1 / np.square(sigmas)
    gain = np.sum(weights * estimates) / weights.sum()
    assert gain == pytest.approx(GAIN, abs=4 / np.sqrt(weights.sum()))
    # Linear: no level stands apart.
    assert np.all(np.abs(np.array(estimates) - GAIN) < 4 * np.array(sigmas))


def test_reset_noise_adds_to_the_read_noise():
    # √(kTC)/q of 20 fF at 25 °C is 56.6 electrons.
    bias = expose(camera(reset_capacitance_ff=20.0), 0.0, 2)
    noise_e = np.sqrt(temporal_variance(bias) - 1 / 12) * GAIN
    assert noise_e == pytest.approx(np.hypot(READ, 400.45 * np.sqrt(0.020)), rel=4 * REL_VARIANCE / 2)


@pytest.mark.parametrize("prnu", [0.01, 0.05])
def test_prnu(prnu):
    section = camera(prnu=prnu)
    count, level = 16, 6000.0
    flats = expose(section, level, count)
    mean = flats.mean(axis=0) - OFFSET
    noise = flats.var(axis=0, ddof=1).mean() / count  # what 16 frames leave of the temporal noise
    measured = np.sqrt(mean.var() - noise) / mean.mean()
    # Spatial variance: √(2/N) of pattern and noise together; the noise itself is known √16 better, which is left out.
    share = mean.var() / (mean.var() - noise)
    assert measured == pytest.approx(prnu, rel=4 * REL_VARIANCE / 2 * share * 1.05)
    # It multiplies: half the light shows the same relative pattern, pixel by pixel.
    half = expose(section, level / 2, count, first=1000).mean(axis=0) - OFFSET
    covariance = np.mean((mean / mean.mean() - 1) * (half / half.mean() - 1))
    # σ of a covariance of N pairs: √((σ₁²σ₂² + c²)/N).
    spread = np.sqrt((np.var(mean / mean.mean()) * np.var(half / half.mean()) + prnu**4) / N)
    assert covariance == pytest.approx(prnu**2, abs=4 * spread)


def test_dark_current_and_dsnu():
    current, dsnu, count = 400.0, 0.25, 16
    darks = expose(camera(dark_current_e_s=current, dsnu=dsnu), 0.0, count)
    mean = (darks.mean(axis=0) - OFFSET) * GAIN
    # Pattern 100 e⁻, noise √(400 + 81)/4 = 5.5 e⁻ a pixel, over √N pixels.
    assert mean.mean() == pytest.approx(current, abs=4 * np.hypot(current * dsnu, 5.5) / np.sqrt(N))
    noise = darks.var(axis=0, ddof=1).mean() * GAIN**2 / count
    # Log-normal with w = 1 + σ²: kurtosis κ = w⁴ + 2w³ + 3w² − 3; σ of a variance is √((κ − 1)/N) of it.
    w = 1 + dsnu**2
    relative = np.sqrt((w**4 + 2 * w**3 + 3 * w**2 - 4) / N)
    assert np.sqrt(mean.var() - noise) / current == pytest.approx(dsnu, rel=4 * relative / 2 * 1.01)
    # Skewness of a log-normal: (w + 2)√(w − 1) = 0.77; 4σ ≈ 4 √(6/N) × 3 for its heavier tail.
    skewness = np.mean((mean - mean.mean()) ** 3) / mean.std() ** 3
    assert skewness == pytest.approx((w + 2) * np.sqrt(w - 1), abs=12 * np.sqrt(6 / N))


def test_dark_current_doubles():
    doubling, current = 6.5, 200.0
    temperatures = np.array([5.0, 12.0, 19.0, 26.0, 33.0])
    signal, sigma = [], []
    for temperature in temperatures:
        dark = expose(camera(dark_current_e_s=current, dark_doubling_c=doubling, temperature_c=temperature), 0.0, 2)
        signal.append((dark.mean() - OFFSET) * GAIN)
        sigma.append(np.sqrt((signal[-1] + READ**2 + GAIN**2 / 12) / (2 * N)))
    # Weighted straight line of log2(signal) against temperature: slope 1/doubling.
    weight = (np.array(signal) / np.array(sigma) * np.log(2)) ** 2
    centred = temperatures - np.average(temperatures, weights=weight)
    slope = np.sum(weight * centred * np.log2(signal)) / np.sum(weight * centred**2)
    assert slope == pytest.approx(1 / doubling, abs=4 / np.sqrt(np.sum(weight * centred**2)))


def test_full_well_from_the_top_of_the_ramp():
    # Half the top is far below, twice far above: mean at the full well, and no shot noise left, only the readout's.
    flats = expose(camera(), 2 * FULL_WELL, 2)
    top_e = (flats.mean() - OFFSET) * GAIN
    assert top_e == pytest.approx(FULL_WELL, abs=4 * READ / np.sqrt(2 * N))
    variance = temporal_variance(flats) - 1 / 12
    assert np.sqrt(variance) * GAIN == pytest.approx(READ, rel=4 * REL_VARIANCE / 2 * 1.02)


def test_hot_pixels():
    fraction, hot = 0.02, 3000.0
    section = camera(
        dark_current_e_s=10.0, hot_pixel_fraction=fraction, hot_pixel_dark_e_s=hot, full_well_e=1e6, adc_bits=16
    )
    dark = (expose(section, 0.0, 16).mean(axis=0) - OFFSET) * GAIN
    # An exponential current exceeds t by e^{−t/hot}; the noise of 16 frames at t = 100 e⁻ is 3.5 e⁻, 26σ below t.
    limit = 100.0
    expected = N * fraction * np.exp(-(limit - 10.0) / hot)
    found = dark[dark > limit]
    # Counts are binomial: σ ≈ √expected. The excess over any limit is exponential again: σ of its mean hot/√n.
    assert found.size == pytest.approx(expected, abs=4 * np.sqrt(expected))
    assert found.mean() - limit == pytest.approx(hot, abs=4 * hot / np.sqrt(expected))
    rows, columns = np.nonzero(dark > limit)
    # Anywhere: the mean of uniform places has σ = SIDE/√12/√n.
    for places in (rows, columns):
        assert places.mean() == pytest.approx((SIDE - 1) / 2, abs=4 * SIDE / np.sqrt(12 * expected))


def test_quantisation_has_a_variance_of_one_twelfth():
    rng = stream(42, "ramp")
    ideal_dn = rng.uniform(10.0, 3000.0, (SIDE, SIDE))
    section = camera(shot_noise=False, read_noise_e=0.0)
    pattern = build_fixed_pattern(section, 42)
    image = detect((ideal_dn - OFFSET).clip(0) * GAIN, section, pattern, lambda name: stream(42, name)).image
    seen = ideal_dn > OFFSET + 1
    error = (image - ideal_dn)[seen]
    # Uniform on ±½: variance 1/12, fourth moment 1/80, so σ of the variance √((1/80 − 1/144)/n); of the mean √(1/12/n).
    assert error.var() == pytest.approx(1 / 12, abs=4 * np.sqrt((1 / 80 - 1 / 144) / error.size))
    assert error.mean() == pytest.approx(0.0, abs=4 * np.sqrt(1 / 12 / error.size))
    assert np.abs(error).max() <= 0.5


@pytest.mark.parametrize("level", [0.1, 20.0, 5000.0])
def test_signal_and_dark_current_are_one_poisson_number(level):
    """Light and dark current are drawn together: mean and variance are those of their sum, at any level."""
    section = camera(dark_current_e_s=level / 2, read_noise_e=0.0, adc_bits=None, gain_e_per_dn=1.0, offset_dn=0.0)
    frames = expose(section, level, 4)
    total, n = 1.5 * level, 4 * N
    assert frames.mean() == pytest.approx(total, abs=4 * np.sqrt(total / n))
    assert frames.var() == pytest.approx(total, abs=4 * np.sqrt((total + 2 * total**2) / n))


def test_patterns_of_light_and_dark_are_uncorrelated():
    pattern = build_fixed_pattern(camera(prnu=0.01, dark_current_e_s=100.0, dsnu=0.2), 42)
    assert abs(np.corrcoef(pattern.prnu.ravel(), pattern.dark_e_s.ravel())[0, 1]) < 4 / np.sqrt(N)


def test_frames_of_different_trials_are_uncorrelated():
    frames = expose(camera(), 1000.0, 3)
    for a, b in [(0, 1), (0, 2), (1, 2)]:
        assert abs(np.corrcoef(frames[a].ravel(), frames[b].ravel())[0, 1]) < 4 / np.sqrt(N)


def test_noises_of_one_trial_are_uncorrelated():
    """Shot, reset and read noise of a trial share a seed and a trial index, yet no numbers."""
    plain = {"adc_bits": None, "gain_e_per_dn": 1.0, "offset_dn": 0.0}
    off = {"read_noise_e": 0.0, "shot_noise": False}
    shot = expose(camera(**(plain | off | {"shot_noise": True})), 1000.0, 1)
    read = expose(camera(**(plain | off | {"read_noise_e": READ})), 1000.0, 1)
    reset = expose(camera(**(plain | off | {"reset_capacitance_ff": 20.0})), 1000.0, 1)
    correlation = np.corrcoef([shot.ravel(), read.ravel(), reset.ravel()])
    assert np.abs(correlation - np.eye(3)).max() < 4 / np.sqrt(N)
