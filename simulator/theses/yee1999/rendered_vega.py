"""The Vega image made anew: the intensified camera of ``xybion.yaml`` rendered, from its pixels to its centre."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from simulator.renderer import Renderer
from simulator.scenario import Scenario
from simulator.study.style import BLUE, INK, VERMILION
from simulator.study.trials.trial import build_tracker
from simulator.theses.printed import Section, new_figure
from simulator.theses.tables import Values, table_rows
from simulator.theses.yee1999.picture import PRINTED_MATCHES, VEGA_FOV_DEG, Options
from simulator.theses.yee1999.rendered import SolvedFrame, show, solve_shown
from startracker.identification.triad_search import TriadLimits

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["section", "vega_frames"]

FloatArray = NDArray[np.float64]

PRINTED_ERROR_DEG = 0.02
"""± of the centre, as she reckons it from the residuals."""
_FRAMES = 12


def vega_frames(frames: int = _FRAMES, scenario: Scenario | None = None) -> list[SolvedFrame]:
    """Frames of ``xybion.yaml``, each with noise of its own, found, identified and measured.

    Parameters
    ----------
    frames : int
        How many.
    scenario : Scenario, optional
        In place of the one that ships; its thresholds are taken for both methods.
    """
    scenario = scenario or Scenario.load("xybion")
    renderer, settings = Renderer(scenario), scenario.tracker
    tracker = build_tracker(scenario, renderer.camera)
    options = Options(magnitude_limit=settings.magnitude_limit, edition=5, limits=limits_of(scenario))
    shown = (show(*renderer.frame(index), settings.detection, VEGA_FOV_DEG) for index in range(frames))
    return [solve_shown(image, one, options, tracker) for image, one in enumerate(shown, 1)]


def limits_of(scenario: Scenario) -> TriadLimits:
    """Thresholds of the thesis' method as a scenario's tracker has them; τ is the clustering's."""
    chosen, tau = scenario.tracker.identification, scenario.tracker.detection.cluster_radius_px
    plain = TriadLimits()
    return TriadLimits(
        separation_tolerance_deg=chosen.separation_tolerance_deg or plain.separation_tolerance_deg,
        rotation_tolerance_deg=chosen.rotation_tolerance_deg,
        enclosed_tolerance_deg=chosen.enclosed_tolerance_deg,
        grouping_tolerance_deg=chosen.grouping_tolerance_deg,
        vote_number=chosen.vote_number,
        combine_px=plain.combine_px if tau is None else tau,
    )


def section(frames: int = _FRAMES) -> Section:
    """From the pixels of a rendered Vega image to its centre (section 4.2.1)."""
    seen = vega_frames(frames)
    first = seen[0]
    identified = [number for number in first.analysis.matches if number is not None]
    methods = ("her method", "the tracker (`identifier: triads`)")
    off = np.array([frame.off_deg for frame in seen]).T
    values = {
        "found": len(first.shown.pixels),
        "hers": ", ".join(map(str, PRINTED_MATCHES)),
        "identified": ", ".join(map(str, identified)),
        "shared": len(set(PRINTED_MATCHES) & set(identified)),
        "printed": len(PRINTED_MATCHES),
        "errors": [{"method": method} | _errors(off_deg) for method, off_deg in zip(methods, off, strict=True)],
    }
    return Section(
        "The Vega image made anew: from the pixels of the rendered camera to the centre",
        table_rows("yee1999/rendered_vega", values),
        {"rendered_vega": lambda: picture_figure(first), "rendered_vega_errors": lambda: error_figure(seen)},
    )


def _errors(off_deg: FloatArray) -> Values:
    found = off_deg[np.isfinite(off_deg)]
    rms = float(np.sqrt(np.mean(found**2))) if len(found) else np.nan
    return {"rms": rms, "most": np.max(found, initial=0.0), "solved": len(found), "frames": len(off_deg)}


def picture_figure(vega: SolvedFrame) -> Figure:
    """The frame with its clusters numbered by their pixels, and the HR number of those that were matched."""
    figure, axes = new_figure(size=(6.4, 4.9))
    axes.grid(False)
    axes.imshow(vega.shown.frame.image, cmap="gray_r", vmin=0, vmax=255, interpolation="nearest")
    tau, width = 8.0, vega.shown.picture.size_px[0]
    for number, ((x, y), match) in enumerate(zip(vega.shown.xy, vega.analysis.matches, strict=True), start=1):
        colour = VERMILION if match is None else BLUE
        axes.add_patch(_circle(x, y, tau, colour))
        text = f"{number}" if match is None else f"{number}: HR {match}"
        left = x > 0.75 * width
        axes.text(x + (-11 if left else 11), y, text, color=colour, va="center", ha="right" if left else "left")
    axes.set(
        xlabel="column [pixel]", ylabel="row [pixel]", title="xybion.yaml, 8 bits, as a negative; circles: τ = 8 pixels"
    )
    return figure


def _circle(x: float, y: float, radius: float, colour: str) -> Any:
    from matplotlib.patches import Circle

    return Circle((x, y), radius, fill=False, color=colour, linewidth=1.2)


def error_figure(frames: Sequence[SolvedFrame]) -> Figure:
    """Where the centres lie about the true one, by her method and by the tracker."""
    figure, axes = new_figure(size=(5.2, 4.6))
    for label, colour, marker, centres in (
        ("thesis' method", VERMILION, "s", [f.analysis.plate and f.analysis.plate.center_deg for f in frames]),
        ("tracker, triads", BLUE, "o", [(f.solution.ra_deg, f.solution.dec_deg) for f in frames if f.solution.solved]),
    ):
        truth = frames[0].shown.truth.attitude
        points = np.array([c for c in centres if c is not None], dtype=float).reshape(-1, 2)
        east = (points[:, 0] - truth.ra_deg) * np.cos(np.radians(truth.dec_deg)) * 3600.0
        axes.plot(
            east, (points[:, 1] - truth.dec_deg) * 3600.0, marker, color=colour, mfc="none", ls="none", label=label
        )
    box = PRINTED_ERROR_DEG * 3600.0
    axes.plot(box * np.array([-1, 1, 1, -1, -1]), box * np.array([-1, -1, 1, 1, -1]), "--", color=INK, label="± 0.02°")
    axes.set(xlabel="right ascension · cos(declination), off the truth [″]", ylabel="declination, off the truth [″]")
    axes.set_aspect("equal", adjustable="datalim")
    figure.legend(loc="outside upper center", ncols=3)
    return figure
