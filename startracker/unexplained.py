"""The one check of an attitude against the whole field: bright stars that stay unexplained on both sides.

An accepted attitude explains the brightest stars of the list and the brightest guide stars of the field. Either side
alone may be incomplete: guide stars are hidden by the Earth, a cloud or a baffle, and then nothing is seen
there; false stars, satellites or hot pixels are added, and then the guide stars are seen as well. Both together, bright
stars without a guide star where bright guide stars are without a star, mean that the stars are there but elsewhere: the
scale or the roll hang on a knot of stars, or the image is not one field. The evidence against chance
(`startracker.identification.bayes_factor`) does not see this, as a knot that is identified is far from chance.

Of an image more is known than its list of stars: where it stands out from its background a guide star is there, even if
the detector rejected it with what it lies on, as a ridge of an aurora. Few matched stars are then enough if most bright
guide stars are there (`startracker.detection.background`), unless those that are not are those of one part of the
image.

The matched fraction is at least 0.5 on one of both sides in real fields, and below 0.4 on both it is refused.
Moreover, on one side of a line across the image, or outside a circle about the matched stars, fewer are matched than
on the other. With a of n items matched in each of two parts the logarithm of the likelihood ratio of two different
fractions against a common one is

    G = Σ_parts ln L(a, n) − ln L(Σ a, Σ n),    ln L(a, n) = a ln(a/n) + (n − a) ln(1 − a/n).

2 G is distributed as χ² with one degree of freedom if the fractions are equal (Wilks 1938, Annals of Mathematical
Statistics 9, 60). It is computed for the guide stars and for the observed ones, and the smaller of the two counts: it
is large only if both are unmatched in the same part.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from startracker._compiled import kernel, kernel_part
from startracker.catalog.guide import GuideDatabase, field_cosine
from startracker.catalog.sky_view import stars_on_image
from startracker.core import BoolArray, FloatArray, IntArray
from startracker.detection.background import Light
from startracker.geometry.camera import Camera
from startracker.sorting import order_of_columns

LARGEST_CONTRAST = 6.0
"""G above which an attitude is refused. With equal fractions one of the sides exceeds it on a given line with
probability 2.7e-4 (χ² above 12, one of the two tails), and both, which are independent, with 7e-8. The largest over
all lines exceeds it in 2 of 5,100 fields with false and missing stars (`benchmarks.identification`, 20 % dropped)."""
LEAST_EXPLAINED = 0.4
"""Matched fraction below which an attitude is refused if both sides are below it, wherever on the image: in the same
5,100 fields it is 0.5 or more on one of them."""
DOUBTFUL_CONTRAST = 4.0
"""G above which the unmatched stars are identified by themselves: those of another field contradict the attitude."""
FEWEST_OF_ANOTHER = 6
"""Unmatched bright stars from which it is worth to do so."""
FEW_STARS, FEW_STARS_SIGMAS = 4, 4.5
"""Three or four stars fit another field too easily if their errors may be larger than stated: each residual must be
within the gate of the stated errors (`identification.verification.GATE_SIGMAS`)."""
LEAST_SHARE = 0.2
"""Unmatched stars of the part, and guide stars, as a fraction of the matched ones, below which the attitude is kept:
the corner of a lens whose distortion is not known leaves the greater part of the image explained."""
NO_ROWS = np.empty(0, np.int64)
DIRECTIONS = 8
"""Lines across the image, of which both sides are compared."""
BRIGHT = 0.9
"""Fraction of the matched stars, brightest first, that sets how faint a star counts as bright."""
BESIDE_PX = 3.0
"""A guide star and a centroid this close, but not matched, are one star whose position is displaced: neither counts."""
_APART_PX = 12.0
"""Light this far from every centroid is not that of a star in the list."""
MOST_SEEN = 0.7
"""Fraction of the bright guide stars that an image must show if less than `LEAST_EXPLAINED` are matched: it is 0.78 to
0.87 in five frames with ridges of 250 times the noise, and about 0.5 if half of the image is of another field."""
MOST_FALSE = 0.5
"""Fraction of the bright stars of an image that are matched, below which most of them are false, as on ridges: no part
of the image then has a smaller fraction than the rest, and the guide stars are asked alone. In 25 such frames their G,
with those that have light, is 5.9 at most; in 34 that are rolled by a fifth of their width it is 6 to 31 but for 3."""
BORDER_PX = 6.0
"""Guide stars closer to the border need not be detected."""
FEWEST = 3
"""Unmatched stars, and guide stars, below which there is no contradiction."""


class Unexplained(NamedTuple):
    """Bright stars that are not matched, and the part of the image with most contradiction.

    Parameters
    ----------
    contrast : float
        G of the side, guide stars or observed stars, that has less; 0 if there is no contradiction.
    stars, guides : int
        Bright observed and guide stars that are not matched in that part.
    lost_stars, matched_stars, lost_guides, matched_guides : int
        Bright ones on the whole image that are not matched, and that are.
    beside : int
        Bright observed stars with a guide star close by that is not matched.
    """

    contrast: float
    stars: int
    guides: int
    lost_stars: int
    matched_stars: int
    lost_guides: int
    matched_guides: int
    beside: int

    @property
    def contradicts(self) -> bool:
        """Whether the attitude is refused."""
        return self.leaves_a_part or self._explained < LEAST_EXPLAINED or self._is_displaced

    @property
    def leaves_the_rest(self) -> bool:
        """Whether it is refused only as too few are matched, wherever they are."""
        return self._explained < LEAST_EXPLAINED and not self.leaves_a_part and not self._is_displaced

    @property
    def leaves_a_part(self) -> bool:
        """Whether it is refused for one part of the image, however faint the stars of the list are against the guide
        stars: a photograph's order of brightness may be far from V."""
        return self.contrast > LARGEST_CONTRAST and self._is_large

    @property
    def is_doubtful(self) -> bool:
        """Whether the unmatched stars may be those of another field, and are enough to be identified by themselves."""
        return self.contrast > DOUBTFUL_CONTRAST and self.stars >= FEWEST_OF_ANOTHER

    @property
    def is_uneven(self) -> bool:
        """Whether one part of the image, however small, is explained worse: it may be of another field."""
        return self.contrast > LARGEST_CONTRAST

    @property
    def _explained(self) -> float:
        """Matched fraction of the side, guide stars or observed stars, of which more are matched."""
        if min(self.lost_stars, self.lost_guides) < FEWEST:
            return 1.0
        of_stars = self.matched_stars / (self.matched_stars + self.lost_stars)
        return max(of_stars, self.matched_guides / (self.matched_guides + self.lost_guides))

    @property
    def is_mostly_false(self) -> bool:
        """Whether most of the bright stars are not matched."""
        return self.matched_stars < MOST_FALSE * (self.matched_stars + self.lost_stars)

    @property
    def _is_displaced(self) -> bool:
        return self.beside > self.matched_stars

    @property
    def _is_large(self) -> bool:
        return self.stars >= LEAST_SHARE * self.matched_stars and self.guides >= LEAST_SHARE * self.matched_guides

    def __str__(self) -> str:
        if self.leaves_a_part:
            where = "in one part of the image"
            return f"{self.stars} bright stars and {self.guides} bright guide stars {where} are unexplained"
        if self._is_displaced:
            return f"{self.beside} bright stars are beside their guide stars, and only {self.matched_stars} are on them"
        return f"{self.lost_stars} bright stars and {self.lost_guides} bright guide stars are unexplained"


NOTHING = Unexplained(0.0, 0, 0, 0, 0, 0, 0, 0)


class Fitted(NamedTuple):
    """An attitude and the stars it was fitted to.

    Parameters
    ----------
    pairs : (M, 2)
        Centroids and guide stars, without outliers.
    residual_px : (M, 2)
        Measured minus predicted.
    matrix : (3, 3)
        ICRS to camera.
    camera : Camera
        With its fitted focal length.
    """

    pairs: IntArray
    residual_px: FloatArray
    matrix: FloatArray
    camera: Camera


def reason_to_refuse(
    xy: FloatArray,
    sigma_px: FloatArray,
    fit: Fitted,
    guide: GuideDatabase,
    ignored: IntArray,
    identify: Callable[[IntArray], IntArray],
    light: Light | None = None,
    *,
    follows_v: bool = True,
) -> str:
    """Why an attitude is not accepted although chance does not explain it, in words; empty if it is accepted.

    Parameters
    ----------
    xy, sigma_px : (N, 2), (N,)
        Centroids, brightest first, and their stated standard errors on one axis.
    fit : Fitted
        The attitude, after all fits.
    guide : GuideDatabase
        In apparent directions.
    ignored : (B,)
        Centroids that are not stars, such as planets.
    identify : callable
        Guide stars with which some centroids, by their rows, are identified by themselves; for doubtful cases.
    light : Light, optional
        The image, if the centroids are those of one.
    follows_v : bool
        Whether the order of the centroids is that of V, as in a star camera. A photograph's may be far from it, its
        depth is not known, and trees may hide a part: how many of its bright stars are matched then says nothing.
    """
    stars = fit.pairs[:, 0]
    if len(stars) <= FEW_STARS:
        largest = float(np.max(np.hypot(*fit.residual_px.T) / sigma_px[stars], initial=0.0))
        if largest > FEW_STARS_SIGMAS:
            return f"one of only {len(stars)} stars is off by {largest:.1f} stated errors"
    left, share = unexplained_in(xy, fit, guide, ignored), 0.0
    if light is not None and (left.is_mostly_false or left.leaves_the_rest):
        positions, there = guide_stars_there(xy, fit, guide, light)
        dark = of_guide_stars(positions, there)
        if follows_v and left.is_mostly_false and dark.contrast > LARGEST_CONTRAST:
            return f"{dark.guides} bright guide stars in one part of the image are without a star or any light"
        share = np.count_nonzero(there) / float(len(there))
    if left.contradicts and not (left.leaves_the_rest and (share >= MOST_SEEN or not follows_v)):
        return str(left)
    if left.is_doubtful:
        others = identify(np.setdiff1d(np.arange(len(xy)), np.append(stars, ignored)))
        index, _, _ = _guide_stars(fit, guide)
        if len(others) > 2 * np.count_nonzero(np.isin(others, index)):
            return f"{len(others)} of the stars that are not explained are those of another field"
    return ""


def unexplained_in(xy: FloatArray, fit: Fitted, guide: GuideDatabase, ignored: IntArray) -> Unexplained:
    """What an attitude leaves unexplained; for the arguments see `reason_to_refuse`."""
    index, _, positions = _guide_stars(fit, guide)
    seen, matched = np.zeros(len(xy), np.bool_), np.isin(index, fit.pairs[:, 1])
    seen[fit.pairs[:, 0]] = True
    if len(ignored):
        xy, seen = np.delete(xy, ignored, axis=0), np.delete(seen, ignored)
    return unexplained_of(np.ascontiguousarray(xy), seen, positions, matched)


def guide_stars_there(xy: FloatArray, fit: Fitted, guide: GuideDatabase, light: Light) -> tuple[FloatArray, BoolArray]:
    """Positions (K, 2) of the bright guide stars, and which are matched or where the image has light that is not in the
    list (K,); without those beside a centroid that they are not matched with."""
    index, _, positions = _guide_stars(fit, guide)
    matched = np.isin(index, fit.pairs[:, 1])
    bright = max(_number_bright(matched), min(len(xy), len(matched)))
    positions, there = positions[:bright], matched[:bright]
    apart = np.min(np.hypot(*(positions[:, None] - xy).transpose(2, 0, 1)), axis=1) > _APART_PX
    missing = np.flatnonzero(~there & apart)
    known = there | apart
    there[missing] = light.seen(positions[missing])
    return positions[known], there[known]


@kernel_part
def _log_likelihood(matched: int, unmatched: int) -> float:
    """ln L of a binomial at its most likely fraction."""
    value = 0.0
    if matched > 0 and unmatched > 0:
        n = float(matched + unmatched)
        value = matched * math.log(matched / n) + unmatched * math.log(unmatched / n)
    return value


@kernel_part
def _number_bright(matched: BoolArray) -> int:
    """Number of the brightest items down to the `BRIGHT` quantile of the matched ones."""
    total, count, bright = 0, 0, len(matched)
    for n in range(len(matched)):
        total += matched[n]
    for n in range(len(matched)):
        count += matched[n]
        if count >= BRIGHT * total:
            bright = n + 1
            break
    return bright


@kernel_part
def _has_neighbour(x: float, y: float, others: FloatArray) -> bool:
    """Whether a point has another within `BESIDE_PX`."""
    near = 0
    for k in range(len(others)):
        near += (x - others[k, 0]) ** 2 + (y - others[k, 1]) ** 2 < BESIDE_PX**2
    return near > 0


@kernel
def bright_items(
    xy: FloatArray, seen: BoolArray, positions: FloatArray, matched: BoolArray
) -> tuple[IntArray, FloatArray]:
    """Kinds (M,) and pixels (M, 2) of the bright stars: 0 and 1 unmatched and matched centroids, 2 and 3 unmatched and
    matched guide stars, 4 centroids beside a guide star; none if fewer than three are unmatched on either side."""
    fewer = min(len(xy), len(positions))
    stars, guides = max(_number_bright(seen), fewer), max(_number_bright(matched), fewer)
    kind, position, count = np.empty(stars + guides, np.int64), np.empty((stars + guides, 2)), 0
    lost_stars, lost_guides = 0, 0
    for n in range(stars):
        lost_stars += not seen[n]
    for k in range(guides):
        lost_guides += not matched[k]
    if min(lost_stars, lost_guides) < FEWEST:
        return kind[:0], position[:0]
    for n in range(stars):
        beside = not seen[n] and _has_neighbour(xy[n, 0], xy[n, 1], positions)
        kind[count], position[count, 0], position[count, 1] = 4 if beside else int(seen[n]), xy[n, 0], xy[n, 1]
        count += 1
    for k in range(guides):
        if matched[k] or not _has_neighbour(positions[k, 0], positions[k, 1], xy):
            kind[count], position[count, 0], position[count, 1] = 2 + int(matched[k]), positions[k, 0], positions[k, 1]
            count += 1
    return kind[:count], position[:count]


def _guide_stars(fit: Fitted, guide: GuideDatabase) -> tuple[IntArray, FloatArray, FloatArray]:
    """Guide stars on the image: index, vectors and pixels."""
    camera = fit.camera
    found: tuple[IntArray, FloatArray, FloatArray] = stars_on_image(
        fit.matrix, field_cosine(camera), -BORDER_PX, guide.directions, guide.grid, camera.image_map
    )
    return found


def unexplained_of(xy: FloatArray, seen: BoolArray, positions: FloatArray, matched: BoolArray) -> Unexplained:
    """What a match leaves unexplained.

    Parameters
    ----------
    xy, seen : (N, 2), (N,)
        Centroids, brightest first, and whether they are matched.
    positions, matched : (K, 2), (K,)
        Predicted positions of the guide stars on the image, brightest first, and whether they are matched.
    """
    kind, position = bright_items(xy, seen, positions, matched)
    return Unexplained(*contradiction(kind, position)) if len(kind) else NOTHING


def is_part_hidden(positions: FloatArray, matched: BoolArray) -> bool:
    """Whether the guide stars of a part of the image are not matched, whatever else is there.

    Where only windows about the guide stars were read, what else is there is not known.
    """
    return of_guide_stars(positions, matched).leaves_a_part


def of_guide_stars(positions: FloatArray, matched: BoolArray) -> Unexplained:
    """What a match leaves of the guide stars (K, 2) alone, which count for both sides."""
    kind, twice = matched.astype(np.int64), np.concatenate([positions, positions])
    return Unexplained(*contradiction(np.concatenate([kind, 2 + kind]), twice))


@kernel
def contradiction(kind: IntArray, position: FloatArray) -> tuple[float, int, int, int, int, int, int, int]:
    """The fields of `Unexplained` from `bright_items`."""
    total, outside, middle = np.zeros(5, np.int64), np.zeros(5, np.int64), np.zeros(2)
    for n in range(len(kind)):
        total[kind[n]] += 1
        for axis in range(2):
            middle[axis] += position[n, axis] if kind[n] == 3 else 0.0
    worst, stars, guides = 0.0, 0, 0
    if min(total[0], total[2]) >= FEWEST and min(total[1], total[3]) > 0:
        whole_stars, whole_guides = _log_likelihood(total[1], total[0]), _log_likelihood(total[3], total[2])
        key = np.empty((1, len(kind)))
        for line in range(2 * DIRECTIONS + 1):  # the last one is the circle about the matched stars
            angle = math.pi * line / DIRECTIONS
            for n in range(len(kind)):
                if line == 2 * DIRECTIONS:
                    x, y = position[n, 0] - middle[0] / total[3], position[n, 1] - middle[1] / total[3]
                    key[0, n] = -math.hypot(x, y)
                else:
                    key[0, n] = math.cos(angle) * position[n, 0] + math.sin(angle) * position[n, 1]
            outside[:] = 0
            for n in order_of_columns(key):
                outside[kind[n]] += 1
                if outside[0] < FEWEST or outside[2] < FEWEST:
                    continue
                # smaller fractions than on the whole image, of both
                if outside[1] * total[0] >= outside[0] * total[1] or outside[3] * total[2] >= outside[2] * total[3]:
                    continue
                of_stars = _log_likelihood(outside[1], outside[0]) - whole_stars
                of_stars += _log_likelihood(total[1] - outside[1], total[0] - outside[0])
                of_guides = _log_likelihood(outside[3], outside[2]) - whole_guides
                of_guides += _log_likelihood(total[3] - outside[3], total[2] - outside[2])
                if min(of_stars, of_guides) > worst:
                    worst, stars, guides = min(of_stars, of_guides), outside[0], outside[2]
    return worst, stars, guides, total[0], total[1], total[2], total[3], total[4]
