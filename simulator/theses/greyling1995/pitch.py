"""The pitch angle from a pair of stars (Greyling 1995, section 5.3): eq. 5.13, Figs. 5.10 and 5.11, the 1.6° rule."""

from __future__ import annotations

from functools import partial

import numpy as np
from scipy.optimize import brentq

from simulator.randomness import stream
from simulator.theses.figures import section_of
from simulator.theses.printed import Section
from simulator.theses.tables import Values
from startracker.core import FloatArray
from startracker.estimation.two_directions import pitch_error_deg, star_pair

ACCURACY_DEG = 0.002
"""Centroid accuracy on each axis: 0.1 pixels of 10°/512."""

PIXEL_DEG, FIELD_DEG = 0.02, 10.0
SPECIFIED_DEG = 0.286


def least_separation_deg(
    pitch_deg: float = SPECIFIED_DEG, accuracy_deg: float = ACCURACY_DEG, direction_deg: float = 0.0
) -> float:
    """Minimum separation, degrees, for a pitch error by eq. 5.13, for pairs along a direction in the field.

    `accuracy_deg` is the centroid accuracy on each axis, `direction_deg` the direction of the pair from the x axis, 0
    to 90.
    """
    angle = np.radians(direction_deg)

    def excess(separation: float) -> float:
        x, y = separation * np.cos(angle), separation * np.sin(angle)
        return float(pitch_error_deg(x, y, accuracy_deg)) - pitch_deg

    return float(brentq(excess, 4.0 * accuracy_deg, 180.0, xtol=1e-12))


def measured_pitch_errors_deg(separation_deg: float, pairs: int = 200) -> FloatArray:
    """Errors (pairs,) about the boresight, degrees, of the attitude from one pair of stars by `star_pair`.

    Pairs are centred in the field, with random directions; each star has uniform errors up to ±`ACCURACY_DEG` on each
    axis.
    """
    rng = stream(1, "greyling1995 pitch", round(1e6 * separation_deg))
    errors = []
    for _ in range(pairs):
        angle = rng.uniform(0.0, np.pi)
        half = 0.5 * np.tan(np.radians(separation_deg)) * np.array([np.cos(angle), np.sin(angle)])
        true = np.stack([half, -half])
        seen = true + np.tan(np.radians(rng.uniform(-ACCURACY_DEG, ACCURACY_DEG, (2, 2))))
        turned = star_pair(_unit(seen), _unit(true), np.full(2, np.radians(ACCURACY_DEG))).matrix
        errors.append(np.degrees(np.arctan2(turned[1, 0] - turned[0, 1], turned[0, 0] + turned[1, 1])))
    return np.array(errors)


def _unit(plane: FloatArray) -> FloatArray:
    vectors = np.column_stack([plane, np.ones(len(plane))])
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def section(pairs: int = 200) -> Section:
    """Section 5.3: eq. 5.13 and the resulting rule, and Figs. 5.10 and 5.11; `pairs` random pairs per separation are
    solved by the tracker's estimator."""
    values = _values(pairs) | _pair() | {"curves": partial(_curves, pairs)}
    return section_of("greyling1995/pitch", "Chapter 5.3: pitch from a pair of stars", values)


def _values(pairs: int) -> Values:
    along, measured = least_separation_deg(), measured_pitch_errors_deg(least_separation_deg(), pairs)
    far, near = (float(pitch_error_deg(apart, apart, ACCURACY_DEG)) for apart in (FIELD_DEG, 3 * PIXEL_DEG))
    return {
        "far": far,
        "near": near,
        "diagonal_deg": np.hypot(FIELD_DEG, FIELD_DEG),
        "along": along,
        "diagonal": least_separation_deg(direction_deg=45.0),
        "half_range_deg": 0.5 * float(pitch_error_deg(along, 0.0, ACCURACY_DEG)),
        "any_direction_deg": least_separation_deg(2 * SPECIFIED_DEG, direction_deg=45.0),
        "largest_deg": np.abs(measured).max(),
        "rms_deg": np.sqrt(np.mean(measured**2)),
        "kept": np.abs(measured).max() <= SPECIFIED_DEG,
        "pairs": pairs,
    }


def _pair() -> Values:
    """Two stars and the squares that contain their centroids, with the steepest and the flattest line; not to scale."""
    stars, accuracy = np.array([[0.0, 0.0], [1.2, 0.8]]), 0.12
    shift = accuracy * np.array([1.0, -1.0])
    return {
        "stars": stars.T,
        "squares": [{"corner": tuple(star - accuracy)} for star in stars],
        "side": 2 * accuracy,
        "steepest": np.stack([stars[0] + shift, stars[1] - shift]).T,
        "flattest": np.stack([stars[0] - shift, stars[1] + shift]).T,
        "below": (0.0, -accuracy),
        "left": (-accuracy, 0.0),
    }


def _curves(pairs: int) -> Values:
    separation = np.geomspace(3 * PIXEL_DEG, FIELD_DEG, 200)
    angle = np.linspace(0.0, 0.5 * np.pi, 31)
    errors = pitch_error_deg(separation[:, None] * np.cos(angle), separation[:, None] * np.sin(angle), ACCURACY_DEG)
    some = np.geomspace(3 * PIXEL_DEG, FIELD_DEG, 12)
    tried = [np.abs(measured_pitch_errors_deg(value, pairs)) for value in some]
    return {
        "separation": separation,
        "accuracies": [
            {"accuracy": accuracy, "error": pitch_error_deg(separation, separation, accuracy)}
            for accuracy in (0.002, 0.001, 0.0005)
        ],
        "least": errors.min(axis=1),
        "most": errors.max(axis=1),
        "some": some,
        "largest": [t.max() for t in tried],
        "rms": [np.sqrt(np.mean(t**2)) for t in tried],
        "specified": SPECIFIED_DEG,
    }
