"""The prototype's converter (Greyling 1995, sections 6.2.3 and 6.3): comparators, the holes of its test in its memory,
and centroids with few and many bits."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.signal import fftconvolve
from scipy.special import erf

from simulator.build import detector_parameters
from simulator.detector.chain import detect
from simulator.detector.fixed_pattern import build_fixed_pattern
from simulator.optics.disk import add_disk
from simulator.optics.psf import build_psf
from simulator.optics.psf_model import PsfModel
from simulator.optics.shutter import frame_transfer_smear
from simulator.optics.splat import render_stars
from simulator.randomness import stream
from simulator.scenario import Scenario
from simulator.theses.greyling1995.sequencer import COLUMNS, COUNTS_PER_LINE, LINES, SERIAL_CLOCK_HZ
from startracker import centroid, detection
from startracker.core import FloatArray
from startracker.errors import InputError
from startracker.front_end import Clock, find_stars
from startracker.inputs import GivenImage
from startracker.settings import CentroidSettings, DetectionSettings


def compare_levels(signal: ArrayLike, levels: ArrayLike) -> NDArray[np.uint16]:
    """Number of the ascending levels (N,) reached by each signal, in the same unit: 0 … N.

    The prototype of Greyling 1995 (section 6.2.3) has three comparators with manually set levels: 2 bits.

    Raises
    ------
    InputError
        If the levels are not ascending.
    """
    limits = np.asarray(levels, dtype=float)
    if limits.ndim != 1 or not len(limits) or not (np.diff(limits) > 0.0).all():
        raise InputError(f"the levels of comparators must be ascending; got {limits.tolist()}")
    return np.searchsorted(limits, np.asarray(signal, dtype=float), side="right").astype(np.uint16)


def even_levels(bits: int, full: float) -> FloatArray:
    """Levels (2^bits − 1,) of a converter that rounds to the nearest of 2^bits values from 0 to `full`."""
    top = 2**bits - 1
    return np.asarray((np.arange(top) + 0.5) * (full / top))


def geometric_levels(lowest: float, highest: float) -> FloatArray:
    """Three levels of equal ratio: closer together at low signals."""
    return np.geomspace(lowest, highest, 3)


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


BITS = (2, 4, 6, 8, 10, 12)
"""Converters, bits."""
SIGMA_PX = 1.23
"""Star image of Table 4.1."""
_SIDE_PX = 64
_STARS = 100
_LEVELS = 0.02, 0.5
"""Lowest and highest of the three levels of equal ratio, relative to the full well."""
_NEAR_PX = 2.0


class ConverterTrial(NamedTuple):
    """Centroids of one star at many positions in a pixel: root mean square error on one axis, NaN if the star is
    detected in fewer than half of the frames, and number of frames in which it is detected."""

    error_px: float
    found: int
    frames: int

    def words(self) -> str:
        """Text for a table."""
        if math.isnan(self.error_px):
            return f"not detected ({self.found} of {self.frames})" if self.found else "not detected"
        return f"{self.error_px:.3f} pixels"


@cache
def converter_trial(bits: int, peak: float, *, geometric: bool = False) -> ConverterTrial:
    """Centroid error with a converter of uniform steps from the offset to the full well, at random positions.

    `peak` is the signal of the brightest pixel of a centred star relative to the full well. `geometric`: three
    comparators with levels of equal ratio instead of uniform steps.
    """
    scenario = camera()
    detector = replace(
        detector_parameters(scenario.detector),
        width=_SIDE_PX,
        height=_SIDE_PX,
        adc_bits=None if geometric else bits,
        offset_dn=0.0,
    )
    pattern = build_fixed_pattern(detector, scenario.seed)
    psf = build_psf(PsfModel(sigma_px=SIGMA_PX), 1.0, (1.0, 1.0))
    total_e = peak * detector.full_well_e / float(erf(0.5 / (SIGMA_PX * math.sqrt(2.0))) ** 2)
    levels = geometric_levels(_LEVELS[0] * detector.full_well_e, _LEVELS[1] * detector.full_well_e)
    positions = _SIDE_PX / 2 + stream(scenario.seed, "converter").uniform(-0.5, 0.5, (_STARS, 2))
    errors = []
    for k, xy in enumerate(positions):
        mean_e = render_stars((_SIDE_PX, _SIDE_PX), xy[None], np.ones(1), np.array([total_e]), psf)
        readout = detect(
            mean_e, detector, pattern, partial(stream, scenario.seed, trial=k), exposure_s=scenario.detector.exposure_s
        )
        image = compare_levels(readout.image, levels) if geometric else readout.image
        found = find_stars(
            GivenImage(image),
            detection.METHODS["components"],
            centroid.METHODS["moment"],
            DetectionSettings(reject_hits=False),
            CentroidSettings(psf_sigma_px=SIGMA_PX),
            Clock(),
        ).stars
        if len(found.xy) and float(np.abs(found.xy[0] - xy).max()) < _NEAR_PX:
            errors.append(found.xy[0] - xy)
    rms = float(np.sqrt(np.mean(np.square(errors)))) if 2 * len(errors) >= _STARS else math.nan
    return ConverterTrial(rms, len(errors), _STARS)


@cache
def converter_trials() -> dict[tuple[str, float], ConverterTrial]:
    """Centroids with each converter, for a bright star (peak at 0.8 of the full well) and a faint one (0.04)."""
    peaks = (0.8, 0.04)
    trials = {(f"{bits} bits", peak): converter_trial(bits, peak) for bits in BITS for peak in peaks}
    return trials | {("2 bits, geometric levels", peak): converter_trial(2, peak, geometric=True) for peak in peaks}
