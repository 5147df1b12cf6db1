"""Small systems of linear equations; `c/tracker_linear.c` performs the same operations in the same order."""

from __future__ import annotations

from startracker.flight.real import ONE, ZERO, Real, log2

_LEAST_PIVOT = Real(1, -20)


def factorised(a: list[list[Real]]) -> Real | None:
    """Factorise a symmetric matrix (n, n) in place, A = L D Lᵀ with the inverses of D on the diagonal and L below;
    returns log₂ of the determinant, None if the matrix is not positive definite to 2⁻²⁰."""
    log_det = ZERO
    for k in range(len(a)):
        least = a[k][k] * _LEAST_PIVOT
        row = [ZERO] * k
        pivot = a[k][k]
        for j in range(k):
            value = a[k][j]
            for i in range(j):
                value = value - row[i] * a[j][i]
            row[j] = value
        for j in range(k):
            a[k][j] = row[j] * a[j][j]
            pivot = pivot - row[j] * a[k][j]
        if not pivot > least:
            return None
        log_det = log_det + log2(pivot)
        a[k][k] = ONE / pivot
    return log_det


def solved(a: list[list[Real]], right: list[Real]) -> list[Real]:
    """Solution (n,) of a system with a factorised matrix (n, n)."""
    x = list(right)
    for k in range(len(x)):
        for j in range(k):
            x[k] = x[k] - a[k][j] * x[j]
    for k in range(len(x) - 1, -1, -1):
        x[k] = x[k] * a[k][k]
        for j in range(k + 1, len(x)):
            x[k] = x[k] - a[j][k] * x[j]
    return x
