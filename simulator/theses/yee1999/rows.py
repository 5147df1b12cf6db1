"""Rows of printed beside computed values that hold several numbers each."""

from __future__ import annotations

from collections.abc import Sequence
from decimal import Decimal

from simulator.theses.printed import Row, Verdict, verdict_of, with_unit

__all__ = ["joined", "worst"]

_ORDER: tuple[Verdict, ...] = ("exact", "close", "differs")


def worst(verdicts: Sequence[Verdict]) -> Verdict:
    """The worst of several verdicts of a comparison."""
    return max(verdicts, key=_ORDER.index)


def joined(
    where: str,
    quantity: str,
    printed: Sequence[str],
    computed: Sequence[float],
    *,
    unit: str = "",
    close: float = 0.05,
    why: str = "",
) -> Row:
    """Row of several numbers of one unit; its verdict is the worst of theirs, each by its printed digits.

    Parameters
    ----------
    where, quantity, why : str
        As in `Row`.
    printed : sequence of str
        Numbers as printed.
    computed : sequence of float
        The same computed; shown to the printed digits.
    unit : str
        Of all.
    close : float
        Greatest relative difference that still counts as close.
    """
    verdicts = [verdict_of(text, value, close) for text, value in zip(printed, computed, strict=True)]
    shown = [
        f"{value:.{max(-int(Decimal(text).as_tuple().exponent), 0)}f}"
        for text, value in zip(printed, computed, strict=True)
    ]
    return Row(
        where, quantity, with_unit(", ".join(printed), unit), with_unit(", ".join(shown), unit), worst(verdicts), why
    )
