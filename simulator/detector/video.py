"""Analogue video: what a line and a recorder of limited bandwidth do to a frame before it is digitised."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simulator.detector.parameters import Video
from simulator.detector.pixels import apply_steps
from simulator.detector.steps import GAUSSIAN_NOISE, Step

__all__ = ["video_signal"]

FloatArray = NDArray[np.float64]

_KERNEL_SIGMAS = 5.0


def video_signal(signal_dn: FloatArray, video: Video, rng: np.random.Generator) -> FloatArray:
    """Video signal (H, W), fractional DN: spread along the lines, with noise of the same bandwidth.

    The signal runs through a channel whose impulse response is a Gaussian of `line_blur_px` along the line. The noise
    of the channel passes the same bandwidth: normal, of standard deviation `noise_dn`, its correlation between pixels
    k apart on a line exp(−k² / 4 σ²), the Gaussian's with itself (Rice 1944, Bell Syst. Tech. J. 23, 282). Lines are
    independent of one another.

    Parameters
    ----------
    signal_dn : (H, W) float64
        From the amplifier.
    video : Video
        Noise and bandwidth.
    rng : Generator
        Draws the noise; not used without any.
    """
    out = _band_limit(signal_dn, video.line_blur_px)
    if video.noise_dn > 0.0:
        noise = np.zeros_like(signal_dn)
        apply_steps(noise, [Step(GAUSSIAN_NOISE, (1.0,), rng=rng)], noise)
        noise = _band_limit(noise, video.line_blur_px)
        impulse = np.zeros(signal_dn.shape[1])
        impulse[len(impulse) // 2] = 1.0
        left = float(np.sqrt(np.sum(_band_limit(impulse[None, :], video.line_blur_px) ** 2)))
        out = out + noise * (video.noise_dn / left)
    return out


def _band_limit(lines: FloatArray, sigma_px: float) -> FloatArray:
    """Lines (…, W) convolved with a Gaussian of sum 1; what is beyond their ends mirrors what is within."""
    if sigma_px == 0.0:
        return lines
    from scipy.ndimage import gaussian_filter1d

    return np.asarray(gaussian_filter1d(lines, sigma_px, axis=-1, mode="reflect", truncate=_KERNEL_SIGMAS))
