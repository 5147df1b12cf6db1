"""Star catalogues: one immutable table each, loaded by name."""

from __future__ import annotations

import functools

from startracker.catalog.bsc5 import load_bsc5
from startracker.catalog.doubles import merge_doubles
from startracker.catalog.hipparcos import load_hipparcos
from startracker.catalog.stars import StarCatalog
from startracker.registry import lookup

__all__ = ["CATALOGS", "StarCatalog", "load_bsc5", "load_catalog", "load_hipparcos", "merge_doubles"]

CATALOGS = {"bsc5": load_bsc5, "hipparcos": load_hipparcos}
"""Loaders by name; a package adds its own under the entry-point group ``boresight.catalogs``."""


@functools.cache
def load_catalog(name: str) -> StarCatalog:
    """Catalogue by name, read once a process.

    Parameters
    ----------
    name : str
        ``hipparcos`` (117,955 stars to V = 14, milliarcseconds, and the bright stars it lacks) or ``bsc5``
        (9,096 stars to V = 8, arcseconds).

    Raises
    ------
    InputError
        When there is no such catalogue, or its file is missing or damaged.
    """
    return lookup("catalogs", CATALOGS, name)()
