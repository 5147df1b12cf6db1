"""A flight build in Python from frame to frame: prediction, identification near it, attitude, filter."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from numpy.typing import ArrayLike

from startracker.flight.directions import quaternion_of
from startracker.flight.following import COASTING, REJECTED, TIME_BAD, Following, FollowingTables
from startracker.flight.hypotheses import FlightPrior
from startracker.flight.solver import FlightAnswer, FlightTracker
from startracker.flight.stars import StarList


class Followed(NamedTuple):
    """A frame of a sequence.

    Parameters
    ----------
    time : int
        Whether the frame's time could be used: `startracker.flight.following.TIME_GOOD` and others.
    result : int
        What the filter did with the frame: `startracker.flight.following.USED` and others.
    answer : FlightAnswer or None
        Of the frame; attitude and covariance are the filter's if it used it. None if the time could not be used.
    """

    time: int
    result: int
    answer: FlightAnswer | None


class FlightSession:
    """Attitudes of one camera over time, as of the C: ``tracker_following_predict``, ``tracker_solve_stars``,
    ``tracker_following_take``.

    Parameters
    ----------
    tracker : FlightTracker
    tables : FollowingTables
    """

    def __init__(self, tracker: FlightTracker, tables: FollowingTables) -> None:
        self.tracker, self.following = tracker, Following(tables)

    def update_stars(
        self,
        stars: StarList,
        time_us: int,
        *,
        velocity: ArrayLike | None = None,
        epoch: int | None = None,
        gyro: Sequence[int] | None = None,
    ) -> Followed:
        """Attitude of a list of stars measured at a time.

        Parameters
        ----------
        stars, velocity, epoch
            As in `FlightTracker.solve_stars`.
        time_us : int
            Middle of the exposure, microseconds of a uniform clock.
        gyro : three integers, optional
            As in `Following.predict`.
        """
        time = self.following.predict(time_us, gyro)
        if time == TIME_BAD:
            return Followed(time, COASTING, None)
        matrix, radius = self.following.prior()
        prior = FlightPrior(matrix, radius) if radius else None
        answer = self.tracker.solve_stars(stars, velocity=velocity, epoch=epoch, prior=prior)
        if not answer.solved:
            return Followed(time, COASTING, answer)
        result = self.following.update(answer.matrix, answer.covariance)
        if result != REJECTED:
            matrix, covariance = self.following.attitude, self.following.attitude_covariance
            answer = answer._replace(matrix=matrix, quaternion=quaternion_of(matrix), covariance=covariance)
        return Followed(time, result, answer)
