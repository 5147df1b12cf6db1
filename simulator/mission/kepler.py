"""Keplerian motion: conversion of elements and states, and the secular rates of an ellipse by J2."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from simulator.constants import EARTH_J2, EARTH_RADIUS_KM
from startracker.core import FloatArray
from startracker.errors import InputError

_ITERATIONS = 50
"""Maximum number of iterations; a few are enough except near e = 1."""
_CONVERGED_RAD = 4e-15
"""Step at which the iteration ends: a few units of the last digit of an angle of π."""


class Elements(NamedTuple):
    """Keplerian elements of an ellipse; angles in radians."""

    semi_major_axis_km: float
    eccentricity: float
    inclination_rad: float
    node_rad: float
    periapsis_rad: float
    """Argument of the periapsis."""
    mean_anomaly_rad: float


def eccentric_anomaly(mean_anomaly_rad: ArrayLike, eccentricity: float) -> FloatArray:
    """Solution E of Kepler's equation M = E − e sin E, radians, any shape; e from 0 to below 1.

    Newton's method with Danby's third-order correction from E = M + 0.85 e sign(sin M) (Danby 1988, *Fundamentals of
    Celestial Mechanics*, section 6.6), which converges for all M and e.

    Raises
    ------
    InputError
        For an eccentricity outside [0, 1).
    """
    if not 0.0 <= eccentricity < 1.0:
        raise InputError(f"an ellipse has an eccentricity from 0 to below 1, not {eccentricity:g}")
    whole = np.asarray(mean_anomaly_rad, dtype=float)
    mean = np.remainder(whole + math.pi, 2.0 * math.pi) - math.pi
    # The iteration is in [−π, π), where rounding is least; whole revolutions are added again at the end.
    found = mean + 0.85 * eccentricity * np.sign(mean)
    for _ in range(_ITERATIONS):
        sine, cosine = eccentricity * np.sin(found), eccentricity * np.cos(found)
        off, slope = found - sine - mean, 1.0 - cosine
        # Newton's, Halley's, and Danby's step, each of which uses the one before.
        step = -off / slope
        step = -off / (slope + 0.5 * step * sine)
        step = -off / (slope + 0.5 * step * sine + step * step * cosine / 6.0)
        found = found + step
        if np.all(np.abs(step) < _CONVERGED_RAD):
            break
    return np.asarray(found + (whole - mean))


def perifocal(elements: Elements, mean_anomaly_rad: ArrayLike, gm_km3_s2: float) -> tuple[FloatArray, FloatArray]:
    """Position and velocity (..., 2) in the orbital plane, x towards the periapsis, at mean anomalies (...).

    r = a (cos E − e, √(1 − e²) sin E), v = √(μ a)/r (−sin E, √(1 − e²) cos E) (Vallado 2013, section 2.2).
    """
    a, e = elements.semi_major_axis_km, elements.eccentricity
    anomaly = eccentric_anomaly(mean_anomaly_rad, e)
    cosine, sine, ratio = np.cos(anomaly), np.sin(anomaly), math.sqrt(1.0 - e * e)
    speed = math.sqrt(gm_km3_s2 / a) / (1.0 - e * cosine)
    return (
        np.stack([a * (cosine - e), a * ratio * sine], axis=-1),
        np.stack([-speed * sine, speed * ratio * cosine], axis=-1),
    )


def plane_axes(
    inclination_rad: float, node_rad: ArrayLike, periapsis_rad: ArrayLike
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Unit vectors (..., 3) towards the periapsis, 90° ahead of it, and along the angular momentum (Vallado 2013,
    section 2.6)."""
    node, along = np.asarray(node_rad, dtype=float), np.asarray(periapsis_rad, dtype=float)
    cos_i, sin_i = math.cos(inclination_rad), math.sin(inclination_rad)
    to_node = np.stack([np.cos(node), np.sin(node), np.zeros(node.shape)], axis=-1)
    ahead = np.stack([-np.sin(node) * cos_i, np.cos(node) * cos_i, np.full(node.shape, sin_i)], axis=-1)
    cosine, sine = np.cos(along)[..., None], np.sin(along)[..., None]
    normal = np.stack([np.sin(node) * sin_i, -np.cos(node) * sin_i, np.full(node.shape, cos_i)], axis=-1)
    return cosine * to_node + sine * ahead, cosine * ahead - sine * to_node, normal


def elements_of(r_km: ArrayLike, v_km_s: ArrayLike, gm_km3_s2: float) -> Elements:
    """Osculating elements of a state (3,), in its axes (Vallado 2013, algorithm 9).

    A circular orbit has its periapsis at the node, an equatorial one its node on the x axis.

    Raises
    ------
    InputError
        If the state is not on an ellipse.
    """
    r, v = np.asarray(r_km, dtype=float), np.asarray(v_km_s, dtype=float)
    distance = float(np.linalg.norm(r))
    inverse = 2.0 / distance - float(v @ v) / gm_km3_s2
    if not inverse > 0.0:
        raise InputError("the state is not on an ellipse: its speed is that of escape or higher")
    # 1e-14 below is rounding: the node of such an equatorial orbit, or the periapsis of such a circular one, would be
    # a random direction.
    momentum = np.cross(r, v)
    h = float(np.linalg.norm(momentum))
    inclination = math.atan2(math.hypot(momentum[0], momentum[1]), momentum[2])
    tilted = math.hypot(momentum[0], momentum[1]) > 1e-14 * h
    node = math.atan2(momentum[0], -momentum[1]) if tilted else 0.0
    to_node, ahead, _ = plane_axes(inclination, node, 0.0)
    vector = np.cross(v, momentum) / gm_km3_s2 - r / distance  # eccentricity vector, towards the periapsis
    e = float(np.linalg.norm(vector))
    periapsis = math.atan2(float(vector @ ahead), float(vector @ to_node)) if e > 1e-14 else 0.0
    a = 1.0 / inverse
    true = math.atan2(float(r @ ahead), float(r @ to_node)) - periapsis
    anomaly = math.atan2(math.sqrt(1.0 - e * e) * math.sin(true), e + math.cos(true))
    turn = 2.0 * math.pi
    return Elements(a, e, inclination, node % turn, periapsis % turn, (anomaly - e * math.sin(anomaly)) % turn)


def periapsis_km(r_km: ArrayLike, v_km_s: ArrayLike, gm_km3_s2: float) -> float:
    """Distance of the periapsis of a state (3,) on any conic: h²/μ / (1 + e); 0 for a fall to the centre."""
    r, v = np.asarray(r_km, dtype=float), np.asarray(v_km_s, dtype=float)
    momentum = np.cross(r, v)
    eccentricity = np.cross(v, momentum) / gm_km3_s2 - r / np.linalg.norm(r)
    return float(momentum @ momentum / gm_km3_s2 / (1.0 + np.linalg.norm(eccentricity)))


def secular_rates(elements: Elements, gm_km3_s2: float) -> tuple[float, float, float]:
    """Secular rates by J2 of node, argument of perigee and mean anomaly, rad/s.

    With p = a (1 − e²) and k = (3/4) n J₂ (R/p)²: Ω̇ = −2 k cos i, ω̇ = k (4 − 5 sin² i),
    Ṁ = n + k √(1 − e²) (2 − 3 sin² i) (Vallado 2013, section 9.6). For e = 0 these are the rates of
    `simulator.mission.secular`.
    """
    a, e = elements.semi_major_axis_km, elements.eccentricity
    n = math.sqrt(gm_km3_s2 / a**3)
    k = 0.75 * n * EARTH_J2 * (EARTH_RADIUS_KM / (a * (1.0 - e * e))) ** 2
    sin2 = math.sin(elements.inclination_rad) ** 2
    node = -2.0 * k * math.cos(elements.inclination_rad)
    return node, k * (4.0 - 5.0 * sin2), n + k * math.sqrt(1.0 - e * e) * (2.0 - 3.0 * sin2)
