"""Defects of a device: hot and dead pixels and columns, and dark current by displacement damage."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simulator.detector.parameters import DetectorParameters
from simulator.randomness import stream
from startracker.errors import InputError


def hot_defects(
    detector: DetectorParameters, dark_factor: float, seed: int
) -> tuple[NDArray[np.float64], NDArray[np.bool_]] | None:
    """Additional dark current of hot pixels and columns, electrons per second, and the mask of these pixels, (H, W)
    each; None if there are none.

    Parameters
    ----------
    detector : DetectorParameters
        The detector.
    dark_factor : float
        Dark current relative to that at the reference temperature.
    seed : int
        Seed of the run; streams ``hot_pixels`` and ``hot_columns`` of the device.
    """
    shape = (detector.height, detector.width)
    pixels = detector.hot_pixel_fraction > 0 and detector.hot_pixel_dark_e_s > 0
    columns = detector.hot_columns > 0 and detector.hot_column_dark_e_s > 0
    if not (pixels or columns):
        return None
    dark, where = np.zeros(shape), np.zeros(shape, dtype=bool)
    if pixels:
        rng = stream(seed, "hot_pixels")
        chosen = some_pixels(detector.hot_pixel_fraction, dark.size, rng)
        dark.flat[chosen] = rng.exponential(detector.hot_pixel_dark_e_s * dark_factor, size=chosen.size)
        where.flat[chosen] = True
    if columns:
        # All pixels of a hot column share one current.
        rng = stream(seed, "hot_columns")
        chosen = _some_columns("hot_columns", detector.hot_columns, detector.width, rng)
        dark[:, chosen] += rng.exponential(detector.hot_column_dark_e_s * dark_factor, size=chosen.size)
        where[:, chosen] = True
    return dark, where


def displacement_dark(detector: DetectorParameters, dark_factor: float, seed: int) -> NDArray[np.float64] | None:
    """Dark current by displacement damage, electrons per second, (H, W); None if there is none.

    The number of interactions in a pixel has a Poisson distribution, and the sum of n exponentially distributed
    dark currents a gamma distribution of shape n. Stream ``displacement`` of the device; parameters as in
    `hot_defects`.
    """
    damage = detector.displacement
    if not damage.mean_e_s > 0:
        return None
    rng = stream(seed, "displacement")
    interactions = rng.poisson(damage.interactions_per_pixel, size=(detector.height, detector.width))
    dark = np.zeros(interactions.shape)
    struck = interactions > 0
    dark[struck] = rng.standard_gamma(interactions[struck]) * (damage.dark_e_s * dark_factor)
    return dark


def dead_defects(detector: DetectorParameters, seed: int) -> NDArray[np.bool_] | None:
    """Mask (H, W) of dead pixels and columns; None if there are none. Streams ``dead_pixels`` and ``dead_columns`` of
    the device."""
    if not (detector.dead_pixel_fraction > 0 or detector.dead_columns > 0):
        return None
    where = np.zeros((detector.height, detector.width), dtype=bool)
    if detector.dead_pixel_fraction > 0:
        chosen = some_pixels(detector.dead_pixel_fraction, where.size, stream(seed, "dead_pixels"))
        where.flat[chosen] = True
    if detector.dead_columns > 0:
        rng = stream(seed, "dead_columns")
        where[:, _some_columns("dead_columns", detector.dead_columns, detector.width, rng)] = True
    return where


def some_pixels(fraction: float, pixels: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Flat indices of a binomial number of pixels, each chosen once, in random order."""
    return rng.choice(pixels, size=rng.binomial(pixels, fraction), replace=False)


def _some_columns(key: str, count: int, width: int, rng: np.random.Generator) -> NDArray[np.int64]:
    if count > width:
        raise InputError(f"detector.{key} = {count} exceeds the {width} columns of the detector; lower it")
    return rng.choice(width, size=count, replace=False)
