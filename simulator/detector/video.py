"""Analogue video: noise and limited bandwidth of a link or recorder before digitisation."""

from __future__ import annotations

import numpy as np

from simulator.detector.parameters import Video
from simulator.detector.pixels import apply_steps
from simulator.detector.steps import GAUSSIAN_NOISE, Step
from startracker.core import FloatArray

_KERNEL_SIGMAS = 5.0
"""Radius at which the impulse response is truncated, standard deviations."""


def video_signal(signal_dn: FloatArray, video: Video, rng: np.random.Generator) -> FloatArray:
    """Video signal (H, W), fractional DN: blurred along the lines, with noise of the same bandwidth.

    The impulse response of the channel is a Gaussian of `line_blur_px` along the line. The noise has the same
    bandwidth: it is Gaussian with standard deviation `noise_dn` and correlation exp(−k² / 4 σ²) between pixels k apart
    on a line, the autocorrelation of the impulse response (Rice 1944, Bell Syst. Tech. J. 23, 282). Lines are
    independent.

    Parameters
    ----------
    signal_dn : (H, W) float64
        Signal of the amplifier.
    video : Video
        Noise and bandwidth.
    rng : Generator
        For the noise; not used if there is none.
    """
    out = _band_limit(signal_dn, video.line_blur_px)
    if video.noise_dn > 0.0:
        noise = np.zeros_like(signal_dn)
        apply_steps(noise, [Step(GAUSSIAN_NOISE, (1.0,), rng=rng)], noise)
        noise = _band_limit(noise, video.line_blur_px)
        # The blur reduces white noise by the root of the sum of squares of its impulse response, for which the noise is
        # compensated.
        impulse = np.zeros(signal_dn.shape[1])
        impulse[len(impulse) // 2] = 1.0
        left = float(np.sqrt(np.sum(_band_limit(impulse[None, :], video.line_blur_px) ** 2)))
        out = out + noise * (video.noise_dn / left)
    return out


def _band_limit(lines: FloatArray, sigma_px: float) -> FloatArray:
    """Lines (…, W) convolved with a normalised Gaussian, with reflection at the ends."""
    if sigma_px == 0.0:
        return lines
    from scipy.ndimage import gaussian_filter1d

    return np.asarray(gaussian_filter1d(lines, sigma_px, axis=-1, mode="reflect", truncate=_KERNEL_SIGMAS))
