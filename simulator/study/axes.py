"""Axes about which errors are measured, with their names in tables and plots."""

from __future__ import annotations

BODY_AXES = ("roll", "pitch", "yaw")
CAMERA_AXES = ("cross_x", "cross_y", "about_boresight")
AXES = BODY_AXES + CAMERA_AXES
"""Columns of errors are called ``error_<axis>_deg``."""

AXIS_TITLES = {
    "roll": ("roll", "about X, the velocity"),
    "pitch": ("pitch", "about Y, minus the orbit normal"),
    "yaw": ("yaw", "about Z, the nadir"),
    "cross_x": ("cross-boresight x", "about the camera's x axis"),
    "cross_y": ("cross-boresight y", "about the camera's y axis"),
    "about_boresight": ("about the boresight", "about the camera's z axis"),
}
"""Title of the error about each axis, and the axis in words."""


def axis_heading(axis: str) -> tuple[str, str]:
    """Heading of a plot of the error about an axis, and the sentence below it."""
    title, about = AXIS_TITLES[axis]
    return f"{title[0].upper()}{title[1:]}", f"{about[0].upper()}{about[1:]}."


def axis_name(axis: str) -> str:
    """Short name of an axis for a column of a table: ``cross x``, ``about boresight``."""
    return axis.replace("_", " ")
