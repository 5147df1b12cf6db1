"""Confirmation of a candidate by the other observed stars, and an occupancy map of the sky that rejects it quickly.

Space is divided into cubic cells, and a hash of a cell's indices selects a bit. The bits of all cells near a guide star
are set. A bit that is not set proves that no guide star is within reach; a bit that is set may belong to another cell,
and the guide stars have to be searched.

The other stars are expressed in the frame of the candidate's two stars. Few of them match by chance, so the number of
matches determines which candidates are verified.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker._compiled import kernel, kernel_part
from startracker.catalog.sky_view import SkyView, star_within
from startracker.core import FloatArray
from startracker.identification.search_state import Candidates, Stars

_BITS = 20
"""Base-2 logarithm of the number of bits (128 kB): with 9,000 guide stars and a reach of a milliradian, a tenth of all
directions are in occupied cells."""
_REACHES_PER_CELL = 3.0
_LEAST_REACH, _ROUNDING = 1e-6, 1e-9


class Occupancy(NamedTuple):
    """Bits of all cells with a point within reach of a guide star.

    Parameters
    ----------
    words : uint32 (2^20 / 32,)
        The bits.
    per_unit : float
        Number of cells per unit of length.
    reach2 : float
        Square of the reach; negative if there is no map.
    share : float
        Fraction of the bits that are set, and so of random directions that the map cannot exclude.
    """

    words: NDArray[np.uint32]
    per_unit: float
    reach2: float
    share: float


@kernel_part
def _bit(i: int, j: int, k: int) -> np.uint64:
    """Bit of a cell, a hash from products with large primes (Teschner et al. 2003).

    It is unsigned, because numba checks signed indices for counting from the end.
    """
    return np.uint64((i * 73856093 ^ j * 19349663 ^ k * 83492791) & ((1 << _BITS) - 1))


NO_OCCUPANCY = Occupancy(np.empty(0, np.uint32), 0.0, -1.0, 1.0)
"""Substitute for a map, which excludes nothing."""


@kernel
def occupancy_map(directions: FloatArray, reach: float) -> Occupancy:
    """Map of all cells that have a point within `reach` of one of the directions (G, 3)."""
    words, reach = np.zeros(1 << (_BITS - 5), np.uint32), max(reach, _LEAST_REACH)
    per_unit, beyond = 1.0 / (_REACHES_PER_CELL * reach), reach + _ROUNDING
    low, high, count = np.empty(3, np.int64), np.empty(3, np.int64), 0
    for star in range(len(directions)):
        for axis in range(3):  # + 2: integers are truncated in the same direction on both sides of 0
            low[axis] = int((directions[star, axis] + 2.0 - beyond) * per_unit)
            high[axis] = int((directions[star, axis] + 2.0 + beyond) * per_unit)
        for i in range(low[0], high[0] + 1):
            for j in range(low[1], high[1] + 1):
                for k in range(low[2], high[2] + 1):
                    bit = _bit(i, j, k)
                    word, mark = words[bit >> np.uint64(5)], np.uint32(1) << np.uint32(bit & np.uint64(31))
                    count += (word & mark) == 0
                    words[bit >> np.uint64(5)] = word | mark
    return Occupancy(words, per_unit, reach * reach, count / 2**_BITS)


@kernel_part
def is_occupied(x: float, y: float, z: float, occupancy: Occupancy) -> bool:
    """Whether a direction could be within reach of a guide star."""
    scale = occupancy.per_unit
    bit = _bit(int((x + 2.0) * scale), int((y + 2.0) * scale), int((z + 2.0) * scale))
    occupied: bool = ((occupancy.words[bit >> np.uint64(5)] >> np.uint32(bit & np.uint64(31))) & np.uint32(1)) != 0
    return occupied


_MANY = 100.0
MOST_STARS = 120
"""Number of the brightest stars that are searched and confirm: a hundred false ones may be brighter than the true
ones."""
_RARE = 1e-4


class Others(NamedTuple):
    """Observed stars other than a candidate's own.

    Parameters
    ----------
    along : (3, 120)
        Coordinates along the pair's midpoint, its difference vector, and the normal to both.
    gate2 : (120,)
        Squared gate of each star.
    near : uint8 (120,)
        Scratch: whether a guide star may be within the gate.
    frame : (3, 3)
        Scratch: frame of the pair.
    """

    along: FloatArray
    gate2: FloatArray
    near: NDArray[np.uint8]
    frame: FloatArray


class Confirmation(NamedTuple):
    """Number of other stars that must confirm a candidate, and the cost of the test.

    Parameters
    ----------
    gate : float
        Largest distance to a guide star, in stated errors.
    chance : float
        Largest probability that as many match by chance.
    enough : int
        Number of matches that is sufficient if it occurs by chance in at most 1 of 10,000 candidates.
    occupancy : Occupancy
        Map of the guide stars, if one was computed.
    candidate_work, star_work : float
        Operations per candidate and per other star.
    """

    gate: float
    chance: float
    enough: int
    occupancy: Occupancy
    candidate_work: float
    star_work: float


@kernel
def midpoint_frame(p: FloatArray, q: FloatArray, frame: FloatArray) -> None:
    """Rows of `frame` (3, 3): the midpoint of two directions, their difference, and the normal to both, as unit
    vectors."""
    sx, sy, sz = p[0] + q[0], p[1] + q[1], p[2] + q[2]
    dx, dy, dz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    # The sum and the difference of unit vectors are perpendicular.
    s, d = 1.0 / math.sqrt(sx * sx + sy * sy + sz * sz), 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
    sx, sy, sz, dx, dy, dz = sx * s, sy * s, sz * s, dx * d, dy * d, dz * d
    frame[0, 0], frame[0, 1], frame[0, 2] = sx, sy, sz
    frame[1, 0], frame[1, 1], frame[1, 2] = dx, dy, dz
    frame[2, 0], frame[2, 1], frame[2, 2] = sy * dz - sz * dy, sz * dx - sx * dz, sx * dy - sy * dx


@kernel_part
def room() -> Others:
    """Uninitialised arrays for the other stars."""
    n = MOST_STARS
    return Others(np.empty((3, n)), np.empty(n), np.empty(n, np.uint8), np.empty((3, 3)))


@kernel
def other_stars(j: int, k: int, i: int, stars: Stars, gate: float, others: Others) -> int:
    """Write the brightest stars except j, k and i into `others`, in the frame of the pair j, k; returns their number.

    `gate` is in standard errors. The midpoint of the pair has half the variance of one star, and the bearing of the
    pair an error that increases as the two stars are closer.
    """
    frame, u, w = others.frame, stars.vectors[j], stars.vectors[k]
    midpoint_frame(u, w, frame)
    shared = stars.sigma[j] ** 2 + stars.sigma[k] ** 2
    apart2 = (u[0] - w[0]) ** 2 + (u[1] - w[1]) ** 2 + (u[2] - w[2]) ** 2
    count = 0
    for star in range(len(stars.vectors)):
        if count == MOST_STARS:
            break
        if star == i or star == j or star == k:  # noqa: PLR1714, SIM109  # a tuple costs 0.3 s of compiling
            continue
        x, y, z = stars.vectors[star, 0], stars.vectors[star, 1], stars.vectors[star, 2]
        for axis in range(3):
            others.along[axis, count] = frame[axis, 0] * x + frame[axis, 1] * y + frame[axis, 2] * z
        away2 = others.along[1, count] ** 2 + others.along[2, count] ** 2
        # Variance of a predicted position: a quarter of both stars' for the midpoint, and the lever arm for the
        # bearing.
        others.gate2[count] = gate * gate * (stars.sigma[star] ** 2 + shared * (0.25 + away2 / apart2))
        count += 1
    return count


@kernel_part
def _position(others: Others, star: int, shrink: float) -> tuple[float, float, float]:
    """Direction in the sky of one of the other stars if the pair is at `others.frame`."""
    frame = others.frame
    p, q, r = others.along[0, star], others.along[1, star] * shrink, others.along[2, star] * shrink
    x = p * frame[0, 0] + q * frame[1, 0] + r * frame[2, 0]
    y = p * frame[0, 1] + q * frame[1, 1] + r * frame[2, 1]
    z = p * frame[0, 2] + q * frame[1, 2] + r * frame[2, 2]
    return x, y, z


@kernel
def enough_matches(
    u: FloatArray, w: FloatArray, shrink: float, others: Others, count: int, need: int, sky: SkyView, map_: Occupancy
) -> bool:
    """Whether at least `need` of the `count` other stars are near guide stars if the pair is at `u` and `w`."""
    if need == 0:
        return True
    near, mapped, possible = others.near, map_.reach2 > 0.0, count
    midpoint_frame(u, w, others.frame)
    if mapped:
        possible = 0
        for star in range(count):  # no branches: several stars at a time
            x, y, z = _position(others, star, shrink)
            near[star] = is_occupied(x, y, z, map_) | (others.gate2[star] > map_.reach2)
            possible += near[star]
    matches = 0
    for star in range(count):
        if matches + possible < need:
            return False
        if mapped and not near[star]:
            continue
        possible -= 1
        x, y, z = _position(others, star, shrink)
        if star_within(x, y, z, others.gate2[star], sky.directions, sky.grid):
            matches += 1
            if matches >= need:
                return True
    return False


@kernel_part
def least_matches(mean: float, chance: float) -> int:
    """Fewest matches with a probability of at most `chance` if their expected number by chance is `mean` (Poisson)."""
    # e^−mean would underflow, so the tail of a Gaussian is used.
    if mean > _MANY:
        return int(mean + 5.0 * math.sqrt(mean)) + 1
    term, tail, matches = math.exp(-mean), 1.0, 0
    while tail > chance:
        tail -= term
        matches += 1
        term *= mean / matches
    return matches


@kernel_part
def _attitude_of_pair(stars: Stars, j: int, k: int, focal: float, u: FloatArray, w: FloatArray) -> FloatArray:
    """Attitude (3, 3) that maps the midpoint and the difference of two guide directions onto those of two observed
    stars."""
    out, ends, seen, known = np.zeros((3, 3)), np.empty((2, 3)), np.empty((3, 3)), np.empty((3, 3))
    for axis in range(3):
        ends[0, axis] = stars.vectors[j, axis] + focal * stars.slopes[j, axis]
        ends[1, axis] = stars.vectors[k, axis] + focal * stars.slopes[k, axis]
    midpoint_frame(ends[0], ends[1], seen)
    midpoint_frame(u, w, known)
    for row in range(3):
        for column in range(3):
            for axis in range(3):
                out[row, column] += seen[axis, row] * known[axis, column]
    return out


@kernel
def next_confirmed(
    candidates: Candidates, start: int, stars: Stars, sky: SkyView, confirmation: Confirmation, work: float
) -> tuple[int, FloatArray, float]:
    """First candidate from `start` on that enough other stars confirm.

    Parameters
    ----------
    work : float
        Number of operations after which to stop.

    Returns
    -------
    Its index, or the number of candidates if there is none; its attitude (3, 3); operations.
    """
    others, count, need, taken, last = room(), 0, 0, 0.0, -1
    for c in range(start, len(candidates.focal)):
        row, before = candidates.stars[c], candidates.stars[max(last, 0)]
        j, k, u, w = row[0], row[1], sky.directions[row[2]], sky.directions[row[3]]
        # Successive candidates often have the same pair of observed stars, and then the same frame and limits.
        if last < 0 or j != before[0] or k != before[1] or row[4] != before[4]:
            count, last = other_stars(j, k, row[4], stars, confirmation.gate, others), c
            mean = 0.0
            for star in range(count):
                # Expected matches by chance: solid angle of the gate, π gate², times the density of guide stars, G /
                # 4π.
                mean += 0.25 * others.gate2[star] * len(sky.directions)
            rare = min(least_matches(mean, _RARE), confirmation.enough)
            need = min(max(least_matches(mean, confirmation.chance), rare), count)
        taken += confirmation.candidate_work + confirmation.star_work * count
        if enough_matches(u, w, 1.0 - candidates.focal[c], others, count, need, sky, confirmation.occupancy):
            return c, _attitude_of_pair(stars, j, k, candidates.focal[c], u, w), taken
        if taken > work:
            break
    return len(candidates.focal), others.frame, taken
