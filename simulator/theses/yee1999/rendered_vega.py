"""The Vega image made anew: the intensified camera of ``xybion.yaml`` rendered, from its pixels to its centre."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from simulator.renderer import Renderer
from simulator.scenario import Scenario
from simulator.study.style import BLUE, INK, VERMILION
from simulator.study.trials.trial import build_tracker
from simulator.theses.printed import Row, Section, new_figure
from simulator.theses.yee1999.picture import PRINTED_MATCHES, VEGA_FOV_DEG, Analysis, Options, analyse
from simulator.theses.yee1999.rendered import Shown, off_deg, show
from startracker.identification.triad_search import TriadLimits
from startracker.solution import Solution

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["VegaFrame", "section", "vega_frames"]

FloatArray = NDArray[np.float64]

PRINTED_ERROR_DEG = 0.02
"""± of the centre, as she reckons it from the residuals."""
_FRAMES = 12


@dataclass(frozen=True, eq=False)
class VegaFrame:
    """One rendered frame, solved by the thesis' method and by the star tracker."""

    shown: Shown
    analysis: Analysis
    solution: Solution

    @property
    def off_deg(self) -> tuple[float, float]:
        """Distance of the centre from the true one: the thesis' method, the tracker; NaN where there is none."""
        plate, solution, truth = self.analysis.plate, self.solution, self.shown.truth.attitude
        hers = np.nan if plate is None else off_deg(truth, plate.center_deg)
        ours = off_deg(truth, np.array([solution.ra_deg, solution.dec_deg])) if solution.solved else np.nan
        return hers, ours


def vega_frames(frames: int = _FRAMES, scenario: Scenario | None = None) -> list[VegaFrame]:
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
    limits = limits_of(scenario)
    out = []
    for index in range(frames):
        frame, truth = renderer.frame(index)
        shown = show(frame, truth, settings.detection, VEGA_FOV_DEG)
        analysis = analyse(shown.picture, Options(magnitude_limit=settings.magnitude_limit, edition=5, limits=limits))
        known: dict[str, Any] = {"saturation_dn": frame.saturation_dn, "gain_e_per_dn": frame.gain_e_per_dn}
        out.append(VegaFrame(shown, analysis, tracker.solve(frame.image, observer=frame.observer, **known)))
    return out


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
    found = len(first.shown.pixels)
    identified = [number for number in first.analysis.matches if number is not None]
    shared = [number for number in PRINTED_MATCHES if number in identified]
    off = np.array([frame.off_deg for frame in seen])
    where = "4.2.1"
    rows = [
        Row(
            where,
            "image stars of a rendered frame (τ = 8, threshold 51, ≥ 10 pixels)",
            "5",
            f"{found}",
            "input missing",
            "her picture is not to be had, nor her camera's sensitivity; ours shows μ Lyrae and HR 6997 too",
        ),
        Row(
            where,
            "matched HR numbers of hers that are found again",
            ", ".join(map(str, PRINTED_MATCHES)),
            ", ".join(map(str, identified)),
            "input missing",
            f"{len(shared)} of the {len(PRINTED_MATCHES)} in a picture made anew; a multiple star has 10,000 added "
            "where its components are named apart",
        ),
        _error_row(where, "centre, her method", off[:, 0]),
        _error_row(where, "centre, the tracker (`identifier: triads`)", off[:, 1]),
    ]
    return Section(
        "The Vega image made anew: from the pixels of the rendered camera to the centre",
        rows,
        {"rendered_vega": lambda: picture_figure(first), "rendered_vega_errors": lambda: error_figure(seen)},
    )


def _error_row(where: str, quantity: str, off_deg: FloatArray) -> Row:
    found = off_deg[np.isfinite(off_deg)]
    rms = float(np.sqrt(np.mean(found**2))) if len(found) else np.nan
    return Row(
        where,
        quantity,
        f"± {PRINTED_ERROR_DEG}°",
        f"off by {rms:.4f}° rms, {np.max(found, initial=0.0):.4f}° at most, in {len(found)} of {len(off_deg)} frames",
        "input missing",
        "another picture: here the truth is known, the printed error was reckoned from residuals",
    )


def picture_figure(vega: VegaFrame) -> Figure:
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


def error_figure(frames: Sequence[VegaFrame]) -> Figure:
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
