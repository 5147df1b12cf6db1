"""Final fit of a field with unknown focal length: all stars, weighted, and the significant lens parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from startracker.catalog.guide import GuideDatabase
from startracker.core import FloatArray
from startracker.estimation import Estimator
from startracker.estimation.association import nearest_unique
from startracker.estimation.few_stars import few_stars_factor
from startracker.estimation.pose import UNKNOWN_FLOOR_PX
from startracker.estimation.wahba import attitude_covariance
from startracker.geometry.lens import PARAMETERS, only
from startracker.geometry.lens_fit import Matches, fit_jointly, noise_floor, significant
from startracker.identification.unknown_scale.free_scale import FEWEST_FOR_K1, FreeFit

_REJECT_SIGMAS = 3.7
"""Length of a residual, in standard errors on one axis, that is exceeded with probability 1e-3 (Rayleigh)."""
STATED_PX = 0.15
"""Error, px, of centroids given without one; the rest is determined by the residuals."""
_FEWEST = 12
_FITTED = 4
"""Number of parameters of a fit of fewer stars: rotation and focal length; and k1 from ten stars on."""
_LENS = ("f", "k1", "k2", "k3", "p1", "p2")
"""Lens parameters of the fit. The principal point is not fitted: in one field it is nearly equivalent to a rotation of
the camera, and with a distorting lens a shift by c has the form of p1 and p2 to first order, −k1 (r² c + 2 x (x·c)), so
these are fitted instead."""


def last_fit(fit: FreeFit, xy: FloatArray, variance_px2: FloatArray | None, guide: GuideDatabase) -> FreeFit:
    """Fit every star of the field, weighted by its own error, with all significant lens parameters.

    The covariance accounts for errors that are known from the residuals only (`startracker.estimation.few_stars`).
    Stars are rejected by the same rule as with a known camera (`startracker.estimation.refine`); the given fit is
    returned if far fewer stars remain.

    Parameters
    ----------
    fit : FreeFit
        The accepted fit.
    xy : (N, 2)
        Centroids, brightest first.
    variance_px2 : (N,), optional
        Variance on one axis; None: equal for all.
    guide : GuideDatabase
        Guide stars as deep as the image; the first ones are those to which the fit's pairs refer.
    """
    if len(fit.pairs) < _FEWEST:
        fitted = _FITTED + (len(fit.pairs) >= FEWEST_FOR_K1)
        return replace(fit, covariance=few_stars_factor(2 * len(fit.pairs) - fitted) * fit.covariance)
    own = np.full(len(xy), STATED_PX**2) if variance_px2 is None else variance_px2
    off = xy[fit.pairs[:, 0]] - fit.camera.project(guide.directions[fit.pairs[:, 1]] @ fit.matrix.T)
    pairs, floor = fit.pairs, noise_floor(off, own[fit.pairs[:, 0]])
    camera, matrix = fit.camera, fit.matrix
    names = tuple(n for n in PARAMETERS["pinhole" if camera.projection == "pinhole" else "fisheye"] if n in _LENS)
    best = fit
    for round_ in range(4):
        sigma = np.sqrt(own + floor**2)
        matches = Matches(xy[pairs[:, 0]], guide.directions[pairs[:, 1]], sigma[pairs[:, 0]])
        if round_ == 0:
            # The first round fits all parameters, and those that are not significant are then dropped.
            full = fit_jointly(camera, [matrix], [matches], names, enough=1e-3)
            if full is None:
                return best
            names = significant(full)
            camera = only(full.camera, names)
        joint = fit_jointly(camera, [matrix], [matches], names, enough=1e-4)
        if joint is None:
            return best
        camera, matrix = joint.camera, joint.matrices[0]
        inflation = few_stars_factor(joint.freedom) * max(joint.chi2 / joint.freedom, 1e-12)
        covariance = joint.covariance[len(names) :, len(names) :] * inflation
        rms = float(np.sqrt(np.mean(joint.residuals[0] ** 2)))
        best = replace(best, camera=camera, matrix=matrix, pairs=pairs, covariance=covariance, rms_px=rms)
        floor = noise_floor(joint.residuals[0], own[pairs[:, 0]], len(joint.covariance))
        index, _, positions = guide.in_field(matrix, 3.0, camera)
        near, _ = nearest_unique(xy, positions, _REJECT_SIGMAS * np.sqrt(own + floor**2))
        seen = np.flatnonzero(near >= 0)
        matched = np.stack([seen, index[near[seen]]], axis=1)
        if np.array_equal(matched, pairs) or len(matched) < 0.8 * len(fit.pairs):
            break
        pairs = matched
    return best


def estimated(
    fit: FreeFit, xy: FloatArray, variance_px2: FloatArray | None, guide: GuideDatabase, estimator: Estimator
) -> FreeFit:
    """The fit with the attitude replaced by that of an estimator, for the same stars and the fitted lens.

    The covariance is the estimator's, plus the contribution of the unknown lens to that of the fit. Other parameters
    and errors are those of `last_fit`; an error of the estimator (`InputError`) is not caught.
    """
    seen, reference = xy[fit.pairs[:, 0]], guide.directions[fit.pairs[:, 1]]
    if variance_px2 is None:
        sigma_px = np.full(len(seen), max(fit.rms_px, UNKNOWN_FLOOR_PX))
    else:
        own = variance_px2[fit.pairs[:, 0]]
        sigma_px = np.sqrt(own + noise_floor(seen - fit.camera.project(reference @ fit.matrix.T), own) ** 2)
    directions, sigma = fit.camera.unproject(seen), sigma_px * fit.camera.pixel_rad
    estimate = estimator(directions, reference, sigma)
    # The contribution of the lens is a difference of two covariances; negative eigenvalues, due to rounding, are set to
    # 0.
    value, axis = np.linalg.eigh(fit.covariance - attitude_covariance(directions, sigma))
    of_lens = (axis * np.maximum(value, 0.0)) @ axis.T
    return replace(fit, matrix=estimate.matrix, covariance=estimate.covariance + of_lens)
