"""Image intensifier before the detector: photocathode, electron multiplier, phosphor screen coupled to the detector.

A photo-electron of the photocathode becomes a random number of electrons in the detector, spread over its pixels: its
light comes in bunches. The noise of the light in an area is therefore larger than Poisson's by the excess noise factor

    F² = 1 + var(g) / ⟨g⟩² + 1 / ⟨g⟩

of the gain g, the last term from the counting of the phosphor's photons in the detector, and it hangs together over
the size of a bunch (Bell 1975, IEEE Trans. Electron Devices 22, 821; for a gain distributed exponentially, as behind a
microchannel plate, F² is 2).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from simulator.detector.poisson import draw_poisson
from simulator.scenario.schema import DetectorSection, IntensifierSection

__all__ = ["bunch_e", "excess_noise_factor", "intensify", "multiply", "signal_gain"]

FloatArray = NDArray[np.float64]

_KERNEL_SIGMAS = 5.0


def signal_gain(section: DetectorSection) -> float:
    """Mean electrons in the detector for a photo-electron: the intensifier's gain, 1 without one."""
    return section.intensifier.gain or 1.0


def excess_noise_factor(section: DetectorSection) -> float:
    """F²: variance of the light summed over an area against that of ideal multiplication; 1 without an intensifier."""
    intensifier = section.intensifier
    return 1.0 + intensifier.gain_variance + 1.0 / intensifier.gain if intensifier.gain else 1.0


def bunch_e(section: DetectorSection) -> float:
    """⟨g⟩ F², electrons: variance over mean of the light summed over an area, in the detector; 1 without an
    intensifier."""
    return signal_gain(section) * excess_noise_factor(section)


def intensify(mean_photo_e: FloatArray, section: DetectorSection, rng: np.random.Generator) -> FloatArray:
    """Mean electrons that an intensified image makes in the detector, (H, W).

    Photo-electrons of the photocathode (light and dark) are counted, each multiplied by its own random gain, and
    spread by phosphor and coupling; the detector's own shot noise, which counts the phosphor's light, comes
    after. Light that would leave the frame at its borders comes back: as much enters from outside. With `shot_noise`
    off the mean is multiplied and spread.

    Parameters
    ----------
    mean_photo_e : (H, W) float64
        Mean photo-electrons of the photocathode over the exposure; overwritten.
    section : DetectorSection
        With an intensifier.
    rng : Generator
        Draws counts and gains.
    """
    intensifier = section.intensifier
    mean_photo_e += intensifier.dark_e_s * section.exposure_s
    if section.shot_noise:
        electrons = multiply(draw_poisson(mean_photo_e, rng, in_place=True), intensifier, rng)
    else:
        electrons = mean_photo_e * intensifier.gain
    sigma_px = intensifier.phosphor_sigma_px
    return gaussian_filter(electrons, sigma_px, mode="reflect", truncate=_KERNEL_SIGMAS) if sigma_px else electrons


def multiply(counts: FloatArray, section: IntensifierSection, rng: np.random.Generator) -> FloatArray:
    """Electrons out of counted photo-electrons, of the same shape.

    The gain of one is distributed as gamma with mean ⟨g⟩ and relative variance b (the Pólya distribution of electron
    multipliers, Prescott 1966, Nucl. Instrum. Methods 39, 173); the sum of n of them then is gamma with shape n / b
    and scale b ⟨g⟩, drawn at once.
    """
    if section.gain_variance == 0.0:
        return counts * section.gain
    return rng.standard_gamma(counts / section.gain_variance) * (section.gain_variance * section.gain)
