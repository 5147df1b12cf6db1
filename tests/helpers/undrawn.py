"""Studies without the drawing of their figures, which takes most of the time of a short one."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import pytest


@contextlib.contextmanager
def undrawn() -> Iterator[None]:
    """Within this context figures are made, with all their curves, and not drawn."""
    from matplotlib.backends.backend_pdf import PdfPages
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(FigureCanvasSVG, "print_svg", lambda _, stream, **__: stream.write("<svg></svg>"))
        patch.setattr(Figure, "savefig", lambda _, stream, **__: stream.write(b"a picture"))
        patch.setattr(PdfPages, "savefig", lambda *_: None)
        yield
