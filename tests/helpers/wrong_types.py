"""Values of wrong types in place of each argument of a call: accepted, or one line of `InputError`."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from startracker.errors import BoresightError

WRONG = {
    "text": "x",
    "None": None,
    "number": 5,
    "negative": -1,
    "fraction": 0.5,
    "NaN": math.nan,
    "infinity": math.inf,
    "complex": 1 + 2j,
    "truth": True,
    "bytes": b"x",
    "list": [1, 2],
    "empty": [],
    "ragged": [[1.0, 2.0], [3.0]],
    "names": [["a", "b"]],
    "mapping": {"a": 1},
    "object": object(),
    "type": int,
    "complex array": np.array([[1j, 2.0]]),
    "text array": np.array(["a"]),
}


def faults_of(
    call: Callable[..., Any],
    right: Mapping[str, Any],
    without: Callable[[str], Iterable[str]] = lambda _: (),
    *,
    many_lines: bool = False,
) -> list[str]:
    """What is neither accepted nor refused in one line; `right` has right arguments, or ... for the call's own.

    `without` gives the kinds that an argument is not tried with; `many_lines` permits a line for each fault.
    """
    given = {name: value for name, value in right.items() if value is not ...}
    faults = []
    for name in right:
        for kind, value in WRONG.items():
            if kind in without(name):
                continue
            try:
                call(**given | {name: value})
            except BoresightError as error:
                if not str(error) or (not many_lines and "\n" in str(error)):
                    faults.append(f"{name}={kind}: {str(error)!r} is not one line")
            except Exception as error:
                faults.append(f"{name}={kind}: {type(error).__name__}: {str(error)[:90]}")
    return faults
