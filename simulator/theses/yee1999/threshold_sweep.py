"""Sweep of the thresholds of triads on rendered frames: the parameter study that the thesis makes manually for one
image.

Each frame is one of ``xybion.yaml``'s camera at a random attitude within the thesis' sub-catalogue, with a gain that
makes its faintest stars (V = 6) detectable, as other fields do not contain Vega. Its brightest centroids are passed to
the thesis' method, which uses the largest group of triads, and to the tracker with ``identifier: triads``, which
accepts a group only if it is not explained by chance.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from simulator.randomness import stream
from simulator.renderer import Renderer
from simulator.scenario import Scenario
from simulator.study.intervals import wilson_interval
from simulator.theses.figures import draw
from simulator.theses.printed import Section
from simulator.theses.tables import Values, table_rows
from simulator.theses.yee1999.picture import VEGA_FOV_DEG, Options, analyse
from simulator.theses.yee1999.rendered import Shown, limits_of, off_deg, show, tracker_off_deg
from startracker.geometry.attitude import Attitude
from startracker.geometry.camera import Camera
from startracker.tracker import StarTracker

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RIGHT_DEG = 0.1
"""Error above which a centre is wrong: five times the ± 0.02° of the thesis."""
_DEC_DEG = (38.0, 82.0)
"""Declinations of the frames, whose fields are within the 30° to 90° of the sub-catalogue."""
_FRAMES = 20
_MOST_STARS = 7
_GAIN_E_PER_DN = 150.0
_METHODS = ("thesis' method", "tracker, identifier: triads")


class _Threshold(NamedTuple):
    """A parameter: name in both methods, label and values; `printed` is that of the thesis."""

    name: str
    label: str
    values: tuple[float, ...]
    printed: float


THRESHOLDS = (
    _Threshold("separation_tolerance_deg", "separation tolerance [degrees]", (0.02, 0.05, 0.1, 0.15, 0.25, 0.4), 0.15),
    _Threshold("rotation_tolerance_deg", "rotation angle tolerance [degrees]", (0.5, 1.0, 2.0, 5.0, 10.0, 20.0), 5.0),
    _Threshold("vote_number", "vote number", (1, 2, 3, 4, 6, 8), 2),
)


class Outcome(NamedTuple):
    """Results for one value of a threshold, with the others as in the scenario: frames with correct and wrong centres,
    and total; the others are not solved."""

    method: str
    threshold: str
    value: float
    right: int
    wrong: int
    frames: int


def sky_frames(frames: int = _FRAMES, scenario: Scenario | None = None) -> list[Shown]:
    """Frames of the camera at random attitudes, uniform over a zone of the sky, found by clustering."""
    scenario = scenario or Scenario.load("xybion", [f"detector.gain_e_per_dn={_GAIN_E_PER_DN:g}"])
    renderer = Renderer(scenario)
    rng = stream(scenario.seed, "threshold_sweep")
    low, high = np.sin(np.radians(_DEC_DEG))
    out = []
    for index in range(frames):
        ra, sine, roll = rng.uniform(0.0, 360.0), rng.uniform(low, high), rng.uniform(0.0, 360.0)
        attitude = Attitude.from_radec_roll(float(ra), float(np.degrees(np.arcsin(sine))), float(roll))
        frame, truth = renderer.frame(index, attitude=attitude)
        out.append(show(frame, truth, scenario.tracker.detection, VEGA_FOV_DEG, _MOST_STARS))
    return out


def sweep(
    shown: Sequence[Shown], scenario: Scenario | None = None, thresholds: Sequence[_Threshold] = THRESHOLDS
) -> list[Outcome]:
    """Correct and wrong results by threshold, with the others as in the scenario, for the frames of `sky_frames`."""
    scenario = scenario or Scenario.load("xybion")
    tracker = _tracker(scenario, shown[0].frame.camera)
    out = []
    for threshold in thresholds:
        for value in threshold.values:
            change = {threshold.name: type(threshold.printed)(value)}
            for method, solve in zip(_METHODS, _solvers(scenario, change, tracker), strict=True):
                off = np.array([solve(one) for one in shown])
                right = int(np.count_nonzero(off <= RIGHT_DEG))
                wrong = int(np.count_nonzero(off > RIGHT_DEG))
                out.append(Outcome(method, threshold.name, value, right, wrong, len(shown)))
    return out


def _tracker(scenario: Scenario, camera: Camera) -> StarTracker:
    """The scenario's tracker with triads."""
    section = scenario.tracker
    return StarTracker(
        camera,
        catalog=section.catalog,
        magnitude_limit=section.magnitude_limit,
        identifier="triads",
        estimator=section.estimator,
        identification=section.identification,
    )


def _solvers(
    scenario: Scenario, change: dict[str, Any], tracker: StarTracker
) -> tuple[Callable[[Shown], float], Callable[[Shown], float]]:
    """Error of the centre, degrees, NaN if not solved: by the thesis' method, by the tracker."""
    section = scenario.tracker
    options = Options(edition=5, magnitude_limit=section.magnitude_limit, limits=replace(limits_of(scenario), **change))
    changed = copy(tracker)  # including guide stars and tables, which do not depend on thresholds
    changed.identification = replace(tracker.identification, **change)

    def hers(one: Shown) -> float:
        plate = analyse(one.picture, options).plate
        return np.nan if plate is None else off_deg(one.truth.attitude, plate.center_deg)

    def ours(one: Shown) -> float:
        solution = changed.solve_centroids(one.xy, one.pixels.astype(float), observer=one.frame.observer)
        return tracker_off_deg(one.truth.attitude, solution)

    return hers, ours


def section(frames: int = _FRAMES) -> Section:
    """Correct and wrong matches by threshold (section 4.2.1 sets them by trial and error for one image)."""
    outcomes = sweep(sky_frames(frames))
    values = []
    for threshold in THRESHOLDS:
        for method in _METHODS:
            mine = [o for o in outcomes if o.method == method and o.threshold == threshold.name]
            at = next(o for o in mine if o.value == threshold.printed)
            best = max(mine, key=lambda o: (o.right, -o.wrong))
            values.append(
                {"label": threshold.label, "method": method, "hers": threshold.printed, "best": best, "at": at}
            )
    rows = table_rows("yee1999/threshold_sweep", {"thresholds": values, "frames": frames})
    drawn = {"threshold_sweep": lambda: sweep_figure(outcomes)}
    return Section("Thresholds of the triads on rendered frames", rows, drawn)


def sweep_figure(outcomes: Sequence[Outcome]) -> Figure:
    """Fraction of frames correct (top) and wrong (bottom) by threshold; bars: 95 % intervals (Wilson)."""
    above, below = ([_panel(outcomes, threshold, what) for threshold in THRESHOLDS] for what in ("right", "wrong"))
    return draw("yee1999/threshold_sweep/threshold_sweep", {"panels": above + below})


def _panel(outcomes: Sequence[Outcome], threshold: _Threshold, what: str) -> Values:
    curves = []
    for method in _METHODS:
        mine = [o for o in outcomes if o.method == method and o.threshold == threshold.name]
        share = np.array([getattr(o, what) / o.frames for o in mine])
        bounds = np.array([wilson_interval(getattr(o, what), o.frames) for o in mine])
        curves.append(
            {
                "at": [o.value for o in mine],
                "share": 100 * share,
                "bars": 100 * np.abs(bounds.T - share),
                "method": method,
            }
        )
    log = (
        []
        if threshold.name == "vote_number"
        else [{"ticks": threshold.values, "texts": [f"{v:g}" for v in threshold.values]}]
    )
    return {
        "curves": curves,
        "printed": threshold.printed,
        "log": log,
        "x_label": threshold.label if what == "wrong" else "",
        "y_label": f"frames {what} [%]" if threshold is THRESHOLDS[0] else "",
    }
