"""Bias of the 5×5 first moment against Greyling 1995, "A CCD star sensor system for a low Earth orbit microsatellite",
Table 4.1 (σ = 1.23, offsets 0 to 0.5 detector lengths).

The table is that of a Gaussian sampled at the pixels' centres, not integrated over them. It prints five significant
digits (six decimals up to 0.1, where it cuts off rather than rounds), so 5e-6 is what the last digit of its coarsest
entry, 0.10855, allows.
"""

import numpy as np

from startracker.centroid.bias import moment_bias

OFFSET = np.arange(11) * 0.05
TABLE_4_1 = [0, 0.010284, 0.020604, 0.030994, 0.041490, 0.052125, 0.062934, 0.073949, 0.085203, 0.096728, 0.10855]


def test_table_4_1():
    assert np.abs(moment_bias(OFFSET, 1.23, 5, integrated=False) - TABLE_4_1).max() < 5e-6


def test_integration_over_pixels_changes_it_by_a_hundredth():
    # the difference that would show if one were taken for the other
    difference = moment_bias(OFFSET, 1.23, 5) - TABLE_4_1
    assert 0.0099 < difference[-1] < 0.0101
