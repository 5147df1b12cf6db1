"""Motions of a body, and what a session is told of them: shared by the tests of tracking."""

import math

import numpy as np

from startracker.geometry.attitude import Attitude
from startracker.observer import Observer
from startracker.tracking import TrackingSession

DT = 0.5
LARGE = 35.0  # χ²(3) is above with a probability of 1e-7
SMALL_CAMERA = [  # overrides of a scenario: a camera whose sequences render in seconds
    "detector.width=384",
    "detector.height=384",
    "optics.focal_length_mm=12",
    "optics.aperture_mm=12",
    "optics.distortion.k1=0",
    "sky.magnitude_limit=7",
    "detector.exposure_s=0.1",
    "pointing.rate_deg_s=[0.03, 0.02, 0.04]",
]


class Session(TrackingSession):
    """A session whose observer is at rest: the frames made here have no aberration."""

    def update(self, image, t_s, **given):
        return super().update(image, t_s, observer=Observer(self.tracker.guide.epoch_jyear, np.zeros(3)), **given)

    def update_centroids(self, xy, flux, t_s, **given):
        observer = Observer(self.tracker.guide.epoch_jyear, np.zeros(3))
        return super().update_centroids(xy, flux, t_s, observer=observer, **given)


def turned(attitude, vector):
    return Attitude.from_rotation_vector(vector, "camera", "camera") @ attitude


def motion(rng, frames, rate_deg_s, acceleration=0.0):
    """True attitudes, and the mean rate (camera axes) since the one before."""
    attitude, rate = Attitude(rng.normal(size=4)), rng.normal(size=3)
    rate *= math.radians(rate_deg_s) / np.linalg.norm(rate)
    mean = rate
    for _ in range(frames):
        yield attitude, mean
        before = attitude
        for _ in range(5):
            rate = rate + acceleration * rng.normal(size=3) * math.sqrt(DT / 5)
            attitude = turned(attitude, rate * DT / 5)
        mean = before.rotation_vector_to(attitude) / DT


def stars(rng, tracker, attitude, noise_px=0.2):
    index, _, xy = tracker.guide.in_field(attitude.as_matrix())
    order = np.argsort(tracker.guide.v_mag[index])
    xy = xy[order] + noise_px * rng.normal(size=xy.shape)
    return xy, 10.0 ** (-0.4 * tracker.guide.v_mag[index[order]])


def nees_of(truth, found):
    error = truth.rotation_vector_to(found.attitude)
    return float(error @ np.linalg.solve(found.covariance, error))


def pooled_nees(sequences):
    """Mean NEES of simulated sequences and the effective number of independent values that it is of."""
    found = [sequence.summary["nees"] for sequence in sequences]
    number = sum(nees["effective_frames"] for nees in found)
    return sum(nees["mean"] * nees["effective_frames"] for nees in found) / number, number
