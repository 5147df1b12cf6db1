"""Table of four-star patterns of the whole sky, found by their shape in constant time.

The shape of a pattern is given by its five smaller edges divided by the largest, ascending, which do not depend on
rotation, shift and scale. The binned ratios form the key of an open-addressing hash table with linear probing; patterns
with the same key follow each other.

Choice of patterns: the camera is placed at attitudes on a lattice that covers the sky, and four-star sets of the
brightest pattern stars of each field are entered, brightest first. So an image's brightest stars are in the table for
every attitude, and sparse fields are entered with all their stars.

Source of the method: tetra3's documentation (Pettersson 2019, ESA) after Brown, Stubis & Cahoy 2017, "TETRA: Star
identification with hash tables"; the choice of patterns by the camera's own fields is ours.
"""

from __future__ import annotations

import hashlib
import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from startracker._compiled import kernel, kernel_part
from startracker.catalog import cache
from startracker.catalog.guide import GuideDatabase, field_of
from startracker.catalog.stars import StarCatalog
from startracker.core import FloatArray, IntArray
from startracker.geometry.camera import Camera
from startracker.geometry.linalg import chord

FORMAT = 1
BINS = 32
"""Number of bins for each ratio of edges: a key has 5 × 5 bits and cannot equal the mark of an empty slot."""
EMPTY = np.uint32(0xFFFFFFFF)
LOAD = 0.62
SMALLEST = 0.12
"""Least extent of a pattern, as a share of the field's diagonal: the shape of a smaller one is too uncertain."""
SIZE_STEPS = 65535
PATTERNS_PER_FIELD = 500
FEWEST_PATTERNS = 120_000
MOST_PATTERNS = 800_000
WHOLE = 6
"""Number of the brightest stars of a field of which all sets are entered."""
SHARES = ((0.3, 1.0), (0.0, 1.0), (0.0, 0.8), (0.0, 0.6), (0.0, 0.5), (0.0, 0.4))
"""For each further star, the shares of the sets with it that are entered: of any size, and compact ones."""
STARS_OF_FIELD = WHOLE + len(SHARES)
COMPACT = 0.45
"""Largest extent of a compact pattern, as a share of the field's diagonal."""
_MOST_NUMBER = 65535
_SAMPLE = 0.05
_STEP = 0.18  # of the field's width, from one attitude of the lattice to the next
_FEWEST_FIELDS, _MOST_FIELDS = 4_000, 30_000


class PatternTable(NamedTuple):
    """Hash table of patterns in the form that kernels read.

    Parameters
    ----------
    keys : uint32 (S,)
        Key of the pattern in each slot; `EMPTY` for a free slot.
    stars : uint16 (S, 4)
        Its stars as indices into `members`, ascending.
    sizes : uint16 (S,)
        Its largest edge in steps of `largest` / `SIZE_STEPS`.
    members : int32 (P,)
        Guide star of each pattern star.
    largest : float
        Chord of the field's diagonal.
    """

    keys: NDArray[np.uint32]
    stars: NDArray[np.uint16]
    sizes: NDArray[np.uint16]
    members: NDArray[np.int32]
    largest: float

    @property
    def patterns(self) -> int:
        """Number of patterns."""
        return int(np.count_nonzero(self.keys != EMPTY))

    @property
    def nbytes(self) -> int:
        """Size of the arrays in bytes."""
        return self.keys.nbytes + self.stars.nbytes + self.sizes.nbytes + self.members.nbytes


@kernel_part
def sorted_edges(a: float, b: float, c: float, d: float, e: float, f: float, out: FloatArray) -> None:
    """The six edges of a pattern, ascending, into `out` (6,)."""
    out[0], out[1], out[2], out[3], out[4], out[5] = a, b, c, d, e, f
    for i in range(1, 6):
        value, j = out[i], i - 1
        while j >= 0 and out[j] > value:
            out[j + 1] = out[j]
            j -= 1
        out[j + 1] = value


@kernel_part
def shape_key(edges: FloatArray) -> int:
    """Key of six ascending edges (6,): the binned ratios of five of them to the largest."""
    key = 0
    for k in range(5):
        key = key * BINS + min(int(edges[k] / edges[5] * BINS), BINS - 1)
    return key


@kernel_part
def home_slot(key: int, slots: int) -> np.int64:
    """Slot at which the search for a key begins: Fibonacci hashing (Knuth 1998, section 6.4), for any table size."""
    mixed = (np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)) >> np.uint64(32)
    return np.int64((mixed * np.uint64(slots)) >> np.uint64(32))


@kernel
def insert(
    patterns: NDArray[np.int32],
    directions: FloatArray,
    largest: float,
    keys: NDArray[np.uint32],
    stars: NDArray[np.uint16],
    sizes: NDArray[np.uint16],
) -> None:
    """Insert patterns (Q, 4) of unit vectors (P, 3) into an empty table, in which at least one slot must stay free."""
    edge, edges = np.empty((4, 4)), np.empty(6)
    slots = len(keys)
    for q in range(len(patterns)):
        a, b, c, d = patterns[q, 0], patterns[q, 1], patterns[q, 2], patterns[q, 3]
        for i in range(4):
            for j in range(i):
                edge[i, j] = chord(directions[patterns[q, i]], directions[patterns[q, j]])
        sorted_edges(edge[1, 0], edge[2, 0], edge[3, 0], edge[2, 1], edge[3, 1], edge[3, 2], edges)
        key = shape_key(edges)
        slot = home_slot(key, slots)
        while keys[slot] != EMPTY:
            slot = slot + 1 if slot + 1 < slots else 0
        keys[slot] = key
        stars[slot, 0], stars[slot, 1], stars[slot, 2], stars[slot, 3] = a, b, c, d
        sizes[slot] = min(int(edges[5] / largest * SIZE_STEPS + 0.5), SIZE_STEPS)


# ---------------------------------------------------------------------- which patterns
def field_attitudes(camera: Camera) -> FloatArray:
    """Attitudes (F, 3, 3), ICRS to camera, whose fields cover the sky.

    The boresights form a Fibonacci lattice; the roll of each differs from the one before by an irrational part of a
    turn.
    """
    half_diagonal, area = field_of(camera)
    width = min(math.sqrt(area), half_diagonal)
    count = int(min(max(4.0 * math.pi / (_STEP * width) ** 2, _FEWEST_FIELDS), _MOST_FIELDS))
    k = np.arange(count) + 0.5
    golden = (1.0 + math.sqrt(5.0)) / 2.0
    z = 1.0 - 2.0 * k / count
    longitude = 2.0 * math.pi * ((k / golden) % 1.0)
    ring = np.sqrt(1.0 - z**2)
    axis = np.stack([ring * np.cos(longitude), ring * np.sin(longitude), z], axis=1)
    east = np.stack([-np.sin(longitude), np.cos(longitude), np.zeros(count)], axis=1)
    north = np.cross(axis, east)
    roll = 2.0 * math.pi * ((k * (math.sqrt(2.0) - 1.0)) % 1.0)[:, None]
    x = np.cos(roll) * east + np.sin(roll) * north
    return np.stack([x, np.cross(axis, x), axis], axis=1)


def stars_of_fields(directions: FloatArray, camera: Camera, most: int) -> IntArray:
    """Indices (F, most) of the brightest stars on the image at each attitude of the lattice, ascending; −1 for none.

    Parameters
    ----------
    directions : (P, 3)
        Unit vectors, brightest first.
    """
    attitudes = field_attitudes(camera)
    half_diagonal, _ = field_of(camera)
    tree = cKDTree(directions)
    reach = 2.0 * math.sin(min(half_diagonal * 1.01, math.pi) / 2.0)
    out = np.full((len(attitudes), most), -1, dtype=np.int64)
    for start in range(0, len(attitudes), 1000):  # bounds the memory of wide fields
        block = attitudes[start : start + 1000]
        near = tree.query_ball_point(block[:, 2], reach, return_sorted=True)
        field = np.repeat(np.arange(len(block)), [len(rows) for rows in near])
        star = np.concatenate([np.asarray(rows, dtype=np.int64) for rows in near])
        vectors = np.einsum("kij,kj->ki", block[field], directions[star])
        inside = camera.contains(camera.project(vectors), 0.0)
        field, star = field[inside], star[inside]
        first = np.searchsorted(field, np.arange(len(block)))
        rank = np.arange(len(field)) - first[field]
        few = rank < most
        out[start + field[few], rank[few]] = star[few]
    return out


@kernel
def pack_patterns(
    fields: IntArray, directions: FloatArray, level: int, share: float, smallest: float, widest: float
) -> NDArray[np.uint64]:
    """Four-star sets whose faintest star has the index `level` in a field, packed into words; sets may be repeated.

    Of the sets whose extent is within the limits (chords), those with the lowest hashes are selected, up to `share`, so
    that neighbouring fields select the same sets.
    """
    out = np.empty(max(len(fields), 1) * 8, np.uint64)
    count = 0
    edge = np.empty((level + 1, level + 1))
    limit = np.uint64(min(share, 1.0) * 4294967295.0)
    for f in range(len(fields)):
        if fields[f, level] < 0:
            continue
        for i in range(level + 1):
            for j in range(i):
                edge[i, j] = chord(directions[fields[f, i]], directions[fields[f, j]])
        for c in range(2, level):
            for b in range(1, c):
                for a in range(b):
                    extent = max(edge[b, a], edge[c, a], edge[c, b], edge[level, a], edge[level, b], edge[level, c])
                    if extent < smallest or extent > widest:
                        continue
                    word = np.uint64(fields[f, a])
                    for star in (fields[f, b], fields[f, c], fields[f, level]):
                        word = (word << np.uint64(16)) | np.uint64(star)
                    # A mixing function makes the hash independent of the star numbers, so that the selection is random.
                    mixed = (word ^ (word >> np.uint64(31))) * np.uint64(0x9E3779B97F4A7C15)
                    mixed = (mixed ^ (mixed >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9)
                    if (mixed >> np.uint64(32)) > limit:
                        continue
                    if count == len(out):
                        out = np.concatenate((out, np.empty_like(out)))
                    out[count] = word
                    count += 1
    return out[:count]


def choose_patterns(directions: FloatArray, camera: Camera) -> NDArray[np.int32]:
    """Patterns (Q, 4) of stars of `directions` (P, 3; brightest first), the brightest of each field first.

    All sets of the `WHOLE` brightest stars of each field are included. Of the sets with a fainter star a share is
    sufficient, because a field has hundreds. Most of these are compact: a small pattern lies completely within more
    fields than a large one, so that the same memory serves more fields. The number is limited in proportion to the
    number of fields that tile the sky.
    """
    half_diagonal, area = field_of(camera)
    wanted = int(min(max(PATTERNS_PER_FIELD * 4.0 * math.pi / area, FEWEST_PATTERNS), MOST_PATTERNS))
    fields = stars_of_fields(directions, camera, STARS_OF_FIELD)
    # A slot has 16 bits for a star; the stars beyond are the faintest.
    fields[fields > _MOST_NUMBER] = -1
    diagonal = 2.0 * math.sin(min(half_diagonal, math.pi / 2))
    smallest = SMALLEST * diagonal

    def further(share: float) -> NDArray[np.uint64]:
        parts = [first]
        for level, (all_sizes, compact) in enumerate(SHARES, WHOLE):
            parts.append(pack_patterns(fields, directions, level, share * all_sizes, smallest, diagonal))
            parts.append(pack_patterns(fields, directions, level, share * compact, smallest, COMPACT * diagonal))
        return np.unique(np.concatenate(parts))

    whole = [pack_patterns(fields, directions, level, 1.0, smallest, diagonal) for level in range(3, WHOLE)]
    first = np.unique(np.concatenate(whole))
    if len(first) >= wanted:
        words = first[np.linspace(0, len(first) - 1, wanted).astype(np.int64)]
    else:
        # The size of a small sample determines how large a share fits.
        sample = len(further(_SAMPLE)) - len(first)
        share = min(1.0, _SAMPLE * (wanted - len(first)) / max(sample, 1))
        words = further(share)
    return np.stack([(words >> np.uint64(16 * k)) & np.uint64(_MOST_NUMBER) for k in (3, 2, 1, 0)], axis=1).astype(
        np.int32
    )


def build_table(directions: FloatArray, members: NDArray[np.int32], camera: Camera) -> PatternTable:
    """Table of a camera's patterns.

    Parameters
    ----------
    directions : (P, 3)
        Unit vectors of the pattern stars, brightest first.
    members : int32 (P,)
        Guide star of each pattern star.
    camera : Camera
    """
    patterns = choose_patterns(directions, camera)
    slots = int(len(patterns) / LOAD) + 16
    largest = 2.0 * math.sin(min(field_of(camera)[0], math.pi / 2))
    keys = np.full(slots, EMPTY, dtype=np.uint32)
    stars = np.zeros((slots, 4), dtype=np.uint16)
    sizes = np.zeros(slots, dtype=np.uint16)
    insert(patterns, directions, largest, keys, stars, sizes)
    return PatternTable(keys, stars, sizes, members, largest)


# ---------------------------------------------------------------------- kept between runs
def pattern_table(guide: GuideDatabase) -> PatternTable:
    """Table of a guide database's catalogue directions: from memory, from the user's cache folder, or computed."""
    return _table(guide.catalog, guide.camera, guide.pattern.tobytes())


@lru_cache(maxsize=8)
def _table(catalog: StarCatalog, camera: Camera, pattern: bytes) -> PatternTable:
    members = np.flatnonzero(np.frombuffer(pattern, dtype=bool)).astype(np.int32)
    directions = catalog.directions(catalog.epoch_jyear)[members]
    settings = f"{FORMAT} {_STEP} {BINS} {LOAD} {SMALLEST} {WHOLE} {SHARES} {COMPACT} {PATTERNS_PER_FIELD} {camera!r}"
    print_of = hashlib.sha256(settings.encode() + pattern + np.round(directions, 9).tobytes()).hexdigest()[:20]
    key = f"patterns-{print_of}"
    table = load(key, members)
    if table is None:
        table = build_table(directions, members, camera)
        store(key, table)
    return table


def load(key: str, members: NDArray[np.int32]) -> PatternTable | None:
    """Table stored under `key`; None if there is none or it is unusable."""
    stored = cache.load_arrays(key)
    try:
        if stored is None:
            return None
        table = PatternTable(stored["keys"], stored["stars"], stored["sizes"], members, float(stored["largest"]))
        return table if str(stored["digest"]) == _digest(table) else None
    except (KeyError, ValueError):
        return None


def store(key: str, table: PatternTable) -> None:
    """Store a table under `key`."""
    arrays = {name: np.asarray(getattr(table, name)) for name in ("keys", "stars", "sizes", "largest")}
    cache.store_arrays(key, {**arrays, "digest": np.array(_digest(table))})


def _digest(table: PatternTable) -> str:
    parts = (table.keys, table.stars, table.sizes, table.members)
    return hashlib.sha256(b"".join(np.ascontiguousarray(p).tobytes() for p in parts)).hexdigest()
