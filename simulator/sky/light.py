"""What turns light on its way in: gravity of the Sun, and the observer's own motion. Kernels on one direction.

Plain arithmetic that the kernels of `simulator.sky.apparent` and `simulator.sky.solar_system` take in.
"""

from __future__ import annotations

import math

from numba.extending import register_jitable

from startracker.constants import SPEED_OF_LIGHT_KM_S

__all__ = ["aberrated", "bent", "unit"]

SCHWARZSCHILD_SUN_AU = 1.97412574336e-8
"""Schwarzschild radius of the Sun, 2GM/c², au; ERFA's ``ERFA_SRS``."""

Vector = tuple[float, float, float]


@register_jitable
def unit(x: float, y: float, z: float) -> Vector:
    """A vector's direction."""
    length = math.sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length


@register_jitable
def bent(p: Vector, q: Vector, e: Vector, distance_au: float, limit: float) -> Vector:
    """Direction of a source after the Sun's gravity has bent its light; ``eraLd`` for the Sun's mass.

    p₁ = p + (2GM/c²)/d · p × (e × q) / max(q·(q + e), limit)

    Parameters
    ----------
    p, q, e : tuples of 3 floats
        Unit vectors from the observer to the source, from the Sun to the source, from the Sun to the observer.
    distance_au : float
        From the Sun to the observer.
    limit : float
        Holds the bending back where the source is behind the Sun.
    """
    (px, py, pz), (qx, qy, qz), (ex, ey, ez) = p, q, e
    behind = qx * (qx + ex) + qy * (qy + ey) + qz * (qz + ez)
    weight = SCHWARZSCHILD_SUN_AU / distance_au / max(behind, limit)
    x, y, z = ey * qz - ez * qy, ez * qx - ex * qz, ex * qy - ey * qx
    return (
        px + weight * (py * z - pz * y),
        py + weight * (pz * x - px * z),
        pz + weight * (px * y - py * x),
    )


@register_jitable
def aberrated(p: Vector, velocity_km_s: Vector) -> Vector:
    """Direction that a moving observer sees; the formula of `startracker.observer.aberrate`."""
    bx, by, bz = (
        velocity_km_s[0] / SPEED_OF_LIGHT_KM_S,
        velocity_km_s[1] / SPEED_OF_LIGHT_KM_S,
        velocity_km_s[2] / SPEED_OF_LIGHT_KM_S,
    )
    inverse_gamma = math.sqrt(1.0 - (bx * bx + by * by + bz * bz))
    along = p[0] * bx + p[1] * by + p[2] * bz
    share = 1.0 + along / (1.0 + inverse_gamma)
    x, y, z = unit(
        p[0] * inverse_gamma + bx * share, p[1] * inverse_gamma + by * share, p[2] * inverse_gamma + bz * share
    )
    return x, y, z
