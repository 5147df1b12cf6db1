"""Constant arrays of exported C."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from startracker.errors import InputError


@dataclass(frozen=True)
class CTable:
    """A constant array of C.

    Parameters
    ----------
    type : str
        C type, such as ``int16_t``.
    name : str
        Name without the prefix.
    meaning : str
        Comment: content and units.
    values : integer array
    """

    type: str
    name: str
    meaning: str
    values: NDArray[Any]

    @property
    def bytes(self) -> int:
        """Size in memory."""
        return int(np.dtype(self.type[:-2]).itemsize * self.values.size)

    @property
    def declaration(self) -> str:
        """Declaration, without a semicolon."""
        return f"const {self.type} tracker_{self.name}" + "".join(f"[{n}]" for n in self.values.shape)

    def definition(self) -> Iterable[str]:
        """Lines of the definition; every value is checked against the range of the type.

        Raises
        ------
        InputError
            If a value does not fit.
        """
        limits = np.iinfo(self.type[:-2])
        if self.values.min() < limits.min or self.values.max() > limits.max:
            raise InputError(f"{self.name}: {self.values.min()} to {self.values.max()} does not fit {self.type}")
        yield f"{self.declaration} = {{"
        if self.values.ndim > 1:
            yield from (f"    {braced(row)}," for row in self.values.tolist())
        else:
            flat = self.values.tolist()
            yield from (f"    {', '.join(map(str, flat[n : n + 12]))}," for n in range(0, len(flat), 12))
        yield "};"


def braced(row: Any) -> str:
    """A row of numbers, or of rows, in braces."""
    return f"{{{', '.join(map(braced, row))}}}" if isinstance(row, list) else str(row)
