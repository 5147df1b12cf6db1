"""Random telegraph pixels: their dark current switches at random times between two levels.

The levels have exponentially distributed durations with means τ_low and τ_high. Such a process is the same as one in
which, at the events of a Poisson process of rate 1/τ_low + 1/τ_high, the level is drawn again, the upper one with the
probability τ_high / (τ_low + τ_high): the rates of leaving the levels are then 1/τ_low and 1/τ_high (uniformisation of
a Markov chain; Ross 2014, *Introduction to Probability Models*, chapter 6). The level at an instant is therefore that
of the last event before it, and is found without the history of the device: time is divided into cells, each with its
own random stream, and the cells are searched backwards. Frames of a sequence are correlated as they should be, in any
order and on any number of workers.

Valid for exposures much shorter than the durations: the level at mid-exposure holds for the exposure.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simulator.detector.defects import some_pixels
from simulator.detector.parameters import DetectorParameters, RandomTelegraph
from simulator.randomness import stream
from startracker.core import FloatArray

_FIRST_CELL = 2**40
"""Cell of the epoch: the index of a random stream cannot be negative, and times before the epoch have cells too."""
_EVENTS_PER_CELL = 2.0
_POISSON = np.cumsum([math.exp(-_EVENTS_PER_CELL) * _EVENTS_PER_CELL**n / math.factorial(n) for n in range(24)])
"""Probability of up to n events in a cell."""


@dataclass(frozen=True, eq=False)
class TelegraphPixels:
    """Random telegraph pixels of one device at one temperature."""

    pixels: NDArray[np.int64]
    """(N,): Flat indices."""
    amplitude_e_s: FloatArray
    """(N,): Upper minus lower level."""
    process: RandomTelegraph
    seed: int

    def is_high(self, t_s: float) -> NDArray[np.bool_]:
        """(N,): Pixels in the upper level at a time, seconds after the epoch."""
        process, size = self.process, len(self.pixels)
        cell_s = _EVENTS_PER_CELL / (1.0 / process.low_s + 1.0 / process.high_s)
        cell = first = math.floor(t_s / cell_s)
        high, open_ = np.zeros(size, dtype=bool), np.arange(size)
        while open_.size:
            rng = stream(self.seed, "telegraph_cell", _FIRST_CELL + cell)
            number, level = rng.random(size), rng.random(size) < process.high_share  # of the last event of the cell
            if cell == first:
                counts = np.searchsorted(_POISSON, number, side="right")
                some, level = _last_before(t_s / cell_s - cell, counts, level, rng, process.high_share)
            else:
                some = number >= _POISSON[0]
            found = some[open_]
            high[open_[found]] = level[open_[found]]
            open_ = open_[~found]
            cell -= 1
        return high

    def without(self, dead: NDArray[np.bool_]) -> TelegraphPixels:
        """The same with dead pixels (H, W), which collect no dark current, switched off."""
        return replace(self, amplitude_e_s=np.where(dead.flat[self.pixels], 0.0, self.amplitude_e_s))

    def add_to(self, mean_e: FloatArray, exposure_s: float, t_s: float) -> FloatArray:
        """Add the mean dark electrons of the pixels in the upper level, in place."""
        mean_e.flat[self.pixels] += exposure_s * self.amplitude_e_s * self.is_high(t_s)
        return mean_e


def telegraph_pixels(detector: DetectorParameters, dark_factor: float, seed: int) -> TelegraphPixels | None:
    """Random telegraph pixels of a device; None without any.

    Parameters
    ----------
    detector : DetectorParameters
        The detector.
    dark_factor : float
        Dark current relative to that at the reference temperature.
    seed : int
        Seed of the run; stream ``telegraph`` of the device, and ``telegraph_cell`` of cells of time.
    """
    process = detector.telegraph
    if not (process.pixel_fraction > 0 and process.dark_e_s > 0):
        return None
    rng = stream(seed, "telegraph")
    chosen = np.sort(some_pixels(process.pixel_fraction, detector.width * detector.height, rng))
    return TelegraphPixels(chosen, rng.exponential(process.dark_e_s * dark_factor, len(chosen)), process, seed)


def _last_before(
    within: float,
    counts: NDArray[np.int64],
    last: NDArray[np.bool_],
    rng: np.random.Generator,
    high_share: float,
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Whether each pixel has an event in the first part `within` of a cell, and the level of the last of these.

    The times of n events, evenly distributed over the cell, are drawn from the last to the first: the latest of n is
    the n-th root of a uniform deviate times the time of its successor. `last` is the level of the latest event. The
    random numbers do not depend on `within`.
    """
    some, level = np.zeros(len(counts), dtype=bool), np.zeros(len(counts), dtype=bool)
    pixels = np.flatnonzero(counts)
    left, now = counts[pixels], last[pixels]
    times = np.ones(len(pixels))
    while pixels.size:
        times = times * rng.random(pixels.size) ** (1.0 / left)
        inside = (times < within) & ~some[pixels]
        some[pixels[inside]] = True
        level[pixels[inside]] = now[inside]
        more = left > 1
        pixels, left, times = pixels[more], left[more] - 1, times[more]
        now = rng.random(pixels.size) < high_share
    return some, level
