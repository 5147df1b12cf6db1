"""A display behind a collimator that shows the sky to a real star tracker: its model, calibration and pictures.

`patterns` draws what is photographed, `photographs` measures it, `geometry_fit` and `photometry_fit` make of it the
`geometry` and the `photometry` of the display, `calibration` holds both and their file, and `picture` uses them.
"""

from simulator.live.stimulator.calibration import (
    DisplayCalibration,
    align_display,
    calibrate_display,
    read_stimulator,
    stimulator_yaml,
)
from simulator.live.stimulator.geometry import DisplayGeometry, nominal_geometry
from simulator.live.stimulator.patterns import Pattern
from simulator.live.stimulator.photographs import Photograph
from simulator.live.stimulator.photometry import Curve, Photometry
from simulator.live.stimulator.photometry_fit import Exposures
from simulator.live.stimulator.picture import DisplayPicture, Stimulator, point_sources

__all__ = [
    "Curve",
    "DisplayCalibration",
    "DisplayGeometry",
    "DisplayPicture",
    "Exposures",
    "Pattern",
    "Photograph",
    "Photometry",
    "Stimulator",
    "align_display",
    "calibrate_display",
    "nominal_geometry",
    "point_sources",
    "read_stimulator",
    "stimulator_yaml",
]
