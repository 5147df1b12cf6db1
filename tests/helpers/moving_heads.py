"""Heads on mountings that move, or whose noise is not as stated, on a body that turns slowly."""

import math
from typing import NamedTuple

import numpy as np
from two_heads import ALONG_X, ALONG_Z, ARCSEC, turned

from startracker.fusion import FusionFilter, Head
from startracker.geometry.attitude import Attitude
from startracker.tracking import GyroNoise

ALONG_Y = Attitude.from_rotation_vector([math.pi / 2.0, 0.0, 0.0], "body", "camera")
GYRO = GyroNoise(angle_random_walk=1e-5, rate_random_walk=1e-7, bias_sigma_rad_s=5e-5, scale_sigma=1e-3)
GOOD_GYRO = GyroNoise(angle_random_walk=1e-6, rate_random_walk=1e-9, bias_sigma_rad_s=5e-5, scale_sigma=1e-3)
SIGMA = 5.0 * ARCSEC
AT_REST = np.zeros(3)


class Result(NamedTuple):
    """What a filter of moving heads found, by frame."""

    nees: np.ndarray
    """Of the attitude of the body."""
    states: list
    outcomes: list
    """(frame, head, outcome)"""
    error_arcsec: np.ndarray
    fusion: FusionFilter

    def count(self, *states):
        return sum(state in states for state in self.states)


def three(**motion):
    """Three heads at 90°; the first defines the axes of the body, the others are known to 60″."""
    return [
        Head("a", ALONG_Z, **motion),
        Head("b", ALONG_X, 60.0 * ARCSEC, **motion),
        Head("c", ALONG_Y, 60.0 * ARCSEC, **motion),
    ]


def rate_at(t_s):
    return 0.003 * np.array([math.sin(0.011 * t_s), math.cos(0.007 * t_s), math.sin(0.005 * t_s + 1.0)])


def follow(
    seed,
    frames,
    heads,
    moved=lambda head, t_s: AT_REST,
    *,
    noise=GYRO,
    step_s=1.0,
    stated=None,
    seen=None,
    rate=rate_at,
):
    """Fly heads of 5″ whose mountings are rotated by `moved` (″, about the axes of the camera).

    `stated` are factors on the standard deviations that they state; `seen(head, t_s)` is whether they see anything.
    """
    rng = np.random.default_rng(seed)
    fusion = FusionFilter(heads, noise)
    alignments = [head.alignment_sigma_rad * rng.normal(size=3) for head in heads]
    bias, scale = noise.bias_sigma_rad_s * rng.normal(size=3), noise.scale_sigma * rng.normal(size=3)
    body = Attitude(rng.normal(size=4), "icrs", "body")
    nees, states, outcomes, errors = [], [], [], []
    for k in range(frames):
        t_s = k * step_s
        if k:
            turn = rate(t_s) * step_s
            body = turned(body, turn)
            bias = bias + noise.rate_random_walk * math.sqrt(step_s) * rng.normal(size=3)
            white = noise.angle_random_walk * math.sqrt(step_s) * rng.normal(size=3)
            fusion.add_gyro(t_s - step_s, t_s, (1.0 + scale) * turn + bias * step_s + white)
        for h, head in enumerate(heads):
            error = SIGMA * rng.normal(size=3)
            if seen is not None and not seen(h, t_s):
                continue
            mounted = turned(head.mounting @ body, alignments[h] + np.asarray(moved(h, t_s)) * ARCSEC)
            sigma = SIGMA * (1.0 if stated is None else stated[h])
            outcomes.append((k, h, fusion.add_attitude(h, t_s, turned(mounted, error), np.eye(3) * sigma**2).outcome))
        found = fusion.estimate(t_s)
        error = body.rotation_vector_to(found.attitude)
        nees.append(error @ np.linalg.solve(found.attitude_covariance, error))
        errors.append(np.linalg.norm(error) / ARCSEC)
        states.append(fusion.status(t_s).state)
    return Result(np.array(nees), states, outcomes, np.array(errors), fusion)
