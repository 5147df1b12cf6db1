"""Ghosts: weak, defocused second images that arise from two reflections between surfaces of the lens.

In a rotationally symmetric lens, the chief ray of light that is reflected twice remains in the meridional plane, so
that to first order the ghost of a star at x is on the line through the principal point c, at

    x_g = c + scale · (x − c),      electrons_g = flux · electrons,

rendered as a uniform disk with the radius of the defocused pencil. `scale` is negative for ghosts on the opposite side.

Validity: paraxial; one scale, flux and radius per pair of surfaces for the whole field, no clipping by stops. `flux` is
about R₁R₂, the product of the two reflectances: 1e-4 for two surfaces of 1 %. Source: W. J. Smith, *Modern Optical
Engineering* (2008), section on ghost images; the first-order formula follows from symmetry alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from startracker.core import FloatArray
from startracker.geometry.camera import Camera


@dataclass(frozen=True)
class Ghost:
    """Second image from two reflections in the lens."""

    flux: float
    """Fraction of the star's light."""
    scale: float
    """Distance from the principal point relative to that of the star; negative: on the opposite side."""
    radius_px: float
    """Radius of the uniform disk."""


LEAST_ELECTRONS = 0.1
"""Ghosts with fewer electrons in total are omitted."""


def ghost_sources(
    camera: Camera, xy: FloatArray, electrons: FloatArray, ghosts: Sequence[Ghost]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Disks of the ghosts of stars and bodies.

    Parameters
    ----------
    camera : Camera
        For its principal point and size.
    xy : (N, 2) array
        Positions of the sources, pixels; NaN has no ghost.
    electrons : (N,) array
        Electrons of the sources over the exposure.
    ghosts : sequence of Ghost
        One entry per pair of reflecting surfaces.

    Returns
    -------
    xy (G, 2), electrons (G,), radius_px (G,) of those that overlap the image, by pair of surfaces
    """
    centre = np.array([camera.cx, camera.cy])
    positions, light, radii = [np.empty((0, 2))], [np.empty(0)], [np.empty(0)]
    for ghost in ghosts:
        # A ghost may be in the image although its source is outside, so all sources are examined.
        position = centre + ghost.scale * (xy - centre)
        share = ghost.flux * electrons
        seen = (
            np.isfinite(position).all(axis=1) & (share >= LEAST_ELECTRONS) & camera.contains(position, ghost.radius_px)
        )
        positions.append(position[seen])
        light.append(share[seen])
        radii.append(np.full(int(seen.sum()), ghost.radius_px))
    return np.concatenate(positions), np.concatenate(light), np.concatenate(radii)
