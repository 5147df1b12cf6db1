"""Stars trailed by the camera's turn: the motion that they share, and where each stood in the middle of the exposure.

Takes an image, its background and what is known of its trails; gives `Trails`: centroids and the motion.
"""

from startracker.trails.find import Trails, find_trails

__all__ = ["Trails", "find_trails"]
