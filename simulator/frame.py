"""Frame and truth: what the camera hands on, and, apart from it, what really was.

`Frame` holds only what a spacecraft knows: the image, its calibrated camera, its own time, place and speed, the
attitude of its other sensors. `FrameTruth` is a separate object that the tracker never sees.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray

from startracker.attitude import Attitude
from startracker.camera import Camera
from startracker.observer import Observer

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Frame:
    """One exposure as the spacecraft has it.

    Parameters
    ----------
    image : array, shape (height, width)
        Digital numbers: uint16, or float64 where the scenario has no converter.
    camera : Camera
        The calibrated camera.
    observer : Observer
        Epoch of mid-exposure, barycentric position and velocity.
    utc : str
        Mid-exposure, UTC, ISO 8601.
    exposure_s : float
        Exposure time.
    saturation_dn, gain_e_per_dn, offset_dn, read_noise_e : float
        What calibration on the ground has told of the detector.
    prior : Attitude, optional
        Attitude by the other sensors.
    prior_deg : float
        Half width of its error about each axis.
    scenario, seed, index : str, int, int
        Where the frame comes from; enough to make it again.
    parameters : dict
        Every key of the scenario's camera, for the file header.
    """

    image: NDArray[np.generic]
    camera: Camera
    observer: Observer
    utc: str
    exposure_s: float
    saturation_dn: float
    gain_e_per_dn: float
    offset_dn: float
    read_noise_e: float
    prior: Attitude | None = None
    prior_deg: float = 0.0
    scenario: str = ""
    seed: int = 0
    index: int = 0
    parameters: dict[str, float | int | str | bool] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class TrueSources:
    """Stars and bodies in or near the field, as columns of equal length N.

    Parameters
    ----------
    id : int array
        Catalogue number; 0 for bodies of the solar system.
    name : str array
        Star or body.
    kind : str array
        ``star``, ``planet``, ``moon`` or ``sun``.
    xy : array, shape (N, 2)
        Pixel at mid-exposure, by the true attitude.
    image_xy : array, shape (N, 2)
        Middle of the path rendered over the exposure, with a rolling shutter over that of the rows it stands in: where
        the image has its centre of light. They differ where paths are curved, or rows are exposed later than the
        middle one.
    direction : array, shape (N, 3)
        Apparent direction, ICRS axes.
    v_mag, b_v, electrons : array
        V, B − V, and mean photo-electrons over the exposure.
    variable : bool array
        Known to the catalogue as a variable star, drawn at the catalogue's V all the same; False for bodies.
    """

    id: NDArray[np.int64]
    name: NDArray[np.str_]
    kind: NDArray[np.str_]
    xy: FloatArray
    image_xy: FloatArray
    direction: FloatArray
    v_mag: FloatArray
    b_v: FloatArray
    electrons: FloatArray
    variable: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.id)

    @functools.cached_property
    def is_star(self) -> NDArray[np.bool_]:
        """Which of them are stars, (N,)."""
        return np.asarray(self.kind == "star")

    def select(self, rows: NDArray[np.int64]) -> TrueSources:
        """Some of the sources, by index array."""
        return TrueSources(**{column.name: getattr(self, column.name)[rows] for column in fields(self)})


@dataclass(frozen=True, eq=False)
class FrameTruth:
    """What really was, at mid-exposure.

    Parameters
    ----------
    attitude : Attitude
        ICRS to camera.
    mounting : Attitude
        Body to camera.
    rate_camera_rad_s : array, shape (3,)
        Inertial angular velocity in camera axes.
    t_s : float
        Seconds after the scenario's epoch.
    sources : TrueSources
        Everything drawn that falls on the detector.
    mean_electrons : array, shape (height, width), optional
        Photo-electrons of sources and background as they come from the lens: no noise, no flaw of the detector.
    excluded : tuple of str
        Bodies within the baffle's exclusion angle.
    """

    attitude: Attitude
    mounting: Attitude
    rate_camera_rad_s: FloatArray
    t_s: float
    sources: TrueSources
    mean_electrons: FloatArray | None = None
    excluded: tuple[str, ...] = ()
