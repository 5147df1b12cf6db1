"""Rendered heads: the fused attitude and the alignment are as wrong as they say, and a blinded head returns without a
jump.

The mean of N independent NEES of three components is χ²(3 N)/N, of standard deviation √(6/N); four are allowed.
"""

import math

import numpy as np
import pytest
from star_sequences import SMALL_CAMERA, pooled_nees

from simulator import Scenario
from simulator.study.sequence.run import run_sequence
from simulator.study.sequence.statistics import fused_nees

GYRO = "sequence.gyro={use: true, angle_random_walk_deg_sqrt_h: 0.003, bias_deg_h: 3, scale_factor_ppm: 500}"
B = "name: b, mounting: zenith, alignment_sigma_arcsec: 60, optics: {focal_length_mm: 14}"
RATES = (
    "sequence.rates=[{at_s: 2}, {at_s: 6, roll_deg_s: 0.5, pitch_deg_s: 0.3, yaw_deg_s: -0.4}, "
    "{at_s: 20, roll_deg_s: -0.5, pitch_deg_s: 0.4, yaw_deg_s: 0.4}]"
)


def fly(b, *overrides):
    heads = f"heads=[{{name: a, mounting: orbit_normal}}, {{{b}}}]"
    return run_sequence(Scenario.load("cubesat_ideal", overrides=[*SMALL_CAMERA, GYRO, heads, *overrides]))


@pytest.mark.parametrize(("rho", "expected"), [(0.0, 1.0), (0.5, 0.6), (0.9, 0.105)])
def test_effective_number_of_fused_rows(rho, expected):
    """Autoregressive errors: N/n = (1 − ρ²)/(1 + ρ²), and 95 % of the means within the bounds (300 series: ± 5 %)."""
    rng, n, inside, number = np.random.default_rng(1), 200, [], []
    axes = ("cross_x", "cross_y", "about_boresight")
    for _ in range(300):
        u = np.empty((n, 3))
        u[0] = rng.normal(size=3)
        for i in range(1, n):
            u[i] = rho * u[i - 1] + math.sqrt(1.0 - rho**2) * rng.normal(size=3)
        columns = {"status": np.array(["solved"] * n, dtype=object), "nees": np.sum(u**2, axis=1)}
        columns |= {f"error_{axis}_deg": u[:, i] for i, axis in enumerate(axes)}
        found = fused_nees(columns | {f"sigma_{axis}_deg": np.ones(n) for axis in axes})
        inside.append(found["within"])
        number.append(found["effective_frames"] / n)
    assert np.mean(number) == pytest.approx(expected, rel=0.05)
    assert 0.90 < np.mean(inside) < 0.99


@pytest.mark.slow
def test_fused_errors_and_alignments_are_as_stated():
    """Eight flights over different parts of the sky, with misalignments and gyro errors drawn anew."""
    flights = [fly(B, RATES, "sequence.frames=60", f"seed={k}", f"sequence.start_s={397 * k}") for k in range(1, 9)]
    mean, number = pooled_nees(flights)
    assert abs(mean - 3.0) < 4.0 * math.sqrt(6.0 / number)
    off = []
    for flight in flights:
        found = flight.summary["heads"]["b"]["alignment_arcsec"].values()
        off += [(axis["estimated"] - axis["true"]) / axis["sigma"] for axis in found]
        assert max(axis["sigma"] for axis in found) < 15.0
        assert flight.summary["wrong"] == 0
    # the three components are correlated a little; their squares are counted as independent pairs
    assert abs(np.mean(np.square(off)) - 1.0) < 4.0 * math.sqrt(2.0 / (len(off) / 1.5))


@pytest.mark.slow
def test_head_blinded_for_ten_minutes_returns_without_a_jump():
    """Head b has no frames from 100 s to 700 s. At its loss and at its return the error changes from row to row by less
    than 3 σ, the larger of both rows, and the covariance grows and shrinks."""
    sequence = fly(f"{B}, dropouts: [{{start_s: 100, duration_s: 600}}]", "sequence.frames=80", "sequence.step_s=10")
    columns = sequence.columns
    lost = columns["head_b_status"] == "no_frame"
    assert lost.sum() == 60
    assert (columns["status"] == "solved").all()
    assert sequence.summary["heads"]["b"]["longest_outage_s"] == 600.0
    assert (columns["head_b_update"][~lost] == "used").all()
    for k in (10, 70):
        assert lost[k] != lost[k - 1]
        for axis in ("cross_x", "cross_y", "about_boresight"):
            jump = abs(columns[f"error_{axis}_deg"][k] - columns[f"error_{axis}_deg"][k - 1])
            sigma = max(columns[f"sigma_{axis}_deg"][k - 1], columns[f"sigma_{axis}_deg"][k])
            assert jump < 3.0 * sigma, (k, axis)
    weak = columns["sigma_about_boresight_deg"]  # of head a; head b sees it across its own boresight
    assert weak[71] < 0.8 * weak[69]
    assert weak[71:].mean() < 0.7 * weak[15:70].mean()
