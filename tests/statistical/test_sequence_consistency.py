"""Rendered sequences: the filter is as wrong as it says, and a filter that is told too little is found out.

The mean of N independent NEES of an attitude is χ²(3 N)/N, of standard deviation √(6/N); errors of successive frames
hang together, and N is the effective number that the autocorrelation leaves (`effective_number`). Four deviations of
all sequences together are allowed: one in 16,000.
"""

import math

import numpy as np
import pytest
from star_sequences import SMALL_CAMERA, pooled_nees

from simulator import Scenario
from simulator.study.sequence.run import run_sequence


def sequence_of(*overrides):
    return run_sequence(Scenario.load("cubesat_ideal", overrides=[*SMALL_CAMERA, *overrides]))


@pytest.mark.slow
def test_errors_are_as_the_covariance_says():
    """With a gyro the truth is what the filter assumes of it: white noise, and a bias that wanders."""
    sequences, inside, values = [], 0, 0
    for seed in (1, 2, 3, 4):
        sequences.append(sequence_of("sequence.gyro.use=true", "sequence.frames=50", f"seed={seed}"))
        columns = sequences[-1].columns
        assert sequences[-1].summary["solved"] == 50
        for axis in ("roll", "pitch", "yaw"):
            inside += int(np.sum(np.abs(columns[f"error_{axis}_deg"]) < 3.0 * columns[f"sigma_{axis}_deg"]))
            values += 50
    mean, number = pooled_nees(sequences)
    assert number > 60
    assert abs(mean - 3.0) < 4.0 * math.sqrt(6.0 / number)
    # 99.7 % of normal errors within 3 σ; the count is binomial, of some third as many independent values
    assert inside / values > 0.9973 - 4.0 * math.sqrt(0.0027 / (values / 3.0))


@pytest.mark.parametrize(("walk", "consistent"), [("auto", True), ("1e-5", False)])
def test_too_little_process_noise_is_found_out(walk, consistent):
    """A body that turns against the level it holds changes its rate by ω × n, 6e-5 °/s²; 1e-5 °/s/√s is too little."""
    nees = sequence_of(f"sequence.rate_walk_deg_s_sqrt_s={walk}", "sequence.frames=40").summary["nees"]
    assert (nees["mean"] < nees["bounds95"][1]) == consistent
