"""The TC211 sequencer of Greyling 1995, chapter 6, clock by clock: states, counters, gates, and charge transfer.

Seven states T0 to T6 in three D flip-flops Q3 Q2 Q1, two latches A (image area gate active) and B (last frame), and the
counters C1 (pixels of a line, up to 208), C2 (lines of a frame, down from 165), C3 (frames of integration, down) and Cm
(memory address):

    T0 wait for GO ─► T1 load C3, clear Cm ─► T2 load C2 ─► T3 clear C1 ─► T4 count C1, 208 times ─► T5 count C2
    T5: lines left ─► T3; frame done, B low ─► T6; frame done, B high ─► T0
    T6: C3 not 0 ─► T2, integrate one frame more; C3 = 0 ─► set A and B ─► T2, clock out

so that GO starts a frame with A (clear), C3 frames without (integration), and one with A and B (clock-out). The signals
C1Z and C3Z are active low, C2Z is active high: only then do the rows of Table 6.2 agree with the text.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import NamedTuple

import numpy as np

from startracker.core import FloatArray
from startracker.errors import InputError

LINES = 165
"""Lines of the TC211 (section 6.1), the initial value of C2."""
COLUMNS = 192
"""Elements of a line."""
COUNTS_PER_LINE = 208
"""Number of repetitions of state T4 (section 6.2.2)."""
DUMMY_CELLS = 6
"""Cells of the serial register before those of the image: the first counts of a line, not written to memory."""
SERIAL_CLOCK_HZ = 2.0e6
"""Half of the 4 MHz of the bus: clock of the state machine and of the serial register gate."""


class TableRow(NamedTuple):
    """A row of Table 6.2; None is X, either value."""

    state: int
    go: int | None
    c1z: int | None
    c2z: int | None
    c3z: int | None
    b: int | None
    following: int
    a_set: int
    b_set: int


STATE_TABLE: tuple[TableRow, ...] = (
    TableRow(0, 0, None, None, None, None, 0b000, 0, 0),
    TableRow(0, 1, None, None, None, None, 0b001, 1, 0),
    TableRow(1, None, None, None, None, None, 0b010, 0, 0),
    TableRow(2, None, None, None, None, None, 0b011, 0, 0),
    TableRow(3, None, None, None, None, None, 0b100, 0, 0),
    TableRow(4, None, 1, None, None, None, 0b100, 0, 0),
    TableRow(4, None, 0, None, None, None, 0b101, 0, 0),
    TableRow(5, None, None, 0, None, None, 0b011, 0, 0),
    TableRow(5, None, None, 1, None, 0, 0b110, 0, 0),
    TableRow(5, None, None, 1, None, 1, 0b000, 0, 0),
    TableRow(6, None, None, None, 1, None, 0b010, 0, 0),
    TableRow(6, None, None, None, 0, None, 0b010, 1, 1),
)
"""Table 6.2 as printed."""


def next_state(
    state: int, go: int, c1z: int, c2z: int, c3z: int, b: int, *, as_printed: bool = False
) -> tuple[int, int, int]:
    """Next state, A_set and B_set by the equations of section 6.2.2; state 7 is undefined and leads to T0.

    With T0 … T6 the decoded states, · and, + or, ' not:

        Q1 = T0·GO + T2 + T4·C1Z' + T5·C2Z'
        Q2 = T1 + T2 + T5·(C2Z·B)' + T6          (printed: T1 + T2 + T5 + T6)
        Q3 = T3 + T4 + T5·C2Z·B'
        A_set = T0·GO + T6·C3Z',   B_set = T6·C3Z'

    The T5 of the printed Q2 leads from the end of the last frame to T2, but Table 6.2 has T0: the camera would never
    stop.
    """
    t = [int(state == k) for k in range(7)]
    stays = 1 if as_printed else 1 - (c2z & b)
    q1 = (t[0] & go) | t[2] | (t[4] & (1 - c1z)) | (t[5] & (1 - c2z))
    q2 = t[1] | t[2] | (t[5] & stays) | t[6]
    q3 = t[3] | t[4] | (t[5] & c2z & (1 - b))
    b_set = t[6] & (1 - c3z)
    return q3 << 2 | q2 << 1 | q1, (t[0] & go) | b_set, b_set


def equation_faults(*, as_printed: bool = False) -> list[tuple[TableRow, str]]:
    """Rows of Table 6.2 that contradict the equations, with the affected output, over all undefined inputs of a row."""
    faults = []
    for row in STATE_TABLE:
        given = (row.go, row.c1z, row.c2z, row.c3z, row.b)
        for inputs in product(*((0, 1) if value is None else (value,) for value in given)):
            found, a_set, b_set = next_state(row.state, *inputs, as_printed=as_printed)
            wrong = [f"Q{k + 1}" for k in range(3) if (found ^ row.following) >> k & 1]
            wrong += ["A_set"] * (a_set != row.a_set) + ["B_set"] * (b_set != row.b_set)
            faults += [(row, name) for name in wrong if (row, name) not in faults]
    return faults


class Pulse(NamedTuple):
    """Actions of the gates at a clock after GO.

    ``line``: the image area gate shifts all lines by one, into the emptied serial register. ``pixel``: a value is
    written to memory, at the address that the counter Cm has; −1 for a line.
    """

    clock: int
    kind: str
    address: int = -1


class Sequencer:
    """The state machine with its latches and counters, for an integration of a number of frame times (0 or more).

    The text does not state pulse widths (they are in Fig. 6.5): here the image area gate shifts at the first count of a
    line, and counts 6 to 197 are written to memory. C2 counts on entry to T5 and C3 on exit from T6, which gives 165
    lines and the requested integration. Fewer lines and columns than those of the TC211 are for tests.

    Raises
    ------
    InputError
        For a negative integration, or a line of too few counts.
    """

    def __init__(
        self,
        integration_frames: int,
        *,
        lines: int = LINES,
        counts_per_line: int = COUNTS_PER_LINE,
        columns: int = COLUMNS,
        as_printed: bool = False,
    ) -> None:
        if integration_frames < 0:
            raise InputError(f"the integration time is {integration_frames} frames; it must be 0 or more")
        if counts_per_line < columns + DUMMY_CELLS:
            raise InputError(
                f"{counts_per_line} counts cannot transfer {columns} elements past {DUMMY_CELLS} dummy cells; "
                f"use at least {columns + DUMMY_CELLS}"
            )
        self.integration_frames = integration_frames
        self.lines, self.counts_per_line, self.columns = lines, counts_per_line, columns
        self.as_printed = as_printed
        self.go = 1
        self.state = self.a = self.b = 0
        self.c1 = self.c2 = self.c3 = self.cm = 0
        self.clock = 0

    @property
    def mode(self) -> str:
        """Mode of the current frame: ``clear``, ``integration`` or ``clockout``."""
        return "clockout" if self.a and self.b else "clear" if self.a else "integration"

    def step(self) -> Pulse | None:
        """One clock period; returns the action of the gates."""
        pulse = None
        state = self.state
        if state == 0:
            self.b = 0
        elif state == 1:
            self.cm, self.c3, self.go = 0, self.integration_frames, 0
        elif state == 2:
            self.c2 = self.lines
        elif state == 3:
            self.c1 = 0
        elif state == 4:
            pulse = self._gates()
            self.c1 += 1
        c1z = int(self.c1 != self.counts_per_line)  # active low
        c2z = int(self.c2 == 0)
        c3z = int(self.c3 != 0)  # active low
        following, a_set, b_set = next_state(state, self.go, c1z, c2z, c3z, self.b, as_printed=self.as_printed)
        if state == 5 and c2z:
            self.a = 0
        if state == 6 and c3z:
            self.c3 -= 1
        self.a |= a_set
        self.b |= b_set
        if following == 5:
            self.c2 -= 1
        self.state = following
        self.clock += 1
        return pulse

    def _gates(self) -> Pulse | None:
        if not self.a:
            return None
        if self.c1 == 0:
            return Pulse(self.clock, "line")
        if self.b and DUMMY_CELLS <= self.c1 < DUMMY_CELLS + self.columns:
            self.cm += 1
            return Pulse(self.clock, "pixel", self.cm - 1)
        return None


def run(sequencer: Sequencer, most_clocks: int = 50_000_000) -> Iterator[Pulse]:
    """Pulses from GO until the machine is back in T0.

    Raises
    ------
    InputError
        If it does not stop within `most_clocks`.
    """
    while True:
        pulse = sequencer.step()
        if pulse is not None:
            yield pulse
        if sequencer.state == 0:
            return
        if sequencer.clock >= most_clocks:
            raise InputError(f"the sequencer does not stop within {most_clocks} clocks")


class ClockedFrame(NamedTuple):
    """Content of the memory after a sequence.

    Electrons of each element (lines, columns), row 0 the line next to the serial register; the time during which charge
    is not moved, from the last shift of the clearing to the first of the clock-out; the time between shifts; and the
    number of values written.
    """

    charge_e: FloatArray
    integration_s: float
    line_s: float
    written: int


def expose(rate_e_s: FloatArray, integration_frames: int, clock_hz: float = SERIAL_CLOCK_HZ) -> ClockedFrame:
    """Run the sequencer with a static scene: every clock adds light, every shift moves all lines.

    This simulates the transfer under light directly: the smear results from the positions of the charge. The scene has
    the photo-electrons per second of each element, (lines, columns) of any size, row 0 next to the serial register.

    Raises
    ------
    InputError
        For a scene that is not a matrix, a clock that is not positive, or a negative integration.
    """
    rate = np.asarray(rate_e_s, dtype=float)
    if rate.ndim != 2 or not clock_hz > 0.0:
        raise InputError(
            f"a scene must be a matrix and a clock above 0 Hz; got the shape {rate.shape}, {clock_hz:g} Hz"
        )
    lines, columns = rate.shape
    sequencer = Sequencer(
        integration_frames, lines=lines, columns=columns, counts_per_line=columns + COUNTS_PER_LINE - COLUMNS
    )
    charge, memory = np.zeros_like(rate), np.zeros_like(rate)
    register = np.zeros(columns)
    shifts = [0]
    for pulse in run(sequencer):
        if pulse.kind == "line":
            charge += rate * ((pulse.clock - shifts[-1]) / clock_hz)
            register = charge[0].copy()
            charge[:-1] = charge[1:]
            charge[-1] = 0.0
            shifts.append(pulse.clock)
        else:
            memory.flat[pulse.address] = register[pulse.address % columns]
    integration_s = (shifts[lines + 1] - shifts[lines]) / clock_hz
    return ClockedFrame(memory, integration_s, (shifts[2] - shifts[1]) / clock_hz, sequencer.cm)
