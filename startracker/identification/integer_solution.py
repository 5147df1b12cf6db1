"""Attitude from centroids in integers: triads, votes, plate constants, verification (Yee 1999, chapters 2 and 3).

The attitude, which Yee computes in floating point, is computed in 64-bit integers here. The groups of triads are
hypotheses: each of the largest gives an attitude, which is tested against all points of the list and all guide stars of
the field (`startracker.fixed_point.verification`), and is accepted only if the probability of a coincidence is at most
the false-alarm rate. The C that `startracker.integer_export` writes gives the same results bit for bit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from startracker.arguments import of_kind, real_array, real_number
from startracker.errors import InputError
from startracker.fixed_point.arithmetic import FixedArithmetic
from startracker.fixed_point.attitude import IntegerAttitude, NotSolved, matrix_angles, plate_attitude
from startracker.fixed_point.evidence import LOG_BITS, Tables, local_areas
from startracker.fixed_point.formats import CENTROID, FixedPointOverflow, Integers, integers
from startracker.fixed_point.verification import FEW_FIT, NOT_SPREAD, plane, verify
from startracker.identification.integer_acceptance import (
    MAX_POINTS,
    IntegerCamera,
    merged_stars,
    verification_tables,
)
from startracker.identification.triad_search import TriadLimits
from startracker.identification.triad_tables import TriadTables
from startracker.identification.triad_votes import COMBINED_ID, GroupMatch, match_triads

__all__ = [
    "MAX_GROUPS",
    "MAX_STARS",
    "MAX_TRIADS",
    "REASONS",
    "STATUSES",
    "IntegerAttitude",
    "IntegerCamera",
    "IntegerReason",
    "IntegerSolution",
    "IntegerStatus",
    "IntegerTracker",
    "integer_tables",
    "solve_integers",
]

IntegerStatus = Literal["solved", "too_few_stars", "no_match", "ambiguous", "outside_image", "overflow", "search_limit"]
STATUSES: tuple[IntegerStatus, ...] = get_args(IntegerStatus)
"""Statuses in the order of their numbers in the C export."""
IntegerReason = Literal[
    "accepted",
    "fewer_than_three",
    "no_triads",
    "no_group",
    "no_attitude",
    "few_fit",
    "not_spread",
    "weak_evidence",
    "rival",
    "outside_image",
    "overflow",
    "too_many_triads",
]
REASONS: tuple[IntegerReason, ...] = get_args(IntegerReason)
"""Reasons in the order of their numbers in the C export; from ``no_triads`` to ``weak_evidence`` in the order of the
stages."""
_WORDS: dict[IntegerReason, str] = {
    "accepted": "accepted",
    "fewer_than_three": "fewer than three points",
    "no_triads": "no triad of catalogue stars passes the tests",
    "no_group": "no group of triads names three stars",
    "no_attitude": "the stars named fit no attitude",
    "few_fit": "fewer than three points fit an attitude",
    "not_spread": "the points that fit lie in a clump or a line",
    "weak_evidence": "chance explains the points that fit",
    "rival": "two attitudes explain the points",
    "outside_image": "a point lies outside the image",
    "overflow": "fixed-point overflow",
    "too_many_triads": "more triads pass the tests than there is room for",
}
MAX_STARS = 12
"""Number of the brightest points that form triads (Yee 1999, section 2.3.4)."""
MAX_TRIADS = 4096
"""Largest number of triads for which the C export has memory."""
MAX_GROUPS = 12
"""Number of the largest groups of triads that are tested."""


@dataclass(frozen=True, eq=False)
class IntegerSolution:
    """Result of the integer tracker.

    Parameters
    ----------
    status : str
        One of `STATUSES`. Only ``solved`` comes with an attitude.
    code : str
        Reason, one of `REASONS`.
    reason : str
        The reason in words.
    numbers : int array, shape (N,)
        Catalogue number of each point, plus 10,000 if several stars are merged in the image; 0 if unmatched, and for
        all points unless solved.
    triads : int
        Number of triads of the winning group; 0 unless solved.
    matched : int
        Number of points that fit the best attitude, solved or not.
    evidence : int
        log₂ of its Bayes factor, with 12 bits of fraction; 0 if no attitude was evaluated.
    attitude : IntegerAttitude or None
        Attitude if solved.
    """

    status: IntegerStatus
    code: IntegerReason
    reason: str
    numbers: NDArray[np.int64]
    triads: int = 0
    matched: int = 0
    evidence: int = 0
    attitude: IntegerAttitude | None = None


@dataclass(frozen=True, eq=False)
class IntegerTracker:
    """All integer tables for one camera and sub-catalogue.

    Parameters
    ----------
    camera : IntegerCamera
        Camera for which the tables were computed.
    tables : TriadTables
        Result of `integer_tables`.
    verification : Tables
        Constants and guide stars of the verification.
    guide_number : (G,)
        Catalogue number of each guide star, plus 10,000 for merged stars.
    guide_of_star : (N,)
        Guide star to which each star of the sub-catalogue belongs.
    """

    camera: IntegerCamera
    tables: TriadTables
    verification: Tables
    guide_number: Integers
    guide_of_star: Integers

    @classmethod
    def build(
        cls,
        camera: IntegerCamera,
        star_id: ArrayLike,
        ra_deg: ArrayLike,
        dec_deg: ArrayLike,
        v_mag: ArrayLike,
        max_separation_deg: float,
    ) -> IntegerTracker:
        """Tables of a sub-catalogue with pairs up to the largest separation.

        Raises
        ------
        InputError, FixedPointOverflow
            As for `TriadTables.build`; also for a largest separation of 32° or more.
        """
        of_kind("camera", camera, IntegerCamera)
        given = real_array("star_id", star_id, (None,))
        if (given % 1.0 != 0.0).any():
            raise InputError("star_id must be whole numbers")
        columns = {"ra_deg": ra_deg, "dec_deg": dec_deg, "v_mag": v_mag}
        ra_deg, dec_deg, v_mag = (real_array(name, values, given.shape) for name, values in columns.items())
        max_separation_deg = real_number("max_separation_deg", max_separation_deg, least=0.0)
        tables = integer_tables(star_id, ra_deg, dec_deg, v_mag, max_separation_deg)
        if not len(tables):
            raise InputError("the sub-catalogue has no star; raise the magnitude limit")
        guide = merged_stars(ra_deg, dec_deg, v_mag, camera.resolution_px / max(camera.focal_px))
        number = tables.id[guide.first] + np.where(guide.several, COMBINED_ID, 0)
        return cls(camera, tables, verification_tables(camera, guide), number, guide.of_star)


def integer_tables(
    star_id: ArrayLike, ra_deg: ArrayLike, dec_deg: ArrayLike, v_mag: ArrayLike, max_separation_deg: float
) -> TriadTables:
    """Integer databases: those of `TriadTables.build`, with ranks by brightness in place of magnitudes.

    Raises
    ------
    InputError, FixedPointOverflow
        As for `TriadTables.build`; also for a largest separation of 32° or more.
    """
    tables = TriadTables.build(FixedArithmetic(), star_id, ra_deg, dec_deg, v_mag, max_separation_deg)
    rank = np.empty(len(tables), dtype=np.int64)
    # The inverse of the permutation that sorts by brightness; equal magnitudes are ranked by index.
    rank[np.lexsort((np.arange(len(tables)), tables.v_mag))] = np.arange(len(tables))
    return replace(tables, v_mag=rank)  # type: ignore[arg-type]  # only ever compared


def solve_integers(tracker: IntegerTracker, xy_px: ArrayLike, limits: TriadLimits | None = None) -> IntegerSolution:
    """Identify stars by triads, compute the attitude and verify it, using integers only once the tables exist.

    Parameters
    ----------
    tracker : IntegerTracker
        Camera and tables.
    xy_px : array_like, shape (N, 2)
        Undistorted centroids, brightest first, x right and y up relative to the image's centre: pixels, or integers of
        the format 10.22. The first 12 form triads, the first 24 are verified.
    limits : TriadLimits, optional
        Thresholds of the triads.

    Returns
    -------
    IntegerSolution
        Overflow and failures are statuses.

    Raises
    ------
    TypeError
        If the tables hold floating-point numbers.
    """
    of_kind("tracker", tracker, IntegerTracker, "IntegerTracker.build makes one")
    of_kind("limits", limits, (TriadLimits, type(None)))
    integers(tracker.tables.v_mag)
    integers(tracker.tables.separation)
    given = np.asarray(xy_px) if np.size(real_array("xy_px", xy_px, finite=False)) else np.empty((0, 2))
    if given.ndim != 2 or given.shape[1] != 2:
        raise InputError(f"xy_px must have the shape (N, 2); got {given.shape}")
    given = given[:MAX_POINTS]
    if len(given) < 3:
        return _refused("too_few_stars", "fewer_than_three", len(given), f"{len(given)} points, 3 are needed")
    try:
        xy = CENTROID.check(given, "centroid") if given.dtype.kind in "iu" else CENTROID.encode(given)
        points = plane(xy, tracker.verification)
        if (np.abs(points) > tracker.verification.half).any():
            return _refused("outside_image", "outside_image", len(xy))
        image: Any = tracker.tables.arithmetic.image(xy[:MAX_STARS], tracker.camera.scale_deg)
        match = match_triads(tracker.tables, image.xy, image.scale_deg, limits)
    except FixedPointOverflow as overflow:
        return _refused("overflow", "overflow", len(given), str(overflow))
    if len(match.triads) > MAX_TRIADS:
        many = f"{len(match.triads)} triads passed the tests; there is room for {MAX_TRIADS}"
        return _refused("search_limit", "too_many_triads", len(xy), many)
    if not len(match.triads):
        return _refused("no_match", "no_triads", len(xy))
    pool = _Pool(tracker, xy, points)
    for group in match.groups()[:MAX_GROUPS]:
        pool.try_group(match.vote(int(group)), int(match.triads.group_sizes[group]))
    return pool.judge()


def _refused(status: IntegerStatus, code: IntegerReason, points: int, reason: str | None = None) -> IntegerSolution:
    return IntegerSolution(status, code, reason or _WORDS[code], np.zeros(points, dtype=np.int64))


class _Pool:
    """Attitudes that have been verified: the best one, and its strongest rival."""

    def __init__(self, tracker: IntegerTracker, xy: Integers, points: Integers) -> None:
        self.tracker, self.xy, self.points = tracker, xy, points
        self.area = local_areas(points, tracker.verification)
        self.stage = REASONS.index("no_group")
        self.found = False
        self.evidence = self.matched = self.triads = 0
        self.rival: int | None = None
        self.numbers = np.zeros(len(xy), dtype=np.int64)
        self.matrix = np.zeros((3, 3), dtype=np.int64)

    def try_group(self, match: GroupMatch, size: int) -> None:
        """Verify the attitude from a group of `size` triads."""
        if match.matched < 3:
            return
        tables, check = self.tracker.tables, self.tracker.verification
        seen, catalog = match.pairs.T
        try:
            start = plate_attitude(self.xy[seen], tables.sky.directions[catalog]).matrix
        except NotSolved:
            self._reached("no_attitude")
            return
        state, evidence, matched, index, matrix = verify(start, self.points, self.area, check)
        self._reached("few_fit" if state == FEW_FIT else "not_spread" if state == NOT_SPREAD else "weak_evidence")
        if state in (FEW_FIT, NOT_SPREAD):
            return
        # The rows of a matrix are the camera's axes in the sky: the third is the boresight, and the first also shows
        # the roll.
        right, _, boresight = np.abs(matrix - self.matrix).max(axis=1).tolist()
        same = self.found and boresight <= check.same and right <= check.same_roll
        better = not self.found or evidence > self.evidence
        if self.found and not same:
            weaker = self.evidence if better else evidence
            self.rival = weaker if self.rival is None else max(self.rival, weaker)
        if better:
            self.found = True
            self.evidence, self.matched, self.triads, self.matrix = evidence, matched, size, matrix
            self.numbers = self._numbers(match, index)

    def judge(self) -> IntegerSolution:
        """The best attitude, if neither chance nor rivals exclude it."""
        threshold = self.tracker.verification.threshold
        status: IntegerStatus = "no_match"
        code = REASONS[self.stage]
        if self.found and self.evidence >= threshold:
            # log₂ of the ratio of the two Bayes factors must exceed the threshold for chance, too.
            contested = self.rival is not None and self.evidence - self.rival < threshold
            status, code = ("ambiguous", "rival") if contested else ("solved", "accepted")
        chance = f"; chance 2^{-self.evidence / (1 << LOG_BITS):.1f}" if self.found else ""
        reason = f"{_WORDS[code]}: {self.matched} of {len(self.xy)} points fit{chance}"
        if status == "solved":
            attitude = IntegerAttitude(self.matrix, *matrix_angles(self.matrix))
            return IntegerSolution(
                status, code, reason, self.numbers, self.triads, self.matched, self.evidence, attitude
            )
        none = np.zeros(len(self.xy), dtype=np.int64)
        return IntegerSolution(status, code, reason, none, 0, self.matched, self.evidence)

    def _reached(self, code: IntegerReason) -> None:
        self.stage = max(self.stage, REASONS.index(code))

    def _numbers(self, match: GroupMatch, index: Integers) -> Integers:
        """Catalogue numbers of the points: those of the votes where they agree with the verification."""
        tracker = self.tracker
        numbers = np.where(index >= 0, tracker.guide_number[index], 0)
        for star, vote in enumerate(match.matches):
            guide = index[star]
            if vote is not None and guide >= 0 and (tracker.guide_of_star[list(vote.members)] == guide).any():
                numbers[star] = vote.number(tracker.tables)
        return np.asarray(numbers)
