"""Bias of the 5×5 first moment against Greyling 1995, Table 4.1 (σ = 1.23, offsets 0 to 0.5 px).

The table is that of a Gaussian sampled at the pixels' centres, not integrated over them, and it cuts its digits off
instead of rounding them: 0.0102847 is printed 0.010284. So the computed value lies above the printed one by less than
one unit of the last printed digit, 1e-6, and 1e-5 for the last entry, which has one digit less.
"""

import numpy as np

from startracker.centroid.bias import moment_bias

OFFSET = np.arange(11) * 0.05
TABLE_4_1 = [0, 0.010284, 0.020604, 0.030994, 0.041490, 0.052125, 0.062934, 0.073949, 0.085203, 0.096728, 0.10855]
LAST_DIGIT = [1e-6] * 10 + [1e-5]


def test_table_4_1():
    above = moment_bias(OFFSET, 1.23, 5, integrated=False) - TABLE_4_1
    assert np.all(above >= 0)
    assert np.all(above < LAST_DIGIT)


def test_integration_over_pixels_changes_it_by_a_hundredth():
    # the difference that would show if one were taken for the other
    difference = moment_bias(OFFSET, 1.23, 5) - TABLE_4_1
    assert 0.0099 < difference[-1] < 0.0101
