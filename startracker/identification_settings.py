"""Settings of the identification: a class for what all methods share, and one for each method.

A tracker takes the class of its identifier, or the shared one, which leaves the method's own settings at their
defaults. `AnyIdentificationSettings` holds the settings of all methods, as scenario files do.
"""

from __future__ import annotations

import dataclasses
import math
import warnings
from dataclasses import dataclass
from typing import Any, Self

from startracker.display import changed_fields
from startracker.errors import InputError
from startracker.setting_checks import ABOVE_0, BELOW_1, COUNT, FORBID, FROM_0, POSITIVE, check_settings

__all__ = [
    "SETTINGS",
    "AdaptiveSettings",
    "AnyIdentificationSettings",
    "IdentificationSettings",
    "MatchGroupSettings",
    "PatternHashSettings",
    "PyramidSettings",
    "TriadSettings",
    "settings_of",
    "unread_keys",
]

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
    """What all methods of identification share.

    The keywords of single methods, which this class had before, are taken for one version more, with a warning: it
    then is an `AnyIdentificationSettings`.

    Parameters
    ----------
    min_stars : int
        Fewest stars to accept.
    close_pair_deg, close_pair_magnitude : float
        Guide stars with a neighbour closer than this and less than this much fainter are left out.
    false_alarm_rate : float
        Accept an identification only when the sky gives such agreement by chance less often than this, a frame.
    max_centroids : int
        Brightest centroids that identification takes; what a list holds beyond them is not looked at.
    max_operations : int
        Steps of one search with a known camera (pairs, candidates and stars compared), after which it ends with the
        status ``search_limit``. They are counted, not timed: the same list ends at the same step on every machine. One
        takes a nanosecond or so. `adaptive` shares them out among its assumptions, and ends sooner.
    max_operations_free_scale : int
        The same where the focal length is not known.
    """

    min_stars: int = 3
    close_pair_deg: float = 0.08
    close_pair_magnitude: float = 0.77
    false_alarm_rate: float = 1e-7
    max_centroids: int = 250
    max_operations: int = 2_000_000_000
    max_operations_free_scale: int = 5_000_000_000

    def __new__(cls, *_values: Any, **keys: Any) -> Self:
        """Of this class; with keywords of single methods, of the one that has them all."""
        if cls is IdentificationSettings and keys.keys() & _OWN:
            names, kinds = sorted(keys.keys() & _OWN), sorted({kind.__name__ for kind in SETTINGS.values()})
            text = f"IdentificationSettings: {', '.join(names)} now belong to the identifier's own settings"
            warnings.warn(f"{text} ({', '.join(kinds)})", FutureWarning, stacklevel=2)
            return object.__new__(AnyIdentificationSettings)  # type: ignore[return-value]  # a subclass, made by itself
        return object.__new__(cls)

    def __post_init__(self) -> None:
        names = (f.name for f in dataclasses.fields(self))
        check_settings(self, **{name: _LIMITS[name] for name in names if name in _LIMITS})

    @classmethod
    def of(cls, settings: IdentificationSettings | None) -> Self:
        """Settings of this class: those given, or the values of those given that it has, the others at their defaults.

        Raises
        ------
        InputError
            For the settings of another method.
        """
        if settings is None:
            return cls()
        if isinstance(settings, cls):
            return settings
        if type(settings) not in (IdentificationSettings, AnyIdentificationSettings):
            raise InputError(f"{type(settings).__name__} are the settings of another identifier; give {cls.__name__}")
        shared = {f.name: getattr(settings, f.name) for f in dataclasses.fields(cls) if hasattr(settings, f.name)}
        if shared.get("max_stars", 0) is None:
            del shared["max_stars"]
        return cls(**shared)

    __pydantic_config__ = FORBID


@dataclass(frozen=True)
class AdaptiveSettings(IdentificationSettings):
    """Settings of `adaptive`, besides those that all methods share.

    Parameters
    ----------
    separation_tolerance_deg : float or None
        Largest difference between a measured and a catalogued separation; None: from the camera and the centroids'
        errors, under several assumptions.
    magnitude_tolerance : float
        Largest difference between measured and catalogued magnitude after the frame's zero point is taken off.
    """

    separation_tolerance_deg: float | None = None
    magnitude_tolerance: float = 2.0


@dataclass(frozen=True)
class MatchGroupSettings(IdentificationSettings):
    """Settings of `match_groups` (Van Bezooijen), besides those that all methods share.

    Parameters
    ----------
    separation_tolerance_deg : float or None
        Largest difference between a measured and a catalogued separation; None: from the camera and the centroids'
        errors. Greyling 1995: 0.2°.
    magnitude_tolerance : float
        Largest difference between measured and catalogued magnitude after the frame's zero point is taken off.
    max_stars : int
        Stars that make match groups at a time, the brightest first; 64 at most.
    group_threshold : int
        First limit on the match-group size; lowered from the largest group found.
    max_groups_per_star : int
        Match groups kept for each observed star (Greyling 1995: group size limit).
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
        Brightest stars that make triangles; 64 at most.
    """

    separation_tolerance_deg: float | None = None
    max_stars: int = 30


@dataclass(frozen=True)
class PatternHashSettings(IdentificationSettings):
    """Settings of `pattern_hash`: those that all methods share."""


@dataclass(frozen=True)
class TriadSettings(IdentificationSettings):
    """Settings of `triads` and `triads_integer` (Yee 1999), besides those that all methods share.

    Parameters
    ----------
    separation_tolerance_deg : float or None
        As in `MatchGroupSettings`.
    max_stars : int
        Brightest stars that make triads; 64 at most.
    rotation_tolerance_deg, grouping_tolerance_deg : float
        Largest difference between the two rotations of a triad, and from the mean of its group.
    enclosed_tolerance_deg : float or None
        Largest difference of an inner angle; None leaves that test out.
    vote_number : int
        Fewest triads of a group that must name a guide star.
    three_stars : bool
        Where only three stars are seen and all triads agree, one vote is enough.
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
    """Settings of all methods, as in a scenario; a method reads those that are its own."""

    separation_tolerance_deg: float | None = None
    """All but `pattern_hash`: largest difference between a measured and a catalogued separation; None: from the camera
    and the centroids' errors. Greyling 1995: 0.2°."""
    magnitude_tolerance: float = 2.0
    """`adaptive` and `match_groups`: largest difference between measured and catalogued magnitude after the frame's
    zero point is taken off."""
    max_stars: int | None = None
    """`match_groups`, `pyramid` and triads: brightest stars used; None: the method's own number, 8, 30 and 12."""
    group_threshold: int = 5
    """`match_groups`: first limit on the match-group size; lowered from the largest group found."""
    max_groups_per_star: int = 11
    """`match_groups`: groups kept for each observed star (Greyling 1995: group size limit)."""
    rotation_tolerance_deg: float = 5.0
    """Triads (Yee 1999): largest difference between the two rotations of a triad."""
    grouping_tolerance_deg: float = 5.0
    """Triads: largest difference of a triad's rotation from the mean of its group."""
    enclosed_tolerance_deg: float | None = 1.0
    """Triads: largest difference of an inner angle; None leaves that test out."""
    vote_number: int = 2
    """Triads: fewest of a group that must name a guide star."""
    three_stars: bool = True
    """Triads: where only three stars are seen and all triads agree, one vote is enough."""

    __repr__ = changed_fields


SETTINGS: dict[str, type[IdentificationSettings]] = {
    "adaptive": AdaptiveSettings,
    "match_groups": MatchGroupSettings,
    "pyramid": PyramidSettings,
    "pattern_hash": PatternHashSettings,
    "triads": TriadSettings,
    "triads_integer": TriadSettings,
}
"""Identifier to the class of its settings."""

_OWN = {f.name for f in dataclasses.fields(AnyIdentificationSettings)} - {
    f.name for f in dataclasses.fields(IdentificationSettings)
}


def settings_of(identifier: str, settings: IdentificationSettings | None) -> IdentificationSettings:
    """Settings of an identifier by name; those of an identifier of another package are handed on as they are.

    Raises
    ------
    InputError
        For the settings of another method.
    """
    kind = SETTINGS.get(identifier)
    return kind.of(settings) if kind else settings or AnyIdentificationSettings()


def unread_keys(identifier: str) -> list[str]:
    """Names of `AnyIdentificationSettings` that an identifier does not read; none for one of another package."""
    kind = SETTINGS.get(identifier, AnyIdentificationSettings)
    return sorted(_OWN - {f.name for f in dataclasses.fields(kind)})
