"""The fused attitude over many flights: its covariance states its errors, and the loss of a head costs no jump."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.special import chdtri
from scipy.stats import poisson
from two_heads import HEADS, NOISE, SIGMA, error_of, fly, in_order

from startracker.fusion import FusionFilter

RUNS = 500


@pytest.mark.slow
def test_500_flights_with_misalignment_and_gyro_errors():
    """NEES at the end of each flight, of the attitude, of the gyro's errors, of the alignment and of all together:
    inside the 95 % bounds of χ²(n · 500)/500. Injected errors are recovered to a fraction of what they were."""
    times = np.linspace(0.0, 60.0, 121)
    parts = {"attitude": slice(0, 3), "bias": slice(3, 6), "scale": slice(6, 9), "alignment": slice(9, 12)}
    nees = {name: [] for name in (*parts, "all")}
    errors, start = [], np.repeat([NOISE.bias_sigma_rad_s, NOISE.scale_sigma, HEADS[1].alignment_sigma_rad], 3)
    for seed in range(RUNS):
        flight = fly(np.random.default_rng(10_000 + seed), times, lambda k: (0, 1))
        found = in_order(FusionFilter(HEADS, NOISE), flight).estimate(60.0)
        error, p = error_of(flight, found), found.full_covariance
        for name, part in (*parts.items(), ("all", slice(0, 12))):
            nees[name].append(error[part] @ np.linalg.solve(p[part, part], error[part]))
        errors.append(error[3:] / start)
    for name, values in nees.items():
        n = 12 if name == "all" else 3
        low, high = (chdtri(n * RUNS, p) / RUNS for p in (0.975, 0.025))
        assert low < np.mean(values) < high, (name, np.mean(values), low, high)
    assert (np.sqrt(np.mean(np.square(errors), axis=0)) < 0.15).all()


@pytest.mark.slow
def test_head_that_is_blinded_for_ten_minutes_costs_no_jump():
    """Head b sees nothing from 60 s to 660 s. At its return the correction is what the covariances before and after
    state: P⁻ − P⁺ is its own. Components beyond 3 σ are as rare as for Gaussian deviates: 0.27 %, with Poisson's
    99.9 % limit; none is at the loss, where nothing is corrected."""
    times = np.concatenate([np.arange(0.0, 60.0), np.arange(60.0, 660.0, 5.0), np.arange(660.0, 700.0)])
    blind = (times >= 60.0) & (times < 660.0)
    back = int(np.argmax(times >= 660.0))
    jumps, beyond = [], 0
    for seed in range(100):
        flight = fly(np.random.default_rng(20_000 + seed), times, lambda k: (0,) if blind[k] else (0, 1), substeps=1)
        whole = FusionFilter(HEADS, NOISE, memory_s=1e4)
        in_order(whole, flight)
        only_a = FusionFilter(HEADS, NOISE, memory_s=1e4)
        upto = flight._replace(
            gyro=flight.gyro[:back], seen=[s for s in flight.seen if s[1] < 660.0 or (s[1] == 660.0 and s[0] == 0)]
        )
        before, after = in_order(only_a, upto).estimate(660.0), whole.estimate(660.0)
        jump = before.attitude.rotation_vector_to(after.attitude)
        beyond += int((np.abs(jump) > 3.0 * np.sqrt(np.diag(before.attitude_covariance))).sum())
        jumps.append(jump @ np.linalg.solve(before.attitude_covariance - after.attitude_covariance, jump))
        # error of the end is again as stated
        assert error_of(flight, whole.estimate(699.0)) @ np.linalg.solve(
            whole.estimate(699.0).full_covariance, error_of(flight, whole.estimate(699.0))
        ) < chdtri(12, 1e-6)
    assert beyond <= poisson.ppf(0.999, 300 * math.erfc(3.0 / math.sqrt(2.0)))
    assert np.mean(jumps) == pytest.approx(3.0, abs=4.0 * math.sqrt(6.0 / len(jumps)))


@pytest.mark.slow
def test_correlated_errors_are_as_stated_if_the_filter_has_states_for_them():
    """A tenth of each head's variance is a Gauss–Markov process of 20 s. NEES of the attitude and of all states over
    200 flights, inside the 95 % bounds; without these states the attitude is far outside."""
    times, runs = np.linspace(0.0, 60.0, 121), 200
    part = tuple(0.33 * SIGMA)
    heads = tuple(dataclasses.replace(head, correlated_sigma_rad=part, correlation_s=20.0) for head in HEADS)
    kept, nees, naive = np.r_[0:9, 12:15], {"attitude": [], "all": []}, []
    for seed in range(runs):
        flight = fly(np.random.default_rng(30_000 + seed), times, lambda k: (0, 1), heads)
        found = in_order(FusionFilter(heads, NOISE), flight).estimate(60.0)
        error, p = error_of(flight, found), found.full_covariance[np.ix_(kept, kept)]
        nees["attitude"].append(error[:3] @ np.linalg.solve(p[:3, :3], error[:3]))
        nees["all"].append(error @ np.linalg.solve(p, error))
        if seed % 4 == 0:
            plain = in_order(FusionFilter(HEADS, NOISE), flight).estimate(60.0)
            off = error_of(flight, plain)[:3]
            naive.append(off @ np.linalg.solve(plain.attitude_covariance, off))
    for name, values in nees.items():
        n = 12 if name == "all" else 3
        low, high = (chdtri(n * runs, q) / runs for q in (0.975, 0.025))
        assert low < np.mean(values) < high, (name, np.mean(values), low, high)
    assert np.mean(naive) > chdtri(3 * len(naive), 1e-3) / len(naive)
