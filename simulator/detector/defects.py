"""Defects of a device: pixels and columns that glow, and such that are dead."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simulator.randomness import stream
from simulator.scenario.schema import DetectorSection
from startracker.errors import InputError


def hot_defects(
    section: DetectorSection, dark_factor: float, seed: int
) -> tuple[NDArray[np.float64], NDArray[np.bool_]] | None:
    """Dark electrons on top of the ordinary ones and the places they come from, (H, W) each; None without hot defects.

    Parameters
    ----------
    section : DetectorSection
        The detector.
    dark_factor : float
        Exposure, seconds, times the dark current relative to that at the reference temperature.
    seed : int
        Seed of the run; streams ``hot_pixels`` and ``hot_columns`` of the device.
    """
    shape = (section.height, section.width)
    pixels = section.hot_pixel_fraction > 0 and section.hot_pixel_dark_e_s > 0
    columns = section.hot_columns > 0 and section.hot_column_dark_e_s > 0
    if not (pixels or columns):
        return None
    dark, places = np.zeros(shape), np.zeros(shape, dtype=bool)
    if pixels:
        rng = stream(seed, "hot_pixels")
        chosen = _some_pixels(section.hot_pixel_fraction, dark.size, rng)
        dark.flat[chosen] = rng.exponential(section.hot_pixel_dark_e_s * dark_factor, size=chosen.size)
        places.flat[chosen] = True
    if columns:
        rng = stream(seed, "hot_columns")
        chosen = _some_columns("hot_columns", section.hot_columns, section.width, rng)
        dark[:, chosen] += rng.exponential(section.hot_column_dark_e_s * dark_factor, size=chosen.size)
        places[:, chosen] = True
    return dark, places


def dead_defects(section: DetectorSection, seed: int) -> NDArray[np.bool_] | None:
    """Dead pixels and columns, (H, W); None without any. Streams ``dead_pixels`` and ``dead_columns`` of the device."""
    if not (section.dead_pixel_fraction > 0 or section.dead_columns > 0):
        return None
    places = np.zeros((section.height, section.width), dtype=bool)
    if section.dead_pixel_fraction > 0:
        chosen = _some_pixels(section.dead_pixel_fraction, places.size, stream(seed, "dead_pixels"))
        places.flat[chosen] = True
    if section.dead_columns > 0:
        rng = stream(seed, "dead_columns")
        places[:, _some_columns("dead_columns", section.dead_columns, section.width, rng)] = True
    return places


def _some_pixels(fraction: float, pixels: int, rng: np.random.Generator) -> NDArray[np.int64]:
    return rng.choice(pixels, size=rng.binomial(pixels, fraction), replace=False)


def _some_columns(key: str, count: int, width: int, rng: np.random.Generator) -> NDArray[np.int64]:
    if count > width:
        raise InputError(f"detector.{key} = {count} is more than the {width} columns there are; lower it")
    return rng.choice(width, size=count, replace=False)
