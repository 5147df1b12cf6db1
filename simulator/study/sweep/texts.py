"""Statistics of points and values of keys as text, for the pages and for the terminal."""

from __future__ import annotations

from typing import Any

from simulator.study.texts import deg_text


def rms_text(statistics: dict[str, Any], axis: str) -> str:
    """Rms of an axis and its 95 % interval, for display."""
    rms, low, high = (deg_text(statistics[f"{axis}_{name}_deg"]) for name in ("rms", "rms_low", "rms_high"))
    if "–" in (low, high):
        return rms
    return f"{rms} ({low[:-1] if low[-1] == high[-1] else low}–{high})"


def rate_text(statistics: dict[str, Any]) -> str:
    """Identification rate and its 95 % interval, for display."""
    rate, low, high = (statistics[f"identification_rate{end}"] for end in ("", "_low", "_high"))
    return "–" if rate is None else f"{100 * rate:.2f} % ({100 * low:.1f} to {100 * high:.1f})"


def number_text(value: float | None) -> str:
    """A mean or a time with one decimal, for display; – if missing."""
    return "–" if value is None else f"{value:.1f}"


def value_text(value: Any) -> str:
    """A value of a key, for display; – if missing."""
    return "–" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)


def short_name(path: str) -> str:
    """Last part of the path of a key; of a component of a list, ``rate_deg_s.0``."""
    *_, above, name = ["", *path.split(".")]
    return f"{above}.{name}" if name.isdecimal() else name
