"""Planes of pixels and tables of sources for tests of the detection."""

import numpy as np

from startracker.detection.sources import SOURCE
from startracker.detection.tiles import as_plane


def plane(shape, value):
    """A plane of equal pixels."""
    return as_plane(np.full(shape, value, np.float32))


def objects(count, **columns):
    """A table of sources with these columns, zero elsewhere."""
    table = np.zeros(count, SOURCE)
    for name, values in columns.items():
        table[name] = values
    return table
