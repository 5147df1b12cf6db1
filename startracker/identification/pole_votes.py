"""Kernels that find a star's position in the sky by the votes of the stars around it.

An observed star is used as the pole, as in the grid algorithm of Padgett & Kreutz-Delgado 1997. Every guide pair whose
separation equals that of the pole from one of its neighbours is one vote: for the guide star that the pole may be, and
for the roll about it, which is the difference of the two bearings. True neighbours agree in both; false ones scatter.
Guide stars and rolls with enough votes are candidates, which the other observed stars have to confirm (`other_stars`)
before one is verified against all (`verification`).

For each neighbour, a pole needs one search of the guide pairs, while triangles need one for each two neighbours. Few
votes agree by chance. All votes are counted for 32 sectors of the roll, or for 16 if more than three must agree, in one
64-bit word for each guide star. Votes in sectors with enough of them are counted again for 64 rolls, where each of four
words holds one binary digit of all 64 counts.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker._compiled import kernel, kernel_part
from startracker.core import FloatArray, Int32Array, IntArray
from startracker.identification.search_plan import MOST_VOTES
from startracker.identification.search_state import Candidates, Guides, Limits, Pairs, Stars
from startracker.identification.triangles import ABERRATION, chord_angle, fits_prior, window
from startracker.sorting import median

BearingArray = NDArray[np.uint16]

_TURN = 65536
"""Units of a bearing per turn."""
_CELL, _ROLL, _SECTOR, _WIDE_SECTOR = 8, 10, 11, 12
"""Widths in bits: of a bearing within a row of the table of bearings, of one of the 64 rolls, of one of the 32 sectors,
and of one of the 16."""
_CELLS = _TURN >> _CELL
_EVERY, _SECOND, _FOURTH = np.uint64(2**64 - 1), np.uint64((2**64 - 1) // 3), np.uint64((2**64 - 1) // 15)
"""Words with every bit set, every second, and every fourth: one bit for each of 64 rolls, 32 sectors, 16 sectors."""
VOTE_SIGMAS = 2.6
"""Standard errors within which a true side is measured: 1 in 100 is lost, and there are other votes."""
_LEAST_ERRORS = 3.0
"""Least separation, in units of its error, at which a bearing is useful."""
_VOTE_WORK = 8.0


class VoteCounts(NamedTuple):
    """Arrays for the votes about any pole.

    Parameters
    ----------
    there, back : (P,)
        Results of `pair_bearings`.
    sectors : uint64 (G,)
        Scratch: votes for each guide star in 32 sectors of two bits, or in 16 of four bits.
    votes : uint64 (G, 4)
        Scratch: digits of the votes for each guide star in 64 rolls.
    head : int32 (G,)
        Scratch: all −1 on entry and on return.
    """

    there: BearingArray
    back: BearingArray
    sectors: NDArray[np.uint64]
    votes: NDArray[np.uint64]
    head: Int32Array


class _Neighbours(NamedTuple):
    """Stars (L,) that vote about a pole.

    How much fainter each is, separations and bearings, the errors of both (`spread` relative to the separation), the
    sectors that votes cover as bits, for guide pairs with a bearing in each 256th of a turn, and the ranges of guide
    pairs with that separation.
    """

    star: IntArray
    fainter: FloatArray
    separation: FloatArray
    spread: FloatArray
    bearing: IntArray
    slack: IntArray
    covered: NDArray[np.uint64]
    low: IntArray
    high: IntArray


@kernel_part
def bearing(v: FloatArray, w: FloatArray) -> float:
    """Bearing of w at v, counted about v from a fixed direction there, in 65536ths of a turn, −32768 to 32768."""
    if abs(v[2]) < 0.9:
        x, y, z = -v[1], v[0], 0.0
    else:
        x, y, z = 0.0, -v[2], v[1]
    h = math.sqrt(x * x + y * y + z * z)
    x, y, z = x / h, y / h, z / h
    along = x * w[0] + y * w[1] + z * w[2]
    across = (v[1] * z - v[2] * y) * w[0] + (v[2] * x - v[0] * z) * w[1] + (v[0] * y - v[1] * x) * w[2]
    return math.atan2(across, along) * (_TURN / (2.0 * math.pi))


@kernel
def pair_bearings(directions: FloatArray, first: Int32Array, second: Int32Array) -> tuple[BearingArray, BearingArray]:
    """Bearings (P,) of the second star of each pair at the first, and of the first at the second."""
    there, back = np.empty(len(first), np.uint16), np.empty(len(first), np.uint16)
    for out, here, other in ((there, first, second), (back, second, first)):
        for p in range(len(first)):
            out[p] = int(bearing(directions[here[p]], directions[other[p]]) + _TURN) & (_TURN - 1)
    return there, back


@kernel_part
def _bits(low: int, width: int, size: int, every: np.uint64) -> np.uint64:
    """Sectors of width 2^`size` that overlap the bearings from `low` to `low + width`; `every` has one bit per
    sector."""
    one, step = np.uint64(1), size - _ROLL
    first = np.uint64((low & (_TURN - 1)) >> size << step)
    last = np.uint64(((low + width) & (_TURN - 1)) >> size << step)
    # Set the bits of the sectors from 0, rotate the word to the first sector, and add the last one, which may be cut
    # off.
    pattern = every & ((one << np.uint64((width >> size) + 1 << step)) - one)
    return (pattern << first) | (pattern >> ((np.uint64(64) - first) & np.uint64(63))) | (one << last)


@kernel_part
def _vote(votes: NDArray[np.uint64], star: int, bits: np.uint64) -> None:
    """Add one to the counts of the rolls in `bits`: a binary adder for 64 counters; overflow is recorded in word 3."""
    old = votes[star, 0]
    votes[star, 0] = old ^ bits
    carry = old & bits
    old = votes[star, 1]
    votes[star, 1] = old ^ carry
    carry &= old
    old = votes[star, 2]
    votes[star, 2] = old ^ carry
    votes[star, 3] |= old & carry


@kernel
def _neighbours(pole: int, nearest: IntArray, need: int, stars: Stars, pairs: Pairs, limits: Limits) -> _Neighbours:
    """Those of the nearest stars whose separation and bearing are useful."""
    n, wide, count = len(nearest), limits.focal_range, 0
    star, fainter, separation, spread = np.empty(n, np.int64), np.empty(n), np.empty(n), np.empty(n)
    turn, slack, covered = np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n * _CELLS, np.uint64)
    low, high = np.empty(n, np.int64), np.empty(n, np.int64)
    size, every = (_SECTOR, _SECOND) if need <= 3 else (_WIDE_SECTOR, _FOURTH)
    widest = float(pairs.separation[-1]) if len(pairs.separation) else 0.0
    for j in nearest:
        s = chord_angle(stars.vectors[pole], stars.vectors[j])
        error = limits.scale * VOTE_SIGMAS * math.hypot(stars.sigma[pole], stars.sigma[j]) + ABERRATION * s
        if s < _LEAST_ERRORS * error or s - error > widest:
            continue
        star[count], separation[count], spread[count] = j, s, error / s
        fainter[count] = stars.magnitude[pole] - stars.magnitude[j]
        turn[count] = int(bearing(stars.vectors[pole], stars.vectors[j]) + _TURN)
        slack[count] = min(int(error / math.sin(s) * (_TURN / (2.0 * math.pi))) + 1, _TURN // 8)
        start, again, shift = count * _CELLS, 1 << size - _CELL, np.uint64(1 << size - _ROLL)
        for cell in range(again):
            least = (cell << _CELL) - turn[count] - slack[count]
            covered[start + cell] = _bits(least, 2 * slack[count] + (1 << _CELL) - 1, size, every)
        # The next sectors are those of a bearing one sector further, so the words are rotated rather than computed
        # again.
        for cell in range(start + again, start + _CELLS):
            bits = covered[cell - again]
            covered[cell] = (bits << shift) | (bits >> (np.uint64(64) - shift))
        low[count], high[count] = window(pairs.separation, (s - error) / (1.0 + wide), (s + error) / (1.0 - wide))
        count += 1
    return _Neighbours(star[:count], fainter, separation[:count], spread, turn, slack, covered, low, high)


@kernel
def _count_sectors(neighbours: _Neighbours, need: int, pairs: Pairs, counts: VoteCounts) -> int:
    """Count the votes for each guide star and sector, and mark sectors that may have enough; returns the number of
    votes."""
    sectors, there, back, covered, total = counts.sectors, counts.there, counts.back, neighbours.covered, 0
    few, one, highest = need <= 3, np.uint64(1), _FOURTH << np.uint64(3)
    # Counters of two bits count to three, and start at 1 if two votes are sufficient; counters of four bits start so
    # high that the last vote that is needed sets the fourth bit.
    start = _SECOND * np.uint64(3 - need) if few else _FOURTH * np.uint64(MOST_VOTES - need)
    for star in range(len(sectors)):
        sectors[star] = start
    for k in range(len(neighbours.star)):
        total += 2 * (neighbours.high[k] - neighbours.low[k])
        for p in range(neighbours.low[k], neighbours.high[k]):
            for way in range(2):
                # unsigned, because numba lets signed indices count from the end
                guide = np.uint32(pairs.first[p] if way == 0 else pairs.second[p])
                bits = covered[np.uint32(k * _CELLS + ((there[p] if way == 0 else back[p]) >> _CELL))]
                old = sectors[guide]
                if few:
                    carry = old & bits
                    sectors[guide] = (old ^ bits) | ((old >> one) & carry) | (carry << one)
                else:
                    sectors[guide] = ((old & ~highest) + bits) | (old & highest)
    for star in range(len(sectors)):
        sectors[star] = sectors[star] & (sectors[star] >> one) if few else sectors[star] >> np.uint64(3)
    return total


@kernel
def _in_full_sectors(neighbours: _Neighbours, total: int, pairs: Pairs, counts: VoteCounts) -> Int32Array:
    """Votes (V, 5), of `total`, that are in sectors with enough of them.

    Columns: the neighbour, the guide stars of pole and neighbour, the guide pair, and the roll.
    """
    rows, count = np.empty((total + 1, 5), np.int32), 0
    sectors, there, back, covered = counts.sectors, counts.there, counts.back, neighbours.covered
    for k in range(len(neighbours.star)):
        for p in range(neighbours.low[k], neighbours.high[k]):
            for way in range(2):
                a, turn = np.uint32(pairs.first[p] if way == 0 else pairs.second[p]), there[p] if way == 0 else back[p]
                if sectors[a] & covered[np.uint32(k * _CELLS + (turn >> _CELL))] != 0:
                    rows[count, 0], rows[count, 1], rows[count, 3] = k, a, p
                    rows[count, 2] = pairs.second[p] if way == 0 else pairs.first[p]
                    rows[count, 4] = (turn - neighbours.bearing[k]) & (_TURN - 1)
                    count += 1
    return rows[:count]


@kernel
def _voters(
    rows: Int32Array,
    neighbours: _Neighbours,
    need: int,
    sky: Guides,
    pairs: Pairs,
    counts: VoteCounts,
    limits: Limits,
) -> Candidates:
    """Votes (V, 5) whose guide star has enough votes for a roll, and ln of the focal-length factor if it is free.

    The guide pair is replaced by the index of the preceding vote for the same guide star, which makes a chain.
    """
    focal, votes, count, wide = np.empty(len(rows)), counts.votes, 0, limits.focal_range > 0.0
    # The count starts so high that the last vote that is needed overflows the third digit.
    missing, zero, one = np.uint64(MOST_VOTES - need), np.uint64(0), np.uint64(1)
    for x in range(len(rows)):
        a = rows[x, 1]
        votes[a, 0], votes[a, 1] = zero - (missing & one), zero - (missing >> one & one)
        votes[a, 2], votes[a, 3] = zero - (missing >> np.uint64(2)), zero
    for x in range(len(rows)):
        slack = neighbours.slack[rows[x, 0]]
        _vote(votes, rows[x, 1], _bits(rows[x, 4] - slack, 2 * slack, _ROLL, _EVERY))
    for x in range(len(rows)):
        k, a, b, p, roll = rows[x, 0], rows[x, 1], rows[x, 2], rows[x, 3], rows[x, 4]
        slack = neighbours.slack[k]
        if votes[a, 3] & _bits(roll - slack, 2 * slack, _ROLL, _EVERY) == 0:
            continue
        if abs(neighbours.fainter[k] - (sky.v_mag[a] - sky.v_mag[b])) > limits.magnitude_tolerance:
            continue
        rows[count, 0], rows[count, 1], rows[count, 2], rows[count, 3], rows[count, 4] = k, a, b, counts.head[a], roll
        focal[count] = math.log(neighbours.separation[k] / pairs.separation[p]) if wide else 0.0
        counts.head[a] = count
        count += 1
    return Candidates(rows[:count], focal[:count])


@kernel_part
def _agreeing(x: int, voters: Candidates, neighbours: _Neighbours, head: Int32Array, wide: bool) -> tuple[int, int]:
    """Number of neighbours' votes, including its own, that agree with a vote in roll and focal length; and
    comparisons."""
    rows, focal = voters.stars, voters.focal
    k, agreeing, compared, y = rows[x, 0], 1, 0, head[rows[x, 1]]
    while y >= 0:
        other = rows[y, 0]
        apart = (rows[x, 4] - rows[y, 4] + _TURN // 2) & (_TURN - 1)
        agreeing += (
            other != k
            and abs(apart - _TURN // 2) <= neighbours.slack[k] + neighbours.slack[other]
            and (not wide or abs(focal[x] - focal[y]) <= neighbours.spread[k] + neighbours.spread[other])
        )
        compared += 1
        y = rows[y, 3]
    return agreeing, compared


@kernel
def vote_about(
    pole: int, nearest: IntArray, need: int, stars: Stars, sky: Guides, pairs: Pairs, counts: VoteCounts, limits: Limits
) -> tuple[Candidates, float]:
    """Guide stars that an observed star and one of its neighbours may be, from the votes of all neighbours.

    Parameters
    ----------
    pole : int
        The observed star.
    nearest : (L,)
        Its neighbours.
    need : int
        Number of votes that must agree.
    stars, sky, pairs, counts, limits
        Observed stars, guide stars and pairs, scratch arrays, limits.

    Returns
    -------
    Candidates of pole and neighbour with their guide stars; operations.
    """
    neighbours = _neighbours(pole, nearest, need, stars, pairs, limits)
    if len(neighbours.star) < need:
        return Candidates(np.empty((0, 5), np.int32), np.empty(0)), 0.0
    total = _count_sectors(neighbours, need, pairs, counts)
    work, wide = 2.0 * len(sky.directions) + 0.75 * _VOTE_WORK * total, limits.focal_range > 0.0
    rows = _in_full_sectors(neighbours, total, pairs, counts)
    voters = _voters(rows, neighbours, need, sky, pairs, counts, limits)
    found, focal, count = np.empty((len(voters.focal), 5), np.int32), np.empty(len(voters.focal)), 0
    far = median(neighbours.separation.copy())
    for x in range(len(voters.focal)):
        k, a, b = voters.stars[x, 0], voters.stars[x, 1], voters.stars[x, 2]
        # Only the farther half of the neighbours forms candidates, because a longer baseline determines the attitude
        # better.
        if neighbours.separation[k] < far or work > limits.work:
            continue
        agreeing, compared = _agreeing(x, voters, neighbours, counts.head, wide)
        work += 2.0 * compared
        j = neighbours.star[k]
        if agreeing < need or not fits_prior(stars.vectors[pole], sky.directions[a], limits):
            continue
        if not fits_prior(stars.vectors[j], sky.directions[b], limits):
            continue
        row = found[count]
        row[0], row[1], row[2], row[3], row[4], focal[count] = pole, j, a, b, -1, voters.focal[x]
        count += 1
    for x in range(len(voters.focal)):
        counts.head[voters.stars[x, 1]] = -1
    return Candidates(found[:count], focal[:count]), work + 3.0 * len(voters.focal)
