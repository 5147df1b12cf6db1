"""Plots of a study: each function draws one figure from the columns of the trials.

Colours are those of Okabe & Ito (2008), distinguishable with colour-blindness and in greyscale print; markers differ as
well.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from simulator.study.style import PICTURE_STYLE, new_figure
from startracker.picture import figure_bytes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from simulator.frame import Frame, FrameTruth
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


def picture(rows: int, columns: int, size: tuple[float, float], **axes: Any) -> tuple[Figure, NDArray[Any]]:
    """Empty picture of `size` inches, and its axes (rows, columns); `axes` go to matplotlib's ``subplots``."""
    return new_figure(PICTURE_STYLE, rows, columns, size, squeeze=False, **axes)


def solved_image(image: NDArray[Any], solution: Solution) -> Figure:
    """An image as the camera sees it, with its detections and its identified stars."""
    height, width = image.shape
    figure, grid = picture(1, 1, (7.4, 7.4 * min(1.3, height / width) + 0.6))
    draw_solution(grid[0, 0], shades_of(np.asarray(image, dtype=float)), solution)
    return figure


def frame_preview(frame: Frame, truth: FrameTruth) -> Figure:
    """A frame with the names of its brightest true sources."""
    height, width = frame.image.shape
    figure, grid = picture(1, 1, (7.4, 7.4 * min(1.3, height / width) + 0.6))
    ax = grid[0, 0]
    _show_sky(ax, shades_of(np.asarray(frame.image, dtype=float)))
    sources = truth.sources
    inside = np.flatnonzero(frame.camera.contains(sources.xy))
    for i in inside[np.argsort(-sources.electrons[inside])][:MOST_NAMES]:
        _label(ax, sources.xy[i], (height, width), sources.name[i], sources.id[i], sources.v_mag[i])
    ax.set_title(
        f"{frame.scenario} {frame.index}  {frame.utc} UTC  RA {truth.attitude.ra_deg:.4f}°  "
        f"Dec {truth.attitude.dec_deg:+.4f}°  roll {truth.attitude.roll_deg:.3f}°",
        fontsize=8,
    )
    return figure


_FEW_GREYS = 24
MOST_NAMES = 12
"""Maximum number of named sources in a preview."""


@dataclass(frozen=True, eq=False)
class Shades:
    """An image prepared for display."""

    grey: NDArray[Any]
    """How dark; `whole` is black."""
    whole: int
    """1 for real numbers, more for a small picture of few greys."""
    width: int
    height: int
    """Of the image itself."""


def shades_of(image: NDArray[Any], preview_px: int | None = None) -> Shades:
    """Inverted greyscale with an arcsinh stretch: dark stars on a white sky.

    With `preview_px` at most this number of samples per side, each the brightest pixel of its block so that no star is
    lost, and with few grey levels, for a small file.
    """
    low, high, spread = _levels(image)
    soft = 4.0 * spread  # the noise stays pale, stars grow dark at once
    top = max(high, low + 5 * soft)
    samples = image if preview_px is None else _brightest_of_blocks(image, -(-max(image.shape) // preview_px))
    stretched = np.arcsinh(np.clip(samples - low, 0, None) / soft) / np.arcsinh((top - low) / soft)
    height, width = image.shape
    if preview_px is None:
        return Shades(stretched, 1, width, height)
    return Shades(np.minimum(np.round(stretched * _FEW_GREYS), 255).astype(np.uint8), _FEW_GREYS, width, height)


def _show_sky(ax: Axes, shades: Shades) -> None:
    from matplotlib import colormaps

    width, height = shades.width, shades.height
    # bytes: resampling in floating point would take eight times the memory
    rgba = colormaps["Greys"](shades.grey / shades.whole / 1.1, bytes=True)
    extent = (-0.5, width - 0.5, height - 0.5, -0.5)
    ax.imshow(rgba, origin="upper", interpolation="nearest", extent=extent)
    ax.grid(visible=False)
    for side in ("top", "right"):
        ax.spines[side].set_visible(True)
    ax.set_xlim(-0.5, width - 0.5)
    ax.set_ylim(height - 0.5, -0.5)
    ax.set_xlabel("column [px]")
    ax.set_ylabel("row [px]")


def _levels(image: NDArray[Any]) -> tuple[float, float, float]:
    """Median, 99.97th percentile and robust standard deviation; as float32, exact for 16 bits, to save memory."""
    values = image.astype(np.float32)
    low, high = float(np.nanmedian(values)), float(np.nanpercentile(values, 99.97))
    values -= np.float32(low)
    np.abs(values, out=values)
    spread = float(np.nanmedian(values, overwrite_input=True)) * 1.4826
    return low, high, spread or float(np.nanstd(image)) or 1.0


def _brightest_of_blocks(image: NDArray[Any], block: int) -> NDArray[Any]:
    height, width = image.shape
    padded = np.pad(image, ((0, -height % block), (0, -width % block)), mode="edge")
    return np.asarray(padded.reshape(padded.shape[0] // block, block, padded.shape[1] // block, block).max(axis=(1, 3)))


def draw_solution(ax: Axes, shades: Shades, solution: Solution, names: int = 25) -> None:
    """Draw an image in reversed grey with what was detected and identified, the brightest `names` stars by name."""
    _show_sky(ax, shades)
    if len(solution.centroids):
        ax.plot(*solution.centroids.T, "s", ms=9, mfc="none", mec=ORANGE, mew=0.7,
                label=f"detected ({len(solution.centroids)})")  # fmt: skip
    if solution.matched:
        ax.plot(*solution.stars.xy.T, "o", ms=13, mfc="none", mec=BLUE, mew=1.1,
                label=f"identified ({solution.matched})")  # fmt: skip
        for i in np.argsort(solution.stars.v_mag)[:names]:
            stars = solution.stars
            _label(ax, stars.xy[i], (shades.height, shades.width), stars.name[i], stars.catalog_id[i], stars.v_mag[i])
    if solution.solved:
        ax.set_title(
            f"RA {solution.ra_deg:.4f}°  Dec {solution.dec_deg:+.4f}°  roll {solution.roll_deg:.3f}°"
            + (f"  field {solution.fov_deg:.3f}°" if solution.fov_deg else ""),
            fontsize=7 if shades.whole > 1 else 9,
        )
    else:
        ax.set_title(f"{solution.status}: {solution.reason}", fontsize=9, wrap=True)
    if ax.get_legend_handles_labels()[0]:
        ax.legend(
            fontsize=8,
            loc="upper center",
            bbox_to_anchor=(0.5, -0.13 if shades.whole > 1 else -0.09),
            ncols=3,
            frameon=False,
        )


def _label(ax: Axes, xy: NDArray[Any], shape: tuple[int, ...], name: Any, number: Any, v_mag: float) -> None:
    """Name, or number, and magnitude beside a star, on the side where there is room."""
    from matplotlib.patheffects import withStroke

    right, top = xy[0] > 0.82 * shape[1], xy[1] < 0.04 * shape[0]
    ax.annotate(
        f"{' '.join(str(name).split()) or number} {v_mag:.1f}",
        (float(xy[0]), float(xy[1])),
        xytext=(-8 if right else 8, -9 if top else 4),
        textcoords="offset points",
        fontsize=6.5,
        color=BLUE,
        ha="right" if right else "left",
        annotation_clip=True,
        path_effects=[withStroke(linewidth=1.5, foreground="white")],
    )


def save_bytes(figure: Figure, form: str = "png", dpi: int = 130) -> bytes:
    """Figure as the bytes of a PNG, SVG or PDF file, the same bytes for the same figure."""
    return figure_bytes(figure, form, dpi=dpi)
