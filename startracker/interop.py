"""Objects of astropy and SciPy in the public interface: ``Quantity``, ``Time``, ``SkyCoord`` and ``Rotation``.

They are recognised by their attributes, so that neither package needs to be imported; plain numbers are passed through.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from startracker.errors import InputError


def plain(given: Any, unit: str, name: str) -> Any:
    """Value of an astropy ``Quantity`` (or ``Angle``) in a unit; anything else is returned unchanged.

    Raises
    ------
    InputError
        If it cannot be converted.
    """
    if not (hasattr(given, "to_value") and hasattr(given, "unit")):
        return given
    try:
        return given.to_value(unit)
    except ValueError as error:  # astropy's UnitConversionError is one
        raise InputError(f"{name} is in '{given.unit}'; it must be in {unit} or a unit of the same kind") from error


def is_time(given: Any) -> bool:
    """Whether this is an astropy ``Time``."""
    return hasattr(given, "tt") and hasattr(given, "jyear")


def julian_year(given: Any) -> Any:
    """Julian epoch, TT, of an astropy ``Time``; anything else is returned unchanged."""
    return float(given.tt.jyear) if is_time(given) and np.ndim(given.tt.jyear) == 0 else given


def is_skycoord(given: Any) -> bool:
    """Whether this is an astropy ``SkyCoord``."""
    return hasattr(given, "icrs")


def skycoord_deg(given: Any, name: str) -> tuple[float, float]:
    """ICRS right ascension and declination, degrees, of a scalar astropy ``SkyCoord``.

    Raises
    ------
    InputError
        For anything else.
    """
    icrs = getattr(given, "icrs", None)
    if icrs is None or np.ndim(icrs.ra) != 0:
        raise InputError(f"{name} must be an astropy SkyCoord of one direction; got {type(given).__name__}")
    return float(icrs.ra.deg), float(icrs.dec.deg)


def is_rotation(given: Any) -> bool:
    """Whether this is a SciPy ``Rotation``."""
    return all(hasattr(given, name) for name in ("as_quat", "as_rotvec", "apply"))


def rotation_quat(given: Any) -> NDArray[np.float64]:
    """Quaternion (x, y, z, w), in the convention of `Attitude`, of a single SciPy ``Rotation``.

    It is the conjugate of SciPy's quaternion, and v_target = rotation.apply(v_source).

    Raises
    ------
    InputError
        For anything else.
    """
    quat = np.asarray(given.as_quat(), dtype=float) if is_rotation(given) else np.empty(0)
    if quat.shape != (4,):
        raise InputError(f"a single scipy Rotation is needed; got {type(given).__name__} with shape {quat.shape[:-1]}")
    return quat * [-1.0, -1.0, -1.0, 1.0]
