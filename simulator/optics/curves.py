"""Spectral curves: transmission of a lens, quantum efficiency of a detector, passband of a filter."""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from startracker.core import FloatArray
from startracker.display import fields_repr
from startracker.errors import InputError
from startracker.files import CURVE_BYTES, read_text

CurveKind = Literal["transmission", "quantum_efficiency", "passband"]

FLAT_RANGE_NM = (300.0, 1100.0)
"""Range of a curve given as one number: from the absorption edge of optical glass to the band edge of silicon."""

_PREFIX: dict[str, str] = {"transmission": "transmission", "quantum_efficiency": "qe", "passband": "passband"}
_PRODUCT_STEP_NM = 1.0


@dataclass(frozen=True, eq=False)
class Curve:
    """A function of wavelength, linear between its points and zero outside.

    Raises
    ------
    InputError
        If the lengths differ, a value is not finite, or the wavelengths are not ascending.
    """

    wavelength_nm: FloatArray
    """(N,): Ascending, N ≥ 2, nanometres."""
    value: FloatArray
    """(N,): Values; a fraction between 0 and 1 if from `load_curve`."""

    __repr__ = fields_repr

    def __post_init__(self) -> None:
        wavelength_nm, value = np.array(self.wavelength_nm, dtype=float), np.array(self.value, dtype=float)
        if wavelength_nm.ndim != 1 or wavelength_nm.shape != value.shape or len(wavelength_nm) < 2:
            raise InputError("a curve needs two or more points, each with a wavelength and a value")
        if not (np.isfinite(wavelength_nm).all() and np.isfinite(value).all()):
            raise InputError("a curve must have finite values only")
        if not (np.diff(wavelength_nm) > 0).all():
            raise InputError("the wavelengths of a curve must be ascending")
        # Copies that cannot be modified, because curves are shared.
        for array in (wavelength_nm, value):
            array.flags.writeable = False
        object.__setattr__(self, "wavelength_nm", wavelength_nm)
        object.__setattr__(self, "value", value)

    @classmethod
    def flat(cls, value: float) -> Curve:
        """A constant over `FLAT_RANGE_NM`."""
        return cls(np.array(FLAT_RANGE_NM), np.array([value, value]))

    def __call__(self, wavelength_nm: ArrayLike) -> FloatArray:
        """Value at any wavelength (nm): linear between the points, zero outside."""
        points = np.asarray(wavelength_nm, dtype=float)
        return np.asarray(np.interp(points, self.wavelength_nm, self.value, left=0.0, right=0.0))

    def __mul__(self, other: Curve) -> Curve:
        """Product over the common range.

        Sampled at the points of both and at least every nanometre, so that linear interpolation approximates the
        piecewise quadratic product to h²/8 of its curvature.
        """
        low = max(self.wavelength_nm[0], other.wavelength_nm[0])
        high = min(self.wavelength_nm[-1], other.wavelength_nm[-1])
        if low >= high:
            raise InputError(
                f"two curves to be multiplied have no wavelength in common: {self._reach()} and {other._reach()}"
            )
        fine = np.linspace(low, high, math.ceil((high - low) / _PRODUCT_STEP_NM) + 1)
        points = np.unique(np.concatenate([fine, self.wavelength_nm, other.wavelength_nm]))
        points = points[(points >= low) & (points <= high)]
        return Curve(points, self(points) * other(points))

    def _reach(self) -> str:
        return f"{self.wavelength_nm[0]:g} to {self.wavelength_nm[-1]:g} nm"


def shipped_curves(kind: CurveKind) -> list[str]:
    """Names of the included curves of a kind."""
    prefix = _PREFIX[kind] + "_"
    folder = resources.files("simulator.optics") / "data"
    names = (entry.name for entry in folder.iterdir())
    return sorted(name[len(prefix) : -4] for name in names if name.startswith(prefix) and name.endswith(".csv"))


def load_curve(spec: str | float, kind: CurveKind, base_dir: str | Path | None = None) -> Curve:
    """Curve from a number, the name of an included curve, or a CSV file.

    Parameters
    ----------
    spec : str or float
        A number between 0 and 1 (constant over `FLAT_RANGE_NM`); the name of an included curve; or the path of a CSV
        file whose header is ``wavelength_nm`` and a name of the value, with ascending wavelengths and values between 0
        and 1. Lines that start with ``#`` are comments.
    kind : {"transmission", "quantum_efficiency", "passband"}
        Kind of the included curve.
    base_dir : path, optional
        Base folder of relative paths; by default the current one.

    Raises
    ------
    InputError
        For a number outside 0 to 1, an unknown name, or a missing or invalid file (with its line).
    """
    what = kind.replace("_", " ")
    if isinstance(spec, bool) or not isinstance(spec, str | int | float):
        raise InputError(f"a {what} is a number, a name or a CSV file; got {spec!r}")
    if not isinstance(spec, str):
        if not 0.0 <= spec <= 1.0:
            raise InputError(f"a {what} lies between 0 and 1; got {spec:g}")
        return Curve.flat(float(spec))
    names = shipped_curves(kind)
    if spec in names:
        text = (resources.files("simulator.optics") / "data" / f"{_PREFIX[kind]}_{spec}.csv").read_text(
            encoding="utf-8"
        )
        return _parse(text, spec)
    # A text that looks like a path is reported as a missing file, any other as an unknown name with a suggestion.
    path = Path(base_dir or ".") / spec
    if path.suffix.lower() == ".csv" or len(Path(spec).parts) > 1 or path.is_file():
        return _parse(read_text(path, CURVE_BYTES, f"give a CSV file of the {what}"), str(path))
    close = difflib.get_close_matches(spec, names, n=1)
    hint = f"; did you mean '{close[0]}'?" if close else ""
    raise InputError(f"'{spec}' is not an included {what} ({', '.join(names)}), a number or a CSV file{hint}")


def _parse(text: str, where: str) -> Curve:
    table = read_points(text, where, "wavelength_nm,value", "a wavelength and a value", _fault)
    return Curve(table[:, 0], table[:, 1])


def _fault(wavelength_nm: float, value: float, before: float | None) -> str:
    if not 0.0 < wavelength_nm < math.inf:
        return f"a wavelength must be a positive number of nanometres; found {wavelength_nm:g}"
    if not 0.0 <= value <= 1.0:
        return f"a value must lie between 0 and 1; found {value:g}"
    if before is not None and wavelength_nm <= before:
        return f"wavelengths must be ascending; {wavelength_nm:g} nm follows {before:g} nm"
    return ""


def read_points(
    text: str, where: str, header: str, what: str, fault: Callable[[float, float, float | None], str]
) -> FloatArray:
    """Points (N, 2) of a CSV text of two columns; lines that begin with ``#`` are comments.

    Parameters
    ----------
    text, where : str
        The text, and the name of its file for messages.
    header : str
        Names of the columns; ``value`` stands for any name.
    what : str
        A point in words.
    fault : callable
        ``fault(x, y, before)``: what is wrong with a point whose predecessor has the abscissa `before` (None for the
        first point); empty if nothing is.

    Raises
    ------
    InputError
        With file and line, for the first fault.
    """
    points: list[tuple[float, float]] = []
    names: list[str] = []
    for number, line in enumerate(text.splitlines(), start=1):
        cells = [cell.strip() for cell in line.split(",")]
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        if not names:
            names = cells
            expected = header.split(",")
            if len(names) != 2 or names[0] != expected[0] or expected[1] not in ("value", names[1]):
                raise InputError(f"{where}:{number}: the header must be '{header}'; found '{line.strip()}'")
            continue
        if len(cells) != 2:
            raise InputError(f"{where}:{number}: a line holds {what}; found '{line.strip()}'")
        try:
            x, y = float(cells[0]), float(cells[1])
        except ValueError:
            raise InputError(f"{where}:{number}: '{line.strip()}' is not two numbers") from None
        if found := fault(x, y, points[-1][0] if points else None):
            raise InputError(f"{where}:{number}: {found}")
        points.append((x, y))
    if len(points) < 2:
        raise InputError(f"{where}: needs a header '{header}' and two or more lines; found {len(points)}")
    return np.array(points)
