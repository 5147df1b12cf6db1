"""Angles, fractions and intervals as text, for tables, pages and verdicts."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any


def deg_text(value_deg: float | None, fine: bool = False) -> str:
    """Angle for display, in degrees, and in arcseconds for small values; – if there is none.

    `fine` adds digits below 10″, so that a value after many trials is distinguished from the ends of its interval.
    """
    if value_deg is None or not math.isfinite(value_deg):
        return "–"
    if abs(value_deg) >= 0.1:
        return f"{value_deg:.4f}°"
    arcsec = value_deg * 3600
    digits = 2 if not fine or abs(arcsec) >= 10.0 else 3 if abs(arcsec) >= 1.0 else 4
    return f"{arcsec:.{digits}f}″"


def fine_text(value_deg: float | None) -> str:
    """`deg_text` with the digits that a report of many trials needs."""
    return deg_text(value_deg, fine=True)


def between_text(low: str, high: str) -> str:
    """Both ends of an interval, ``7.40 to 9.01″``, with the sign of arcseconds once if both have it."""
    return f"{low[:-1] if low[-1:] == high[-1:] == '″' else low} to {high}"


def interval_text(interval: Any, text: Callable[[float | None], str] = fine_text) -> str:
    """``low to high`` of an interval, with a common unit only once; empty without an interval, – for an open limit."""
    if interval is None or all(end is None for end in interval):
        return ""
    low, high = interval
    return between_text(text(low), text(high))


def percent_text(share: float | None) -> str:
    """A fraction in per cent, with enough digits to distinguish it from 0 and 100."""
    if share is None:
        return "–"
    away = min(share, 1.0 - share)
    digits = 2 if away <= 0.0 or away >= 1e-4 else min(6, math.ceil(-math.log10(100 * away) - 1e-9))
    return f"{100 * share:.{digits}f} %"


def rms_text(statistics: dict[str, Any], axis: str) -> str:
    """Rms of an axis at a point of a sweep, and its 95 % interval."""
    rms, low, high = (deg_text(statistics[f"{axis}_{name}_deg"]) for name in ("rms", "rms_low", "rms_high"))
    if "–" in (low, high):
        return rms
    return f"{rms} ({low[:-1] if low[-1] == high[-1] else low}–{high})"


def rate_text(statistics: dict[str, Any]) -> str:
    """Identification rate at a point of a sweep, and its 95 % interval."""
    rate, low, high = (statistics[f"identification_rate{end}"] for end in ("", "_low", "_high"))
    return "–" if rate is None else f"{100 * rate:.2f} % ({100 * low:.1f} to {100 * high:.1f})"


def value_text(value: Any, digits: str = ".6g") -> str:
    """A number of a key or of a table, with the digits given if it is not whole; – if there is none."""
    return "–" if value is None else f"{value:{digits}}" if isinstance(value, float) else str(value)


def short_name(path: str) -> str:
    """Last part of the path of a key; of a component of a list, ``rate_deg_s.0``."""
    *_, above, name = ["", *path.split(".")]
    return f"{above}.{name}" if name.isdecimal() else name
