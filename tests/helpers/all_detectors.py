"""All detectors by name: the tracker's own, and those that packages register."""

from importlib.metadata import entry_points

from startracker.detection import METHODS

GENERAL = METHODS | {
    entry.name: entry.load()
    for entry in entry_points(group="boresight.detectors")
    if not entry.name.endswith("_regions")
}
"""Detectors for every image."""
DETECTORS = METHODS | {entry.name: entry.load() for entry in entry_points(group="boresight.detectors")}
"""With those that apply the rules of Greyling 1995 alone, which leave hot pixels and streaks in."""
