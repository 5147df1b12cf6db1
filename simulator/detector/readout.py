"""Conversion of charge to digital numbers: output node, amplifier, converter.

Kernels work in place on runs of pixels. Reset noise and read noise are sums of very many thermal fluctuations and
therefore Gaussian (`gaussian.py`).
"""

from __future__ import annotations

import math

import numpy as np

from simulator.constants import BOLTZMANN_J_K, ELEMENTARY_CHARGE_C
from simulator.detector.excess_noise import bunch_e
from simulator.detector.parameters import DetectorParameters
from startracker._compiled import kernel_part
from startracker.core import FloatArray
from startracker.errors import InputError

SATURATION_MARGIN_SIGMA = 3.0
"""Margin of `saturation_dn`, in standard deviations of the readout noise: 0.1 % of the full pixels read lower."""


def reset_noise_e(capacitance_f: float, temperature_c: float) -> float:
    """Reset (kTC) noise of the output node, electrons.

    √(k T C) / q (Greyling 1995, eq. 3.12), 400 electrons × √(C / pF) at 25 °C.

    Parameters
    ----------
    capacitance_f : float
        Capacitance of the output node, farad.
    temperature_c : float
        Its temperature, °C.
    """
    return math.sqrt(BOLTZMANN_J_K * (temperature_c + 273.15) * capacitance_f) / ELEMENTARY_CHARGE_C


def detector_reset_noise_e(detector: DetectorParameters) -> float:
    """Reset noise of a detector, electrons; 0 with correlated double sampling."""
    return reset_noise_e(detector.reset_capacitance_ff * 1e-15, detector.temperature_c)


@kernel_part
def bend(electrons: FloatArray, full_well_e: float, second: float, third: float) -> None:
    """Signal (N,) of a slightly non-linear output stage, electrons: S (1 + c₂ s + c₃ s²), s = S / full well.

    c₂ and c₃ are the relative deviations from linearity at the full well due to the terms of second and third order;
    the gain of small signals is unchanged (Janesick 2007, *Photon Transfer*, chapter 7). Two terms describe the
    non-linearity of a few percent of a source follower, not the knee of a saturating amplifier.
    """
    for i in range(electrons.size):
        relative = electrons[i] / full_well_e
        electrons[i] *= 1.0 + relative * (second + third * relative)


@kernel_part
def amplify(electrons: FloatArray, gain_e_per_dn: float, offset_dn: float) -> None:
    """Signal (N,) at the converter: electrons / gain + offset, fractional DN."""
    for i in range(electrons.size):
        electrons[i] = electrons[i] / gain_e_per_dn + offset_dn


@kernel_part
def convert(signal_dn: FloatArray, highest_dn: float) -> None:
    """Digital numbers (N,) of the converter: rounded to nearest and clipped to 0 … `highest_dn`."""
    for i in range(signal_dn.size):
        signal_dn[i] = min(max(np.rint(signal_dn[i]), 0.0), highest_dn)


def highest_dn(detector: DetectorParameters) -> int | None:
    """Largest digital number, 2^bits − 1; None without a converter."""
    return None if detector.adc_bits is None else 2**detector.adc_bits - 1


def gain_e_per_dn(detector: DetectorParameters) -> float:
    """Electrons per DN. ``auto``: full well plus offset is the largest digital number; 1 without a converter.

    Raises
    ------
    InputError
        If the gain is automatic and the offset exceeds the range of the converter.
    """
    top = highest_dn(detector)
    if detector.gain_e_per_dn != "auto":
        return detector.gain_e_per_dn
    if top is None:
        return 1.0
    if detector.offset_dn >= top:
        raise InputError(
            f"detector.offset_dn = {detector.offset_dn:g} leaves nothing of the {detector.adc_bits} bits (top {top}); "
            "lower it or raise adc_bits"
        )
    return detector.full_well_e / (top - detector.offset_dn)


def noise_gain_e_per_dn(detector: DetectorParameters) -> float:
    """Ratio of signal to variance, electrons per DN, as measured by a photon-transfer curve of large areas.

    This is the gain K of `gain_e_per_dn` without an intensifier, and K / (⟨g⟩ F²) with one.
    """
    return gain_e_per_dn(detector) / bunch_e(detector)


def electronics_noise_e(detector: DetectorParameters) -> float:
    """Standard deviation of the noise of the electronics (reset, read and video noise), electrons of the detector."""
    video_e = detector.video.noise_dn * gain_e_per_dn(detector)
    return math.hypot(detector.read_noise_e, detector_reset_noise_e(detector), video_e)


def saturation_dn(detector: DetectorParameters) -> float:
    """DN at and above which a pixel is saturated.

    It is the largest digital number or the DN of the full well, whichever is lower, rounded as by the converter. The
    latter is reduced by `SATURATION_MARGIN_SIGMA` standard deviations of the readout noise, with which a full pixel is
    read.
    """
    gain = gain_e_per_dn(detector)
    noise_e = electronics_noise_e(detector)
    # At the full well, s = 1, the non-linearity is the factor 1 + c₂ + c₃.
    well_e = (detector.full_well_e - SATURATION_MARGIN_SIGMA * noise_e) * (1.0 + sum(detector.nonlinearity))
    well = well_e / gain + detector.offset_dn
    top = highest_dn(detector)
    return well if top is None else float(np.rint(min(well, top)))
