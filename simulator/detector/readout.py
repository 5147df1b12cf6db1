"""From charge to numbers: output node, amplifier, converter. Kernels work in place on runs of pixels; reset noise and
read noise, sums of very many thermal motions and not counts, are the normal numbers of `normal.py`."""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from simulator.constants import BOLTZMANN_J_K, ELEMENTARY_CHARGE_C
from simulator.detector.excess_noise import bunch_e
from simulator.scenario.schema import DetectorSection
from startracker.errors import InputError

FloatArray = NDArray[np.float64]

SATURATION_MARGIN_SIGMA = 3.0
"""A full pixel reads less than this many standard deviations of the readout noise below its mean in 0.1 % of cases."""


def reset_noise_e(capacitance_f: float, temperature_c: float) -> float:
    """Noise of charging the output node to its reference, electrons.

    √(k T C) / q (Greyling 1995, eq. 3.12), 400 electrons × √(C / pF) at 25 °C.

    Parameters
    ----------
    capacitance_f : float
        Capacitance of the output node, farad.
    temperature_c : float
        Its temperature, °C.
    """
    return math.sqrt(BOLTZMANN_J_K * (temperature_c + 273.15) * capacitance_f) / ELEMENTARY_CHARGE_C


def section_reset_noise_e(section: DetectorSection) -> float:
    """Reset noise of a detector as its scenario describes it, electrons; 0 with correlated double sampling."""
    return reset_noise_e(section.reset_capacitance_ff * 1e-15, section.temperature_c)


@numba.njit(cache=True, error_model="numpy")
def bend(electrons: FloatArray, full_well_e: float, second: float, third: float) -> None:
    """Signal (N,) of an output stage that is not quite linear, electrons: S (1 + c₂ s + c₃ s²), s = S / full well.

    c₂ and c₃ are the relative departures from a straight line at the full well that the terms of second and third order
    bring; small signals keep the gain (Janesick 2007, *Photon Transfer*, chapter 7). Two terms describe the few percent
    of a source follower, not the knee of a saturating amplifier.
    """
    for i in range(electrons.size):
        relative = electrons[i] / full_well_e
        electrons[i] *= 1.0 + relative * (second + third * relative)


@numba.njit(cache=True, error_model="numpy")
def amplify(electrons: FloatArray, gain_e_per_dn: float, offset_dn: float) -> None:
    """Signal (N,) at the converter: electrons / gain + offset, fractional DN."""
    for i in range(electrons.size):
        electrons[i] = electrons[i] / gain_e_per_dn + offset_dn


@numba.njit(cache=True, error_model="numpy")
def convert(signal_dn: FloatArray, highest_dn: float) -> None:
    """Numbers (N,) of the converter: rounded to the nearest and clipped to 0 … `highest_dn`."""
    for i in range(signal_dn.size):
        signal_dn[i] = min(max(np.rint(signal_dn[i]), 0.0), highest_dn)


def highest_dn(section: DetectorSection) -> int | None:
    """Top of the converter, 2^bits − 1; None without one."""
    return None if section.adc_bits is None else 2**section.adc_bits - 1


def gain_e_per_dn(section: DetectorSection) -> float:
    """Electrons a DN. ``auto``: the full well, on top of the offset, is the top of the converter; 1 without one.

    Raises
    ------
    InputError
        When the gain is to be automatic and the offset fills the converter.
    """
    top = highest_dn(section)
    if section.gain_e_per_dn != "auto":
        return section.gain_e_per_dn
    if top is None:
        return 1.0
    if section.offset_dn >= top:
        raise InputError(
            f"detector.offset_dn = {section.offset_dn:g} leaves nothing of the {section.adc_bits} bits (top {top}); "
            "lower it or raise adc_bits"
        )
    return section.full_well_e / (top - section.offset_dn)


def noise_gain_e_per_dn(section: DetectorSection) -> float:
    """Signal over variance of the light, electrons a DN: what a photon-transfer curve of large areas gives.

    `gain_e_per_dn` without an intensifier; with one, K / (⟨g⟩ F²).
    """
    return gain_e_per_dn(section) / bunch_e(section)


def electronics_noise_e(section: DetectorSection) -> float:
    """Standard deviation of what the electronics add: reset, read and video noise, electrons of the detector."""
    video_e = section.video.noise_dn * gain_e_per_dn(section)
    return math.hypot(section.read_noise_e, section_reset_noise_e(section), video_e)


def saturation_dn(section: DetectorSection) -> float:
    """DN from which on a pixel counts as saturated.

    The top of the converter or the DN of the full well, whichever is lower. The charge of a full pixel is blurred by
    the readout noise, so the latter is taken `SATURATION_MARGIN_SIGMA` below its mean; without readout noise it is the
    full well itself. Rounded as the converter rounds.
    """
    gain = gain_e_per_dn(section)
    noise_e = electronics_noise_e(section)
    well_e = (section.full_well_e - SATURATION_MARGIN_SIGMA * noise_e) * (1.0 + sum(section.nonlinearity))
    well = well_e / gain + section.offset_dn
    top = highest_dn(section)
    return well if top is None else float(np.rint(min(well, top)))
