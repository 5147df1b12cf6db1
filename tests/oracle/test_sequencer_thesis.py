"""The TC211 sequencer against Greyling 1995, chapter 6, and clocking out under light against sums over rows.

Source: Table 6.2, its equations and the numbers of sections 6.1 and 6.2 as printed. The smear is compared with the time
that each line of charge spends in each row, counted here by hand; both are sums of the same few products, so that they
agree to rounding (1e-12 of the largest).
"""

import numpy as np
import pytest

from simulator.detector.readout import convert
from simulator.optics.shutter import frame_transfer_smear
from simulator.theses.greyling1995.converter import compare_levels, even_levels, geometric_levels
from simulator.theses.greyling1995.sequencer import (
    SERIAL_CLOCK_HZ,
    STATE_TABLE,
    Sequencer,
    equation_faults,
    expose,
    next_state,
    run,
)
from startracker.errors import InputError


def test_equations_give_the_state_table():
    assert equation_faults() == []
    assert len(STATE_TABLE) == 12
    assert {row.state for row in STATE_TABLE} == set(range(7))


def test_printed_equation_of_q2_is_wrong_in_one_row():
    """T5 with C2Z = B = 1: the table says T0 (000), the printed sum T1 + T2 + T5 + T6 sets Q2."""
    faults = equation_faults(as_printed=True)
    assert [(row.state, row.c2z, row.b, name) for row, name in faults] == [(5, 1, 1, "Q2")]
    assert next_state(5, 0, 0, 1, 0, 1, as_printed=True)[0] == 0b010
    with pytest.raises(InputError, match="does not stop"):
        for _ in run(Sequencer(0, lines=3, columns=4, counts_per_line=20, as_printed=True), most_clocks=5000):
            pass


def test_a_state_that_is_none_leads_to_the_initial_one():
    for inputs in np.ndindex(2, 2, 2, 2, 2):
        assert next_state(7, *inputs)[0] == 0


def test_one_sequence_clock_by_clock():
    """GO, T1, then frames of T2, 165 × (T3, 208 × T4, T5) and T6: clear, integration, clock-out, which ends in T0."""
    sequencer = Sequencer(1)
    pulses = list(run(sequencer))
    line = 208 + 2
    assert sequencer.clock == 2 + 3 * (1 + 165 * line) + 2
    shifts = [p.clock for p in pulses if p.kind == "line"]
    assert len(shifts) == 2 * 165
    assert set(np.diff(shifts[:165])) == {line}
    pixels = [p for p in pulses if p.kind == "pixel"]
    assert [p.address for p in pixels] == list(range(192 * 165))
    # the first value is that of count 6, after the dummy cells
    assert pixels[0].clock - shifts[165] == 6
    assert pixels[191].clock - shifts[165] == 197


def test_modes_follow_one_another():
    sequencer = Sequencer(2, lines=2, columns=3, counts_per_line=10)
    modes = []
    while sequencer.clock == 0 or sequencer.state:
        sequencer.step()
        if sequencer.state == 4 and (not modes or modes[-1] != sequencer.mode):
            modes.append(sequencer.mode)
    assert modes == ["clear", "integration", "clockout"]


def test_rates_of_the_thesis():
    assert SERIAL_CLOCK_HZ / 208 == pytest.approx(9.6e3, abs=50)
    clocked = [expose(np.zeros((165, 192)), frames) for frames in (1, 2, 3)]
    frame_s = (165 * 210 + 2) / SERIAL_CLOCK_HZ
    assert np.diff([c.integration_s for c in clocked]) == pytest.approx(frame_s, rel=1e-12)
    assert clocked[0].integration_s - frame_s == pytest.approx(212 / SERIAL_CLOCK_HZ, rel=1e-9)
    assert clocked[0].written == 31680


def by_rows(rate, integration_s, line_s):
    """Charge read in row r stood `integration_s` there and a line time in every other row, on its way in or out."""
    charge = np.zeros_like(rate)
    for r in range(len(rate)):
        charge[r] = rate[r] * integration_s
        for other in range(len(rate)):
            if other != r:
                charge[r] += rate[other] * line_s
    return charge


@pytest.mark.parametrize("clock_hz", [2e6, 1e5])
@pytest.mark.parametrize("frames", [0, 1, 4])
def test_smear_of_clocking_out_under_light(clock_hz, frames):
    rate = np.random.default_rng(3).exponential(1e5, (23, 9))
    clocked = expose(rate, frames, clock_hz)
    expected = by_rows(rate, clocked.integration_s, clocked.line_s)
    assert np.abs(clocked.charge_e - expected).max() < 1e-12 * expected.max()
    still = rate * clocked.integration_s
    smear = frame_transfer_smear(still, clocked.integration_s, clocked.line_s, "up")
    assert np.abs(still + smear - clocked.charge_e).max() < 1e-12 * expected.max()


def test_smear_in_frames_does_not_depend_on_the_clock():
    """Integration is counted in frames: charge and smear grow alike as the clock slows."""
    rate = np.random.default_rng(4).exponential(1.0, (12, 5))
    fast, slow = expose(rate, 2, 2e6), expose(rate, 2, 1e5)
    assert np.allclose(slow.charge_e, 20 * fast.charge_e, rtol=1e-12)


def test_comparators():
    """Even levels are those of a converter that rounds; any others count what is reached."""
    signal = np.linspace(-0.1, 3.1, 1001)
    converted = signal.copy()
    convert(converted, 3.0)
    assert np.array_equal(compare_levels(signal, even_levels(2, 3.0)), converted)
    assert compare_levels([0.0, 1.0, 2.0, 9.0], [1.0, 4.0, 8.0]).tolist() == [0, 1, 1, 3]
    assert geometric_levels(0.02, 0.5) == pytest.approx([0.02, 0.1, 0.5])
    with pytest.raises(InputError, match="ascending"):
        compare_levels([1.0], [2.0, 2.0])


def test_impossible_sequences_are_told():
    with pytest.raises(InputError, match="0 or more"):
        Sequencer(-1)
    with pytest.raises(InputError, match="at least 198"):
        Sequencer(1, counts_per_line=190)
    with pytest.raises(InputError, match="above 0 Hz"):
        expose(np.zeros((3, 3)), 1, 0.0)
