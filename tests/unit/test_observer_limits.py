"""Velocities and positions that no observer has are refused with a message, whatever their size."""

import numpy as np
import pytest

from startracker import InputError, Observer


@pytest.mark.parametrize("column", ["velocity_km_s", "position_au"])
@pytest.mark.parametrize("value", [1e4, 1e200, -1e308, np.inf, np.nan])
def test_impossible_vectors_are_refused(column, value):
    """The square of 1e200 overflows a float, which is a warning of NumPy."""
    with pytest.raises(InputError, match=column):
        Observer(**{column: [value, 0.0, value]})
