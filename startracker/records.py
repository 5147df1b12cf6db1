"""Copies of frozen dataclasses with other values."""

from __future__ import annotations

from typing import Any, TypeVar

Record = TypeVar("Record")


def changed(record: Record, **values: Any) -> Record:
    """Copy of a frozen dataclass that neither checks nor derives anything, with other values: as
    `dataclasses.replace`, in a tenth of its time."""
    made = object.__new__(type(record))
    made.__dict__.update(record.__dict__)
    made.__dict__.update(values)
    return made
