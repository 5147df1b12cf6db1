"""Sections 3.4.2, 3.4.3 and 3.5.1: noise budget, signal-to-noise ratio, dynamic range, bits, memory.

The thesis adds its noise terms as they stand. Here each term comes from its equation and from frames of the product's
detector on which it alone is switched on, and the total from a frame with all of them.
"""

from __future__ import annotations

import functools
import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from simulator.detector import build_fixed_pattern, detect
from simulator.detector.parameters import DetectorParameters
from simulator.detector.readout import reset_noise_e
from simulator.randomness import stream
from simulator.study.style import BLUE, GREEN, ORANGE, VERMILION
from simulator.theses.greyling1995.starlight import SATURATION_MV, VOLT_PER_E
from simulator.theses.printed import Section, new_figure
from simulator.theses.tables import Values, table_rows

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FloatArray = NDArray[np.float64]

SIGNAL_E, DARK_E, DSNU_E, READOUT_F, ROOM_C = 1e6, 100.0, 100.0, 0.08e-12, 25.0
"""Conditions of the budget: signal, dark signal, its non-uniformity, electrons; readout capacitance; temperature."""

PRINTED_NOISE_E, PRINTED_NOISE_MV = 1310.0, 1.5
FAINTEST_V, BRIGHTEST_V, LEAST_DN = 6.5, -1.47, 5

_SIDE, _SEED = 256, 1995
_DSNU_FRAMES = 16


def section() -> Section:
    """Noise budget and what the converter has to span."""
    figures = {"noise_budget": budget_figure, "dynamic_range": bits_figure}
    rows = table_rows("greyling1995/noise", _noise_values() | _converter_values())
    return Section("Chapter 3.4 and 3.5: noise, dynamic range and converter", rows, figures)


def equation_terms_e() -> dict[str, float]:
    """The four terms of (3.13) by their equations, electrons."""
    return {
        "photon noise": math.sqrt(SIGNAL_E),
        "dark signal": DARK_E,
        "DSNU": DSNU_E,
        "reset noise": reset_noise_e(READOUT_F, ROOM_C),
    }


@functools.cache
def measured_terms_e(signal_e: float = SIGNAL_E) -> dict[str, float]:
    """The same measured on frames of the product's detector, each alone, and ``together``, electrons.

    Photon and reset noise are the standard deviation of the difference of two frames over √2; the dark signal is a
    mean; the DSNU is the spread of the mean of 16 dark frames, less the shot noise left in it. Together: the standard
    deviation over the pixels of one frame.

    Parameters
    ----------
    signal_e : float
        Electrons of the light in every pixel.
    """
    photon = _frames_e(signal_e, 2)
    dark = _frames_e(0.0, 2, dark_current_e_s=DARK_E)
    uneven = _frames_e(0.0, _DSNU_FRAMES, dark_current_e_s=DARK_E, dsnu=DSNU_E / DARK_E).mean(axis=0)
    reset = _frames_e(0.0, 2, reset_capacitance_ff=READOUT_F * 1e15)
    everything = _frames_e(
        signal_e, 1, dark_current_e_s=DARK_E, dsnu=DSNU_E / DARK_E, reset_capacitance_ff=READOUT_F * 1e15
    )
    return {
        "photon noise": float(np.diff(photon, axis=0).std() / math.sqrt(2.0)),
        "dark signal": float(dark.mean()),
        "DSNU": math.sqrt(float(uneven.var()) - DARK_E / _DSNU_FRAMES),
        "reset noise": float(np.diff(reset, axis=0).std() / math.sqrt(2.0)),
        "together": float(everything.std()),
    }


def _frames_e(mean_e: float, count: int, **keys: Any) -> FloatArray:
    """Frames (count, H, W) of an even light, electrons, unquantised."""
    section = _detector(full_well_e=1e7, gain_e_per_dn=1.0, adc_bits=None, **keys)
    pattern = build_fixed_pattern(section, _SEED)
    light = np.full((_SIDE, _SIDE), mean_e)
    frames = [
        detect(light, section, pattern, functools.partial(_stream, k), exposure_s=1.0).image for k in range(count)
    ]
    return np.asarray(frames, dtype=float)


def _stream(frame: int, name: str) -> np.random.Generator:
    return stream(_SEED, name, frame)


def _detector(**keys: Any) -> DetectorParameters:
    return DetectorParameters(width=_SIDE, height=_SIDE, pitch_um=(16.0, 16.0), temperature_c=ROOM_C, **keys)


def brightness_ratio(faint_v: float = FAINTEST_V, bright_v: float = BRIGHTEST_V) -> float:
    """Light of the brightest star over that of the faintest, (⁵√100)^(m₂ − m₁)."""
    return float(100.0 ** ((faint_v - bright_v) / 5.0))


def faint_star_dn(bits: int) -> int:
    """What the product's converter makes of the V = 6.5 star when the V = −1.47 star just fills it."""
    full_well = 150_000.0
    section = _detector(full_well_e=full_well, gain_e_per_dn="auto", adc_bits=bits, shot_noise=False)
    light = np.full((_SIDE, _SIDE), full_well / brightness_ratio())
    pattern = build_fixed_pattern(section, _SEED)
    return int(detect(light, section, pattern, functools.partial(_stream, 0), exposure_s=1.0).image[0, 0])


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
    ratio = brightness_ratio()
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
        "frame_bits": 192 * 165 * 8,
        "frame_kbits": 192 * 165 * 8 / 1024,
        "frame_kbytes": 192 * 165 / 1024,
    }


def budget_figure() -> Figure:
    """The terms of the noise budget: printed sum, equations, simulated frames; and their total in squares."""
    equation, measured = equation_terms_e(), measured_terms_e()
    names = list(equation)
    figure, ax = new_figure(size=(7.2, 3.8))
    place = np.arange(len(names) + 1)
    quadrature = math.sqrt(sum(equation[name] ** 2 for name in ("photon noise", "DSNU", "reset noise")) + DARK_E)
    series = (
        ("printed", [1000, 100, 100, 110, PRINTED_NOISE_E], BLUE, ""),
        ("by the equations, in squares", [*equation.values(), quadrature], ORANGE, "//"),
        ("simulated frames", [*(measured[name] for name in names), measured["together"]], GREEN, ".."),
    )
    for k, (label, values, colour, hatch) in enumerate(series):
        bars = ax.bar(place + 0.27 * (k - 1), values, 0.25, color=colour, hatch=hatch, edgecolor="white", label=label)
        ax.bar_label(bars, fmt="%.0f", fontsize=7, padding=1)
    ax.set(yscale="log", ylim=(50, 3000))
    ax.set_xticks(place, [*names, "total"])
    ax.set_ylabel("noise [electrons]")
    ax.legend(loc="upper center", ncols=3)
    return figure


def bits_figure() -> Figure:
    """Counts of the faintest star against the bits of the converter, the brightest just filling it."""
    bits = np.arange(6, 17)
    figure, ax = new_figure(size=(6.4, 3.8))
    ax.semilogy(bits, [2.0**b / brightness_ratio() for b in bits], "-", color=BLUE, label="2^B / 1541.7")
    counts = np.array([faint_star_dn(int(b)) for b in bits])
    seen = counts > 0
    ax.semilogy(bits[seen], counts[seen], "o", color=GREEN, label="simulated converter")
    ax.axhline(LEAST_DN, color=ORANGE, linestyle="--", label="5 counts, as the thesis asks for")
    ax.axvline(13, color=VERMILION, linestyle=":", label="13 bits")
    ax.set(xlabel="bits of the converter", ylabel="counts of the V = 6.5 star")
    ax.legend(loc="upper left")
    return figure
