"""Excess noise of an image intensifier, in which each photo-electron produces a random number of electrons.

The variance of the light in an area exceeds that of a Poisson distribution by the excess noise factor

    F² = 1 + var(g) / ⟨g⟩² + 1 / ⟨g⟩

of the gain g. The last term is the shot noise of the phosphor's photons in the detector. The noise is correlated over
the size of the phosphor spot (Bell 1975, IEEE Trans. Electron Devices 22, 821; for the exponential gain distribution of
a microchannel plate F² is 2).
"""

from __future__ import annotations

from simulator.detector.parameters import DetectorParameters


def signal_gain(detector: DetectorParameters) -> float:
    """Mean electrons in the detector per photo-electron: the gain of the intensifier, 1 without one."""
    return detector.intensifier.gain or 1.0


def excess_noise_factor(detector: DetectorParameters) -> float:
    """F²: variance of the light in an area relative to noiseless multiplication; 1 without an intensifier."""
    intensifier = detector.intensifier
    return 1.0 + intensifier.gain_variance + 1.0 / intensifier.gain if intensifier.gain else 1.0


def bunch_e(detector: DetectorParameters) -> float:
    """⟨g⟩ F², electrons: ratio of variance to mean of the charge summed over an area of the detector; 1 without an
    intensifier."""
    return signal_gain(detector) * excess_noise_factor(detector)
