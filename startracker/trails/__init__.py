"""Stars trailed by the rotation of the camera: their common motion, and their positions in the middle of the exposure.

The input is an image, its background and the trails already known in it; the result is `Trails`, with their middles and
the motion. Together with a camera these give the positions of the stars at mid-exposure.
"""

from startracker.trails.find import find_trails
from startracker.trails.turn import Trails, mid_exposure

__all__ = ["Trails", "find_trails", "mid_exposure"]


def __dir__() -> list[str]:
    return sorted(__all__)
