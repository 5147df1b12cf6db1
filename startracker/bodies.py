"""Directions of the Sun, the Moon and the planets at an epoch, to mark them on a picture."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from startracker.errors import InputError
from startracker.observer import Observer, aberrate

__all__ = ["BODIES", "body_directions", "earth_observer"]

FloatArray = NDArray[np.float64]

BODIES = {
    "Sun": "sun",
    "Moon": "moon",
    "Mercury": "mercury",
    "Venus": "venus",
    "Mars": "mars",
    "Jupiter": "jupiter barycenter",
    "Saturn": "saturn barycenter",
    "Uranus": "uranus barycenter",
    "Neptune": "neptune barycenter",
}
"""Body to its name in the ephemeris DE421."""
_DAYS_PER_AU = 499.004783836 / 86400.0


def body_directions(observer: Observer) -> dict[str, FloatArray]:
    """Unit vectors (3,), ICRS, of the bodies seen by an observer, with light time.

    Aberration is included if the velocity is known, as in the directions that a tracker is given.
    Without a position the observer is at the Earth's centre, from which the Moon is up to 1° away from where it is seen
    on the ground; it is then left out.

    Raises
    ------
    InputError
        If the ephemeris (DE421: 1899-07-29 to 2053-10-09) does not cover the epoch.
    """
    time = _timescale().tt_jd(2451545.0 + 365.25 * (observer.epoch_jyear - 2000.0))
    with _ephemeris(observer.epoch_jyear) as kernel:
        origin = kernel["earth"].at(time).position.au if observer.position_au is None else observer.position_au
        seen = {}
        for name, target in BODIES.items():
            if name == "Moon" and observer.position_au is None:
                continue
            light_days = 0.0
            for _ in range(3):
                offset = kernel[target].at(time - light_days).position.au - origin
                light_days = float(np.linalg.norm(offset)) * _DAYS_PER_AU
            seen[name] = offset / np.linalg.norm(offset)
    if observer.velocity_km_s is None:
        return seen
    return dict(zip(seen, aberrate(np.array(list(seen.values())), observer.velocity_km_s), strict=True))


def earth_observer(time: datetime) -> Observer:
    """Observer that moves with the Earth's centre, for photographs from the ground: aberration to 0.3″.

    Its position is left unknown: parallax is not corrected, and the Moon, which the ground sees elsewhere, not marked.

    Raises
    ------
    InputError
        If the ephemeris does not cover the time.
    """
    at = _timescale().from_datetime(time)
    with _ephemeris(float(at.J)) as kernel:
        return Observer(float(at.J), velocity_km_s=kernel["earth"].at(at).velocity.km_per_s)


def _timescale() -> Any:
    from skyfield.api import load

    return load.timescale(builtin=True)  # the tables included in Skyfield: nothing is downloaded


@contextmanager
def _ephemeris(epoch_jyear: float) -> Iterator[Any]:
    """DE421 by Skyfield; a date outside of it, used within the block, raises `InputError`."""
    from skyfield.errors import EphemerisRangeError
    from skyfield.jpllib import SpiceKernel

    kernel = SpiceKernel(str(files("skyfield_data") / "data" / "de421.bsp"))
    try:
        yield kernel
    except EphemerisRangeError as error:
        raise InputError(
            f"the positions of the planets are known from 1899-07-29 to 2053-10-09, not in {epoch_jyear:.2f}"
        ) from error
    finally:
        kernel.close()
