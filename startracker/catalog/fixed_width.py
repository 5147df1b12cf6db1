"""Tables in fixed-width columns, as the CDS publishes them, read a whole column at a time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from startracker.errors import InputError


@dataclass(frozen=True, eq=False)
class FixedWidth:
    """Rows of bytes of equal length.

    Parameters
    ----------
    cells : uint8 array, shape (rows, width)
        The characters.
    where : str
        Name of the table, for error messages.
    """

    cells: NDArray[np.uint8]
    where: str

    @classmethod
    def from_bytes(cls, data: bytes, width: int, where: str) -> FixedWidth:
        """Table of a file's bytes; short rows are filled with blanks, longer ones cut at `width`.

        Raises
        ------
        InputError
            When there is no row in the file.
        """
        rows = np.array(data.splitlines(), dtype=f"S{width}")
        if rows.size == 0:
            raise InputError(f"{where}: the file is empty; install boresight anew")
        cells = rows.view(np.uint8).reshape(len(rows), width)
        return cls(np.where(cells == 0, np.uint8(ord(" ")), cells), where)

    def rows(self, keep: NDArray[np.bool_]) -> FixedWidth:
        """The rows chosen by a mask."""
        return FixedWidth(self.cells[keep], self.where)

    def text(self, first: int, last: int) -> NDArray[np.str_]:
        """Column of bytes `first` to `last` (from 1, both included) as stripped text."""
        return np.char.strip(np.char.decode(self._column(first, last), "latin-1"))

    def number(self, first: int, last: int, missing: float = np.nan) -> NDArray[np.float64]:
        """Column as numbers, `missing` where it is blank.

        Raises
        ------
        InputError
            When a cell is neither blank nor a number.
        """
        column = np.char.strip(self._column(first, last))
        blank = column == b""
        try:
            values = np.where(blank, b"nan", column).astype(np.float64)
        except ValueError as error:
            raise InputError(
                f"{self.where}: bytes {first} to {last} hold what is no number ({error}); the file is damaged, "
                "install its package anew"
            ) from error
        return np.where(blank, missing, values)

    def _column(self, first: int, last: int) -> NDArray[np.bytes_]:
        block = np.ascontiguousarray(self.cells[:, first - 1 : last])
        return block.view(f"S{last - first + 1}")[:, 0]
