"""Guide stars and the camera's field as arrays for kernels."""

from __future__ import annotations

from typing import NamedTuple

from startracker.catalog.field_shape import FieldShape
from startracker.catalog.voxels import VoxelGrid
from startracker.core import FloatArray


class SkyView(NamedTuple):
    """Guide stars and the camera's field, as kernels take them."""

    directions: FloatArray
    """Unit vectors, brightest first, (G, 3)."""
    v_mag: FloatArray
    """Shape (G,)."""
    grid: VoxelGrid
    shape: FieldShape
    area: float
    """Solid angle of the image, sr."""
