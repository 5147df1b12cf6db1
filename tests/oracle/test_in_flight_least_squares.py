"""Calibration in flight against a batch least-squares fit of all frames by SciPy.

Without drift the recursive estimate is that of one fit to all stars of all frames, with the lens and an attitude per
frame as unknowns and the initial uncertainties as further observations: same estimate, same covariance. The fit here
shares no code with the filter except the projection of the camera and the shape of the residual distortion; its
derivatives are finite differences. Without a residual distortion (`field_px=0`) the lens alone is compared.
"""

import numpy as np
import pytest
from lens_sequences import WIDE, lens, new_sky
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from startracker.calibration import InFlightSettings, LensFilter
from startracker.calibration.residual_field import FIELD_TERMS, field_columns
from startracker.geometry.camera import Camera
from startracker.geometry.distortion import Distortion

NO_DRIFT = {
    "focal_length_drift_ppm_sqrt_h": 0.0,
    "principal_point_drift_px_sqrt_h": 0.0,
    "distortion_drift_px_sqrt_h": 0.0,
    "star_error_px": 0.0,
    "field_px": 0.0,
}
FISHEYE = Camera(300.0, 300.0, 255.5, 255.5, 512, 512, Distortion(k1=-0.01), projection="fisheye")


def batch(filtered, frames):
    """Estimate and covariance of the change of the lens by one fit to all frames."""
    names, size = filtered.names, len(filtered.names)

    def residuals(unknown):
        camera = lens(filtered.ground, names, unknown[:size] * filtered.initial_sigma)
        out = [unknown[:size]]
        for (matrix, stars), turn in zip(frames, unknown[size:].reshape(-1, 3), strict=True):
            turned = Rotation.from_rotvec(1e-4 * turn).as_matrix() @ matrix
            out.append(((stars.xy - camera.project(stars.directions @ turned.T)) / stars.sigma_px[:, None]).ravel())
        return np.concatenate(out)

    found = least_squares(residuals, np.zeros(size + 3 * len(frames)), jac="3-point", xtol=1e-12, ftol=1e-12)
    covariance = np.linalg.inv(found.jac.T @ found.jac)[:size, :size]
    return found.x[:size] * filtered.initial_sigma, covariance * np.outer(
        filtered.initial_sigma, filtered.initial_sigma
    )


@pytest.mark.parametrize(
    ("camera", "names"),
    [
        (WIDE, ("f", "cx", "cy", "k1")),
        (WIDE, ("f", "aspect", "cx", "cy", "k1", "k2", "p1", "p2")),
        (FISHEYE, ("f", "cx", "cy", "k1", "k2")),
    ],
)
def test_recursive_estimate_is_that_of_one_fit(camera, names):
    """Both are minima of the same sum of squares, except that the filter keeps the derivatives of each frame at the
    lens of its time: a change of 1e-3 of the field (0.2 px of 500) changes these, and so the estimate in units of its
    standard deviation, by about 1e-3 times a few; the covariance likewise."""
    rng = np.random.default_rng(5)
    filtered = LensFilter(camera, InFlightSettings(parameters=names, **NO_DRIFT))
    true = lens(camera, names, rng.normal(size=len(names)) * filtered.initial_sigma)
    frames = []
    for k in range(12):
        matrix, stars = new_sky(rng, true, 20, 0.05, 20 * k)
        stars.xy[:] -= 0.1 * (stars.xy - true.project(stars.directions @ matrix.T))  # no frame is taken for too noisy
        filtered.predict(1.0)
        found = filtered.update(matrix, stars)
        assert found.accepted
        frames.append((matrix, stars.select(found.used)))
    assert filtered.noise_factor == 1.0
    assert sum(len(stars) for _, stars in frames) >= 0.98 * 240
    estimate, covariance = batch(filtered, frames)
    sigma = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose((filtered.change - estimate) / sigma, 0.0, atol=0.02)
    np.testing.assert_allclose(
        filtered.covariance / np.outer(sigma, sigma), covariance / np.outer(sigma, sigma), atol=0.01
    )
    assert np.abs(filtered.change / filtered.initial_sigma).max() > 0.5  # there was something to find


def test_a_star_moved_moves_the_estimate_as_stated():
    """The consider covariance follows ∂(lens)/∂(direction of a star): against the difference of two runs, one with a
    star of the catalogue displaced by 0.02 px in every frame. Linear to 1e-3 as above."""
    changes, filters = [], []
    for moved in (0.0, 0.02):
        rng = np.random.default_rng(8)
        filtered = LensFilter(WIDE, InFlightSettings(star_error_px=0.01, field_px=0.0))
        sky = None
        for k in range(15):
            matrix = Rotation.from_rotvec([0.0, 0.0, 0.1 * k]).as_matrix()
            if sky is None:
                _, first = new_sky(rng, WIDE, 25, 0.05)
                sky = WIDE.unproject(first.xy)
                axis = np.cross(sky[3], [0.0, 0.0, 1.0])
                axis /= np.linalg.norm(axis)
            xy = WIDE.project(sky @ matrix.T)
            inside = np.flatnonzero(WIDE.contains(xy))
            catalogue = sky.copy()
            catalogue[3] += moved * WIDE.pixel_rad * axis
            measured = xy[inside] + rng.normal(0.0, 0.03, (len(inside), 2))
            stars = first.select(inside)
            stars.xy[:], stars.directions[:], stars.catalog_id[:] = measured, catalogue[inside], inside
            filtered.predict(10.0)
            assert filtered.update(matrix, stars).used.all()
        changes.append(filtered.change)
        filters.append(filtered)
    row = int(filters[0].stars.rows(np.array([3]))[0])
    expected = filters[0].stars._slopes[row] @ axis * 0.02 * WIDE.pixel_rad
    scale = np.abs(expected) + 0.02 * np.sqrt(np.diag(filters[0].stars.covariance))
    np.testing.assert_allclose((changes[1] - changes[0]) / scale, expected / scale, atol=0.02)
    assert np.abs(expected / filters[0].sigma).max() > 0.05


def test_lens_and_residual_distortion_are_those_of_one_fit():
    """A lens with a smooth distortion of 0.1 px: lens, displacement and their covariance against one linear fit to all
    stars for each rms value of the displacement, averaged with the evidence of each fit. The model is linear to 1e-3 as
    above, and the weights of the rms values change by as much."""
    settings = InFlightSettings(**NO_DRIFT | {"field_px": 1.0})
    filtered, rng = LensFilter(WIDE, settings), np.random.default_rng(6)
    size, terms = len(filtered.names), FIELD_TERMS
    true = lens(WIDE, filtered.names, rng.normal(size=size) * filtered.initial_sigma)
    bend = rng.normal(0.0, 0.1 / np.sqrt(terms / 2.0), terms)
    frames = []
    for k in range(6):
        matrix, stars = new_sky(rng, true, 30, 0.05, 30 * k)
        stars.xy[:] -= 0.1 * (stars.xy - true.project(stars.directions @ matrix.T))
        stars.xy[:] += field_columns(WIDE, stars.xy) @ bend
        found = filtered.update(matrix, stars)
        assert found.accepted
        frames.append((matrix, stars.select(found.used)))
        assert found.noise_factor == filtered.noise_factor == 1.0

    def residuals(unknown):
        camera, turns = lens(WIDE, filtered.names, unknown[:size] * filtered.initial_sigma), unknown[size + terms :]
        out = []
        for (matrix, stars), turn in zip(frames, turns.reshape(-1, 3), strict=True):
            xy = camera.project(stars.directions @ matrix.T @ Rotation.from_rotvec(1e-4 * turn).as_matrix().T)
            moved = xy + field_columns(WIDE, stars.xy) @ unknown[size : size + terms]
            out.append(((stars.xy - moved) / stars.sigma_px[:, None]).ravel())
        return np.concatenate(out)

    start = np.zeros(size + terms + 3 * len(frames))
    start[:size] = filtered.change / filtered.initial_sigma
    steps = 1e-4 * np.eye(len(start))
    jacobian = np.stack([(residuals(start + h) - residuals(start - h)) / 2e-4 for h in steps], axis=1)
    fits, log_evidence = [], []
    for rms_px in 0.5 ** np.arange(11.0):
        scale = np.concatenate([np.ones(size), np.full(terms, rms_px / np.sqrt(terms / 2.0)), np.ones(3 * len(frames))])
        prior = np.diag(np.r_[np.ones(size + terms), np.zeros(3 * len(frames))])
        normal = (jacobian * scale).T @ (jacobian * scale) + prior
        wanted = residuals(start) - jacobian @ start
        unknown = -np.linalg.solve(normal, (jacobian * scale).T @ wanted)
        left = wanted + jacobian @ (scale * unknown)
        log_evidence.append(-0.5 * (left @ left + unknown @ prior @ unknown + np.linalg.slogdet(normal)[1]))
        fits.append((scale * unknown, np.linalg.inv(normal) * np.outer(scale, scale)))
    weight = np.exp(np.array(log_evidence) - max(log_evidence))
    weight /= weight.sum()
    mean = sum(w * x for w, (x, _) in zip(weight, fits, strict=True))
    spread = sum(w * (c + np.outer(x - mean, x - mean)) for w, (x, c) in zip(weight, fits, strict=True))
    sigma = np.sqrt(np.diag(spread))
    found = np.concatenate([filtered.change / filtered.initial_sigma, filtered.field.mean])
    np.testing.assert_allclose((found - mean[: size + terms]) / sigma[: size + terms], 0.0, atol=0.03)
    stated = filtered.field.joint(filtered.filtered) / np.outer(*[np.r_[filtered.initial_sigma, np.ones(terms)]] * 2)
    of_both = slice(0, size + terms)
    relative = np.outer(sigma[of_both], sigma[of_both])
    np.testing.assert_allclose(stated / relative, spread[of_both, of_both] / relative, atol=0.02)
    assert filtered.field.rms_px == pytest.approx(0.1, rel=0.5)  # of 26 coefficients, and few stars
