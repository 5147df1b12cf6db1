"""Centroids with converters of few and many bits: a star on the TC211, with the product's pipeline."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache, partial
from typing import NamedTuple

import numpy as np
from scipy.special import erf

from simulator.build import detector_parameters
from simulator.detector.chain import detect
from simulator.detector.fixed_pattern import build_fixed_pattern
from simulator.optics.psf import build_psf
from simulator.optics.psf_model import PsfModel
from simulator.optics.splat import render_stars
from simulator.randomness import stream
from simulator.theses.greyling1995.comparators import compare_levels, geometric_levels
from simulator.theses.greyling1995.holes import camera
from startracker import centroid, detection
from startracker.front_end import Clock, find_stars
from startracker.settings import CentroidSettings, DetectionSettings

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
            image,
            detection.METHODS["components"],
            centroid.METHODS["moment"],
            DetectionSettings(reject_hits=False),
            CentroidSettings(psf_sigma_px=SIGMA_PX),
            Clock(),
        )
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
