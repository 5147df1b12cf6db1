"""Figures of the Vega image."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from simulator.study.style import BLUE, INK, ORANGE, SOFT, VERMILION
from simulator.theses.printed import new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from simulator.theses.yee1999.picture import Analysis
    from startracker.estimation.plate import Plate

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

__all__ = ["triad_figure", "vega_figure"]


def vega_figure(found: Analysis) -> Figure:
    """Fig. 4.4 from its centroids: the image stars, the catalogue around them, what was matched."""
    figure, axes = new_figure(size=(6.4, 5.2))
    width, height = found.picture.size_px
    if found.plate is not None:
        stars, xy = _in_image(found, found.plate)
        size = 4.0 + 7.0 * np.clip(6.5 - found.catalog.v_mag[stars], 0.0, None)
        axes.scatter(*xy.T, s=size, color=SOFT, alpha=0.6, lw=0, label="catalogue, V ≤ 6.00")
    axes.plot(*found.picture.xy_px.T, "o", ms=13, mfc="none", mec=BLUE, label="image stars")
    for star, (x, y) in enumerate(found.picture.xy_px):
        number = found.matches[star]
        text = f"{star + 1}" if number is None else f"{star + 1}: HR {number}"
        axes.annotate(text, (x, y), xytext=(9, 6), textcoords="offset points", color=INK)
    axes.plot(0, 0, "+", color=VERMILION, ms=10, label="centre")
    axes.set_xlim(-width / 2, width / 2)
    axes.set_ylim(-height / 2, height / 2)
    axes.set_aspect("equal")
    axes.set_xlabel("x from the centre [pixels]")
    axes.set_ylabel("y from the centre, up [pixels]")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=3)
    return figure


def _in_image(found: Analysis, plate: Plate) -> tuple[IntArray, FloatArray]:
    """Catalogue stars on the image, and their pixels."""
    near = np.flatnonzero(_cosine(found.catalog.sky_deg, plate.center_deg) > 0.8)
    xy = plate.image_xy(found.catalog.sky_deg[near])
    inside = (np.abs(xy) <= np.array(found.picture.size_px) / 2.0).all(axis=1)
    return near[inside], xy[inside]


def _cosine(sky_deg: FloatArray, center_deg: FloatArray) -> FloatArray:
    (ra, dec), (ra0, dec0) = np.radians(sky_deg).T, np.radians(center_deg)
    return np.asarray(np.sin(dec) * np.sin(dec0) + np.cos(dec) * np.cos(dec0) * np.cos(ra - ra0))


def triad_figure(found: Analysis) -> Figure:
    """Table 4.2 as a picture: the two rotations of every triad, by group."""
    figure, axes = new_figure(size=(6.4, 3.6))
    largest = max(range(len(found.groups)), key=lambda g: found.groups[g][0], default=-1)
    for row in found.triads:
        best = row["group"] - 1 == largest
        style = {"color": ORANGE if best else BLUE, "marker": "s" if best else "o", "ms": 6 if best else 4}
        axes.plot(row["rotations_deg"], [row["group"]] * 2, lw=1.0, mfc="none", **style)
    for group, (size, mean) in enumerate(found.groups):
        text = f"{size} triad{'' if size == 1 else 's'}, mean {mean:.1f}°"
        axes.annotate(text, (mean, group + 1), xytext=(0, 7), textcoords="offset points", ha="center", color=INK)
    axes.set_xlim(-60.0, 380.0)
    axes.set_xticks(range(0, 361, 60))
    axes.set_ylim(0.3, len(found.groups) + 0.9)
    axes.set_yticks(range(1, len(found.groups) + 1))
    axes.set_xlabel("rotation of image to catalogue, two of each triad [°]")
    axes.set_ylabel("group")
    return figure
