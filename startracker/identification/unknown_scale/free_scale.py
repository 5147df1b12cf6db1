"""Identification with a focal length that is unknown or only roughly known: patterns of four, then a fitted camera.

1. Patterns of neighbouring stars among the brightest are looked up by shape (`quads`), as observed and mirrored.
2. Each candidate gives attitude and focal length; guide stars of the field are matched in a widening region while
   attitude, focal length and radial distortion are refitted.
3. The evidence of all stars except the four of the pattern is compared with the number of candidates, and accepted by
   probability (`log_evidence`).

Null hypothesis of the evidence: each observed star is anywhere on the image, with density 1/A. Hypothesis: it is a
distractor with probability d, of density 1/A; otherwise it is one of the K guide stars of the field, with a Gaussian of
width σ about its predicted position, and a magnitude near the guide star's. Let Λ be the product of the ratios over the
stars. Under the null hypothesis the probability that Λ exceeds t is at most 1/t (Markov's inequality, because
E[Λ] = 1). So the probability that one of H hypotheses reaches H/ε by chance is at most ε, whatever the distribution of
Λ. Source of the model: Lang, Hogg, Mierle, Blanton & Roweis 2010, AJ 139, 1782, section 2.3; the bound is ours.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from startracker.catalog.guide import GuideDatabase
from startracker.core import FloatArray, IntArray
from startracker.estimation.association import nearest_unique
from startracker.estimation.wahba import fit_rotation
from startracker.geometry.attitude import rotation_vector_to_matrix
from startracker.geometry.camera import Camera
from startracker.geometry.lens import change_lens, is_one_to_one
from startracker.geometry.lens_fit import Matches, image_equations
from startracker.identification.clustering_null import clustering_price
from startracker.identification.unknown_scale.quads import QuadIndex, neighbour_quads, sky_codes

WIDTHS_PX = (0.3, 1.0, 3.0)
"""Standard errors, px, that are tried for the residuals after the fit."""
STAR_COUNTS = (8, 12, 18, 28)
"""Numbers of the brightest stars among which neighbours are searched for: small ones if the sky is poor or the image
shallow."""
FOV_BANDS_DEG = ((3.0, 9.0, 18.0), (17.0, 22.0, 29.0), (27.0, 33.0, 40.0), (38.0, 46.0, 54.0), (51.0, 60.0, 72.0))
"""Least, assumed and largest field of each band: shapes away from the axis depend on the field, by 1.5 % within a
band."""
FEWEST_MATCHED = 6
DISTRACTORS = (0.1, 0.3, 0.6, 0.9)
"""Shares of observed stars that are not guide stars; the best is used, and its selection is accounted for."""
_CORE_MAG, _WIDE_MAG, _WIDE_SHARE = 0.3, 1.5, 0.3
_MOST_CANDIDATES = 4000
_LEAST_DEPTH = {"pinhole": 1e-3, "fisheye": -1.0}
_K1_SIGMA = 0.5
FEWEST_FOR_K1 = 10


@dataclass(frozen=True, eq=False)
class FreeFit:
    """A camera and its attitude fitted to one field.

    Parameters
    ----------
    camera : Camera
        Camera with the fitted focal length, radial distortion and parity.
    matrix : (3, 3)
        ICRS to camera.
    pairs : int (M, 2)
        Observed and guide index.
    covariance : (3, 3)
        Covariance of the rotation vector in camera axes, rad², with focal length and distortion marginalised.
    rms_px : float
        Root mean square of the residuals on one axis, corrected for the degrees of freedom.
    log_evidence : float
        Result of `log_evidence`, reduced for the selection of the width.
    """

    camera: Camera
    matrix: FloatArray
    pairs: IntArray
    covariance: FloatArray
    rms_px: float
    log_evidence: float


def fit_camera(
    camera: Camera,
    matrix: FloatArray,
    directions: FloatArray,
    xy: FloatArray,
    with_k1: bool,
    k1_expected: float = 0.0,
) -> tuple[Camera, FloatArray, FloatArray, float]:
    """Attitude, focal length and k1 by least squares (Gauss–Newton) on pixels.

    Parameters
    ----------
    camera, matrix
        Initial values.
    directions : (M, 3)
        Guide stars.
    xy : (M, 2)
        Pixels of their images.
    with_k1 : bool
        Whether to fit the radial distortion too; it has a Gaussian prior around the expected value with σ = 0.5, which
        matters for few stars only.
    k1_expected : float
        Zero, or the known value for the lens.

    Returns
    -------
    camera, matrix, covariance (3, 3) of the rotation vector, rms of the residuals on one axis, px; the rms is infinite
    if no lens fits that is one to one over the image.
    """
    names = ("f", "k1") if with_k1 else ("f",)
    stars, normal = Matches(xy, directions, np.ones(len(xy))), np.eye(3 + len(names))
    nothing = camera, matrix, np.zeros((3, 3)), math.inf
    for _ in range(8):
        if not (directions @ matrix[2] > _LEAST_DEPTH[camera.projection]).all():
            return nothing
        normal, right = image_equations(camera, matrix, stars, names)
        if with_k1:
            normal[1, 1] += _K1_SIGMA**-2
            right[1] -= (camera.distortion.k1 - k1_expected) * _K1_SIGMA**-2
        try:
            change = np.linalg.solve(normal, right)
        except np.linalg.LinAlgError:  # all at one position
            return nothing
        if not np.isfinite(change).all():
            return nothing
        # Long steps are clipped, so that a poor start does not leave the range in which the lens is invertible.
        change = np.clip(change, -0.3, 0.3)
        camera = change_lens(camera, dict(zip(names, change.tolist(), strict=False)))
        matrix = rotation_vector_to_matrix(change[-3:]) @ matrix
        if not _sane(camera):
            return nothing
        if max(abs(change[0]), *np.abs(change[-3:])) < 1e-8:
            break
    residual = xy - camera.project(directions @ matrix.T)
    freedom = max(2 * len(xy) - len(normal), 1)
    variance = float(np.sum(residual**2)) / freedom
    covariance: FloatArray = np.linalg.inv(normal)[-3:, -3:].astype(np.float64) * variance
    return camera, matrix, covariance, math.sqrt(variance)


def _sane(camera: Camera) -> bool:
    """Whether the field is below 150° and the distortion is one to one up to the corner, with a margin.

    r (1 + k1 r²) has its maximum at r² = −1/(3 k1), which corresponds to k1 r_d² = −4/27 = −0.148 in the image.
    """
    if camera.projection != "pinhole":
        return is_one_to_one(camera)
    corner = (max(camera.cx, camera.width - 1 - camera.cx) / camera.fx) ** 2
    corner += (max(camera.cy, camera.height - 1 - camera.cy) / camera.fy) ** 2
    return corner < 14.0 and -0.11 < camera.distortion.k1 * corner < 0.5


def weigh(
    camera: Camera,
    matrix: FloatArray,
    xy: FloatArray,
    magnitude: FloatArray | None,
    guide: GuideDatabase,
    anchors: int,
    excess: FloatArray,
) -> tuple[float, IntArray]:
    """ln Λ of a camera and attitude, and the pairs that it explains.

    It is the best over `WIDTHS_PX`, reduced for this selection. `excess` is that of `clustering_null`: crowded points
    agree by chance more easily.
    """
    index, _, positions = guide.in_field(matrix, 2.0, camera)
    keep = slice(0, 2 * len(xy) + 10)
    index, positions = index[keep], positions[keep]
    best, pairs = -math.inf, np.empty((0, 2), dtype=np.int64)
    for width in WIDTHS_PX:
        sigma = np.full(len(xy), width)
        near, distance = nearest_unique(xy, positions, 4.5 * sigma)
        matched = np.flatnonzero(near >= 0)
        if len(matched) < FEWEST_MATCHED:
            continue
        ratio = np.ones(len(xy))
        if magnitude is not None:
            v = np.full(len(xy), np.nan)
            v[matched] = guide.v_mag[index[near[matched]]]
            ratio = magnitude_ratio(magnitude, v, guide.v_mag[index])
        area = float(camera.width) * camera.height
        value = log_evidence(distance, sigma, area, len(index), ratio, anchors) - math.log(len(WIDTHS_PX))
        value -= clustering_price(excess, near)
        if value > best:
            best, pairs = value, np.stack([matched, index[near[matched]]], axis=1)
    return best, pairs


def grow(
    camera: Camera,
    matrix: FloatArray,
    xy: FloatArray,
    guide: GuideDatabase,
    centre: FloatArray,
    first_gate: FloatArray,
) -> tuple[Camera, FloatArray, FloatArray, float, IntArray] | None:
    """Match and refit outwards from the surroundings of one pattern; None as soon as too few stars agree.

    Returns camera, matrix, covariance, rms and pairs.
    """
    away = np.hypot(*(xy - centre).T)
    gate, k1_expected = first_gate, camera.distortion.k1
    pairs = np.empty((0, 2), dtype=np.int64)
    result = None
    for round_ in range(10):
        index, _, positions = guide.in_field(matrix, 5.0, camera)
        keep = slice(0, 2 * len(xy) + 10)
        near, _ = nearest_unique(xy, positions[keep], gate)
        matched = np.flatnonzero(near >= 0)
        if len(matched) < FEWEST_MATCHED:
            return None
        new = np.stack([matched, index[near[matched]]], axis=1)
        if result is not None and np.array_equal(new, pairs):
            break
        pairs = new
        camera, matrix, covariance, rms = fit_camera(
            camera, matrix, guide.directions[pairs[:, 1]], xy[pairs[:, 0]], len(pairs) >= FEWEST_FOR_K1, k1_expected
        )
        if not math.isfinite(rms):
            return None
        result = (camera, matrix, covariance, rms, pairs)
        residual = xy[pairs[:, 0]] - camera.project(guide.directions[pairs[:, 1]] @ matrix.T)
        # 1.1774 σ is the median of a Rayleigh distribution, that of the length of a two-dimensional Gaussian error.
        robust = float(np.median(np.hypot(residual[:, 0], residual[:, 1]))) / 1.1774
        narrow = max(4.0 * robust, 1.0)
        # In the first rounds the gate grows with the distance from the pattern, where scale and distortion are
        # extrapolated.
        gate = np.minimum(gate, narrow + (0.004 * away if round_ < 2 else 0.0))
        if round_ >= 2:
            gate = np.full(len(xy), narrow)
    return result


def candidates(
    xy: FloatArray, camera: Camera, index: QuadIndex, low: float, high: float, widen: float = 1.0
) -> Iterator[tuple[Camera, IntArray, FloatArray, float]]:
    """Cameras and attitudes suggested by patterns of the brightest stars, best agreement first for each number of
    stars.

    Parameters
    ----------
    xy : (N, 2)
        Brightest first.
    camera : Camera
        Assumed camera; only its parity is tried.
    index : QuadIndex
    low, high : float
        Allowed range of the ratio of the true to the assumed angle.
    widen : float
        Factor on the tolerance of the patterns' codes.

    Yields
    ------
    Camera with that focal length, the pattern (2, 4) of observed and guide stars, its centre (2,) and extent in pixels.
    """
    vectors = camera.unproject(xy)
    usable = np.flatnonzero(np.isfinite(vectors).all(axis=1))  # within what the lens that is tried can show
    done: set[bytes] = set()
    for count in STAR_COUNTS:
        if count > STAR_COUNTS[0] and len(xy) <= STAR_COUNTS[STAR_COUNTS.index(count) - 1]:
            break
        quads = neighbour_quads(vectors, usable[:count])
        quads = np.array([q for q in quads if q.tobytes() not in done], dtype=np.int64).reshape(-1, 4)
        done.update(q.tobytes() for q in quads)
        if len(quads) == 0:
            continue
        codes, order, baseline = sky_codes(vectors, quads)
        baseline_px = np.hypot(*(xy[order[:, 0]] - xy[order[:, 1]]).T)
        good = np.isfinite(codes).all(axis=1) & (baseline_px > 20.0)
        codes, order, baseline, baseline_px = codes[good], order[good], baseline[good], baseline_px[good]
        if len(codes) == 0:
            continue
        tolerance = widen * np.minimum(0.006 + 0.8 / baseline_px, 0.03)
        query, found, _ = index.candidates(codes, tolerance, baseline * low, baseline * high)
        for q, k in zip(query[:_MOST_CANDIDATES], found[:_MOST_CANDIDATES], strict=True):
            stars, guides = order[q], index.quads[k]
            ratio = float(index.baseline_rad[k]) / float(baseline[q])
            scaled = replace(camera, fx=camera.fx / ratio, fy=camera.fy / ratio)
            yield scaled, np.stack([stars, guides]).astype(np.int64), xy[stars].mean(axis=0), float(baseline_px[q])


def attitude_of(camera: Camera, xy: FloatArray, directions: FloatArray) -> FloatArray:
    """Rotation (3, 3) from a few stars."""
    return np.asarray(fit_rotation(camera.unproject(xy), directions, np.ones(len(xy))))


def without_rational(camera: Camera) -> Camera:
    """The camera without the denominator of its distortion model, which the fit does not use."""
    if camera.projection != "pinhole":
        return replace(camera, projection="fisheye")
    return replace(camera, distortion=replace(camera.distortion, k4=0.0, k5=0.0, k6=0.0))


def field_deg(camera: Camera) -> float:
    """Angle, degrees, across the width of the image from edge to edge, including distortion."""
    left, right = camera.unproject([[-0.5, camera.cy], [camera.width - 0.5, camera.cy]])
    return math.degrees(math.acos(min(1.0, float(left @ right))))


def depth(stars: int, width: int, height: int, fov_deg: float) -> int:
    """Number of the sky's brightest stars that is three times the image's star density, for evenly distributed
    stars."""
    side = math.radians(fov_deg)
    field = side * side * min(height / width, 1.0)
    return max(500, int(3.0 * (stars + 5) * 4.0 * math.pi / field))


# ---------------------------------------------------------------------- evidence
def magnitude_density(difference: FloatArray) -> FloatArray:
    """Density (…,) per magnitude of the observed minus the catalogued magnitude.

    A core of 0.3 mag and wide wings (colour, variability, saturation, blends), so that one discordant star has little
    effect.
    """
    core = np.exp(-0.5 * (difference / _CORE_MAG) ** 2) / (_CORE_MAG * math.sqrt(2.0 * math.pi))
    wide = np.exp(-0.5 * (difference / _WIDE_MAG) ** 2) / (_WIDE_MAG * math.sqrt(2.0 * math.pi))
    return np.asarray((1.0 - _WIDE_SHARE) * core + _WIDE_SHARE * wide + 1e-3)


def magnitude_ratio(magnitude: FloatArray, matched_v: FloatArray, field_v: FloatArray) -> FloatArray:
    """Likelihood ratio (N,) of the observed magnitudes: for the matched guide star to any star of the field.

    Parameters
    ----------
    magnitude : (N,)
        Observed magnitudes with the instrument's own zero point.
    matched_v : (N,)
        V magnitude of the matched guide star; NaN if there is none.
    field_v : (K,)
        V magnitudes of the guide stars of the field.
    """
    ratio = np.ones(len(magnitude))
    matched = np.isfinite(matched_v)
    # One star determines the zero point, and two provide too little information.
    if matched.sum() < 3:
        return ratio
    calibrated = magnitude - np.median(magnitude[matched] - matched_v[matched])
    likely = magnitude_density(calibrated[matched] - matched_v[matched])
    by_chance = magnitude_density(calibrated[matched, None] - field_v[None, :]).mean(axis=1)
    ratio[matched] = likely / by_chance
    return ratio


def log_evidence(
    distance: FloatArray,
    sigma: FloatArray,
    area: float,
    guides: int,
    ratio: FloatArray,
    anchors: int = 2,
) -> float:
    """ln Λ of an attitude, excluding the stars that determined it.

    Parameters
    ----------
    distance : (N,)
        Distance of each observed star from its guide star, in any unit; inf if it has none.
    sigma : (N,)
        Standard error on one axis, in the same unit.
    area : float
        Area of the image, in the same unit squared.
    guides : int
        Number of guide stars of the field, K.
    ratio : (N,)
        Likelihood ratio of the magnitudes.
    anchors : int
        Number of stars that determined the attitude; those with the largest terms are excluded, so that none is counted
        twice.

    Returns
    -------
    float
        Largest ln Λ over `DISTRACTORS`, less ln(their number).
    """
    if guides == 0:
        return -math.inf
    gain = ratio * area / (2.0 * math.pi * sigma**2 * guides) * np.exp(-0.5 * (distance / sigma) ** 2)
    best = -math.inf
    for share in DISTRACTORS:
        terms = np.sort(np.log(share + (1.0 - share) * gain))
        best = max(best, float(terms[: len(terms) - anchors].sum()))
    return best - math.log(len(DISTRACTORS))
