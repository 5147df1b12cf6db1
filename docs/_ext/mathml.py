"""Formulas as MathML, which browsers draw themselves: no script, nothing to fetch.

docutils translates the LaTeX; a formula that it cannot translate is a warning of the build.
"""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.util import logging

_SIZES = re.compile(r"\\(?:displaystyle|[Bb]igg?)(?![A-Za-z]) ?")
"""Commands that only set a size, which docutils does not know; a browser stretches brackets anyway."""


def _mathml(translator: Any, node: nodes.Element, *, block: bool) -> None:
    try:
        text = tex2mathml(_SIZES.sub("", node.astext()), as_block=block)
    except MathError as error:
        logging.getLogger(__name__).warning("formula: %s", error, location=node)
        text = translator.encode(node.astext())
    translator.body.append(f'<div class="math">{text}</div>' if block else text)
    raise nodes.SkipNode


def _visit_inline(translator: Any, node: nodes.math) -> None:
    _mathml(translator, node, block=False)


def _visit_block(translator: Any, node: nodes.math_block) -> None:
    _mathml(translator, node, block=True)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the renderer as Sphinx's own are."""
    app.add_html_math_renderer("mathml", (_visit_inline, None), (_visit_block, None))
    app.config.html_math_renderer = "mathml"
    return {"parallel_read_safe": True, "parallel_write_safe": True}
