"""Labels that do not overlap: each is written at the first free position around its star, or left out."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from startracker.core import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_DIRECTIONS = (
    (1, 0.35),
    (-1, 0.35),
    (1, -0.35),
    (-1, -0.35),
    (0, 1),
    (0, -1),
    (0.8, 1),
    (-0.8, 1),
    (0.8, -1),
    (-0.8, -1),
)
"""Positions of a label relative to its star in order of preference; y up."""
_GAP = 2.0
_LARGEST_MARK = 50.0
"""Diameter, points, above which a label is placed inside its mark, as for a large nebula."""
_CLEAR = 1.5
"""Gap between two labels on one line, points."""
_BORDER = 20.0


class Label(NamedTuple):
    """Text that belongs to a mark."""

    xy: FloatArray
    """Pixel of the mark (x, y)."""
    diameter: float
    """Diameter of the mark, points."""
    text: str
    colour: str
    size: float
    """Font size of the text, points."""


class Labels:
    """Occupied areas of a picture, in points from the lower left corner of its axes.

    Parameters
    ----------
    ax : Axes
        Axes with their limits set; the limits must not change afterwards.
    """

    def __init__(self, ax: Axes) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        self.ax = ax
        figure: Any = ax.figure
        if not hasattr(figure.canvas, "get_renderer"):
            FigureCanvasAgg(figure)
        self.points = 72.0 / figure.dpi
        box = ax.get_window_extent()
        self.origin = np.array([box.x0, box.y0])
        self.size = np.array([box.width, box.height]) * self.points
        self.taken: list[tuple[float, float, float, float]] = []
        self.renderer = figure.canvas.get_renderer()
        x_px, _ = ax.transData.transform((1.0, 0.0)) - ax.transData.transform((0.0, 0.0))
        self.points_per_pixel = abs(float(x_px)) * self.points
        """Size of a pixel of the image, points."""

    def to_points(self, xy: FloatArray) -> FloatArray:
        """Position of a pixel in points."""
        return np.asarray((self.ax.transData.transform(xy) - self.origin) * self.points)

    def occupy(self, xy: FloatArray, diameter: float) -> None:
        """Reserve the area of a mark with this diameter in points."""
        x, y = self.to_points(xy)
        half = diameter / 2
        self.taken.append((x - half, y - half, x + half, y + half))

    def beside(self, label: Label) -> bool:
        """Write next to a mark without covering anything; returns False, and writes nothing, if there is no room."""
        artist, wide, high = self._measure(label.text, label.colour, label.size)
        x, y = self.to_points(label.xy)
        reach = min(label.diameter, _LARGEST_MARK) / 2 + _GAP
        for side, up in _DIRECTIONS:
            left = x + (reach * side if side > 0 else reach * side - wide if side < 0 else -wide / 2)
            low = y - high / 2 + up * (reach + high / 2)
            if self._put(artist, left, low, wide, high):
                return True
        artist.remove()
        return False

    def at_border(self, pixels: FloatArray, text: str, colour: str) -> bool:
        """Write the value of a grid line where it meets the border, preferably the left or lower one."""
        artist, wide, high = self._measure(text, colour, 6.5)
        ends = [self.to_points(pixels[k]) for k in (0, -1)]
        # The end nearer to the lower or left border is tried first.
        for x, y in sorted(ends, key=lambda end: float(min(end))):
            if min(x, y, *(self.size - (x, y))) > _BORDER:  # the pole, where lines end
                continue
            left = min(max(x + _GAP, _GAP), self.size[0] - wide - _GAP)
            low = min(max(y + _GAP, _GAP), self.size[1] - high - _GAP)
            if self._put(artist, left, low, wide, high):
                return True
        artist.remove()
        return False

    def _measure(self, text: str, colour: str, size: float) -> tuple[Any, float, float]:
        from matplotlib.patheffects import withStroke

        artist = self.ax.annotate(
            text.replace("$", r"\$"), (0.0, 0.0), xycoords="axes fraction", color=colour, fontsize=size, zorder=5,
            ha="left", va="bottom", path_effects=[withStroke(linewidth=1.6, foreground="black")],
        )  # fmt: skip
        box = artist.get_window_extent(self.renderer)
        return artist, box.width * self.points, box.height * self.points

    def _put(self, artist: Any, left: float, low: float, wide: float, high: float) -> bool:
        box = (left - _CLEAR, low, left + wide + _CLEAR, low + high)
        if left < 0 or low < 0 or left + wide > self.size[0] or low + high > self.size[1]:
            return False
        if any(box[0] < x1 and x0 < box[2] and box[1] < y1 and y0 < box[3] for x0, y0, x1, y1 in self.taken):
            return False
        self.taken.append(box)
        self._move(artist, left, low)
        return True

    def _move(self, artist: Any, left: float, low: float) -> None:
        """Set the lower left corner, as a share of the axes: a layout that changes their size moves mark and label."""
        at = (left / self.size[0], low / self.size[1])
        artist.xy = at
        artist.set_position(at)
