"""Width of the star images over many frames: a Kalman filter of a random walk."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from startracker.arguments import ABOVE_0, real_array, real_number
from startracker.centroid.frame import prepare
from startracker.centroid.psf_kernel import Starts
from startracker.centroid.psf_shape import Shape, fit_gaussian
from startracker.core import FloatArray
from startracker.detection.background import Background
from startracker.display import described
from startracker.settings import CentroidSettings

_STARS = 9
_FEWEST = 3
_HALF_PX = 8
_RIM_PX = 2
_LONGEST_RATIO = 1.5
"""Ratio of the variances along the axes above which an image is trailed and does not show the width of the lens."""
_CEILING = 0.9
"""Fraction of saturation above which a star is not measured."""
_SIGMA_OF_MAD = 1.4826
_NOISE_FREE = 1e-3
"""Minimum noise relative to the peak of the star."""
_MEDIAN_ERROR = math.sqrt(0.5 * math.pi)
_FEW_VALUES = 0.8
"""The median absolute deviation of n values is too small by n / (n − 0.8) (Croux & Rousseeuw 1992, COMPSTAT 1, 411)."""
_FIRST_WEIGHT = 4.0
"""Weight of the initial standard deviation as the scatter of single stars, in stars."""
_MEMORY = 0.98
"""Fading of the scatter of single stars from frame to frame."""
_GATE_SIGMAS = 5.0


def star_widths(
    image: NDArray[Any],
    xy: FloatArray,
    flux: FloatArray,
    saturation_dn: float | None,
    gain_e_per_dn: float | None,
) -> FloatArray:
    """Widths σ (N,), px, of the pixel-integrated Gaussians that fit the brightest stars best, at most nine.

    Saturated and trailed stars, and stars at the border, are excluded.

    Parameters
    ----------
    image : array, shape (H, W)
        DN.
    xy, flux : array, shape (M, 2), (M,)
        Positions and signal of stars.
    saturation_dn, gain_e_per_dn : float, optional
        Properties of the detector.
    """
    found: list[float] = []
    height, width = image.shape
    for star in np.argsort(-np.nan_to_num(flux)):
        x, y = (round(float(value)) for value in xy[star])
        inside = _HALF_PX <= x < width - _HALF_PX and _HALF_PX <= y < height - _HALF_PX
        if not inside or len(found) == _STARS:
            continue
        window = image[y - _HALF_PX : y + _HALF_PX + 1, x - _HALF_PX : x + _HALF_PX + 1].astype(np.float32)
        # Negated, so that a window that is NaN throughout is rejected, too.
        if saturation_dn is not None and not np.nanmax(window) < _CEILING * saturation_dn:
            continue
        xx, yy, xy_ = _shape(window, float(xy[star, 0]) - x, float(xy[star, 1]) - y, gain_e_per_dn)
        # The variances along the axes of the ellipse are middle ± spread.
        middle, spread = 0.5 * (xx + yy), math.hypot(0.5 * (xx - yy), xy_)
        if math.isfinite(middle) and middle + spread < _LONGEST_RATIO * (middle - spread):
            found.append(math.sqrt(middle))
    return np.array(found)


def _shape(window: NDArray[np.float32], dx: float, dy: float, gain_e_per_dn: float | None) -> Shape:
    """Variances and covariance of the star near the centre of a window; NaN if it cannot be fitted."""
    rim = np.ones(window.shape, np.bool_)
    rim[_RIM_PX:-_RIM_PX, _RIM_PX:-_RIM_PX] = False
    values = window[rim & np.isfinite(window)]
    if len(values) < rim.sum() // 2:
        return math.nan, math.nan, math.nan
    level = float(np.median(values))
    # In a noise-free image the scatter of the rim is zero, which would make the weights infinite.
    least = _NOISE_FREE * (float(np.nanmax(window)) - level)
    noise = max(_SIGMA_OF_MAD * float(np.median(np.abs(values - level))), least, 1e-30)
    flat = Background(np.full_like(window, level), np.full_like(window, noise))
    pixels = prepare(window, flat, CentroidSettings(), gain_e_per_dn).pixels
    half, start = _HALF_PX // 2, (1.0, 1.0, 0.0)
    starts = Starts(np.array([_HALF_PX + dx]), np.array([_HALF_PX + dy]), np.array([half]), np.array([np.inf]))
    found, _ = fit_gaussian(pixels, starts, np.zeros(1, np.int64), half, start)
    return found


class WidthFilter:
    """Recursive estimate of the width of star images.

    Parameters
    ----------
    sigma_px : float
        Initial standard deviation.
    drift_px_sqrt_s : float
        Drift per √s.
    width_px : float, optional
        Width of the calibration on the ground; None: as in the first frame.

    Notes
    -----
    The measurement of a frame is the median over its stars; its error is estimated from their scatter in this and
    previous frames, which includes their colours and positions in the field.
    """

    def __init__(self, sigma_px: float, drift_px_sqrt_s: float, width_px: float | None = None) -> None:
        sigma_px = real_number("sigma_px", sigma_px, least=0.0)
        self.width_px = math.nan if width_px is None else real_number("width_px", width_px, least=ABOVE_0)
        self.variance_px2 = sigma_px**2
        self.drift_px_sqrt_s = real_number("drift_px_sqrt_s", drift_px_sqrt_s, least=0.0)
        self.frames = 0
        self._scatter2, self._weight = _FIRST_WEIGHT * sigma_px**2, _FIRST_WEIGHT

    def __repr__(self) -> str:
        return described("WidthFilter", f"{self.width_px:.4f}±{self.sigma_px:.2g} px", f"{self.frames} frames")

    @property
    def sigma_px(self) -> float:
        """Standard deviation of the width."""
        return math.sqrt(self.variance_px2)

    def predict(self, dt_s: float) -> None:
        """Let the width drift for `dt_s` seconds."""
        dt_s = real_number("a step forward in time", dt_s, least=0.0)
        self.variance_px2 += self.drift_px_sqrt_s**2 * dt_s

    def update(self, widths_px: FloatArray) -> bool:
        """Update with the widths (N,) of the stars of a frame; returns whether they were used.

        At least three are needed, and their median must be within five standard deviations of the prediction.
        """
        widths_px = real_array("widths_px", widths_px, (None,))
        if len(widths_px) < _FEWEST:
            return False
        median = float(np.median(widths_px))
        count = len(widths_px)
        scatter = _SIGMA_OF_MAD * float(np.median(np.abs(widths_px - median))) * count / (count - _FEW_VALUES)
        # Pooled variance: the frames' squared scatters are weighted by their degrees of freedom and fade with age.
        weight = count - 1.0
        self._scatter2 = _MEMORY * self._scatter2 + weight * scatter**2
        self._weight = _MEMORY * self._weight + weight
        # Squared standard error of a median, π/2 times that of a mean.
        noise = max(_MEDIAN_ERROR**2 * self._scatter2 / self._weight / count, 1e-12)
        # Without a calibration on the ground, the first frame gives the initial width.
        if math.isnan(self.width_px):
            self.width_px, self.frames = median, 1
            self.variance_px2 = min(self.variance_px2, noise)
            return True
        innovation, variance = median - self.width_px, self.variance_px2 + noise
        if innovation**2 > _GATE_SIGMAS**2 * variance:
            return False
        gain = self.variance_px2 / variance
        self.width_px += gain * innovation
        self.variance_px2 *= 1.0 - gain
        self.frames += 1
        return True
