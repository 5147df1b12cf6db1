"""Style of the figures of reports; one figure serves the light page, the dark page and print.

A panel is drawn once, in the light colours below. In the page it is inline SVG in which each of these colours is
replaced by a variable of the style sheet, so that the light or dark theme applies to lines and text alike; in the PDF
it is unchanged. The colours follow Okabe & Ito (2008), distinguishable with colour-blindness; curves also differ
in marker or line style.
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
"""Variable of the style sheet: its colour on a light and on a dark page. The contrast with the page is at least 4.5 : 1
(WCAG 2.1, 1.4.3), except for ``line``, which carries no information."""

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
    "figure.autolayout": False,  # another package may have set it
    "figure.constrained_layout.use": True,
    "svg.fonttype": "none",  # text remains text: small, sharp and searchable
    "svg.hashsalt": "boresight",  # the same figure gives the same file
    "pdf.fonttype": 42,
    "path.simplify": True,
}

STUDY_STYLE: dict[RcKeyType, Any] = STYLE | {
    "axes.facecolor": "white",
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "lines.linewidth": 1.3,
}
"""Style of the report on white, for print."""

PICTURE_STYLE: dict[RcKeyType, Any] = {
    "font.size": 9,
    "axes.grid": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "figure.autolayout": False,  # another package may have set it
    "figure.constrained_layout.use": True,
    "svg.hashsalt": "boresight",
}
"""Style of separate figures (PNG)."""

NARROW_IN, WIDE_IN = 4.2, 7.6
"""Widths in inches. The text of a narrow panel is 9 points high on a phone with a width of 360 px."""


@dataclass(frozen=True)
class Panel:
    """One figure of the report."""

    title: str
    note: str
    """Heading and caption."""
    draw: Callable[[Axes], None]
    """Draws the panel into the given axes."""
    height_in: float = 3.0
    """Height in inches."""
    wide: bool = False
    """Full width of the page, instead of two or three per row."""
    anchor: str = ""
    """Anchor of the figure in the page, for links to it."""
    command: str = ""
    """Command that makes the figure again, below its caption."""


def figure_of(panel: Panel, narrow: bool = False) -> Figure:
    """The panel as a separate figure, with `narrow` in the width of a phone; call within `style`."""
    from matplotlib.figure import Figure

    width = WIDE_IN if panel.wide and not narrow else NARROW_IN
    figure = Figure(figsize=(width, min(panel.height_in, 3.0) if narrow else panel.height_in))
    panel.draw(figure.subplots())
    return figure


def style() -> Any:
    """Context in which figures of the report are drawn and written."""
    from matplotlib import rc_context

    return rc_context(STYLE)


def new_figure(
    look: dict[RcKeyType, Any], rows: int, columns: int, size: tuple[float, float], **axes: Any
) -> tuple[Figure, Any]:
    """Figure of `size` inches without a window, and its axes as from matplotlib's ``subplots``."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with rc_context(look):
        figure = Figure(figsize=size)
        FigureCanvasAgg(figure)
        return figure, figure.subplots(rows, columns, **axes)


def inline_svg(panel: Panel, key: str, narrow: bool = False) -> str:
    """The panel as inline SVG: no declaration, fluid width, colours as variables, unique ids.

    Parameters
    ----------
    panel : Panel
        The panel.
    key : str
        Prefix that makes its ids unique in the page.
    narrow : bool
        Draw a wide panel in the width of the others, for a phone.
    """
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    stream = io.StringIO()
    with style():
        figure = figure_of(panel, narrow)
        figure.set_dpi(160)
        # the canvas lays out and draws at once; `savefig` draws twice
        FigureCanvasSVG(figure).print_svg(stream, metadata={"Date": None, "Creator": None})  # type: ignore[no-untyped-call]
    text = stream.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    head, rest = text.split(">", 1)
    text = re.sub(r' (width|height)="[^"]*"', "", head) + ">" + rest  # fluid width, by its viewBox
    text = re.sub(r'\bid="([^"]+)"', rf'id="{key}-\1"', text)
    text = re.sub(r'href="#([^"]+)"', rf'href="#{key}-\1"', text)
    text = re.sub(r"url\(#([^)]+)\)", rf"url(#{key}-\1)", text)
    text = text.replace("'DejaVu Sans'", "system-ui, 'DejaVu Sans'")
    for name, (light, _) in COLOURS.items():
        text = text.replace(light, f"var(--{name})")
    for fixed, name in (("#ffffff", "back"), ("#e69f00", "orange"), ("#777777", "soft")):  # of frames
        text = text.replace(fixed, f"var(--{name})")
    return text.replace("<svg ", f'<svg role="img" aria-label="{panel.title.replace(chr(34), "")}" ', 1)


def style_variables() -> dict[str, str]:
    """CSS declarations of the colours for ``light`` and ``dark``."""
    return {
        scheme: " ".join(f"--{name}: {pair[i]};" for name, pair in COLOURS.items())
        for i, scheme in enumerate(("light", "dark"))
    }
