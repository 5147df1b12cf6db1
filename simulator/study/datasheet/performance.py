"""Performance: acquisition of the attitude, tracking with loss and recovery, greatest rate and acceleration."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from simulator.build import build_mounting
from simulator.scenario import Scenario
from simulator.study.datasheet.sheet import Amounts, Estimate, Quantity, mean_of, proportion, rms_of
from simulator.study.datasheet.tasks import Task, TaskRunner, trial_tasks
from startracker.core import ARCSEC_PER_DEG, Columns

RATES_DEG_S = (0.0, 0.1, 0.3, 1.0, 2.0, 4.0, 8.0)
"""Angular rates across the boresight at which errors are stated."""

LEAST_SHARE = 0.95
"""Minimum fraction of correct attitudes up to the greatest rate or acceleration."""

ACQUIRED = 0.997
"""Probability of an attitude after the stated number of frames."""

FIRST_ANGLE_DEG, SMALLEST_ANGLE_DEG = 16.0, 1.0
"""First and smallest angle from a body that is tried."""

FIRST_SHARE = 0.25
"""First acceleration tried, as a fraction of the greatest one that frames at the scenario's interval can follow."""

_OUTAGES_S = (1.0, 5.0)
"""Duration of the interruptions after which recovery is measured."""


class Limit(NamedTuple):
    """Bracket of the greatest value that passes: the greatest that passed, and the smallest above it that failed."""

    passed: float | None
    failed: float | None

    @property
    def estimate(self) -> Estimate:
        """Greatest value that passed, and the bracket."""
        return Estimate(self.passed, self.passed, self.failed)


def bracket(passes: Callable[[float], bool], start: float, steps: int, highest: float) -> Limit:
    """Bracket of the greatest value for which `passes` is true, by doubling or halving and bisection of the logarithm.

    Parameters
    ----------
    passes : callable
        Whether a value passes.
    start : float
        First value.
    steps : int
        Number of bisections.
    highest : float
        Values above it are not tried; 1/1000 of `start` is the smallest.
    """
    low, high = (start, None) if passes(start) else (None, start)
    while low is None or high is None:
        value = 2.0 * low if low is not None else 0.5 * (high or start)
        if value > highest or value < 1e-3 * start:
            return Limit(low, high)
        if passes(value):
            low = value
        else:
            high = value
    for _ in range(steps):
        middle = math.sqrt(low * high)
        if passes(middle):
            low = middle
        else:
            high = middle
    return Limit(low, high)


def acquisition(scenario: Scenario, runner: TaskRunner, amounts: Amounts) -> list[Quantity]:
    """Probability of an attitude from one frame over the whole sky, and the frames and the time it takes."""
    whole_sky: dict[str, Any] = {"study.sampling": "sky", "pointing.target": None}
    quantities = []
    for name, title, prior, count in (
        ("lost_in_space", "lost in space", False, amounts.acquisition),
        ("with_prior", f"with a prior of ±{scenario.pointing.error_deg:g}°", True, amounts.acquisition // 2),
    ):
        found = runner.trials(scenario.changed(whole_sky | {"tracker.prior": prior}), count)
        right = proportion(found["right"])
        method = f"{count} random attitudes over the whole sky, one frame each; {int(np.sum(found['right']))} correct"
        words: dict[str, Any] = {"interpretation": "ensemble", "method": method}
        frames = Estimate(*(frames_to_acquire(share) for share in (right.value, right.high, right.low)))
        quantities += [
            Quantity(f"acquisition_probability_{name}", f"Acquisition probability, {title}", right, **words),
            *(
                Quantity(
                    f"acquisition_{outcome}_{name}", f"{word} attitudes, {title}", proportion(found[outcome]), **words
                )
                for outcome, word in (
                    ("misidentified", "Misidentified"),
                    ("inconsistent", "Inconsistent"),
                    ("wrong", "Wrong"),
                )
            ),
            Quantity(
                f"acquisition_time_{name}",
                f"Acquisition time at {100 * ACQUIRED:g} %, {title}",
                frames.times(scenario.sequence.step_s),
                "s",
                interpretation="ensemble",
                method="frames with independent success times the interval between frames, without computing time",
            ),
        ]
    return quantities


def frames_to_acquire(share: float | None) -> float | None:
    """Number of frames after which an attitude is known with the probability `ACQUIRED`; None without success."""
    if not share:
        return None
    return 1.0 if share >= ACQUIRED else float(math.ceil(math.log(1.0 - ACQUIRED) / math.log(1.0 - share)))


def rates(scenario: Scenario, runner: TaskRunner, amounts: Amounts) -> tuple[Quantity, list[dict[str, Any]]]:
    """The greatest angular rate across the boresight, and errors against the rate: points with ``rate_deg_s``,
    ``available`` and rms and mean about the axis of rotation (``along``), across it, and about the boresight."""
    count = amounts.per_rate
    runner.run([task for rate in RATES_DEG_S for task in trial_tasks(scenario, count, "at_rate", rate)])

    def at(rate_deg_s: float) -> Columns:
        return runner.trials(scenario, count, "at_rate", rate_deg_s)

    points = []
    for rate in RATES_DEG_S:
        found = at(rate)
        point: dict[str, Any] = {"rate_deg_s": rate, "available": list(proportion(found["right"]))}
        for part in ("along", "across", "about"):
            errors = found[f"{part}_deg"] * ARCSEC_PER_DEG
            point[f"{part}_rms_arcsec"] = list(rms_of(errors, scenario.seed))
            point[f"{part}_mean_arcsec"] = list(mean_of(errors, scenario.seed))
        points.append(point)
    limit = bracket(lambda rate: float(np.mean(at(rate)["right"])) >= LEAST_SHARE, 2.0, amounts.bisections, 90.0)
    method = f"at least {100 * LEAST_SHARE:g} % of {count} frames correct; bracket of the bisection"
    return Quantity("greatest_rate", "Greatest angular rate", limit.estimate, "deg/s", method=method), points


def exclusion(scenario: Scenario, runner: TaskRunner, amounts: Amounts) -> list[Quantity]:
    """Smallest angles of the boresight from Sun, Moon and Earth at which frames are solved, by bisection.

    They are not determined for a scenario without stray light, which decides them."""
    if scenario.optics.baffle.pst is None:
        bodies = ("sun", "earth", "moon") if scenario.sky.planets else ("sun", "earth")
        return [_angle(body, Estimate(None), "the scenario has no stray light (optics.baffle.pst)") for body in bodies]
    count = amounts.per_rate
    without_earth = scenario.changed({"sky.earth": False})  # it would cover some of the fields near Sun and Moon
    cases = {"sun": without_earth, "earth": scenario} | ({"moon": without_earth} if scenario.sky.planets else {})

    def frames(body: str, inverse: float) -> Task:
        return Task(cases[body], "near_body", (0, count, body, 1.0 / inverse))

    runner.run([frames(body, 2.0**k / FIRST_ANGLE_DEG) for body in cases for k in range(5)])
    quantities = []
    for body in cases:

        def passes(inverse: float, body: str = body) -> bool:
            return float(np.mean(runner.run([frames(body, inverse)])[0]["right"])) >= LEAST_SHARE

        passed, failed = bracket(passes, 1.0 / FIRST_ANGLE_DEG, amounts.bisections, 1.0 / SMALLEST_ANGLE_DEG)
        value = None if passed is None else 1.0 / passed
        size = Estimate(value, None if failed is None else 1.0 / failed, value)
        limb = " of its limb" if body == "earth" else ""
        method = f"boresight{limb}: at least {100 * LEAST_SHARE:g} % of {count} frames correct; bracket"
        quantities.append(_angle(body, size, method))
    return quantities


def _angle(body: str, size: Estimate, method: str) -> Quantity:
    title = f"Smallest angle from the {body.title()}"
    return Quantity(f"smallest_angle_{body}", title, size, "deg", interpretation="ensemble", method=method)


def tracking(scenario: Scenario, runner: TaskRunner, amounts: Amounts, rate_deg_s: float | None) -> list[Quantity]:
    """Sequence with interruptions: attitudes in tracking, recovery; and the greatest acceleration at which it holds."""
    step_s = scenario.sequence.step_s
    gaps = tuple(
        {"start_s": (k + 1) * amounts.sequence * step_s / (len(_OUTAGES_S) + 1), "duration_s": duration}
        for k, duration in enumerate(_OUTAGES_S)
    )
    quiet = scenario.changed({"sequence.frames": amounts.sequence, "sequence.dropouts": gaps})
    found = runner.run([Task(quiet, "sequence")])[0]
    taken = found["status"] != "no_frame"
    kept = (found["mode"] == "tracking")[taken][1:]
    method = f"sequence of {amounts.sequence} frames every {step_s:g} s, interrupted for " + " and ".join(
        f"{duration:g} s" for duration in _OUTAGES_S
    )
    returns = [recovery_frames(found, gap["start_s"], step_s) for gap in gaps]
    known = [frames * step_s for frames in returns if frames is not None]
    recovery = Estimate(max(known), min(known), max(known)) if len(known) == len(returns) else Estimate(None)
    return [
        Quantity(
            "tracking_share", "Frames solved in tracking mode", proportion(kept), "", "", None, "temporal", method
        ),
        Quantity(
            "recovery_time",
            "Recovery after an interruption",
            recovery,
            "s",
            interpretation="temporal",
            method=f"{method}; longest, and all from shortest to longest",
        ),
        _greatest_acceleration(scenario, runner, amounts, rate_deg_s),
    ]


def recovery_frames(found: Columns, start_s: float, step_s: float) -> int | None:
    """Frames from the end of an interruption to the first attitude, 1 for the first frame; None for none."""
    missing = (found["status"] == "no_frame") & (found["elapsed_s"] >= start_s - 0.5 * step_s)
    gap = np.flatnonzero(missing)
    if not len(gap):
        return None
    last = gap[0]
    while last + 1 < len(missing) and missing[last + 1]:
        last += 1
    solved = np.flatnonzero(((found["status"] == "solved") & ~found["wrong"])[last + 1 :])
    return int(solved[0]) + 1 if len(solved) else None


def _greatest_acceleration(
    scenario: Scenario, runner: TaskRunner, amounts: Amounts, rate_deg_s: float | None
) -> Quantity:
    """The rate swings between ± half the greatest rate with constant acceleration, over at least two frames."""
    swing = 0.5 * rate_deg_s if rate_deg_s else 0.5
    highest = swing / scenario.sequence.step_s

    def frames(acceleration: float) -> Task:
        return Task(swinging(scenario, acceleration, swing, amounts.acceleration), "sequence")

    def passes(acceleration: float) -> bool:
        found = runner.run([frames(acceleration)])[0]
        return bool(np.mean((found["status"] == "solved") & ~found["wrong"]) >= LEAST_SHARE)

    runner.run([frames(share * highest) for share in (FIRST_SHARE, 2.0 * FIRST_SHARE, 4.0 * FIRST_SHARE)])
    limit = bracket(passes, FIRST_SHARE * highest, amounts.bisections, highest)
    return Quantity(
        "greatest_acceleration",
        "Greatest angular acceleration",
        limit.estimate,
        "deg/s2",
        method=f"sequences of {amounts.acceleration} frames, rate between ±{swing:.3g}°/s; at least "
        f"{100 * LEAST_SHARE:g} % correct; bracket of the bisection",
    )


def swinging(scenario: Scenario, acceleration_deg_s2: float, swing_deg_s: float, frames: int) -> Scenario:
    """The scenario's sequence with a rate that swings between ±`swing_deg_s` about a body axis across the boresight."""
    boresight = build_mounting(scenario).inverse.apply(np.array([0.0, 0.0, 1.0]))
    axis = ("roll_deg_s", "pitch_deg_s", "yaw_deg_s")[int(np.argmin(np.abs(boresight)))]
    quarter_s, end_s = swing_deg_s / acceleration_deg_s2, frames * scenario.sequence.step_s
    count = min(math.ceil(0.5 * end_s / quarter_s) + 1, 10_000)
    times = [0.0, *(quarter_s * (2 * k + 1) for k in range(count))]
    values = [0.0, *(swing_deg_s * (-1) ** k for k in range(count))]
    points = tuple({"at_s": at_s, axis: value} for at_s, value in zip(times, values, strict=True))
    return scenario.changed({"sequence.frames": frames, "sequence.rates": points, "sequence.dropouts": ()})
