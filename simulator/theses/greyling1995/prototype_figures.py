"""Figures of the prototype camera (Greyling 1995, chapter 6)."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from simulator.detector.comparators import even_levels
from simulator.detector.sequencer import SERIAL_CLOCK_HZ, Sequencer
from simulator.study.style import BLUE, GREEN, INK, ORANGE, SOFT, VERMILION
from simulator.theses.greyling1995.converter import BITS, converter_trials
from simulator.theses.greyling1995.holes import SLOW_CLOCK_HZ, camera, memory_image, smear_share
from simulator.theses.printed import new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["FIGURES", "POSITION_PX"]

POSITION_PX = 0.1
"""Accuracy that section 7.2 asks of the positions: L/10."""
_CLOCKS_HZ = np.geomspace(5e4, 3.26e6, 25)
_FIG_DEFOCUS_UM = 120.0


def _fig_modes() -> Figure:
    """Fig. 6.4: clear, integration, clock-out, with the gates."""
    figure, ax = new_figure(size=(6.4, 2.8))
    sequencer = Sequencer(2)
    modes: list[tuple[str, int]] = []
    while sequencer.clock == 0 or sequencer.state != 0:
        sequencer.step()
        if sequencer.state in (2, 3, 4, 5) and (not modes or modes[-1][0] != sequencer.mode):
            modes.append((sequencer.mode, sequencer.clock))
    ends = [*(start for _, start in modes[1:]), sequencer.clock]
    to_ms = 1e3 / SERIAL_CLOCK_HZ
    colours = {"clear": SOFT, "integration": BLUE, "clockout": VERMILION}
    words = {"clear": "clear", "integration": "integration, N = 2", "clockout": "clock-out"}
    for (mode, start), end in zip(modes, ends, strict=True):
        width = (end - start) * to_ms
        ax.broken_barh([(start * to_ms, width)], (2.1, 0.8), color=colours[mode])
        ax.text((start + end) / 2 * to_ms, 2.5, words[mode], color="white", ha="center", va="center")
        if mode != "integration":
            ax.broken_barh([(start * to_ms, width)], (1.1, 0.8), color=GREEN)
        ax.broken_barh([(start * to_ms, width)], (0.1, 0.8), color=ORANGE)
    ax.set_yticks([2.5, 1.5, 0.5], ["mode", "IAG, 165 lines", "SRG, 2 MHz"])
    ax.set_xlabel("time after GO [ms]")
    ax.grid(visible=False, axis="y")
    return figure


def _show_levels(ax: Axes, codes: NDArray[np.uint16], title: str) -> None:
    pitch_x, pitch_y = camera().detector.pitch_um
    ax.imshow(codes, cmap="gray", vmin=0, vmax=3, aspect=pitch_y / pitch_x, interpolation="nearest")
    ax.set_title(title)
    ax.set_xlabel("column [pixels]")
    ax.set_ylabel("line [pixels]")
    ax.grid(visible=False)


def _fig_focus() -> Figure:
    """Fig. 6.9: holes out of focus, and in focus."""
    figure, axes = new_figure(1, 2, size=(7.6, 3.6))
    for ax, defocus_um in zip(axes, (_FIG_DEFOCUS_UM, 0.0), strict=True):
        _show_levels(ax, memory_image(SERIAL_CLOCK_HZ, defocus_um=defocus_um), f"{defocus_um:g} µm out of focus")
    return figure


def _fig_holes(clock_hz: float) -> Figure:
    """Figs. 6.10 and 6.11: holes in a box, one frame time, at one clock."""
    figure, ax = new_figure(size=(4.8, 4.2))
    _show_levels(ax, memory_image(clock_hz), f"{clock_hz / 1e6:g} MHz, integration of one frame")
    return figure


def _fig_smear() -> Figure:
    """Smear beside a hole over its peak, against the clock."""
    figure, ax = new_figure()
    frames = [100 * smear_share(clock, frames=1) for clock in _CLOCKS_HZ]
    seconds = [100 * smear_share(clock, integration_s=0.2) for clock in _CLOCKS_HZ]
    ax.loglog(_CLOCKS_HZ / 1e6, frames, "-o", color=BLUE, markersize=3, label="integration of one frame")
    ax.loglog(_CLOCKS_HZ / 1e6, seconds, "--s", color=ORANGE, markersize=3, label="integration of 0.2 s")
    lowest = 100 * float(even_levels(2, 1.0)[0])
    ax.axhline(lowest, color=INK, linewidth=0.8, linestyle=":", label="lowest of three even levels")
    ax.set_xticks([0.05, 0.1, 0.2, 0.5, 1, 2], ["0.05", "0.1", "0.2", "0.5", "1", "2"])
    ax.minorticks_off()
    ax.set_xlabel("serial clock [MHz]")
    ax.set_ylabel("smear over the hole's peak [%]")
    ax.legend()
    return figure


def _fig_converter() -> Figure:
    """Error of the centroid against the bits of the converter."""
    figure, ax = new_figure()
    trials = converter_trials()
    for peak, colour, style in ((0.8, BLUE, "-o"), (0.04, ORANGE, "--s")):
        found = [(bits, trials[f"{bits} bits", peak].error_px) for bits in BITS]
        shown = [(bits, error) for bits, error in found if math.isfinite(error)]
        ax.semilogy(
            *zip(*shown, strict=True), style, color=colour, markersize=4, label=f"peak at {peak:g} of full well"
        )
        geometric = trials["2 bits, geometric levels", peak].error_px
        if math.isfinite(geometric):
            ax.semilogy(2, geometric, "^", color=colour, markersize=7, label=f"{peak:g}, levels of equal ratio")
    ax.axhline(POSITION_PX, color=INK, linewidth=0.8, linestyle=":", label="a tenth of a pixel (section 7.2)")
    ax.set_xticks(BITS)
    ax.set_xlabel("converter [bits]")
    ax.set_ylabel("centroid error, rms of an axis [pixels]")
    ax.legend()
    return figure


FIGURES: dict[str, Callable[[], Figure]] = {
    "fig_6_4_modes": _fig_modes,
    "fig_6_9_focus": _fig_focus,
    "fig_6_10_slow_clock": partial(_fig_holes, SLOW_CLOCK_HZ),
    "fig_6_11_2_mhz": partial(_fig_holes, SERIAL_CLOCK_HZ),
    "fig_6_smear_against_clock": _fig_smear,
    "fig_6_converter": _fig_converter,
}
"""File name to the function that draws it, in the order of the thesis."""
