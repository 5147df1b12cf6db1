"""Kernels that find a star's position in the sky by the votes of the stars around it.

An observed star is taken as the pole, as in the grid algorithm of Padgett & Kreutz-Delgado 1997. Every guide pair as
long as its separation from one of its neighbours is one vote: for the guide star that the pole may be, and for the roll
about it, by the difference of the two bearings. True neighbours agree in both; false ones scatter. The pairs of a guide
star and roll with enough votes are the candidates, which the other observed stars have to confirm (`other_stars`)
before one is verified against all (`verification`).

A pole costs one look at the guide pairs of each of its neighbours, where triangles would cost one of each two of them.
The votes of a guide star are counted for 64 rolls at a time, bit by bit: four words hold a digit of all 64 counts each.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from startracker.arrays import FloatArray, Int32Array, IntArray
from startracker.identification.search_plan import MOST_VOTES
from startracker.identification.search_state import Candidates, Guides, Limits, Pairs, Stars
from startracker.identification.triangles import ABERRATION, chord_angle, fits_prior, grown, window
from startracker.kernels import kernel, kernel_part
from startracker.sorting import median

BearingArray = NDArray[np.uint16]

_TURN = 65536
"""Units of a bearing to a turn."""
_ROLL = 1024
"""The same to one of the 64 rolls."""
VOTE_SIGMAS = 2.6
"""A true side is measured within this many standard errors except for 1 in 100, and there are other votes."""
_LEAST_ERRORS = 3.0
"""Least separation, in its errors, for a useful bearing."""
_VOTE_WORK = 8.0


class VoteCounts(NamedTuple):
    """Arrays for the votes about any pole.

    Parameters
    ----------
    there, back : (P,)
        Of `pair_bearings`.
    votes : uint64 (G, 4)
        Scratch: digits of the votes of each guide star for 64 rolls.
    elected : bool (G,)
        Scratch: the guide stars with enough votes.
    head : int32 (G,)
        Scratch, −1 throughout; left so.
    """

    there: BearingArray
    back: BearingArray
    votes: NDArray[np.uint64]
    elected: NDArray[np.bool_]
    head: Int32Array


class _Neighbours(NamedTuple):
    """The stars (L,) that vote about a pole: their separations and bearings, the errors of both (`spread` in parts of
    the separation), the rolls that a vote covers as bits, and the guide pairs of that length."""

    star: IntArray
    separation: FloatArray
    spread: FloatArray
    bearing: IntArray
    slack: IntArray
    pattern: NDArray[np.uint64]
    low: IntArray
    high: IntArray


@kernel_part
def bearing(v: FloatArray, w: FloatArray) -> float:
    """Angle at v from a fixed direction there to w, counted about v, in 65536ths of a turn, −32768 to 32768."""
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
def _bits(turn: int, slack: int, pattern: np.uint64) -> np.uint64:
    """Rolls within `slack` of a turn, one bit each."""
    low = np.uint64(((turn - slack) & (_TURN - 1)) >> 10)
    high = np.uint64(((turn + slack) & (_TURN - 1)) >> 10)
    one = np.uint64(1)
    return (pattern << low) | (pattern >> ((np.uint64(64) - low) & np.uint64(63))) | (one << high)


@kernel_part
def _vote(votes: NDArray[np.uint64], star: int, bits: np.uint64) -> None:
    """Add one to the counts of some rolls; a carry beyond the third digit stays."""
    old = votes[star, 0]
    votes[star, 0] = old ^ bits
    carry = old & bits
    old = votes[star, 1]
    votes[star, 1] = old ^ carry
    carry &= old
    old = votes[star, 2]
    votes[star, 2] = old ^ carry
    votes[star, 3] |= old & carry


@kernel_part
def _neighbours(pole: int, nearest: IntArray, stars: Stars, pairs: Pairs, limits: Limits) -> _Neighbours:
    """Those of the nearest stars whose separation and bearing are useful."""
    n, wide, count = len(nearest), limits.focal_range, 0
    star, separation, spread = np.empty(n, np.int64), np.empty(n), np.empty(n)
    turn, slack, pattern = np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n, np.uint64)
    low, high = np.empty(n, np.int64), np.empty(n, np.int64)
    widest = float(pairs.separation[-1]) if len(pairs.separation) else 0.0
    for j in nearest:
        s = chord_angle(stars.vectors[pole], stars.vectors[j])
        error = limits.scale * VOTE_SIGMAS * math.hypot(stars.sigma[pole], stars.sigma[j]) + ABERRATION * s
        if s < _LEAST_ERRORS * error or s - error > widest:
            continue
        star[count], separation[count], spread[count] = j, s, error / s
        turn[count] = int(bearing(stars.vectors[pole], stars.vectors[j]) + _TURN)
        slack[count] = min(int(error / math.sin(s) * (_TURN / (2.0 * math.pi))) + 1, _TURN // 8)
        pattern[count] = (np.uint64(1) << np.uint64(2 * slack[count] // _ROLL + 1)) - np.uint64(1)
        low[count], high[count] = window(pairs.separation, (s - error) / (1.0 + wide), (s + error) / (1.0 - wide))
        count += 1
    return _Neighbours(
        star[:count], separation[:count], spread[:count], turn[:count], slack[:count], pattern[:count], low, high
    )


@kernel_part
def _mark_elected(neighbours: _Neighbours, need: int, pairs: Pairs, counts: VoteCounts) -> int:
    """Count the votes for each guide star and roll, and mark the stars that have as many as needed; how many."""
    votes, zero, one, count = counts.votes, np.uint64(0), np.uint64(1), 0
    # the count starts so high that the last vote that is needed carries beyond the third digit
    missing = np.uint64(MOST_VOTES - need)
    units, twos, fours = zero - (missing & one), zero - (missing >> one & one), zero - (missing >> np.uint64(2))
    for star in range(len(votes)):
        votes[star, 0], votes[star, 1], votes[star, 2], votes[star, 3] = units, twos, fours, zero
    for k in range(len(neighbours.star)):
        turn, slack, pattern = neighbours.bearing[k], neighbours.slack[k], neighbours.pattern[k]
        for p in range(neighbours.low[k], neighbours.high[k]):
            # unsigned, as no index counts from the end
            _vote(votes, np.uint32(pairs.first[p]), _bits(counts.there[p] - turn, slack, pattern))
            _vote(votes, np.uint32(pairs.second[p]), _bits(counts.back[p] - turn, slack, pattern))
    for star in range(len(votes)):
        counts.elected[star] = votes[star, 3] != zero
        count += counts.elected[star]
    return count


@kernel_part
def _voters(
    pole: int,
    neighbours: _Neighbours,
    stars: Stars,
    sky: Guides,
    pairs: Pairs,
    counts: VoteCounts,
    limits: Limits,
) -> Candidates:
    """Votes (V, 5) for guide stars that have enough of them: the neighbour, the guide stars of pole and neighbour, the
    vote before for the same guide star, and the roll; with ln of the focal length's factor where that is free."""
    rows, focal, count = np.empty((64, 5), np.int32), np.empty(64), 0
    wide = limits.focal_range > 0.0
    for k in range(len(neighbours.star)):
        fainter = stars.magnitude[pole] - stars.magnitude[neighbours.star[k]]
        bearing_there, slack, pattern = neighbours.bearing[k], neighbours.slack[k], neighbours.pattern[k]
        for p in range(neighbours.low[k], neighbours.high[k]):
            for way in range(2):
                a, turn = pairs.first[p], counts.there[p] - bearing_there
                if way == 1:
                    a, turn = pairs.second[p], counts.back[p] - bearing_there
                if not counts.elected[a] or counts.votes[a, 3] & _bits(turn, slack, pattern) == 0:
                    continue
                b = pairs.second[p] if way == 0 else pairs.first[p]
                if abs(fainter - (sky.v_mag[a] - sky.v_mag[b])) > limits.magnitude_tolerance:
                    continue
                if count == len(focal):
                    rows, focal = grown(rows, focal)
                rows[count, 0], rows[count, 1], rows[count, 2] = k, a, b
                rows[count, 3], rows[count, 4] = counts.head[a], turn & (_TURN - 1)
                focal[count] = math.log(neighbours.separation[k] / pairs.separation[p]) if wide else 0.0
                counts.head[a] = count
                count += 1
    return Candidates(rows[:count], focal[:count])


@kernel_part
def _agreeing(x: int, voters: Candidates, neighbours: _Neighbours, head: Int32Array, wide: bool) -> tuple[int, int]:
    """Neighbours' votes, its own included, that agree with a vote in roll and focal length; votes compared."""
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
    """Guide stars that an observed star and one of its neighbours may be, by the votes of all neighbours.

    Parameters
    ----------
    pole : int
        The observed star.
    nearest : (L,)
        Its neighbours.
    need : int
        Votes that must agree.
    stars, sky, pairs, counts, limits
        Observed stars, guide stars and pairs, scratch, limits.

    Returns
    -------
    Pole and neighbour with their guide stars, operations.
    """
    found, focal, count = np.empty((16, 5), np.int32), np.empty(16), 0
    neighbours = _neighbours(pole, nearest, stars, pairs, limits)
    if len(neighbours.star) < need:
        return Candidates(found[:0], focal[:0]), 0.0
    work = 2.0 * len(sky.directions)
    for k in range(len(neighbours.star)):
        work += 1.5 * _VOTE_WORK * (neighbours.high[k] - neighbours.low[k])
    if _mark_elected(neighbours, need, pairs, counts) == 0:
        return Candidates(found[:0], focal[:0]), work
    wide = limits.focal_range > 0.0
    voters = _voters(pole, neighbours, stars, sky, pairs, counts, limits)
    far = median(neighbours.separation.copy())
    for x in range(len(voters.focal)):
        k, a, b = voters.stars[x, 0], voters.stars[x, 1], voters.stars[x, 2]
        if neighbours.separation[k] < far or work > limits.work:
            continue
        agreeing, compared = _agreeing(x, voters, neighbours, counts.head, wide)
        work += 2.0 * compared
        j = neighbours.star[k]
        if agreeing < need or not fits_prior(stars.vectors[pole], sky.directions[a], limits):
            continue
        if not fits_prior(stars.vectors[j], sky.directions[b], limits):
            continue
        if count == len(focal):
            found, focal = grown(found, focal)
        row = found[count]
        row[0], row[1], row[2], row[3], row[4], focal[count] = pole, j, a, b, -1, voters.focal[x]
        count += 1
    for x in range(len(voters.focal)):
        counts.head[voters.stars[x, 1]] = -1
    return Candidates(found[:count], focal[:count]), work + 3.0 * len(voters.focal)
