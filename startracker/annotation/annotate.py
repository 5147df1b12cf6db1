"""A solved image as a picture: stars by name, deep-sky objects, planets, constellations, grid, compass, scale.

The image is shown as a camera shows the sky (`startracker.images.picture.stretch`), a colour image in its colours. The
colours of the marks follow Okabe & Ito (2008), which colour-blind readers can distinguish, some lightened; the
symbols differ as well. Sizes are fractions of the picture's size. Matplotlib is imported with the first picture.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from startracker.annotation import marks
from startracker.annotation.labels import Labels
from startracker.annotation.sky import compass_arrows, field_text, nice_step
from startracker.catalog import load_catalog
from startracker.catalog.stars import StarCatalog
from startracker.images.picture import figure_bytes, stretch
from startracker.images.star_colours import tinted
from startracker.observer import Observer
from startracker.solution import Solution

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["annotate", "annotated_picture", "star_coloured", "stretch"]

TEXT = marks.TEXT
_BACKGROUND = "#101418"
_SIDE_IN = 10.0
_LEAST_PX, _MOST_PX = 1400, 2400
_MOST_ENTRIES = 6
"""Largest number of entries in the legend."""


def annotated_picture(image: NDArray[Any], solution: Solution, form: str = "png", **options: Any) -> bytes:
    """File of the figure of `annotate` in one of `startracker.images.picture.FORMATS`, as bytes; deterministic."""
    figure = annotate(image, solution, **options)
    fast = {"pil_kwargs": {"compress_level": 3}} if form == "png" else {}
    return figure_bytes(figure, form, facecolor=_BACKGROUND, **fast)


def annotate(
    image: NDArray[Any],
    solution: Solution,
    *,
    names: int = 40,
    grid: bool = False,
    constellations: bool = False,
    deep_sky: bool = True,
    catalog: str | StarCatalog = "hipparcos",
    observer: Observer | None = None,
) -> Figure:
    """Figure of an image with its detections and identified stars.

    Parameters
    ----------
    image : array, shape (H, W) or (H, W, 3)
        The image that was solved, or its colours.
    solution : Solution
        If it is not solved, the detections and the reason are shown.
    names : int
        Maximum number of stars to label; labels that would overlap another are left out.
    grid : bool
        Draw lines of right ascension and declination.
    constellations : bool
        Draw constellation lines.
    deep_sky : bool
        Mark the Messier objects, and bright objects of the NGC and IC.
    catalog : str or StarCatalog
        Source of names, constellation lines and of the stars that were expected but not detected.
    observer : Observer, optional
        The observer that was passed to the solve. Its epoch gives the positions of the planets, which are then marked.

    Returns
    -------
    Figure
        Matplotlib figure with its own canvas; pyplot's state is not changed.
    """
    from matplotlib import rc_context

    with rc_context({"font.size": 8, "svg.hashsalt": "boresight"}):
        figure, ax = _canvas(image.shape)
        ax.imshow(stretch(image), cmap="gray", vmin=0.0, vmax=1.0, origin="upper", interpolation="antialiased")
        ax.set_xlim(-0.5, image.shape[1] - 0.5)
        ax.set_ylim(image.shape[0] - 0.5, -0.5)
        labels = Labels(ax)
        marks.mark_others(ax, solution, labels)
        if solution.solved:
            stars = load_catalog(catalog) if isinstance(catalog, str) else catalog
            field = marks.FieldOfStars(solution, stars, observer)
            wanted = marks.mark_bodies(ax, field, labels)
            star_labels = marks.mark_stars(ax, field, labels, names)
            wanted += marks.mark_deep_sky(ax, field, labels) if deep_sky else []
            wanted += star_labels
            wanted += marks.mark_constellations(ax, field) if constellations else []
            if grid:
                marks.mark_grid(ax, field, labels)
            for label in wanted:
                labels.beside(label)
            _compass_and_scale(figure, ax, solution)
        _title(figure, solution)
        _legend(figure, ax)
    return figure


def star_coloured(
    image: NDArray[Any], solution: Solution, catalog: str | StarCatalog = "hipparcos"
) -> NDArray[np.float32]:
    """Grey image (H, W) with its identified stars in their colours (H, W, 3), from the catalogue's B−V."""
    stars = load_catalog(catalog) if isinstance(catalog, str) else catalog
    order = np.argsort(stars.id)
    rows = order[np.searchsorted(stars.id, solution.stars.catalog_id, sorter=order)]
    flux = 10.0 ** (-0.4 * solution.stars.v_mag)  # photographs saturate
    return tinted(image, solution.stars.xy, flux, stars.b_v[rows])


_TITLE_IN, _LEGEND_ROW_IN, _MARGIN_IN = 0.62, 0.24, 0.12
_ENTRY_IN = 1.95
"""Width of an entry of the legend."""
_COMPASS_IN = 0.40
_WIDE_IN = 8.4
"""Width, inches, below which compass and scale are in their own row under the title."""


def _canvas(shape: tuple[int, ...]) -> tuple[Figure, Axes]:
    """Figure with room above the image for title, scale and compass, and below it for the legend."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    height, width = shape[:2]
    longest = max(height, width)
    dpi = min(max(longest, _LEAST_PX), _MOST_PX) / _SIDE_IN
    wide, high = (max(_SIDE_IN * side / longest, 0.05) for side in (width, height))
    across = max(wide + 2 * _MARGIN_IN, 5.5)
    top = _TITLE_IN + (0.0 if across > _WIDE_IN else 2 * _COMPASS_IN)
    bottom = 0.18 + _LEGEND_ROW_IN * -(-_MOST_ENTRIES // int(across / _ENTRY_IN))
    total = across, high + top + bottom
    figure = Figure(figsize=total, dpi=dpi, facecolor=_BACKGROUND)
    figure.set_layout_engine("none")  # another package of the program may have set one for all figures
    FigureCanvasAgg(figure)
    left = (total[0] - wide) / 2
    ax = figure.add_axes((left / total[0], bottom / total[1], wide / total[0], high / total[1]))
    ax.set_xticks([])
    ax.set_yticks([])
    for spine in ax.spines.values():
        spine.set_color("#667788")
        spine.set_linewidth(0.6)
    return figure, ax


def _compass_and_scale(figure: Figure, ax: Axes, solution: Solution) -> None:
    """Scale bar and compass beside the title, or below it on a narrow picture; the image stays free."""
    camera = solution.camera
    assert camera is not None
    across, down = figure.get_size_inches()
    top = down - (0.31 if across > _WIDE_IN else _TITLE_IN + _COMPASS_IN - 0.05)
    over = figure.add_axes((0.0, 0.0, 1.0, 1.0))  # in inches from the lower left corner
    over.set_xlim(0.0, across)
    over.set_ylim(0.0, down)
    over.set_axis_off()
    middle = np.array([across - _MARGIN_IN - 0.45, top])
    # The arrows point north and east at the centre of the image.
    for text, arrow in compass_arrows(solution).items():
        upwards = arrow * [1.0, -1.0]
        style = {"arrowstyle": "-|>", "color": TEXT, "lw": 1.1, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 7}
        start, tip = middle - 0.05 * upwards, middle + 0.13 * upwards
        over.annotate("", (tip[0], tip[1]), (start[0], start[1]), arrowprops=style)
        at = middle + 0.21 * upwards
        over.text(at[0], at[1], text, color=TEXT, fontsize=8, ha="center", va="center")
    # Both sizes are in inches, so that compass and scale do not depend on the size of the image.
    inches_per_px = ax.get_position().width * across / camera.width
    step = nice_step(math.degrees(1.6 / inches_per_px * camera.pixel_rad))
    length = math.radians(step) / camera.pixel_rad * inches_per_px
    left = _MARGIN_IN + 0.1
    over.plot([left, left + length], [top - 0.08, top - 0.08], color=TEXT, lw=2.0, solid_capstyle="butt")
    text = f"{step:g}°" if step >= 1 else (f"{step * 60:.3g}′" if step >= 1 / 60 else f"{step * 3600:.3g}″")
    over.text(left + length / 2, top + 0.06, text, color=TEXT, fontsize=9, ha="center", va="center")


def _title(figure: Figure, solution: Solution) -> None:
    first, second = field_text(solution)
    across, height = figure.get_size_inches()
    size = min(1.0, across / 7.2)
    figure.text(0.5, 1.0 - 0.20 / height, first, color=TEXT, ha="center", va="center", fontsize=11 * size)
    figure.text(0.5, 1.0 - 0.44 / height, second, color="#b8c4d0", ha="center", va="center", fontsize=8.5 * size)


def _legend(figure: Figure, ax: Axes) -> None:
    handles, texts = ax.get_legend_handles_labels()
    if not handles:
        return
    across, height = figure.get_size_inches()
    legend = figure.legend(
        handles, texts, loc="lower center", bbox_to_anchor=(0.5, 0.02 / height), ncols=int(across / _ENTRY_IN),
        frameon=False, labelcolor=TEXT, fontsize=8.5, markerscale=0.9, borderpad=0.3, labelspacing=0.4,
    )  # fmt: skip
    legend.set_in_layout(False)
