"""Rules of ``tracker.engine: flight``: methods, settings and cameras that the flight build does not support."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from simulator.scenario.document import show_value
from simulator.scenario.errors import Violation, impossible
from startracker.settings import AdaptiveSettings, CentroidSettings, DetectionSettings

_METHODS = {
    "tracker.detector": ("components",),
    "tracker.centroider": ("maximum_likelihood",),
    "tracker.identifier": ("adaptive", "triads"),
    "tracker.estimator": ("field_fit",),
}
"""Methods that the flight build has, the default first."""
_UNREAD: dict[str, tuple[Any, tuple[str, ...]]] = {
    "tracker.detection": (
        DetectionSettings(),
        ("min_pixels", "search_step_px", "matched_filter", "isolation", "cluster_radius_px", "threshold_dn"),
    ),
    "tracker.centroid": (CentroidSettings(), ("bias_correction", "psf_sigma_px", "psf")),
}
"""Settings that have no effect on the flight build: the section's defaults, and the names of these settings."""
_UNREAD_BY_IDENTIFIERS = ("max_centroids", "max_operations")
_WIDEST_DEG = 45.0
LARGEST = {
    "detector.width": 4096,
    "detector.height": 4096,
    "tracker.detection.max_stars": 120,
    "tracker.centroid.window_px": 11,
}
"""Limits of `startracker.flight`, which a scenario may not import; a test compares them."""
_LEAST_STARS = 3
_OR = "or tracker.engine: reference"


def contradictions(v: Mapping[str, Any]) -> Iterator[Violation]:
    """Violated rules of a scenario whose frames are solved by the flight build."""
    if v["tracker.engine"] != "flight":
        return
    # Every difference from what the flight build does is an error, so that a study never shows results of settings that
    # have not been used.
    for key, known in _METHODS.items():
        if v[key] not in known:
            yield impossible(key, f"the flight build has no '{v[key]}'; use {known[0]}, {_OR}")
    own = ("separation_tolerance_deg",) if v["tracker.identifier"] == "adaptive" else ()  # triads read it
    unread = _UNREAD | {"tracker.identification": (AdaptiveSettings(), (*_UNREAD_BY_IDENTIFIERS, *own))}
    for section, (defaults, names) in unread.items():
        for name in names:
            default = getattr(defaults, name)
            if v[f"{section}.{name}"] != default:
                shown = "null" if default is None else show_value(default)
                message = f"has no effect on the flight build; use {shown}, {_OR}"
                yield impossible(f"{section}.{name}", message)
    if v["tracker.identification.min_stars"] < _LEAST_STARS:
        message = f"the flight build needs {_LEAST_STARS} stars; use {_LEAST_STARS}, {_OR}"
        yield impossible("tracker.identification.min_stars", message)
    yield from _camera(v)
    for key in ("tracker.in_flight_calibration.use", "sequence.operation.use"):
        if v[key]:
            yield impossible(key, f"is not part of the flight build; use false, {_OR}")


def _camera(v: Mapping[str, Any]) -> Iterator[Violation]:
    """Properties of a camera that the flight build does not support."""
    if v["detector.shutter"] == "rolling":
        yield impossible("detector.shutter", f"the flight build has no rolling shutter; use global, {_OR}")
    if v["detector.adc_bits"] is None:
        yield impossible("detector.adc_bits", f"the flight build reads whole numbers; use 1 to 16 bits, {_OR}")
    for key, largest in LARGEST.items():
        if v[key] > largest:
            yield impossible(key, f"the flight build takes up to {largest}; use fewer, {_OR}")
    widest_deg = max(_half_field_deg(v, side, k) for k, side in enumerate(("width", "height")))
    if widest_deg >= _WIDEST_DEG:
        message = f"the camera sees {widest_deg:.1f}° from its axis along rows or columns, the flight build less than "
        yield impossible("optics.focal_length_mm", message + f"{_WIDEST_DEG:g}°; use a longer one, {_OR}")


def _half_field_deg(v: Mapping[str, Any], side: str, axis: int) -> float:
    """Angle between the optical axis and the farther border along an axis of the image, without distortion."""
    # The border is half a detector away from its middle, plus the offset of the principal point.
    pitch = v["detector.pixel_pitch_um"]
    pitch_um = pitch[axis] if isinstance(pitch, tuple) else pitch
    away_px = 0.5 * v[f"detector.{side}"] + abs(v["optics.principal_point_offset_px"][axis])
    ratio = away_px * pitch_um * 1e-3 / v["optics.focal_length_mm"]
    if v["optics.projection"] == "pinhole":
        return math.degrees(math.atan(ratio))
    if v["optics.projection"] == "equisolid":
        return math.degrees(2.0 * math.asin(min(0.5 * ratio, 1.0)))
    return math.degrees(ratio)
