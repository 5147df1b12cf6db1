"""Van Bezooijen's algorithm tried by region of the sky (Greyling 1995, section 5.2.4 and Table 5.2).

The identifier is the tracker's own `match_groups`, with the settings of the thesis' program (those of
``scenarios/sunsat.yaml``) or with tolerances that follow from the centroids' errors.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from simulator.checks import load_scenario
from simulator.randomness import stream
from simulator.study.style import BLUE, GREEN, INK, VERMILION
from simulator.theses.greyling1995.guide_stars import BORESIGHT_DEC_DEG, FIELD_DEG, SIDE_PX, map_lines
from simulator.theses.printed import Section, new_figure
from simulator.theses.tables import Values, table_rows
from startracker.attitude import Attitude
from startracker.camera import Camera
from startracker.catalog import load_catalog
from startracker.catalog.guide import GuideDatabase
from startracker.identification import match_groups
from startracker.identification.observed import Identification, Observed, Prior
from startracker.settings import IdentificationSettings, MatchGroupSettings
from startracker.solution import Status

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "CHANGES",
    "TABLE_5_2",
    "Outcome",
    "draw_field",
    "guide_database",
    "judge",
    "region",
    "section",
    "thesis_identification",
]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

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
"""Limiting magnitudes that the table's values are averages of."""

CHANGES = (0, 1, 2, -1, -2)
"""Stars added to the field (positive) or taken out of it (negative)."""

MORE_CHANGES = (-6, -4, 4, 8, 12, 16, 20, 24)
"""Beyond the thesis' two, to where the algorithm gives up."""

CENTROID_ERROR_PX = 0.1
"""What section 4.3.3 concludes; uniform between ± this on either axis."""

POINTING_ERROR_DEG = 1.0
"""Of the other sensors, about each axis."""

MAGNITUDE_ERROR = 0.2
"""Assumed standard deviation of a measured magnitude."""


@dataclass(frozen=True)
class Outcome:
    """What came of some fields of one region.

    Parameters
    ----------
    trials : int
        Fields.
    solved, wrong : int
        Identified without a false pair; accepted with one.
    too_few : int
        With fewer than three true stars, where nothing can be identified.
    stars : float
        Mean number of stars seen.
    time_ms : float
        Mean time of the identification on this machine.
    """

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
        """Success among the fields where it is possible; NaN where there are none."""
        return self.solved / self.possible if self.possible else math.nan


@lru_cache(maxsize=1)
def thesis_identification() -> MatchGroupSettings:
    """Settings of the thesis' program: 0.2°, 2 magnitudes, 3 to 8 stars, groups from 5 down."""
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
    """Identification in fields of 10° × 10° on the boresight's path at a right ascension.

    Parameters
    ----------
    hour : float
        Right ascension, hours.
    change : int
        Stars added at random places, as bright as one of the eight brightest each (positive), or taken out of the
        eight brightest (negative).
    trials : int
        Fields at each limiting magnitude: the nominal one turned by up to ±1° about each axis.
    limits : sequence of float
        Limiting magnitudes.
    settings : IdentificationSettings, optional
        Those of the thesis' program where left out.
    seed : int
        Of the fields.
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
            start = time.perf_counter()
            answer = match_groups(observed, guide, settings, prior)
            times.append(1e3 * (time.perf_counter() - start))
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
    """What the sensors tell, what the camera measures, and the guide star of each observed star (−1: none)."""
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
    """Whether every pair of a solved field is right; None where it is not solved."""
    if answer.status is not Status.SOLVED:
        return None
    return bool(np.all(truth[answer.pairs[:, 0]] == answer.pairs[:, 1]))


def region_lines(hour: float, limits: Sequence[float] = LIMITS) -> float:
    """Mean number of lines in the program's map about an hour, over limiting magnitudes."""
    return float(np.mean([map_lines(hour, limit) for limit in limits]))


def section(trials: int = 6) -> Section:
    """Section 5.2.4: Table 5.2, and the success with stars added and taken out.

    Parameters
    ----------
    trials : int
        Fields in each region, at each limiting magnitude and each change.
    """
    region(12, 0, 1, LIMITS[:1])  # compiles the kernels: not to be timed
    thesis = {change: {hour: region(hour, change, trials) for hour in TABLE_5_2} for change in CHANGES}
    own_settings = replace(thesis_identification(), separation_tolerance_deg=None)
    own = {
        change: {hour: region(hour, change, trials, settings=own_settings) for hour in TABLE_5_2} for change in CHANGES
    }
    few = math.ceil(trials / 3)
    beyond = [
        {change: _all_regions(change, few, settings) for change in MORE_CHANGES}
        for settings in (thesis_identification(), own_settings)
    ]
    figures: dict[str, Callable[[], Figure]] = {
        "table_5_2_success": partial(_success_figure, thesis, own, beyond),
        "table_5_2_time": partial(_time_figure, thesis[0], own[0]),
    }
    values = _success_values(thesis, own) | _region_values(thesis[0], own[0]) | _time_values(thesis[0], own[0])
    rows = table_rows("greyling1995/identification", values)
    return Section("Chapter 5.2.4: star identification", rows, figures)


Outcomes = dict[int, dict[int, Outcome]]


def _all_regions(change: int, trials: int, settings: IdentificationSettings) -> float:
    return _share({hour: region(hour, change, trials, settings=settings) for hour in TABLE_5_2})[0]


def _share(outcomes: dict[int, Outcome]) -> tuple[float, int, int]:
    """Success rate over all regions, fields, and fields with a false pair."""
    fields = sum(outcome.possible for outcome in outcomes.values())
    return (
        sum(outcome.solved for outcome in outcomes.values()) / fields,
        fields,
        sum(outcome.wrong for outcome in outcomes.values()),
    )


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
                "left_out": f", {few} fields with fewer than three stars left out" if few else "",
            }
        )
    return {"regions": rows}


def _time_values(thesis: dict[int, Outcome], own: dict[int, Outcome]) -> Values:
    printed = np.array(list(TABLE_5_2.values()), dtype=float)
    times, ours = ([outcome.time_ms for outcome in outcomes.values()] for outcomes in (thesis, own))
    return {
        "printed_mean": printed[:, 1].mean(),
        "times_ms": (min(times), max(times)),
        "own_times_ms": (min(ours), max(ours)),
        "power": float(np.polyfit(np.log(printed[:, 2]), np.log(printed[:, 1]), 1)[0]),
    }


def _success_figure(thesis: Outcomes, own: Outcomes, beyond: list[dict[int, float]]) -> Figure:
    figure, (left, right) = new_figure(1, 2, (7.6, 3.8), sharey=True)
    hours = list(TABLE_5_2)
    styles = {0: (INK, "o", "-"), 1: (BLUE, "^", "--"), 2: (BLUE, "v", ":"), -1: (VERMILION, "s", "--"),
              -2: (VERMILION, "D", ":")}  # fmt: skip
    for change, (colour, marker, line) in styles.items():
        rate = [100.0 * thesis[change][hour].rate for hour in hours]
        name = "unchanged" if change == 0 else f"{abs(change)} {'added' if change > 0 else 'removed'}"
        left.plot(
            range(len(hours)), rate, marker, color=colour, linestyle=line, markersize=5, linewidth=0.9, label=name
        )
    left.set_xticks(range(len(hours)), [str(hour) for hour in hours])
    left.set(
        xlabel="region, right ascension [h]",
        ylabel="identified [%]",
        ylim=(-3, 104),
        title=f"tolerance 0.2°, {thesis[0][hours[0]].trials} fields a point",
    )
    left.legend(loc="lower center", ncols=2)
    for outcomes, more, colour, marker, line, name in (
        (thesis, beyond[0], BLUE, "o", "-", "0.2°, as in the thesis"),
        (own, beyond[1], VERMILION, "s", "--", "from the centroids' errors"),
    ):
        rates = {change: _share(outcomes[change])[0] for change in CHANGES} | more
        changes = sorted(rates)
        rate = [100.0 * rates[change] for change in changes]
        right.plot(changes, rate, color=colour, marker=marker, markersize=4, linestyle=line, label=name)
    right.axvspan(-2, 2, color=INK, alpha=0.08, linewidth=0, label="what the thesis tried")
    right.set(xticks=range(-8, 25, 4), xlabel="stars removed (−) or added (+)", title="all six regions, by tolerance")
    right.legend(loc="lower center")
    figure.suptitle("Table 5.2  Success of the identification, V ≤ 6.0 to 6.2", fontsize=10)
    return figure


def _time_figure(thesis: dict[int, Outcome], own: dict[int, Outcome]) -> Figure:
    figure, axes = new_figure(1, 1, (5.8, 3.8))
    hours = list(TABLE_5_2)
    place = np.arange(len(hours))
    for shift, values, colour, hatch, name in (
        (-0.3, [TABLE_5_2[hour][1] for hour in hours], VERMILION, "", "printed: 386 at 40 MHz"),
        (0.0, [thesis[hour].time_ms for hour in hours], BLUE, "//", "here, tolerance 0.2°"),
        (0.3, [own[hour].time_ms for hour in hours], GREEN, "..", "here, our tolerance"),
    ):
        axes.bar(place + shift, values, width=0.28, color=colour, hatch=hatch, edgecolor="white", label=name)
    axes.set_yscale("log")
    axes.set_ylim(top=3e5)
    axes.set_xticks(place, [str(hour) for hour in hours])
    axes.set(
        xlabel="region, right ascension [h]", ylabel="execution time [ms]", title="Table 5.2  Time of an identification"
    )
    axes.legend(loc="upper right")
    return figure
