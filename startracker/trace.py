"""What a solve did, stage by stage: found, tried, rejected."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar, overload

__all__ = ["Step", "Steps"]


@dataclass(frozen=True)
class Step:
    """One finding.

    Parameters
    ----------
    stage : str
        Stage it belongs to: image, background, detection, centroids, identification, attitude, hint.
    text : str
        The finding in words, with its numbers and units.
    """

    stage: str
    text: str


Finding = TypeVar("Finding", Step, str)


class Steps(Sequence[Finding]):
    """Findings in order, put into words when they are first read: most solves are asked for their attitude alone.

    Parameters
    ----------
    *parts : Step or str, iterable of such, or function without arguments that gives either
    """

    def __init__(self, *parts: Finding | Iterable[Finding] | Callable[[], Finding | Iterable[Finding]]) -> None:
        self._parts: tuple[Any, ...] = parts
        self._told: tuple[Finding, ...] | None = None

    def _all(self) -> tuple[Finding, ...]:
        if self._told is None:
            told: list[Any] = []
            for part in self._parts:
                found = part() if callable(part) else part
                told.extend((found,) if isinstance(found, (Step, str)) else found)
            self._told, self._parts = tuple(told), ()
        return self._told

    def __len__(self) -> int:
        return len(self._all())

    def __iter__(self) -> Iterator[Finding]:
        return iter(self._all())

    @overload
    def __getitem__(self, place: int) -> Finding: ...
    @overload
    def __getitem__(self, place: slice) -> tuple[Finding, ...]: ...
    def __getitem__(self, place: int | slice) -> Finding | tuple[Finding, ...]:
        return self._all()[place]

    def __eq__(self, other: object) -> bool:
        return self._all() == tuple(other) if isinstance(other, (Steps, tuple)) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._all())

    def __repr__(self) -> str:
        return repr(self._all())

    def __reduce__(self) -> tuple[Any, ...]:
        return Steps, self._all()
