"""Figs. 2.2, 3.10, 3.11, 6.5 to 6.8 and Table 6.1 of Greyling 1995 against print, formulas and the state table."""

import itertools

import numpy as np
import pytest

from simulator.theses.figures import draw
from simulator.theses.greyling1995 import signals, starlight
from simulator.theses.greyling1995.converter import compare_levels, even_levels
from simulator.theses.greyling1995.sequencer import STATE_TABLE, next_state
from simulator.theses.tables import table_rows


@pytest.mark.parametrize("address", range(0x2F0, 0x320, 2))
def test_only_the_four_addresses_of_table_6_1_select_something(address):
    printed = {0x300: "Camera", 0x302: "PC", 0x304: "Reset", 0x306: "Go"}
    assert signals.control_name(address) == printed.get(address, "")


def test_products_are_the_equations_in_every_state_and_input():
    for state, *inputs in itertools.product(range(7), *[(0, 1)] * 5):
        assert signals.terms_next(state, *inputs) == next_state(state, *inputs)


def test_products_are_table_6_2():
    for row in STATE_TABLE:
        open_inputs = [(0, 1) if v is None else (v,) for v in (row.go, row.c1z, row.c2z, row.c3z, row.b)]
        for inputs in itertools.product(*open_inputs):
            assert signals.terms_next(row.state, *inputs) == (row.following, row.a_set, row.b_set)


def test_a_line_of_the_clock_out():
    found = signals.line_signals()
    first, second = np.flatnonzero(found["IAG"])[:2]
    assert second - first == 210  # 208 counts, T5 and T3
    line = slice(first, second)
    assert found["SRG"][line].sum() == 208
    assert found["MW"][line].sum() == 192
    # six dummy cells first: sections 6.1 and 6.2.2
    assert found["C1"][line][found["MW"][line] == 1][[0, -1]].tolist() == [6, 197]
    assert found["state"][:2].tolist() == [3, 4]


def test_the_latch_holds_what_the_output_dips_to():
    light = np.array([0.1, 0.9, 0.0, 0.5])
    found = signals.output_signals(light, samples=40)
    latch = found["latch"].reshape(4, 40)
    np.testing.assert_allclose(latch[:, -1], 8.0 - 4.0 * light)  # 8 V dark, 4 V saturated
    # written while the latch holds the pixel before: one pixel later, halfway between two pulses of S/H
    write = found["/MW"].reshape(4, 40) == 0.0
    assert write.sum(axis=1).tolist() == [4] * 4
    for k in range(1, 4):
        np.testing.assert_allclose(latch[k][write[k]], 8.0 - 4.0 * light[k - 1])
    assert not (write & (found["S/H"].reshape(4, 40) == 1.0)).any()
    assert found["time_us"][-1] == pytest.approx(4 * 0.5, abs=0.01)  # 2 MHz
    assert compare_levels(light, even_levels(2, 1.0)).max() == 3


def test_peaks_of_the_spectral_responses():
    rows = {(row.where, row.printed): row for row in table_rows("greyling1995/spectral", starlight.spectral_values())}
    assert rows["Fig. 2.2", "555 nm"].verdict == "exact"
    w = np.array([440.0, 550.0, 640.0, 790.0, 1250.0])
    np.testing.assert_allclose(starlight.ccd_efficiency(w), [0.2, 0.4, 0.5, 0.38, 0.05])  # ccdmag.m
    # an electron a photon is λ / 1.2398 A/W, λ in µm (CODATA: hc/q = 1.239842 V µm)
    np.testing.assert_allclose(starlight.ccd_response_a_w(w), starlight.ccd_efficiency(w) * w / 1239.842, rtol=1e-6)


def test_figures_are_drawn():
    spectra = ("fig_2_2_eye_and_ccd", "fig_3_10_quantum_efficiency", "fig_3_11_response")
    drawn = [draw(f"greyling1995/photometry/{name}", starlight.spectral_values()) for name in spectra]
    circuit = ("fig_6_5_clocks", "fig_6_6_states", "fig_6_7_circuit", "fig_6_8_output")
    drawn += [draw(f"greyling1995/prototype/{name}", signals.values()) for name in circuit]
    for figure in drawn:
        assert any(ax.get_xlabel() for ax in figure.axes)
        assert any(ax.get_ylabel() or ax.get_yticklabels() for ax in figure.axes)
