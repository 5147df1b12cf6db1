"""Angles and fractions as text, for tables, pages and verdicts."""

from __future__ import annotations

import math


def deg_text(value_deg: float | None) -> str:
    """Angle for display, in degrees, and in arcseconds for small values."""
    if value_deg is None or not math.isfinite(value_deg):
        return "–"
    return f"{value_deg:.4f}°" if abs(value_deg) >= 0.1 else f"{value_deg * 3600:.2f}″"


def axis_name(axis: str) -> str:
    """Name of an axis of the errors (`simulator.study.statistics.AXES`): ``cross x``, ``about boresight``."""
    return axis.replace("_", " ")


def between_text(low: str, high: str) -> str:
    """Both ends of an interval, ``7.40 to 9.01″``, with the sign of arcseconds once if both have it."""
    return f"{low[:-1] if low[-1:] == high[-1:] == '″' else low} to {high}"


def percent_text(share: float | None) -> str:
    """A fraction in per cent, with enough digits to distinguish it from 0 and 100."""
    if share is None:
        return "–"
    away = min(share, 1.0 - share)
    digits = 2 if away <= 0.0 or away >= 1e-4 else min(6, math.ceil(-math.log10(100 * away) - 1e-9))
    return f"{100 * share:.{digits}f} %"
