"""Base class of the sections of a scenario, and types of numbers."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from startracker.display import described

Positive = Annotated[FiniteFloat, Field(gt=0)]
NonNegative = Annotated[FiniteFloat, Field(ge=0)]
Fraction = Annotated[FiniteFloat, Field(ge=0, le=1)]
Count = Annotated[int, Field(ge=1)]


class Section(BaseModel):
    """Base of every section: unknown keys are errors, values are frozen, types are strict."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=False)

    def __repr__(self) -> str:
        changed = [
            f"{name}={getattr(self, name)!r}"
            for name, field in type(self).model_fields.items()
            if getattr(self, name) != field.default
        ]
        return described(type(self).__name__, *changed)

    __str__ = __repr__

    def __dir__(self) -> list[str]:
        """Keys, and the attributes that boresight defines; those inherited from pydantic are omitted."""
        own = {name for kind in type(self).__mro__ if issubclass(kind, Section) for name in vars(kind)}
        return sorted(name for name in {*own, *type(self).model_fields} if not name.startswith(("_", "model_")))
