"""One-line descriptions of objects for ``repr``, and the self-contained HTML for display in notebooks.

The HTML uses the colours of text and background of the notebook, so that it is readable in light and dark themes; it
needs no script and no other files.
"""

from __future__ import annotations

import dataclasses
import html
import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from startracker.core import ARCSEC_RAD

_LONGEST = 240
"""Largest number of characters of a description; the rest is cut off."""
PICTURE_PX = 420
"""Longer side of a picture in a notebook, px."""


def described(kind: str, *parts: str) -> str:
    """``Kind(part, part)`` on one line of limited length; empty parts are omitted."""
    text = " ".join(f"{kind}({', '.join(part for part in parts if part)})".split())
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 2]}…)"


def changed_fields(values: Any) -> str:
    """Description of a dataclass that lists only the fields that differ from their defaults."""
    changed = []
    for field in dataclasses.fields(values):
        value = getattr(values, field.name)
        default = field.default if field.default_factory is dataclasses.MISSING else field.default_factory()
        if field.repr and value != default:
            changed.append(f"{field.name}={value!r}")
    return described(type(values).__name__, *changed)


def fields_repr(values: Any) -> str:
    """``__repr__`` of a dataclass with arrays, each of which is represented by its shape."""
    shown = []
    for field in dataclasses.fields(values):
        value = getattr(values, field.name)
        if field.repr and value is not None:
            shape = "×".join(str(length) for length in value.shape) if isinstance(value, np.ndarray) else ""
            shown.append(f"{field.name}: {shape}" if shape else f"{field.name}={value!r}")
    return described(type(values).__name__, *shown)


def angle_text(angle_rad: float) -> str:
    """An angle with two significant digits or one decimal, in ″, ′ or °, whichever is readable."""
    arcsec = angle_rad / ARCSEC_RAD
    if not math.isfinite(arcsec):
        return "unknown"
    if arcsec < 99.95:
        return f"{arcsec:.1f}″" if arcsec >= 0.095 else f"{arcsec:.2g}″"
    return f"{arcsec / 60.0:.1f}′" if arcsec < 3597.0 else f"{arcsec / 3600.0:.1f}°"


def quantity_range(name: str, values: NDArray[Any], digits: int = 1) -> str:
    """``name low to high`` of the finite values; empty if there are none."""
    finite = values[np.isfinite(values)]
    return f"{name} {finite.min():.{digits}f} to {finite.max():.{digits}f}" if len(finite) else ""


def html_card(title: str, rows: Mapping[str, str] | Iterable[tuple[str, str]], picture: str = "") -> str:
    """A picture (HTML) with a table of names and values (plain text) beside it, below it on narrow screens."""
    pairs = rows.items() if isinstance(rows, Mapping) else rows
    cell = "text-align:left;vertical-align:top;padding:1px"
    lines = "".join(
        f'<tr><th style="{cell} 12px 1px 0;font-weight:600;white-space:nowrap">{html.escape(name)}</th>'
        f'<td style="{cell} 0">{html.escape(value)}</td></tr>'
        for name, value in pairs
        if value
    )
    figure = f'<div style="flex:0 1 {PICTURE_PX}px;min-width:0">{picture}</div>' if picture else ""
    return (
        '<div style="display:flex;flex-wrap:wrap;gap:16px;align-items:flex-start;color:inherit;background:transparent">'
        f'{figure}<div style="flex:1 1 300px;min-width:0;overflow-wrap:anywhere">'
        f'<div style="font-weight:700;margin-bottom:4px">{html.escape(title)}</div>'
        f'<table style="border-collapse:collapse;background:transparent;margin:0"><tbody>{lines}</tbody></table>'
        "</div></div>"
    )


def star_chart(
    size: tuple[int, int],
    points: NDArray[np.float64],
    stars: NDArray[np.float64],
    radius: NDArray[np.float64],
    names: Iterable[str],
) -> str:
    """Chart of an image as SVG in the notebook's text colour: a dot for every centroid, a circle for identified stars.

    Parameters
    ----------
    size : (int, int)
        Width and height of the image, pixels.
    points : array, shape (N, 2)
        All centroids.
    stars : array, shape (M, 2)
        Identified stars.
    radius : array, shape (M,)
        Radius of each identified star's dot, in units of the picture.
    names : iterable of str
        Names of the identified stars; empty ones are not written.
    """
    width, height = size
    scale = PICTURE_PX / max(width, height, 1)
    across, down = width * scale, height * scale
    key = f'<circle cx="6" cy="{down + 12:.0f}" r="3.5"/><text x="14" y="{down + 16:.0f}">identified star</text>'
    key += f'<circle cx="116" cy="{down + 12:.0f}" r="1.2"/><text x="122" y="{down + 16:.0f}">other centroid</text>'
    dots = "".join(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="1.2"/>' for x, y in (points + 0.5) * scale)
    circles, labels = "", ""
    for (x, y), size_px, name in zip((stars + 0.5) * scale, radius, names, strict=True):
        circles += f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{size_px:.1f}"/>'
        if name:
            left = x > across - 70
            anchor, shift = ("end", -size_px - 3) if left else ("start", size_px + 3)
            labels += f'<text x="{x + shift:.1f}" y="{y + 3:.1f}" text-anchor="{anchor}">{html.escape(name)}</text>'
    return (
        f'<svg role="img" aria-label="centroids and identified stars" viewBox="0 0 {across:.0f} {down + 20:.0f}" '
        f'style="display:block;width:100%;max-width:{across:.0f}px;height:auto" xmlns="http://www.w3.org/2000/svg">'
        f'<rect x="0.5" y="0.5" width="{across - 1:.1f}" height="{down - 1:.1f}" fill="none" stroke="currentColor" '
        f'stroke-opacity="0.4"/><g fill="currentColor" fill-opacity="0.45">{dots}</g>'
        f'<g fill="currentColor" stroke="none">{circles}</g>'
        f'<g fill="currentColor" font-size="10" font-family="sans-serif">{labels}{key}</g></svg>'
    )
