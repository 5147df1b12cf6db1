"""Fields for the unit tests of an exported flight build: lists of stars, and frames that a few numbers describe.

A frame is an even background with noise from a linear congruential generator of its own for each row, and stars
whose images are products of two profiles tabulated at eighths of a pixel: ``test_frames.c`` makes the same pixels.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from startracker.core import SPEED_OF_LIGHT_KM_S, FloatArray, IntArray
from startracker.flight.apparent import EPOCH_BITS
from startracker.flight.design import FlightDesign
from startracker.flight.stars import StarList
from startracker.observer import Observer

VELOCITY = (19000, -14000, 11000)
"""Of the observer over that of light, 2.30: 7.6 km/s."""
YEARS = 4 << 16
"""Between the tables and the frames, 16 fraction bits."""
SEED = 20260
REACH, EIGHTHS = 6, 8
NOISE_SHARE = 4.0
"""Peak of the faintest star over the standard deviation of the noise."""
_LISTS, _FRAMES = 4, 3
_POSITION_SIGMA_PX = 0.05
_BRIGHTER_MAG = 0.8
_MOST_SOURCES = 40
_ONE = float(1 << 30)


class UnitField(NamedTuple):
    """Guide stars in an image, brightest first."""

    attitude: FloatArray
    """Matrix (3, 3): v_camera = A @ v_icrs."""
    number: IntArray
    """Catalogue numbers, (N,)."""
    v_mag: FloatArray
    """Magnitudes, (N,)."""
    xy: FloatArray
    """Positions (N, 2), px, with aberration of `VELOCITY`, `YEARS` after the epoch of the tables."""


class UnitList(NamedTuple):
    """A list of stars, and what they are."""

    stars: StarList
    number: IntArray
    """Catalogue number of each; 0: a false star."""
    attitude: FloatArray | None
    """As in `UnitField`; None: there is none, or too few stars determine it."""


class UnitScene(NamedTuple):
    """A frame by its numbers."""

    x8: IntArray
    y8: IntArray
    """Positions of the stars in eighths of a pixel, (N,)."""
    flux: IntArray
    """Of the products of two profiles, units of 2⁻³⁰, (N,)."""
    attitude: FloatArray | None
    """As in `UnitField`; None: there are no stars."""


class SceneNumbers(NamedTuple):
    """What all frames of a design share."""

    level: int
    """Background, DN."""
    noise: int
    """Largest value of the noise, a quarter of its range, DN."""
    white: int
    """Largest pixel, DN."""
    profile: IntArray
    """Image of a star by eighths of a pixel from its centre, 15 fraction bits."""


def unit_field(design: FlightDesign, index: int) -> UnitField:
    """A field near guide star number 37 `index`."""
    rng = np.random.Generator(np.random.PCG64([SEED, index]))
    z = design.guide.directions[37 * index % len(design.guide)] + rng.normal(0.0, 0.05, 3)
    z /= np.linalg.norm(z)
    x = np.cross(z, rng.normal(size=3))
    x /= np.linalg.norm(x)
    attitude = np.array([x, np.cross(z, x), z])
    velocity = np.array(VELOCITY) / _ONE * SPEED_OF_LIGHT_KM_S
    seen = design.guide.apparent_to(Observer(design.guide.epoch_jyear + YEARS / (1 << EPOCH_BITS), velocity)).directions
    vectors = seen @ attitude.T
    near = np.flatnonzero(vectors[:, 2] > math.cos(min(design.camera.half_diagonal_rad * 1.1, 1.5)))
    xy = design.camera.project(vectors[near])
    inside = design.camera.contains(xy, -2.0)
    index_of = near[inside]
    return UnitField(attitude, design.guide.catalog.id[index_of], design.guide.v_mag[index_of], xy[inside])


def unit_lists(design: FlightDesign) -> list[UnitList]:
    """A field; one with stars missing and false stars; its mirror image, which no attitude explains; two stars."""
    most = design.detection.max_stars
    lists = []
    for index in range(_LISTS):
        rng = np.random.Generator(np.random.PCG64([SEED, 1, index]))
        field = unit_field(design, index)
        number, v_mag = field.number[:most], field.v_mag[:most]
        xy = field.xy[:most] + rng.normal(0.0, _POSITION_SIGMA_PX, (len(number), 2))
        flux = 4000.0 * 10.0 ** (-0.4 * (v_mag - v_mag.min(initial=9.0)))
        if index == 1:
            kept = rng.random(len(xy)) > 0.2
            size = (design.camera.width - 1.0, design.camera.height - 1.0)
            xy = np.vstack([xy[kept], rng.uniform((0.0, 0.0), size, (3, 2))])
            flux = np.append(flux[kept], rng.choice(flux, 3))
            number = np.append(number[kept], [0, 0, 0])
        elif index == 2:
            xy = np.column_stack([design.camera.width - 1.0 - xy[:, 0], xy[:, 1]])
        elif index == 3:
            xy, flux, number = xy[:2], flux[:2], number[:2]
        order = np.argsort(-flux, kind="stable")[:most]
        stars = StarList.of(xy[order], flux[order], np.full(len(order), _POSITION_SIGMA_PX**2))
        lists.append(UnitList(stars, number[order], field.attitude if index < 2 else None))
    return lists


def scene_numbers(design: FlightDesign) -> SceneNumbers:
    """Background, noise and star image of the frames."""
    sigma = max(design.psf_sigma_px, 0.4)
    offset = np.arange(REACH * EIGHTHS) / EIGHTHS
    profile = np.rint((1 << 15) * np.exp(-0.5 * (offset / sigma) ** 2)).astype(np.int64)
    detector = design.front_detector
    noise_dn = max(detector.read_noise_e / detector.gain_e_per_dn, 1.0)
    # the sum of four even values of 0 to 1 has a standard deviation of 0.58
    return SceneNumbers(round(8 * noise_dn) + 20, max(2, round(noise_dn / 0.58)), detector.saturation_dn, profile)


def unit_scenes(design: FlightDesign) -> list[UnitScene]:
    """Two fields, and a frame without stars."""
    numbers = scene_numbers(design)
    scenes = []
    for index in range(_FRAMES):
        field = unit_field(design, 10 + index)
        xy, v_mag = field.xy[:_MOST_SOURCES], field.v_mag[:_MOST_SOURCES]
        attitude = field.attitude if index < _FRAMES - 1 else None
        if attitude is None:
            xy, v_mag = xy[:0], v_mag[:0]
        faintest = float(design.guide.v_mag[-1]) - _BRIGHTER_MAG
        peak = NOISE_SHARE * 0.58 * numbers.noise * 10.0 ** (-0.4 * (v_mag - faintest))
        x8, y8 = np.rint(EIGHTHS * xy.T).astype(np.int64)
        scenes.append(UnitScene(x8, y8, np.rint(peak).astype(np.int64), attitude))
    return scenes


def scene_rows(design: FlightDesign, scene: UnitScene, seed: int) -> IntArray:
    """Pixels (H, W) of a scene, as ``test_frames.c`` makes them."""
    numbers, width, height = scene_numbers(design), design.camera.width, design.camera.height
    state = (seed + np.arange(height, dtype=np.uint64) * 2654435761) & 0xFFFFFFFF
    frame = np.empty((height, width), dtype=np.int64)
    for x in range(width):
        value = np.zeros(height, dtype=np.uint64)
        for _ in range(4):
            state = (state * np.uint64(1664525) + np.uint64(1013904223)) & np.uint64(0xFFFFFFFF)
            value += state >> np.uint64(16)
        frame[:, x] = numbers.level + (value.astype(np.int64) * numbers.noise >> 16)
    for x8, y8, flux in zip(scene.x8.tolist(), scene.y8.tolist(), scene.flux.tolist(), strict=True):
        columns = np.arange(max(x8 // 8 - REACH, 0), min(x8 // 8 + REACH + 1, width))
        rows = np.arange(height)
        across, down = (_profile(numbers, EIGHTHS * k - at) for k, at in ((columns, x8), (rows, y8)))
        frame[:, columns] += (down[:, None] * across * flux) >> 30
        np.minimum(frame, numbers.white, out=frame)
    return frame


def _profile(numbers: SceneNumbers, offset: IntArray) -> IntArray:
    size = np.abs(offset)
    return np.where(size < len(numbers.profile), numbers.profile[np.minimum(size, len(numbers.profile) - 1)], 0)
