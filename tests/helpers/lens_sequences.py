"""Sequences of star positions for calibration in flight: a random sky, a true lens, Gaussian errors; no image."""

import numpy as np
from scipy.spatial.transform import Rotation

from startracker.calibration import IdentifiedStars
from startracker.geometry.camera import Camera
from startracker.geometry.distortion import Distortion
from startracker.geometry.lens import change_lens

WIDE = Camera.from_fov(26.0, 1024, 1024, Distortion(k1=-0.05))


def lens(camera, names, change):
    """The camera with its parameters changed."""
    return change_lens(camera, dict(zip(names, np.asarray(change).tolist(), strict=True)))


def new_sky(rng, true, count, sigma_px, first_id=0):
    """Attitude (3, 3) and stars of a frame at a random attitude, with stars that are in no other frame."""
    matrix = Rotation.random(random_state=rng).as_matrix()
    xy = rng.uniform([0, 0], [true.width - 1, true.height - 1], (count, 2))
    directions = true.unproject(xy) @ matrix
    measured = xy + rng.normal(0.0, sigma_px, (count, 2))
    sigma = np.full(count, sigma_px)
    return matrix, IdentifiedStars(measured, directions, sigma, first_id + np.arange(count), np.full(count, np.nan))


def disc_of_stars(rng, count, half_deg):
    """Unit vectors (N, 3), uniform within an angle of the z axis."""
    cosine = 1.0 - rng.uniform(0.0, 1.0, count) * (1.0 - np.cos(np.radians(half_deg)))
    azimuth, sine = rng.uniform(0.0, 2.0 * np.pi, count), np.sqrt(1.0 - cosine**2)
    return np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), cosine], axis=1)


def rolled(rng, true, sky, catalogue, sigma_px, roll_deg):
    """Attitude and stars of a camera on the z axis that has rolled; true and catalogue directions (N, 3)."""
    matrix = Rotation.from_rotvec([0.0, 0.0, np.radians(roll_deg)]).as_matrix()
    xy = true.project(sky @ matrix.T)
    seen = np.flatnonzero(true.contains(xy))
    measured = xy[seen] + rng.normal(0.0, 1.0, (len(seen), 2)) * sigma_px[seen, None]
    return matrix, IdentifiedStars(measured, catalogue[seen], sigma_px[seen], seen, np.full(len(seen), np.nan))


def waves(seed, rms_px):
    """A smooth displacement of an image of 1024 × 1024 pixels with an rms value on each axis: about a wave over it."""
    phase, places = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, 4), np.linspace(-1.0, 1.0, 41)

    def shape(u, v):
        x = np.sin(np.pi * u + phase[0]) * np.cos(2.0 * v + phase[1])
        return np.stack([x, np.sin(np.pi * v + phase[2]) * np.cos(2.0 * u + phase[3])], axis=1)

    size = rms_px / np.sqrt(np.mean(shape(*(grid.ravel() for grid in np.meshgrid(places, places))) ** 2))
    return lambda xy: size * shape(*((xy - 511.5) / 512.0).T)
