"""Star candidates, the result of every detector."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from startracker.display import fields_repr


@dataclass(frozen=True, eq=False)
class Spots:
    """Star candidates as columns of equal length N, brightest first.

    Parameters
    ----------
    x_peak, y_peak : int array
        Brightest pixel; the first in reading order where several are.
    flux : array
        Sum of the signal above the background over the object's pixels, DN.
    pixels : int array
        Number of pixels above the threshold.
    saturated : bool array
        Whether a pixel reaches saturation, or the top is flat.
    edge : bool array
        Whether the object touches the border of the image, so that a part may be missing.
    centre : array, shape (N, 2), optional
        Signal-weighted mean (x, y) of the object's pixels: the middle of a streak.
    streak : array, shape (N, 2), optional
        Length along x and y, px, of the trail caused by the motion of the frame; 0 for a point.
    rejected : mapping of str to int
        Number of objects rejected, by reason.
    other : Spots, optional
        If the frame shows streaks of one motion: the candidates under the hypothesis that was not chosen, points if
        these are streaks, and the reverse.
    direction_rad : float, optional
        Direction, rad from x to y, along which neighbouring objects are aligned far more often than by chance; they may
        be fragments of long trails.
    """

    x_peak: NDArray[np.int64]
    y_peak: NDArray[np.int64]
    flux: NDArray[np.float64]
    pixels: NDArray[np.int64]
    saturated: NDArray[np.bool_]
    edge: NDArray[np.bool_]
    centre: NDArray[np.float64] | None = None
    streak: NDArray[np.float64] | None = None
    rejected: Mapping[str, int] = field(default_factory=dict)
    other: Spots | None = None
    direction_rad: float | None = None

    __repr__ = fields_repr

    def __len__(self) -> int:
        return len(self.flux)

    @property
    def are_streaks(self) -> bool:
        """Whether these are stars trailed by the frame's motion."""
        return self.streak is not None and bool(self.streak.any())

    def take(self, index: NDArray[np.int64]) -> Spots:
        """The candidates at these indices."""
        return replace(
            self,
            x_peak=self.x_peak[index],
            y_peak=self.y_peak[index],
            flux=self.flux[index],
            pixels=self.pixels[index],
            saturated=self.saturated[index],
            edge=self.edge[index],
            centre=None if self.centre is None else self.centre[index],
            streak=None if self.streak is None else self.streak[index],
        )

    @classmethod
    def none(cls, rejected: Mapping[str, int] | None = None) -> Spots:
        """No candidates."""
        integers, flags, points = np.empty(0, np.int64), np.empty(0, np.bool_), np.empty((0, 2))
        return cls(integers, integers, np.empty(0), integers, flags, flags, points, points, rejected or {})
