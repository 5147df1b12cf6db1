"""The pitch angle from a pair of stars (Greyling 1995, section 5.3): eq. 5.13, Figs. 5.10 and 5.11, the 1.6° rule."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from simulator.randomness import stream
from simulator.study.style import BLUE, GREEN, INK, ORANGE, SOFT, VERMILION
from simulator.theses.printed import Section, new_figure
from simulator.theses.tables import Values, table_rows
from startracker.estimation.star_pair import pitch_error_deg, star_pair

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["least_separation_deg", "measured_pitch_errors_deg", "section"]

FloatArray = NDArray[np.float64]

ACCURACY_DEG = 0.002
"""Of a centroid, along either axis: 0.1 of a pixel of 10°/512."""

PIXEL_DEG, FIELD_DEG = 0.02, 10.0
SPECIFIED_DEG = 0.286


def least_separation_deg(
    pitch_deg: float = SPECIFIED_DEG, accuracy_deg: float = ACCURACY_DEG, direction_deg: float = 0.0
) -> float:
    """Separation, degrees, from which on eq. 5.13 stays below a pitch error, for pairs along a direction in the field.

    Parameters
    ----------
    pitch_deg : float
        Error allowed.
    accuracy_deg : float
        Of a centroid along either axis.
    direction_deg : float
        Of the line between the stars from the x axis, 0 to 90.
    """
    angle = np.radians(direction_deg)

    def excess(separation: float) -> float:
        x, y = separation * np.cos(angle), separation * np.sin(angle)
        return float(pitch_error_deg(x, y, accuracy_deg)) - pitch_deg

    return float(brentq(excess, 4.0 * accuracy_deg, 180.0, xtol=1e-12))


def measured_pitch_errors_deg(
    separation_deg: float, pairs: int = 200, accuracy_deg: float = ACCURACY_DEG, seed: int = 1
) -> FloatArray:
    """Errors (pairs,) about the boresight, degrees, of the attitude from one pair of stars by our `star_pair`.

    Pairs lie about the middle of the field in random directions; each star is measured wrongly by up to
    ±`accuracy_deg` along either axis, evenly.
    """
    rng = stream(seed, "greyling1995 pitch", round(1e6 * separation_deg))
    errors = []
    for _ in range(pairs):
        angle = rng.uniform(0.0, np.pi)
        half = 0.5 * np.tan(np.radians(separation_deg)) * np.array([np.cos(angle), np.sin(angle)])
        true = np.stack([half, -half])
        seen = true + np.tan(np.radians(rng.uniform(-accuracy_deg, accuracy_deg, (2, 2))))
        turned = star_pair(_unit(seen), _unit(true), np.full(2, np.radians(accuracy_deg))).matrix
        errors.append(np.degrees(np.arctan2(turned[1, 0] - turned[0, 1], turned[0, 0] + turned[1, 1])))
    return np.array(errors)


def _unit(plane: FloatArray) -> FloatArray:
    vectors = np.column_stack([plane, np.ones(len(plane))])
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def section(pairs: int = 200) -> Section:
    """Section 5.3: eq. 5.13 and the rule that follows, and Figs. 5.10 and 5.11.

    Parameters
    ----------
    pairs : int
        Random pairs at each separation that the tracker's own estimator is tried on.
    """
    figures: dict[str, Callable[[], Figure]] = {
        "fig_5_10_pair": _pair_figure,
        "fig_5_11_pitch": partial(_pitch_figure, pairs),
    }
    rows = table_rows("greyling1995/pitch", _values(pairs))
    return Section("Chapter 5.3: pitch from a pair of stars", rows, figures)


def _values(pairs: int) -> Values:
    along, measured = least_separation_deg(), measured_pitch_errors_deg(least_separation_deg(), pairs)
    far, near = (float(pitch_error_deg(apart, apart, ACCURACY_DEG)) for apart in (FIELD_DEG, 3 * PIXEL_DEG))
    return {
        "far": far,
        "near": near,
        "diagonal_deg": np.hypot(FIELD_DEG, FIELD_DEG),
        "along": along,
        "diagonal": least_separation_deg(direction_deg=45.0),
        "half_range_deg": 0.5 * float(pitch_error_deg(along, 0.0, ACCURACY_DEG)),
        "any_direction_deg": least_separation_deg(2 * SPECIFIED_DEG, direction_deg=45.0),
        "largest_deg": np.abs(measured).max(),
        "rms_deg": np.sqrt(np.mean(measured**2)),
        "kept": np.abs(measured).max() <= SPECIFIED_DEG,
        "pairs": pairs,
    }


def _pair_figure(separation: float = 1.0, accuracy: float = 0.12) -> Figure:
    """Two stars and the squares that their centroids lie in, with the steepest and the flattest line; not to scale."""
    from matplotlib.patches import Rectangle

    figure, axes = new_figure(1, 1, (4.6, 3.9))
    stars = np.array([[0.0, 0.0], [1.2, 0.8]]) * separation
    for x, y in stars:
        square = (x - accuracy, y - accuracy)
        axes.add_patch(Rectangle(square, 2 * accuracy, 2 * accuracy, fill=False, edgecolor=SOFT))
    axes.plot(*stars.T, "o-", color=INK, linewidth=1.0, label="θ")
    for sign, colour, line, name in ((1.0, VERMILION, "--", "θ max"), (-1.0, BLUE, "-.", "θ min")):
        shift = sign * accuracy * np.array([1.0, -1.0])
        ends = np.stack([stars[0] + shift, stars[1] - shift])
        axes.plot(*ends.T, color=colour, linestyle=line, label=name)
    axes.annotate("2 δx", (0.0, -accuracy), xytext=(0, -14), textcoords="offset points", ha="center")
    axes.annotate("2 δy", (-accuracy, 0.0), xytext=(-16, -3), textcoords="offset points", ha="center")
    axes.set_aspect("equal")
    axes.margins(0.16)
    axes.set(
        xticks=[],
        yticks=[],
        xlabel="x (not to scale)",
        ylabel="y (not to scale)",
        title="Fig. 5.10  Pitch angle accuracy",
    )
    axes.legend(loc="upper left")
    return figure


def _pitch_figure(pairs: int) -> Figure:
    figure, (left, right) = new_figure(1, 2, (7.6, 3.9))
    separation = np.geomspace(3 * PIXEL_DEG, FIELD_DEG, 200)
    for accuracy, colour, line in ((0.002, BLUE, "-"), (0.001, GREEN, "-."), (0.0005, ORANGE, ":")):
        left.plot(separation, pitch_error_deg(separation, separation, accuracy), color=colour, linestyle=line,
                  label=f"δx = δy = {accuracy:g}°")  # fmt: skip
    left.plot([10.0, 0.06], [0.0458, 7.62], "k*", markersize=10, label="printed")
    left.set(xlabel="x = y [°]", ylabel="θ_err, eq. 5.13 [°]", title="eq. 5.13 for x = y")
    angle = np.linspace(0.0, 0.5 * np.pi, 31)
    errors = pitch_error_deg(separation[:, None] * np.cos(angle), separation[:, None] * np.sin(angle), ACCURACY_DEG)
    right.fill_between(separation, errors.min(axis=1), errors.max(axis=1), color=BLUE, alpha=0.3, linewidth=0,
                       label="eq. 5.13, all directions")  # fmt: skip
    some = np.geomspace(3 * PIXEL_DEG, FIELD_DEG, 12)
    tried = [np.abs(measured_pitch_errors_deg(value, pairs)) for value in some]
    right.plot(some, [t.max() for t in tried], color=VERMILION, linestyle="--", marker="s", markersize=4,
               label=f"star_pair, largest of {pairs}")  # fmt: skip
    right.plot(some, [np.sqrt(np.mean(t**2)) for t in tried], color=GREEN, linestyle="-.", marker="o", markersize=4,
               label="star_pair, rms")  # fmt: skip
    right.set(
        xlabel="angular separation [°]",
        ylabel="error about the boresight [°]",
        title=f"by separation, δ = {ACCURACY_DEG:g}°",
    )
    for axes in (left, right):
        axes.axhline(SPECIFIED_DEG, color=INK, linewidth=0.9, linestyle="--")
        axes.axvline(least_separation_deg(), color=INK, linewidth=0.9, linestyle=":", label="0.286° and 1.6°")
        axes.set(xscale="log", yscale="log", ylim=(0.003, 20.0))
        axes.legend(loc="lower left", frameon=True, facecolor="white", edgecolor="none", framealpha=1.0)
    figure.suptitle("Fig. 5.11  Pitch angle accuracy", fontsize=10)
    return figure
