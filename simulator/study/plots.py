"""Plots of a study: each function draws one figure from the columns of the trials.

Colours follow Okabe & Ito (2008), distinguishable with colour-blindness and in greyscale print; markers differ as
well.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from simulator.study.pictures import frame_preview, solved_image
from simulator.study.style import PICTURE_STYLE, new_figure
from startracker.images.picture import figure_bytes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "BLUE",
    "GREEN",
    "GREY",
    "ORANGE",
    "VERMILION",
    "frame_preview",
    "picture",
    "save_bytes",
    "solved_image",
]

BLUE, ORANGE, GREEN, VERMILION, GREY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#777777"


def picture(rows: int, columns: int, size: tuple[float, float], **axes: Any) -> tuple[Figure, NDArray[Any]]:
    """Empty picture of `size` inches, and its axes (rows, columns); `axes` go to matplotlib's ``subplots``."""
    return new_figure(PICTURE_STYLE, rows, columns, size, squeeze=False, **axes)


def save_bytes(figure: Figure) -> bytes:
    """Figure as the bytes of a PNG file, the same bytes for the same figure."""
    return figure_bytes(figure, dpi=130)
