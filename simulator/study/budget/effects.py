"""Effects that an error budget switches off, and how, grouped by the classes of ECSS-E-ST-60-20C (Stars sensor
terminology and performance specification)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from simulator.build import build_orbit, detector_parameters
from simulator.detector.readout import gain_e_per_dn
from simulator.scenario import Scenario
from simulator.scenario.fields import flatten

Changes = dict[str, Any]

CLASSES = {
    "bias": "bias and thermo-elastic error",
    "fov_spatial": "field-of-view spatial error",
    "pixel_spatial": "pixel spatial error",
    "temporal": "temporal noise",
    "rate": "rate-dependent error",
}
"""Classes of ECSS-E-ST-60-20C, and errors that grow with the angular rate in one of their own."""


@dataclass(frozen=True)
class Effect:
    """One effect: its name, its class, and the keys of the scenario that switch it off (`off`, by dotted path)."""

    name: str
    kind: str
    off: Callable[[Scenario], Changes]


def _fixed(**changes: Any) -> Callable[[Scenario], Changes]:
    named = {path.replace("__", "."): value for path, value in changes.items()}
    return lambda scenario: named


def _no_converter(scenario: Scenario) -> Changes:
    return {"detector.adc_bits": None, "detector.gain_e_per_dn": gain_e_per_dn(detector_parameters(scenario.detector))}


def _even_gain(scenario: Scenario) -> Changes:
    return {"detector.intensifier.gain_variance": 0.0} if scenario.detector.intensifier.gain else {}


def _no_rate(scenario: Scenario) -> Changes:
    """Body rate that undoes the turning of the local level, 2π a period about −Y (`simulator.mission.pointing`),
    or a spin about +Z."""
    spin_deg_s = scenario.pointing.spin.rate_deg_s
    if spin_deg_s:
        return {"pointing.rate_deg_s": (0.0, 0.0, -spin_deg_s)}
    held = scenario.pointing.target is not None
    period_s = build_orbit(scenario).period_s
    return {"pointing.rate_deg_s": (0.0, 0.0 if held else 360.0 / period_s, 0.0)}


def _no_faint_stars(scenario: Scenario) -> Changes:
    return {"sky.magnitude_limit": min(scenario.sky.magnitude_limit, scenario.tracker.magnitude_limit)}


def _perfect_catalogue(scenario: Scenario) -> Changes:
    return {"sky.catalog": scenario.tracker.catalog}


EFFECTS: tuple[Effect, ...] = (
    Effect("shot noise", "temporal", _fixed(detector__shot_noise=False)),
    Effect("read noise", "temporal", _fixed(detector__read_noise_e=0.0, detector__reset_capacitance_ff=0.0)),
    Effect("gain of the intensifier", "temporal", _even_gain),
    Effect("video noise", "temporal", _fixed(detector__video__noise_dn=0.0)),
    Effect("quantisation", "temporal", _no_converter),
    Effect("cosmic rays", "temporal", _fixed(detector__cosmic_rays__rate_cm2_s=0.0)),
    Effect("sky background", "temporal", _fixed(sky__background=False)),
    Effect("stray light", "temporal", _fixed(optics__baffle__pst=None)),
    Effect("dark current", "temporal", _fixed(detector__dark_current_e_s=0.0, detector__intensifier__dark_e_s=0.0)),
    Effect("dark non-uniformity", "pixel_spatial", _fixed(detector__dsnu=0.0)),
    Effect(
        "hot and dead pixels",
        "pixel_spatial",
        _fixed(
            detector__hot_pixel_fraction=0.0,
            detector__hot_columns=0,
            detector__dead_pixel_fraction=0.0,
            detector__dead_columns=0,
        ),
    ),
    Effect("response non-uniformity", "pixel_spatial", _fixed(detector__prnu=0.0)),
    Effect("charge transfer", "pixel_spatial", _fixed(detector__cti_parallel=0.0, detector__cti_serial=0.0)),
    Effect("non-linearity", "pixel_spatial", _fixed(detector__nonlinearity=(0.0, 0.0))),
    Effect("faint neighbours", "fov_spatial", _no_faint_stars),
    Effect("catalogue errors", "fov_spatial", _perfect_catalogue),
    Effect(
        "field aberrations",
        "fov_spatial",
        _fixed(
            optics__psf__field__coma_waves=0.0,
            optics__psf__field__astigmatism_waves=0.0,
            optics__psf__field__curvature_waves=0.0,
        ),
    ),
    Effect("colour of the image", "fov_spatial", _fixed(optics__psf__polychromatic=False)),
    Effect("ghosts", "fov_spatial", _fixed(optics__ghosts=())),
    Effect("tether", "fov_spatial", _fixed(tether__diameter_mm=0.0)),
    Effect("planets and Moon", "fov_spatial", _fixed(sky__planets=False)),
    Effect("thermal focal length", "bias", _fixed(optics__thermal__expansion_ppm_k=0.0)),
    Effect("light deflection", "bias", _fixed(sky__light_deflection=False)),
    Effect("smear by rates", "rate", _no_rate),
    Effect("jitter", "rate", _fixed(pointing__jitter__rms_arcsec=(0.0, 0.0, 0.0))),
)
"""What can be switched off; the tracker stays as it is. The aberration of light, proper motion, parallax and the lens'
distortion are not among them: the tracker knows and corrects them exactly."""


def effective(scenario: Scenario, changes: Changes) -> Changes:
    """The changes themselves where they change what the scenario's camera sees or does; nothing otherwise."""
    now = flatten(scenario)
    return changes if any(now[path] != value for path, value in changes.items()) else {}


def changed(scenario: Scenario, changes: Changes) -> Scenario:
    """The scenario with keys, by dotted path, set to other values."""
    return scenario.changed(flatten(scenario) | changes)
