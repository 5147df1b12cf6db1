"""Range checks of settings."""

from __future__ import annotations

import math
from typing import Any

from startracker.errors import InputError

FORBID = {"extra": "forbid"}  # read by pydantic, which this package does not import

ABOVE_0, BELOW_1 = math.ulp(0.0), math.nextafter(1.0, 0.0)
POSITIVE, COUNT, FROM_0 = (ABOVE_0, math.inf), (1, math.inf), (0.0, math.inf)


def check_settings(settings: Any, **limits: tuple[float, float]) -> None:
    """Check that settings are numbers within their limits (inclusive); None is accepted.

    Raises
    ------
    InputError
        With the setting's name, its value and its limits.
    """
    for name, (least, most) in limits.items():
        value = getattr(settings, name)
        if value is None:
            continue
        good = isinstance(value, (int, float)) or (hasattr(value, "dtype") and value.dtype.kind in "iuf")
        if not (good and least <= value <= most):
            within = f"at least {least:g}" if most == math.inf else f"from {least:g} to {most:g}"
            raise InputError(f"{name} is {value!r}; it must be a number {within}")
