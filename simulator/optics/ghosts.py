"""Ghosts: weak, blurred second images by two reflections between the surfaces of the lens.

Light that is reflected twice leaves a lens of rotational symmetry as a pencil whose chief ray still goes through the
axis, so that to first order the ghost of a star at x stands on the line through the principal point c, at

    x_g = c + scale · (x − c),      electrons_g = flux · electrons,

drawn as an even disk of the radius of the defocused pencil. `scale` is negative for ghosts on the other side.

Validity: paraxial; one scale, flux and radius a pair of surfaces over the whole field, no cut by stops. `flux` is about
R₁R₂, the product of the two reflectances: 1e-4 for two surfaces of 1 %. Source: W. J. Smith, *Modern
Optical Engineering* (2008), section on ghost images; the first-order formula follows from symmetry alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from startracker.camera import Camera

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Ghost:
    """Second image by two reflections in the lens."""

    flux: float
    """Share of the star's light."""
    scale: float
    """Distance from the principal point, against the star's; negative: on the other side."""
    radius_px: float
    """Radius of the even disk."""


LEAST_ELECTRONS = 0.1
"""Ghosts of fewer electrons over their whole disk are left out."""


def ghost_sources(
    camera: Camera, xy: FloatArray, electrons: FloatArray, ghosts: Sequence[Ghost]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Disks to draw for the ghosts of stars and bodies.

    Parameters
    ----------
    camera : Camera
        For its principal point and size.
    xy : (N, 2) array
        Places of the sources, pixels; NaN has no ghost.
    electrons : (N,) array
        Electrons of the sources over the exposure.
    ghosts : sequence of Ghost
        The pairs of reflecting surfaces.

    Returns
    -------
    xy (G, 2), electrons (G,), radius_px (G,) of those that reach into the image, pair by pair
    """
    centre = np.array([camera.cx, camera.cy])
    positions, light, radii = [np.empty((0, 2))], [np.empty(0)], [np.empty(0)]
    for ghost in ghosts:
        position = centre + ghost.scale * (xy - centre)
        share = ghost.flux * electrons
        seen = (
            np.isfinite(position).all(axis=1) & (share >= LEAST_ELECTRONS) & camera.contains(position, ghost.radius_px)
        )
        positions.append(position[seen])
        light.append(share[seen])
        radii.append(np.full(int(seen.sum()), ghost.radius_px))
    return np.concatenate(positions), np.concatenate(light), np.concatenate(radii)
