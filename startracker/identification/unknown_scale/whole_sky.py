"""Stars and patterns of the whole sky, for images whose field of view is not known; made once a process."""

from __future__ import annotations

import functools
import zlib

import numpy as np

from startracker.catalog import cache, load_catalog
from startracker.catalog.guide import GuideDatabase
from startracker.catalog.stars import StarCatalog
from startracker.geometry.camera import Camera
from startracker.identification.unknown_scale.quads import QuadIndex, build_quads, pack_quads, unpack_quads

_MAGNITUDE_LIMIT = 9.0
_REFERENCE = Camera.from_fov(4.0, 1024, 1024)  # the finest: doubles closer than 28″ are one
_CACHE_KEY = "quads-2"


@functools.lru_cache(maxsize=16)
def brightest_stars(catalog: str | StarCatalog, depth: int) -> GuideDatabase:
    """The `depth` brightest of them."""
    return all_stars(catalog).brightest(depth)


@functools.cache
def all_stars(catalog: str | StarCatalog) -> GuideDatabase:
    """Guide stars to V = 9 for every field, brightest first."""
    return GuideDatabase.build(
        load_catalog(catalog) if isinstance(catalog, str) else catalog, _REFERENCE, _MAGNITUDE_LIMIT
    )


@functools.cache
def quad_index(catalog: str | StarCatalog) -> QuadIndex:
    """Patterns of the whole sky; made in about two seconds, then kept in the user's cache folder (24 MB)."""
    stars = all_stars(catalog)
    # the stars' number and positions are part of the name: another edition of the catalogue has another index
    mark = zlib.crc32(np.ascontiguousarray(stars.directions).tobytes())
    key = f"{_CACHE_KEY}-{mark:08x}"
    stored = cache.load_arrays(key)
    if stored is None or not {"codes", "low", "high"} <= stored.keys():
        codes, quads, _ = build_quads(stars.directions)
        stored = pack_quads(codes, quads)
        cache.store_arrays(key, stored)
    return unpack_quads(stored, stars.directions)
