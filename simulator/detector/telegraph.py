"""Random telegraph pixels: their dark current switches at random times between two levels.

The levels have exponentially distributed durations with means τ_low and τ_high. This process is equivalent to one in
which the level is drawn again at each event of a Poisson process of rate 1/τ_low + 1/τ_high, the upper level with the
probability τ_high / (τ_low + τ_high): the rates of leaving the levels are then 1/τ_low and 1/τ_high (uniformisation of
a Markov chain; Ross 2014, *Introduction to Probability Models*, chapter 6). The level at an instant is therefore that
drawn at the last event before it, which can be found without the history of the device: time is divided into cells,
each with its own random stream, and the cells are searched backwards. The levels in the frames of a sequence have the
right correlation, in whatever order and on however many workers the frames are rendered.

Valid for exposures much shorter than the durations: the level at mid-exposure is used for the whole exposure.
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
"""Number of the cell at the epoch. The index of a random stream cannot be negative, but times before the epoch have
cells as well."""
_EVENTS_PER_CELL = 2.0
"""Mean number of events of a pixel in a cell; the length of the cells follows from it."""
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
    """Mean durations of the levels."""
    seed: int
    """Seed of the run."""

    def is_high(self, t_s: float) -> NDArray[np.bool_]:
        """(N,): Pixels in the upper level at a time, seconds after the epoch."""
        process, size = self.process, len(self.pixels)
        cell_s = _EVENTS_PER_CELL / (1.0 / process.low_s + 1.0 / process.high_s)
        cell = first = math.floor(t_s / cell_s)
        high, open_ = np.zeros(size, dtype=bool), np.arange(size)
        while open_.size:
            # Every cell draws numbers for all pixels, so that they do not depend on which pixels are still open.
            rng = stream(self.seed, "telegraph_cell", _FIRST_CELL + cell)
            number, level = rng.random(size), rng.random(size) < process.high_share  # of the last event of the cell
            if cell == first:
                counts = np.searchsorted(_POISSON, number, side="right")
                some, level = _last_before(t_s / cell_s - cell, counts, level, rng, process.high_share)
            else:
                some = number >= _POISSON[0]
            # A pixel is decided by the first cell, going backwards, in which it has an event.
            found = some[open_]
            high[open_[found]] = level[open_[found]]
            open_ = open_[~found]
            cell -= 1
        return high

    def without(self, dead: NDArray[np.bool_]) -> TelegraphPixels:
        """The same pixels with an amplitude of 0 for dead ones, given by a mask (H, W)."""
        return replace(self, amplitude_e_s=np.where(dead.flat[self.pixels], 0.0, self.amplitude_e_s))

    def add_to(self, mean_e: FloatArray, exposure_s: float, t_s: float) -> FloatArray:
        """Add the mean dark electrons of the pixels in the upper level, in place."""
        mean_e.flat[self.pixels] += exposure_s * self.amplitude_e_s * self.is_high(t_s)
        return mean_e


def telegraph_pixels(detector: DetectorParameters, dark_factor: float, seed: int) -> TelegraphPixels | None:
    """Random telegraph pixels of a device; None if there are none.

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

    The times of n events, uniformly distributed over the cell, are drawn from the last to the first: the largest of n
    uniform deviates on (0, T) has the distribution of T times the n-th root of a uniform deviate, and T is the time of
    the event after it. `last` is the level drawn at the latest event. The random numbers do not depend on `within`, so
    that all times of a cell see the same events.
    """
    some, level = np.zeros(len(counts), dtype=bool), np.zeros(len(counts), dtype=bool)
    pixels = np.flatnonzero(counts)
    left, now = counts[pixels], last[pixels]
    times = np.ones(len(pixels))
    while pixels.size:
        # `left` events remain, and `now` is the level drawn at the latest of them.
        times = times * rng.random(pixels.size) ** (1.0 / left)
        inside = (times < within) & ~some[pixels]
        some[pixels[inside]] = True
        level[pixels[inside]] = now[inside]
        more = left > 1
        pixels, left, times = pixels[more], left[more] - 1, times[more]
        now = rng.random(pixels.size) < high_share
    return some, level
