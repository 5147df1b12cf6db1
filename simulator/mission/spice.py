"""Trajectory and attitudes written as SPICE kernels by SpiceyPy (extra ``spice``): SPK of type 13, CK of type 3, with
the kernels of the clock and of the camera's frame that they need.

SPICE identifies its frame J2000 with the ICRF. The clock ticks 65,536 times a second of TDB.
"""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from simulator.mission.clock import Clock
from simulator.mission.epochs import tdb_seconds
from simulator.mission.spk import NAIF
from simulator.mission.trajectory import Trajectory
from startracker.core import FloatArray
from startracker.errors import InputError

SPACECRAFT_ID, CAMERA_ID = -999, -999_001
"""NAIF numbers of spacecraft and camera, from the range that NAIF does not assign."""
CAMERA_FRAME = "BORESIGHT_CAMERA"
_TICKS = 65_536
_HERMITE_DEGREE = 7
_GAP_STEPS = 1.5
"""Attitudes farther apart than this many median steps are not interpolated by SPICE."""

_FRAME_KERNEL = f"""KPL/FK
The star camera: +z along the boresight, +x along columns, +y along rows of the image.
\\begindata
FRAME_{CAMERA_FRAME} = {CAMERA_ID}
FRAME_{CAMERA_ID}_NAME = '{CAMERA_FRAME}'
FRAME_{CAMERA_ID}_CLASS = 3
FRAME_{CAMERA_ID}_CLASS_ID = {CAMERA_ID}
FRAME_{CAMERA_ID}_CENTER = {SPACECRAFT_ID}
CK_{CAMERA_ID}_SCLK = {SPACECRAFT_ID}
CK_{CAMERA_ID}_SPK = {SPACECRAFT_ID}
\\begintext
"""


class Attitudes(NamedTuple):
    """Attitudes of the camera."""

    t_s: FloatArray
    """(N,): Ascending times, seconds after the epoch."""
    quaternions: FloatArray
    """(N, 4): Scalar last, ICRF to camera."""


def need_spiceypy() -> Any:
    """The package SpiceyPy; `InputError` if it is not installed."""
    try:
        import spiceypy
    except ImportError as error:
        raise InputError("SPICE kernels need the package spiceypy: pip install 'boresight[spice]'") from error
    return spiceypy


def spice_kernels(trajectory: Trajectory, t_s: FloatArray, attitudes: dict[str, Attitudes]) -> dict[str, bytes]:
    """Files of kernels by name.

    Parameters
    ----------
    trajectory : Trajectory
        True trajectory.
    t_s : array, shape (N,)
        Ascending times of the states of ``trajectory.bsp``, seconds after the epoch; no such file for N below 2.
    attitudes : dict
        Attitudes by the name of their file, such as ``true.bc``.

    Returns
    -------
    dict
        These files, ``camera.tsc`` (clock) and ``camera.tf`` (frame).

    Raises
    ------
    InputError
        If SpiceyPy is not installed.
    """
    spice, clock = need_spiceypy(), trajectory.clock
    et_s = tdb_seconds(clock, t_s)
    first_s = math.floor(float(et_s[0])) - 1
    # The clock starts a second before the first state, so that no time is negative.
    files = {"camera.tsc": _clock_kernel(clock, first_s).encode(), "camera.tf": _FRAME_KERNEL.encode()}
    with tempfile.TemporaryDirectory() as folder:
        if len(t_s) > 1:
            path = Path(folder) / "trajectory.bsp"
            _write_spk(spice, path, trajectory, t_s, et_s)
            files[path.name] = path.read_bytes()
        for name, given in attitudes.items():
            path = Path(folder) / name
            _write_ck(spice, path, given, (tdb_seconds(clock, given.t_s) - first_s) * _TICKS)
            files[name] = path.read_bytes()
    return files


def _write_spk(spice: Any, path: Path, trajectory: Trajectory, t_s: FloatArray, et_s: FloatArray) -> None:
    """Write the states of a trajectory as an SPK of type 13, Hermite polynomials of degree up to 7."""
    numbers = {name: number for number, name in NAIF.items()}
    degree = min(_HERMITE_DEGREE, 2 * len(t_s) - 1)
    states = np.concatenate(trajectory.state(t_s), axis=1)
    handle = spice.spkopn(str(path), "boresight", 0)
    what = (SPACECRAFT_ID, numbers[trajectory.centre], "J2000", et_s[0], et_s[-1], "true trajectory")
    spice.spkw13(handle, *what, degree, len(t_s), states, et_s)
    spice.spkcls(handle)


def _write_ck(spice: Any, path: Path, given: Attitudes, ticks: FloatArray) -> None:
    """Write attitudes as a CK of type 3, which SPICE interpolates at constant rate within intervals without gaps."""
    steps = np.diff(ticks)
    gaps = np.flatnonzero(steps > _GAP_STEPS * np.median(steps)) + 1 if len(steps) else np.empty(0, np.int64)
    starts = ticks[np.concatenate([[0], gaps])]
    scalar_first = np.roll(given.quaternions, 1, axis=1)
    # For the same matrix, the vector part of SPICE's quaternion has the opposite sign: it describes the rotation of
    # vectors and ours that of the axes.
    scalar_first[:, 1:] *= -1.0
    handle = spice.ckopn(str(path), "boresight", 0)
    what = (ticks[0], ticks[-1], CAMERA_ID, "J2000", False, "attitude of the camera")
    spice.ckw03(handle, *what, len(ticks), ticks, scalar_first, np.zeros((len(ticks), 3)), len(starts), starts)
    spice.ckcls(handle)


def _clock_kernel(clock: Clock, first_s: int) -> str:
    """Text of the kernel of the spacecraft's clock, which starts `first_s` seconds of TDB after J2000."""
    number = -SPACECRAFT_ID
    return f"""KPL/SCLK
\\begindata
SCLK_KERNEL_ID = ( @{clock.epoch:%Y-%m-%d} )
SCLK_DATA_TYPE_{number} = ( 1 )
SCLK01_TIME_SYSTEM_{number} = ( 1 )
SCLK01_N_FIELDS_{number} = ( 2 )
SCLK01_MODULI_{number} = ( 4294967296 {_TICKS} )
SCLK01_OFFSETS_{number} = ( 0 0 )
SCLK01_OUTPUT_DELIM_{number} = ( 1 )
SCLK_PARTITION_START_{number} = ( 0.0 )
SCLK_PARTITION_END_{number} = ( 281474976710655.0 )
SCLK01_COEFFICIENTS_{number} = ( 0.0 {first_s}.0 1.0 )
\\begintext
"""
