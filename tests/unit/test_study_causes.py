"""What an accepted attitude is, and the likely cause of one that its covariance does not explain, limit by limit."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import chdtri

from simulator.study.specification.measured import Measured, Setting
from simulator.study.specification.outcome import (
    CENTROIDS,
    DISPLACED,
    GROSS_DEG,
    INCONSISTENT_NEES,
    NOISE,
    UNKNOWN,
    Outcome,
    exceeds_limit,
    outcome_counts_text,
    outcome_of,
    outcome_text,
)
from simulator.study.specification.requirements import Specification
from simulator.study.trials import causes

SIGMA = np.array([1.0, 2.0, 5.0]) * 1e-3
"""Stated standard errors about the axes of the camera, degrees."""
NO_LIMITS = Specification.of_limits({})


def cause(monkeypatch, error_sigmas, turn_sigmas=(0.0, 0.0, 0.0), residual_sigmas=0.5, count=6, bound_sigmas=1.0):
    """Cause of an error, with the turn by displacements and the bound in stated standard errors, and residuals of
    this length on each axis."""
    monkeypatch.setattr(causes, "matched_sources", lambda truth, xy: np.arange(len(xy)))
    monkeypatch.setattr(causes, "systematic_turn_deg", lambda *_: np.array(turn_sigmas) * SIGMA)
    monkeypatch.setattr(causes, "attitude_bound_deg", lambda *_: bound_sigmas * SIGMA)
    fitted = SimpleNamespace(
        xy=np.zeros((count, 2)),
        sigma_px=np.full(count, 0.2),
        residual_px=np.full((count, 2), 0.2 * residual_sigmas),
    )
    fitted.sigma_px[-1] = np.nan  # of a star without a stated error nothing is known
    fitted.residual_px[-1] = 1e3
    solution = SimpleNamespace(stars=SimpleNamespace(fitted=fitted), covariance=np.diag(SIGMA**2))
    return causes.likely_cause(None, None, solution, np.array(error_sigmas) * SIGMA)


def test_displacements_explain_an_error_of_which_they_leave_less_than_half(monkeypatch):
    error = (6.0, 0.0, 8.0)
    for share, found in ((0.51, DISPLACED), (0.49, NOISE), (1.49, DISPLACED), (1.51, NOISE), (-0.6, NOISE)):
        turn = tuple(share * value for value in error)
        assert cause(monkeypatch, error, turn, bound_sigmas=2.0) == found


@pytest.mark.parametrize("count", [4, 9])
def test_residuals_of_one_frame_in_a_thousand_are_the_centroids(monkeypatch, count):
    """χ² of the stars with stated errors, less the three unknowns."""
    freedom = 2 * (count - 1) - 3
    limit = math.sqrt(chdtri(freedom, 1e-3) / (2 * (count - 1)))
    for share, found in ((0.99, NOISE), (1.01, CENTROIDS)):
        assert (
            cause(monkeypatch, (6.0, 0.0, 0.0), residual_sigmas=share * limit, count=count, bound_sigmas=2.0) == found
        )
    assert cause(monkeypatch, (6.0, 0.0, 0.0), residual_sigmas=1e3, count=2, bound_sigmas=2.0) == NOISE


def test_within_five_bounds_it_is_noise(monkeypatch):
    for axis in range(3):
        error = np.zeros(3)
        error[axis] = -6.0
        for bound, found in ((1.21, NOISE), (1.19, UNKNOWN), (math.nan, UNKNOWN)):
            assert cause(monkeypatch, error, bound_sigmas=bound) == found


def test_an_outcome_by_stars_and_covariance():
    """Misidentified stars are wrong; an inconsistent attitude is if it also exceeds the specification."""
    small, gross = dict.fromkeys(("cross_x", "cross_y", "about_boresight"), 0.0), 1.01 * GROSS_DEG
    large = {**small, "cross_y": gross}
    assert outcome_of(0, INCONSISTENT_NEES, large, NO_LIMITS) == Outcome()
    assert outcome_of(0, math.nan, large, NO_LIMITS) == Outcome()
    assert outcome_of(1, 3.0, small, NO_LIMITS) == Outcome(misidentified=True, wrong=True)
    beyond = math.nextafter(INCONSISTENT_NEES, math.inf)
    assert outcome_of(0, beyond, small, NO_LIMITS) == Outcome(inconsistent=True)
    assert outcome_of(0, beyond, large, NO_LIMITS) == Outcome(inconsistent=True, wrong=True)
    assert outcome_of(2, beyond, small, NO_LIMITS) == Outcome(True, True, True)


def test_a_rotation_is_gross_about_all_axes_together():
    share = GROSS_DEG / math.sqrt(3.0)
    for factor, gross in ((0.999, False), (1.001, True)):
        error = dict.fromkeys(("cross_x", "cross_y", "about_boresight"), factor * share)
        assert exceeds_limit(error, NO_LIMITS) is gross
    # a limit on errors takes its place, also about an axis of the body
    limits = Specification.of_limits({"roll": 0.01, "about_boresight": 0.5})
    error = {"roll": 0.0, "pitch": 9.0, "yaw": 0.0, "cross_x": 9.0, "cross_y": 9.0, "about_boresight": 0.49}
    assert not exceeds_limit(error, limits)
    assert exceeds_limit({**error, "about_boresight": -0.51}, limits)
    assert exceeds_limit({**error, "roll": 0.011}, limits)


@pytest.mark.parametrize(
    ("wrong", "misidentified", "inconsistent", "beyond", "text", "counts"),
    [
        (0, 0, 0, 0, "none wrong", "0 wrong"),
        (0, 0, 3, 0, "none wrong, 3 inconsistent", "0 wrong, 3 inconsistent"),
        (2, 2, 0, 0, "2 wrong (2 misidentified)", "2 wrong"),
        (3, 1, 5, 2, "3 wrong (1 misidentified, 2 inconsistent and beyond the specification), 3 inconsistent", None),
        (2, 0, 2, 2, "2 wrong (2 inconsistent and beyond the specification)", "2 wrong, 2 inconsistent"),
    ],
)
def test_outcomes_in_words(wrong, misidentified, inconsistent, beyond, text, counts):
    summary = {"wrong": wrong, "misidentified": misidentified, "inconsistent": inconsistent}
    summary["inconsistency"] = {"beyond_limit": beyond} if inconsistent else None
    assert outcome_text(summary) == text
    assert outcome_counts_text(summary) == (counts or f"{wrong} wrong, {inconsistent} inconsistent")


def test_an_inconsistent_attitude_is_beyond_five_sigma():
    """χ² of three components with the probability of a normal deviate beyond 5 σ on either side, 5.73e-7."""
    assert chdtri(3, math.erfc(5.0 / math.sqrt(2.0))) == pytest.approx(INCONSISTENT_NEES, abs=1e-3)


def test_frames_in_the_conditions_of_a_specification_count():
    """Angles and rates at their limits count: from the exclusion angle on, and within a tenth of the rate."""
    specification = Specification((), rate_deg_s=1.0, exclusion_deg=(("sun", 30.0), ("earth", 10.0)))
    angles = {
        "sun": np.array([30.0, 29.9, 40.0, 40.0, 40.0, 40.0, 40.0]),
        "earth": np.array([90.0, 90.0, 10.0, 9.9, 90.0, 90.0, 90.0]),
    }
    rates = np.array([0.9, 1.0, 1.1, 1.0, 0.89, 1.11, 1.0])
    status = np.array(["solved"] * 6 + ["no_match"], dtype=object)
    columns = {"status": status, "rate_deg_s": rates}
    found = Measured(columns, specification, Setting(angles_deg=angles))
    assert found.counted.tolist() == [True, False, True, False, False, False, True]
    assert found._solved.tolist() == [True, False, True, False, False, False, False]
    # of a sequence the rate is that of the three axes together
    axes = {f"true_rate_{axis}_deg_s": share * rates for axis, share in (("x", 0.6), ("y", 0.0), ("z", -0.8))}
    assert Measured({"status": status, **axes}, specification, Setting(angles_deg=angles)).counted.sum() >= 1
    assert Measured(columns, Specification(())).counted.all()
    assert (found.unit, Measured(columns, specification, Setting(step_s=0.5)).unit) == ("trials", "independent frames")
