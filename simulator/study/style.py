"""How the figures of the report look, and how one figure serves the light page, the dark page and print.

A panel is drawn once, in the light colours below. In the page it stands as inline SVG in which every one of these
colours is replaced by a variable of the page's style sheet, so that the reader's own choice of light or dark recolours
lines and text alike; in the PDF it stands as drawn. Hues are those of Okabe & Ito (2008), distinguished by the
colour-blind; every curve differs in marker or line style as well.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.typing import RcKeyType

INK, SOFT, LINE, BACK = "#1b1f24", "#57606a", "#d0d7de", "#fffffe"
BLUE, ORANGE, GREEN, VERMILION = "#0072b2", "#b87400", "#00785a", "#c24a00"

COLOURS = {
    "text": (INK, "#e6edf3"),
    "soft": (SOFT, "#9aa5b1"),
    "line": (LINE, "#3a424c"),
    "back": (BACK, "#0f1419"),
    "blue": (BLUE, "#56b4e9"),
    "orange": (ORANGE, "#e69f00"),
    "green": (GREEN, "#3cc79a"),
    "vermilion": (VERMILION, "#ff9166"),
}
"""Variable of the style sheet: its colour on a light and on a dark page. Each is at least 4.5 : 1 against its page
(WCAG 2.1, 1.4.3), but for ``line``, which carries no meaning."""

STYLE: dict[RcKeyType, Any] = {
    "font.size": 9,
    "font.sans-serif": ["DejaVu Sans"],
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": SOFT,
    "axes.titlesize": 9,
    "axes.titlecolor": INK,
    "xtick.color": SOFT,
    "ytick.color": SOFT,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "axes.facecolor": "none",
    "figure.facecolor": "none",
    "savefig.facecolor": "none",
    "axes.grid": True,
    "grid.color": LINE,
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "figure.constrained_layout.use": True,
    "svg.fonttype": "none",  # text stays text: small, sharp, to be searched
    "svg.hashsalt": "boresight",  # the same figure is the same file
    "pdf.fonttype": 42,
    "path.simplify": True,
}

STUDY_STYLE: dict[RcKeyType, Any] = STYLE | {
    "axes.facecolor": "white",
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "lines.linewidth": 1.3,
}
"""The report's style on white, as for print."""

PICTURE_STYLE: dict[RcKeyType, Any] = {
    "font.size": 9,
    "axes.grid": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "figure.constrained_layout.use": True,
    "svg.hashsalt": "boresight",
}
"""Of pictures that stand alone, as PNG."""

NARROW_IN, WIDE_IN = 4.2, 7.6
"""Widths in inches. A narrow panel still reads at 9 points when a phone shows it 360 px wide."""


@dataclass(frozen=True)
class Panel:
    """One figure of the report."""

    title: str
    note: str
    """Heading, and what the reader has to know to read it."""
    draw: Callable[[Axes], None]
    """Draws it into the axes that it is given."""
    height_in: float = 3.0
    """Height in inches."""
    wide: bool = False
    """Across the page, rather than two or three beside each other."""


def figure_of(panel: Panel, narrow: bool = False) -> Figure:
    """The panel alone in a figure of its own, a wide one as a phone wants it where `narrow`; call within `style`."""
    from matplotlib.figure import Figure

    width = WIDE_IN if panel.wide and not narrow else NARROW_IN
    figure = Figure(figsize=(width, min(panel.height_in, 3.0) if narrow else panel.height_in))
    panel.draw(figure.subplots())
    return figure


def style() -> Any:
    """Context in which the report's figures are both drawn and written."""
    from matplotlib import rc_context

    return rc_context(STYLE)


def new_figure(
    look: dict[RcKeyType, Any], rows: int, columns: int, size: tuple[float, float], **axes: Any
) -> tuple[Figure, Any]:
    """Figure of `size` inches that belongs to no window, and its axes as matplotlib's ``subplots`` gives them."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with rc_context(look):
        figure = Figure(figsize=size)
        FigureCanvasAgg(figure)
        return figure, figure.subplots(rows, columns, **axes)


def inline_svg(panel: Panel, key: str, narrow: bool = False) -> str:
    """The panel as SVG to stand in a page: no declaration, fluid width, colours as variables, ids of its own.

    Parameters
    ----------
    panel : Panel
        What to draw.
    key : str
        Prefix that keeps its ids apart from those of the page's other figures.
    narrow : bool
        A wide panel in the width of the others, for a phone.
    """
    stream = io.StringIO()
    with style():
        figure_of(panel, narrow).savefig(stream, format="svg", dpi=160, metadata={"Date": None, "Creator": None})
    text = stream.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    head, rest = text.split(">", 1)
    text = re.sub(r' (width|height)="[^"]*"', "", head) + ">" + rest  # as wide as the page lets it, by its viewBox
    text = re.sub(r'\bid="([^"]+)"', rf'id="{key}-\1"', text)
    text = re.sub(r'href="#([^"]+)"', rf'href="#{key}-\1"', text)
    text = re.sub(r"url\(#([^)]+)\)", rf"url(#{key}-\1)", text)
    text = text.replace("'DejaVu Sans'", "system-ui, 'DejaVu Sans'")
    for name, (light, _) in COLOURS.items():
        text = text.replace(light, f"var(--{name})")
    for fixed, name in (("#ffffff", "back"), ("#e69f00", "orange"), ("#777777", "soft")):  # of frames, drawn elsewhere
        text = text.replace(fixed, f"var(--{name})")
    return text.replace("<svg ", f'<svg role="img" aria-label="{panel.title.replace(chr(34), "")}" ', 1)


def style_variables() -> dict[str, str]:
    """CSS declarations of the colours for ``light`` and ``dark``."""
    return {
        scheme: " ".join(f"--{name}: {pair[i]};" for name, pair in COLOURS.items())
        for i, scheme in enumerate(("light", "dark"))
    }
