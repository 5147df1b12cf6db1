"""One camera of several on a body, as the filter knows it."""

from __future__ import annotations

from dataclasses import dataclass

from startracker.arguments import ABOVE_0, real_array, real_number
from startracker.errors import InputError
from startracker.geometry.attitude import Attitude


@dataclass(frozen=True)
class Head:
    """One camera of several on a body.

    Parameters
    ----------
    name : str
        Its name.
    mounting : Attitude
        Body to camera, as known before the flight.
    alignment_sigma_rad : float
        Standard deviation of the mounting about each axis, which is then estimated. 0: it is exact.
    correlated_sigma_rad : tuple of three float
        Standard deviation of the part of its errors that is correlated from frame to frame, about each axis of the
        camera; in addition to the covariance of its attitudes. All 0: errors of different frames are independent.
    correlation_s : float
        Correlation time of this part, such as the time that a star takes to cross the field.
    bending_sigma_rad : float
        Standard deviation about each axis of the motion of its mounting in flight, such as the thermal deformation of
        the structure around an orbit, which is then estimated. 0: the mounting does not move.
    bending_s : float
        Correlation time of this motion. For a deformation that follows the orbit it is the period divided by 2π: 900 s
        in a low orbit.

    Raises
    ------
    InputError
        For a name that is not text, a mounting that is not an attitude from body to camera, or standard deviations and
        times that are not finite or negative.
    """

    name: str
    mounting: Attitude
    alignment_sigma_rad: float = 0.0
    correlated_sigma_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    correlation_s: float = 60.0
    bending_sigma_rad: float = 0.0
    bending_s: float = 900.0

    def __post_init__(self) -> None:
        if not isinstance(self.name, str):
            raise InputError(f"a head's name must be text; got {self.name!r}")
        mounting = self.mounting
        if not isinstance(mounting, Attitude) or (mounting.source, mounting.target) != ("body", "camera"):
            raise InputError(f"head {self.name}: the mounting must be an attitude from body to camera")
        for name in ("alignment_sigma_rad", "bending_sigma_rad"):
            real_number(f"head {self.name}: {name}", getattr(self, name), least=0.0)
        for name in ("correlation_s", "bending_s"):
            real_number(f"head {self.name}: {name}", getattr(self, name), least=ABOVE_0)
        what = f"head {self.name}: correlated_sigma_rad"
        if not (real_array(what, self.correlated_sigma_rad, (3,)) >= 0.0).all():
            raise InputError(f"{what} must be three numbers, zero or positive; got {self.correlated_sigma_rad}")
