"""Interstellar extinction, for stars redder than any intrinsic colour."""

from __future__ import annotations

import numpy as np
from numpy.polynomial import polynomial

from startracker.core import FloatArray

R_V = 3.1
"""A_V / E(B−V) of the diffuse interstellar medium; Cardelli, Clayton & Mathis 1989."""

# Coefficients of y⁰ to y⁷ in Cardelli, Clayton & Mathis 1989, eq. 3a and 3b.
_OPTICAL_A = (1.0, 0.17699, -0.50447, -0.02427, 0.72085, 0.01979, -0.77530, 0.32999)
_OPTICAL_B = (0.0, 1.41338, 2.28305, 1.07233, -5.38434, -0.62251, 5.30260, -2.09002)


def extinction_over_av(wavelength_nm: FloatArray) -> FloatArray:
    """A(λ)/A_V = a(x) + b(x)/R_V with x = 1 µm/λ; Cardelli, Clayton & Mathis 1989 (ApJ 345, 245), eq. 1 to 3.

    The optical polynomials are valid from 1.1 to 3.3 µm⁻¹ (303 to 909 nm), the infrared power law beyond 909 nm; below
    303 nm the value is constant.
    """
    # The wave number in µm⁻¹, limited to the range of the optical polynomials.
    x = 1000.0 / np.asarray(wavelength_nm, dtype=float)
    y = np.clip(x, 1.1, 3.3) - 1.82
    optical = polynomial.polyval(y, _OPTICAL_A) + polynomial.polyval(y, _OPTICAL_B) / R_V
    infrared = (0.574 - 0.527 / R_V) * x**1.61
    return np.asarray(np.where(x < 1.1, infrared, optical))


def relative_extinction(wavelength_nm: FloatArray) -> FloatArray:
    """(A(λ) − A_V)/E(B−V), magnitudes per magnitude of colour excess: 1 in B, 0 in V."""
    return R_V * (extinction_over_av(wavelength_nm) - 1.0)
