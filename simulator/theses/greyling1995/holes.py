"""Images of the box with holes in its bottom in front of the prototype (Greyling 1995, section 6.3), in its memory."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve

from simulator.build import detector_parameters
from simulator.detector.chain import detect
from simulator.detector.fixed_pattern import build_fixed_pattern
from simulator.optics.disk import add_disk
from simulator.optics.shutter import frame_transfer_smear
from simulator.randomness import stream
from simulator.scenario import Scenario
from simulator.theses.greyling1995.comparators import compare_levels, even_levels
from simulator.theses.greyling1995.sequencer import COLUMNS, COUNTS_PER_LINE, LINES, SERIAL_CLOCK_HZ
from startracker.arrays import FloatArray

SLOW_CLOCK_HZ = 1.0e5
"""Assumed, as the thesis does not state the slow clock of Fig. 6.10."""
HOLES = ((40, 30), (95, 22), (150, 45), (62, 70), (120, 84), (30, 110), (88, 125), (160, 118), (135, 146))
"""Columns and lines of the holes: an assumed arrangement."""
HOLE_PX = 2.2
PEAK_AT_2_MHZ = 0.7
"""Brightest pixel relative to the full well, after one frame at 2 MHz."""
_CLOCKS_PER_LINE = COUNTS_PER_LINE + 2
"""With the states T3 and T5."""


@cache
def camera() -> Scenario:
    """The included prototype: scenarios/tc211.yaml."""
    return Scenario.load("tc211")


def scene(defocus_um: float = 0.0) -> FloatArray:
    """Photo-electrons per second of the holes, (165, 192): uniform discs with a radius of 2.2 pixels, blurred by
    defocus."""
    scenario = camera()
    pitch_x, pitch_y = scenario.detector.pitch_um
    rate = np.zeros((LINES, COLUMNS))
    for hole in HOLES:
        add_disk(rate, hole, (HOLE_PX, HOLE_PX * pitch_x / pitch_y), 1.0)
    rate *= PEAK_AT_2_MHZ * scenario.detector.full_well_e / (rate.max() * _frame_s(SERIAL_CLOCK_HZ))
    if defocus_um > 0.0:
        radius_um = defocus_um * scenario.optics.aperture_mm / scenario.optics.focal_length_mm / 2.0
        half = int(np.ceil(radius_um / min(pitch_x, pitch_y))) + 1
        disc = np.zeros((2 * half + 1, 2 * half + 1))
        add_disk(disc, (half, half), (radius_um / pitch_x, radius_um / pitch_y), 1.0)
        rate = np.maximum(fftconvolve(rate, disc, mode="same"), 0.0)
    return rate


def memory_image(clock_hz: float, defocus_um: float = 0.0) -> NDArray[np.uint16]:
    """Content of the prototype's memory after an integration of one frame: 2 bits per pixel, (165, 192).

    Light and smear through the detector of scenarios/tc211.yaml, and through three comparators at uniform levels.
    """
    scenario = camera()
    frame_s, line_s = _frame_s(clock_hz), _CLOCKS_PER_LINE / clock_hz
    still = scene(defocus_um) * frame_s
    mean_e = still + frame_transfer_smear(still, frame_s, line_s, "up")
    detector = scenario.detector.model_copy(update={"exposure_s": frame_s, "adc_bits": None, "offset_dn": 0.0})
    device = detector_parameters(detector)
    pattern = build_fixed_pattern(device, scenario.seed)
    readout = detect(mean_e, device, pattern, lambda stage: stream(scenario.seed, stage, 0), exposure_s=frame_s)
    return compare_levels(readout.image, even_levels(2, detector.full_well_e))


def smear_share(clock_hz: float, *, frames: int = 0, integration_s: float = 0.0) -> float:
    """Mean smear in the brightest column outside the hole, relative to the hole's peak, both limited by the full well.

    The integration is in frame times of this serial clock, or in seconds, with the same signal of the holes at every
    clock.
    """
    full_e = camera().detector.full_well_e
    rate = scene()
    line_s = _CLOCKS_PER_LINE / clock_hz
    exposure_s = frames * _frame_s(clock_hz) if frames else integration_s
    if not frames:
        rate *= _frame_s(SERIAL_CLOCK_HZ) / integration_s
    still = rate * exposure_s
    smear = frame_transfer_smear(still, exposure_s, line_s, "up")
    dark = still == 0.0
    return float(np.minimum(smear[dark].max(), full_e) / np.minimum((still + smear).max(), full_e))


def _frame_s(clock_hz: float) -> float:
    """Frame time: 165 lines, and the states T6 and T2 between frames."""
    return (LINES * _CLOCKS_PER_LINE + 2) / clock_hz
