"""A page as HTML: one self-contained file without scripts or external links, in light and dark, for desktop, phone and
print.

This is the only module that writes HTML of studies. The same page gives the same bytes.
"""

from __future__ import annotations

import base64
import itertools
import re
from pathlib import Path
from typing import TYPE_CHECKING

from simulator.study.pages.page import UNBROKEN, Page, Picture
from simulator.study.specification.verdicts import MET, NOT_MET, UNDECIDED
from simulator.study.style import Panel, inline_svg, style_variables

if TYPE_CHECKING:
    from markupsafe import Markup

_FOLDER = Path(__file__).parent

_DOT_IN_KEY = re.compile(r"(?<=[a-z])\.(?=[a-z])")

TONES = {MET: "good", NOT_MET: "bad", UNDECIDED: "open"}
"""Class of each verdict in the style sheet."""


def html_of(page: Page) -> str:
    """The page as one HTML file."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined
    from markupsafe import Markup

    environment = Environment(
        loader=FileSystemLoader(_FOLDER),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(
        figure=_figure, heading=_heading, data_address=_data_address, kind=lambda block: type(block).__name__
    )
    figures = itertools.count()

    def svg(panel: Panel, narrow: bool = False) -> Markup:
        return Markup(inline_svg(panel, f"f{next(figures)}", narrow))

    return environment.get_template("page.html.j2").render(
        page=page,
        svg=svg,
        tones=TONES,
        colours=style_variables(),
        style=Markup((_FOLDER / "page.css").read_text(encoding="utf-8")),
    )


def _figure(cell: str) -> Markup:
    """A cell with figures as HTML; no line ends within an interval or before a per cent sign."""
    from markupsafe import Markup, escape

    return Markup(UNBROKEN.sub(r'<span class="unbroken">\g<0></span>', str(escape(cell))))


def _heading(text: str) -> Markup:
    """A heading of a column as HTML; a line may end after the dots of a key, such as ``optics.aperture_mm``."""
    from markupsafe import Markup, escape

    return Markup(_DOT_IN_KEY.sub(r"\g<0><wbr>", str(escape(text))))


def _data_address(picture: Picture) -> str:
    """The picture within its own address (RFC 2397)."""
    return f"data:{picture.media_type};base64,{base64.b64encode(picture.data).decode('ascii')}"
