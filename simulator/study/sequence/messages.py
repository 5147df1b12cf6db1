"""Trajectory and attitudes of a sequence for other programs: messages of CCSDS, kernels of SPICE, columns."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.build import build_orbit
from simulator.mission.mean_elements import MeanElementsOrbit
from simulator.mission.messages import Header, acm_text, aem_text, oem_text
from simulator.mission.spice import Attitudes, spice_kernels
from simulator.mission.tabulated import TabulatedTrajectory
from simulator.mission.trajectory import geocentric
from simulator.scenario import Scenario
from simulator.study.axes import CAMERA_AXES
from startracker.core import FloatArray

_QUATERNION = ("qx", "qy", "qz", "qw")


def sequence_messages(scenario: Scenario, columns: Mapping[str, NDArray[Any]], created: str) -> dict[str, str]:
    """Files by name: ``trajectory.oem`` and ``true.aem``, the truth at the frames; ``estimated.aem``, the attitudes of
    the tracker where it has one, and ``estimated.acm``, the same with their variances.

    Parameters
    ----------
    scenario : Scenario
        The scenario of the sequence.
    columns : mapping
        Columns of ``sequence.parquet``.
    created : str
        Date and time of the files, UTC.
    """
    orbit, t_s = build_orbit(scenario), np.asarray(columns["t_s"], dtype=float)
    true, estimated = _quaternions(columns)
    sigma_deg = np.stack([columns[f"sigma_{axis}_deg"] for axis in CAMERA_AXES], axis=1)

    def header(comment: str) -> Header:
        object_id = orbit.object_id if isinstance(orbit, MeanElementsOrbit | TabulatedTrajectory) else ""
        return Header(scenario.name, created.removesuffix("+00:00"), comment, object_id)

    files = {"true.aem": aem_text(orbit.clock, t_s, true, header("true attitude at mid-exposure"))}
    if len(t_s) > 1:
        files["trajectory.oem"] = oem_text(orbit, t_s, header("true trajectory at mid-exposure"))
    known = np.isfinite(estimated).all(axis=1) & np.isfinite(sigma_deg).all(axis=1)
    if known.any():
        rows = t_s[known], estimated[known]
        files["estimated.aem"] = aem_text(orbit.clock, *rows, header("attitude by the star tracker"))
        files["estimated.acm"] = acm_text(
            orbit.clock, *rows, sigma_deg[known] ** 2, header("attitude by the star tracker, with its variances")
        )
    return files


def sequence_kernels(scenario: Scenario, columns: Mapping[str, NDArray[Any]]) -> dict[str, bytes]:
    """Files by name: ``trajectory.bsp``, ``true.bc`` and ``estimated.bc``, and the kernels of the clock and the frame
    (`simulator.mission.spice`).

    Raises
    ------
    InputError
        If SpiceyPy is not installed.
    """
    orbit, t_s = build_orbit(scenario), np.asarray(columns["t_s"], dtype=float)
    true, estimated = _quaternions(columns)
    known = np.isfinite(estimated).all(axis=1)
    attitudes = {"true.bc": Attitudes(t_s, true)}
    if known.any():
        attitudes["estimated.bc"] = Attitudes(t_s[known], estimated[known])
    return spice_kernels(orbit, t_s, attitudes)


def state_columns(scenario: Scenario, t_s: FloatArray) -> dict[str, FloatArray]:
    """True geocentric positions, km, and velocities, km/s, in ICRF axes at times (N,) as columns (N,)."""
    states = np.concatenate(geocentric(build_orbit(scenario), np.asarray(t_s, dtype=float)), axis=1)
    return dict(zip(("x_km", "y_km", "z_km", "vx_km_s", "vy_km_s", "vz_km_s"), states.T, strict=True))


def _quaternions(columns: Mapping[str, NDArray[Any]]) -> tuple[FloatArray, FloatArray]:
    """True and estimated quaternions (N, 4), scalar last."""
    true, estimated = (
        np.stack([columns[f"{prefix}{name}"] for name in _QUATERNION], axis=1) for prefix in ("true_", "")
    )
    return true, estimated
