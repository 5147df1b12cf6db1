"""The prototype's bus addresses, clocks, state machine and output (Greyling 1995, Table 6.1 and Figs. 6.5 to 6.8)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from simulator.study.style import BLUE, GREEN, INK, ORANGE, SOFT, VERMILION
from simulator.theses.greyling1995.comparators import compare_levels, even_levels
from simulator.theses.greyling1995.sequencer import (
    COUNTS_PER_LINE,
    DUMMY_CELLS,
    SERIAL_CLOCK_HZ,
    STATE_TABLE,
    Sequencer,
    expose,
    next_state,
)
from simulator.theses.printed import new_figure
from simulator.theses.tables import Values

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["CONTROL", "FIGURES", "TERMS", "control_name", "line_signals", "output_signals", "terms_next", "values"]

FloatArray = NDArray[np.float64]

CONTROL = {0x300: "Camera", 0x302: "PC", 0x304: "Reset", 0x306: "Go"}
"""Table 6.1: addresses of the bus and what a write to them does."""

DARK_V, SATURATED_V = 8.0, 4.0
"""Section 6.2.3: level of a dark pixel at the amplified output, and of a saturated one."""

TERMS: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    ("T0·GO", "T0 GO", ("Q1", "A set")),
    ("T1", "T1", ("Q2",)),
    ("T2", "T2", ("Q1", "Q2")),
    ("T3", "T3", ("Q3",)),
    ("T4", "T4", ("Q3",)),
    ("T4·C1Z'", "T4 C1Z'", ("Q1",)),
    ("T5·C2Z'", "T5 C2Z'", ("Q1", "Q2")),
    ("T5·C2Z·B'", "T5 C2Z B'", ("Q2", "Q3")),
    ("T6", "T6", ("Q2",)),
    ("T6·C3Z'", "T6 C3Z'", ("A set", "B set")),
)
"""Products of the circuit: name, factors, the sums that it goes into. Q2 mended: T5·(C2Z·B)' = T5·C2Z' + T5·C2Z·B'."""

_SUMS = ("Q1", "Q2", "Q3", "A set", "B set")
_INPUTS = (*(f"T{k}" for k in range(7)), "GO", "C1Z", "C2Z", "C3Z", "B")


def control_name(address: int) -> str:
    """What a write to an address of the bus selects: lines A1 and A2 distinguish four addresses from 300H on."""
    names = list(CONTROL.values())
    return names[(address >> 1) & 3] if address & ~0b111 == 0x300 else ""


def terms_next(state: int, go: int, c1z: int, c2z: int, c3z: int, b: int) -> tuple[int, int, int]:
    """Next state, A_set and B_set by `TERMS`; as `next_state`."""
    value = {f"T{k}": state == k for k in range(7)} | {
        "GO": go == 1, "C1Z": c1z == 1, "C2Z": c2z == 1, "C3Z": c3z == 1, "B": b == 1,
    }  # fmt: skip
    sums = dict.fromkeys(_SUMS, 0)
    for _, factors, outputs in TERMS:
        if all(value[f.rstrip("'")] != f.endswith("'") for f in factors.split()):
            sums |= dict.fromkeys(outputs, 1)
    return sums["Q3"] << 2 | sums["Q2"] << 1 | sums["Q1"], sums["A set"], sums["B set"]


def line_signals(clocks: int = 2 * (COUNTS_PER_LINE + 2) + 4) -> dict[str, FloatArray]:
    """Signals (clocks,) from the first line of a clock-out on: states, count C1, IAG, SRG and the writing to memory."""
    sequencer = Sequencer(0)
    states: list[int] = []
    c1: list[int] = []
    iag: list[bool] = []
    written: list[bool] = []
    while len(states) < clocks:
        now, mode, count = sequencer.state, sequencer.mode, sequencer.c1
        pulse = sequencer.step()
        if mode != "clockout" or (not states and now != 3):
            continue
        kind = pulse.kind if pulse else ""
        states.append(now)
        c1.append(count)
        iag.append(kind == "line")
        written.append(kind == "pixel")
    state = np.array(states, dtype=float)
    return {
        "state": state,
        "C1": np.array(c1, dtype=float),
        "IAG": np.array(iag, dtype=float),
        "SRG": (state == 4).astype(float),
        "MW": np.array(written, dtype=float),
    }


def output_signals(light: FloatArray, samples: int = 40) -> dict[str, FloatArray]:
    """Signals over some pixels (Fig. 6.8), `samples` to a pixel of 0.5 µs.

    The output is at the dark level and dips by the charge in the second half of each pixel; S/H is high in the
    pixel's last quarter, the latch follows then and holds; /MW is low for a tenth of a pixel halfway between.

    Parameters
    ----------
    light : (P,) array
        Charge of the pixels over the full well, 0 to 1.
    samples : int
        Samples to a pixel.
    """
    phase = np.tile((np.arange(samples) + 0.5) / samples, len(light))
    charge = np.repeat(np.clip(light, 0.0, 1.0), samples)
    output = DARK_V - (DARK_V - SATURATED_V) * charge * (phase >= 0.5)
    hold = phase >= 0.75
    latch, value = np.empty_like(output), DARK_V
    for k, follows in enumerate(hold):
        value = output[k] if follows else value
        latch[k] = value
    middle = 0.875 - 0.5  # halfway between two S/H pulses
    write = (np.abs(phase - middle) < 0.05).astype(float)
    time_us = (np.arange(len(phase)) + 0.5) / samples * 1e6 / SERIAL_CLOCK_HZ
    return {"time_us": time_us, "output": output, "S/H": hold.astype(float), "latch": latch, "/MW": 1.0 - write}


def values() -> Values:
    """Table 6.1 and the figures' numbers."""
    names, found = list(CONTROL.values()), [control_name(address) for address in CONTROL]
    signals = line_signals()
    start, end = np.flatnonzero(signals["IAG"])[:2]
    agree = all(
        terms_next(row.state, go, c1z, c2z, c3z, b) == next_state(row.state, go, c1z, c2z, c3z, b)
        for row in STATE_TABLE
        for go, c1z, c2z, c3z, b in np.ndindex(2, 2, 2, 2, 2)
    )
    dark = np.zeros((165, 192))
    return {
        "names": ", ".join(names),
        "found": ", ".join(found),
        "right": found == names,
        "frame_ms": 1e3 * (expose(dark, 3).integration_s - expose(dark, 2).integration_s),
        "srg_pulses": signals["SRG"][start:end].sum(),
        "written": signals["MW"][start:end].sum(),
        "line_clocks": end - start,
        "dummy": DUMMY_CELLS,
        "terms": len(TERMS),
        "same": "the same" if agree else "other",
    }


def _steps(axes: Axes, x: NDArray[Any], signals: Iterable[tuple[str, NDArray[Any], str]]) -> None:
    """Logic signals above one another, the first on top."""
    names = []
    for k, (name, values, colour) in enumerate(reversed(list(signals))):
        axes.step(x, 1.4 * k + values, where="post", color=colour, linewidth=1.0)
        names.append(name)
    axes.set_yticks([1.4 * k + 0.5 for k in range(len(names))], names)
    axes.set_ylim(-0.3, 1.4 * len(names))
    axes.grid(visible=False, axis="y")


def _clock_figure() -> Figure:
    """Fig. 6.5: IAG and SRG over two lines, and the beginning of a line in detail."""
    figure, (left, right) = new_figure(1, 2, (9.0, 3.2))
    signals = line_signals()
    t_us = np.arange(len(signals["SRG"])) * 1e6 / SERIAL_CLOCK_HZ
    busy = [("IAG", signals["IAG"], VERMILION), ("SRG runs", signals["SRG"], BLUE), ("to memory", signals["MW"], GREEN)]
    _steps(left, t_us, busy)
    left.set(xlabel="time from a line's start [µs]", title="two lines of 105 µs")
    few, fine = 14, 20
    clock = np.tile(np.arange(fine) < fine // 2, few).astype(float)
    gate = [np.repeat(signals[name][:few], fine) for name in ("IAG", "SRG", "MW")]
    detail = [("clock, 2 MHz", clock, INK), ("IAG", gate[0], VERMILION), ("SRG", gate[1] * clock, BLUE)]
    _steps(right, np.arange(few * fine) / fine * 1e6 / SERIAL_CLOCK_HZ, [*detail, ("to memory", gate[2], GREEN)])
    right.set(xlabel="time from a line's start [µs]", title="its first 14 clocks")
    figure.suptitle("Fig. 6.5  Clock signals IAG and SRG", fontsize=10)
    return figure


_PLACES = {0: (0.0, 3.0), 1: (0.0, 2.0), 2: (0.0, 1.0), 3: (1.6, 1.0), 4: (3.2, 1.0), 5: (3.2, 2.2), 6: (1.6, 1.95)}
_DOES = {
    0: "wait for GO", 1: "Cm = 0, load C3", 2: "C2 = 165", 3: "C1 = 0", 4: "C1 + 1", 5: "C2 − 1", 6: "A = 0, C3 − 1",
}  # fmt: skip


def _state_figure() -> Figure:
    """Fig. 6.6: the states and what leads from one to the next, by Table 6.2."""
    figure, axes = new_figure(1, 1, (8.0, 4.6))
    for state, (x, y) in _PLACES.items():
        axes.text(x, y, f"T{state}\n{_DOES[state]}", ha="center", va="center", fontsize=8,
                  bbox={"boxstyle": "round,pad=0.4", "facecolor": "white", "edgecolor": INK})  # fmt: skip
    for row in STATE_TABLE:
        given = {"GO": row.go, "C1Z": row.c1z, "C2Z": row.c2z, "C3Z": row.c3z, "B": row.b}
        label = ", ".join(f"{name} = {value}" for name, value in given.items() if value is not None)
        if row.following == row.state:
            x, y = _PLACES[row.state]
            axes.text(x + (0.62 if row.state == 4 else -0.62), y, f"stays:\n{label}", ha="left" if row.state == 4
                      else "right", va="center", fontsize=7, color=SOFT)  # fmt: skip
            continue
        start, end = (np.array(_PLACES[k]) for k in (row.state, row.following))
        bend = 0.0 if row.c3z is None else 0.28 if row.c3z == 0 else -0.28
        axes.annotate("", xy=end, xytext=start, arrowprops={"arrowstyle": "->", "color": BLUE, "shrinkA": 30,
                      "shrinkB": 30, "connectionstyle": f"arc3,rad={bend}"})  # fmt: skip
        if label:
            shift = bend * np.array([-0.45, 0.8])  # to where the curve bends to
            axes.text(*(0.5 * (start + end) + shift), label, fontsize=7, color=VERMILION, ha="center", va="center",
                      bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6})  # fmt: skip
    axes.set(
        xlim=(-1.9, 4.8),
        ylim=(0.4, 3.6),
        xticks=[],
        yticks=[],
        xlabel="counters C1 (pixels), C2 (lines), C3 (frames of integration), Cm (memory); latches A and B",
        ylabel="states T0 to T6",
        title="Fig. 6.6  Camera state machine",
    )
    return figure


def _circuit_figure() -> Figure:
    """Fig. 6.7 as an array of products: which inputs each product takes, and which sums it goes into."""
    figure, axes = new_figure(1, 1, (8.0, 4.4))
    columns = {name: k for k, name in enumerate((*_INPUTS, *(f"{s} " for s in _SUMS)))}
    for k, (_, factors, outputs) in enumerate(TERMS):
        axes.axhline(k, color=SOFT, linewidth=0.5)
        for factor in factors.split():
            inverted = factor.endswith("'")
            axes.plot(columns[factor.rstrip("'")], k, "o", color=BLUE, markersize=7,
                      markerfacecolor="white" if inverted else BLUE)  # fmt: skip
        for output in outputs:
            axes.plot(columns[f"{output} "], k, "s", color=VERMILION, markersize=7)
    axes.plot([], [], "o", color=BLUE, label="input")
    axes.plot([], [], "o", color=BLUE, markerfacecolor="white", label="input, inverted")
    axes.plot([], [], "s", color=VERMILION, label="goes into the sum")
    axes.axvline(len(_INPUTS) - 0.5, color=INK, linewidth=1.0)
    axes.set_xticks(list(columns.values()), [name.strip() for name in columns])
    axes.set_yticks(range(len(TERMS)), [name for name, _, _ in TERMS])
    axes.invert_yaxis()
    axes.set(
        xlabel="decoded states and inputs | inputs of the D flip-flops and latches",
        ylabel="product (AND)",
        title="Fig. 6.7  Circuit of the state machine: products and sums",
    )
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=3)
    return figure


def _output_figure() -> Figure:
    """Fig. 6.8: output, sample and hold, latch, memory write, and the 2-bit value of each pixel."""
    figure, (top, bottom) = new_figure(2, 1, (7.6, 4.8), sharex=True, gridspec_kw={"height_ratios": [1.5, 1]})
    light = np.array([0.02, 0.1, 0.45, 0.8, 0.6, 0.3, 0.05, 0.0])
    signals = output_signals(light)
    top.plot(signals["time_us"], signals["output"], color=BLUE, label="output")
    top.plot(signals["time_us"], signals["latch"], color=VERMILION, linestyle="--", label="after the latch")
    codes = compare_levels(light, even_levels(2, 1.0))
    for k, code in enumerate(codes):
        top.text((k + 0.5) * 0.5, 8.35, f"{int(code):02b}", ha="center", color=INK)
    for level in even_levels(2, 1.0):
        top.axhline(DARK_V - (DARK_V - SATURATED_V) * float(level), color=SOFT, linewidth=0.7, linestyle=":")
    top.plot([], [], color=SOFT, linestyle=":", label="three comparators, two bits")
    top.set(ylim=(3.2, 9.0), xlabel="time [µs]", ylabel="level [V]")
    top.legend(loc="lower left", ncols=3)
    _steps(bottom, signals["time_us"], [("S/H", signals["S/H"], ORANGE), ("/MW", signals["/MW"], GREEN)])
    bottom.set(xlabel="time [µs]", ylabel="logic")
    figure.suptitle("Fig. 6.8  Output and associated signals", fontsize=10)
    return figure


FIGURES: dict[str, Callable[[], Figure]] = {
    "fig_6_5_clocks": _clock_figure,
    "fig_6_6_states": _state_figure,
    "fig_6_7_circuit": _circuit_figure,
    "fig_6_8_output": _output_figure,
}
"""File name to the function that draws it, in the order of the thesis."""
