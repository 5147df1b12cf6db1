"""Matplotlib figures as bytes of a file."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["FORMATS", "figure_bytes"]

FORMATS = ("png", "svg", "pdf")
"""Output formats of figures, by file suffix."""
_NO_DATE: dict[str, dict[str, Any]] = {"png": {"Software": None}, "svg": {"Date": None}, "pdf": {"CreationDate": None}}


def figure_bytes(figure: Figure, form: str = "png", **options: Any) -> bytes:
    """Figure in one of `FORMATS`, deterministic; `options` are those of `Figure.savefig`."""
    from matplotlib import rc_context

    stream = io.BytesIO()
    with rc_context({"svg.hashsalt": "boresight"}):  # otherwise the identifiers in an SVG are random
        figure.savefig(stream, format=form, metadata=_NO_DATE[form], **options)
    return stream.getvalue()
