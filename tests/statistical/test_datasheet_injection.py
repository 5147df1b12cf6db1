"""Classes of a datasheet on rendered frames: one cause of errors alone is found in its own class.

Each scenario has a single cause. The rms of all frames is then the injected error, and the class must contain it within
its interval; the others are limited by the statistics of cross-spectra (`FIELDS` fields of 45 frames).
"""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from simulator import Scenario
from simulator.study.datasheet.classes import Separated, separate
from simulator.study.datasheet.dependence import residuals
from simulator.study.datasheet.frames import DatasheetFrames
from simulator.study.datasheet.scan import scan_geometry
from simulator.study.datasheet.sheet import QUICK
from simulator.study.datasheet.tasks import TaskRunner

FIELDS = 24
QUIET: dict[str, Any] = {
    "detector.width": 384,
    "detector.height": 384,
    "optics.focal_length_mm": 12.5,
    "optics.aperture_mm": 12.5,
    "detector.shot_noise": False,
    "detector.read_noise_e": 0.0,
    "detector.adc_bits": None,
    "detector.gain_e_per_dn": 1.0,
    "detector.prnu": 0.0,
    "detector.dsnu": 0.0,
    "detector.hot_pixel_fraction": 0.0,
    "detector.dark_current_e_s": 0.0,
    "sky.background": False,
    "sky.magnitude_limit": 6.0,
    "sky.light_deflection": False,
    "tracker.magnitude_limit": 6.0,
    "environment.trapped": "none",
    "optics.calibration_residual.rms_px": 0.0,
    "optics.lateral_colour.corner_px": 0.0,
    "optics.thermal.expansion_ppm_k": 0.0,
    "optics.thermal.decentring_um_k": (0.0, 0.0),
}
GEOMETRY = scan_geometry(384, 384)


@functools.lru_cache(maxsize=3)
def scanned(**changes: Any) -> tuple[Separated, np.ndarray]:
    """Classes in arcseconds, and the Cramér–Rao bound of the noise, arcseconds (frames, 3)."""
    values = QUIET | {name.replace("__", "."): value for name, value in changes.items()}
    frames = DatasheetFrames(Scenario.load("scenarios/cubesat_ideal.yaml").changed(values))
    scans = [frames.scan(field, GEOMETRY) for field in range(FIELDS)]
    passes = np.stack([scan["error_deg"] for scan in scans], axis=1) * 3600.0
    bound = np.concatenate([scan["noise_bound_deg"] for scan in scans]) * 3600.0
    same_field = np.stack([scan["same_field"] for scan in scans])
    return separate(passes, GEOMETRY, same_field=same_field), bound[np.isfinite(bound).all(axis=1)]


def leaks(found: Separated, name: str, axis: int) -> dict[str, float]:
    """Rms of every other class over the total, without what the camera has with no cause of errors at all."""
    total, quiet = found.figures["total"][axis].value, scanned()[0]
    assert total
    others = {"bias", "fov_spatial", "pixel_spatial", "temporal_noise"} - {name}
    powers = {
        other: (found.figures[other][axis].value or 0.0) ** 2 - (quiet.figures[other][axis].value or 0.0) ** 2
        for other in others
    }
    return {other: math.sqrt(max(power, 0.0)) / total for other, power in powers.items()}


def contains_total(found: Separated, name: str, axis: int) -> None:
    total, figure = found.figures["total"][axis].value, found.figures[name][axis]
    assert figure.low is not None
    assert figure.high is not None
    assert total is not None
    assert figure.low <= total <= figure.high


@pytest.mark.slow
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_noise_alone(axis: int) -> None:
    """Within 5 % of the Cramér–Rao bound. The standard deviation of the ratio is 1/√(2 · 24 · 45) = 2.2 %: 5 % and two
    of these."""
    found, bound = scanned(detector__shot_noise=True, detector__read_noise_e=13.0)
    contains_total(found, "temporal_noise", axis)
    noise = found.figures["temporal_noise"][axis].value
    assert noise == pytest.approx(math.sqrt(np.mean(bound[:, axis] ** 2)), rel=0.05 + 0.044)
    for other in ("fov_spatial", "pixel_spatial"):
        low = found.figures[other][axis].low
        assert low is not None
        assert low < 0.1 * (noise or 0.0)
        # the power of cross-spectra of M frames scatters by about 1.5/√M of that of the noise
        assert leaks(found, "temporal_noise", axis)[other] ** 2 < 3.0 * 1.5 / math.sqrt(FIELDS * GEOMETRY.frames)


@pytest.mark.slow
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_uneven_pixels_alone(axis: int) -> None:
    found, _ = scanned(detector__prnu=0.1)
    contains_total(found, "pixel_spatial", axis)
    leak = leaks(found, "pixel_spatial", axis)
    assert leak["temporal_noise"] < 0.01
    assert leak["bias"] < 0.1
    # the covariance of two independent random functions with some 45 independent values a field: of fields of different
    # power, as few stars fix the roll of some, those of the highest power have the largest part in it
    power = found.field_powers["total"][:, axis]
    equal_fields = power.sum() ** 2 / np.square(power).sum()
    assert equal_fields > 0.25 * FIELDS
    assert leak["fov_spatial"] ** 2 < 3.0 / math.sqrt(GEOMETRY.frames * equal_fields)


@pytest.mark.slow
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_interpolation_error_alone(axis: int) -> None:
    """The measured curve of a pixel, A sin 2πx on each axis: it has the period of a pixel, and is the same behind other
    pixels."""
    found, _ = scanned(detector__intra_pixel__centroid_curve_px=0.1)
    contains_total(found, "pixel_spatial", axis)
    leak = leaks(found, "pixel_spatial", axis)
    assert leak["temporal_noise"] < 0.01
    assert leak["bias"] < 0.1
    assert leak["fov_spatial"] < 0.1


FIELD_ERRORS: dict[str, dict[str, Any]] = {
    "calibration residual": {"optics__calibration_residual__rms_px": 0.5},
    "lateral colour": {"optics__lateral_colour__corner_px": 3.0},
    "catalogue": {"tracker__catalogue_errors__position_mas": 3000.0},
}
"""Errors that are smooth over the field, or those of stars."""


@pytest.mark.slow
@pytest.mark.parametrize("cause", FIELD_ERRORS)
def test_errors_of_the_field_alone(cause: str) -> None:
    found, _ = scanned(**FIELD_ERRORS[cause])
    for axis in range(3):
        contains_total(found, "fov_spatial", axis)
        leak = leaks(found, "fov_spatial", axis)
        assert leak["temporal_noise"] < 0.01
        assert leak["pixel_spatial"] < 0.1
        # the mean over the fields of a random error of each field
        assert leak["bias"] < 3.0 / math.sqrt(FIELDS)


@pytest.mark.slow
def test_decentring_alone_is_thermo_elastic_bias() -> None:
    """A shift of the lens by s turns the boresight by s / f: 0.5 µm/K × 10 K over 12.5 mm is 82.5″ about y."""
    found, _ = scanned(optics__thermal__decentring_um_k=(0.5, 0.0), optics__thermal__temperature_c=30.0)
    expected = math.degrees(math.atan(5.0 / 12_500.0)) * 3600.0
    assert abs(found.figures["bias"][1].value or 0.0) == pytest.approx(expected, rel=0.01)
    for other in ("fov_spatial", "pixel_spatial", "temporal_noise"):
        assert leaks(found, "bias", 1)[other] < 0.1


def test_decentring_is_thermo_elastic() -> None:
    """The same closed form, for a step of 10 K: 5 µm over 12.5 mm. Stars move by 0.9 pixels, which
    changes the interpolation error of the centroids, without noise below 0.01 pixels or 0.9″, by a different amount
    for each of some 12 stars and 8 fields: 0.1″, and five times this."""
    values = QUIET | {"optics.thermal.decentring_um_k": (0.5, 0.0)}
    scenario = Scenario.load("scenarios/cubesat_ideal.yaml").changed(values)
    found = residuals(scenario, TaskRunner(), replace(QUICK, per_point=8))
    named = {(q.name, q.axis): q.estimate.value for q in found}
    assert abs(named["thermo_elastic_mean", "cross_y"] or 0.0) == pytest.approx(82.5, abs=0.5)
    assert abs(named["thermo_elastic_mean", "cross_x"] or 0.0) < 0.5


def test_time_tag_is_a_rate_error() -> None:
    """An error of the time by dt turns a camera at the rate ω by ω dt: 0.5°/s and 1 ms are 1.8″ about its axis. Trailed
    images without noise are measured to 0.01 pixels or 0.9″ each, some 12 a frame, and 8 frames: 0.1″; three times
    this for the mean."""
    scenario = Scenario.load("scenarios/cubesat_ideal.yaml").changed(QUIET | {"detector.time_tag.offset_s": 1e-3})
    made = DatasheetFrames(scenario).at_rate(0, 8, 0.5)
    assert made["right"].all()
    assert abs(float(np.mean(made["along_deg"]))) * 3600.0 == pytest.approx(1.8, abs=0.3)
    assert abs(float(np.mean(made["across_deg"]))) * 3600.0 < 0.3
