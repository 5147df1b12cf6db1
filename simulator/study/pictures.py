"""Frames as pictures: as a camera shows the sky, with pixel axes and names, and with what the tracker found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from simulator.study.style import PICTURE_STYLE, new_figure
from startracker.annotation.labels import Label, Labels
from startracker.catalog.names import designation, proper_name
from startracker.images.picture import rgb_pixels, stretch
from startracker.images.star_colours import tinted

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from simulator.frame import Frame, FrameTruth
    from startracker.solution import Solution

_DETECTED, _IDENTIFIED, _NAME = "#F0A830", "#56B4E9", "#f5f7fa"
_GREYS = 64
_LABEL_POINTS = 6.5
_MARK_POINTS = 11.0
MOST_NAMES = 12
"""Sources of a preview that are named."""


def frame_picture(frame: Frame, truth: FrameTruth | None = None) -> NDArray[np.uint8]:
    """Pixels (H, W, 3) of a frame as a camera shows the sky, in the colours of its stars if their `truth` is given."""
    if truth is None:
        return rgb_pixels(stretch(frame.image))
    sources = truth.sources
    inside = frame.camera.contains(sources.image_xy)
    columns = (sources.image_xy[inside], sources.electrons[inside], sources.b_v[inside])
    return rgb_pixels(stretch(tinted(frame.image, *columns)))


def frame_preview(frame: Frame, truth: FrameTruth) -> Figure:
    """A frame with pixel axes and the names of its brightest true sources."""
    figure, ax = _image_figure(frame.image.shape)
    sources = truth.sources
    _show_sky(ax, shades_of(frame.image), axes=True)
    ax.set_title(
        f"{frame.scenario} {frame.index}  {frame.utc} UTC  RA {truth.attitude.ra_deg:.4f}°  "
        f"Dec {truth.attitude.dec_deg:+.4f}°  roll {truth.attitude.roll_deg:.3f}°",
        fontsize=8,
    )
    inside = np.flatnonzero(frame.camera.contains(sources.xy))
    brightest = inside[np.argsort(-sources.electrons[inside])][:MOST_NAMES]
    rows = [(sources.xy[i], sources.name[i], sources.id[i], sources.v_mag[i]) for i in brightest]
    _write_names(ax, rows, 4.0, np.empty((0, 2)))
    return figure


def solved_image(image: NDArray[Any], solution: Solution) -> Figure:
    """An image as the camera sees it, with its detections and its identified stars."""
    figure, ax = _image_figure(image.shape)
    draw_solution(ax, shades_of(image), solution, title_of(solution))
    return figure


@dataclass(frozen=True, eq=False)
class Shades:
    """An image as it is drawn."""

    grey: NDArray[np.uint8]
    """Brightness from 0 to 255, in few greys."""
    width: int
    height: int
    """Of the image itself."""


def shades_of(image: NDArray[Any], preview_px: int | None = None) -> Shades:
    """Stretched image to be drawn.

    With `preview_px` at most so many samples a side, each the brightest pixel of its block so that no star is lost, and
    in few greys: a small file.
    """
    height, width = image.shape
    shown = stretch(image)
    if preview_px is not None:
        shown = _brightest_of_blocks(shown, -(-max(image.shape) // preview_px))
    greys = 255 if preview_px is None else _GREYS
    return Shades(np.round(np.round(greys * shown) * (255.0 / greys)).astype(np.uint8), width, height)


def title_of(solution: Solution) -> str:
    """Attitude and field of a solution, or why there is none."""
    if not solution.solved:
        return f"{solution.status}: {solution.reason}"
    field = f"  field {solution.camera.fov_text}" if solution.camera else ""
    return f"RA {solution.ra_deg:.4f}°  Dec {solution.dec_deg:+.4f}°  roll {solution.roll_deg:.3f}°{field}"


def draw_solution(ax: Axes, shades: Shades, solution: Solution, title: str, names: int = 25) -> None:
    """Draw an image with what was detected and identified, the brightest `names` stars by name."""
    _show_sky(ax, shades)
    if len(solution.centroids):
        ax.plot(*solution.centroids.T, "s", ms=8, mfc="none", mec=_DETECTED, mew=0.7,
                label=f"detected ({len(solution.centroids)})")  # fmt: skip
    if solution.matched:
        ax.plot(*solution.stars.xy.T, "o", ms=_MARK_POINTS, mfc="none", mec=_IDENTIFIED, mew=1.0,
                label=f"identified ({solution.matched})")  # fmt: skip
    small = solution.solved and ax.get_window_extent().width < 450
    ax.set_title(title, fontsize=6.5 if small else 9, wrap=not solution.solved)
    if marks := ax.get_legend_handles_labels()[0]:
        ax.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.01), ncols=len(marks), frameon=False)
    stars = solution.stars
    brightest = np.argsort(stars.v_mag, kind="stable")[:names]
    rows = [(stars.xy[i], stars.name[i], stars.catalog_id[i], stars.v_mag[i]) for i in brightest]
    _write_names(ax, rows, _MARK_POINTS, solution.centroids)


def _image_figure(shape: tuple[int, ...]) -> tuple[Figure, Axes]:
    """Figure for an image of this height and width, and its axes."""
    height, width = shape[:2]
    figure, ax = new_figure(PICTURE_STYLE, 1, 1, (7.4, 7.4 * min(1.3, height / width) + 0.6))
    return figure, ax


def _show_sky(ax: Axes, shades: Shades, *, axes: bool = False) -> None:
    """Show the pixels, positive, with pixel axes only where they are asked for."""
    width, height = shades.width, shades.height
    extent = (-0.5, width - 0.5, height - 0.5, -0.5)
    ax.imshow(shades.grey, cmap="gray", vmin=0, vmax=255, origin="upper", interpolation="none", extent=extent, zorder=0)
    ax.grid(visible=False)
    ax.set_xlim(-0.5, width - 0.5)
    ax.set_ylim(height - 0.5, -0.5)
    if not axes:
        ax.set_axis_off()
        return
    for side in ("top", "right"):
        ax.spines[side].set_visible(True)
    ax.set_xlabel("column [px]")
    ax.set_ylabel("row [px]")


def _write_names(
    ax: Axes, rows: list[tuple[Any, Any, Any, Any]], mark_points: float, others: NDArray[np.float64]
) -> None:
    """Write name (or number) and magnitude beside stars; no name covers another, a star or one of the other marks.

    Parameters
    ----------
    ax : Axes
    rows : list of (pixel, name, number, V)
    mark_points : float
        Diameter of the marks.
    others : float array, shape (N, 2)
        Pixels of the other marks.
    """
    figure: Any = ax.figure
    figure.draw_without_rendering()  # lays the axes out, in which the labels find room
    labels = Labels(ax)
    for xy in (*(row[0] for row in rows), *others):
        labels.occupy(xy, mark_points)
    for xy, name, number, v_mag in rows:
        text = f"{proper_name(str(name)) or designation(str(name)) or number} {v_mag:.1f}"
        labels.beside(Label(xy, mark_points, text, _NAME, _LABEL_POINTS))


def _brightest_of_blocks(image: NDArray[Any], block: int) -> NDArray[Any]:
    height, width = image.shape
    padded = np.pad(image, ((0, -height % block), (0, -width % block)), mode="edge")
    return np.asarray(padded.reshape(padded.shape[0] // block, block, padded.shape[1] // block, block).max(axis=(1, 3)))
