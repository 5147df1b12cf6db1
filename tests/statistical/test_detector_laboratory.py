"""Chain → photon-transfer laboratory → the parameters that went in, within k standard errors.

The laboratory states its own standard errors; a right chain and a right laboratory differ by less than 4 of them but
once in 16,000. That the errors are themselves right is tested on many devices: χ² of the pulls.
"""

import numpy as np
import pytest
from scipy import stats

from simulator.detector import photon_transfer as lab
from simulator.randomness import stream
from simulator.scenario.schema import DetectorSection
from tests.detectors import build_fixed_pattern, detect

GAIN, READ, PRNU, DSNU, FULL, DARK, DOUBLING = 3.3, 13.0, 0.01, 0.3, 13_500.0, 2000.0, 7.0
LEVELS = (200.0, 500.0, 1000.0, 2000.0, 4000.0, 7000.0, 10_000.0)


def device(side=256, **keys):
    base = {
        "width": side,
        "height": side,
        "pixel_pitch_um": 5.5,
        "exposure_s": 0.2,
        "temperature_c": 25.0,
        "full_well_e": FULL,
        "read_noise_e": READ,
        "gain_e_per_dn": GAIN,
        "offset_dn": 100.0,
        "prnu": PRNU,
        "adc_bits": 14,
    }
    return DetectorSection(**(base | keys))


def pair(section, level, name, seed=5):
    pattern = build_fixed_pattern(section, seed)
    light = np.full((section.height, section.width), float(level))
    images = [detect(light, section, pattern, lambda s, k=k: stream(seed, f"{name} {s}", k)).image for k in range(2)]
    return images[0], images[1]


def within(measured, truth, k=4.0):
    assert abs(measured.value - truth) < k * measured.error, (measured, truth)


@pytest.fixture(scope="module")
def bias():
    return pair(device(exposure_s=1e-9), 0.0, "bias")


@pytest.fixture(scope="module")
def curve(bias):
    flats = [pair(device(), level, f"flat {level}") for level in (*LEVELS, 30_000.0)]
    return lab.photon_transfer(flats, bias)


def test_gain_and_read_noise(curve):
    within(curve.gain_e_per_dn, GAIN)
    within(curve.read_noise_e, READ)
    assert curve.gain_e_per_dn.error < 0.01 * GAIN
    assert curve.read_noise_e.error < 0.01 * READ
    assert curve.used.tolist() == [True] * 7 + [False]  # the saturated level is found out


def test_prnu(bias):
    measured = lab.response_nonuniformity(pair(device(), 10_000.0, "flat"), bias)
    within(measured, PRNU)
    assert measured.error < 0.02 * PRNU


def test_dsnu():
    section = {"dark_current_e_s": DARK, "dsnu": DSNU}
    dark = pair(device(exposure_s=1.0, **section), 0.0, "dark")
    measured = lab.dark_nonuniformity(dark, pair(device(exposure_s=1e-9, **section), 0.0, "bias"))
    within(measured, DSNU)
    assert measured.error < 0.02 * DSNU


def test_full_well(bias, curve):
    measured = lab.full_well(pair(device(), 60_000.0, "full"), bias, curve.gain_e_per_dn)
    within(measured, FULL)
    assert measured.error < 0.01 * FULL


def test_dark_current_doubling(bias):
    temperatures = (0.0, 10.0, 20.0, 30.0, 40.0)
    darks = [
        pair(device(dark_current_e_s=DARK, dark_doubling_c=DOUBLING, temperature_c=t), 0.0, f"dark {t}")
        for t in temperatures
    ]
    measured = lab.dark_doubling_c(darks, temperatures, bias)
    within(measured, DOUBLING)
    assert measured.error < 0.01 * DOUBLING


def test_standard_errors_are_right():
    """Over 60 devices the pulls (measured − true)/error have the variance 1: χ² with 60 degrees, two-sided 1e-4."""
    pulls = {"gain": [], "read": [], "prnu": []}
    for seed in range(60):
        small = device(48)
        bias = pair(device(48, exposure_s=1e-9), 0.0, "bias", seed)
        flats = [pair(small, level, f"flat {level}", seed) for level in (500.0, 2000.0, 8000.0)]
        curve = lab.photon_transfer(flats, bias)
        prnu = lab.response_nonuniformity(flats[-1], bias)
        pulls["gain"].append((curve.gain_e_per_dn.value - GAIN) / curve.gain_e_per_dn.error)
        pulls["read"].append((curve.read_noise_e.value - READ) / curve.read_noise_e.error)
        pulls["prnu"].append((prnu.value - PRNU) / prnu.error)
    low, high = stats.chi2.ppf([0.5e-4, 1 - 0.5e-4], 60)
    for name, values in pulls.items():
        assert low < np.sum(np.square(values)) < high, name


def test_rounding_is_no_read_noise():
    """At 20 e⁻/DN the rounding adds 1/12 to a variance of 0.42 DN²: without taking it out, 9 % more read noise."""
    coarse = {"gain_e_per_dn": 20.0}
    bias = pair(device(exposure_s=1e-9, **coarse), 0.0, "bias")
    curve = lab.photon_transfer([pair(device(**coarse), level, f"flat {level}") for level in LEVELS], bias)
    within(curve.read_noise_e, READ)
    within(curve.gain_e_per_dn, 20.0)
    assert curve.read_noise_e.error < 0.02 * READ
