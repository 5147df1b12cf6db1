"""Interpolation of tables of states: Lagrange's polynomials, and Hermite's through positions and velocities."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from startracker.core import FloatArray


@dataclass(frozen=True, eq=False)
class StateTable:
    """States at ascending times, interpolated by polynomials through the nearest of them.

    The nodes are selected as in SPICE's types 8, 9, 12 and 13 (*SPK Required Reading*): an even number is half before
    and half after the instant, an odd number is centred on the nearest node; near an end of the table the first or last
    nodes are used."""

    t_s: FloatArray
    """(N,): Ascending."""
    states: FloatArray
    """(N, C): Quantities; for ``hermite`` C/2 quantities followed by their derivatives."""
    method: Literal["lagrange", "hermite"]
    """``lagrange``: a polynomial through the values of each column. ``hermite``: a polynomial through positions and
    velocities, and its derivative as the velocity."""
    nodes: int
    """Nodes of a polynomial: degree + 1 for ``lagrange``, (degree + 1) / 2 for ``hermite``; at most N."""

    def state(self, t_s: FloatArray) -> FloatArray:
        """States (T, C) at times (T,) within the table."""
        first = self._first(t_s)
        rows = first[:, None] + np.arange(self.nodes)
        # With the instant as the origin of time, the polynomials are evaluated at 0.
        x, y = self.t_s[rows] - t_s[:, None], self.states[rows]
        if self.method == "lagrange":
            return _newton(x, _differences(x, y))[0]
        doubled = np.repeat(x, 2, axis=1)
        position, velocity = _newton(doubled, _doubled_differences(x, y))
        return np.concatenate([position, velocity], axis=1)

    def _first(self, t_s: FloatArray) -> NDArray[np.int64]:
        """First node (T,) of the polynomial of each time."""
        if self.nodes % 2 == 0:
            first = np.searchsorted(self.t_s, t_s, side="right") - self.nodes // 2
        else:
            # The nearest node changes at the middle of two nodes.
            nearest = np.searchsorted((self.t_s[1:] + self.t_s[:-1]) / 2.0, t_s, side="right")
            first = nearest - self.nodes // 2
        return np.asarray(np.clip(first, 0, len(self.t_s) - self.nodes))


def _differences(x: FloatArray, y: FloatArray) -> list[FloatArray]:
    """Newton's divided differences: n coefficients (T, C) for nodes (T, n) with values (T, n, C)."""
    table, coefficients = y, [y[:, 0]]
    for order in range(1, x.shape[1]):
        apart = (x[:, order:] - x[:, :-order])[..., None]
        table = (table[:, 1:] - table[:, :-1]) / apart
        coefficients.append(table[:, 0])
    return coefficients


def _doubled_differences(x: FloatArray, y: FloatArray) -> list[FloatArray]:
    """Divided differences of nodes (T, n), each taken twice, with positions and derivatives (T, n, C)."""
    half = y.shape[-1] // 2
    position, slope = y[..., :half], y[..., half:]
    doubled = np.repeat(x, 2, axis=1)
    table = np.repeat(position, 2, axis=1)
    first = np.empty_like(table[:, 1:])
    # The divided difference of two equal nodes is the derivative; between different nodes it is the usual quotient.
    first[:, 0::2] = slope
    first[:, 1::2] = (position[:, 1:] - position[:, :-1]) / (x[:, 1:] - x[:, :-1])[..., None]
    coefficients, table = [position[:, 0], first[:, 0]], first
    for order in range(2, doubled.shape[1]):
        apart = (doubled[:, order:] - doubled[:, :-order])[..., None]
        table = (table[:, 1:] - table[:, :-1]) / apart
        coefficients.append(table[:, 0])
    return coefficients


def _newton(x: FloatArray, coefficients: list[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Value and derivative (T, C) at 0 of Newton's polynomial with nodes (T, n), by Horner's scheme."""
    value, slope = coefficients[-1], np.zeros_like(coefficients[-1])
    for order in range(len(coefficients) - 2, -1, -1):
        away = -x[:, order, None]
        slope = slope * away + value  # uses the value before its update: (p x + c)′ = p′ x + p
        value = value * away + coefficients[order]
    return value, slope
