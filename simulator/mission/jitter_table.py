"""Jitter as a time series, from a table in CSV or Parquet."""

from __future__ import annotations

from pathlib import Path

from simulator.mission.clock import Clock
from simulator.mission.tables import read_rows
from simulator.optics.jitter import Jitter
from simulator.optics.jitter_series import JitterSeries
from startracker.core import ARCSEC_RAD

COLUMNS = ("x_arcsec", "y_arcsec", "z_arcsec")


def read_jitter(parameters: Jitter, clock: Clock, folder: Path = Path()) -> JitterSeries | None:
    """Time series of ``pointing.jitter``; None if the section has no file.

    Raises
    ------
    InputError
        With file and line, as for `simulator.mission.tables.read_rows`.
    """
    if parameters.series is None:
        return None
    path = folder / parameters.series
    t_s, angles_arcsec, _ = read_rows(path, clock, COLUMNS)
    return JitterSeries(t_s, angles_arcsec * ARCSEC_RAD, str(path))
