"""Triads as the source of hypotheses (Yee 1999, section 2.3.4), in integers.

1. Three observed stars may be three guide stars if sides, sense and inner angles of their triangles agree, and two
   sides are turned alike against the celestial pole. The first star of a triangle is a pole (`votes`): two votes for a
   guide star are two sides, and a triad if the third one agrees.
2. Triads are grouped by their mean rotation: a triad joins the first group whose running mean is near.
3. The largest group first, its triads are votes for what each star is; the winners with the most disagreeing
   separations are dropped. Two of at least three that are left, those farthest apart, give the attitude that is
   verified.

`startracker.identification.triads` is the same in floating point, but for stars that are not resolved: guide stars with
a close neighbour are in no pair here. Angles are degrees of 10.6. The C (`c/triads/`) performs the same operations.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from startracker.core import IntArray
from startracker.fixed_point.arithmetic import FULL_TURN, inner_angles
from startracker.fixed_point.cordic import FINE_BITS, fine_angles
from startracker.fixed_point.formats import ANGLE
from startracker.flight.hypotheses import SURE_BEYOND, Work, pair_frame
from startracker.flight.search_plan import Search
from startracker.flight.triad_numbers import MOST_CHECKED, MOST_GROUPS, MOST_NAMED, TriadNumbers
from startracker.flight.votes import Ballot, as_long, neighbours_of, same_star, triangles_agree
from startracker.identification.triad_search import group_rotations

VOTE_STEPS, TRIAD_STEPS = 3, 300
"""Of two votes that are compared, and of three sides that agree."""
_ANGLE_SHIFT = FINE_BITS - ANGLE.fraction_bits
_SIDES_BITS = 10
"""Of `Search.sides`: 4 standard errors, 8 fraction bits."""


def group_steps(triads: int, members: int, named: int) -> int:
    """Steps of the votes of a group."""
    return (2 * triads + 3 * members * named) >> 3


class TriadWork(Work):
    """Searches of one identification: triads, groups, votes."""

    @property
    def numbers(self) -> TriadNumbers:
        """Limits of the triads."""
        assert self.tables.triads is not None
        return self.tables.triads

    def run(self, search: Search) -> None:
        """One search."""
        if not self._tried(search):
            return
        t, most = self.numbers, self.steps + search.steps
        found = [np.empty((0, 7), np.int64)]
        for pole in range(min(t.stars, len(self.seen)) - 2):
            self._about(pole, search, most, found)
        triads = np.concatenate(found)
        self.pool.cut_short |= self._is_over(most, found)
        self._try_groups(triads[: t.room], search)

    def _tried(self, search: Search) -> bool:
        """Whether the errors that a search assumes are a small share of the field for half of the stars, or stated."""
        largest = (self.numbers.widest << _SIDES_BITS) // search.sides
        return search is self.tables.searches[0] or 2 * int((self.seen.variance <= largest**2).sum()) >= len(self.seen)

    def _about(self, pole: int, search: Search, most: int, found: list[IntArray]) -> None:
        """Add triads (T, 7) whose first star is a pole: three stars, three guide stars, mean rotation."""
        if self._is_over(most, found):
            return
        near = neighbours_of(pole, pole + 1, self.sides, search, self.tables)
        if len(near.star) < search.need:
            return
        ballot = Ballot(pole, near, self.seen, search.need, self.tables)
        self.steps += len(self.tables.guide) + 2 * ballot.looked
        while not self._is_over(most, found) and (votes := ballot.part()) is not None:
            self.steps += 2 * ballot.looked
            votes = votes[self.fits_prior(pole, self.tables.guide[votes[:, 2]], search)]
            found.append(self._turned_alike(self._triangles(pole, votes, near.star, search)))

    def _is_over(self, most: int, found: list[IntArray]) -> bool:
        """Whether the steps or the room are used up."""
        return self.steps > most or sum(map(len, found)) > self.numbers.room

    def _triangles(self, pole: int, votes: IntArray, neighbour: IntArray, search: Search) -> IntArray:
        """Triangles (T, 6) of votes (V, 3) whose sides and sense agree: three stars and three guide stars."""
        guide = self.tables.guide
        x, y = same_star(votes[:, 2])
        x, y = x[x < y], y[x < y]
        self.steps += VOTE_STEPS * len(x)
        other = votes[x, 0] != votes[y, 0]
        x, y = x[other], y[other]
        j, k = neighbour[votes[x, 0]], neighbour[votes[y, 0]]
        a, b, c = votes[x, 2], votes[x, 1], votes[y, 1]
        i = np.full(len(x), pole, np.int64)
        agree = triangles_agree((i, j, k), (a, b, c), self.seen, self.sides, search, self.tables)
        agree &= as_long(guide[a] - guide[b], i, j, self.sides, search)
        agree &= as_long(guide[a] - guide[c], i, k, self.sides, search)
        self.steps += TRIAD_STEPS * int(agree.sum())
        return np.stack([i, j, k, a, b, c], axis=1)[agree]

    def _turned_alike(self, triangles: IntArray) -> IntArray:
        """Triads (T, 7) of triangles whose rotations and inner angles agree."""
        seen, guide, t = self.seen.direction, self.tables.guide, self.numbers
        i, j, k, a, b, c = triangles.T
        one = (_bearing(guide[a], guide[b]) - image_bearing(seen[i], seen[j])) % FULL_TURN
        two = (_bearing(guide[a], guide[c]) - image_bearing(seen[i], seen[k])) % FULL_TURN
        keep = np.abs(between(two, one)) <= t.rotation
        if t.enclosed >= 0:
            ours = inner_angles(seen[i], seen[j], seen[k], ANGLE)
            theirs = inner_angles(guide[a], guide[b], guide[c], ANGLE)
            keep &= np.abs(np.array(ours) - np.array(theirs)).max(axis=0, initial=0) <= t.enclosed
        mean = (one + (between(two, one) >> 1)) % FULL_TURN
        return np.column_stack([triangles, mean])[keep]

    def _try_groups(self, triads: IntArray, search: Search) -> None:
        """Verify the attitudes of the groups that name three stars, the largest group first."""
        group, _, _, size = group_rotations(triads[:, 6], self.numbers.grouping, FULL_TURN)
        size, checked = size[:MOST_GROUPS], 0
        needed = self.numbers.votes
        if self.numbers.lone and min(self.numbers.stars, len(self.seen)) == 3 and len(size) == 1:
            needed = 1
        for number in np.argsort(-size, kind="stable").tolist():
            members = triads[group == number]
            winner, named = elected(members, needed, self.numbers.stars)
            self.steps += group_steps(len(triads), len(members), named)
            drop_disagreeing(winner, self._agreement(winner, search))
            if (winner >= 0).sum() < 3:
                continue
            self._try(winner, search)
            checked += 1
            if checked == MOST_CHECKED or self.pool.beyond(SURE_BEYOND):
                return

    def _agreement(self, winner: IntArray, search: Search) -> NDArray[np.bool_]:
        """Whether the separations of winners (n, n) are those observed."""
        star, guide = np.flatnonzero(winner >= 0), self.tables.guide
        i, j = (grid.ravel() for grid in np.meshgrid(star, star))
        agree = np.ones((len(winner), len(winner)), np.bool_)
        agree[i, j] = as_long(guide[winner[i]] - guide[winner[j]], i, j, self.sides, search)
        return agree | np.eye(len(winner), dtype=np.bool_)

    def _try(self, winner: IntArray, search: Search) -> None:
        """Verify the attitude of the two winners that are farthest apart."""
        star = np.flatnonzero(winner >= 0)
        i, j = (star[index] for index in np.triu_indices(len(star), 1))
        far = int(np.argmax(self.sides.chord[i, j]))
        p, q = int(i[far]), int(j[far])
        seen = pair_frame(self.seen.direction[p], self.seen.direction[q])
        known = pair_frame(self.tables.guide[winner[p]], self.tables.guide[winner[q]])
        if seen is None or known is None:
            return
        matrix = (seen.T @ known) >> 30
        if not self.is_known(matrix, search):
            self.verify(matrix, search.gates)


def between(first: IntArray, second: IntArray) -> IntArray:
    """Angles first − second in [−180°, 180°)."""
    return np.asarray((first - second + FULL_TURN // 2) % FULL_TURN - FULL_TURN // 2)


def image_bearing(p: IntArray, q: IntArray) -> IntArray:
    """Directions (T,) of lines from stars to others in the tangent plane, from x over the image's upper edge."""
    across = (q[:, 0] * p[:, 2] - p[:, 0] * q[:, 2]) >> 30
    up = (p[:, 1] * q[:, 2] - q[:, 1] * p[:, 2]) >> 30
    return np.asarray(fine_angles(up, across) >> _ANGLE_SHIFT)


def _bearing(p: IntArray, q: IntArray) -> IntArray:
    """Directions (T,) of great circles from stars to others, from west over north."""
    step = q - p
    west = (p[:, 1] * step[:, 0] - p[:, 0] * step[:, 1]) >> 30
    along = (p * step).sum(axis=1) >> 30
    north = step[:, 2] - ((p[:, 2] * along) >> 30)
    return np.asarray(fine_angles(north, west) >> _ANGLE_SHIFT)


def elected(members: IntArray, needed: int, stars: int) -> tuple[IntArray, int]:
    """Guide star (n,) of each star by the triads of a group, −1 for none, and how many pairs of both they name."""
    name = np.stack([members[:, :3].ravel(), members[:, 3:6].ravel()], axis=1)
    pair, first, count = np.unique(name, axis=0, return_index=True, return_counts=True)
    order = np.argsort(first, kind="stable")[:MOST_NAMED]
    pair, count = pair[order], count[order]
    winner = np.full(stars, -1, np.int64)
    for star in range(stars):
        votes = np.where(pair[:, 0] == star, count, 0)
        most = int(votes.max(initial=0))
        if most >= needed and int((votes == most).sum()) == 1:
            winner[star] = pair[np.argmax(votes), 1]
    return winner, len(pair)


def drop_disagreeing(winner: IntArray, agree: NDArray[np.bool_]) -> None:
    """Drop winners until all separations agree, each time that with most disagreements, of equal ones the last."""
    wrong = ~agree
    while wrong.any():
        count = wrong.sum(axis=1)
        worst = int(np.flatnonzero(count == count.max())[-1])
        winner[worst] = -1
        wrong[worst] = wrong[:, worst] = False
