"""Settings of the identification: a class with the common settings, and one class per method.

A tracker takes the class of its identifier, or the common class, with which the settings of the method have their
defaults. `AnyIdentificationSettings` has the settings of all methods, as in scenario files.
"""

from __future__ import annotations

import dataclasses
import math
import warnings
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Self

from startracker.arguments import ABOVE_0, of_kind, text
from startracker.display import changed_fields
from startracker.errors import InputError
from startracker.settings.checks import BELOW_1, COUNT, FORBID, FROM_0, POSITIVE, check_settings

_LIMITS: dict[str, tuple[float, float]] = {
    "min_stars": (2, math.inf),
    "close_pair_deg": FROM_0,
    "close_pair_magnitude": FROM_0,
    "false_alarm_rate": (ABOVE_0, BELOW_1),
    "max_centroids": (3, math.inf),
    "max_operations": COUNT,
    "max_operations_free_scale": COUNT,
    "separation_tolerance_deg": (ABOVE_0, 180.0),
    "magnitude_tolerance": POSITIVE,
    "max_stars": (2, math.inf),
    "group_threshold": COUNT,
    "max_groups_per_star": COUNT,
    "rotation_tolerance_deg": POSITIVE,
    "grouping_tolerance_deg": POSITIVE,
    "enclosed_tolerance_deg": POSITIVE,
    "vote_number": COUNT,
}


@dataclass(frozen=True)
class IdentificationSettings:
    """Settings common to all methods of identification.

    Keywords of single methods, which this class had before, are accepted for one more version with a warning; the
    result is then an `AnyIdentificationSettings`.

    Parameters
    ----------
    min_stars : int
        Minimum number of matched stars.
    close_pair_deg : float
        Guide stars with a neighbour closer than this are not used in patterns; they are still matched.
    close_pair_magnitude : float
        Only neighbours that are brighter, or fainter by less than this, count.
    false_alarm_rate : float
        Maximum probability per frame that an accepted identification is due to chance.
    max_centroids : int
        Number of centroids used for identification, the brightest; others are ignored.
    max_operations : int
        Maximum number of operations of a search with a known camera (pairs, candidates and stars compared), after which
        it ends with the status ``search_limit``. They are counted, not timed, so that a search ends at the same
        operation on every machine; one takes about a nanosecond. `adaptive` divides them among its assumptions and ends
        earlier.
    max_operations_free_scale : int
        The same for an unknown focal length.
    """

    min_stars: int = 3
    close_pair_deg: float = 0.08
    close_pair_magnitude: float = 0.77
    false_alarm_rate: float = 1e-7
    max_centroids: int = 250
    max_operations: int = 2_000_000_000
    max_operations_free_scale: int = 5_000_000_000

    def __new__(cls, *_values: Any, **keys: Any) -> Self:
        """An object of this class; with keywords of single methods, an object of `AnyIdentificationSettings`."""
        if cls is IdentificationSettings and keys.keys() & _OWN:
            names, kinds = sorted(keys.keys() & _OWN), sorted({kind.__name__ for kind in SETTINGS.values()})
            text = f"IdentificationSettings: {', '.join(names)} now belong to the identifier's own settings"
            warnings.warn(f"{text} ({', '.join(kinds)})", FutureWarning, stacklevel=2)
            return object.__new__(AnyIdentificationSettings)  # type: ignore[return-value]  # a subclass, converted by itself
        return object.__new__(cls)

    def __post_init__(self) -> None:
        names = (f.name for f in dataclasses.fields(self))
        check_settings(self, **{name: _LIMITS[name] for name in names if name in _LIMITS})

    @classmethod
    def of(cls, settings: IdentificationSettings | None) -> Self:
        """Settings of this class: the given ones, or their values that this class has, with defaults for the others.

        Raises
        ------
        InputError
            For settings of another method.
        """
        of_kind("settings", settings, (IdentificationSettings, type(None)))
        if isinstance(settings, cls):
            return settings
        converted: Self = _converted(cls, settings)  # type: ignore[arg-type]  # a class is hashable
        return converted

    __pydantic_config__ = FORBID


@dataclass(frozen=True)
class AdaptiveSettings(IdentificationSettings):
    """Settings of `adaptive`, besides those that all methods share.

    Parameters
    ----------
    separation_tolerance_deg : float or None
        Maximum difference between measured and catalogue separation; None: from the camera and the centroid errors,
        under several assumptions.
    magnitude_tolerance : float
        Maximum difference between measured and catalogue magnitude after subtraction of the frame's zero point.
    """

    separation_tolerance_deg: float | None = None
    magnitude_tolerance: float = 2.0


@dataclass(frozen=True)
class MatchGroupSettings(IdentificationSettings):
    """Settings of `match_groups` (Van Bezooijen), besides those that all methods share.

    Parameters
    ----------
    separation_tolerance_deg : float or None
        Maximum difference between measured and catalogue separation; None: from the camera and the centroid errors.
        Greyling 1995: 0.2°.
    magnitude_tolerance : float
        Maximum difference between measured and catalogue magnitude after subtraction of the frame's zero point.
    max_stars : int
        Number of stars in match groups, the brightest; at most 64.
    group_threshold : int
        Initial threshold of the group size, which is decreased from the largest group found.
    max_groups_per_star : int
        Number of match groups kept for each observed star (Greyling 1995: group size limit).
    """

    separation_tolerance_deg: float | None = None
    magnitude_tolerance: float = 2.0
    max_stars: int = 8
    group_threshold: int = 5
    max_groups_per_star: int = 11


@dataclass(frozen=True)
class PyramidSettings(IdentificationSettings):
    """Settings of `pyramid` (Mortari), besides those that all methods share.

    Parameters
    ----------
    separation_tolerance_deg : float or None
        As in `MatchGroupSettings`.
    max_stars : int
        Number of stars in triangles, the brightest; at most 64.
    """

    separation_tolerance_deg: float | None = None
    max_stars: int = 30


@dataclass(frozen=True)
class PatternHashSettings(IdentificationSettings):
    """Settings of `pattern_hash`: the common ones."""


@dataclass(frozen=True)
class TriadSettings(IdentificationSettings):
    """Settings of `triads` (Yee 1999), besides those that all methods share.

    Parameters
    ----------
    separation_tolerance_deg : float or None
        As in `MatchGroupSettings`.
    max_stars : int
        Number of stars in triads, the brightest; at most 64.
    rotation_tolerance_deg, grouping_tolerance_deg : float
        Maximum difference between the two rotations of a triad, and from the mean of its group.
    enclosed_tolerance_deg : float or None
        Largest difference of an inner angle; None: no test.
    vote_number : int
        Minimum number of votes for a guide star in a group of triads.
    three_stars : bool
        Accept a single vote if only three stars are observed and all triads agree.
    """

    separation_tolerance_deg: float | None = None
    max_stars: int = 12
    rotation_tolerance_deg: float = 5.0
    grouping_tolerance_deg: float = 5.0
    enclosed_tolerance_deg: float | None = 1.0
    vote_number: int = 2
    three_stars: bool = True


@dataclass(frozen=True)
class AnyIdentificationSettings(IdentificationSettings):
    """Settings of all methods, as in a scenario; a method uses its own."""

    separation_tolerance_deg: float | None = None
    """All except `pattern_hash`: maximum difference between measured and catalogue separation; None: from the camera
    and the centroid errors. Greyling 1995: 0.2°."""
    magnitude_tolerance: float = 2.0
    """`adaptive` and `match_groups`: maximum difference between measured and catalogue magnitude after subtraction of
    the frame's zero point."""
    max_stars: int | None = None
    """`match_groups`, `pyramid` and triads: number of stars used, the brightest; None: 8, 30 and 12, respectively."""
    group_threshold: int = 5
    """`match_groups`: initial threshold of the group size, which is decreased from the largest group found."""
    max_groups_per_star: int = 11
    """`match_groups`: number of groups kept for each observed star (Greyling 1995: group size limit)."""
    rotation_tolerance_deg: float = 5.0
    """Triads (Yee 1999): maximum difference between the two rotations of a triad."""
    grouping_tolerance_deg: float = 5.0
    """Triads: maximum difference of a triad's rotation from the mean of its group."""
    enclosed_tolerance_deg: float | None = 1.0
    """Triads: largest difference of an inner angle; None: no test."""
    vote_number: int = 2
    """Triads: minimum number of votes for a guide star in a group."""
    three_stars: bool = True
    """Triads: accept a single vote if only three stars are observed and all triads agree."""

    __repr__ = changed_fields


SETTINGS: dict[str, type[IdentificationSettings]] = {
    "adaptive": AdaptiveSettings,
    "match_groups": MatchGroupSettings,
    "pyramid": PyramidSettings,
    "pattern_hash": PatternHashSettings,
    "triads": TriadSettings,
}
"""Class of the settings of each identifier."""

_OWN = {f.name for f in dataclasses.fields(AnyIdentificationSettings)} - {
    f.name for f in dataclasses.fields(IdentificationSettings)
}


@lru_cache(maxsize=32)
def _converted(kind: Any, settings: IdentificationSettings | None) -> Any:
    """Settings of one class from those of another, see `IdentificationSettings.of`."""
    if settings is None:
        return kind()
    if type(settings) not in (IdentificationSettings, AnyIdentificationSettings):
        raise InputError(f"{type(settings).__name__} are the settings of another identifier; give {kind.__name__}")
    shared = {f.name: getattr(settings, f.name) for f in dataclasses.fields(kind) if hasattr(settings, f.name)}
    # None stands for the method's own default, which the class of the method has.
    if shared.get("max_stars", 0) is None:
        del shared["max_stars"]
    return kind(**shared)


def settings_of(identifier: str, settings: IdentificationSettings | None) -> IdentificationSettings:
    """Settings of an identifier by name; those of an identifier of another package are returned unchanged.

    Raises
    ------
    InputError
        For settings of another method.
    """
    of_kind("identification", settings, (IdentificationSettings, type(None)))
    kind = SETTINGS.get(text("identifier", identifier))
    return kind.of(settings) if kind else settings or AnyIdentificationSettings()


def unread_keys(identifier: str) -> list[str]:
    """Names of `AnyIdentificationSettings` that an identifier does not use; empty for one of another package."""
    kind = SETTINGS.get(identifier, AnyIdentificationSettings)
    return sorted(_OWN - {f.name for f in dataclasses.fields(kind)})
