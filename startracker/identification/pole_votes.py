"""Kernels that find a star's place in the sky by the votes of the stars around it.

An observed star is taken for the pole, as in the grid algorithm of Padgett & Kreutz-Delgado 1997. Every guide pair as
long as its separation from one of its neighbours says which guide star the pole may be, and by the difference of the
two bearings how the camera is then rolled about it: one vote for that guide star and that roll. True neighbours agree
in both; false ones scatter. Where enough votes meet, the pairs that gave them are attitudes, which the other observed
stars have to confirm before one is verified against all (`verification`).

A pole costs one look at the guide pairs of each of its neighbours, where triangles would cost one of each two of them.
The votes of a guide star are counted for 64 rolls at a time, bit by bit: four words hold a digit of all 64 counts each.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from startracker.catalog.sky_view import SkyView
from startracker.identification.marked_sky import mark_sky, no_marks, share_marked
from startracker.identification.other_stars import enough_hits, least_hits, look_beyond, no_others
from startracker.identification.search_plan import MOST_VOTES
from startracker.identification.search_state import Finds, Limits, Pairs, Stars
from startracker.identification.triangles import (
    ABERRATION,
    attitude_of_pair,
    chord_angle,
    fits_prior,
    weigh_attitude,
    window,
)
from startracker.identification.verification import GATE_SIGMAS
from startracker.kernels import kernel, kernel_with
from startracker.sorting import median

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_TURN = 65536
"""Units of a bearing to a turn."""
_ROLL = 1024
"""The same to one of the 64 rolls."""
VOTE_SIGMAS = 2.6
"""A true side is measured within this many standard errors but for 1 in 100, and there are other votes."""
_LEAST_ERRORS = 3.0
"""Errors of a separation that it must be at least for the bearing to say something."""
_RARE = 1e-4
_MANY_TRIED, _USUAL_LEVER = 60, 3.0
"""Attitudes tried after which the sky is marked, for stars whose place errs by so many of their own errors."""
_VOTE_WORK, _CANDIDATE_WORK, _LOOK_WORK = 8.0, 100.0, 25.0


@kernel
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
def pair_bearings(
    directions: FloatArray, first: NDArray[np.int32], second: NDArray[np.int32]
) -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
    """Bearings (P,) of the second star of each pair at the first, and of the first at the second."""
    there, back = np.empty(len(first), np.uint16), np.empty(len(first), np.uint16)
    for p in range(len(first)):
        v, w = directions[first[p]], directions[second[p]]
        there[p] = int(bearing(v, w) + _TURN) & (_TURN - 1)
        back[p] = int(bearing(w, v) + _TURN) & (_TURN - 1)
    return there, back


@kernel_with(inline="always")
def _bits(turn: int, slack: int, pattern: np.uint64) -> np.uint64:
    """Rolls within `slack` of a turn, one bit each."""
    low = np.uint64(((turn - slack) & (_TURN - 1)) >> 10)
    high = np.uint64(((turn + slack) & (_TURN - 1)) >> 10)
    one = np.uint64(1)
    return (pattern << low) | (pattern >> ((np.uint64(64) - low) & np.uint64(63))) | (one << high)


@kernel_with(inline="always")
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


@kernel
def _more(
    voter: NDArray[np.int32], place: NDArray[np.int32], roll: NDArray[np.int32], focal: FloatArray, size: int
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32], FloatArray]:
    """The same arrays, or longer ones where they have no room for so many votes."""
    n = len(voter)
    if n >= size:
        return voter, place, roll, focal
    more = (
        np.empty(2 * size, np.int32),
        np.empty((2 * size, 3), np.int32),
        np.empty(2 * size, np.int32),
        np.empty(2 * size),
    )
    more[0][:n], more[1][:n], more[2][:n], more[3][:n] = voter, place, roll, focal
    return more


@kernel
def search_poles(
    poles: IntArray,
    nearest: IntArray,
    need: int,
    fewest: int,
    stars: Stars,
    sky: SkyView,
    pairs: Pairs,
    bearings: tuple[NDArray[np.uint16], NDArray[np.uint16]],
    limits: Limits,
    finds: Finds,
    count: int,
) -> tuple[int, int, int, float]:
    """Take observed stars for the pole one after the other.

    Parameters
    ----------
    poles : (T,)
        Observed stars.
    nearest : (N, L)
        The neighbours of each observed star.
    need : int
        Votes that must agree.
    fewest : int
        True stars without which no attitude is accepted.
    stars, sky, pairs, limits
        What was seen, what there is, and what may be done.
    bearings : (P,), (P,)
        Of `pair_bearings`.
    finds, count
        Hypotheses so far, added to.

    Returns
    -------
    number of hypotheses, poles taken, attitudes tried, operations.
    """
    there, back = bearings
    n, wide = len(stars.vectors), limits.focal_range
    votes = np.empty((len(sky.directions), 4), np.uint64)
    separation, members, middle = np.empty(n), np.empty(n, np.int64), np.empty(n)
    low, high = np.empty(n, np.int64), np.empty(n, np.int64)
    seen, slack, pattern = np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n, np.uint64)
    spread = np.empty(n)
    head = np.full(len(sky.directions), -1, np.int32)
    voter, place = np.empty(0, np.int32), np.empty((0, 3), np.int32)
    roll, focal = np.empty(0, np.int32), np.empty(0)
    looked, hits = 0, 0
    others, marks, marked = no_others(), no_marks(), 1.0
    gate, density = GATE_SIGMAS * limits.scale, len(sky.directions) / (4.0 * math.pi)
    widest = float(pairs.separation[-1]) if len(pairs.separation) else 0.0
    work, done, tried, sure = 0.0, 0, 0, False
    for i in poles:
        if sure or work > limits.work:
            break
        done += 1
        neighbours = 0
        for j in nearest[i]:
            s = chord_angle(stars.vectors[i], stars.vectors[j])
            error = limits.scale * VOTE_SIGMAS * math.hypot(stars.sigma[i], stars.sigma[j]) + ABERRATION * s
            if s < _LEAST_ERRORS * error or s - error > widest:
                continue
            separation[neighbours], members[neighbours] = s, j
            low[neighbours], high[neighbours] = window(
                pairs.separation, (s - error) / (1.0 + wide), (s + error) / (1.0 - wide)
            )
            seen[neighbours] = int(bearing(stars.vectors[i], stars.vectors[j]) + _TURN)
            slack[neighbours] = min(int(error / math.sin(s) * (_TURN / (2.0 * math.pi))) + 1, _TURN // 8)
            spread[neighbours] = error / s
            rolls = 2 * slack[neighbours] // _ROLL + 1
            pattern[neighbours] = (np.uint64(1) << np.uint64(rolls)) - np.uint64(1)
            neighbours += 1
        if neighbours < need:
            continue
        for digit in range(3):
            votes[:, digit] = np.uint64(0) - np.uint64(((MOST_VOTES - need) >> digit) & 1)
        votes[:, 3] = 0
        for k in range(neighbours):
            t, e, some = seen[k], slack[k], pattern[k]
            for p in range(low[k], high[k]):
                _vote(votes, pairs.first[p], _bits(there[p] - t, e, some))
                _vote(votes, pairs.second[p], _bits(back[p] - t, e, some))
            work += _VOTE_WORK * (high[k] - low[k])
        work += 2.0 * len(sky.directions)
        voters = 0
        for k in range(neighbours):
            work += 0.5 * _VOTE_WORK * (high[k] - low[k])
            m_ij = stars.magnitude[i] - stars.magnitude[members[k]]
            t, e, some = seen[k], slack[k], pattern[k]
            voter, place, roll, focal = _more(voter, place, roll, focal, voters + 2 * (high[k] - low[k]))
            for p in range(low[k], high[k]):
                for way in range(2):
                    a, turn = (pairs.first[p], there[p] - t) if way == 0 else (pairs.second[p], back[p] - t)
                    if votes[a, 3] & _bits(turn, e, some) == 0:
                        continue
                    b = pairs.second[p] if way == 0 else pairs.first[p]
                    if abs(m_ij - (sky.v_mag[a] - sky.v_mag[b])) > limits.magnitude_tolerance:
                        continue
                    place[voters, 0], place[voters, 1] = a, b
                    voter[voters], roll[voters] = k, turn & (_TURN - 1)
                    focal[voters] = math.log(separation[k] / pairs.separation[p]) if wide > 0.0 else 0.0
                    place[voters, 2] = head[a]
                    head[a] = voters
                    voters += 1
        middle[:neighbours] = separation[:neighbours]
        far = median(middle[:neighbours])
        last = -1
        for x in range(voters):
            k, a, b = voter[x], place[x, 0], place[x, 1]
            if sure or work > limits.work:
                break
            if separation[k] < far:
                continue
            agreeing, y = 1, head[a]
            while y >= 0:
                work += 2.0
                other = voter[y]
                apart = (roll[x] - roll[y] + _TURN // 2) & (_TURN - 1)
                if (
                    other != k
                    and abs(apart - _TURN // 2) <= slack[k] + slack[other]
                    and (wide == 0.0 or abs(focal[x] - focal[y]) <= spread[k] + spread[other])
                ):
                    agreeing += 1
                y = place[y, 2]
            if agreeing < need:
                continue
            u, w = sky.directions[a], sky.directions[b]
            j = members[k]
            if not (fits_prior(stars.vectors[i], u, limits) and fits_prior(stars.vectors[j], w, limits)):
                continue
            tried += 1
            if tried == _MANY_TRIED:
                marks = mark_sky(sky.directions, _USUAL_LEVER * gate * median(stars.sigma.copy()))
                marked = share_marked(marks)
                work += 20.0 * len(sky.directions)
            if k != last:
                looked, last = look_beyond(i, j, i, stars, gate, others), k
                expected = 0.0
                for star in range(looked):
                    expected += math.pi * others.gate2[star] * density
                hits = min(
                    max(least_hits(expected, limits.chance_hits), min(least_hits(expected, _RARE), fewest - 3)), looked
                )
            work += _CANDIDATE_WORK + (1.0 + _LOOK_WORK * marked) * looked
            if not enough_hits(u, w, 1.0 - focal[x], others, looked, hits, sky, marks):
                continue
            before = count
            count, cost = weigh_attitude(
                attitude_of_pair(stars.vectors[i], stars.vectors[j], u, w), focal[x], stars, sky, limits, finds, count
            )
            work += cost
            if count > before and finds.log_b[:count].max() > limits.sure:
                sure = True
        work += 3.0 * voters
        for x in range(voters):
            head[place[x, 0]] = -1
    return count, done, tried, work
