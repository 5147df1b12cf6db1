"""Accuracy: the classes of error, the measurement error of the whole, and whether the classes add up to it."""

from __future__ import annotations

import math
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

from simulator.randomness import stream
from simulator.scenario import Scenario
from simulator.study.axes import CAMERA_AXES
from simulator.study.datasheet.classes import CLASSES, Separated, separate
from simulator.study.datasheet.scan import ScanGeometry, scan_geometry
from simulator.study.datasheet.sheet import LEVELS, Estimate, Quantity, rms_of, upper_limit
from simulator.study.datasheet.tasks import Task, TaskRunner
from simulator.study.datasheet.words import TERMS
from simulator.study.intervals import ratios_of_rms
from startracker.core import ARCSEC_PER_DEG, Columns, FloatArray

RESAMPLES = 400
"""Bootstrap samples of the percentiles of the temporal noise."""

_TAILS = (0.025, 0.975)


class Accuracy(NamedTuple):
    """Errors of a camera, arcseconds about its axes."""

    quantities: list[Quantity]
    """Values of the classes and of the whole."""
    separated: Separated
    """Classes with their spectra."""
    trials: Columns
    """Ordinary trials of the mission."""
    geometry: ScanGeometry
    """The scans."""


def measure_accuracy(scenario: Scenario, runner: TaskRunner, fields: int, trials: int) -> Accuracy:
    """Scan `fields` fields and run `trials` trials."""
    detector = scenario.detector
    geometry = scan_geometry(detector.width, detector.height)
    scans = runner.run([Task(scenario, "scan", (field, geometry)) for field in range(fields)])
    passes = np.stack([scan["error_deg"] for scan in scans], axis=1) * ARCSEC_PER_DEG
    same_field = np.stack([scan["same_field"] for scan in scans])
    found = separate(passes, geometry, scenario.seed, same_field)
    columns = runner.trials(scenario, trials)
    bound = np.stack([scan["noise_bound_deg"] for scan in scans]) * ARCSEC_PER_DEG
    quantities = [
        *_classes(found),
        *_noise_levels(found, scenario.seed),
        *_against_bound(passes, bound, scenario.seed),
        *_whole(columns, scenario.seed),
        *_sum_of_classes(found, columns, scenario.seed),
    ]
    return Accuracy(quantities, found, columns, geometry)


def normal_factor(level: float) -> float:
    """Ratio of a percentile of the magnitude to the rms of a normal error of zero mean."""
    return float(ndtri(0.5 + 0.005 * level))


def _classes(found: Separated) -> list[Quantity]:
    """Bias, and rms and percentiles of the spatial errors; rms of the noise."""
    quantities = []
    for name in CLASSES:
        term = TERMS[name]
        kind = "mean" if name == "bias" else "rms"
        for axis, size in zip(CAMERA_AXES, found.figures[name], strict=True):
            named = partial(Quantity, unit="arcsec", axis=axis, interpretation=term.interpretation)
            quantities.append(named(f"{name}_{kind}", f"{term.title}, {kind}", size, method=term.method))
            for level in LEVELS if name.endswith("spatial") else ():
                factor = normal_factor(level)
                method = f"{factor:.3f} × rms, for a normal distribution"
                quantities.append(named(name, term.title, size.times(factor), level=level, method=method))
    return quantities


def _noise_levels(found: Separated, seed: int) -> list[Quantity]:
    """Percentiles of the temporal noise: over all fields (mixed), and in the noisiest field (temporal)."""
    samples = np.abs(found.differences)
    fields, frames, axes = samples.shape
    drawn = stream(seed, "datasheet bootstrap").integers(0, fields, (RESAMPLES, fields))
    term, shares = TERMS["temporal_noise"], np.array(LEVELS) / 100.0
    mixed = f"percentile of {fields * frames} differences of passes, divided by √2; bootstrap over {fields} fields"
    temporal = f"as the mixed value, in the noisiest of {fields} fields; order statistics of {frames} frames"
    quantities = []
    for k, axis in enumerate(CAMERA_AXES[:axes]):
        # Frames of one field share their stars and are not independent, so that whole fields are resampled.
        ends = np.quantile(np.quantile(samples[drawn, :, k].reshape(RESAMPLES, -1), shares, axis=1), _TAILS, axis=1)
        values = np.quantile(samples[:, :, k], shares)
        worst = samples[int(np.argmax(found.field_powers["temporal_noise"][:, k])), :, k]
        for j, level in enumerate(LEVELS):
            named = partial(Quantity, unit="arcsec", axis=axis, level=level)
            size = Estimate(values[j], ends[0, j], ends[1, j])
            title = f"{term.title}, noisiest field"
            quantities += [
                named("temporal_noise", term.title, size, interpretation="mixed", method=mixed),
                named(
                    "temporal_noise_worst_field",
                    title,
                    upper_limit(worst, level),
                    interpretation="temporal",
                    method=temporal,
                ),
            ]
    return quantities


def _against_bound(passes: FloatArray, bound: FloatArray, seed: int) -> list[Quantity]:
    """Temporal noise over its Cramér–Rao bound, in the frames in which the bound was computed."""
    # Two passes over the same attitudes share all errors but the noise, of which their difference has √2 times as much.
    difference = (passes[0] - passes[1]) / math.sqrt(2.0)
    use = np.isfinite(bound).all(axis=2) & np.isfinite(difference).all(axis=2)
    if not use.any():
        return []
    ratio, ends = ratios_of_rms(difference[use], bound[use], seed)
    method = "noise of signal, background, dark current and electronics; the same stars"
    quantities = []
    for k, axis in enumerate(CAMERA_AXES):
        size = Estimate(ratio[k]) if ends is None else Estimate(ratio[k], *ends[k])
        bounds = rms_of(bound[use][:, k], seed)
        quantities += [
            Quantity("noise_bound_rms", "Cramér–Rao bound of the noise, rms", bounds, "arcsec", axis, method=method),
            Quantity("noise_over_bound", "Temporal noise / its bound", size, axis=axis, method=method),
        ]
    return quantities


def _whole(columns: Columns, seed: int) -> list[Quantity]:
    """Measurement error of the whole: rms and percentiles of the correct attitudes of the trials."""
    term, quantities = TERMS["measurement_error"], []
    for axis in CAMERA_AXES:
        errors = errors_arcsec(columns, axis)
        method = f"{len(errors)} trials; {term.method}"
        named = partial(Quantity, unit="arcsec", axis=axis, interpretation=term.interpretation, method=method)
        quantities.append(named("measurement_error_rms", f"{term.title}, rms", rms_of(errors, seed)))
        quantities += [
            named("measurement_error", term.title, upper_limit(errors, level), level=level) for level in LEVELS
        ]
    return quantities


def errors_arcsec(columns: Columns, axis: str) -> FloatArray:
    """Errors of the correct attitudes about an axis."""
    return np.asarray(columns[f"error_{axis}_deg"][columns["right"]] * ARCSEC_PER_DEG)


def _sum_of_classes(found: Separated, columns: Columns, seed: int) -> list[Quantity]:
    """Root of the sum of the squares of all classes, and over the measured rms.

    The sum is the rms of all frames of the scans, whose interval over the fields it has. The interval of the ratio
    combines the relative half widths of both in quadrature, as they are independent.
    """
    rule = "root of the sum of the squares of bias, FOV spatial, pixel spatial and temporal errors (rms)"
    powers = np.sum([found.field_powers[name].mean(axis=0) for name in CLASSES if name != "bias"], axis=0)
    quantities = []
    for k, axis in enumerate(CAMERA_AXES):
        bias, total = found.figures["bias"][k].value or 0.0, found.figures["total"][k]
        added = Estimate(math.sqrt(max(powers[k] + bias**2, 0.0)), total.low, total.high)
        whole = rms_of(errors_arcsec(columns, axis), seed)
        quantities += [
            Quantity("sum_of_classes", "Sum of the classes", added, "arcsec", axis, method=rule),
            Quantity(
                "sum_over_measured",
                "Sum of the classes / rms of the trials",
                _ratio(added, whole),
                axis=axis,
                method="the interval contains 1 if the classes add up to the measured error",
            ),
        ]
    return quantities


def _ratio(one: Estimate, other: Estimate) -> Estimate:
    """Ratio of independent estimates, with their relative half widths combined in quadrature."""
    if not one.value or not other.value or one.half_width is None or other.half_width is None:
        return Estimate(None)
    ratio = one.value / other.value
    half = ratio * math.hypot(one.half_width / one.value, other.half_width / other.value)
    return Estimate(ratio, ratio - half, ratio + half)
