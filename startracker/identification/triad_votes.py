"""From groups of triads to matched stars: votes, merged stars, final check (Yee 1999, section 2.3.4.3)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from startracker.core import IntArray
from startracker.identification.arithmetic import Arithmetic, Numbers
from startracker.identification.triad_search import TriadLimits, Triads, find_triads, image_pairs
from startracker.identification.triad_tables import TriadTables

COMBINED_ID = 10_000
"""Added to the number of the brightest of several stars that are merged in the image: 7139 becomes 17139."""


@dataclass(frozen=True)
class Vote:
    """A catalogue star, or several unresolved ones, that an image star may be.

    Parameters
    ----------
    catalog : int
        Index in the sub-catalogue; for several stars, that of the brightest.
    members : tuple of int
        Indices of all of them.
    frequency : int
        Number of triads of the group that name it.
    """

    catalog: int
    members: tuple[int, ...]
    frequency: int

    def number(self, tables: TriadTables) -> int:
        """Catalogue number; for several stars, that of the brightest plus 10,000."""
        return int(tables.id[self.catalog]) + (COMBINED_ID if len(self.members) > 1 else 0)


@dataclass(frozen=True, eq=False)
class GroupMatch:
    """Matches according to one group of triads.

    Parameters
    ----------
    group : int
        Number of the group.
    votes : tuple of tuple of Vote
        For each image star, its candidates, brightest first, with merged stars last.
    winners : tuple of (Vote or None)
        For each image star, the candidate with most votes.
    matches : tuple of (Vote or None)
        The winners that pass the final check of separations.
    """

    group: int
    votes: tuple[tuple[Vote, ...], ...]
    winners: tuple[Vote | None, ...]
    matches: tuple[Vote | None, ...]

    @property
    def matched(self) -> int:
        """Number of matched stars."""
        return sum(match is not None for match in self.matches)

    @property
    def pairs(self) -> IntArray:
        """Image star and index in the sub-catalogue (M, 2) of each match."""
        found = [(star, match.catalog) for star, match in enumerate(self.matches) if match is not None]
        return np.array(found, dtype=np.int64).reshape(-1, 2)


@dataclass(frozen=True, eq=False)
class TriadMatch:
    """All intermediate results of one identification.

    Parameters
    ----------
    tables : TriadTables
        The sub-catalogue.
    scale_deg : (2,)
        Degrees per pixel, across and down.
    limits : TriadLimits
        The thresholds.
    stars : int
        Number of image stars.
    separations : (P,)
        Separations of the image stars, in the order of `image_pairs`.
    pair_counts : int (P,)
        Number of catalogue pairs found for each.
    triads : Triads
        Triads that passed the tests, grouped.
    """

    tables: TriadTables
    scale_deg: ArrayLike
    limits: TriadLimits
    stars: int
    separations: Numbers
    pair_counts: IntArray
    triads: Triads

    def groups(self) -> IntArray:
        """Group numbers in descending order of size, equal ones in the order in which they were found."""
        return np.argsort(-self.triads.group_sizes, kind="stable")

    def candidates(self) -> Iterator[GroupMatch]:
        """Groups that match at least three stars, largest first.

        Yee's program examined the largest groups only; the others follow as her section 5.2 recommends.
        """
        for group in self.groups():
            found = self.vote(int(group))
            if found.matched >= 3:
                yield found

    def best(self) -> GroupMatch | None:
        """The first group that matches three stars, or None."""
        return next(self.candidates(), None)

    def vote(self, group: int) -> GroupMatch:
        """Count the votes of a group's triads and check the winners."""
        arithmetic, tables, limits = self.tables.arithmetic, self.tables, self.limits
        members = self.triads.group == group
        seen, catalog = self.triads.stars[members], self.triads.catalog[members]
        close = combine_separation(arithmetic, self.scale_deg, limits.combine_px)
        # Three image stars form one triad, which gives each one vote; that is enough if no other group contradicts it.
        unique = limits.three_stars and self.stars == 3 and len(self.triads.group_rotations) == 1
        needed = 1 if unique else limits.votes_needed(self.stars)
        votes = tuple(
            _votes(tables, seen, catalog, star, close, limits.reprocess_multiples) for star in range(self.stars)
        )
        winners = tuple(_winner(possible, needed) for possible in votes)
        return GroupMatch(group, votes, winners, self._checked(winners))

    def _checked(self, winners: tuple[Vote | None, ...]) -> tuple[Vote | None, ...]:
        """Remove matches until all separations agree, each time the match with most disagreements; of equal ones the
        last.

        Several stars that are merged in the image agree if one of them does, because the image lies between them.
        """
        left = list(winners)
        tolerance = self.limits.pair_tolerances(self.tables.arithmetic, len(self.separations))
        wrong = np.zeros((self.stars, self.stars), dtype=bool)
        for pair, (i, j) in enumerate(zip(*image_pairs(self.stars), strict=True)):
            one, other = winners[i], winners[j]
            if one is not None and other is not None:
                agrees = self._agree(one, other, self.separations[pair], tolerance[pair])
                wrong[i, j] = wrong[j, i] = not agrees
        while wrong.any():
            count = wrong.sum(axis=1)
            worst = int(np.flatnonzero(count == count.max())[-1])
            left[worst] = None
            wrong[worst, :] = wrong[:, worst] = False
        return tuple(left)

    def _agree(self, one: Vote, other: Vote, separation: Any, tolerance: Any) -> bool:
        i, j = (grid.ravel() for grid in np.meshgrid(one.members, other.members))
        theirs = self.tables.arithmetic.catalog_separations(self.tables.sky, i, j)
        return bool(self.tables.arithmetic.separations_agree(separation, theirs, tolerance).any())


def combine_separation(arithmetic: Arithmetic, scale_deg: ArrayLike, radius_px: float) -> Any:
    """Separation up to which stars are merged in the image: the larger of τ pixels across and τ pixels down (eq.
    2.4)."""
    probe: Any = arithmetic.image([[0.0, 0.0], [radius_px, 0.0], [0.0, radius_px]], scale_deg)
    apart = arithmetic.image_separations(probe, np.array([0, 0]), np.array([1, 2]))
    return apart.max()


def match_triads(
    tables: TriadTables, xy_px: ArrayLike, scale_deg: ArrayLike, limits: TriadLimits | None = None
) -> TriadMatch:
    """Identify image stars by triads (Yee 1999, section 2.3.4), in the tables' arithmetic.

    Parameters
    ----------
    tables : TriadTables
        The sub-catalogue.
    xy_px : (N, 2)
        Centroids, x right and y up relative to the image's centre, brightest first; all are used.
    scale_deg : (2,)
        Degrees per pixel, across and down.
    limits : TriadLimits, optional
        Thresholds.

    Returns
    -------
    TriadMatch
        Its `best` is the answer; its groups, triads and separations are the intermediate results.

    Raises
    ------
    InputError
        Centroids or scales that are not finite.
    """
    limits = limits or TriadLimits()
    arithmetic = tables.arithmetic
    image: Any = arithmetic.image(xy_px, scale_deg)
    stars = len(np.asarray(xy_px))
    separations = arithmetic.image_separations(image, *image_pairs(stars))
    triads, counts = find_triads(image, stars, separations, tables, limits)
    return TriadMatch(tables, scale_deg, limits, stars, separations, counts, triads)


def _votes(
    tables: TriadTables, seen: IntArray, catalog: IntArray, star: int, close: Any, reprocess: bool
) -> tuple[Vote, ...]:
    """Candidates that triads (T, 3) name for an image star, with their frequency, brightest first, then merged stars.

    Several merged stars have the sum of their frequencies, or the number of triads that remain different when each of
    the stars is replaced by the brightest.
    """
    index, frequency = np.unique(catalog[seen == star], return_counts=True)
    order = np.lexsort((index, tables.v_mag[index]))
    index, frequency = index[order], frequency[order]
    single = [Vote(int(p), (int(p),), int(f)) for p, f in zip(index, frequency, strict=True)]
    combined = []
    for members in _chains(tables, index, close):
        stars = tuple(int(p) for p in index[members])
        count = int(frequency[members].sum())
        if reprocess:
            naming = (np.isin(catalog, stars) & (seen == star)).any(axis=1)
            renamed = np.where(np.isin(catalog, stars), stars[0], catalog)
            count = len(np.unique(np.hstack([seen, renamed])[naming], axis=0))
        combined.append(Vote(stars[0], stars, count))
    # Stars that are merged in the image are no longer candidates individually.
    if reprocess:
        single = [vote for vote in single if not any(vote.catalog in several.members for several in combined)]
    return tuple(single + combined)


def _chains(tables: TriadTables, index: IntArray, close: Any) -> list[IntArray]:
    """Sets of several stars connected by separations of at most `close`, as ascending indices into `index`."""
    label = np.arange(len(index))
    i, j = image_pairs(len(index))
    near = tables.arithmetic.catalog_separations(tables.sky, index[i], index[j]) <= close
    for a, b in zip(i[near], j[near], strict=True):
        # Two sets that are connected become one, as in single-linkage clustering.
        low, high = sorted((label[a], label[b]))
        label[label == high] = low
    several = np.flatnonzero(np.bincount(label, minlength=len(index)) > 1)
    return [np.flatnonzero(label == value) for value in several]


def _winner(votes: tuple[Vote, ...], needed: int) -> Vote | None:
    """The candidate with the highest frequency, if that is sufficient and no other has the same."""
    if not votes:
        return None
    most = max(vote.frequency for vote in votes)
    top = [vote for vote in votes if vote.frequency == most]
    return top[0] if len(top) == 1 and most >= needed else None
