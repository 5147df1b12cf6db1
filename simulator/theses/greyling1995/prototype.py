"""The prototype camera (Greyling 1995, chapter 6): sequencer, smear of clocking out, focus, converter."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from simulator.detector.comparators import compare_levels, even_levels
from simulator.detector.sequencer import (
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
from simulator.focal_plane import FocalPlane
from simulator.optics.psf import build_psf
from simulator.optics.shutter import frame_transfer_smear
from simulator.optics.splat import render_stars
from simulator.scenario.schema import DetectorSection, PsfSection
from simulator.theses.greyling1995 import signals
from simulator.theses.greyling1995.converter import converter_trials
from simulator.theses.greyling1995.holes import SLOW_CLOCK_HZ, camera, scene, smear_share
from simulator.theses.greyling1995.prototype_figures import FIGURES, POSITION_PX
from simulator.theses.printed import NOTHING, Row, Section, compare

__all__ = ["defocus_radii_um", "limits_of_brightness", "section"]

FloatArray = NDArray[np.float64]

DARK_ELEMENTS = 12
"""Elements for the dark reference at the end of each line (section 6.1)."""
IAG_HZ = 15.7e3
"""Largest rate of the image area gate, by the data book (section 6.2.2)."""
DEFOCUS_UM = 40.0


def section() -> Section:
    """Chapter 6 against the models of the product."""
    return Section(
        "Chapter 6: the prototype camera with the TC211",
        [
            *_device_rows(),
            *_state_rows(),
            *_clock_rows(),
            *_smear_rows(),
            _focus_row(),
            *_converter_rows(),
            *signals.rows(),
        ],
        signals.FIGURES | FIGURES,
    )


# ---------------------------------------------------------------------- sections 6.1 and 6.2
def _device_rows() -> list[Row]:
    pitch_x, pitch_y = camera().detector.pitch_um
    width, height = COLUMNS * pitch_x, LINES * pitch_y
    cells = DUMMY_CELLS + COLUMNS + DARK_ELEMENTS
    return [
        Row(
            "6.1",
            "image area",
            "square",
            f"{width:g} µm × {height:g} µm",
            "exact" if width == height else "differs",
            "192 × 13.75 µm and 165 × 16 µm",
        ),
        Row(
            "6.1, 6.2.2",
            "counts a line against cells of the serial register",
            f"{COUNTS_PER_LINE}",
            f"{cells}",
            "close",
            f"{DUMMY_CELLS} dummy cells, {COLUMNS} elements, {DARK_ELEMENTS} dark ones: the last "
            f"{cells - COUNTS_PER_LINE} are cleared unread",
        ),
    ]


def _state_rows() -> list[Row]:
    printed, mended = equation_faults(as_printed=True), equation_faults()
    names = {name for _, name in printed}
    rows = [
        Row(
            "Table 6.2",
            f"rows that the equation of {name} gives, over all inputs",
            f"{len(STATE_TABLE)}",
            f"{len(STATE_TABLE) - sum(fault == name for _, fault in printed)}",
            "exact",
            "as printed",
        )
        for name in ("Q1", "Q3", "A_set", "B_set")
        if name not in names
    ]
    wrong = [row for row, name in printed if name == "Q2"]
    lines_left = next(c2z for c2z in (0, 1) if next_state(5, 0, 0, c2z, 0, 0)[0] == 3)
    rows.append(
        Row(
            "Table 6.2",
            "rows that the equation of Q2 gives, over all inputs",
            f"{len(STATE_TABLE)}",
            f"{len(STATE_TABLE) - len(wrong)} as printed, {len(STATE_TABLE) - len(mended)} mended",
            "differs" if wrong else "exact",
            f"its plain T5 leads from T5 with C2Z = B = 1 to {_led_to(as_printed=True)} where the table has "
            f"T{wrong[0].following}: the camera never comes to rest. T1 + T2 + T5·(C2Z·B)' + T6 is right",
        )
    )
    rows.append(
        Row(
            "6.2.2",
            "lines left: from T5 to T3",
            "if C2 has reached 0",
            f"with C2Z = {lines_left}, where C2 has not reached 0",
            "differs",
            "the text has it the wrong way round; Table 6.2 goes to T3 with C2Z = 0, lines left. C2Z is active high, "
            "C1Z and C3Z active low",
        )
    )
    return rows


def _led_to(*, as_printed: bool) -> str:
    """State that follows the end of the last frame."""
    sequencer = Sequencer(0, lines=1, columns=1, counts_per_line=COUNTS_PER_LINE, as_printed=as_printed)
    while True:
        last = sequencer.state == 5 and sequencer.b == 1
        sequencer.step()
        if last:
            return f"T{sequencer.state}"


@cache
def _full_run() -> Sequencer:
    """One sequence with an integration of one frame, run to its end."""
    sequencer = Sequencer(1)
    for _ in run(sequencer):
        pass
    return sequencer


def _clock_rows() -> list[Row]:
    dark = np.zeros((LINES, COLUMNS))
    one, three = (expose(dark, frames) for frames in (1, 3))
    frame_s = (three.integration_s - one.integration_s) / 2.0
    written = _full_run().cm
    return [
        compare(
            "6.2.2",
            "largest clock of SRG: 15.7 kHz × 208",
            "3.26",
            IAG_HZ * COUNTS_PER_LINE / 1e6,
            unit="MHz",
            why="3.2656: cut, not rounded",
        ),
        compare(
            "6.2.2",
            "line clock: 1 / (208 × 0.5 µs)",
            "9.6",
            SERIAL_CLOCK_HZ / COUNTS_PER_LINE / 1e3,
            unit="kHz",
        ),
        compare(
            "6.2.2",
            "line clock of the state machine",
            "9.6",
            1e-3 / one.line_s,
            unit="kHz",
            why=f"each line takes T3 and T5 besides 208 times T4: {one.line_s * SERIAL_CLOCK_HZ:.0f} clocks",
        ),
        Row(
            "6.2.1",
            "integration time",
            "in multiples of the frame time",
            f"N × {frame_s * 1e3:.3f} ms + {(one.integration_s - frame_s) * 1e3:.3f} ms",
            "close",
            "run clock by clock; the rest is T6, T2 and the line from the last shift of the clearing to the first of "
            "the clock-out",
        ),
        compare("6.2.3", "memory of an image", "31680", float(written), unit="bytes", why="addresses written in a run"),
        compare(
            "6.2.3",
            "memory against 2 bits a pixel, packed",
            "4",
            written * 8.0 / (written * 2.0),
            unit="times",
        ),
    ]


# ---------------------------------------------------------------------- smear
def _smear_rows() -> list[Row]:
    rate = scene()
    clocked = expose(rate, 1)
    still = rate * clocked.integration_s
    smear = frame_transfer_smear(still, clocked.integration_s, clocked.line_s, "up")
    off = float(np.abs(clocked.charge_e - still - smear).max() / still.max())
    fast, slow = (smear_share(clock, frames=1) for clock in (SERIAL_CLOCK_HZ, SLOW_CLOCK_HZ))
    fast_s, slow_s = (smear_share(clock, integration_s=0.2) for clock in (SERIAL_CLOCK_HZ, SLOW_CLOCK_HZ))
    return [
        Row(
            "6.2, Fig. 6.10",
            "smear by line_time · Σ F against charge moved line by line",
            NOTHING,
            f"{off:.0e} of the brightest pixel",
            "not printed",
            "simulator.optics.shutter against the sequencer, which moves the charge at every shift",
        ),
        Row(
            "6.2.3, 6.3",
            f"smear over signal, {SLOW_CLOCK_HZ / 1e6:g} MHz against 2 MHz, integration 0.2 s",
            "greater at a slower clock",
            f"{100 * slow_s:.2f} % against {100 * fast_s:.2f} %",
            "exact" if slow_s > fast_s else "differs",
            "the same integration: a line stands longer in each row, smear ∝ 1 / clock",
        ),
        Row(
            "6.2.3, 6.3",
            f"smear over signal, {SLOW_CLOCK_HZ / 1e6:g} MHz against 2 MHz, integration one frame",
            "greater at a slower clock",
            f"{100 * slow:.1f} % against {100 * fast:.1f} %",
            "close" if slow > fast else "differs",
            "integration is counted in frames and slows with the clock, which leaves smear over signal as it is; but "
            "the holes' images fill their wells while their smear still grows",
        ),
    ]


# ---------------------------------------------------------------------- focus
@cache
def defocus_radii_um(defocus_um: float = DEFOCUS_UM) -> tuple[float, float]:
    """Root mean square radius of a star's image out of focus, µm: by diffraction, and of the geometric disc.

    The disc has the diameter δ/N; with the pixel's own spread, rms² = (δ/2N)²/2 + (p_x² + p_y²)/12.
    """
    optics, pitch = camera().optics, camera().detector.pitch_um
    f_number = optics.focal_length_mm / optics.aperture_mm
    psf = build_psf(PsfSection(model="diffraction", defocus_um=defocus_um), f_number, pitch)
    image = render_stars((81, 81), np.array([[40.0, 40.0]]), np.ones(1), np.array([1e6]), psf)
    y, x = np.indices(image.shape)
    square = ((x - 40) * pitch[0]) ** 2 + ((y - 40) * pitch[1]) ** 2
    disc_um = defocus_um / f_number / 2.0
    near = np.where(np.sqrt(square) < disc_um + 2.0 * max(pitch), image, 0.0)
    pixel = (pitch[0] ** 2 + pitch[1] ** 2) / 12.0
    return float(np.sqrt((near * square).sum() / near.sum())), math.sqrt(disc_um**2 / 2.0 + pixel)


def _focus_row() -> Row:
    diffraction, disc = defocus_radii_um()
    return Row(
        "Fig. 6.9",
        f"rms radius of a point {DEFOCUS_UM:g} µm out of focus at f/1",
        NOTHING,
        f"{diffraction:.1f} µm",
        "not printed",
        f"the figure has no scale; a geometric disc of diameter δ/N, spread over a pixel, has {disc:.1f} µm",
    )


# ---------------------------------------------------------------------- converter
def limits_of_brightness() -> tuple[float, float]:
    """Faintest V that the prototype sees: with its 2 bits in one frame time; with 12 bits in 0.5 s.

    A star must bring its brightest pixel over the lowest of the even levels, or over five times the noise.
    """
    scenario = camera()
    detector, sigma_px = scenario.detector, scenario.optics.psf.sigma_px
    assert sigma_px is not None
    share = float(erf(0.5 / (sigma_px * math.sqrt(2.0))) ** 2)
    rate = float(FocalPlane(scenario).photometer.electrons_per_s(0.0, 0.65)) * share
    frame_s = expose(np.zeros((LINES, COLUMNS)), 1).integration_s
    lowest_e = float(even_levels(2, detector.full_well_e)[0])
    dark_e = detector.dark_current_e_s * 2.0 ** (
        (detector.temperature_c - detector.dark_reference_c) / detector.dark_doubling_c
    )
    noise_e = math.sqrt(detector.read_noise_e**2 + dark_e * detector.exposure_s + gain_noise_e(detector) ** 2)
    return (
        2.5 * math.log10(rate * frame_s / lowest_e),
        2.5 * math.log10(rate * detector.exposure_s / (5.0 * noise_e)),
    )


def gain_noise_e(detector: DetectorSection, bits: int = 12) -> float:
    """Noise of the conversion, a step of the converter over √12, electrons."""
    return float(detector.full_well_e / (2**bits - 1) / math.sqrt(12.0))


def _converter_rows() -> list[Row]:
    trials = converter_trials()
    counts = len(np.unique(compare_levels(np.linspace(0.0, 1.0, 1000), even_levels(2, 1.0))))
    two, many = limits_of_brightness()
    rows = [
        compare("6.2.3", "brightness values of three levels", "4", float(counts)),
        Row(
            "6.3",
            "faintest star, V, with the lens of 1.5 cm",
            "lens much too small to observe real stars",
            f"V = {two:.1f} with 2 bits and one frame; V = {many:.1f} with 12 bits and 0.5 s",
            "differs",
            "it was the 2-bit converter and the integration of some 20 ms: with 12 bits and 0.5 s scenarios/tc211.yaml "
            "solves its frames through this lens",
        ),
    ]
    for bits in (2, 8, 12):
        bright, faint = trials[f"{bits} bits", 0.8], trials[f"{bits} bits", 0.04]
        rows.append(
            Row(
                "6.2.3",
                f"centroid error with {bits} bits, rms of an axis",
                NOTHING,
                f"{bright.words()} at 0.8 of the full well; {faint.words()} at 0.04",
                "not printed",
                ("2 bits are for experimental purposes, the thesis says" if bits == 2 else "recommended by the thesis")
                + f"; by the product's detection and centroiding; section 7.2 asks for {POSITION_PX:g} pixels",
            )
        )
    wide, faint = trials["2 bits, geometric levels", 0.8], trials["2 bits, geometric levels", 0.04]
    rows.append(
        Row(
            "6.2.3",
            "2 bits, levels of equal ratio in place of even ones",
            "further tests could be done",
            f"{wide.words()} at 0.8 of the full well; {faint.words()} at 0.04",
            "open",
            "levels at 0.02, 0.1 and 0.5 of the full well",
        )
    )
    return rows
