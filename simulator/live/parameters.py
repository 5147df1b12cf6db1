"""What a client may change in a live mission: the sliders, with their ranges about the scenario's values."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from typing import Any, NamedTuple

from simulator.detector.readout import gain_e_per_dn
from simulator.live.answers import Parameter
from simulator.live.protocol import Refused
from simulator.renderer import Renderer

__all__ = ["RATE_PATHS", "ParameterTable"]

RATE_PATHS = tuple(f"pointing.rate_deg_s.{axis}" for axis in ("roll", "pitch", "yaw"))
"""Rates of the body relative to its reference, which belong to the motion and not to the scenario."""
_FASTEST_DEG_S = 10.0


class _Range(NamedTuple):
    """Range of a parameter."""

    minimum: float
    maximum: float
    logarithmic: bool = False


class _Row(NamedTuple):
    """A parameter of the scenario."""

    path: str
    label: str
    group: str
    unit: str
    value: Callable[[Renderer], float]
    span: Callable[[Renderer], _Range]


def _about(value: float, factor: float, least: float = 0.0, most: float = math.inf) -> _Range:
    return _Range(max(value / factor, least), min(value * factor, most), True)


def _aperture_range(renderer: Renderer) -> _Range:
    """From f/22 to f/0.8."""
    focal_length_mm = renderer.scenario.optics.focal_length_mm
    return _Range(focal_length_mm / 22.0, focal_length_mm / 0.8, True)


_ROWS: tuple[_Row, ...] = (
    _Row("detector.exposure_s", "Exposure", "camera", "s",
         lambda r: r.exposure_s, lambda r: _about(r.exposure_s, 100.0, 1e-5, 60.0)),
    _Row("optics.aperture_mm", "Aperture", "camera", "mm", lambda r: r.scenario.optics.aperture_mm, _aperture_range),
    _Row("detector.gain_e_per_dn", "Gain", "detector", "e⁻/DN",
         lambda r: float(gain_e_per_dn(r.detector.parameters)),
         lambda r: _about(float(gain_e_per_dn(r.detector.parameters)), 30.0)),
    _Row("detector.temperature_c", "Temperature", "detector", "°C",
         lambda r: r.scenario.detector.temperature_c, lambda r: _Range(-60.0, 80.0)),
    _Row("detector.read_noise_e", "Read noise", "detector", "e⁻",
         lambda r: r.scenario.detector.read_noise_e, lambda r: _Range(0.0, 200.0)),
    _Row("detector.hot_pixel_fraction", "Hot pixels", "detector", "",
         lambda r: r.scenario.detector.hot_pixel_fraction, lambda r: _Range(0.0, 0.01)),
    _Row("environment.age_years", "Age in orbit", "age", "years",
         lambda r: r.scenario.environment.age_years, lambda r: _Range(0.0, 20.0)),
)  # fmt: skip
_HOT_DARK_E_S = 5000.0
"""Mean dark current of hot pixels where the scenario has none, as in the included scenario cubesat."""


class ParameterTable:
    """Parameters of one mission; ranges are those about the values at its start.

    Parameters
    ----------
    renderer : Renderer
        Renderer of the scenario.
    """

    def __init__(self, renderer: Renderer) -> None:
        environment = renderer.scenario.environment
        ages = find_spec("aep8") is not None or (environment.trapped == "none" and environment.solar_proton_events > 0)
        rows = [row for row in _ROWS if ages or row.group != "age"]
        if renderer.scenario.sequence.operation.use:  # the rules set the exposure
            rows = [row for row in rows if row.path != "detector.exposure_s"]
        self._rows = {row.path: row for row in rows}
        self._ranges = {row.path: self._range_with_value(row, renderer) for row in rows}
        fastest = max(_FASTEST_DEG_S, 2.0 * max(map(abs, renderer.scenario.pointing.rate_deg_s)))
        self._ranges |= {path: _Range(-fastest, fastest) for path in RATE_PATHS}

    @staticmethod
    def _range_with_value(row: _Row, renderer: Renderer) -> _Range:
        """The range, extended to contain the present value."""
        span, value = row.span(renderer), row.value(renderer)
        return span._replace(minimum=min(span.minimum, value), maximum=max(span.maximum, value))

    def values(self, renderer: Renderer, rates_deg_s: tuple[float, ...]) -> dict[str, float]:
        """Present values by path."""
        values = {path: row.value(renderer) for path, row in self._rows.items()}
        return values | dict(zip(RATE_PATHS, rates_deg_s, strict=True))

    def described(self, renderer: Renderer, rates_deg_s: tuple[float, ...]) -> list[Parameter]:
        """All parameters with their ranges and present values."""
        listed = []
        for path, value in self.values(renderer, rates_deg_s).items():
            row = self._rows.get(path)
            axis = path.rpartition(".")[2]
            label, group, unit = row[1:4] if row else (f"Rate {axis}", "motion", "°/s")
            span = self._ranges[path]
            listed.append(Parameter(path=path, label=label, group=group, unit=unit, value=value, **span._asdict()))
        return listed

    def check(self, path: str, value: float) -> None:
        """`Refused` for an unknown path, or a value outside its range."""
        if path not in self._ranges:
            raise Refused("invalid", f"path: '{path[:60]}' is not a parameter of this mission; see welcome.parameters")
        span = self._ranges[path]
        if not span.minimum <= value <= span.maximum:
            raise Refused("invalid", f"{path}: {value:g} is outside {span.minimum:g} to {span.maximum:g}")

    @staticmethod
    def changes(renderer: Renderer, values: Mapping[str, float]) -> dict[str, Any]:
        """Keys of the scenario that realise new values of its parameters."""
        changed: dict[str, Any] = dict(values)
        scenario = renderer.scenario
        if values.get("detector.hot_pixel_fraction") and not scenario.detector.hot_pixel_dark_e_s:
            changed["detector.hot_pixel_dark_e_s"] = _HOT_DARK_E_S
        environment = scenario.environment
        if values.get("environment.age_years") and not (
            environment.trapped != "none" or environment.solar_proton_events
        ):
            changed |= {"environment.trapped": "ap8"}
            if not environment.has_particles:  # it has aged, but frames have no more events than before
                changed["environment.transients"] = False
        return changed
