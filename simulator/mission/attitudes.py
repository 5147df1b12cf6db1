"""Build the attitude law of a scenario's ``pointing`` section."""

from __future__ import annotations

from pathlib import Path

from simulator.mission.aem import read_aem
from simulator.mission.attitude_law import AttitudeLaw
from simulator.mission.attitude_table import TabulatedAttitude, read_attitude_table
from simulator.mission.ck import read_ck
from simulator.mission.clock import Clock
from simulator.mission.parameters import AttitudeSource, PointingParameters
from simulator.mission.pointing import mounting_of
from simulator.mission.slews import build_slews
from simulator.mission.tracking import build_tracking
from simulator.mission.trajectories import build_trajectory
from simulator.mission.trajectory import Trajectory
from startracker.core import FloatArray
from startracker.errors import InputError


def build_attitude_law(parameters: PointingParameters, orbit: Trajectory, folder: Path = Path()) -> AttitudeLaw | None:
    """Attitude law of a section; None if the body holds the local level or a `target`, or spins.

    Parameters
    ----------
    parameters : PointingParameters
        The section.
    orbit : Trajectory
        Trajectory of the spacecraft.
    folder : Path
        Folder of relative file names.

    Raises
    ------
    InputError
        For several laws, or a file that cannot be used.
    """
    if len(parameters.laws) > 1:
        raise InputError(f"pointing: {' and '.join(parameters.laws)} both define the attitude; remove one of them")
    mounting = mounting_of(parameters)
    if parameters.law == "attitude":
        return attitude_from_file(parameters.attitude, orbit.clock, mounting.quat, folder, orbit)
    if parameters.law == "waypoints":
        return build_slews(parameters.waypoints, orbit.clock, mounting.quat)
    if parameters.law == "track":
        track = parameters.track
        other = build_trajectory(track.spacecraft, orbit.clock.epoch, folder) if track.target == "spacecraft" else None
        return build_tracking(track, orbit, other, mounting)
    return None


def attitude_from_file(
    section: AttitudeSource, clock: Clock, mounting: FloatArray, folder: Path, orbit: Trajectory | None = None
) -> AttitudeLaw:
    """Attitude law from the file of a section.

    The inverse of `mounting` (4,), body → camera, is applied to attitudes of the camera. Without the trajectory, a
    table relative to the local level can be read, but not evaluated.
    """
    if len(section.sources) > 1:
        given = " and ".join(section.sources)
        raise InputError(f"pointing.attitude: {given} both define the attitude; remove one of them")
    # Only an AEM can state whether its attitudes are those of the body or of the camera; other files have them of the
    # body unless the section says otherwise.
    kind = section.sources[0]
    path = folder / str(getattr(section, kind))
    if kind == "aem":
        return _from_aem(section, path, clock, mounting)
    camera = mounting if section.gives == "camera" else None
    if kind == "ck":
        if section.sclk is None:
            raise InputError(f"{path}: needs pointing.attitude.sclk, the kernel of the spacecraft's clock")
        return read_ck(path, folder / section.sclk, clock, section.object, camera)
    return read_attitude_table(path, clock, section.frame, section.interpolation, camera, orbit)


def _from_aem(section: AttitudeSource, path: Path, clock: Clock, mounting: FloatArray) -> TabulatedAttitude:
    wanted = None if section.object is None else str(section.object)
    segments, gives, frame = read_aem(path, clock, wanted)
    if section.gives != "auto":
        gives = section.gives
    if gives is None:
        raise InputError(f"{frame} is neither SC_BODY nor STARTRACKER; set pointing.attitude.gives to body or camera")
    return TabulatedAttitude.of(segments, clock, str(path), mounting if gives == "camera" else None)
