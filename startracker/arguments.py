"""Checks of arguments: values of a wrong type or outside their range are an `InputError` that names the argument.

Objects of astropy (``Quantity``, ``Time``, ``SkyCoord``) and SciPy (``Rotation``) are recognised by their attributes,
so that neither package needs to be imported; plain numbers are passed through.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Iterator
from numbers import Integral, Real
from pathlib import Path
from typing import Any, TypeVar, get_args, overload

import numpy as np
from numpy.typing import NDArray

from startracker.core import FloatArray
from startracker.errors import InputError

T = TypeVar("T")
_TRUTH: tuple[Any, ...] = (bool, np.bool_)
ABOVE_0 = math.ulp(0.0)
"""Lower limit of a positive number."""


def real_number(
    name: str,
    given: Any,
    *,
    unit: str = "",
    least: float = -math.inf,
    most: float = math.inf,
    finite: bool = True,
    what: str = "a number",
) -> float:
    """Argument as a float: a real number, also of NumPy, or an astropy ``Quantity`` if there is a `unit`.

    Parameters
    ----------
    name : str
        Name of the argument, for the message.
    given : object
        Value as given by the caller.
    unit : str
        Unit into which a quantity is converted.
    least, most : float
        Limits, inclusive.
    finite : bool
        Whether NaN and infinities are rejected; if not, the limits do not apply to NaN.
    what : str
        Description of what the argument must be, for the message.

    Raises
    ------
    InputError
        For anything else, including complex numbers, text and truth values.
    """
    value = plain(given, unit, name) if unit else given
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if isinstance(value, Real) and type(value) not in _TRUTH:
        try:
            number = float(value)
        except OverflowError:  # an integer beyond 1.8e308
            number, finite = math.nan, True
        within = least <= number <= most and (math.isfinite(number) or not finite)
        if within or (math.isnan(number) and not finite):
            return number
    raise InputError(f"{name} must be {_range(what, least, most, unit)}; got {shown(given)}")


def whole_number(name: str, given: Any, *, least: float = -math.inf, most: float = math.inf) -> int:
    """Argument as an integer; a float without a fraction is one.

    Raises
    ------
    InputError
        For anything else, or a number outside the limits.
    """
    value = given[()] if isinstance(given, np.ndarray) and given.ndim == 0 else given
    good = isinstance(value, Integral) or (isinstance(value, float | np.floating) and float(value).is_integer())
    if good and type(value) not in _TRUTH and least <= value <= most:
        return int(value)
    raise InputError(f"{name} must be {_range('a whole number', least, most)}; got {shown(given)}")


def real_array(
    name: str, given: Any, shape: tuple[int | None, ...] | None = None, *, unit: str = "", finite: bool = True
) -> FloatArray:
    """Argument as an array of real numbers, a copy unless it is one already.

    Parameters
    ----------
    name : str
        Name of the argument, for the message.
    given : array_like or astropy Quantity
        Value as given by the caller.
    shape : tuple, optional
        Required shape; None in it stands for any length.
    unit : str
        Unit into which a quantity is converted.
    finite : bool
        Whether NaN and infinities are rejected.

    Raises
    ------
    InputError
        For anything else; complex numbers have no real value, and text is not converted.
    """
    value = plain(given, unit, name) if unit else given
    try:
        array = np.asarray(value)
    except (TypeError, ValueError):  # rows of different lengths
        array = np.empty(0, dtype=object)
    fits = shape is None or (
        array.ndim == len(shape) and all(n in (None, m) for n, m in zip(shape, array.shape, strict=True))
    )
    if array.dtype.kind not in "iuf" or not fits:
        needed = "" if shape is None else f" with the shape {_shape_text(shape)}"
        got = f"the shape {array.shape}" if array.dtype.kind in "iuf" else shown(given)
        raise InputError(f"{name} must be real numbers{needed}{f', {unit}' if unit else ''}; got {got}")
    array = array.astype(np.float64, copy=False)
    if finite and not np.isfinite(array).all():
        raise InputError(f"{name} must be finite numbers; got {shown(given)}")
    return array


@overload
def of_kind(name: str, given: Any, kinds: type[T], advice: str = "") -> T: ...


@overload
def of_kind(name: str, given: Any, kinds: tuple[Any, ...], advice: str = "") -> Any: ...


def of_kind(name: str, given: Any, kinds: Any, advice: str = "") -> Any:
    """The argument, if it is an object of one of these classes.

    Raises
    ------
    InputError
        If it is not; `advice` explains how to create one.
    """
    if isinstance(given, kinds):
        return given
    names = " or ".join("None" if kind is type(None) else kind.__name__ for kind in _classes(kinds))
    raise InputError(f"{name} must be {_article(names)} {names}{f' ({advice})' if advice else ''}; got {shown(given)}")


def pair(name: str, given: Any) -> tuple[float, float]:
    """Argument as two finite real numbers.

    Raises
    ------
    InputError
        For anything else.
    """
    one, other = real_array(name, given, (2,)).tolist()
    return one, other


def names_of(given: Any) -> tuple[str, ...]:
    """Argument as names: a sequence of text, and not a single text.

    Raises
    ------
    InputError
        For anything else.
    """
    if isinstance(given, Iterable) and not isinstance(given, str | bytes):
        names = tuple(given)
        if all(isinstance(name, str) for name in names):
            return names
    raise InputError(f"names must be given as a list of text; got {shown(given)}")


def switch(name: str, given: Any) -> bool:
    """Argument as a truth value: True or False, also of NumPy, or 1 or 0.

    Raises
    ------
    InputError
        For anything else: text such as "no" would be true.
    """
    if isinstance(given, bool | np.bool_) or (isinstance(given, int) and given in (0, 1)):
        return bool(given)
    raise InputError(f"{name} must be True or False; got {shown(given)}")


def file_path(name: str, given: Any) -> Path:
    """Argument as the path of a file: text or an `os.PathLike`.

    Raises
    ------
    InputError
        For anything else, or a name that no file can have.
    """
    if isinstance(given, str) or (isinstance(given, os.PathLike) and isinstance(os.fspath(given), str)):
        if "\0" in str(given):
            raise InputError(f"{str(given)!r} is not a file name: it contains a null character")
        return Path(given)
    raise InputError(f"{name} must be the name of a file; got {shown(given)}")


def text(name: str, given: Any) -> str:
    """The argument, if it is text.

    Raises
    ------
    InputError
        If it is not.
    """
    if isinstance(given, str):
        return given
    raise InputError(f"{name} must be text; got {shown(given)}")


def _classes(kinds: Any) -> Iterator[type]:
    """The classes of nested tuples and unions."""
    parts = kinds if isinstance(kinds, tuple) else get_args(kinds)
    if not parts:
        yield kinds
    for part in parts:
        yield from _classes(part)


def _article(word: str) -> str:
    return "an" if word[:1] in "AEIOUaeiou" else "a"


def _range(what: str, least: float, most: float, unit: str = "") -> str:
    tail = f", {unit}" if unit else ""
    if math.isfinite(least) and math.isfinite(most):
        return f"{what} from {least:g} to {most:g}{tail}"
    if math.isfinite(least):
        positive = least == ABOVE_0
        return f"{what.replace('a ', 'a positive ', 1)}{tail}" if positive else f"{what} of at least {least:g}{tail}"
    return f"{what} of at most {most:g}{tail}" if math.isfinite(most) else f"{what}{tail}"


def _shape_text(shape: tuple[int | None, ...]) -> str:
    lengths = ["N" if length is None else str(length) for length in shape]
    return f"({', '.join(lengths)}{',' if len(lengths) == 1 else ''})"


def shown(given: Any) -> str:
    """A value as quoted in a message: one short line."""
    if isinstance(given, np.ndarray) and given.ndim:
        return f"an array of {given.dtype} with the shape {given.shape}"
    try:
        line = " ".join(repr(given).split())
    except Exception:
        line = ""
    return line if 0 < len(line) <= 60 else f"an object of {type(given).__name__}"


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
