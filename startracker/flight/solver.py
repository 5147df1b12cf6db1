"""A flight build in Python: the stages of a frame in order, with the integers of the C (`c/tracker_frame.c`)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from startracker.core import FloatArray, IntArray
from startracker.display import described
from startracker.fixed_point.evidence import LOG_BITS
from startracker.flight.apparent import flight_observer
from startracker.flight.design import FlightDesign
from startracker.flight.directions import GridTables, plane_of, vectors_of
from startracker.flight.evidence import sight
from startracker.flight.front_end import FrontTables, front_tables, measure_frame
from startracker.flight.hypotheses import FlightPrior, Reason
from startracker.flight.pose import COVARIANCE_BITS, PoseTables, pose_tables, solve_pose
from startracker.flight.search import Found, identify
from startracker.flight.search_tables import SearchTables, search_tables
from startracker.flight.stars import StarList
from startracker.solution import Status

_STATUS = {
    Reason.ACCEPTED: Status.SOLVED,
    Reason.NOTHING_FOUND: Status.NO_STARS,
    Reason.FEW_FOUND: Status.TOO_FEW_STARS,
    Reason.STEPS_USED_UP: Status.SEARCH_LIMIT,
    Reason.ABOVE_RATE: Status.AMBIGUOUS,
    Reason.RIVAL: Status.AMBIGUOUS,
    Reason.ROWS_MISSING: Status.BAD_IMAGE,
    Reason.FRAME_UNIFORM: Status.BAD_IMAGE,
    Reason.SATURATED_SHARE: Status.SATURATED,
}
"""All others are `Status.NO_MATCH`."""
SATURATED_PART = 20
"""An unsolved frame with more than one saturated pixel in this many is called saturated (`survey.SATURATED_SHARE`)."""


class FlightAnswer(NamedTuple):
    """Result of a flight build: the members of ``struct tracker_answer``.

    Parameters
    ----------
    status, reason : Status, Reason
    stars, matched, used : int
        Stars of the list, identified, and used in the attitude.
    evidence, chance : int
        log₂ of the Bayes factor, and of the probability that the answer is wrong, 12 fraction bits.
    steps : int
        Of the search.
    prior_contradicted : bool
    number : int array, shape (N,)
        Catalogue number of each star; 0: not identified.
    matrix : int array, shape (3, 3)
        ICRS to camera, 2.30.
    quaternion : int array, shape (4,)
        The same, scalar last, 2.30.
    covariance : int array, shape (3, 3)
        Of the rotation vector in camera axes, square radians of 60 fraction bits.
    """

    status: Status
    reason: Reason
    stars: int
    matched: int
    used: int
    evidence: int
    chance: int
    steps: int
    prior_contradicted: bool
    number: IntArray
    matrix: IntArray
    quaternion: IntArray
    covariance: IntArray

    @property
    def solved(self) -> bool:
        """Whether the attitude is valid."""
        return self.status is Status.SOLVED

    @property
    def attitude_matrix(self) -> FloatArray:
        """Attitude as real numbers (3, 3): v_camera = A @ v_icrs."""
        return np.asarray(self.matrix / float(1 << 30))

    @property
    def covariance_rad2(self) -> FloatArray:
        """Covariance (3, 3) of the rotation vector in camera axes, rad²."""
        return np.asarray(self.covariance / float(1 << COVARIANCE_BITS))

    @property
    def log2_chance(self) -> float:
        """log₂ of the probability that the answer is wrong."""
        return self.chance / float(1 << LOG_BITS)


class FlightTracker:
    """The flight build of one camera in Python, bit for bit that of the C in integers.

    Parameters
    ----------
    design : FlightDesign
    front, search, pose : FrontTables, SearchTables, PoseTables

    Examples
    --------
    >>> tracker = FlightTracker.build(design)  # doctest: +SKIP
    >>> tracker.solve_stars(StarList.of(xy_px, flux_dn, variance_px2)).status  # doctest: +SKIP
    """

    def __init__(self, design: FlightDesign, front: FrontTables, search: SearchTables, pose: PoseTables) -> None:
        self.design, self.front_tables, self.search_tables, self.pose_tables = design, front, search, pose

    @classmethod
    def build(cls, design: FlightDesign) -> FlightTracker:
        """Tables of a design.

        Raises
        ------
        InputError
            For a camera, settings or guide stars that a flight build does not hold.
        """
        return cls(design, front_tables(design), search_tables(design), pose_tables(design))

    def __repr__(self) -> str:
        stars = f"{len(self.search_tables.guide):,} guide stars, {len(self.search_tables.first):,} pairs"
        return described("FlightTracker", repr(self.design.camera), stars, self.design.arithmetic)

    @property
    def grid(self) -> GridTables:
        """Table of the directions."""
        return self.pose_tables.grid

    def solve(
        self,
        image: ArrayLike,
        *,
        velocity: ArrayLike | None = None,
        epoch: int | None = None,
        prior: FlightPrior | None = None,
    ) -> FlightAnswer:
        """Attitude from the pixels of a frame.

        Parameters
        ----------
        image : uint16 array, shape (H, W)
            DN.
        velocity, epoch, prior
            As in `solve_stars`.

        Raises
        ------
        InputError
            For an array of another shape or type, a faster observer, or an epoch too far away.
        """
        frame = measure_frame(image, self.front_tables)
        if frame.lowest == frame.highest:
            none = Found(Reason.FRAME_UNIFORM, np.zeros((3, 3), np.int64), np.empty(0, np.int64))
            return _unsolved(none, Reason.FRAME_UNIFORM)
        answer = self.solve_stars(frame.stars, velocity=velocity, epoch=epoch, prior=prior)
        if not answer.solved and frame.saturated * SATURATED_PART > np.size(image):
            answer = answer._replace(status=Status.SATURATED, reason=Reason.SATURATED_SHARE)
        return answer

    def solve_stars(
        self,
        stars: StarList,
        *,
        velocity: ArrayLike | None = None,
        epoch: int | None = None,
        prior: FlightPrior | None = None,
    ) -> FlightAnswer:
        """Attitude from a list of stars.

        Parameters
        ----------
        stars : StarList
            Brightest first; the first `DetectionSettings.max_stars` are used.
        velocity : int array, shape (3,), optional
            Of the observer over that of light, ICRS axes, 2.30; at most 2⁻¹⁰ on each axis. None: no aberration.
        epoch : int, optional
            Julian epoch (TT) of the frame, years of 16 fraction bits, within 100 years of the tables'
            (`SearchTables.epoch`). None: that of the tables.
        prior : FlightPrior, optional

        Raises
        ------
        InputError
            For a faster observer, or an epoch too far away.
        """
        observer = flight_observer(velocity, epoch, self.search_tables.epoch)
        stars = stars.take(np.arange(min(len(stars.x), self.search_tables.most_stars)))
        plane, seen = plane_of(np.column_stack([stars.x, stars.y]), self.grid)
        direction = vectors_of(plane, self.grid)
        sighted = sight(stars, direction, seen, self.search_tables)
        found = identify(sighted, len(seen), observer, prior, self.search_tables)
        if found.reason is not Reason.ACCEPTED:
            return _unsolved(found, found.reason)
        pose = solve_pose(stars, found.guide, found.matrix, observer, self.pose_tables)
        if pose is None:
            return _unsolved(found, Reason.POSE_FAILED)
        number = np.where(pose.guide >= 0, self.search_tables.number[pose.guide], 0)
        return _answer(found, Reason.ACCEPTED, int((pose.guide >= 0).sum()), number)._replace(
            matrix=pose.matrix, quaternion=pose.quaternion, covariance=pose.covariance
        )


def _answer(found: Found, reason: Reason, used: int, number: IntArray) -> FlightAnswer:
    return FlightAnswer(
        _STATUS.get(reason, Status.NO_MATCH),
        reason,
        len(number),
        found.matched,
        used,
        found.evidence,
        found.chance,
        found.steps,
        found.prior_contradicted,
        number,
        np.zeros((3, 3), np.int64),
        np.zeros(4, np.int64),
        np.zeros((3, 3), np.int64),
    )


def _unsolved(found: Found, reason: Reason) -> FlightAnswer:
    return _answer(found, reason, 0, np.zeros(len(found.guide), np.int64))
