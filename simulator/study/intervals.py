"""95 % confidence intervals: of moments by bootstrap, of percentiles by order statistics, of rates and ratios."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.fft import irfft, rfft
from scipy.special import bdtr, gammaincinv, ndtr, ndtri  # scipy.stats takes 17 MB and 0.2 s to load

from simulator.randomness import stream
from startracker.core import FloatArray

Interval = tuple[float, float]

RESAMPLES = 1000
"""Number of bootstrap samples, for which the limits of a 95 % interval are accurate to a tenth of its half width."""

LARGE = 5_000
"""Above this number of trials intervals are computed from moments, since resampling would take seconds; the difference
is less than the scatter of the resampling."""

FEWEST = 5
"""Minimum number of trials for an interval."""

_TAILS = (0.5 - 0.95 / 2, 0.5 + 0.95 / 2)
"""Probabilities of the two limits of a 95 % interval."""

Moment = Callable[[FloatArray, FloatArray, int], FloatArray]


def _mean(first: FloatArray, second: FloatArray, n: int) -> FloatArray:
    return first / n


def _std(first: FloatArray, second: FloatArray, n: int) -> FloatArray:
    return np.sqrt(np.maximum(second - first * first / n, 0.0) / (n - 1))


def _rms(first: FloatArray, second: FloatArray, n: int) -> FloatArray:
    return np.sqrt(second / n)


MOMENTS: dict[str, Moment] = {"mean": _mean, "std": _std, "rms": _rms}
"""Statistics by name as functions of Σx, Σx² and n."""


def wilson_interval(successes: float, trials: float) -> Interval:
    """Wilson's score interval of a proportion (Wilson 1927, J. Am. Stat. Assoc. 22, 209); (0, 1) for no trials.

    Valid near 0 and 1, where the normal approximation gives intervals of zero width. Effective numbers of correlated
    trials need not be whole.
    """
    if trials == 0:
        return 0.0, 1.0
    z = NormalDist().inv_cdf(_TAILS[1])
    p = successes / trials
    middle = (p + z * z / (2 * trials)) / (1 + z * z / trials)
    half = z / (1 + z * z / trials) * math.sqrt(p * (1 - p) / trials + z * z / (4 * trials * trials))
    # at the ends the two terms are equal, and their difference would be rounding error
    return (0.0 if successes == 0 else middle - half), (1.0 if successes == trials else middle + half)


def moment_intervals(values: ArrayLike, seed: int = 0) -> dict[str, FloatArray | None]:
    """Intervals of mean, standard deviation (n − 1) and rms of every column.

    Bootstrap, bias-corrected and accelerated (BCa; Efron 1987, J. Am. Stat. Assoc. 82, 171): rows are resampled with
    replacement, all columns together, `RESAMPLES` times; the acceleration is estimated by the jackknife. Above `LARGE`
    rows the normal interval of the mean and those of `spread_interval` are used, based on the same moments.

    Parameters
    ----------
    values : array_like, shape (n, columns)
        Finite; rows are independent trials.
    seed : int
        Seed of the resampling (stream ``bootstrap``): the same values and seed give the same intervals.

    Returns
    -------
    dict
        By the names of `MOMENTS`: lower and upper limits (columns, 2); None below `FEWEST` rows.
    """
    x = np.asarray(values, dtype=float)
    n = len(x)
    if n < FEWEST:
        return dict.fromkeys(MOMENTS)
    if n > LARGE:
        return _from_moments(x)
    scale = np.sqrt(np.mean(x * x, axis=0))
    scale = np.where(scale > 0.0, scale, 1.0)  # scaled, so that squares of small angles keep their precision
    x = x / scale
    squares = x * x
    both = np.concatenate([x, squares], axis=1)
    drawn = _resampled(both, seed)
    columns = x.shape[1]
    first, second = both.sum(axis=0)[:columns], both.sum(axis=0)[columns:]
    found: dict[str, FloatArray | None] = {}
    for name, moment in MOMENTS.items():
        samples = moment(drawn[:, :columns], drawn[:, columns:], n)
        left_out = moment(first - x, second - squares, n - 1)
        found[name] = _bca(samples, moment(first, second, n), left_out) * scale[:, None]
    return found


def _resampled(x: FloatArray, seed: int) -> FloatArray:
    """Column sums (B, columns) of rows (n, columns) drawn with replacement, from the number of times each row is
    drawn."""
    n = len(x)
    rng = stream(seed, "bootstrap")
    drawn = np.empty((RESAMPLES, x.shape[1]))
    at_once = max(1, 500_000 // n)
    for start in range(0, RESAMPLES, at_once):
        rows = min(at_once, RESAMPLES - start)
        index = rng.integers(0, n, (rows, n), dtype=np.int32)
        index += np.arange(rows, dtype=np.int32)[:, None] * n
        counts = np.bincount(index.ravel(), minlength=rows * n).reshape(rows, n)
        drawn[start : start + rows] = counts.astype(np.float64) @ x
    return drawn


def _bca(samples: FloatArray, value: FloatArray, left_out: FloatArray) -> FloatArray:
    """BCa intervals (columns, 2) from bootstrap samples (B, columns) and jackknife values (n, columns)."""
    below = np.mean(samples < value, axis=0) + 0.5 * np.mean(samples == value, axis=0)
    half = 0.5 / len(samples)
    bias = ndtri(np.clip(below, half, 1.0 - half))
    off = left_out.mean(axis=0) - left_out
    spread = np.sum(off * off, axis=0)
    acceleration = np.sum(off**3, axis=0) / (6.0 * np.where(spread > 0.0, spread, 1.0) ** 1.5)
    z = ndtri(np.array(_TAILS))[:, None]
    levels = ndtr(bias + (bias + z) / (1.0 - acceleration * (bias + z)))
    return np.array([np.quantile(samples[:, k], levels[:, k]) for k in range(samples.shape[1])])


def _from_moments(x: FloatArray) -> dict[str, FloatArray | None]:
    n = len(x)
    mean, std = x.mean(axis=0), x.std(axis=0, ddof=1)
    half = float(ndtri(_TAILS[1])) * std / math.sqrt(n)
    return {
        "mean": np.stack([mean - half, mean + half], axis=1),
        "std": np.array([spread_interval(column - m) for column, m in zip(x.T, mean, strict=True)]),
        "rms": np.array([spread_interval(column) for column in x.T]),
    }


def spread_interval(values: ArrayLike) -> Interval:
    """Interval of the rms about zero from the second and fourth moments.

    n m₂ / σ² has a χ² distribution of ν degrees of freedom scaled by n / ν, with ν = 2 n m₂² / (m₄ − m₂²) chosen to
    match the variance of m₂ (Box 1953, Biometrika 40, 318): n for a normal distribution, fewer for heavier tails. ν is
    limited to n, so that a small sample is not assigned a narrower interval than a normal one.

    Returns
    -------
    (low, high)
        NaN for no values.
    """
    x = np.asarray(values, dtype=float)
    n = len(x)
    if n == 0:
        return math.nan, math.nan
    squares = x * x
    m2 = float(np.mean(squares))
    if m2 == 0.0:
        return 0.0, 0.0
    excess = float(np.mean((squares / m2 - 1.0) ** 2))
    freedom = n if excess <= 2.0 else 2.0 * n / excess
    low, high = _central_chi_square(freedom)
    return math.sqrt(m2 * freedom / high), math.sqrt(m2 * freedom / low)


def percentile_interval(
    ordered: FloatArray, percent: float, independent: float | None = None
) -> tuple[float | None, float | None]:
    """Distribution-free 95 % interval of a percentile between two order statistics.

    P(x₍ₖ₎ ≤ q) = P(Bin(n, p) ≥ k): the bootstrap of a percentile needs no resampling, as the number of values below it
    is binomial (Conover 1999, *Practical Nonparametric Statistics*, section 3.2). The coverage is at least 95 %. A
    limit is None if it is outside the sample: the 99.7th percentile has an upper limit of 97.5 % only from 1,228 values
    on.

    Parameters
    ----------
    ordered : (n,) array
        Values, ascending.
    percent : float
        Percentile, 0 to 100.
    independent : float, optional
        Effective number of independent values, if they are correlated (`effective_number`); at most their number. The
        k-th of m independent values is taken as the (k − 1) n / m-th for the lower limit and the k n / m-th for the
        upper one, so that the interval is rather too wide.
    """
    n, p, tail = len(ordered), percent / 100.0, _TAILS[0]
    if n == 0:
        return None, None
    m = n if independent is None else min(max(int(independent), 1), n)
    low = _binomial_quantile(tail, m, p)  # P(Bin < low) ≤ tail
    high = _binomial_quantile(1.0 - tail, m, p) + 1  # P(Bin ≥ high) ≤ tail
    first, last = (low - 1) * n // m, -(-high * n // m) - 1  # their positions among all values
    return (float(ordered[first]) if low >= 1 else None), (float(ordered[last]) if high <= m else None)


def effective_number(values: FloatArray) -> float:
    """Effective number of independent values of a correlated series, for its mean.

    N / (1 + 2 Σ ρ_k), the sum over lags while pairs of autocorrelations stay positive (Geyer 1992, Statistical Science
    7, 473: the initial positive sequence); between 1 and N.
    """
    n = len(values)
    centred = values - values.mean() if n else values
    power = float(centred @ centred)
    if n < 4 or power <= 1e-24 * float(values @ values):  # a constant, to rounding
        return float(n)
    spectrum = rfft(centred, 2 * n)
    correlation = irfft(np.abs(spectrum) ** 2, 2 * n)[:n] / power
    total = 1.0
    for k in range(1, n - 1, 2):
        pair = float(correlation[k] + correlation[k + 1])
        if pair <= 0.0:
            break
        total += 2.0 * pair
    return float(np.clip(n / total, 1.0, n))


def ratios_of_rms(errors: ArrayLike, bounds: ArrayLike, seed: int = 0) -> tuple[FloatArray, FloatArray | None]:
    """rms(errors) / rms(bounds) of every column (columns,) with its 95 % interval (columns, 2); rows are trials.

    Bootstrap of pairs as in `moment_intervals`; by the delta method above `LARGE`: the variance of ln Σe² − ln Σb² is
    Σ(e²/Σe² − b²/Σb²)². No interval below `FEWEST` rows.
    """
    e2, b2 = np.asarray(errors, dtype=float) ** 2, np.asarray(bounds, dtype=float) ** 2
    n, columns = e2.shape
    ratio = np.sqrt(e2.sum(axis=0) / b2.sum(axis=0))
    if n < FEWEST:
        return ratio, None
    share_e, share_b = e2 / e2.sum(axis=0), b2 / b2.sum(axis=0)
    if n > LARGE:
        half = float(ndtri(0.975)) * 0.5 * np.sqrt(np.sum((share_e - share_b) ** 2, axis=0))
        return ratio, np.stack([ratio * np.exp(-half), ratio * np.exp(half)], axis=1)
    drawn = _resampled(np.concatenate([share_e, share_b], axis=1), seed)
    samples = np.sqrt(drawn[:, :columns] / drawn[:, columns:])
    left_out = np.sqrt((1.0 - share_e) / (1.0 - share_b))
    return ratio, _bca(samples, np.ones(columns), left_out) * ratio[:, None]


def mean_chi_square_bounds(trials: int, freedom: int) -> Interval | None:
    """95 % bounds of the mean of `trials` χ² variables of `freedom` degrees of freedom: χ²(freedom × trials) / trials.

    The mean normalised error squared of a consistent filter lies within (Bar-Shalom, Li & Kirubarajan 2001,
    *Estimation with Applications to Tracking and Navigation*, section 5.4.2). None for no trials.
    """
    if trials == 0:
        return None
    low, high = _central_chi_square(freedom * trials)
    return low / trials, high / trials


def _central_chi_square(freedom: float) -> Interval:
    """Central 95 % interval of χ²."""
    low, high = 2.0 * gammaincinv(freedom / 2.0, _TAILS)
    return float(low), float(high)


def _binomial_quantile(q: float, n: int, p: float) -> int:
    """Smallest k with P(Bin(n, p) ≤ k) ≥ q."""
    return bisect_left(range(n), q, key=lambda k: bdtr(k, n, p))


def plain(interval: Any) -> list[float | None]:
    """An interval for JSON; missing and non-finite values become null."""
    if interval is None:
        return [None, None]
    return [float(v) if v is not None and math.isfinite(v) else None for v in interval]
