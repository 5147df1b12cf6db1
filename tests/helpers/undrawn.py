"""Studies without the drawing of their figures, which takes most of the time of a short one."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import pytest


@contextlib.contextmanager
def undrawn() -> Iterator[None]:
    """Within this context figures are made, with all their curves, and not drawn."""
    from matplotlib.backends.backend_pdf import PdfPages
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(FigureCanvasSVG, "print_svg", lambda _, stream, **__: stream.write("<svg></svg>"))
        patch.setattr(Figure, "savefig", _saved)
        patch.setattr(PdfPages, "savefig", lambda *_: None)
        yield


def _saved(_: object, target: str | Path | BinaryIO, **__: object) -> None:
    if isinstance(target, str | Path):
        Path(target).write_bytes(b"a picture")
    else:
        target.write(b"a picture")
