"""Sections 3.4.2, 3.4.3 and 3.5.1: noise budget, signal-to-noise ratio, dynamic range, bits, memory.

The thesis adds its noise terms linearly. Here each term is computed from its equation and measured on frames of the
product's detector with only this term switched on, and the total on a frame with all of them.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np

from simulator.detector import build_fixed_pattern, detect
from simulator.detector.parameters import DetectorParameters
from simulator.detector.readout import reset_noise_e
from simulator.randomness import stream
from simulator.theses.figures import section_of
from simulator.theses.greyling1995.starlight import SATURATION_MV, VOLT_PER_E
from simulator.theses.printed import Section
from simulator.theses.tables import Values
from startracker.core import FloatArray

SIGNAL_E, DARK_E, DSNU_E, READOUT_F, ROOM_C = 1e6, 100.0, 100.0, 0.08e-12, 25.0
"""Conditions of the budget: signal, dark signal, its non-uniformity, electrons; readout capacitance; temperature."""

PRINTED_NOISE_E, PRINTED_NOISE_MV = 1310.0, 1.5
FAINTEST_V, BRIGHTEST_V, LEAST_DN = 6.5, -1.47, 5

BRIGHTNESS_RATIO = 100.0 ** ((FAINTEST_V - BRIGHTEST_V) / 5.0)
"""Ratio of the light of the brightest star to that of the faintest, (⁵√100)^(m₂ − m₁)."""

_SIDE, _SEED = 256, 1995
_DSNU_FRAMES = 16


def section() -> Section:
    """Noise budget and required range of the converter."""
    values = _noise_values() | _converter_values() | _budget()
    return section_of("greyling1995/noise", "Chapter 3.4 and 3.5: noise, dynamic range and converter", values)


def equation_terms_e() -> dict[str, float]:
    """The four terms of (3.13) from their equations, electrons."""
    return {
        "photon noise": math.sqrt(SIGNAL_E),
        "dark signal": DARK_E,
        "DSNU": DSNU_E,
        "reset noise": reset_noise_e(READOUT_F, ROOM_C),
    }


@functools.cache
def measured_terms_e(signal_e: float = SIGNAL_E) -> dict[str, float]:
    """The same terms measured on frames of the product's detector, each separately, and ``together``, electrons.

    Photon and reset noise are the standard deviation of the difference of two frames over √2; the dark signal is a
    mean; the DSNU is the spread of the mean of 16 dark frames, minus the remaining shot noise. Together: the standard
    deviation over the pixels of one frame with `signal_e` electrons of light in every pixel.
    """
    dark, uneven = {"dark_current_e_s": DARK_E}, {"dark_current_e_s": DARK_E, "dsnu": DSNU_E / DARK_E}
    reset = {"reset_capacitance_ff": READOUT_F * 1e15}
    mean_dark = _frames_e(0.0, _DSNU_FRAMES, **uneven).mean(axis=0)
    return {
        "photon noise": float(np.diff(_frames_e(signal_e, 2), axis=0).std() / math.sqrt(2.0)),
        "dark signal": float(_frames_e(0.0, 2, **dark).mean()),
        "DSNU": math.sqrt(float(mean_dark.var()) - DARK_E / _DSNU_FRAMES),
        "reset noise": float(np.diff(_frames_e(0.0, 2, **reset), axis=0).std() / math.sqrt(2.0)),
        "together": float(_frames_e(signal_e, 1, **uneven, **reset).std()),
    }


def _frames_e(mean_e: float, count: int, **keys: Any) -> FloatArray:
    """Frames (count, H, W) of uniform light, electrons, by default without quantisation."""
    keys = {"full_well_e": 1e7, "gain_e_per_dn": 1.0, "adc_bits": None} | keys
    section = DetectorParameters(width=_SIDE, height=_SIDE, pitch_um=(16.0, 16.0), temperature_c=ROOM_C, **keys)
    pattern = build_fixed_pattern(section, _SEED)
    light = np.full((_SIDE, _SIDE), mean_e)
    frames = [
        detect(light, section, pattern, functools.partial(stream, _SEED, trial=k), exposure_s=1.0).image
        for k in range(count)
    ]
    return np.asarray(frames, dtype=float)


def faint_star_dn(bits: int) -> int:
    """Value of the product's converter for a star of V = 6.5 if a star of V = −1.47 just reaches its maximum."""
    full_well = 150_000.0
    converter = {"full_well_e": full_well, "gain_e_per_dn": "auto", "adc_bits": bits, "shot_noise": False}
    return int(_frames_e(full_well / BRIGHTNESS_RATIO, 1, **converter)[0, 0, 0])


def _noise_values() -> Values:
    terms, measured = equation_terms_e(), measured_terms_e()
    noise_mv, together_mv = (e * VOLT_PER_E * 1e3 for e in (PRINTED_NOISE_E, measured["together"]))
    return {
        "terms": terms,
        "measured": measured,
        "reset_at_1_pf_e": reset_noise_e(1e-12, ROOM_C),
        "total": sum(terms.values()),
        "noise_mv": noise_mv,
        "together_mv": together_mv,
        "printed_db": 20.0 * math.log10(SATURATION_MV / PRINTED_NOISE_MV),
        "unrounded_db": 20.0 * math.log10(SATURATION_MV / noise_mv),
        "together_db": 20.0 * math.log10(SATURATION_MV / together_mv),
        "electrons_full": SATURATION_MV * 1e-3 / VOLT_PER_E,
    }


def _converter_values() -> Values:
    """Converter value of the faintest star if the brightest just reaches the maximum, by number of bits."""
    ratio, bits = BRIGHTNESS_RATIO, np.arange(6, 17)
    counts = np.array([faint_star_dn(int(b)) for b in bits])
    least = next(b for b in range(1, 33) if faint_star_dn(b) >= LEAST_DN)
    return {
        "ratio": ratio,
        "ratio_db": 20.0 * math.log10(ratio),
        "counts": LEAST_DN * ratio,
        "bits": math.log2(LEAST_DN * ratio),
        "least": least,
        "reads": faint_star_dn(least),
        "one_less": least - 1,
        "reads_below": faint_star_dn(least - 1),
        "shown_bits": bits,
        "line": [2.0**b / ratio for b in bits],
        "seen": (bits[counts > 0], counts[counts > 0]),
        "asked_dn": LEAST_DN,
        "frame_bits": 192 * 165 * 8,
        "frame_kbits": 192 * 165 * 8 / 1024,
        "frame_kbytes": 192 * 165 / 1024,
    }


def _budget() -> Values:
    """The terms of the noise budget: printed sum, equations, simulated frames; and their quadratic sum."""
    equation, measured = equation_terms_e(), measured_terms_e()
    names = list(equation)
    at = np.arange(len(names) + 1)
    quadrature = math.sqrt(sum(equation[name] ** 2 for name in ("photon noise", "DSNU", "reset noise")) + DARK_E)
    series = (
        ("printed", [1000, 100, 100, 110, PRINTED_NOISE_E]),
        ("equations, quadratic sum", [*equation.values(), quadrature]),
        ("simulated frames", [*(measured[name] for name in names), measured["together"]]),
    )
    bars = [{"at": at + 0.27 * (k - 1), "name": name, "electrons": e} for k, (name, e) in enumerate(series)]
    return {"bars": bars, "ticks": at, "names": [*names, "total"]}
