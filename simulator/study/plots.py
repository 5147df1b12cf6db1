"""Plots of a study: each function draws one figure from the columns of the trials.

Colours are those of Okabe & Ito (2008), told apart by the colour-blind and in grey print; markers differ as well.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from simulator.study.statistics import AXES, BODY_AXES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from simulator.frame import Frame, FrameTruth
    from startracker.catalog.stars import StarCatalog
    from startracker.solution import Solution

BLUE, ORANGE, GREEN, VERMILION, GREY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#777777"
TITLES = {
    "roll": "roll (about X, velocity)",
    "pitch": "pitch (about Y, minus orbit normal)",
    "yaw": "yaw (about Z, nadir)",
    "cross_x": "cross-boresight x",
    "cross_y": "cross-boresight y",
    "about_boresight": "about the boresight",
}
Columns = dict[str, NDArray[Any]]

_STYLE: Any = {
    "font.size": 9,
    "axes.grid": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "figure.constrained_layout.use": True,
    "svg.hashsalt": "boresight",  # the same figure is the same file
}


def _figure(rows: int, columns: int, size: tuple[float, float], **axes: Any) -> tuple[Figure, Any]:
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with rc_context(_STYLE):
        figure = Figure(figsize=size)
        FigureCanvasAgg(figure)
        return figure, figure.subplots(rows, columns, squeeze=False, **axes)


def _arcsec(values_deg: NDArray[Any]) -> NDArray[np.float64]:
    return np.asarray(values_deg, dtype=float) * 3600.0


def error_histograms(columns: Columns, specification_deg: dict[str, float]) -> Figure:
    """Histograms of the errors about the body and the camera axes, with mean ± 3σ and the specification."""
    solved = columns["status"] == "solved"
    figure, grid = _figure(2, 3, (10, 5.4))
    for ax, axis in zip(grid.ravel(), AXES, strict=True):
        errors = _arcsec(columns[f"error_{axis}_deg"][solved])
        ax.set_title(TITLES[axis], fontsize=9)
        ax.set_xlabel("error [arcsec]")
        ax.set_ylabel("trials")
        if not len(errors):
            _note(ax, "nothing solved")
            continue
        reach = max(float(np.percentile(np.abs(errors), 99.7)) * 1.25, 1e-6)
        outside = int(np.sum(np.abs(errors) > reach))
        ax.hist(errors, bins=np.linspace(-reach, reach, 41), color=BLUE, edgecolor="white", linewidth=0.3)
        three_sigma = 3 * float(np.sqrt(np.mean(errors**2)))
        for sign in (-1, 1):
            ax.axvline(
                sign * three_sigma,
                color=ORANGE,
                linestyle="--",
                label=f"±3σ = {three_sigma:.3g}″" if sign > 0 else None,
            )
        if axis in BODY_AXES:
            limit = specification_deg[axis] * 3600.0
            if limit < 3 * max(reach, three_sigma):
                for sign in (-1, 1):
                    ax.axvline(sign * limit, color=VERMILION, label=f"specified ±{limit:.4g}″" if sign > 0 else None)
            else:
                ax.plot([], [], color=VERMILION, label=f"specified ±{limit:.4g}″ (outside)")
        if outside:
            ax.plot([], [], " ", label=f"{outside} beyond the plot")
        ax.legend(fontsize=7, loc="upper right", framealpha=0.9)
        ax.set_ylim(0, ax.get_ylim()[1] * 1.35)
    return figure


def error_against_stars(columns: Columns) -> Figure:
    """Magnitude of the errors against the number of stars matched: every trial, and the rms at each number."""
    solved = columns["status"] == "solved"
    stars = np.asarray(columns["stars_matched"])[solved]
    figure, grid = _figure(1, 3, (10, 3.4))
    for ax, axis in zip(grid.ravel(), BODY_AXES, strict=True):
        errors = np.abs(_arcsec(columns[f"error_{axis}_deg"][solved]))
        ax.set_title(TITLES[axis], fontsize=9)
        ax.set_xlabel("stars matched")
        ax.set_ylabel("|error| [arcsec]")
        if not len(errors):
            _note(ax, "nothing solved")
            continue
        ax.semilogy(stars, np.maximum(errors, 1e-4), ".", color=BLUE, alpha=0.35, markersize=3, label="trial")
        numbers = np.unique(stars)
        numbers = numbers[[np.sum(stars == n) >= 3 for n in numbers]] if len(numbers) else numbers
        rms = [float(np.sqrt(np.mean(errors[stars == n] ** 2))) for n in numbers]
        ax.semilogy(numbers, rms, "s-", color=VERMILION, markersize=3.5, linewidth=1.2, label="rms (3 trials or more)")
        ax.legend(fontsize=7)
    return figure


def sky_path(columns: Columns, catalog: StarCatalog, magnitude_limit: float = 4.5) -> Figure:
    """Boresights of all trials over the sky, in the thesis' Sanson-Flamsteed projection, RA growing to the left."""
    figure, grid = _figure(1, 1, (10, 5))
    ax = grid[0, 0]

    def plane(ra_deg: NDArray[Any], dec_deg: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        offset = (np.asarray(ra_deg, dtype=float) - 180.0 + 180.0) % 360.0 - 180.0
        return -offset * np.cos(np.radians(dec_deg)) + 180.0, np.asarray(dec_deg, dtype=float)

    latitude = np.linspace(-90, 90, 181)
    for meridian in range(0, 361, 30):
        ax.plot(180.0 - (meridian - 180.0) * np.cos(np.radians(latitude)), latitude, color="#cccccc", linewidth=0.5)
    for parallel in range(-60, 61, 30):
        reach = 180.0 * np.cos(np.radians(parallel))
        ax.plot([180 - reach, 180 + reach], [parallel, parallel], color="#cccccc", linewidth=0.5)
    bright = catalog.brighter_than(magnitude_limit)
    x, y = plane(np.degrees(bright.ra_rad), np.degrees(bright.dec_rad))
    ax.scatter(
        x,
        y,
        s=10 ** (0.22 * (magnitude_limit - bright.v_mag)),
        color=GREY,
        linewidths=0,
        label=f"stars, V ≤ {magnitude_limit:g}",
    )
    for label, pole, style in (("ecliptic", _ECLIPTIC_POLE, "--"), ("galactic plane", _GALACTIC_POLE, ":")):
        ra, dec = _great_circle(pole)
        x, y = plane(ra, dec)
        cuts = np.flatnonzero(np.abs(np.diff(x)) > 90) + 1
        for n, (px, py) in enumerate(zip(np.split(x, cuts), np.split(y, cuts), strict=True)):
            ax.plot(
                px, py, style, color=ORANGE if style == "--" else GREEN, linewidth=1.2, label=label if n == 0 else None
            )
    solved = columns["status"] == "solved"
    for mask, colour, marker, label in (
        (solved, BLUE, ".", "solved"),
        (~solved, VERMILION, "x", "not solved"),
        (np.asarray(columns["wrong"], dtype=bool), "black", "*", "wrong"),
    ):
        if np.any(mask):
            x, y = plane(columns["true_ra_deg"][mask], columns["true_dec_deg"][mask])
            ax.plot(
                x,
                y,
                marker,
                color=colour,
                markersize=3 if marker == "." else 7,
                label=f"boresight, {label} ({int(np.sum(mask))})",
            )
    ax.set_aspect("equal")
    ax.set_xlim(0, 360)
    ax.set_ylim(-90, 90)
    ax.set_xticks(
        range(0, 361, 30),
        [f"{(360 - ra) % 360}°" if ra not in (0, 360) else ("360°" if ra == 0 else "0°") for ra in range(0, 361, 30)],
    )
    ax.set_yticks(range(-90, 91, 30), [f"{d:+d}°" if d else "0°" for d in range(-90, 91, 30)])
    ax.set_xlabel("right ascension (ICRS), at the equator")
    ax.set_ylabel("declination (ICRS)")
    ax.grid(visible=False)
    figure.legend(fontsize=8, loc="outside lower center", ncols=6, frameon=False)
    return figure


_ECLIPTIC_POLE = (270.0, 66.5607)
_GALACTIC_POLE = (192.85948, 27.12825)  # J2000, Hipparcos catalogue vol. 1, section 1.5.3


def _great_circle(pole_deg: tuple[float, float]) -> tuple[NDArray[Any], NDArray[Any]]:
    ra, dec = np.radians(pole_deg)
    node = np.array([-np.sin(ra), np.cos(ra), 0.0])
    third = np.array([-np.sin(dec) * np.cos(ra), -np.sin(dec) * np.sin(ra), np.cos(dec)])
    t = np.linspace(0, 2 * np.pi, 721)[:, None]
    circle = np.cos(t) * node + np.sin(t) * third
    return np.degrees(np.arctan2(circle[:, 1], circle[:, 0])) % 360, np.degrees(np.arcsin(circle[:, 2]))


def solved_image(image: NDArray[Any], solution: Solution) -> Figure:
    """An image as the camera sees it, with its detections and its identified stars."""
    height, width = image.shape
    figure, grid = _figure(1, 1, (7.4, 7.4 * min(1.3, height / width) + 0.6))
    draw_solution(grid[0, 0], np.asarray(image, dtype=float), solution)
    return figure


def frame_preview(frame: Frame, truth: FrameTruth, names: int = 12) -> Figure:
    """A frame with its brightest true sources by name."""
    height, width = frame.image.shape
    figure, grid = _figure(1, 1, (7.4, 7.4 * min(1.3, height / width) + 0.6))
    ax = grid[0, 0]
    _show_sky(ax, np.asarray(frame.image, dtype=float))
    inside = np.flatnonzero(frame.camera.contains(truth.sources.xy))
    for i in inside[np.argsort(-truth.sources.electrons[inside])][:names]:
        _label(ax, truth.sources.xy[i], width, truth.sources.name[i], truth.sources.id[i], truth.sources.v_mag[i])
    ax.set_title(
        f"{frame.scenario} {frame.index}  {frame.utc} UTC  RA {truth.attitude.ra_deg:.4f}°  "
        f"Dec {truth.attitude.dec_deg:+.4f}°  roll {truth.attitude.roll_deg:.3f}°",
        fontsize=8,
    )
    return figure


def _show_sky(ax: Axes, image: NDArray[Any]) -> None:
    """Image in reversed grey with an arcsinh stretch: sky white, stars dark, faint and bright at once."""
    low = float(np.nanmedian(image))
    spread = float(np.nanmedian(np.abs(image - low))) * 1.4826 or float(np.nanstd(image)) or 1.0
    soft = 4.0 * spread  # the noise stays pale, stars grow dark at once
    top = max(float(np.nanpercentile(image, 99.97)), low + 5 * soft)
    stretched = np.arcsinh(np.clip(image - low, 0, None) / soft) / np.arcsinh((top - low) / soft)
    ax.imshow(stretched, cmap="Greys", vmin=0, vmax=1.1, origin="upper", interpolation="nearest")
    ax.grid(visible=False)
    for side in ("top", "right"):
        ax.spines[side].set_visible(True)
    ax.set_xlim(-0.5, image.shape[1] - 0.5)
    ax.set_ylim(image.shape[0] - 0.5, -0.5)
    ax.set_xlabel("column [px]")
    ax.set_ylabel("row [px]")


def draw_solution(ax: Axes, image: NDArray[Any], solution: Solution, names: int = 25) -> None:
    """Draw an image in reversed grey with what was detected and identified, the brightest `names` stars by name."""
    _show_sky(ax, image)
    if len(solution.centroids):
        ax.plot(*solution.centroids.T, "s", ms=9, mfc="none", mec=ORANGE, mew=0.7,
                label=f"detected ({len(solution.centroids)})")  # fmt: skip
    if solution.matched:
        ax.plot(*solution.stars.xy.T, "o", ms=13, mfc="none", mec=BLUE, mew=1.1,
                label=f"identified ({solution.matched})")  # fmt: skip
        for i in np.argsort(solution.stars.v_mag)[:names]:
            stars = solution.stars
            _label(ax, stars.xy[i], image.shape[1], stars.name[i], stars.catalog_id[i], stars.v_mag[i])
    if solution.solved:
        ax.set_title(
            f"RA {solution.ra_deg:.4f}°  Dec {solution.dec_deg:+.4f}°  roll {solution.roll_deg:.3f}°"
            + (f"  field {solution.fov_deg:.3f}°" if solution.fov_deg else ""),
            fontsize=9,
        )
    else:
        ax.set_title(f"{solution.status}: {solution.reason}", fontsize=9, wrap=True)
    if ax.get_legend_handles_labels()[0]:
        ax.figure.legend(
            *ax.get_legend_handles_labels(), fontsize=8, loc="outside lower center", ncols=3, frameon=False
        )


def _label(ax: Axes, xy: NDArray[Any], width: int, name: Any, number: Any, v_mag: float) -> None:
    """Name, or number, and magnitude beside a star, on the side where there is room."""
    from matplotlib.patheffects import withStroke

    right = xy[0] > 0.82 * width
    ax.annotate(
        f"{' '.join(str(name).split()) or number} {v_mag:.1f}",
        (float(xy[0]), float(xy[1])),
        xytext=(-8 if right else 8, 4),
        textcoords="offset points",
        fontsize=6.5,
        color=BLUE,
        ha="right" if right else "left",
        annotation_clip=True,
        path_effects=[withStroke(linewidth=1.5, foreground="white")],
    )


def _note(ax: Axes, text: str) -> None:
    ax.text(0.5, 0.5, text, transform=ax.transAxes, ha="center", va="center", color=GREY)


def save_bytes(figure: Figure, form: str = "png", dpi: int = 130) -> bytes:
    """Figure as the bytes of a PNG or SVG file, the same bytes for the same figure."""
    import io

    stream = io.BytesIO()
    figure.savefig(stream, format=form, dpi=dpi, metadata={"Software": None} if form == "png" else {"Date": None})
    return stream.getvalue()
