"""Lists of stars for the flight build: simulated fields with disturbances, and lists that are not a sky."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from benchmarks.pattern_lists import Pattern, pattern_list
from startracker import StarTracker
from startracker.core import FloatArray, IntArray
from startracker.flight.stars import StarList

MOST = 60


class Kind(NamedTuple):
    """Fields: noise of each coordinate, pixels; shares of false and of missing stars; fewest and most stars."""

    noise_px: float
    false: float = 0.0
    missing: float = 0.05
    fewest: int = 6
    most: int = 50


FIELDS = {
    "clean": Kind(0.1),
    "noise": Kind(0.5, missing=0.1),
    "false stars": Kind(0.2, 0.3, 0.1),
    "missing stars": Kind(0.3, 0.1, 0.4),
    "everything": Kind(0.4, 0.3, 0.3),
    "few stars": Kind(0.2, 0.1, 0.1, 3, 9),
}


class Field(NamedTuple):
    """A list and its truth: centroids (N, 2), fluxes (N,), stated error in pixels, attitude (3, 3), catalogue numbers
    (N,), 0 of false stars."""

    xy: FloatArray
    flux: FloatArray
    sigma_px: float
    matrix: FloatArray
    number: IntArray

    @property
    def stars(self) -> StarList:
        """The list as a flight build takes it."""
        return StarList.of(self.xy, self.flux, np.full(len(self.xy), self.sigma_px**2))


def field_list(tracker: StarTracker, kind: Kind, rng: np.random.Generator) -> Field:
    """A field at a random attitude: the brightest stars, with magnitudes scattered by 0.2.

    The stated error is the true one in half of the lists, and otherwise 0.15 px.
    """
    matrix = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    matrix *= np.linalg.det(matrix)
    index, _, positions = tracker.guide.in_field(matrix)
    magnitude = tracker.guide.v_mag[index] + rng.normal(0.0, 0.2, len(index))
    seen = np.argsort(magnitude)[: int(rng.integers(kind.fewest, kind.most))]
    seen = seen[rng.random(len(seen)) >= kind.missing]
    xy = positions[seen] + rng.normal(0.0, kind.noise_px, (len(seen), 2))
    flux = 10.0 ** (-0.4 * (magnitude[seen] - 10.0))
    number = np.asarray(tracker.guide.catalog.id)[index[seen]]
    count = round(kind.false * len(seen) / (1.0 - kind.false))
    size = np.array([tracker.camera.width, tracker.camera.height])
    if count:
        faintest, brightest = np.log([flux.min(), flux.max()])
        xy = np.concatenate([xy, rng.uniform(0.0, size - 1.0, (count, 2))])
        flux = np.concatenate([flux, np.exp(rng.uniform(faintest, brightest, count))])
        number = np.concatenate([number, np.zeros(count, number.dtype)])
    order = np.argsort(-flux, kind="stable")
    order = order[tracker.camera.contains(xy[order])][:MOST]
    sigma = max(kind.noise_px, 0.05) if rng.random() < 0.5 else 0.15
    return Field(xy[order], flux[order], sigma, matrix, number[order])


def null_list(tracker: StarTracker, pattern: Pattern, rng: np.random.Generator) -> StarList:
    """Points that are not a sky, with random brightness and stated errors of 0.05 to 1 px; of a third the brightness is
    not known."""
    size = (tracker.camera.width, tracker.camera.height)
    xy = pattern_list(pattern, size, rng, int(rng.integers(4, MOST + 1))) * (1.0, -1.0)
    xy = xy + 0.5 * (np.array(size) - 1.0)
    flux = np.sort(rng.lognormal(6.0, 1.2, len(xy)))[::-1] * float(rng.random() < 2.0 / 3.0)
    return StarList.of(xy, flux, np.full(len(xy), float(10.0 ** rng.uniform(-1.3, 0.0)) ** 2))
