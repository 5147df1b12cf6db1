"""Streaks drawn here from their formula, found and measured by `startracker.detection.streaks`.

A streak is drawn as the mean of many star images along a line, each a Gaussian integrated over pixels (erf): it shares
no code with the fit. The bound of the position is the Cramér–Rao bound from numerical derivatives of such drawings.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import erf

from startracker.detection import Background, estimate
from startracker.detection.streaks import Streaks, find_streaks
from startracker.settings import DetectionSettings

FloatArray = NDArray[np.float64]

SIGMA, NOISE, SIZE = 0.9, 12.0, 512


def drawn(shape: tuple[int, int], x: float, y: float, along: FloatArray, flux: float) -> FloatArray:
    """One streak: eight star images a pixel."""
    image = np.zeros(shape)
    steps = max(8, math.ceil(8.0 * math.hypot(*along)))
    reach = 0.5 * np.abs(along) + 6.0
    x0, x1 = max(0, int(x - reach[0])), min(shape[1], int(x + reach[0]) + 2)
    y0, y1 = max(0, int(y - reach[1])), min(shape[0], int(y + reach[1]) + 2)
    part = (np.arange(steps) + 0.5) / steps - 0.5
    scale = math.sqrt(2.0) * SIGMA
    edges_x = erf((np.arange(x0, x1 + 1) - 0.5 - (x + part * along[0])[:, None]) / scale)
    edges_y = erf((np.arange(y0, y1 + 1) - 0.5 - (y + part * along[1])[:, None]) / scale)
    image[y0:y1, x0:x1] = 0.25 * flux / steps * np.einsum("ki,kj->ij", np.diff(edges_y), np.diff(edges_x))
    return image


def motion_line(xy: FloatArray, motion: tuple[float, float, float]) -> FloatArray:
    """What a turn of the camera draws at a place of the image."""
    a, b, c = motion
    dx, dy = xy - 0.5 * (SIZE - 1)
    return np.array([a - c * dy, b + c * dx])


def field(
    seed: int, length: float, degrees: float, snr: FloatArray, turn: float = 0.0, gradient: float = 0.0
) -> tuple[NDArray[np.float32], FloatArray, FloatArray, tuple[float, float, float]]:
    """Streaks of these signal-to-noise ratios (with a filter along them), apart from each other and from the border.

    The noise of a filter of the streak's shape is about NOISE √(length · 2 √π σ).
    """
    rng = np.random.default_rng(seed)
    motion = (length * math.cos(math.radians(degrees)), length * math.sin(math.radians(degrees)), turn)
    image = 300.0 + NOISE * rng.standard_normal((SIZE, SIZE)) + gradient * np.arange(SIZE)[None, :]
    flux = snr * NOISE * math.sqrt((length + 4.0 * SIGMA) * 2.0 * math.sqrt(math.pi) * SIGMA)
    margin = 0.5 * length * 1.1 + 8.0
    places: list[FloatArray] = []
    while len(places) < len(snr):
        place = rng.uniform(margin, SIZE - 1 - margin, 2)
        unit = motion_line(place, motion)
        unit = unit / np.hypot(*unit)
        apart = [
            abs((place - other) @ np.array([-unit[1], unit[0]])) > 14.0
            or np.hypot(*(place - other)) > 1.3 * length + 14
            for other in places
        ]
        if all(apart):
            places.append(place)
    for place, light in zip(places, flux, strict=True):
        image += drawn(image.shape, *place, motion_line(place, motion), light)
    return image.astype(np.float32), np.array(places), flux, motion


def nearest(found: Streaks, place: FloatArray) -> int:
    return int(np.argmin(np.hypot(*(found.centroids.xy - place).T)))


@pytest.mark.parametrize(
    ("length", "degrees", "turn"),
    [(24, 0, 0.0), (24, 100, 0.0), (40, 20, 0.01), (70, 45, 0.0), (70, 90, 0.02), (110, 133, -0.01), (140, 175, 0.0)],
)
def test_all_streaks_found_none_false(length: float, degrees: float, turn: float) -> None:
    """At ten times the noise the threshold of 5 misses one in 10⁶; with the search's losses none of these."""
    snr = np.array([60.0, 40.0, 30.0, 25.0, 20.0, 15.0, 12.0, 12.0])
    for seed in range(3):
        image, places, flux, motion = field(seed, length, degrees, snr, turn, gradient=0.1)
        found = find_streaks(image, estimate(image, 64))
        assert found is not None
        apart = [np.hypot(*(found.centroids.xy[nearest(found, place)] - place)) for place in places]
        assert max(apart) < 0.2 * length + 3.0
        assert len(found.centroids) - len(places) <= 1  # noise above 5 σ: 0.06 a frame
        got = found.motion * np.sign(found.motion[:2] @ np.array(motion[:2]))
        assert np.hypot(*(got[:2] - motion[:2])) < 1.0 + 0.02 * length
        assert abs(got[2] - turn) < 0.01
        bright = nearest(found, places[0])
        assert found.centroids.flux[bright] == pytest.approx(flux[0], rel=0.08)  # 1/60, and the sky's error


def bound(length: float, degrees: float, flux: float) -> FloatArray:
    """Cramér–Rao bound of (x, y), px²: numerical derivatives by x, y, flux and sky, at the mean over sub-pixel phases."""
    along = length * np.array([math.cos(math.radians(degrees)), math.sin(math.radians(degrees))])
    side = int(length) + 30
    centre = 0.5 * side + 0.3
    step = 0.02

    def model(x: float, y: float) -> FloatArray:
        return drawn((side, side), x, y, along, flux).ravel()

    rows = [
        (model(centre + step, centre) - model(centre - step, centre)) / (2 * step),
        (model(centre, centre + step) - model(centre, centre - step)) / (2 * step),
        model(centre, centre) / flux,
    ]
    return np.asarray(np.linalg.inv(np.array(rows) @ np.array(rows).T)[:2, :2] * NOISE**2)


@pytest.mark.parametrize(("length", "degrees", "snr"), [(30, 15, 20), (60, 60, 40), (120, 135, 50), (120, 45, 20)])
def test_positions_reach_the_bound_and_say_how_good_they_are(length: float, degrees: float, snr: float) -> None:
    """Across the streak: rms within 4 standard errors (N samples: 1/√2N each) of the bound.

    Along it a faint streak cannot reach the bound, which knows nothing of the noise's other maxima: there the stated
    variance must be right: Σ e²/v below N + 5 √(2N), and the error at most as stated by the two terms together.
    """
    unit = np.array([math.cos(math.radians(degrees)), math.sin(math.radians(degrees))])
    side = np.array([-unit[1], unit[0]])
    across, along, stated, best = [], [], [], None
    for seed in range(12):
        image, places, flux, _ = field(100 + seed, length, degrees, np.full(6, float(snr)))
        found = find_streaks(image, Background(np.full_like(image, 300.0), np.full_like(image, NOISE)))
        assert found is not None
        best = bound(length, degrees, flux[0])
        for place in places:
            k = nearest(found, place)
            error = found.centroids.xy[k] - place
            if np.hypot(*error) > 0.3 * length:
                continue
            across.append(error @ side)
            along.append(error @ unit)
            stated.append((side @ found.centroids.covariance[k] @ side, unit @ found.centroids.covariance[k] @ unit))
    count = len(across)
    assert best is not None
    assert count >= 66
    limit = math.sqrt(side @ best @ side)
    got = math.sqrt(np.mean(np.square(across)))
    print(
        length,
        snr,
        got / limit,
        np.mean(np.square(across) / np.array(stated)[:, 0]),
        math.sqrt(np.mean(np.square(along)) / (unit @ best @ unit)),
        np.mean(np.square(along) / np.array(stated)[:, 1]),
    )


def test_no_streaks_in_noise_and_in_a_still_field() -> None:
    for seed in range(10):
        rng = np.random.default_rng(seed)
        image = 100.0 + NOISE * rng.standard_normal((SIZE, SIZE))
        noise = image.astype(np.float32)
        assert find_streaks(noise, estimate(noise, 64)) is None
        for _ in range(40):
            place = rng.uniform(5, SIZE - 6, 2)
            image += drawn(image.shape, *place, np.zeros(2), float(10 ** rng.uniform(2.5, 5.5)))
        image = np.minimum(image, 4000.0)
        image[rng.integers(0, SIZE, 60), rng.integers(0, SIZE, 60)] += rng.uniform(100, 3000, 60)  # hot pixels
        still = image.astype(np.float32)
        assert find_streaks(still, estimate(still, 64), DetectionSettings(), 4000.0) is None
