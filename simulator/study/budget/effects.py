"""Effects that an error budget switches off, grouped by the classes of ECSS-E-ST-60-20C (Stars sensor terminology and
performance specification)."""

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
"""Classes of ECSS-E-ST-60-20C, and a separate class for errors that grow with the angular rate."""


@dataclass(frozen=True)
class Effect:
    """One effect that can be switched off."""

    name: str
    kind: str
    """Class, a key of `CLASSES`."""
    keys: Changes | Callable[[Scenario], Changes]
    """Keys of the scenario by dotted path, with the values that switch the effect off."""

    def off(self, scenario: Scenario) -> Changes:
        """Changes of a scenario that switch the effect off; empty if the scenario does not have it."""
        changes = self.keys(scenario) if callable(self.keys) else self.keys
        now = flatten(scenario)
        return changes if any(now[path] != value for path, value in changes.items()) else {}


def _no_converter(scenario: Scenario) -> Changes:
    if scenario.tracker.engine == "flight":  # which reads whole numbers: the effect cannot be switched off
        return {}
    return {"detector.adc_bits": None, "detector.gain_e_per_dn": gain_e_per_dn(detector_parameters(scenario.detector))}


def _even_gain(scenario: Scenario) -> Changes:
    return {"detector.intensifier.gain_variance": 0.0} if scenario.detector.intensifier.gain else {}


def _no_particles(scenario: Scenario) -> Changes:
    if scenario.environment.has_particles:
        return {"environment.transients": False, "detector.cosmic_rays.rate_cm2_s": 0.0}
    return {"detector.cosmic_rays.rate_cm2_s": 0.0}


def _as_new(scenario: Scenario) -> Changes:
    changes: Changes = {"detector.displacement.interactions_per_pixel": 0.0, "detector.telegraph.pixel_fraction": 0.0}
    return changes | ({"environment.age_years": 0.0} if scenario.environment.has_damage else {})


def _no_rate(scenario: Scenario) -> Changes:
    """Body rate that cancels the rotation of the local level, 2π per period about −Y (`simulator.mission.pointing`), or
    a spin about +Z. An attitude law has no rate that could be cancelled: no change."""
    if scenario.pointing.law not in ("level", "target", "spin"):
        return {}
    spin_deg_s = scenario.pointing.spin.rate_deg_s
    if spin_deg_s:
        return {"pointing.rate_deg_s": (0.0, 0.0, -spin_deg_s)}
    held = scenario.pointing.target is not None
    period_s = build_orbit(scenario).period_s
    return {"pointing.rate_deg_s": (0.0, 0.0 if held else 360.0 / period_s, 0.0)}


def _no_faint_stars(scenario: Scenario) -> Changes:
    limit = min(scenario.sky.magnitude_limit, scenario.tracker.magnitude_limit)
    return {"sky.magnitude_limit": limit, "sky.faint_magnitude_limit": None}


def _perfect_catalogue(scenario: Scenario) -> Changes:
    return {
        "sky.catalog": scenario.tracker.catalog,
        "tracker.catalogue_errors.position_mas": 0.0,
        "tracker.catalogue_errors.proper_motion_mas_yr": 0.0,
    }


EFFECTS: tuple[Effect, ...] = (
    Effect("shot noise", "temporal", {"detector.shot_noise": False}),
    Effect("read noise", "temporal", {"detector.read_noise_e": 0.0, "detector.reset_capacitance_ff": 0.0}),
    Effect("gain of the intensifier", "temporal", _even_gain),
    Effect("video noise", "temporal", {"detector.video.noise_dn": 0.0}),
    Effect("quantisation", "temporal", _no_converter),
    Effect("cosmic rays", "temporal", _no_particles),
    Effect("sky background", "temporal", {"sky.background": False}),
    Effect("stray light", "temporal", {"optics.baffle.pst": None}),
    Effect("dark current", "temporal", {"detector.dark_current_e_s": 0.0, "detector.intensifier.dark_e_s": 0.0}),
    Effect("dark non-uniformity", "pixel_spatial", {"detector.dsnu": 0.0}),
    Effect(
        "hot and dead pixels",
        "pixel_spatial",
        {
            "detector.hot_pixel_fraction": 0.0,
            "detector.hot_columns": 0,
            "detector.dead_pixel_fraction": 0.0,
            "detector.dead_columns": 0,
        },
    ),
    Effect("radiation damage", "pixel_spatial", _as_new),
    Effect("response non-uniformity", "pixel_spatial", {"detector.prnu": 0.0}),
    Effect(
        "intra-pixel response",
        "pixel_spatial",
        {"detector.intra_pixel.contrast": 0.0, "detector.intra_pixel.centroid_curve_px": 0.0},
    ),
    Effect("charge transfer", "pixel_spatial", {"detector.cti_parallel": 0.0, "detector.cti_serial": 0.0}),
    Effect("non-linearity", "pixel_spatial", {"detector.nonlinearity": (0.0, 0.0)}),
    Effect("faint neighbours", "fov_spatial", _no_faint_stars),
    Effect("unresolved faint stars", "fov_spatial", {"sky.faint_magnitude_limit": None}),
    Effect("catalogue errors", "fov_spatial", _perfect_catalogue),
    Effect(
        "field aberrations",
        "fov_spatial",
        {
            "optics.psf.field.coma_waves": 0.0,
            "optics.psf.field.astigmatism_waves": 0.0,
            "optics.psf.field.curvature_waves": 0.0,
        },
    ),
    Effect("calibration residual", "fov_spatial", {"optics.calibration_residual.rms_px": 0.0}),
    Effect("lateral colour", "fov_spatial", {"optics.lateral_colour.corner_px": 0.0}),
    Effect("colour of the image", "fov_spatial", {"optics.psf.polychromatic": False}),
    Effect("ghosts", "fov_spatial", {"optics.ghosts": ()}),
    Effect("tether", "fov_spatial", {"tether.diameter_mm": 0.0}),
    Effect("planets and Moon", "fov_spatial", {"sky.planets": False}),
    Effect("thermal focal length", "bias", {"optics.thermal.expansion_ppm_k": 0.0}),
    Effect("decentring of the lens", "bias", {"optics.thermal.decentring_um_k": (0.0, 0.0)}),
    Effect("light deflection", "bias", {"sky.light_deflection": False}),
    Effect("smear by rates", "rate", _no_rate),
    Effect("time tag", "rate", {"detector.time_tag.offset_s": 0.0, "detector.time_tag.jitter_s": 0.0}),
    Effect("jitter", "rate", {"pointing.jitter.rms_arcsec": (0.0, 0.0, 0.0), "pointing.jitter.series": None}),
)
"""Effects that can be switched off; the tracker is not changed. Aberration, proper motion, parallax and lens distortion
are not included, because the tracker corrects them exactly."""
