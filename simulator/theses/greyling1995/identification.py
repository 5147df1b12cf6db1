"""Van Bezooijen's algorithm tested by region of the sky (Greyling 1995, section 5.2.4 and Table 5.2).

The identifier is the tracker's `match_groups`, with the settings of the thesis' program (those of
``scenarios/sunsat.yaml``) or with tolerances derived from the centroid errors.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from simulator.checks import load_scenario
from simulator.randomness import stream
from simulator.theses.figures import section_of
from simulator.theses.greyling1995.guide_stars import BORESIGHT_DEC_DEG, FIELD_DEG, SIDE_PX, map_lines
from simulator.theses.printed import Section
from simulator.theses.tables import Values
from startracker._compiled import clock
from startracker.catalog import load_catalog
from startracker.catalog.guide import GuideDatabase
from startracker.core import IntArray
from startracker.geometry.attitude import Attitude
from startracker.geometry.camera import Camera
from startracker.identification import match_groups
from startracker.identification.observed import Identification, Observed, Prior
from startracker.settings import IdentificationSettings, MatchGroupSettings
from startracker.solution import Status

TABLE_5_2 = {
    1: (146, 676, 1672),
    5: (296, 1663, 2555),
    8: (203, 1026, 1540),
    12: (50, 380, 924),
    18: (106, 620, 1333),
    20: (183, 860, 1449),
}
"""Region (hours of right ascension): printed time to generate match groups and to execute, ms, and number of lines."""

LIMITS = (6.0, 6.1, 6.2)
"""Limiting magnitudes over which the values of the table are averaged."""

CHANGES = (0, 1, 2, -1, -2)
"""Stars added to the field (positive) or removed from it (negative)."""

MORE_CHANGES = (-6, -4, 4, 8, 12, 16, 20, 24)
"""More than the two of the thesis, up to the failure of the algorithm."""

CENTROID_ERROR_PX = 0.1
"""Conclusion of section 4.3.3; uniform between ± this value on each axis."""

POINTING_ERROR_DEG = 1.0
"""Error of the other sensors about each axis."""

MAGNITUDE_ERROR = 0.2
"""Assumed standard deviation of a measured magnitude."""


class Outcome(NamedTuple):
    """Results of fields of one region: numbers identified without a false pair, accepted with one, and with fewer than
    three true stars, which cannot be identified; mean number of stars observed, and time on this machine."""

    trials: int
    solved: int
    wrong: int
    too_few: int
    stars: float
    time_ms: float

    @property
    def possible(self) -> int:
        """Fields with three true stars or more."""
        return self.trials - self.too_few

    @property
    def rate(self) -> float:
        """Success rate of the possible fields; NaN if there are none."""
        return self.solved / self.possible if self.possible else math.nan


@lru_cache(maxsize=1)
def thesis_identification() -> MatchGroupSettings:
    """Settings of the thesis' program: 0.2°, 2 magnitudes, 3 to 8 stars, group threshold from 5 down."""
    return MatchGroupSettings.of(load_scenario("sunsat").tracker.identification)


@lru_cache(maxsize=8)
def guide_database(limit: float) -> GuideDatabase:
    """The tracker's database of the Bright Star Catalogue for 10° on 512 pixels, down to a magnitude."""
    camera = Camera.from_fov(FIELD_DEG, SIDE_PX, SIDE_PX)
    return GuideDatabase.build(load_catalog("bsc5"), camera, limit, thesis_identification())


def region(
    hour: float,
    change: int = 0,
    trials: int = 6,
    limits: Sequence[float] = LIMITS,
    settings: IdentificationSettings | None = None,
    seed: int = 1,
) -> Outcome:
    """Identification in fields of 10° × 10° on the boresight's path at a right ascension, hours.

    For each limiting magnitude the given number of trials: the nominal field rotated by up to ±1° about each axis.
    Stars are added at random positions, each as bright as one of the eight brightest (`change` positive), or removed
    from the eight brightest (negative). By default the settings are those of the thesis' program.
    """
    settings = settings or thesis_identification()
    results, times, stars, few = [], [], [], 0
    for limit in limits:
        guide = guide_database(limit)
        for trial in range(trials):
            rng = stream(seed, f"greyling1995 region {hour:g} {limit:g} {change}", trial)
            prior, observed, truth = draw_field(guide, hour, change, rng)
            if np.count_nonzero(truth >= 0) < settings.min_stars:
                few += 1
                continue
            start = clock()
            answer = match_groups(observed, guide, settings, prior)
            times.append(1e3 * (clock() - start))
            stars.append(len(observed))
            results.append(judge(answer, truth))
    return Outcome(
        trials=trials * len(limits),
        solved=results.count(True),
        wrong=results.count(False),
        too_few=few,
        stars=float(np.mean(stars)) if stars else math.nan,
        time_ms=float(np.mean(times)) if times else math.nan,
    )


def draw_field(
    guide: GuideDatabase, hour: float, change: int, rng: np.random.Generator
) -> tuple[Prior, Observed, IntArray]:
    """Prior of the sensors, observation of the camera, and guide star of each observed star (−1: none)."""
    camera = guide.camera
    nominal = Attitude.from_radec_roll(15.0 * hour, BORESIGHT_DEC_DEG, rng.uniform(0.0, 360.0))
    turn = np.radians(rng.uniform(-POINTING_ERROR_DEG, POINTING_ERROR_DEG, 3))
    true = Attitude.from_rotation_vector(turn, "camera", "camera") @ nominal
    index, _vectors, xy = guide.in_field(true.as_matrix())
    magnitude = guide.v_mag[index] + rng.normal(0.0, MAGNITUDE_ERROR, len(index))
    xy = xy + rng.uniform(-CENTROID_ERROR_PX, CENTROID_ERROR_PX, xy.shape)
    brightest = np.argsort(magnitude)[:8]
    if change < 0:
        gone = rng.choice(brightest, min(-change, len(brightest)), replace=False)
        keep = np.setdiff1d(np.arange(len(index)), gone)
        index, magnitude, xy = index[keep], magnitude[keep], xy[keep]
    elif change > 0 and len(index):
        false = rng.choice(magnitude[brightest], change)
        index = np.concatenate([index, np.full(change, -1)])
        magnitude = np.concatenate([magnitude, false])
        xy = np.concatenate([xy, rng.uniform(0.0, SIDE_PX - 1.0, (change, 2))])
    order = np.argsort(magnitude, kind="stable")
    sigma = np.full(len(order), CENTROID_ERROR_PX / math.sqrt(3.0) * camera.pixel_rad)
    observed = Observed(camera.unproject(xy[order]), 10.0 ** (-0.4 * magnitude[order]), sigma)
    return Prior(nominal, math.radians(math.sqrt(3.0) * POINTING_ERROR_DEG)), observed, index[order]


def judge(answer: Identification, truth: IntArray) -> bool | None:
    """Whether every pair of a solved field is correct; None if it is not solved."""
    if answer.status is not Status.SOLVED:
        return None
    return bool(np.all(truth[answer.pairs[:, 0]] == answer.pairs[:, 1]))


def region_lines(hour: float) -> float:
    """Mean number of lines in the program's map around an hour, over the limiting magnitudes."""
    return float(np.mean([map_lines(hour, limit) for limit in LIMITS]))


Outcomes = dict[int, dict[int, Outcome]]
"""By change and hour."""


def section(trials: int = 6) -> Section:
    """Section 5.2.4: Table 5.2, and the success rate with stars added and removed.

    `trials` fields per region, limiting magnitude and change; a third of them beyond those of the thesis.
    """
    region(12, 0, 1, LIMITS[:1])  # compiles the kernels, without timing
    settings = thesis_identification(), replace(thesis_identification(), separation_tolerance_deg=None)
    thesis, own = ({change: _regions(change, trials, one) for change in CHANGES} for one in settings)
    beyond = [
        {change: _share(_regions(change, math.ceil(trials / 3), one))[0] for change in MORE_CHANGES} for one in settings
    ]
    values = _success_values(thesis, own) | _region_values(thesis[0], own[0]) | _time_values(thesis[0], own[0])
    values |= _success_curves(thesis, own, beyond)
    return section_of("greyling1995/identification", "Chapter 5.2.4: star identification", values)


def _regions(change: int, trials: int, settings: IdentificationSettings) -> dict[int, Outcome]:
    return {hour: region(hour, change, trials, settings=settings) for hour in TABLE_5_2}


def _share(outcomes: dict[int, Outcome]) -> tuple[float, int, int]:
    """Success rate over all regions, fields, and fields with a false pair."""
    fields = sum(outcome.possible for outcome in outcomes.values())
    solved, wrong = (sum(getattr(outcome, name) for outcome in outcomes.values()) for name in ("solved", "wrong"))
    return solved / fields, fields, wrong


def _success_values(thesis: Outcomes, own: Outcomes) -> Values:
    names = {0: "no star added or removed", 1: "1 star added", 2: "2 stars added", -1: "1 removed", -2: "2 removed"}
    rows = []
    for change in CHANGES:
        rate, fields, wrong = _share(thesis[change])
        own_rate, _, own_wrong = _share(own[change])
        exact = wrong == 0 and own_wrong == 0 and rate == 1.0
        found = {"percent": 100 * rate, "own_percent": 100 * own_rate, "wrong": wrong, "own_wrong": own_wrong}
        rows.append({"name": names[change], "fields": fields, "exact": exact} | found)
    return {"unchanged": rows[:1], "changed": rows[1:]}


def _region_values(thesis: dict[int, Outcome], own: dict[int, Outcome]) -> Values:
    rows = []
    for hour, (_groups, _ms, printed) in TABLE_5_2.items():
        few = thesis[hour].too_few
        rows.append(
            {
                "hour": hour,
                "listed": printed,
                "lines": region_lines(hour),
                "stars": own[hour].stars,
                "percents": (100 * thesis[hour].rate, 100 * own[hour].rate),
                "left_out": f", {few} fields with fewer than three stars excluded" if few else "",
            }
        )
    return {"regions": rows}


def _time_values(thesis: dict[int, Outcome], own: dict[int, Outcome]) -> Values:
    printed, at = np.array(list(TABLE_5_2.values()), dtype=float), np.arange(len(TABLE_5_2))
    times, ours = ([outcome.time_ms for outcome in outcomes.values()] for outcomes in (thesis, own))
    return {
        "printed_mean": printed[:, 1].mean(),
        "times_ms": (min(times), max(times)),
        "own_times_ms": (min(ours), max(ours)),
        "bars": [{"at": at + k, "ms": ms} for k, ms in ((-0.3, printed[:, 1]), (0.0, times), (0.3, ours))],
        "ticks": at,
        "power": float(np.polyfit(np.log(printed[:, 2]), np.log(printed[:, 1]), 1)[0]),
    }


def _success_curves(thesis: Outcomes, own: Outcomes, beyond: list[dict[int, float]]) -> Values:
    names = {0: "unchanged", 1: "1 added", 2: "2 added", -1: "1 removed", -2: "2 removed"}
    curves = [
        {"name": name, "rates": [100.0 * outcome.rate for outcome in thesis[change].values()]}
        for change, name in names.items()
    ]
    tolerances = []
    for outcomes, more in zip((thesis, own), beyond, strict=True):
        rates = {change: 100.0 * _share(outcomes[change])[0] for change in CHANGES}
        found = sorted((rates | {change: 100.0 * rate for change, rate in more.items()}).items())
        tolerances.append({"changes": [change for change, _ in found], "rates": [rate for _, rate in found]})
    return {
        "curves": curves,
        "hours": [str(hour) for hour in TABLE_5_2],
        "trials": next(iter(thesis[0].values())).trials,
        "tolerances": tolerances,
    }
