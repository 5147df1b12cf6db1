"""Lists of centroids, and sizes and pixels as users write them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from startracker.errors import InputError
from startracker.files import LIST_BYTES, read_text


def parse_size(text: str) -> tuple[int, int]:
    """Width and height of ``WxH``; `InputError` for anything else."""
    width, _, height = text.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal() and int(width) and int(height)):
        raise InputError(f"--size: must be WIDTHxHEIGHT in pixels, such as 1024x768, not '{text}'")
    return int(width), int(height)


def parse_pixel(text: str) -> tuple[float, float]:
    """Column and row of ``X,Y``; `InputError` for anything else."""
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        x = y = math.nan
    if not math.isfinite(x + y):
        raise InputError(
            f"--pixel: must be X,Y in pixels from the first pixel's centre, such as 511.5,383.5, not '{text}'"
        )
    return x, y


def read_centroids(path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
    """Centroids (N, 2) and, where there is a third column, fluxes (N,) of a CSV file.

    The first line may name the columns (x, y, flux in any order); lines that begin with # are left out.

    Raises
    ------
    InputError
        For a file that cannot be read or a line that is not numbers; names the line.
    """
    wanted = "--centroids needs a CSV with columns x, y and optionally flux"
    lines = read_text(path, LIST_BYTES, wanted).splitlines()
    names = ["x", "y", "flux"]
    rows: list[list[float]] = []
    first = True
    for number, line in enumerate(lines, 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        cells = [cell.strip() for cell in line.split(",")]
        if first and any(cell.lower() in ("x", "y") for cell in cells):
            names = [cell.lower() for cell in cells]
            first = False
            continue
        first = False
        try:
            rows.append([float(cell) for cell in cells])
        except ValueError:
            raise InputError(f"{path}:{number}: '{line.strip()}' is not a row of numbers x,y[,flux]") from None
        if len(cells) < 2 or len(cells) != len(rows[0]):
            raise InputError(f"{path}:{number}: has {len(cells)} columns; every row needs x, y and optionally flux")
    if not {"x", "y"} <= set(names):
        raise InputError(f"{path}:1: needs the columns x and y; found {', '.join(names)}")
    if not rows:
        return np.empty((0, 2)), None
    table = np.array(rows)
    column = {name: table[:, i] for i, name in enumerate(names[: table.shape[1]])}
    return np.stack([column["x"], column["y"]], axis=1), column.get("flux")
