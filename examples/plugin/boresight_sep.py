"""A detector for boresight that calls SEP, the Source Extractor of Bertin & Arnouts (1996) as a library (Barbary 2016).

Installing this package is all that boresight needs: it finds the function through the entry point in pyproject.toml.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import sep
from numpy.typing import NDArray

from startracker import DetectionSettings
from startracker.detection import Background, Spots

__all__ = ["find_with_sep"]

_SIGMA_PX = 0.8
"""Width of the star images for the filter where the settings give none, as for boresight's own detectors."""


def find_with_sep(
    image: NDArray[Any],
    background: Background,
    settings: DetectionSettings,
    saturation_dn: float | None = None,
) -> Spots:
    """Star candidates by SEP: threshold on the filtered image, deblending, cleaning.

    Parameters
    ----------
    image : array, shape (H, W)
        DN; pixels that are not finite are masked.
    background : Background
        Level and noise of every pixel, which SEP need not estimate again.
    settings : DetectionSettings
        `threshold_sigma`, `min_pixels`, `max_pixels`, `max_axis_ratio`, `max_stars`, `matched_filter`, `psf_sigma_px`.
    saturation_dn : float, optional
        DN from which a pixel counts as saturated.

    Returns
    -------
    Spots
        Brightest first, with the number of rejected candidates by reason.
    """
    pixels = np.asarray(image, dtype=np.float32)
    bad = ~np.isfinite(pixels)
    signal = np.ascontiguousarray(np.where(bad, 0.0, pixels - background.level), dtype=np.float32)
    found = sep.extract(
        signal,
        settings.threshold_sigma,
        err=np.ascontiguousarray(background.noise, dtype=np.float32),
        mask=bad,
        minarea=1 if settings.matched_filter else settings.min_pixels,
        filter_kernel=_star_image(settings.psf_sigma_px or _SIGMA_PX) if settings.matched_filter else None,
    )
    large = found["npix"] > settings.max_pixels
    long = ~large & (found["a"] > settings.max_axis_ratio * np.maximum(found["b"], 0.1))
    keep = np.flatnonzero(~large & ~long & (found["flux"] > 0))
    keep = keep[np.argsort(-found["flux"][keep], kind="stable")][: settings.max_stars]
    star = found[keep]
    peak_dn = pixels[star["ypeak"], star["xpeak"]]
    return Spots(
        x_peak=star["xpeak"].astype(np.int64),
        y_peak=star["ypeak"].astype(np.int64),
        flux=star["flux"].astype(np.float64),
        pixels=star["npix"].astype(np.int64),
        saturated=peak_dn >= (np.inf if saturation_dn is None else saturation_dn),
        edge=(star["flag"] & sep.OBJ_TRUNC) > 0,
        centre=np.stack([star["x"], star["y"]], axis=1),
        streak=np.zeros((len(star), 2)),
        rejected={"too large": int(large.sum()), "too long": int(long.sum())},
    )


def _star_image(sigma_px: float) -> NDArray[np.float32]:
    """Kernel of the matched filter: a Gaussian out to three standard deviations."""
    reach = max(1, int(np.ceil(3.0 * sigma_px)))
    square = np.arange(-reach, reach + 1) ** 2
    return np.exp(-(square[:, None] + square[None, :]) / (2.0 * sigma_px**2)).astype(np.float32)
