"""Star tracker: attitudes from images of the night sky. It does not need the simulator.

Names are loaded on first use, which keeps the import fast.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from startracker._version import __version__

if TYPE_CHECKING:
    from startracker.blind import solve_unknown_fov
    from startracker.calibration import Calibration, InFlightCalibration, StarField, calibrate
    from startracker.catalog import load_catalog
    from startracker.catalog.stars import StarCatalog
    from startracker.errors import BoresightError, InputError
    from startracker.geometry.attitude import Attitude
    from startracker.geometry.camera import Camera
    from startracker.geometry.distortion import Distortion
    from startracker.images.reading import LoadedImage, read_image, sample_photo
    from startracker.observer import Observer
    from startracker.settings import (
        AdaptiveSettings,
        CentroidSettings,
        DetectionSettings,
        IdentificationSettings,
        InFlightSettings,
        MatchGroupSettings,
        PatternHashSettings,
        PyramidSettings,
        TrackingSettings,
        TriadSettings,
    )
    from startracker.solution import MatchedStars, Solution, Status
    from startracker.trace import Step
    from startracker.tracker import StarTracker
    from startracker.tracking import CalibratedSession, GyroNoise, Mekf, RateNoise, TrackingSession, TrackingState
    from startracker.wcs import wcs_header


__all__ = [
    "AdaptiveSettings",
    "Attitude",
    "BoresightError",
    "CalibratedSession",
    "Calibration",
    "Camera",
    "CentroidSettings",
    "DetectionSettings",
    "Distortion",
    "GyroNoise",
    "IdentificationSettings",
    "InFlightCalibration",
    "InFlightSettings",
    "InputError",
    "LoadedImage",
    "MatchGroupSettings",
    "MatchedStars",
    "Mekf",
    "Observer",
    "PatternHashSettings",
    "PyramidSettings",
    "RateNoise",
    "Solution",
    "StarCatalog",
    "StarField",
    "StarTracker",
    "Status",
    "Step",
    "TrackingSession",
    "TrackingSettings",
    "TrackingState",
    "TriadSettings",
    "__version__",
    "calibrate",
    "load_catalog",
    "read_image",
    "sample_photo",
    "solve_unknown_fov",
    "wcs_header",
]

_HOME = {
    "Attitude": "geometry.attitude",
    "BoresightError": "errors",
    "CalibratedSession": "tracking",
    "Calibration": "calibration",
    "Camera": "geometry.camera",
    "CentroidSettings": "settings",
    "DetectionSettings": "settings",
    "Distortion": "geometry.distortion",
    "GyroNoise": "tracking",
    "IdentificationSettings": "settings",
    "InFlightCalibration": "calibration",
    "InFlightSettings": "settings",
    "AdaptiveSettings": "settings",
    "MatchGroupSettings": "settings",
    "PatternHashSettings": "settings",
    "PyramidSettings": "settings",
    "TriadSettings": "settings",
    "InputError": "errors",
    "LoadedImage": "images.reading",
    "MatchedStars": "solution",
    "Mekf": "tracking",
    "Observer": "observer",
    "RateNoise": "tracking",
    "Solution": "solution",
    "StarCatalog": "catalog.stars",
    "StarField": "calibration",
    "StarTracker": "tracker",
    "Status": "solution",
    "Step": "trace",
    "TrackingSession": "tracking",
    "TrackingSettings": "settings",
    "TrackingState": "tracking",
    "calibrate": "calibration",
    "load_catalog": "catalog",
    "read_image": "images.reading",
    "sample_photo": "images.reading",
    "solve_unknown_fov": "blind",
    "wcs_header": "wcs",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'startracker' has no attribute '{name}'")
    from importlib import import_module

    return getattr(import_module(f"startracker.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
