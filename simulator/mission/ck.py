"""Attitudes of CK kernels, through SpiceyPy (the extra ``spice``): NAIF's CSPICE interpolates them.

Kernels are loaded only during an evaluation, because SPICE's pool of kernels is global and may be used by the calling
program.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from simulator.mission.attitude_law import body_of, from_matrices
from simulator.mission.clock import Clock
from simulator.mission.epochs import from_tdb_seconds, tdb_seconds
from simulator.mission.spice import need_spiceypy
from simulator.mission.tabulated import RESOLUTION_S, Part, piecewise
from startracker.core import FloatArray
from startracker.errors import InputError
from startracker.files import KERNEL_BYTES, check_file

_DELTET = {
    "DELTET/DELTA_T_A": [32.184],
    "DELTET/K": [1.657e-3],
    "DELTET/EB": [1.671e-2],
    "DELTET/M": [6.239996, 1.99096871e-7],
}
"""Constants of TDB − TT, which clock kernels in TT need (*Time Required Reading*, NAIF; kernel naif0012.tls)."""
_TOLERANCE_S = 1e-3
"""Tolerance of SPICE's search for an attitude. Seconds after J2000 are rounded to 1e-7, and times to ticks of the
clock, so the end of an interval may be missed by that much."""


@dataclass(frozen=True, eq=False)
class CkAttitude:
    """Attitudes of one object of a kernel."""

    clock: Clock
    """Epoch."""
    kernels: tuple[str, ...]
    """Files of the attitudes and of the spacecraft's clock."""
    number: int
    """NAIF number of the object."""
    windows_s: tuple[tuple[float, float], ...]
    """Intervals with attitudes, seconds after the epoch."""
    mounting: FloatArray | None
    """(4,): Quaternion from body to camera, if the object is the camera."""

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time, seconds after the epoch."""
        return self.windows_s[0][0] - RESOLUTION_S, self.windows_s[-1][1] + RESOLUTION_S

    def quaternions(self, t_s: FloatArray) -> FloatArray:
        """Unit quaternions (T, 4) ICRS → body at times (T,); `InputError` outside the span, or in a gap."""
        parts = [
            Part(first - RESOLUTION_S, last + RESOLUTION_S, functools.partial(self._of, (first, last)))
            for first, last in self.windows_s
        ]
        with _loaded(self.kernels):
            matrices = piecewise(parts, self.clock, t_s, self.kernels[0], "attitudes")
        return body_of(from_matrices(matrices.reshape(-1, 3, 3)), self.mounting)

    def _of(self, window_s: tuple[float, float], t_s: FloatArray) -> FloatArray:
        """Matrices (T, 9) from ICRF (J2000 of SPICE) at times of a window, with the kernels loaded."""
        import spiceypy

        spacecraft = spiceypy.ckmeta(self.number, "SCLK")
        out = np.empty((len(t_s), 9))
        for k, et in enumerate(tdb_seconds(self.clock, np.clip(t_s, *window_s)).tolist()):
            # CK kernels are indexed by ticks of the spacecraft's clock, and so is the tolerance.
            ticks = spiceypy.sce2c(spacecraft, et)
            tolerance = spiceypy.sce2c(spacecraft, et + _TOLERANCE_S) - ticks
            out[k] = spiceypy.ckgp(self.number, ticks, tolerance, "J2000")[0].ravel()
        return out


def read_ck(path: Path, sclk: Path, clock: Clock, wanted: str | int | None, mounting: FloatArray | None) -> CkAttitude:
    """Law of a CK kernel of any type that has attitudes over intervals.

    Parameters
    ----------
    path : Path
        The kernel.
    sclk : Path
        Kernel of the spacecraft's clock.
    clock : Clock
        The scenario's clock.
    wanted : str, int or None
        NAIF number of the object; needed if the kernel has several.
    mounting : array, shape (4,), optional
        Quaternion from body to camera, if the object is the camera.

    Raises
    ------
    InputError
        If SpiceyPy is not installed, the file is not a kernel of that kind, the object is not in it, or its attitudes
        are relative to a frame that SPICE does not know.
    """
    for file, what in ((path, "a CK kernel"), (sclk, "a kernel of the spacecraft's clock (SCLK)")):
        if not file.exists():
            raise InputError(f"{file}: no such file; give {what}")
        check_file(file, KERNEL_BYTES, f"give {what}")
    kernels = (str(path), str(sclk))
    with _loaded(kernels) as spice:
        numbers = list(spice.ckobj(str(path)))
        known = ", ".join(map(str, numbers))
        if wanted is None and len(numbers) > 1:
            raise InputError(f"{path}: has several objects; choose one by pointing.attitude.object: {known}")
        number = numbers[0] if wanted is None else _number(wanted)
        if number is None or number not in numbers:
            raise InputError(f"{path}: has no object {wanted}; pointing.attitude.object can be {known}")
        found = spice.ckcov(str(path), number, False, "INTERVAL", 0.0, "TDB")
        windows = np.array([spice.wnfetd(found, k) for k in range(spice.wncard(found))])
        windows_s = from_tdb_seconds(clock, windows).tolist()
        law = CkAttitude(clock, kernels, int(number), tuple((first, last) for first, last in windows_s), mounting)
    # One evaluation, so that an unknown frame or a wrong clock kernel is reported now and not during the run.
    law.quaternions(np.array([windows_s[0][0]]))
    return law


def _number(wanted: str | int) -> int | None:
    try:
        return int(wanted)
    except ValueError:
        return None


@contextmanager
def _loaded(kernels: tuple[str, ...]) -> Iterator[Any]:
    """SpiceyPy with kernels loaded; its errors become `InputError` of one line."""
    spiceypy = need_spiceypy()
    from spiceypy.utils.exceptions import NotFoundError, SpiceyError

    # Constants that the calling program has loaded are left as they are, and only our own are removed at the end.
    mine = [name for name in _DELTET if not spiceypy.expool(name)]
    try:
        for kernel in kernels:
            spiceypy.furnsh(kernel)
        for name in mine:
            spiceypy.pdpool(name, _DELTET[name])
        yield spiceypy
    except NotFoundError as error:
        raise InputError(
            f"{kernels[0]}: no attitude relative to J2000 where the kernel covers it; are the frames between known?"
        ) from error
    except SpiceyError as error:
        reason = " ".join(str(getattr(error, "long", "") or error).split())
        raise InputError(f"{kernels[0]}: cannot be used with {Path(kernels[1]).name}: {reason}") from error
    finally:
        for name in mine:
            spiceypy.dvpool(name)
        for kernel in kernels:
            spiceypy.unload(kernel)
