"""Raw Bayer mosaics to grey images at full resolution."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker.errors import InputError

PATTERNS = ("RGGB", "BGGR", "GRBG", "GBRG")
"""Colours of the first two rows and columns, in reading order."""
_CLIP = 3.0
_MOST_SAMPLES = 65536


def bayer_to_grey(mosaic: ArrayLike, pattern: str = "RGGB", *, balance: bool = True) -> NDArray[np.float32]:
    """Raw Bayer mosaic as a grey image of the same size.

    There is no interpolation between colours, which would blur stars and correlate the noise. The sky of a mosaic has a
    checkered pattern, because red, green and blue differ in level and noise. With `balance`, each of the four sites is
    scaled to the sky level and noise of the green pixels: g' = (v − median) × (green noise / noise of this site) +
    green median, with the median and the clipped standard deviation of the sky. The light of a star still falls on
    filters of several colours, which shifts its centroid by up to some tenths of a pixel if its image is narrower than
    two pixels. Averaging the four sites (`mosaic[0::2, 0::2] + …`) avoids this at half the resolution.

    Parameters
    ----------
    mosaic : array_like, shape (H, W)
        Raw DN.
    pattern : str
        One of RGGB, BGGR, GRBG, GBRG.
    balance : bool
        False leaves the values unchanged.

    Returns
    -------
    float32 array, shape (H, W)

    Raises
    ------
    InputError
        Unknown pattern; not a two-dimensional array of numbers of at least 2×2.
    """
    if not isinstance(pattern, str) or pattern.upper() not in PATTERNS:
        raise InputError(f"bayer is {pattern!r}; it must be one of {', '.join(PATTERNS)}")
    raw = np.asarray(mosaic)
    if raw.ndim != 2 or min(raw.shape) < 2 or raw.dtype.kind not in "buif":
        raise InputError(
            f"a Bayer mosaic must be a 2-D array of real numbers, at least 2×2; got {raw.dtype}, shape {raw.shape}"
        )
    grey: NDArray[Any] = np.array(raw, dtype=np.float32)
    if not balance:
        return grey
    sites = {(row, column): _sky(grey[row::2, column::2]) for row in (0, 1) for column in (0, 1)}
    greens = [sites[divmod(k, 2)] for k in range(4) if pattern.upper()[k] == "G"]
    level, noise = np.mean([sky[0] for sky in greens]), np.mean([sky[1] for sky in greens])
    for (row, column), (site_level, site_noise) in sites.items():
        # A site without noise (black, or coarsely digitised) is only shifted.
        gain = noise / site_noise if noise > 0 and site_noise > 0 else 1.0
        grey[row::2, column::2] = (grey[row::2, column::2] - site_level) * gain + level
    return grey


def _sky(values: NDArray[np.float32]) -> tuple[float, float]:
    """Median and standard deviation of the values within 3σ of the median; (0, 0) if none is finite."""
    flat = values.reshape(-1)
    sample = flat[:: max(1, flat.size // _MOST_SAMPLES)].astype(np.float64)
    sample = sample[np.isfinite(sample)]
    if not len(sample):
        return 0.0, 0.0
    for _ in range(5):
        middle, spread = float(np.median(sample)), float(sample.std())
        inside = np.abs(sample - middle) <= _CLIP * spread
        if inside.all() or spread == 0.0:
            break
        sample = sample[inside]
    return float(np.median(sample)), float(sample.std())
