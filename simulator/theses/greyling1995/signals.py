"""The prototype's bus addresses, clocks, state machine and output (Greyling 1995, Table 6.1 and Figs. 6.5 to 6.8)."""

from __future__ import annotations

from typing import Any

import numpy as np

from simulator.theses.greyling1995.converter import compare_levels, even_levels
from simulator.theses.greyling1995.sequencer import (
    COUNTS_PER_LINE,
    DUMMY_CELLS,
    SERIAL_CLOCK_HZ,
    STATE_TABLE,
    Sequencer,
    expose,
    next_state,
)
from simulator.theses.tables import Values
from startracker.core import FloatArray

CONTROL = {0x300: "Camera", 0x302: "PC", 0x304: "Reset", 0x306: "Go"}
"""Table 6.1: bus addresses and the effect of a write to them."""

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
"""Products of the circuit: name, factors, and sums that include it. Q2 corrected: T5·(C2Z·B)' = T5·C2Z' + T5·C2Z·B'."""

_SUMS = ("Q1", "Q2", "Q3", "A set", "B set")
_INPUTS = (*(f"T{k}" for k in range(7)), "GO", "C1Z", "C2Z", "C3Z", "B")


def control_name(address: int) -> str:
    """Function selected by a write to a bus address: lines A1 and A2 distinguish four addresses from 300H on."""
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


def line_signals() -> dict[str, FloatArray]:
    """Signals over the first two lines of a clock-out: states, count C1, IAG, SRG and writes to memory."""
    sequencer = Sequencer(0)
    found: list[tuple[int, int, str]] = []
    while len(found) < 2 * (COUNTS_PER_LINE + 2) + 4:
        now, mode, count = sequencer.state, sequencer.mode, sequencer.c1
        pulse = sequencer.step()
        if mode == "clockout" and (found or now == 3):
            found.append((now, count, pulse.kind if pulse else ""))
    state, c1, kind = (np.array(column) for column in zip(*found, strict=True))
    signals = {"state": state, "C1": c1, "IAG": kind == "line", "SRG": state == 4, "MW": kind == "pixel"}
    return {name: signal.astype(float) for name, signal in signals.items()}


def output_signals(light: FloatArray, samples: int = 40) -> dict[str, FloatArray]:
    """Signals over pixels of 0.5 µs with a charge `light`, 0 to 1 of the full well (Fig. 6.8), `samples` to a pixel.

    The output is at the dark level and decreases with the charge in the second half of each pixel; S/H is high in the
    last quarter of a pixel, when the latch follows the signal; /MW is low for a tenth of a pixel halfway between.
    """
    phase = np.tile((np.arange(samples) + 0.5) / samples, len(light))
    charge = np.repeat(np.clip(light, 0.0, 1.0), samples)
    output = DARK_V - (DARK_V - SATURATED_V) * charge * (phase >= 0.5)
    hold = phase >= 0.75
    followed = np.maximum.accumulate(np.where(hold, np.arange(len(hold)), -1))
    latch = np.where(followed < 0, DARK_V, output[followed])
    middle = 0.875 - 0.5  # halfway between two S/H pulses
    write = (np.abs(phase - middle) < 0.05).astype(float)
    time_us = (np.arange(len(phase)) + 0.5) / samples * 1e6 / SERIAL_CLOCK_HZ
    return {"time_us": time_us, "output": output, "S/H": hold.astype(float), "latch": latch, "/MW": 1.0 - write}


def values() -> Values:
    """Values of Table 6.1 and the figures."""
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
        "clock_signals": _clocks,
        "states": _states,
        "circuit": _circuit,
        "output": _output,
    }


def _raised(signals: dict[str, FloatArray]) -> Values:
    """Logic signals stacked with the first on top, with labelled ticks."""
    below = list(reversed(signals))
    steps = [{"signal": 1.4 * k + signals[name]} for k, name in enumerate(below)]
    ticks = [1.4 * k + 0.5 for k in range(len(below))]
    return {"steps": steps, "ticks": ticks, "names": below, "range": (-0.3, 1.4 * len(below))}


def _clocks() -> Values:
    """IAG and SRG over two lines, and the beginning of a line in detail."""
    signals = line_signals()
    few, fine = 14, 20
    clock = np.tile(np.arange(fine) < fine // 2, few).astype(float)
    iag, srg, written = (np.repeat(signals[name][:few], fine) for name in ("IAG", "SRG", "MW"))
    detail = {"clock, 2 MHz": clock, "IAG": iag, "SRG": srg * clock, "to memory": written}
    return {
        "t_us": np.arange(len(signals["SRG"])) * 1e6 / SERIAL_CLOCK_HZ,
        "lines": _raised({"IAG": signals["IAG"], "SRG runs": signals["SRG"], "to memory": signals["MW"]}),
        "detail_us": np.arange(few * fine) / fine * 1e6 / SERIAL_CLOCK_HZ,
        "detail": _raised(detail),
    }


_AT = {0: (0.0, 3.0), 1: (0.0, 2.0), 2: (0.0, 1.0), 3: (1.6, 1.0), 4: (3.2, 1.0), 5: (3.2, 2.2), 6: (1.6, 1.95)}
_DOES = ("wait for GO", "Cm = 0, load C3", "C2 = 165", "C1 = 0", "C1 + 1", "C2 − 1", "A = 0, C3 − 1")


def _states() -> Values:
    """The states and their transitions, by Table 6.2."""
    stays: list[Values] = []
    arrows: list[Values] = []
    labels: list[Values] = []
    for row in STATE_TABLE:
        given = {"GO": row.go, "C1Z": row.c1z, "C2Z": row.c2z, "C3Z": row.c3z, "B": row.b}
        label = ", ".join(f"{name} = {value}" for name, value in given.items() if value is not None)
        start, end = (np.array(_AT[k]) for k in (row.state, row.following))
        if row.following == row.state:
            side, align = (0.62, "left") if row.state == 4 else (-0.62, "right")
            stays.append({"x": start[0] + side, "y": start[1], "label": label, "align": align})
            continue
        bend = 0.0 if row.c3z is None else 0.28 if row.c3z == 0 else -0.28
        arrows.append({"start": start, "end": end, "bend": bend})
        if label:
            x, y = 0.5 * (start + end) + bend * np.array([-0.45, 0.8])  # the direction of the curvature
            labels.append({"x": x, "y": y, "label": label})
    states = [{"x": x, "y": y, "text": f"T{state}\n{_DOES[state]}"} for state, (x, y) in _AT.items()]
    return {"states": states, "stays": stays, "arrows": arrows, "labels": labels}


def _circuit() -> Values:
    """The circuit as an array of products: inputs of each product, and sums that include it."""
    columns = {name: k for k, name in enumerate((*_INPUTS, *(f"{s} " for s in _SUMS)))}
    inputs = [
        {"x": columns[factor.rstrip("'")], "y": k, "inverted": factor.endswith("'")}
        for k, (_, factors, _) in enumerate(TERMS)
        for factor in factors.split()
    ]
    plain, inverted = ([dot for dot in inputs if dot["inverted"] == which] for which in (False, True))
    sums = [{"x": columns[f"{output} "], "y": k} for k, (_, _, outputs) in enumerate(TERMS) for output in outputs]
    ticks: dict[str, Any] = {"x_ticks": list(columns.values()), "x_names": [name.strip() for name in columns]}
    rows = {"rows": [{"y": k} for k in range(len(TERMS))], "names": [name for name, _, _ in TERMS]}
    return ticks | rows | {"plain": plain, "inverted": inverted, "sums": sums, "border": len(_INPUTS) - 0.5}


def _output() -> Values:
    """Output, sample and hold, latch, memory write, and the 2-bit value of each pixel."""
    light = np.array([0.02, 0.1, 0.45, 0.8, 0.6, 0.3, 0.05, 0.0])
    signals, levels = output_signals(light), even_levels(2, 1.0)
    codes = [{"x": (k + 0.5) * 0.5, "code": f"{int(code):02b}"} for k, code in enumerate(compare_levels(light, levels))]
    limits = [{"level": DARK_V - (DARK_V - SATURATED_V) * float(level)} for level in levels]
    logic = _raised({"S/H": signals["S/H"], "/MW": signals["/MW"]})
    return {"signals": signals, "codes": codes, "limits": limits, "logic": logic}
