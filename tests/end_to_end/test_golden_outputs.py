"""The whole of the software answers as the golden outputs have it: `tests/helpers/golden_outputs.py`."""

import numpy as np
import pytest
from golden_outputs import GROUPS, differences, processor, read

RTOL = 1e-9
"""Last digits of a sum that a compiler has put into another order, of numbers which depend on few such sums."""


@pytest.mark.slow
@pytest.mark.parametrize("group", GROUPS)
def test_as_the_golden_outputs(group):
    """Otherwise, if the change is meant: python tests/helpers/golden_outputs.py --write, and why in the commit."""
    kept, where = read(group)
    if where != processor():
        pytest.skip(f"the golden outputs are of another processor: {where}")
    assert differences(GROUPS[group](), kept, RTOL) == []


def test_each_kind_of_difference_is_named():
    kept = {"a": np.array([1.0, np.nan]), "b": np.array(["x"]), "c": np.zeros(2), "e": np.zeros(1)}
    found = {"a": np.array([1.0 + 1e-12, np.nan]), "b": np.array(["y"]), "c": np.zeros(3), "d": np.zeros(1)}
    assert differences(found, kept, RTOL) == [
        "b: 1 of 1 differ, first (0,): y now, x before",
        "c: (3,) now, (2,) before",
        "d: only now",
        "e: only before",
    ]
    assert differences(found, kept)[0].startswith("a: 1 of 2 differ")
    assert differences(kept, kept) == []


def test_all_groups_are_kept():
    assert all(read(group)[0] for group in GROUPS)
