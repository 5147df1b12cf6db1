"""Integer reference of the front end's fit: position, flux and variance of a star by maximum likelihood.

See `front_end`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from startracker.core import BoolArray, IntArray
from startracker.flight.front_background import square_root
from startracker.flight.front_rows import Candidates
from startracker.flight.front_stamps import StarImage, inside_frame
from startracker.flight.front_tables import HALF, FrontTables
from startracker.flight.stars import MOST_VARIANCE

ITERATIONS = 8
_NODES = 8
_NEIGHBOUR = 10
"""Pixels along each axis within which the light of another star is subtracted."""
_LONGEST_STEP = 1 << 15
_FARTHEST = 5 << 15
"""From the middle of the stamp, 16 fraction bits."""
_CONVERGED = 1 << 11
"""Longest last step, 16 fraction bits: the next is far shorter."""
_LEAST_FLUX, _MOST_FLUX = 16, 1 << 28
_HOT_ODDS = 9 << 8
"""Twice the logarithm of the odds of a star against a hot pixel, 8 fraction bits: 10 stars a hot pixel, 10 times."""
_THIRTY = 30


class Fits(NamedTuple):
    """Measured stars."""

    x: IntArray
    y: IntArray
    """From the middle of the stamp, 16 fraction bits."""
    flux: IntArray
    """DN, 4 fraction bits."""
    variance: IntArray
    """Mean of both axes, without floor, 26 fraction bits."""
    chi2: IntArray
    """8 fraction bits."""
    freedom: IntArray
    star: BoolArray
    """Whether a star fits, and better than one hot pixel."""


def _shift(values: IntArray, bits: IntArray, limit: int = 62) -> IntArray:
    """Values times 2^bits, rounded down; where they would exceed 2^limit they stop there."""
    left, right = np.clip(bits, 0, 62), np.clip(-bits, 0, 62)
    most = (1 << limit) - 1
    fits = np.abs(values) <= (most >> left)
    return np.asarray(np.where(fits, (values >> right) << (left * fits), np.sign(values) * most))


def _thirty_bits(rows: IntArray) -> tuple[IntArray, IntArray]:
    """Rows (K, N) shifted right until all K are below 2^30, and the shifts (N,)."""
    largest, shift = np.abs(rows).max(axis=0), np.zeros(rows.shape[1], np.int64)
    for bits in range(1, 64 - _THIRTY):
        shift += largest >> (_THIRTY + bits - 1) > 0
    return rows >> shift, shift


def _profiles(offset: IntArray, inverse: int, tables: FrontTables) -> tuple[IntArray, IntArray]:
    """Shares (N, 11) of the pixels of an axis and their slopes, 15 fraction bits, of images at offsets (N,)."""
    edge = (np.arange(-HALF, HALF + 2) << 16) - 32768 - offset[:, None]
    away, last = (np.abs(edge) * inverse) >> 12, len(tables.profile) - 1
    index, part = np.minimum(away >> 10, last - 1), away & 1023
    beyond = away >> 10 >= last

    def interpolated(table: IntArray) -> IntArray:
        inner = (table[index] * (1024 - part) + table[index + 1] * part) >> 10
        return np.asarray(np.where(beyond, table[last], inner))

    integral = np.sign(edge) * interpolated(tables.profile)
    density = (interpolated(tables.density) * inverse) >> 12
    return np.diff(integral, axis=1), density[:, :-1] - density[:, 1:]


def _images(x: IntArray, y: IntArray, shared: StarImage, tables: FrontTables) -> tuple[IntArray, IntArray, IntArray]:
    """Image and its slopes along x and y in the pixels of stamps (N, 11, 11), 15 fraction bits."""
    nodes, less = (_NODES, 3) if shared.moved else (1, 0)
    image, slope_x, slope_y = np.zeros((3, len(x), 2 * HALF + 1, 2 * HALF + 1), np.int64)
    for node in range(nodes):
        steps = 2 * node - nodes + 1
        share_x, rise_x = _profiles(x + (steps * shared.trail_x >> 1), shared.inverse_x, tables)
        share_y, rise_y = _profiles(y + (steps * shared.trail_y >> 1), shared.inverse_y, tables)
        image += (share_x[:, None, :] * share_y[:, :, None]) >> less
        slope_x += (rise_x[:, None, :] * share_y[:, :, None]) >> less
        slope_y += (share_x[:, None, :] * rise_y[:, :, None]) >> less
    return image >> 15, slope_x >> 15, slope_y >> 15


class _Noise(NamedTuple):
    """Constants of a star's weights."""

    photon: IntArray
    flat: IntArray
    square: IntArray


def _noise_of(found: Candidates, tables: FrontTables) -> _Noise:
    square = found.noise * found.noise
    photon = np.minimum(tables.gain // square, 1 << 34)
    return _Noise(photon, (1 << 40) // square, square)


def _weights(light: IntArray, noise: _Noise, tables: FrontTables) -> IntArray:
    """2^19 × the dark variance over that of pixels with a light (N, 11, 11), DN of 4 fraction bits."""
    uneven = np.minimum((light * tables.flat) >> 16, 1 << 16)
    ratio = 4096 + ((light * noise.photon[:, None, None]) >> 20) + ((uneven * uneven * noise.flat[:, None, None]) >> 20)
    return np.asarray((1 << 31) // np.minimum(ratio, (1 << 31) - 1))


def _sums(weight: IntArray, *factors: IntArray) -> IntArray:
    product = weight
    for factor in factors:
        product = product * factor
    return np.asarray(product.sum(axis=(1, 2)))


def fit_stars(
    found: Candidates, start: tuple[IntArray, IntArray], other: IntArray, shared: StarImage, tables: FrontTables
) -> Fits:
    """Fisher scoring in flux, x and y over a window, a fixed number of steps.

    `start` are positions from the middle of each stamp, 16 fraction bits; `other` (N, 11, 11) is light of other stars,
    DN of 4 fraction bits. Each step solves for x and y with the flux marginalised, and for the flux alone: the solution
    of both is that of greatest likelihood.
    """
    window = _window(found, shared.half, tables)
    data = np.where(window, (found.stamp << 4) - (found.level >> 4)[:, None, None] - other, 0)
    noise, (x, y) = _noise_of(found, tables), start
    flux, used, longest = np.full(len(x), _LEAST_FLUX), window.sum(axis=(1, 2)), np.zeros(len(x), np.int64)
    good = used > 3
    for step in range(ITERATIONS + 1):
        image, slope_x, slope_y = (np.where(window, part, 0) for part in _images(x, y, shared, tables))
        if step == 0:
            flux = _start_flux(image, data)
        light = (flux[:, None, None] * image) >> 15
        weight, left = _weights(light, noise, tables), data - light
        normal = np.array([
            _sums(weight, image, image), _sums(weight, image, slope_x), _sums(weight, image, slope_y),
            _sums(weight, slope_x, slope_x), _sums(weight, slope_y, slope_y), _sums(weight, slope_x, slope_y),
        ])  # fmt: skip
        score = np.array([_sums(weight, part, left) for part in (image, slope_x, slope_y)])
        (pp, px, py, xx, yy, xy), scale = _thirty_bits(normal)
        (rp, rx, ry), shift = _thirty_bits(score)
        good &= pp > 0
        pp = np.maximum(pp, 1)
        xx, yy, xy = xx - px * px // pp, yy - py * py // pp, xy - px * py // pp
        determinant = xx * yy - xy * xy
        good &= (determinant >> 20 > 0) & (xx + yy > 0)
        if step == ITERATIONS:
            break
        rx, ry = rx - px * rp // pp, ry - py * rp // pp
        positive = np.maximum(determinant >> 20, 1)
        move = np.array([yy * rx - xy * ry, xx * ry - xy * rx]) // positive
        move = np.clip(_shift(move, 11 + shift - scale) // flux, -_LONGEST_STEP, _LONGEST_STEP)
        more = _shift((rp << 30) // pp, shift - scale - 15)
        x, y = np.clip([x + move[0], y + move[1]], -_FARTHEST - 1, _FARTHEST + 1)
        flux = np.clip(flux + np.clip(more, -flux // 2, flux), _LEAST_FLUX, _MOST_FLUX)
        longest = np.abs(move).max(axis=0)
    good &= (longest <= _CONVERGED) & (np.maximum(np.abs(x), np.abs(y)) <= _FARTHEST)
    variance = _variance(found, flux, (xx + yy, determinant, scale))
    chi2, alone = _misfits(data, left, weight, noise)
    good &= (alone + _HOT_ODDS >= chi2) & (variance <= shared.variance << 18)
    return Fits(x, y, flux, variance, chi2, used - 3, good)


def fit_beside(found: Candidates, fits: Fits, shared: StarImage, tables: FrontTables) -> Fits:
    """Fits of stars that have neighbours, with the neighbours' light subtracted, as fitted before; the others stay."""
    near = (np.abs(found.x[:, None] - found.x) <= _NEIGHBOUR) & (np.abs(found.y[:, None] - found.y) <= _NEIGHBOUR)
    one, two = np.nonzero(near & fits.star[:, None] & fits.star & ~np.eye(len(found.x), dtype=np.bool_))
    if not len(one):
        return fits
    x = (found.x[two] - found.x[one] << 16) + fits.x[two]
    y = (found.y[two] - found.y[one] << 16) + fits.y[two]
    other = np.zeros(found.stamp.shape, np.int64)
    np.add.at(other, one, (fits.flux[two, None, None] * _images(x, y, shared, tables)[0]) >> 15)
    again, beside = fit_stars(found, (fits.x, fits.y), other, shared, tables), np.isin(np.arange(len(found.x)), one)
    return Fits(*(np.where(beside, new, old) for new, old in zip(again, fits, strict=True)))


def _window(found: Candidates, half: int, tables: FrontTables) -> BoolArray:
    """Pixels (N, 11, 11) of the fits; of saturated stars, whose windows are whole stamps, those below 0.9 of the
    highest above the background, as each pixel has its own full well."""
    away = np.abs(np.arange(-HALF, HALF + 1))
    middle = (away <= half) & (away <= half)[:, None]
    highest = found.stamp.max(axis=(1, 2), initial=0)
    full = (highest >= tables.saturation)[:, None, None]
    limit = found.level + 9 * ((highest << 8) - found.level) // 10
    usable = np.where(full, found.stamp << 8 < limit[:, None, None], middle)
    return np.asarray(inside_frame(found, tables) & usable)


def _start_flux(image: IntArray, data: IntArray) -> IntArray:
    """Flux by unweighted least squares."""
    above, below = (image * data).sum(axis=(1, 2)), (image * image).sum(axis=(1, 2)) >> 15
    return np.asarray(np.clip(above // np.maximum(below, 1), _LEAST_FLUX, _MOST_FLUX))


def _variance(found: Candidates, flux: IntArray, normal: tuple[IntArray, IntArray, IntArray]) -> IntArray:
    """Half the trace of the inverse information matrix, 26 fraction bits."""
    trace, determinant, scale = normal
    ratio = np.minimum((found.noise << 24) // flux, (1 << 30) - 1)
    square, shift = ratio * ratio, 18 - scale
    for _ in range(62):
        small = square < 1 << 61
        square, shift = np.where(small, square << small, square), shift - small
    information = np.maximum(determinant // np.maximum(trace, 1), 1)
    return np.minimum(_shift(square // information, shift), MOST_VARIANCE)


def _misfits(data: IntArray, left: IntArray, weight: IntArray, noise: _Noise) -> tuple[IntArray, IntArray]:
    """χ² of the fit, and of nothing but one bright pixel, 8 fraction bits."""
    size = np.minimum(np.abs(left), 1 << 16)
    chi2 = _sums(weight, size, size) // (8 * noise.square)
    size = np.minimum(np.abs(data), 1 << 16)
    squares = size * size << 19
    brightest = np.where(data > 0, squares, 0).max(axis=(1, 2), initial=0)
    return chi2, (squares.sum(axis=(1, 2)) - brightest) // (8 * noise.square)


def misfit_variance(fits: Fits, tables: FrontTables) -> IntArray:
    """Variances, larger where a star's χ² is too large unless most of the highest stars misfit, and the floor."""
    excess = fits.chi2 - (fits.freedom << 8)
    misfit = excess > square_root(32 * np.maximum(fits.freedom, 0) << 16)
    first = np.flatnonzero(fits.star)[:9]
    wrong = 2 * np.count_nonzero(misfit[first]) > len(first)
    raised = fits.variance * np.minimum(fits.chi2 >> 4, 1 << 32) // (16 * np.maximum(fits.freedom, 1))
    variance = np.where(misfit & (not wrong), raised, fits.variance)
    return np.asarray(np.minimum(variance + tables.floor, MOST_VARIANCE))
