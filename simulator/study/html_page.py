"""Self-contained HTML pages from the templates of the studies."""

from __future__ import annotations

from pathlib import Path
from typing import Any

__all__ = ["render_page"]

_FOLDER = Path(__file__).parent


def render_page(template: str, **values: Any) -> str:
    """Rendered template, given by its path from this folder; undefined values are errors."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(_FOLDER),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(**values)
