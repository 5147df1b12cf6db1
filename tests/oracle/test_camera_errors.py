"""Errors of the camera that the tracker does not know, against closed forms and sums made another way.

Calibration residual: its mean square by a midpoint sum over the detector (its error is of the order 1/N²), and what a
calibration could still fit of it by least squares on numerical derivatives of the camera. Lateral colour: the closed
form at the corner. Intra-pixel response: Poisson's summation formula for the mean position and the sum of a sampled
image, and Simpson's rule in two dimensions. The turn of an attitude by displaced stars: normal equations of equal
weights.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import simpson
from scipy.spatial import cKDTree
from scipy.special import j1

from simulator import Renderer, Scenario
from simulator.optics.displacement import C_LINE_NM, F_LINE_NM, CalibrationResidual, Displacement, LateralColour
from simulator.optics.displacement import draw_residual as drawn
from simulator.optics.lens import Lens
from simulator.optics.pixel_response import transfer
from simulator.optics.psf import PSFS
from simulator.optics.psf_model import PsfModel
from simulator.optics.splat import render_stars
from simulator.study.trials.trial import TrialRunner
from startracker import Attitude, Camera, StarTracker
from startracker.calibration import StarField, calibrate
from startracker.core import ARCSEC_RAD
from startracker.geometry.distortion import Distortion
from startracker.geometry.image_map import pixel_slopes

CAMERA = Camera(4545.0, 4000.0, 500.0, 420.0, 1024, 800)
QUIET = ["sky.earth=false", "sky.planets=false", "pointing.error_deg=0", "study.sampling=sky"]


def midpoints(camera, count=401):
    """Positions (count², 2) at the middles of equal parts of the detector."""
    x, y = ((np.arange(count) + 0.5) / count * side - 0.5 for side in (camera.width, camera.height))
    return np.stack([a.ravel() for a in np.meshgrid(x, y)], axis=1)


def residual_at(xy, rms_px=0.05, order=5, seed=3, camera=CAMERA):
    field = drawn(camera, CalibrationResidual(rms_px, order), np.random.default_rng(seed))
    return Displacement(camera, field).moved(xy, np.zeros(len(xy))) - xy


@pytest.mark.parametrize(("order", "seed"), [(2, 1), (3, 2), (5, 3), (8, 4)])
def test_the_residual_has_its_rms_exactly(order, seed):
    moved = residual_at(midpoints(CAMERA), 0.05, order, seed)
    assert np.sqrt(np.mean(moved**2)) == pytest.approx(0.05, rel=2e-4 * order)  # error of the sum: order⁴/(6 · 401²)


def calibrated_terms(camera, xy):
    """Derivatives (N, 2, 12) of positions by all that a calibration fits, from the camera itself."""
    rays = camera.unproject(xy)
    changes = [{"fx": 1.0}, {"fy": 1.0}, {"cx": 1.0}, {"cy": 1.0}]
    changes = [{name: getattr(camera, name) + step for name, step in change.items()} for change in changes]
    changes += [{"distortion": Distortion(**{name: 1e-5})} for name in ("k1", "k2", "k3", "p1", "p2")]
    columns = [replace(camera, **change).project(rays) - xy for change in changes]
    return np.concatenate([np.stack(columns, axis=2), pixel_slopes(rays, camera.image_map)], axis=2)


def test_a_calibration_would_find_nothing_of_it():
    xy = midpoints(CAMERA, 101)
    terms = calibrated_terms(CAMERA, xy).reshape(2 * len(xy), -1)
    terms = terms / np.linalg.norm(terms, axis=0)
    moved = residual_at(xy).ravel()
    part = terms @ np.linalg.lstsq(terms, moved, rcond=1e-10)[0]
    # the sum over 101² points leaves 1/(6 · 101²) × order⁴ of a projection; without it half of the field is found
    assert np.linalg.norm(part) < 0.02 * np.linalg.norm(moved)


def test_the_residual_is_that_of_the_camera_and_smooth():
    xy = midpoints(CAMERA, 40)
    np.testing.assert_array_equal(residual_at(xy), residual_at(xy))
    assert not np.allclose(residual_at(xy), residual_at(xy, seed=4))
    np.testing.assert_allclose(residual_at(xy, 0.1), 2.0 * residual_at(xy, 0.05), atol=1e-12)
    # a polynomial of degree 5 with this rms: Markov's inequality bounds the slope by 25 × its largest value
    steps = np.abs(residual_at(xy + np.array([1.0, 0.0])) - residual_at(xy))
    assert steps.max() < 25.0 * np.abs(residual_at(xy)).max() * 2.0 / CAMERA.height
    outside = np.array([[-400.0, 200.0], [-0.5, 200.0]])
    np.testing.assert_allclose(*residual_at(outside), atol=1e-12)


def test_a_calibration_states_its_residual():
    """Twelve frames with centroids of 0.02 px: the calibration finds that they are 0.05 px further from any camera,
    less what the attitudes of the images take of it."""
    keys = [*QUIET, "sky.magnitude_limit=7", "optics.calibration_residual.rms_px=0.05"]
    renderer, fields, rng = Renderer(Scenario.load("cubesat_ideal", keys)), [], np.random.default_rng(1)
    for index in range(12):
        scene = renderer.scene(index)
        sources = renderer.expose(scene).sources
        rows = np.flatnonzero(renderer.camera.contains(sources.xy))
        rows = rows[np.argsort(-sources.electrons[rows])]
        measured = sources.image_xy[rows] + rng.normal(0.0, 0.02, (len(rows), 2))
        known = {"flux": sources.electrons[rows], "variance_px2": np.full(len(rows), 4e-4), "observer": scene.observer}
        fields.append(StarField(f"{index}", measured, 1024, 1024, **known))
    found = calibrate(fields, camera=renderer.camera)
    assert 0.7 * 0.05 < found.floor_px < 1.02 * 0.05


def test_lateral_colour_at_the_corner():
    """Half a line on either side of the middle of C and F: half the stated distance, along the radius."""
    middle_nm = 0.5 * (C_LINE_NM + F_LINE_NM)
    camera = Camera(4545.0, 4545.0, 511.5, 511.5, 1024, 1024)
    lens = Displacement.of(camera, None, LateralColour(0.4), middle_nm, 0.0)
    corner = np.full((2, 2), 1023.5)
    moved = lens.moved(corner, np.array([C_LINE_NM, F_LINE_NM])) - corner
    np.testing.assert_allclose(moved, [[0.2 / np.sqrt(2.0)] * 2, [-0.2 / np.sqrt(2.0)] * 2], rtol=1e-12)


def test_stars_are_displaced_by_their_colour():
    keys = [*QUIET, "optics.lateral_colour.corner_px=3"]
    plain, coloured = (Renderer(Scenario.load("cubesat_ideal", k)) for k in (QUIET, keys))
    before, after = (r.expose(r.scene(2)).sources for r in (plain, coloured))
    rows = np.array([after.id.tolist().index(number) for number in before.id.tolist()])
    camera = plain.focal_plane.true_camera
    radius = np.hypot(*(before.xy - (camera.cx, camera.cy)).T)
    outwards = np.hypot(*(after.xy[rows] - (camera.cx, camera.cy)).T) - radius
    # by the mean wavelength of the whole spectrum: 3 px over 170 nm in the corner at 512 √2 px
    scene, photometer = plain.scene(2), plain.focal_plane.photometer
    of_scene = np.array([scene.stars.id.tolist().index(number) for number in before.id.tolist()])
    wavelength_nm = photometer.effective_wavelength_nm(scene.b_v[scene.rows], scene.giant[scene.rows])[of_scene]
    redder_nm = wavelength_nm - photometer.effective_wavelength_nm(0.6)
    expected = 3.0 * redder_nm / (656.27 - 486.13) * radius / (512.0 * np.sqrt(2.0))
    np.testing.assert_allclose(outwards, expected, atol=1e-9)
    assert np.ptp(outwards) > 0.5
    assert after.image_xy[rows] == pytest.approx(after.xy[rows], abs=0.01)


# ---------------------------------------------------------------------- pixels
def mean_of_samples(x, sigma, contrast):
    """Σ i pᵢ / Σ pᵢ − x of a sampled Gaussian line by Poisson's formula, from the transfer function P = G R, which is
    even: Σ pᵢ = 1 + 2 Σ_k P(k) cos 2πkx and Σ (i − x) pᵢ = (1/π) Σ_k P'(k) sin 2πkx, k ≥ 1."""
    k = np.arange(1, 12)
    optical = np.exp(-2.0 * (np.pi * sigma * k) ** 2)
    pixel = np.where(k == 1, 0.5 * contrast, 0.0)
    slope = (-1.0) ** k / k
    below = np.where(k == 1, 0.0, (-1.0) ** (k - 1) / np.maximum(k - 1, 1))  # the slope of sinc f at k is (−1)ᵏ/k
    slope = slope + 0.5 * contrast * (below + (-1.0) ** (k + 1) / (k + 1))
    derivative = optical * (slope - 4.0 * np.pi**2 * sigma**2 * k * pixel)
    phase = 2.0 * np.pi * k * x
    return (derivative @ np.sin(phase)) / np.pi / (1.0 + 2.0 * (optical * pixel) @ np.cos(phase))


@pytest.mark.parametrize("contrast", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("sigma", [0.35, 0.5, 0.9])
def test_the_mean_position_on_sensitive_pixels(sigma, contrast):
    psf = build_psf_of("gaussian", contrast, sigma_px=sigma)
    for x in (0.05, 0.2, 0.25, 0.4):
        image = render_stars((61, 31), np.array([[15.0 + x, 30.0]]), np.ones(1), [1e6], psf)
        mean = image.sum(axis=0) @ np.arange(31) / image.sum() - 15.0 - x
        # 3e-6: interpolation between the phases of the table; an exact Gaussian is cut where 1e-6 of its light is left
        assert mean == pytest.approx(mean_of_samples(x, sigma, contrast), abs=5e-6)


def build_psf_of(model, contrast, **keys):
    return PSFS[model](PsfModel(model=model, **keys), Lens(4.0, (4.0, 4.0), contrast=contrast))


def airy_pattern(r):
    v = np.maximum(np.pi * r, 1e-9)
    return np.pi / 4.0 * (2.0 * j1(v) / v) ** 2


@pytest.mark.parametrize("model", ["airy", "diffraction"])
def test_a_diffraction_image_on_sensitive_pixels(model):
    """λN = 0.6 px; the middle 3 × 3 pixels by Simpson's rule on 81² points each."""
    psf, scale = build_psf_of(model, 0.4, wavelength_nm=600.0), 0.6
    u = np.linspace(-0.5, 0.5, 81)
    response = 1.0 + 0.4 * np.cos(2.0 * np.pi * u)
    for x, y in ((0.0, 0.0), (0.3, -0.2)):
        image = render_stars((129, 129), np.array([[64.0 + x, 64.0 + y]]), np.ones(1), [1.0], psf)
        expected = np.empty((3, 3))
        for j in range(-1, 2):
            for i in range(-1, 2):
                pattern = airy_pattern(np.hypot(i + u[None, :] - x, j + u[:, None] - y) / scale) / scale**2
                expected[j + 1, i + 1] = simpson(simpson(pattern * response * response[:, None], x=u), x=u)
        # the tables: 5e-5 of the peak for the Airy pattern, 2e-4 for aberrated images
        np.testing.assert_allclose(image[63:66, 63:66], expected, atol=3e-4 * expected.max())


@pytest.mark.parametrize("model", ["gaussian", "airy", "diffraction"])
@pytest.mark.parametrize("electrons", [1.0, 1e6])
def test_the_brightness_on_sensitive_pixels(model, electrons):
    """Poisson's formula in two dimensions for the light of a star, with and without its wings: 1 + c G(1, 0)
    (cos 2πx + cos 2πy) + c² G(1, 1) cos 2πx cos 2πy, with G of a clear aperture (Goodman 2005, section 6.3) or
    Gaussian; its mean over the positions is 1."""

    def aperture(frequency):
        s = np.minimum(frequency, 1.0)
        return 2.0 / np.pi * (np.arccos(s) - s * np.sqrt(1.0 - s * s))

    psf = build_psf_of(model, 0.4, **({"sigma_px": 0.35} if model == "gaussian" else {"wavelength_nm": 600.0}))
    one, two = (aperture(0.6), aperture(0.6 * np.sqrt(2.0)))
    if model == "gaussian":
        one, two = (np.exp(-2.0 * (np.pi * 0.35) ** 2 * square) for square in (1.0, 2.0))
    for x, y in ((0.0, 0.0), (0.5, 0.0), (0.2, 0.4)):
        image = render_stars((1201, 1201), np.array([[600.0 + x, 600.0 + y]]), np.ones(1), [electrons], psf)
        across, down = np.cos(2.0 * np.pi * x), np.cos(2.0 * np.pi * y)
        expected = 1.0 + 0.4 * one * (across + down) + 0.16 * two * across * down
        # a star of 1e6 e⁻ ends at 99 px, where a pixel gets 0.02 of them, and loses 2 λN/(π² 99) = 1.2e-3 of its light;
        # a faint one ends with its stamp
        tolerance = 1e-5 if model == "gaussian" else 2e-3 if electrons > 1.0 else 0.04
        assert image.sum() / electrons == pytest.approx(expected, abs=tolerance)


def test_a_pixel_without_contrast_is_a_square():
    f = np.linspace(0.0, 5.0, 100)
    assert np.array_equal(transfer(f, 0.0), np.sinc(f))
    u = np.linspace(-0.5, 0.5, 2001)
    for frequency in (0.0, 0.4, 1.0, 2.7):
        direct = simpson((1.0 + 0.3 * np.cos(2.0 * np.pi * u)) * np.cos(2.0 * np.pi * frequency * u), x=u)
        assert transfer(np.array([frequency]), 0.3)[0] == pytest.approx(direct, abs=1e-9)


# ---------------------------------------------------------------------- frames
OFF = [
    "optics.calibration_residual.rms_px=0",
    "optics.lateral_colour.corner_px=0",
    "optics.thermal.decentring_um_k=[0, 0]",
    "detector.intra_pixel.contrast=0",
    "detector.intra_pixel.centroid_curve_px=0",
]
SMALL = [*QUIET, "detector.width=256", "detector.height=256"]


def test_what_is_off_changes_no_byte():
    """Other parameters of an effect that is off, its order, reference or temperature, do not act."""
    idle = ["optics.calibration_residual.order=9", "optics.lateral_colour.reference_b_v=1"]
    one, other = (Renderer(Scenario.load("cubesat_ideal", k)).frame(4) for k in (SMALL, [*SMALL, *OFF, *idle]))
    assert one[0].image.tobytes() == other[0].image.tobytes()
    assert one[1].mean_electrons.tobytes() == other[1].mean_electrons.tobytes()
    assert np.array_equal(one[1].sources.xy, other[1].sources.xy)


@pytest.mark.parametrize(
    "key",
    [
        "optics.calibration_residual.rms_px=0.2",
        "optics.lateral_colour.corner_px=1",
        "detector.intra_pixel.contrast=0.5",
        "detector.intra_pixel.centroid_curve_px=0.1",
    ],
)
def test_the_noise_of_a_frame_stays(key):
    """Dark pixels far from stars have the same value: no stream is disturbed; a frame is the same every time."""
    one, other, again = (
        Renderer(Scenario.load("cubesat_ideal", k)).frame(4) for k in (SMALL, [*SMALL, key], [*SMALL, key])
    )
    assert other[0].image.tobytes() == again[0].image.tobytes()
    assert one[0].camera == other[0].camera
    changed = np.abs(one[1].mean_electrons - other[1].mean_electrons)
    assert changed.max() > 1.0
    dark = changed < 1e-9
    assert dark.mean() > 0.3
    assert np.array_equal(one[0].image[dark], other[0].image[dark])


# ---------------------------------------------------------------------- attitudes
def displaced_and_not(keys, index):
    """True sources of a frame with and without displacement, paired by their numbers, and its camera."""
    plain, moved = (Renderer(Scenario.load("cubesat_ideal", k)) for k in (QUIET, [*QUIET, *keys]))
    scene = plain.scene(index)
    one, other = plain.expose(scene).sources, moved.expose(scene).sources
    bright = np.flatnonzero(one.is_star & (one.v_mag < 6.0) & plain.camera.contains(one.xy, -8.0))
    rows = np.array([other.id.tolist().index(number) for number in one.id[bright].tolist()])
    return scene, plain, one.select(bright), other.select(rows)


def turn_of(runner_camera, attitude, sources, displacement):
    """Rotation vector of an attitude fitted with equal weights to displaced stars: −(Σ JᵀJ)⁻¹ Σ Jᵀd or its opposite."""
    slopes = pixel_slopes(attitude.apply(sources.direction), runner_camera.image_map)
    return np.linalg.solve(np.einsum("nji,njk->ik", slopes, slopes), np.einsum("nji,nj->i", slopes, displacement))


@pytest.fixture(scope="module")
def tracker():
    runner = TrialRunner(Scenario.load("cubesat_ideal", QUIET))
    return StarTracker(runner.renderer.camera, magnitude_limit=6.5)


@pytest.mark.parametrize(
    "keys",
    [
        ("optics.calibration_residual.rms_px=0.05",),
        ("optics.lateral_colour.corner_px=0.4",),
        ("detector.intra_pixel.centroid_curve_px=0.02",),
    ],
)
def test_an_attitude_is_turned_by_its_displaced_stars(tracker, keys):
    """With equal stated errors, well above the displacements, the tracker's fit is the plain least-squares fit."""
    turned, expected = [], []
    for index in range(6):
        scene, plain, here, there = displaced_and_not(keys, index)
        attitude = scene.pointing.camera
        known = {"sigma_px": 0.2, "observer": scene.observer, "prior": attitude, "prior_deg": 0.5}
        fits = [tracker.solve_centroids(s.image_xy, s.electrons, **known) for s in (here, there)]
        used = [cKDTree(s.image_xy).query(fit.stars.fitted.xy)[1] for s, fit in zip((here, there), fits, strict=True)]
        rows = np.intersect1d(*used)
        assert len(rows) > 0.8 * len(here)
        turned.append(fits[0].attitude.rotation_vector_to(fits[1].attitude))
        moved = there.image_xy[rows] - here.image_xy[rows]
        expected.append(turn_of(plain.camera, attitude, here.select(rows), moved))
    turned, expected = np.array(turned) / ARCSEC_RAD, np.array(expected) / ARCSEC_RAD
    size = np.sqrt(np.mean(expected**2, axis=0))
    assert (size > (0.02, 0.02, 0.2)).all()
    # the average over models (focal length, systematic errors) and doubles merged by the tracker: a tenth of the size
    assert (np.sqrt(np.mean((turned - expected) ** 2, axis=0)) < 0.15 * size).all()


def test_a_decentred_lens_turns_the_attitude_by_its_angle(tracker):
    """1 µm at 45° before 25 mm: arctan(0.7071/25000) = 5.83″ about either axis, and nothing about the boresight."""
    half = np.sqrt(0.5) / 10.0
    keys = (f"optics.thermal.decentring_um_k=[{half}, {half}]", "optics.thermal.temperature_c=30")
    scene, _, here, there = displaced_and_not(keys, 1)
    known = {"sigma_px": 0.2, "observer": scene.observer, "prior": scene.pointing.camera, "prior_deg": 0.5}
    fits = [tracker.solve_centroids(s.image_xy, s.electrons, **known).attitude for s in (here, there)]
    x, y, z = fits[0].rotation_vector_to(fits[1]) / ARCSEC_RAD
    assert isinstance(fits[0], Attitude)
    assert abs(x) == pytest.approx(5.834, rel=0.01)  # a rotation is a shift to 1 − cos² 6° = 1 %
    assert abs(y) == pytest.approx(5.834, rel=0.01)
    assert abs(z) < 0.3


def test_the_size_of_a_residual():
    """Over cameras, N stars across the field leave rms/√N of the shift on each axis: 0.05 px of 45″ with N stars of
    equal weight. 40 cameras of two axes: the rms is good to 1/√160 of itself; three of these, and the spread of N."""
    camera = Camera(4545.0, 4545.0, 511.5, 511.5, 1024, 1024)
    rng, errors = np.random.default_rng(8), []
    stars = rng.uniform(0.0, 1023.0, (30, 2))
    for seed in range(40):
        moved = residual_at(stars, 0.05, 5, seed, camera)
        slopes = pixel_slopes(camera.unproject(stars), camera.image_map)
        normal, right = np.einsum("nji,njk->ik", slopes, slopes), np.einsum("nji,nj->i", slopes, moved)
        errors.append(np.linalg.solve(normal, right) / ARCSEC_RAD)
    across = np.sqrt(np.mean(np.array(errors)[:, :2] ** 2))
    # smooth over a third of the field, and projected out on average: below that of independent errors
    assert across < 0.05 * 45.38 / np.sqrt(30.0) * (1.0 + 3.0 / np.sqrt(160.0))
    assert across > 0.05 * 45.38 / np.sqrt(30.0) / 3.0
