"""The per-pixel pipeline: a sequence of steps that act on single pixels, run over the image in tiles.

An image of a million pixels is larger than the processor's cache, and reading it from memory takes as long as most
effects. Therefore all steps are applied to one tile before the next tile is read. The noise of a pixel depends only on
the key of its step and on the number of the pixel.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from simulator.detector.charge import clip, collect
from simulator.detector.gaussian import add_gaussian
from simulator.detector.philox import fill_bits
from simulator.detector.poisson import LARGEST_MEAN, shot_noise
from simulator.detector.readout import amplify, bend, convert
from simulator.detector.steps import (
    AMPLIFY,
    BEND,
    CLIP,
    CONVERT,
    GAUSSIAN_NOISE,
    LIGHT,
    SHOT_NOISE,
    TILE,
    Collection,
    Step,
    begin,
)
from simulator.randomness import Key, Streams, draw_key
from startracker._compiled import kernel
from startracker.core import FloatArray, IntArray
from startracker.errors import InputError

_VALUES = 3
"""Largest number of values of a step."""


class Program(NamedTuple):
    """The K steps after charge collection, as arrays for the kernel."""

    kernels: IntArray
    """(K,): Numbers of the steps."""
    values: FloatArray
    """(K, 3): Values of the steps, padded with zeros."""
    keys: Key
    """(K, 2): Keys of the random streams; zeros for steps without noise."""


def apply_steps(signal: FloatArray, steps: Sequence[Step], out: NDArray[Any]) -> None:
    """Apply steps that have their own generators to an image; see `PixelPipeline`."""
    PixelPipeline(steps).run(signal, out)


class PixelPipeline:
    """Steps prepared for any number of images.

    Parameters
    ----------
    steps : sequence of Step
        Steps in order.
    """

    def __init__(self, steps: Sequence[Step]) -> None:
        self._collection, rest = begin(steps)
        self._values = np.zeros((len(rest), _VALUES))
        for k, step in enumerate(rest):
            self._values[k, : len(step.values)] = step.values
        self._kernels = np.array([step.kernel for step in rest], dtype=np.int64)
        self._random = [(k, step.rng) for k, step in enumerate(rest) if step.rng is not None]

    def run(
        self, signal: FloatArray, out: NDArray[Any], streams: Streams | None = None, exposure_s: float = 1.0
    ) -> None:
        """Apply the steps to an image.

        Parameters
        ----------
        signal : (H, W) float64, contiguous
            Not modified.
        out : (H, W) float64 or uint16, contiguous
            Output; may be `signal`. uint16 needs integers in range, with `CONVERT` as the last step.
        streams : callable, optional
            Returns the generators of steps that name their streams.
        exposure_s : float
            Exposure time, by which dark currents are multiplied.

        Raises
        ------
        InputError
            If light is negative or not finite, or the Poisson mean, with response and dark current, is not in 0 to
            `LARGEST_MEAN`.
        """
        if not (signal.flags.c_contiguous and out.flags.c_contiguous):
            raise ValueError("the per-pixel pipeline works on C-contiguous arrays only")
        # Each random step draws its key once per image; the noise of all pixels follows from it.
        keys = np.zeros((len(self._kernels), 2), dtype=np.uint64)
        for k, source in self._random:
            if isinstance(source, str):
                assert streams is not None, "a step names its stream, but no streams are given"
                keys[k] = draw_key(streams(source))
            else:
                keys[k] = draw_key(source)
        program = Program(self._kernels, self._values, keys)
        stopped = _run(signal.reshape(-1), self._collection, exposure_s, program, out.reshape(-1))
        if stopped == LIGHT:
            raise InputError("mean_photo_e has a pixel that is negative or not finite")
        if stopped == SHOT_NOISE:
            raise InputError(f"the mean electrons of a pixel must be in 0 to {LARGEST_MEAN:g}")


@kernel
def _run(signal: FloatArray, collection: Collection, exposure_s: float, program: Program, out: NDArray[Any]) -> int:
    """Kernel of `PixelPipeline.run`; returns the number of the step that rejected the signal, or −1."""
    bits, one, two = np.empty(TILE, np.uint32), np.empty(TILE, np.float32), np.empty(TILE, np.float32)
    tile = np.empty(TILE)
    for first in range(0, signal.size, TILE):
        stop = min(first + TILE, signal.size)
        run, target = tile[: stop - first], out[first:stop]
        if not collect(run, signal[first:stop], collection, exposure_s, first):
            return LIGHT
        for k in range(program.kernels.size):
            kernel, value, key = program.kernels[k], program.values[k], program.keys[k]
            # Each block of random bits serves four pixels, so counters advance by a quarter of the pixels.
            if kernel in (SHOT_NOISE, GAUSSIAN_NOISE):
                fill_bits(key, np.uint64(first // 4), np.uint64(0), bits)
            if kernel == SHOT_NOISE:
                if not shot_noise(run, key, first, bits, one, two):
                    return SHOT_NOISE
            elif kernel == CLIP:
                clip(run, value[0])
            elif kernel == GAUSSIAN_NOISE:
                add_gaussian(run, value[0], key, first, bits, one)
            elif kernel == BEND:
                bend(run, value[0], value[1], value[2])
            elif kernel == AMPLIFY:
                amplify(run, value[0], value[1])
            elif kernel == CONVERT:
                convert(run, value[0])
        for i in range(run.size):  # the compiler vectorises this loop, but not the assignment of a slice
            target[i] = run[i]
    return -1
