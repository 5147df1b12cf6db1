"""Stars trailed by the camera's turn: the motion that they share, and where each stood in the middle of the exposure.

Takes an image, its background and what is known of its trails; gives `Trails`, their middles and the motion, and from
these with a camera the positions of the stars at mid-exposure.
"""

from startracker.trails.find import find_trails
from startracker.trails.turn import Trails, mid_exposure

__all__ = ["Trails", "find_trails", "mid_exposure"]


def __dir__() -> list[str]:
    return sorted(__all__)
