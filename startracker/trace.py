"""Explanation of a solve, stage by stage: findings, attempts and rejections."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar, overload


@dataclass(frozen=True)
class Step:
    """One finding of a stage of a solve.

    Parameters
    ----------
    stage : str
        image, background, detection, centroids, identification, attitude or hint.
    text : str
        The finding with its values and units.
    """

    stage: str
    text: str


Trace = list[Step | Iterable[Step] | Callable[[], Step | Iterable[Step]]]
"""Findings in the order in which the stages of a solve append them; a function creates its text when it is read."""
Finding = TypeVar("Finding", Step, str)


class Steps(Sequence[Finding]):
    """Findings in order.

    The text is created when it is first read, because most callers need only the attitude.

    Parameters
    ----------
    *parts : Step or str, iterable of these, or function without arguments that returns either
    """

    def __init__(self, *parts: Finding | Iterable[Finding] | Callable[[], Finding | Iterable[Finding]]) -> None:
        self._parts: tuple[Any, ...] = parts
        self._findings: tuple[Finding, ...] | None = None

    def _all(self) -> tuple[Finding, ...]:
        if self._findings is None:
            findings: list[Any] = []
            for part in self._parts:
                found = part() if callable(part) else part
                findings.extend((found,) if isinstance(found, (Step, str)) else found)
            self._findings, self._parts = tuple(findings), ()
        return self._findings

    def __len__(self) -> int:
        return len(self._all())

    def __iter__(self) -> Iterator[Finding]:
        return iter(self._all())

    @overload
    def __getitem__(self, index: int) -> Finding: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Finding, ...]: ...
    def __getitem__(self, index: int | slice) -> Finding | tuple[Finding, ...]:
        return self._all()[index]

    def __eq__(self, other: object) -> bool:
        return self._all() == tuple(other) if isinstance(other, (Steps, tuple)) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._all())

    def __repr__(self) -> str:
        stages = ", ".join(dict.fromkeys(getattr(step, "stage", "text") for step in self._all()))
        return f"<{len(self)} steps: {stages}>"

    def __reduce__(self) -> tuple[Any, ...]:
        return Steps, self._all()
