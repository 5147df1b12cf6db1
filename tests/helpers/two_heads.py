"""A body that slews, with two heads at 90° and a gyro whose errors are drawn as the filter assumes them."""

import math
from typing import NamedTuple

import numpy as np

from startracker.fusion import Head
from startracker.geometry.attitude import Attitude
from startracker.tracking import GyroNoise

ARCSEC = math.radians(1.0 / 3600.0)
ALONG_Z = Attitude([0.0, 0.0, 0.0, 1.0], "body", "camera")
ALONG_X = Attitude.from_rotation_vector([0.0, math.pi / 2.0, 0.0], "body", "camera")
HEADS = (Head("a", ALONG_Z), Head("b", ALONG_X, 60.0 * ARCSEC))
NOISE = GyroNoise(
    angle_random_walk=1e-5, rate_random_walk=1e-7, bias_sigma_rad_s=5e-5, acceleration=1e-3, scale_sigma=1e-3
)
SIGMA = np.array([2.0, 3.0, 15.0]) * ARCSEC
"""Of an attitude of a single frame: across and about the boresight."""


class Flight(NamedTuple):
    """Truth, and what the sensors measure."""

    times: np.ndarray
    attitudes: list
    """ICRS to body, at the times."""
    bias: np.ndarray
    """At the last time."""
    scale: np.ndarray
    alignments: list
    """Rotation vectors of the heads."""
    gyro: list
    """(start, end, rotation vector)"""
    seen: list
    """(head, time, attitude, covariance)"""

    def truth(self, t_s):
        return self.attitudes[int(np.argmin(np.abs(self.times - t_s)))]


def rate_of(t_s):
    """About three axes in turn, up to 1°/s: scale factors and alignments are observable."""
    return math.radians(1.0) * np.array([math.sin(0.11 * t_s), math.cos(0.07 * t_s), math.sin(0.05 * t_s + 1.0)])


def turned(attitude, vector):
    frame = attitude.target
    return Attitude.from_rotation_vector(vector, frame, frame) @ attitude


def fly(rng, times, schedule, heads=HEADS, noise=NOISE, substeps=4, rate=rate_of):
    """A flight over `times`; `schedule(k)` is the heads that give an attitude at the k-th.

    The correlated part of the heads' errors is drawn as they state it.
    """
    body = Attitude(rng.normal(size=4), "icrs", "body")
    bias = noise.bias_sigma_rad_s * rng.normal(size=3)
    scale = noise.scale_sigma * rng.normal(size=3)
    alignments = [head.alignment_sigma_rad * rng.normal(size=3) for head in heads]
    covariance = np.diag(SIGMA**2)
    shared = [np.array(head.correlated_sigma_rad) * rng.normal(size=3) for head in heads]
    attitudes, gyro, seen = [], [], []
    for k, t_s in enumerate(times):
        if k:
            step = (t_s - times[k - 1]) / substeps
            before, error = body, np.zeros(3)
            for j in range(substeps):
                body = turned(body, rate(times[k - 1] + (j + 0.5) * step) * step)
                change = noise.rate_random_walk * math.sqrt(step) * rng.normal(size=3)
                # ∫ of the bias over the substep, with the part that is not seen in its ends (variance h³/12)
                inner = noise.rate_random_walk * math.sqrt(step**3 / 12.0) * rng.normal(size=3)
                error += (bias + 0.5 * change) * step + inner
                bias = bias + change
            white = noise.angle_random_walk * math.sqrt(t_s - times[k - 1]) * rng.normal(size=3)
            gyro.append((times[k - 1], t_s, (1.0 + scale) * before.rotation_vector_to(body) + error + white))
            for h, head in enumerate(heads):
                kept = math.exp(-(t_s - times[k - 1]) / head.correlation_s)
                fresh = np.array(head.correlated_sigma_rad) * rng.normal(size=3)
                shared[h] = kept * shared[h] + math.sqrt(1.0 - kept**2) * fresh
        attitudes.append(body)
        for h in schedule(k):
            camera = turned(heads[h].mounting @ body, alignments[h])
            seen.append((h, float(t_s), turned(camera, shared[h] + SIGMA * rng.normal(size=3)), covariance))
    return Flight(np.asarray(times), attitudes, bias, scale, alignments, gyro, seen)


def in_order(fusion, flight):
    """Give all data of a flight to a filter in order of time."""
    events = [(end, -1, (start, end, turn)) for start, end, turn in flight.gyro]
    events += [(t_s, h, (h, t_s, attitude, p)) for h, t_s, attitude, p in flight.seen]
    for _, h, data in sorted(events, key=lambda event: event[:2]):
        (fusion.add_gyro if h < 0 else fusion.add_attitude)(*data)
    return fusion


def error_of(flight, mekf):
    """Error (n,) of attitude, bias, scale factors and alignments at the last time, estimate minus truth."""
    parts = [flight.attitudes[-1].rotation_vector_to(mekf.attitude)]
    parts += [mekf.bias_rad_s - flight.bias, mekf.scale - flight.scale]
    parts += [
        mekf.alignment_rad(h) - flight.alignments[h] for h, head in enumerate(mekf.heads) if head.alignment_sigma_rad
    ]
    return np.concatenate(parts)
