"""Image intensifier before the detector: photocathode, electron multiplier, phosphor screen coupled to the detector.

A photo-electron of the photocathode produces a random number of electrons, spread over several pixels of the detector
(`simulator.detector.excess_noise`).
"""

from __future__ import annotations

import numpy as np

from simulator.detector.parameters import DetectorParameters, Intensifier
from simulator.detector.pixels import apply_steps
from simulator.detector.steps import SHOT_NOISE, Step
from startracker.core import FloatArray

_KERNEL_SIGMAS = 5.0
"""Radius at which the blur is truncated, standard deviations."""


def intensify(
    mean_photo_e: FloatArray, detector: DetectorParameters, exposure_s: float, rng: np.random.Generator
) -> FloatArray:
    """Mean electrons of an intensified image in the detector, (H, W).

    The numbers of photo-electrons of the photocathode (light and dark) are sampled, each photo-electron is multiplied
    by a random gain, and the result is blurred by phosphor and coupling. The shot noise of the phosphor's light is
    added later, as the detector's own shot noise. At the borders of the frame the blur is reflected, because as much
    light enters from outside as leaves. With `shot_noise` off the mean is multiplied and blurred.

    Parameters
    ----------
    mean_photo_e : (H, W) float64
        Mean photo-electrons of the photocathode over the exposure; overwritten.
    detector : DetectorParameters
        With an intensifier.
    exposure_s : float
        Exposure time.
    rng : Generator
        For numbers of electrons and gains.
    """
    intensifier = detector.intensifier
    mean_photo_e += intensifier.dark_e_s * exposure_s
    if detector.shot_noise:
        apply_steps(mean_photo_e, [Step(SHOT_NOISE, rng=rng)], mean_photo_e)
        electrons = multiply(mean_photo_e, intensifier, rng)
    else:
        electrons = mean_photo_e * intensifier.gain
    sigma_px = intensifier.phosphor_sigma_px
    if sigma_px == 0.0:
        return electrons
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(electrons, sigma_px, mode="reflect", truncate=_KERNEL_SIGMAS))


def multiply(counts: FloatArray, intensifier: Intensifier, rng: np.random.Generator) -> FloatArray:
    """Electrons from numbers of photo-electrons, of the same shape.

    The gain of one photo-electron has a gamma distribution with mean ⟨g⟩ and relative variance b (the Pólya
    distribution of electron multipliers, Prescott 1966, Nucl. Instrum. Methods 39, 173). The sum for n of them has a
    gamma distribution with shape n / b and scale b ⟨g⟩, which is sampled directly.
    """
    if intensifier.gain_variance == 0.0:
        return counts * intensifier.gain
    return rng.standard_gamma(counts / intensifier.gain_variance) * (intensifier.gain_variance * intensifier.gain)
