"""Other programs beside ours, in one process, on the same scene: as their users call them, with their defaults."""

from functools import cache

import numpy as np
import pytest

from benchmarks.cases import CASES
from benchmarks.scenes import SceneMaker
from benchmarks.solvers import Boresight, Tetra3rs
from benchmarks.speed.workload import PLAIN, even_scenario, expose, renderer, scene
from startracker.centroid import METHODS as CENTROIDERS
from startracker.detection import METHODS as DETECTORS
from startracker.front_end import Clock, find_stars
from startracker.inputs import given_image
from startracker.settings import CentroidSettings, DetectionSettings

SIDE, STARS, SIGMA_PX, READ_E = 1024, 200, 0.9, 10.0
FULL_SCALE = 4095


@cache
def drawn():
    """The scene that all draw: renderer, scene, pixels and electrons of its stars, background, electrons a DN."""
    made = renderer(even_scenario(SIDE, STARS, *PLAIN))
    seen = scene(made, 0)
    light = made.expose(seen)
    inside = made.camera.contains(light.sources.xy)
    gain = expose(made, seen, 0).gain_e_per_dn
    return made, seen, light.sources.xy[inside], light.sources.electrons[inside], float(np.median(light.mean_e)), gain


@cache
def image():
    made, seen, *_ = drawn()
    return expose(made, seen, 0)


def as_dn(electrons, gain):
    return np.clip(np.rint(electrons / gain), 0, FULL_SCALE).astype(np.uint16)


@pytest.mark.benchmark(group="draw 200 stars with noise, 1024²")
def test_draw_boresight(timed):
    made, seen, *_ = drawn()
    assert timed(lambda index: expose(made, seen, index), lambda index: index, 30).image.shape == (SIDE, SIDE)


@pytest.mark.benchmark(group="draw 200 stars with noise, 1024²")
def test_draw_galsim(timed):
    galsim = pytest.importorskip("galsim")
    _, _, xy, electrons, background, gain = drawn()

    def draw(index):
        rng = galsim.BaseDeviate(index + 1)
        whole = galsim.ImageD(SIDE, SIDE, xmin=0, ymin=0)
        for (x, y), flux in zip(xy, electrons, strict=True):
            star = galsim.Gaussian(sigma=SIGMA_PX, flux=flux)
            stamp = star.drawImage(nx=15, ny=15, scale=1.0, center=galsim.PositionD(x, y))
            both = stamp.bounds & whole.bounds
            whole[both] += stamp[both]
        whole += background
        whole.addNoise(galsim.PoissonNoise(rng))
        whole.addNoise(galsim.GaussianNoise(rng, sigma=READ_E))
        return as_dn(whole.array, gain)

    assert timed(draw, lambda index: index, 8).shape == (SIDE, SIDE)


@pytest.mark.benchmark(group="draw 200 stars with noise, 1024²")
def test_draw_photutils(timed):
    photutils = pytest.importorskip("photutils")
    from astropy.table import Table
    from photutils.datasets import make_model_image
    from photutils.psf import CircularGaussianPRF

    assert photutils
    _, _, xy, electrons, background, gain = drawn()
    table = Table({"x_0": xy[:, 0], "y_0": xy[:, 1], "flux": electrons})
    model = CircularGaussianPRF(fwhm=SIGMA_PX * 2.3548)

    def draw(index):
        rng = np.random.default_rng(index)
        mean = make_model_image((SIDE, SIDE), model, table, model_shape=(15, 15)) + background
        return as_dn(rng.poisson(mean) + rng.normal(0.0, READ_E, mean.shape), gain)

    assert timed(draw, lambda index: index, 8).shape == (SIDE, SIDE)


@pytest.mark.benchmark(group="find and measure the stars of that frame")
def test_find_boresight(timed):
    readout = image()

    def find(_):
        return find_stars(
            given_image(readout),
            DETECTORS["components"],
            CENTROIDERS["maximum_likelihood"],
            DetectionSettings(max_stars=1000),
            CentroidSettings(),
            Clock(),
        )

    assert len(timed(find, lambda _: None, 30).stars.xy) > 0.8 * STARS


@pytest.mark.benchmark(group="find and measure the stars of that frame")
def test_find_photutils(timed):
    pytest.importorskip("photutils")
    from astropy.stats import sigma_clipped_stats
    from photutils.centroids import centroid_com, centroid_sources
    from photutils.detection import DAOStarFinder

    pixels = image().image.astype(float)

    def find(_):
        _, median, noise = sigma_clipped_stats(pixels, sigma=3.0)
        found = DAOStarFinder(threshold=5.0 * noise, fwhm=SIGMA_PX * 2.3548)(pixels - median)
        columns = ("x_centroid", "y_centroid") if "x_centroid" in found.colnames else ("xcentroid", "ycentroid")
        x, y = (np.asarray(found[name]) for name in columns)
        return centroid_sources(pixels - median, x, y, box_size=5, centroid_func=centroid_com)

    assert len(timed(find, lambda _: None, 6)[0]) > 0.5 * STARS


CASE = CASES["10deg 6.5, 0.3 px, 3 false"]
MAKER = cache(lambda: SceneMaker(CASE, 4))


@pytest.mark.benchmark(group="solve centroids lost in space: 10°, 0.3 px, 3 false")
def test_solve_boresight(timed):
    solver = Boresight(CASE, "adaptive")
    timed(solver.answer, lambda index: MAKER().scene(index), 500, 20)


@pytest.mark.benchmark(group="solve centroids lost in space: 10°, 0.3 px, 3 false")
def test_solve_tetra3rs(timed):
    pytest.importorskip("tetra3rs")
    solver = Tetra3rs(CASE, coarser=False)
    timed(solver.answer, lambda index: MAKER().scene(index), 500, 20)
