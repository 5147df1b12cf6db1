"""The flight of OEDIPUS-C made anew: the turn of the spinning payload in ``oedipus.yaml``, rendered and followed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from simulator.scenario import Scenario
from simulator.study.sequence.frames import SequenceRunner
from simulator.study.style import BLUE, GREEN, INK, ORANGE, VERMILION
from simulator.theses.printed import Section, new_figure
from simulator.theses.tables import Values, table_rows
from simulator.theses.yee1999.catalogue import printed_rows
from simulator.theses.yee1999.picture import Options
from simulator.theses.yee1999.rendered import SolvedFrame, off_deg, show, solve_shown
from simulator.theses.yee1999.rendered_vega import limits_of
from simulator.theses.yee1999.video_field import cropped_field_deg, field_deg

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["flight_frames", "section"]

FloatArray = NDArray[np.float64]

WRONG = (22,)
"""Images in which her program matched wrong stars (appendix D.3)."""
FAILED = (*WRONG, 24)
"""The same, and the image whose stars it matched correctly but whose centre then diverged from an initial estimate
several degrees off."""
PRINTED_ERROR_DEG = 0.1
_FULL_FIELD_MM = (13.2440, 10.4396)
_DEC_RANGE_DEG, _MAX_SEPARATION_DEG, _MOST_STARS = (50.0, 90.0), 40.0, 7
_RIGHT_DEG = 0.5
"""A boresight that is off by more is that of other stars: five times the error she gives."""


def flight_frames(images: Sequence[int] | None = None, scenario: Scenario | None = None) -> list[SolvedFrame]:
    """Images of the turn, each solved without what the others told.

    Parameters
    ----------
    images : sequence of int, optional
        Numbers from 1; left out, all of the scenario's sequence.
    scenario : Scenario, optional
        In place of ``oedipus.yaml``.
    """
    scenario = scenario or Scenario.load("oedipus")
    runner = SequenceRunner(scenario)
    options = Options(
        edition=5,
        magnitude_limit=scenario.tracker.magnitude_limit,
        dec_range_deg=_DEC_RANGE_DEG,
        max_separation_deg=_MAX_SEPARATION_DEG,
        limits=limits_of(scenario),
    )
    fov_deg = cropped_field_deg(field_deg(*_FULL_FIELD_MM))
    out = []
    for image in images or range(1, len(runner.states) + 1):
        state = runner.states[image - 1]
        frame, truth = runner.renderer.frame(
            image - 1, at_s=state.t_s, attitude=state.camera, rate_camera_rad_s=state.rate_camera_rad_s
        )
        shown = show(frame, truth, scenario.tracker.detection, fov_deg, _MOST_STARS)
        out.append(solve_shown(image, shown, options, runner.tracker))
    return out


def section(images: Sequence[int] | None = None) -> Section:
    """The track of the boresight over one turn (section 4.3, appendix D.3, Fig. 4.11)."""
    frames = flight_frames(images)
    rows = table_rows("yee1999/rendered_flight", _values(frames))
    names = {6: "fig_4_8_rendered", 7: "fig_4_9_rendered"}
    figures = {"fig_4_11_rendered": partial(track_figure, frames)}
    figures |= {names[f.image]: partial(image_figure, f) for f in frames if f.image in names}
    return Section("OEDIPUS-C made anew: a turn of the spinning payload", rows, figures)


def _values(frames: Sequence[SolvedFrame]) -> Values:
    printed = {int(row["image"]): row for row in printed_rows("table_d_2")}
    wrong = sum(f.image in WRONG for f in frames)
    right = sum(bool(printed[f.image]["hr"]) for f in frames) - wrong
    hers, ours = (np.array([getattr(f, name) for f in frames]) for name in ("hers_off_deg", "ours_off_deg"))
    apart = [
        off_deg(f.shown.truth.attitude, np.array([float(row["ra_deg"]), float(row["dec_deg"])]))
        for f in frames
        if (row := printed[f.image])["ra_deg"]
    ]
    coordinate = math.sqrt(float(np.mean(np.square(apart))) / 2.0) if apart else math.nan
    methods = (
        (
            hers, "images whose stars are named right, and wrong, by her method",
            "hers are the real pictures, the tether painted over; here it stays, and the noise is assumed",
        ),
        (
            ours, "the same by the tracker (`identifier: triads`)",
            "another video; up to 12 stars, exact geometry, acceptance by probability",
        ),
    )  # fmt: skip
    return {
        "methods": [
            {
                "method": method,
                "video": video,
                "right": np.count_nonzero(off <= _RIGHT_DEG),
                "wrong": np.count_nonzero(off > _RIGHT_DEG),
            }
            for off, method, video in methods
        ],
        "hers": (right, wrong),
        "total": len(frames),
        "failed": [_failed(f) for f in frames if f.image in FAILED],
        "largest": np.nanmax(ours),
        "coordinate": coordinate,
        "fitted": coordinate <= PRINTED_ERROR_DEG,
    }


def _failed(f: SolvedFrame) -> Values:
    """An image in which her program failed."""
    hers = "wrong matches" if f.image in WRONG else "right matches, the centre diverged"
    if not f.solution.solved:
        return {"image": f.image, "hers": hers, "ours": "not solved", "note": f.solution.reason}
    ours = f"{len(f.solution.stars)} stars, off by {f.ours_off_deg:.3f}°"
    return {
        "image": f.image,
        "hers": hers,
        "ours": ours,
        "note": "another video; her program failed here; ours does not",
    }


def track_figure(frames: Sequence[SolvedFrame]) -> Figure:
    """Declination against right ascension, as Fig. 4.11: printed, by her method and by the tracker."""
    figure, axes = new_figure(size=(6.4, 4.8))
    truth = np.array([(f.shown.truth.attitude.ra_deg, f.shown.truth.attitude.dec_deg) for f in frames])
    axes.plot(*truth.T, "-", color=INK, linewidth=0.8, label="true boresight")
    printed = [r for r in printed_rows("table_d_2") if r["ra_deg"]]
    axes.errorbar(
        [float(r["ra_deg"]) for r in printed],
        [float(r["dec_deg"]) for r in printed],
        xerr=PRINTED_ERROR_DEG,
        yerr=PRINTED_ERROR_DEG,
        fmt="D",
        ms=4,
        color=ORANGE,
        ecolor=ORANGE,
        elinewidth=0.7,
        label="printed (Table D.2)",
    )
    hers = [f.analysis.plate.center_deg for f in frames if f.analysis.plate is not None and f.hers_off_deg < _RIGHT_DEG]
    axes.plot(*np.array(hers).reshape(-1, 2).T, "s", ms=8, mfc="none", color=GREEN, label="rendered, her method")
    ours = {f.image: (f.solution.ra_deg, f.solution.dec_deg) for f in frames if f.solution.solved}
    axes.plot(*np.array(list(ours.values())).reshape(-1, 2).T, "o", ms=3.5, color=BLUE, label="rendered, tracker")
    for image, place in ours.items():
        marked = image in FAILED
        axes.annotate(
            f"{image}",
            place,
            xytext=(6, 4),
            textcoords="offset points",
            color=VERMILION if marked else INK,
            fontweight="bold" if marked else "normal",
            fontsize=8,
        )
    axes.set(xlabel="right ascension [degrees]", ylabel="declination [degrees]")
    axes.legend(loc="center", bbox_to_anchor=(0.45, 0.5))
    return figure


def image_figure(flight: SolvedFrame) -> Figure:
    """A rendered image as Figs. 4.8 and 4.9, the tracker's stars named."""
    figure, axes = new_figure(size=(6.4, 5.7))
    axes.grid(False)
    axes.imshow(flight.shown.frame.image, cmap="gray_r", vmin=0, vmax=255, interpolation="nearest")
    stars, width = flight.solution.stars, flight.shown.picture.size_px[0]
    for (x, y), number in zip(stars.xy, stars.catalog_id, strict=True):
        left = x > 0.85 * width
        axes.plot(x, y, "o", ms=12, mfc="none", color=BLUE)
        axes.text(x + (-12 if left else 12), y, f"{number}", color=BLUE, va="center", ha="right" if left else "left")
    axes.set(
        xlabel="column [pixel]",
        ylabel="row [pixel]",
        title=f"oedipus.yaml, image {flight.image}, as a negative; HR numbers of the tracker",
    )
    return figure
