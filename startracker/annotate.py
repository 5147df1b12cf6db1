"""A solved image as a picture: stars by name, grid, constellations, compass, scale.

The image is shown with an arcsinh stretch, so that faint and bright stars are both visible. The colours are those of
Okabe & Ito (2008), which colour-blind readers can distinguish (the grid's green is lighter); the symbols differ as
well. Sizes are fractions of the picture's size. Matplotlib is imported when the first picture is drawn.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from startracker.annotate_labels import Labels
from startracker.annotate_sky import compass_arrows, field_text, grid_lines, nice_step, polyline
from startracker.catalog import load_catalog
from startracker.catalog.names import constellation_lines, designation, proper_name
from startracker.catalog.stars import StarCatalog
from startracker.observer import Observer, aberrate
from startracker.picture import figure_bytes
from startracker.solution import Solution

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["annotate", "annotated_picture", "stretch"]

FloatArray = NDArray[np.float64]

MATCHED, UNMATCHED, MISSING = "#56B4E9", "#E69F00", "#F0E442"
FIGURES, GRID, TEXT = "#CC79A7", "#2FBF9B", "#ffffff"
_BACKGROUND = "#101418"
_SIDE_IN = 10.0
_LEAST_PX, _MOST_PX = 1400, 2400
_MISSING_SHARE = 0.6
_SAMPLES = 500_000


def annotated_picture(image: NDArray[Any], solution: Solution, form: str = "png", **options: Any) -> bytes:
    """PNG, SVG or PDF file of the figure of `annotate`, as bytes; deterministic."""
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
    catalog: str | StarCatalog = "hipparcos",
    observer: Observer | None = None,
) -> Figure:
    """Figure of an image with its detections and identified stars.

    Parameters
    ----------
    image : array, shape (H, W)
        The image that was solved.
    solution : Solution
        If it is not solved, the detections and the reason are shown.
    names : int
        Maximum number of stars to label; labels that would overlap another are left out.
    grid : bool
        Draw lines of right ascension and declination.
    constellations : bool
        Draw constellation lines.
    catalog : str or StarCatalog
        Source of names, constellation lines and of the stars that were expected but not detected.
    observer : Observer, optional
        The observer that was passed to the solve.

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
        if solution.solved:
            stars = _Sky(solution, load_catalog(catalog) if isinstance(catalog, str) else catalog, observer)
            _compass_and_scale(ax, solution, labels)
            if grid:
                _grid(ax, solution, labels)
        _detections(ax, solution)
        if solution.solved:
            _stars(ax, stars, labels, names)
            if constellations:
                _figures(ax, stars, labels)
        _title(figure, solution)
        _legend(figure, ax)
    return figure


def stretch(image: NDArray[Any]) -> NDArray[np.float32]:
    """Image (H, W) as grey levels from 0 (sky) to 1: arcsinh of the signal above the median in units of the noise."""
    values = np.asarray(image, dtype=np.float32)
    step = max(1, math.isqrt(values.size // _SAMPLES))
    finite = values[::step, ::step]
    finite = finite[np.isfinite(finite)]
    if not len(finite):
        return np.zeros(values.shape, np.float32)
    low, top = (float(v) for v in np.percentile(finite, (50.0, 99.95)))
    noise = 1.4826 * float(np.median(np.abs(finite - low))) or float(finite.std()) or 1.0
    soft = 6.0 * noise
    top = max(top, low + 10.0 * noise)
    signal = np.clip(np.nan_to_num(values, nan=low, posinf=top, neginf=low) - low, 0.0, top - low)
    return np.asarray(np.arcsinh(signal / soft) / math.asinh((top - low) / soft), dtype=np.float32)


class _Sky:
    """Catalogue stars in the field, matched and unmatched."""

    def __init__(self, solution: Solution, catalog: StarCatalog, observer: Observer | None) -> None:
        self.solution, self.catalog, self.observer = solution, catalog, observer
        if observer is None:  # as in the tracker
            self.directions, _ = catalog.space_motion()
        else:
            self.directions = catalog.directions(observer.epoch_jyear, observer.position_au)
            if observer.velocity_km_s is not None:
                self.directions = aberrate(self.directions, observer.velocity_km_s)

    def project(self, directions: FloatArray) -> FloatArray:
        """Pixels (N, 2) of directions; NaN farther from the boresight than the image's corners."""
        solution = self.solution
        assert solution.attitude is not None
        assert solution.camera is not None
        vectors = solution.attitude.apply(directions)
        angle = np.arctan2(np.hypot(vectors[:, 0], vectors[:, 1]), vectors[:, 2])
        pixels = np.full((len(vectors), 2), np.nan)
        seen = angle <= solution.camera.half_diagonal_rad
        pixels[seen] = solution.camera.project(vectors[seen])
        return pixels

    def missing(self) -> FloatArray:
        """Pixels (N, 2) of catalogue stars as bright as most matched stars that have no detection."""
        solution = self.solution
        assert solution.camera is not None
        limit = float(np.quantile(solution.stars.v_mag, _MISSING_SHARE))
        bright = np.flatnonzero(self.catalog.v_mag <= limit)
        pixels = self.project(self.directions[bright])
        pixels = pixels[np.isfinite(pixels).all(axis=1)]
        pixels = pixels[solution.camera.contains(pixels, -1.0)]
        radius_px = max(6.0, 0.006 * solution.camera.width)  # the companion of a detected double is not missing
        far = np.array([np.hypot(*(solution.centroids - xy).T).min(initial=np.inf) > radius_px for xy in pixels])
        return np.asarray(pixels[far.astype(bool)])


def _canvas(shape: tuple[int, ...]) -> tuple[Figure, Axes]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    height, width = shape
    longest = max(height, width)
    dpi = min(max(longest, _LEAST_PX), _MOST_PX) / _SIDE_IN
    wide, high = (max(_SIDE_IN * side / longest, 0.05) for side in (width, height))
    top, bottom, side = 0.62, 0.42, 0.12
    total = max(wide + 2 * side, 5.5), high + top + bottom
    figure = Figure(figsize=total, dpi=dpi, facecolor=_BACKGROUND)
    FigureCanvasAgg(figure)
    left = (total[0] - wide) / 2
    ax = figure.add_axes((left / total[0], bottom / total[1], wide / total[0], high / total[1]))
    ax.set_xticks([])
    ax.set_yticks([])
    for spine in ax.spines.values():
        spine.set_color("#667788")
        spine.set_linewidth(0.6)
    return figure, ax


def _detections(ax: Axes, solution: Solution) -> None:
    """Mark the detections without an identified star."""
    matched = {tuple(xy) for xy in solution.stars.xy}
    others = np.array([xy for xy in solution.centroids if tuple(xy) not in matched]).reshape(-1, 2)
    if len(others):
        ax.plot(*others.T, "s", ms=6, mfc="none", mec=UNMATCHED, mew=0.7, label=f"detected only ({len(others)})")


def _stars(ax: Axes, sky: _Sky, labels: Labels, names: int) -> None:
    stars = sky.solution.stars
    faintest = float(stars.v_mag.max(initial=0.0))
    # diameter in points: 1.3 per magnitude, from 6 for the faintest star to at most 18
    diameter = np.clip(6.0 + 1.3 * (faintest - stars.v_mag), 6.0, 18.0)
    for chosen, style, label in (
        (stars.used, "-", "identified"),
        (~stars.used, ":", "identified, left out of the fit"),
    ):
        if chosen.any():
            ax.scatter(stars.xy[chosen, 0], stars.xy[chosen, 1], s=diameter[chosen] ** 2, facecolors="none",
                       edgecolors=MATCHED, linewidths=0.9, linestyles=style,
                       label=f"{label} ({np.count_nonzero(chosen)})", zorder=3)  # fmt: skip
    missing = sky.missing()
    if len(missing):
        ax.plot(*missing.T, "D", ms=5, mfc="none", mec=MISSING, mew=0.8, ls="none",
                label=f"expected, not found ({len(missing)})", zorder=3)  # fmt: skip
    for xy, size in zip(stars.xy, diameter, strict=True):
        labels.occupy(xy, size)
    order = np.argsort(stars.v_mag, kind="stable")
    proper = np.array([bool(proper_name(str(name))) for name in stars.name], dtype=bool)
    order = np.concatenate([order[proper[order]], order[~proper[order]]])
    for i in order[:names]:
        name = str(stars.name[i])
        text = proper_name(name) or designation(name) or f"{_prefix(sky.catalog, int(stars.catalog_id[i]))}"
        labels.beside(stars.xy[i], diameter[i], text, TEXT, 7.5 if proper[i] else 6.5)


def _prefix(catalog: StarCatalog, number: int) -> str:
    """Catalogue number with the catalogue's abbreviation."""
    if catalog.name == "hipparcos":
        return f"HIP {number}" if number > 0 else f"HR {-number}"
    return f"HR {number}" if catalog.name == "bsc5" else str(number)


def _figures(ax: Axes, sky: _Sky, labels: Labels) -> None:
    pairs, names = constellation_lines(sky.catalog)
    label: str | None = "constellations"
    seen: dict[str, list[FloatArray]] = {}
    for (one, other), name in zip(pairs, names, strict=True):
        path = polyline(sky.directions[one], sky.directions[other])
        pixels = sky.project(path)
        if np.isfinite(pixels).all(axis=1).any():
            ax.plot(*pixels.T, color=FIGURES, lw=0.9, alpha=0.8, label=label, zorder=2)
            label = None
            seen.setdefault(str(name), []).append(pixels)
    camera = sky.solution.camera
    assert camera is not None
    for name, lines in seen.items():
        pixels = np.concatenate(lines)
        pixels = pixels[np.isfinite(pixels).all(axis=1)]
        pixels = pixels[camera.contains(pixels)]
        if len(pixels):
            labels.beside(pixels.mean(axis=0), 0.0, name, FIGURES, 8.0)


def _grid(ax: Axes, solution: Solution, labels: Labels) -> None:
    for pixels, text in grid_lines(solution):
        ax.plot(*pixels.T, color=GRID, lw=0.5, alpha=0.6, zorder=1)
        inside = np.flatnonzero(solution.camera.contains(pixels, -2.0)) if solution.camera else np.empty(0, int)
        if len(inside):
            labels.at_border(pixels[inside], text, GRID)


def _compass_and_scale(ax: Axes, solution: Solution, labels: Labels) -> None:
    camera = solution.camera
    assert camera is not None
    # the arrows point north and east at the image centre and are drawn in the lower right corner
    size = 0.055 * max(camera.width, camera.height)
    corner = np.array([camera.width - 1.0 - 1.9 * size, camera.height - 1.0 - 1.9 * size])
    for text, arrow in compass_arrows(solution).items():
        tip = corner + size * arrow
        arrow_style = {"arrowstyle": "-|>", "color": TEXT, "lw": 1.1, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 8}
        ax.annotate("", (tip[0], tip[1]), (corner[0], corner[1]), arrowprops=arrow_style)
        labels.free(corner + 1.35 * size * arrow, text, TEXT, 9.0)
    labels.occupy_box(corner, 1.7 * size)
    width_deg = math.degrees(camera.width * camera.pixel_rad)
    step = nice_step(0.2 * width_deg)
    length = math.radians(step) / camera.pixel_rad
    left, low = 0.035 * camera.width, camera.height - 1.0 - 0.04 * camera.height
    ax.plot([left, left + length], [low, low], color=TEXT, lw=2.0, solid_capstyle="butt", zorder=4)
    text = f"{step:g}°" if step >= 1 else (f"{step * 60:.3g}′" if step >= 1 / 60 else f"{step * 3600:.3g}″")
    labels.free(np.array([left + length / 2, low - 0.02 * camera.height]), text, TEXT, 9.0)
    labels.occupy_box(np.array([left + length / 2, low]), length / 2, 0.04 * camera.height)


def _title(figure: Figure, solution: Solution) -> None:
    first, second = field_text(solution)
    height = figure.get_size_inches()[1]
    figure.text(0.5, 1.0 - 0.20 / height, first, color=TEXT, ha="center", va="center", fontsize=11)
    figure.text(0.5, 1.0 - 0.44 / height, second, color="#b8c4d0", ha="center", va="center", fontsize=8.5)


def _legend(figure: Figure, ax: Axes) -> None:
    handles, texts = ax.get_legend_handles_labels()
    if not handles:
        return
    height = figure.get_size_inches()[1]
    legend = figure.legend(
        handles, texts, loc="center", bbox_to_anchor=(0.5, 0.20 / height), ncols=4, frameon=False,
        labelcolor=TEXT, fontsize=8.5, markerscale=0.9,
    )  # fmt: skip
    legend.set_in_layout(False)
