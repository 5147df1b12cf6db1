"""The noise figures of Greyling 1995, sections 3.4.2 and 3.4.3, found again on simulated frames.

Tolerances are those of print: 400 √(C/pF) is given to one or two digits (exact: 400.5), 110 electrons of reset noise at
0.08 pF to two (400·√0.08 = 113). The frames' own statistical error is derived beside each.
"""

import math

import numpy as np
import pytest

from simulator.constants import BOLTZMANN_J_K, ELEMENTARY_CHARGE_C
from simulator.detector.readout import reset_noise_e
from simulator.randomness import stream
from simulator.scenario.schema import DetectorSection
from tests.detectors import build_fixed_pattern, detect

SIDE = 256
PIXELS = SIDE * SIDE
# Eq. 3.7: V = q N G / C with the typical G = 0.7, C = 0.1 pF, q = 1.6e-19 C: 1.12 µV an electron.
VOLT_PER_E = 1.6e-19 * 0.7 / 0.1e-12


def device(**keys):
    """The device of the budget: one million electrons, 0.08 pF, 25 °C; a DN is a millivolt, unquantised."""
    base = {
        "width": SIDE,
        "height": SIDE,
        "pixel_pitch_um": 16.0,
        "exposure_s": 1.0,
        "temperature_c": 25.0,
        "full_well_e": 1e7,
        "gain_e_per_dn": 1e-3 / VOLT_PER_E,
        "adc_bits": None,
    }
    return DetectorSection(**(base | keys))


def frames_mv(section, mean_e, count=2):
    pattern = build_fixed_pattern(section, 1)
    light = np.full((SIDE, SIDE), float(mean_e))
    return [detect(light, section, pattern, lambda name, k=k: stream(1, name, k)).image for k in range(count)]


def test_reset_noise_formula():
    for picofarad in (0.01, 0.08, 0.1, 1.0):
        noise = reset_noise_e(picofarad * 1e-12, 25.0)
        assert noise == pytest.approx(400 * math.sqrt(picofarad), rel=2e-3)
        # eq. 3.12, squared, in other units: (q N)² / C = k T, that is thermal energy
        assert (noise * ELEMENTARY_CHARGE_C) ** 2 / (picofarad * 1e-12) == pytest.approx(
            BOLTZMANN_J_K * 298.15, rel=1e-12
        )
    assert reset_noise_e(0.08e-12, 25.0) == pytest.approx(110, abs=5)


def test_noise_budget_and_signal_to_noise_ratio():
    """1000 + 100 + 100 + 110 = 1310 electrons, nearly 1.5 mV, 49.54 dB: each term measured on frames of its own."""
    photon = np.diff(frames_mv(device(), 1e6), axis=0).std() / math.sqrt(2)
    dark = np.mean(frames_mv(device(dark_current_e_s=100.0), 0.0))
    many = np.mean(frames_mv(device(dark_current_e_s=100.0, dsnu=1.0), 0.0, count=16), axis=0)
    # The mean dark signal's own shot noise, 100 e⁻² over 16 frames, taken off.
    dsnu = math.sqrt(many.var() - 100 / 16 * (1e3 * VOLT_PER_E) ** 2)
    reset = np.diff(frames_mv(device(reset_capacitance_ff=80.0), 0.0), axis=0).std() / math.sqrt(2)

    to_e = 1e-3 / VOLT_PER_E
    terms_e = np.array([photon, dark, dsnu, reset]) * to_e
    # Relative σ of a standard deviation: 1/√(2·65536) = 0.28 %; of the dark mean: 10/100/√131072 = 0.03 %; the DSNU at
    # 100 % is log-normal with kurtosis 2⁴ + 2·2³ + 3·2² − 3 = 41: σ = √(40/65536)/2 = 1.2 %. 4σ; reset as printed.
    assert terms_e[0] == pytest.approx(1000, rel=4 * 0.0028)
    assert terms_e[1] == pytest.approx(100, rel=4 * 0.0003)
    assert terms_e[2] == pytest.approx(100, rel=4 * 0.012)
    assert terms_e[3] == pytest.approx(110, abs=5)

    total_mv = terms_e.sum() / to_e  # the thesis adds the terms linearly
    # 1310 e⁻ are 1.467 mV; ours may differ by the printed 110 (3.3 e⁻) and 4σ of the terms above (11 + 5 e⁻): 1.5 %.
    assert total_mv == pytest.approx(1.467, rel=0.015)
    assert round(total_mv, 1) == 1.5
    assert 20 * math.log10(450 / round(total_mv, 1)) == pytest.approx(49.54, abs=0.005)


def test_dynamic_range_and_bits():
    """V = −1.47 to 6.5 is 1541.7 or 63.76 dB; 13 bits show the faint star at 5 or more, 12 do not."""
    ratio = 100 ** ((6.5 + 1.47) / 5)
    light = np.full((16, 16), 150_000.0)
    light[8:] = 150_000.0 / ratio

    def read(bits):
        section = device(
            width=16, height=16, full_well_e=150_000.0, gain_e_per_dn="auto", adc_bits=bits, shot_noise=False
        )
        return detect(light, section, build_fixed_pattern(section, 1), lambda name: stream(1, name)).image

    exact = read(None)
    assert exact[0, 0] / exact[8, 0] == pytest.approx(1541.7, abs=0.05)
    assert 20 * math.log10(exact[0, 0] / exact[8, 0]) == pytest.approx(63.76, abs=0.005)
    assert read(13)[8, 0] >= 5
    assert read(12)[8, 0] < 5
    assert read(13)[0, 0] == 8191
