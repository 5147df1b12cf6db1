"""Camera parameters that can be estimated from stars, and the derivatives of the image with respect to them.

Pinhole with Brown–Conrady distortion, or fisheye (Kannala–Brandt), as in `startracker.geometry.camera`.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from startracker.core import FloatArray
from startracker.geometry.camera import Camera
from startracker.geometry.distortion import Distortion

PARAMETERS = {
    "pinhole": ("f", "aspect", "cx", "cy", "k1", "k2", "k3", "p1", "p2"),
    "fisheye": ("f", "aspect", "cx", "cy", "k1", "k2", "k3", "k4"),
}
"""Fitted parameters, in this order: ln √(fx fy), ln (fy/fx), principal point (px), distortion coefficients."""

_CENTRE_SHARE, _ASPECT_SIGMA, _RADIAL_SHARE, _TANGENTIAL_SHARE = 0.03, 0.01, 0.2, 0.01


def prior_of(name: str, camera: Camera) -> tuple[float, float]:
    """Prior mean and standard deviation of a parameter; infinite for the focal length.

    Principal point: 3 % of the image width from the centre; aspect ratio: 1 %; radial terms: 20 %, tangential ones: 1 %
    of the radius at the corner. The priors constrain what a field cannot determine: without distortion a shift of the
    principal point is nearly equivalent to a rotation of the camera.
    """
    if name == "f":
        return 0.0, math.inf
    if name == "aspect":
        return 0.0, _ASPECT_SIGMA
    if name in ("cx", "cy"):
        return ((camera.width if name == "cx" else camera.height) - 1) / 2, _CENTRE_SHARE * camera.width
    corner = corner_radius(camera)
    if name in ("p1", "p2"):
        return 0.0, _TANGENTIAL_SHARE / corner
    return 0.0, _RADIAL_SHARE / corner ** (2 * int(name[1:]))


def value_of(name: str, camera: Camera) -> float:
    """Current value of a parameter."""
    if name == "f":
        return 0.5 * math.log(camera.fx * camera.fy)
    if name == "aspect":
        return math.log(camera.fy / camera.fx)
    return float(getattr(camera if name in ("cx", "cy") else camera.distortion, name))


def change_lens(camera: Camera, change: dict[str, float]) -> Camera:
    """The camera with `change` added to its parameters."""
    lens = replace(
        camera.distortion,
        **{k: getattr(camera.distortion, k) + v for k, v in change.items() if k[0] in "kp"},
    )
    scale, stretch = change.get("f", 0.0), 0.5 * change.get("aspect", 0.0)
    return replace(
        camera,
        fx=camera.fx * math.exp(scale - stretch),
        fy=camera.fy * math.exp(scale + stretch),
        cx=camera.cx + change.get("cx", 0.0),
        cy=camera.cy + change.get("cy", 0.0),
        distortion=lens,
    )


def plain(camera: Camera) -> Camera:
    """The camera without distortion, centred, with square pixels."""
    focal = math.sqrt(camera.fx * camera.fy)
    middle = ((camera.width - 1) / 2, (camera.height - 1) / 2)
    return replace(camera, fx=focal, fy=focal, cx=middle[0], cy=middle[1], distortion=Distortion())


def only(camera: Camera, names: tuple[str, ...]) -> Camera:
    """The camera with all parameters except `names` at their values in `plain`; the focal length is kept."""
    start = plain(camera)
    lens = {k: getattr(camera.distortion, k) for k in names if k[0] in "kp"}
    if "aspect" in names:
        start = replace(start, fx=camera.fx, fy=camera.fy)
    return replace(
        start,
        cx=camera.cx if "cx" in names else start.cx,
        cy=camera.cy if "cy" in names else start.cy,
        distortion=Distortion(**lens),
    )


def sensitivity(camera: Camera, vectors: FloatArray) -> tuple[FloatArray, dict[str, FloatArray], FloatArray]:
    """Pixels of stars, and their derivatives with respect to the lens and to their directions.

    Parameters
    ----------
    camera : Camera
        Pinhole without rational terms (k4 to k6), or fisheye.
    vectors : (M, 3)
        Unit vectors in the camera frame.

    Returns
    -------
    pixels (M, 2); derivative (M, 2) with respect to each of `PARAMETERS`; derivative (M, 2, 3) with respect to the
    vector.
    """
    image, by_lens, by_vector = (_pinhole if camera.projection == "pinhole" else _fisheye)(camera, vectors)
    # A mirrored image has a negative focal length along the columns.
    focal = np.array([camera.parity * camera.fx, camera.fy])
    moves = {name: focal * columns for name, columns in by_lens.items()}
    offset = focal * image
    moves["f"] = offset
    moves["aspect"] = offset * np.array([-0.5, 0.5])
    moves["cx"], moves["cy"] = (np.broadcast_to(axis, offset.shape) for axis in np.eye(2))
    return offset + np.array([camera.cx, camera.cy]), moves, focal[:, None] * by_vector


def by_turn(by_vector: FloatArray, vectors: FloatArray) -> FloatArray:
    """Derivative (M, 2, 3) of pixels with respect to a small rotation vector of the camera.

    It follows from the derivative with respect to the vectors (M, 3), because a rotation of the frame by δ changes the
    coordinates to v + v × δ.
    """
    x, y, z = vectors.T
    a, b, c = by_vector[:, :, 0], by_vector[:, :, 1], by_vector[:, :, 2]
    x, y, z = x[:, None], y[:, None], z[:, None]
    return np.stack([b * z - c * y, c * x - a * z, a * y - b * x], axis=2)


def _pinhole(camera: Camera, vectors: FloatArray) -> tuple[FloatArray, dict[str, FloatArray], FloatArray]:
    lens = camera.distortion
    depth = vectors[:, 2]
    plane = vectors[:, :2] / depth[:, None]
    x, y = plane.T
    r2 = x * x + y * y
    radial = 1.0 + r2 * (lens.k1 + r2 * (lens.k2 + r2 * lens.k3))
    # Derivative of `radial` with respect to r²/2.
    slope = 2.0 * (lens.k1 + r2 * (2.0 * lens.k2 + r2 * 3.0 * lens.k3))
    tangential = {
        "p1": np.stack([2.0 * x * y, r2 + 2.0 * y * y], axis=1),
        "p2": np.stack([r2 + 2.0 * x * x, 2.0 * x * y], axis=1),
    }
    image = plane * radial[:, None] + lens.p1 * tangential["p1"] + lens.p2 * tangential["p2"]
    mixed = x * y * slope + 2.0 * (lens.p1 * x + lens.p2 * y)
    by_plane = np.empty((len(x), 2, 2))
    by_plane[:, 0, 0] = radial + x * x * slope + 2.0 * lens.p1 * y + 6.0 * lens.p2 * x
    by_plane[:, 0, 1] = by_plane[:, 1, 0] = mixed
    by_plane[:, 1, 1] = radial + y * y * slope + 6.0 * lens.p1 * y + 2.0 * lens.p2 * x
    plane_by_vector = np.zeros((len(x), 2, 3))
    plane_by_vector[:, 0, 0] = plane_by_vector[:, 1, 1] = 1.0 / depth
    plane_by_vector[:, :, 2] = -plane / depth[:, None]
    powers = {f"k{n}": plane * (r2**n)[:, None] for n in (1, 2, 3)}
    return image, {**powers, **tangential}, by_plane @ plane_by_vector


def _fisheye(camera: Camera, vectors: FloatArray) -> tuple[FloatArray, dict[str, FloatArray], FloatArray]:
    lens = camera.distortion
    coefficients = (lens.k1, lens.k2, lens.k3, lens.k4)
    side = np.maximum(np.hypot(vectors[:, 0], vectors[:, 1]), 1e-12)
    outward = vectors[:, :2] / side[:, None]
    angle = np.arctan2(side, vectors[:, 2])
    radius, slope = angle.copy(), np.ones_like(angle)
    for n, k in enumerate(coefficients, 1):
        radius += k * angle ** (2 * n + 1)
        slope += (2 * n + 1) * k * angle ** (2 * n)
    angle_by_vector = np.concatenate([outward * vectors[:, 2:], -side[:, None]], axis=1)
    angle_by_vector /= np.sum(vectors**2, axis=1)[:, None]
    across = np.eye(2) - outward[:, :, None] * outward[:, None, :]
    by_vector = (slope[:, None] * outward)[:, :, None] * angle_by_vector[:, None, :]
    by_vector[:, :, :2] += (radius / side)[:, None, None] * across
    powers = {f"k{n}": outward * (angle ** (2 * n + 1))[:, None] for n in (1, 2, 3, 4)}
    return outward * radius[:, None], powers, by_vector


def corner_radius(camera: Camera) -> float:
    """Radius of the farthest corner in focal lengths."""
    return math.hypot(
        max(camera.cx, camera.width - 1 - camera.cx) / camera.fx,
        max(camera.cy, camera.height - 1 - camera.cy) / camera.fy,
    )


def is_one_to_one(camera: Camera) -> bool:
    """Whether the image radius increases with the angle out to the corner, so that the model can be inverted there.

    For a pinhole r (1 + k1 r² + k2 r⁴ + k3 r⁶) must reach the corner before its maximum; the image circle of a fisheye
    may be smaller than the image.
    """
    corner, lens = corner_radius(camera), camera.distortion
    if camera.projection != "pinhole":
        return corner < 3.0 * math.pi
    # Up to 76° from the axis. The slope of r · radial(r²) must stay positive, with a margin.
    reach = np.linspace(0.0, 4.0, 400) ** 2
    rises = 1.0 + reach * (3.0 * lens.k1 + reach * (5.0 * lens.k2 + reach * 7.0 * lens.k3)) > 0.05
    last = len(reach) if rises.all() else int(np.argmin(rises))
    r2 = reach[:last]
    image = np.sqrt(r2) * (1.0 + r2 * (lens.k1 + r2 * (lens.k2 + r2 * lens.k3)))
    return bool(image[-1] > corner)
