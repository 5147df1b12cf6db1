"""Equations of one frame for the lens, with the attitude of the frame marginalised (see `lens_filter`)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from startracker.core import FloatArray
from startracker.geometry.attitude import rotation_vector_to_matrix
from startracker.geometry.camera import Camera
from startracker.geometry.lens import by_turn, sensitivity
from startracker.geometry.lens_fit import Matches

_ATTITUDE_STEPS = 3
_RATE_SIGMA_RAD_S = 0.2
"""Prior standard deviation of the rate of a camera with a rolling shutter."""


@dataclass(frozen=True, eq=False)
class LensEquations:
    """Equations of the stars of a frame (M) for the parameters of the lens, with their stated errors.

    The P unknowns are the parameters of the lens, followed by the coefficients of the residual field.
    """

    matrix: FloatArray
    """Attitude (3, 3) fitted to the stars with the current lens."""
    information: FloatArray
    """I (P, P) of `lens_filter`."""
    vector: FloatArray
    """b (P,)."""
    residual: FloatArray
    """Residuals (M, 2) of the fitted attitude, px."""
    by_lens: FloatArray
    """Derivatives (M, 2, P) of the positions that the attitude does not explain."""
    attitude_by_lens: FloatArray
    """Derivative (3, P) of the attitude (rotation vector, camera axes)."""
    weighted: FloatArray
    """`by_lens` divided by the standard errors, (M, 2, P)."""
    by_star: FloatArray
    """Derivative (M, P, 3) of b with respect to the directions of the stars, ICRS axes."""

    def noise_information(self, share: FloatArray) -> FloatArray:
        """Covariance (P, P) of b by the part `share` (M,) of the variances of the stars."""
        return np.asarray(np.einsum("mip,m,miq->pq", self.weighted, share, self.weighted))


def lens_equations(
    camera: Camera, matrix: FloatArray, stars: Matches, names: tuple[str, ...], field: FloatArray | None = None
) -> LensEquations:
    """Equations of a frame about its own attitude, which is fitted by Gauss–Newton from `matrix` (3, 3).

    Parameters
    ----------
    camera, matrix, stars
        Current lens, approximate attitude, and the stars of the frame (M).
    names : tuple of str
        Parameters, of `startracker.geometry.lens.PARAMETERS`.
    field : array, shape (M, 2, C), optional
        Displacements by further unknowns, pixels (`startracker.calibration.residual_field`).
    """
    weight = 1.0 / stars.sigma_px[:, None]
    for _ in range(_ATTITUDE_STEPS):
        at, vectors = matrix, stars.directions @ matrix.T
        pixels, moves, by_vector = sensitivity(camera, vectors)
        unknown = by_turn(by_vector, vectors)
        if camera.row_time_s:  # the rate of the camera rotates the rows
            row_s = (stars.xy[:, 1] - (camera.height - 1) / 2.0) * camera.row_time_s
            unknown = np.concatenate([unknown, unknown * row_s[:, None, None]], axis=2)
        columns = (unknown * weight[:, :, None]).reshape(-1, unknown.shape[2])
        observed = ((stars.xy - pixels) * weight).ravel()
        normal = columns.T @ columns
        normal[range(3, len(normal)), range(3, len(normal))] += _RATE_SIGMA_RAD_S**-2.0
        turn = np.linalg.solve(normal, columns.T @ observed)
        matrix = rotation_vector_to_matrix(turn[:3]) @ matrix
    slopes = np.stack([moves[name] for name in names], axis=2)
    if field is not None:
        slopes = np.concatenate([slopes, field], axis=2)
    by_lens = (slopes * weight[:, :, None]).reshape(-1, slopes.shape[2])
    # Schur complement: the part of the derivatives that a rotation of the camera (and its rate) cannot explain.
    share = np.linalg.solve(normal, columns.T @ by_lens)
    beside = by_lens - columns @ share
    left = observed - columns @ turn
    weighted = beside.reshape(slopes.shape)
    # A shift of a star has the opposite sign of its residual; `at` takes ICRS to camera axes.
    by_star = -np.einsum("mip,mij->mpj", weighted * weight[:, :, None], by_vector @ at)
    return LensEquations(
        np.asarray(matrix),
        by_lens.T @ beside,
        by_lens.T @ left,
        left.reshape(-1, 2) / weight,
        weighted / weight[:, :, None],
        np.asarray(-share[:3], dtype=np.float64),
        weighted,
        np.asarray(by_star, dtype=np.float64),
    )
