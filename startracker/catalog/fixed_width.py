"""Tables with fixed-width columns, as published by the CDS, parsed column by column."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from startracker.errors import InputError


@dataclass(frozen=True, eq=False)
class FixedWidth:
    """Rows of bytes of equal length."""

    cells: NDArray[np.uint8]
    """Characters, (rows, width)."""
    where: str
    """Name of the table, for error messages."""

    @classmethod
    def from_bytes(cls, data: bytes, width: int, where: str) -> FixedWidth:
        """Table from the contents of a file; short rows are padded with blanks, longer ones truncated at `width`.

        Raises
        ------
        InputError
            If the file is empty.
        """
        rows = np.array(data.splitlines(), dtype=f"S{width}")
        if rows.size == 0:
            raise InputError(f"{where}: the file is empty; reinstall boresight")
        cells = rows.view(np.uint8).reshape(len(rows), width)
        return cls(np.where(cells == 0, np.uint8(ord(" ")), cells), where)

    def rows(self, keep: NDArray[np.bool_]) -> FixedWidth:
        """Rows selected by a mask."""
        return FixedWidth(self.cells[keep], self.where)

    def text(self, first: int, last: int) -> NDArray[np.str_]:
        """Column of bytes `first` to `last` (from 1, both included) as stripped text."""
        return np.char.strip(np.char.decode(self._column(first, last), "latin-1"))

    def number(self, first: int, last: int, missing: float = np.nan) -> NDArray[np.float64]:
        """Column as numbers, `missing` where it is blank.

        Raises
        ------
        InputError
            If a cell is neither blank nor a number.
        """
        column = np.char.strip(self._column(first, last))
        blank = column == b""
        try:
            values = np.where(blank, b"nan", column).astype(np.float64)
        except ValueError as error:
            raise InputError(
                f"{self.where}: bytes {first} to {last} are not a number ({error}); the file is damaged, "
                "reinstall its package"
            ) from error
        return np.where(blank, missing, values)

    def _column(self, first: int, last: int) -> NDArray[np.bytes_]:
        block = np.ascontiguousarray(self.cells[:, first - 1 : last])
        return block.view(f"S{last - first + 1}")[:, 0]
