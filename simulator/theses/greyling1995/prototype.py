"""The prototype camera (Greyling 1995, chapter 6): sequencer, readout smear, focus, converter."""

from __future__ import annotations

import math
from functools import cache, partial

import numpy as np
from scipy.special import erf

from simulator.build import build_focal_plane
from simulator.optics.psf import build_psf
from simulator.optics.psf_model import PsfModel
from simulator.optics.shutter import frame_transfer_smear
from simulator.optics.splat import render_stars
from simulator.theses.figures import figures
from simulator.theses.greyling1995 import signals
from simulator.theses.greyling1995.converter import (
    BITS,
    SLOW_CLOCK_HZ,
    camera,
    compare_levels,
    converter_trials,
    even_levels,
    memory_image,
    scene,
    smear_share,
)
from simulator.theses.greyling1995.sequencer import (
    COLUMNS,
    COUNTS_PER_LINE,
    DUMMY_CELLS,
    LINES,
    SERIAL_CLOCK_HZ,
    STATE_TABLE,
    Sequencer,
    equation_faults,
    expose,
    next_state,
    run,
)
from simulator.theses.printed import Section
from simulator.theses.tables import Values, table_rows

DARK_ELEMENTS = 12
"""Dark-reference elements at the end of each line (section 6.1)."""
IAG_HZ = 15.7e3
"""Maximum rate of the image area gate according to the data book (section 6.2.2)."""
DEFOCUS_UM = 40.0
POSITION_PX = 0.1
"""Accuracy of the positions required in section 7.2: L/10."""
_CLOCKS_HZ = np.geomspace(5e4, 3.26e6, 25)
_FIG_DEFOCUS_UM = 120.0


def section() -> Section:
    """Chapter 6 compared with the models of the product."""
    circuit = signals.values()
    values = _device_values() | _state_values() | _clock_values() | _smear_values() | _converter_values()
    values |= {
        "modes": _modes,
        "focus": partial(_images, (SERIAL_CLOCK_HZ, _FIG_DEFOCUS_UM), (SERIAL_CLOCK_HZ, 0.0)),
        "slow": partial(_images, (SLOW_CLOCK_HZ, 0.0)),
        "fast": partial(_images, (SERIAL_CLOCK_HZ, 0.0)),
        "smear": _smear,
        "conversion": _converters,
    }
    drawn = figures("greyling1995/prototype", values | circuit)
    rows = table_rows("greyling1995/prototype", values) + table_rows("greyling1995/signals", circuit)
    return Section("Chapter 6: the prototype camera with the TC211", rows, drawn)


# ---------------------------------------------------------------------- sections 6.1 and 6.2
def _device_values() -> Values:
    pitch_x, pitch_y = camera().detector.pitch_um
    width, height = COLUMNS * pitch_x, LINES * pitch_y
    cells = DUMMY_CELLS + COLUMNS + DARK_ELEMENTS
    counts = {"counts_per_line": COUNTS_PER_LINE, "cells": cells, "unread": cells - COUNTS_PER_LINE}
    diffraction, disc = defocus_radii_um()
    return counts | {
        "width": width,
        "height": height,
        "square": width == height,
        "dummy": DUMMY_CELLS,
        "columns": COLUMNS,
        "diffraction": diffraction,
        "disc": disc,
    }


def _state_values() -> Values:
    printed, mended = equation_faults(as_printed=True), equation_faults()
    names = {name for _, name in printed}
    wrong = [row for row, name in printed if name == "Q2"]
    return {
        "table_rows": len(STATE_TABLE),
        "right_outputs": [{"name": name} for name in ("Q1", "Q3", "A_set", "B_set") if name not in names],
        "right_printed": len(STATE_TABLE) - len(wrong),
        "right_mended": len(STATE_TABLE) - len(mended),
        "wrong": wrong,
        "led_to": _led_to(as_printed=True),
        "lines_left": next(c2z for c2z in (0, 1) if next_state(5, 0, 0, c2z, 0, 0)[0] == 3),
    }


def _led_to(*, as_printed: bool) -> str:
    """State after the end of the last frame."""
    sequencer = Sequencer(0, lines=1, columns=1, counts_per_line=COUNTS_PER_LINE, as_printed=as_printed)
    while True:
        last = sequencer.state == 5 and sequencer.b == 1
        sequencer.step()
        if last:
            return f"T{sequencer.state}"


@cache
def _full_run() -> Sequencer:
    """A complete sequence with an integration of one frame."""
    sequencer = Sequencer(1)
    for _ in run(sequencer):
        pass
    return sequencer


def _clock_values() -> Values:
    dark = np.zeros((LINES, COLUMNS))
    one, three = (expose(dark, frames) for frames in (1, 3))
    frame_s = (three.integration_s - one.integration_s) / 2.0
    written = _full_run().cm
    return {
        "largest_mhz": IAG_HZ * COUNTS_PER_LINE / 1e6,
        "line_khz": SERIAL_CLOCK_HZ / COUNTS_PER_LINE / 1e3,
        "machine_khz": 1e-3 / one.line_s,
        "line_clocks": one.line_s * SERIAL_CLOCK_HZ,
        "frame_ms": frame_s * 1e3,
        "rest_ms": (one.integration_s - frame_s) * 1e3,
        "written": written,
        "packed": written * 8.0 / (written * 2.0),
    }


# ---------------------------------------------------------------------- smear
def _smear_values() -> Values:
    rate = scene()
    clocked = expose(rate, 1)
    still = rate * clocked.integration_s
    smear = frame_transfer_smear(still, clocked.integration_s, clocked.line_s, "up")
    fast, slow = (100 * smear_share(clock, frames=1) for clock in (SERIAL_CLOCK_HZ, SLOW_CLOCK_HZ))
    fast_s, slow_s = (100 * smear_share(clock, integration_s=0.2) for clock in (SERIAL_CLOCK_HZ, SLOW_CLOCK_HZ))
    return {
        "off": np.abs(clocked.charge_e - still - smear).max() / still.max(),
        "slow_mhz": SLOW_CLOCK_HZ / 1e6,
        "percents": (slow, fast),
        "slow_greater": slow > fast,
        "percents_s": (slow_s, fast_s),
        "slow_s_greater": slow_s > fast_s,
    }


# ---------------------------------------------------------------------- focus
@cache
def defocus_radii_um() -> tuple[float, float]:
    """Root mean square radius of a defocused star image, µm: by diffraction, and of the geometric disc.

    The disc has the diameter δ/N; including the pixel, rms² = (δ/2N)²/2 + (p_x² + p_y²)/12.
    """
    optics, pitch = camera().optics, camera().detector.pitch_um
    f_number = optics.focal_length_mm / optics.aperture_mm
    psf = build_psf(PsfModel(model="diffraction", defocus_um=DEFOCUS_UM), f_number, pitch)
    image = render_stars((81, 81), np.array([[40.0, 40.0]]), np.ones(1), np.array([1e6]), psf)
    y, x = np.indices(image.shape)
    square = ((x - 40) * pitch[0]) ** 2 + ((y - 40) * pitch[1]) ** 2
    disc_um = DEFOCUS_UM / f_number / 2.0
    near = np.where(np.sqrt(square) < disc_um + 2.0 * max(pitch), image, 0.0)
    pixel = (pitch[0] ** 2 + pitch[1] ** 2) / 12.0
    return float(np.sqrt((near * square).sum() / near.sum())), math.sqrt(disc_um**2 / 2.0 + pixel)


# ---------------------------------------------------------------------- converter
def limits_of_brightness() -> tuple[float, float]:
    """Faintest V detected by the prototype: with 2 bits in one frame time, and with 12 bits in 0.5 s.

    The brightest pixel of a star must exceed the lowest of the uniform levels, or five times the noise.
    """
    scenario = camera()
    detector, sigma_px = scenario.detector, scenario.optics.psf.sigma_px
    assert sigma_px is not None
    share = float(erf(0.5 / (sigma_px * math.sqrt(2.0))) ** 2)
    rate = float(build_focal_plane(scenario).photometer.electrons_per_s(0.0, 0.65)) * share
    frame_s = expose(np.zeros((LINES, COLUMNS)), 1).integration_s
    lowest_e = float(even_levels(2, detector.full_well_e)[0])
    dark_e = detector.dark_current_e_s * 2.0 ** (
        (detector.temperature_c - detector.dark_reference_c) / detector.dark_doubling_c
    )
    converter_e = detector.full_well_e / (2**12 - 1) / math.sqrt(12.0)  # a step over √12
    noise_e = math.sqrt(detector.read_noise_e**2 + dark_e * detector.exposure_s + converter_e**2)
    return (2.5 * math.log10(rate * frame_s / lowest_e), 2.5 * math.log10(rate * detector.exposure_s / (5.0 * noise_e)))


def _converter_values() -> Values:
    def words(name: str) -> dict[str, str]:
        return {"bright": trials[name, 0.8].words(), "faint": trials[name, 0.04].words()}

    trials = converter_trials()
    notes = {2: "2 bits are for experimental purposes according to the thesis"}
    return {
        "counts": len(np.unique(compare_levels(np.linspace(0.0, 1.0, 1000), even_levels(2, 1.0)))),
        "faintest_v": limits_of_brightness(),
        "position_px": POSITION_PX,
        "converters": [
            {"bits": bits, "note": notes.get(bits, "recommended by the thesis")} | words(f"{bits} bits")
            for bits in (2, 8, 12)
        ],
        "geometric": words("2 bits, geometric levels"),
    }


def _modes() -> Values:
    """Clear, integration and clock-out, with the gates."""
    sequencer = Sequencer(2)
    starts: list[tuple[str, int]] = []
    while sequencer.clock == 0 or sequencer.state != 0:
        sequencer.step()
        if sequencer.state in (2, 3, 4, 5) and (not starts or starts[-1][0] != sequencer.mode):
            starts.append((sequencer.mode, sequencer.clock))
    to_ms = 1e3 / SERIAL_CLOCK_HZ
    modes = []
    for (_mode, start), (_next, end), words in zip(
        starts, [*starts[1:], ("", sequencer.clock)], ("clear", "integration, N = 2", "clock-out"), strict=True
    ):
        span = [(start * to_ms, (end - start) * to_ms)]
        modes.append({"span": span, "middle": (start + end) / 2 * to_ms, "words": words})
    return {"modes": modes, "moved": [modes[0], modes[2]]}


def _images(*clocks_and_defocus: tuple[float, float]) -> Values:
    """Content of the memory, by clock and defocus."""
    pitch_x, pitch_y = camera().detector.pitch_um
    panels = [
        {"codes": memory_image(clock_hz, defocus_um), "mhz": clock_hz / 1e6, "defocus_um": defocus_um}
        for clock_hz, defocus_um in clocks_and_defocus
    ]
    return {"panels": panels, "aspect": pitch_y / pitch_x}


def _smear() -> Values:
    """Smear beside a hole relative to its peak, by clock rate."""
    return {
        "mhz": _CLOCKS_HZ / 1e6,
        "frames": [100 * smear_share(clock, frames=1) for clock in _CLOCKS_HZ],
        "seconds": [100 * smear_share(clock, integration_s=0.2) for clock in _CLOCKS_HZ],
        "lowest": 100 * float(even_levels(2, 1.0)[0]),
    }


def _converters() -> Values:
    """Centroid error by number of bits of the converter; empty if the star is not detected."""
    trials = converter_trials()
    peaks = []
    for peak in (0.8, 0.04):
        found = [(bits, trials[f"{bits} bits", peak].error_px) for bits in BITS]
        geometric = trials["2 bits, geometric levels", peak].error_px
        shown = np.array([(bits, error) for bits, error in found if math.isfinite(error)])
        peaks.append({"peak": peak, "bits": shown[:, 0], "errors": shown[:, 1], "geometric": geometric})
    return {"bright": peaks[0], "faint": peaks[1], "ticks": BITS, "needed": POSITION_PX}
