"""Tables of star images: Gaussians against SciPy's integral, smear against a sum of exposures, files."""

import zipfile

import numpy as np
import pytest
from scipy.integrate import dblquad
from scipy.stats import multivariate_normal

from startracker.centroid.psf_model import _MOST_EXPANDED_BYTES, PsfModel, gaussian_psf, load_psf
from startracker.errors import InputError


@pytest.mark.parametrize(
    ("xx", "yy", "xy"), [(0.81, 0.81, 0.0), (0.25, 0.4, 0.0), (1.4, 0.8, 0.5), (4.0, 1.0, -1.5), (0.3, 0.3, 0.1)]
)
def test_gaussian_against_scipy(xx, yy, xy):
    psf = gaussian_psf(xx, yy, xy, radius_px=5.0)
    density = multivariate_normal(cov=[[xx, xy], [xy, yy]])
    peak = float(psf.shares(0.0, 0.0))
    for dx, dy in [(0.0, 0.0), (0.37, -0.81), (1.5, 1.2), (-2.1, 0.33)]:
        exact = dblquad(
            lambda v, u: density.pdf([u, v]), dx - 0.5, dx + 0.5, dy - 0.5, dy + 0.5, epsabs=1e-8, epsrel=1e-6
        )[0]
        # seven points a σ: cubic interpolation and the trapezoidal rule are good to some 1e-4 of the peak
        assert float(psf.shares(dx, dy)) == pytest.approx(exact, abs=2e-4 * peak)
    # the light beyond 5 pixels, 2.5 σ at the widest
    outside = 1 - psf.table.sum() / psf.oversampling**2
    assert -1e-4 < outside < 0.03


@pytest.mark.parametrize("xy", [0.02, -0.06, 0.08])
def test_a_tilted_gaussian_is_a_sum_of_products(xy):
    psf = gaussian_psf(0.8, 1.1, xy, radius_px=4.0)
    assert 6 <= len(psf.axes) <= 10
    density, middle = multivariate_normal(cov=[[0.8, xy], [xy, 1.1]]), len(psf.table) // 2
    for column, row in [(0, 0), (3, -5), (-9, 8), (14, 16)]:
        corner = np.array([column, row]) / psf.oversampling - 0.5
        exact = density.cdf(corner + 1.0, lower_limit=corner)
        # what the terms left out have, and the tolerance of SciPy's integral
        assert psf.table[middle + row, middle + column] == pytest.approx(exact, abs=1e-5 * psf.table.max())


@pytest.mark.parametrize("path", [(4.0, 0.0), (2.0, -3.0)])
def test_smear_is_the_mean_of_many_exposures(path):
    still = gaussian_psf(0.8, 0.8, radius_px=6.0)
    smeared = still.smeared(*path)
    u, v = np.array([-1.3, 0.0, 0.7, 2.2]), np.array([0.4, 0.0, -1.6, -1.1])
    t = (np.arange(2000) + 0.5) / 2000 - 0.5
    exact = still.shares(u[:, None] - t * path[0], v[:, None] - t * path[1]).mean(axis=1)
    assert np.allclose(smeared.shares(u, v), exact, atol=2e-5)
    assert smeared.table.sum() / smeared.oversampling**2 == pytest.approx(1, abs=1e-3)
    assert smeared.sigma_px == pytest.approx(np.sqrt(0.8 + (path[0] ** 2 + path[1] ** 2) / 12))


def test_the_table_of_an_upright_image_is_the_product_of_its_axes():
    psf = gaussian_psf(0.9, 0.7, radius_px=4.0)
    table, (along_x, along_y), oversampling = psf.samples
    assert not table.size
    radius = psf.radius_px
    assert np.array_equal(psf.table, np.outer(along_y, along_x))
    whole = PsfModel(psf.table, oversampling, psf.shape)
    assert whole.radius_px == radius
    assert whole.samples[0] is psf.table


def test_a_file_gives_back_what_was_saved(tmp_path):
    psf = gaussian_psf(0.9, 0.7, 0.1, radius_px=4.0)
    path = tmp_path / "psf.npz"
    psf.save(path)
    back = load_psf(path)
    assert np.array_equal(back.table, psf.table)
    assert (back.oversampling, back.shape) == (psf.oversampling, psf.shape)


def test_bad_files_are_named(tmp_path):
    with pytest.raises(InputError, match=r"none\.npz"):
        load_psf(tmp_path / "none.npz")
    broken = tmp_path / "broken.npz"
    broken.write_text("no archive")
    with pytest.raises(InputError, match="not a star image"):
        load_psf(broken)
    even = tmp_path / "even.npz"
    PsfModel(np.ones((4, 4)), 8, (1.0, 1.0, 0.0)).save(even)
    with pytest.raises(InputError, match="odd"):
        load_psf(even)
    with pytest.raises(InputError, match="covariance"):
        gaussian_psf(1.0, 1.0, 1.0, radius_px=4.0)


@pytest.mark.parametrize(
    "changes",
    [
        {"format": 99},
        {"table": np.ones((5, 7))},
        {"table": np.ones(5)},
        {"table": np.full((5, 5), np.inf)},
        {"oversampling": 0},
        {"shape": np.ones(2)},
    ],
)
def test_each_part_of_a_file_is_checked(tmp_path, changes):
    path = tmp_path / "psf.npz"
    gaussian_psf(0.9, 0.7, 0.1, radius_px=1.0).save(path)
    with np.load(path) as data:
        parts = dict(data)
    np.savez(path, **{**parts, "oversampling": 1})
    assert load_psf(path).oversampling == 1
    damaged = tmp_path / "damaged.npz"
    np.savez(damaged, **{**parts, **changes})
    with pytest.raises(InputError, match="is damaged: the table must be square, of odd size and finite"):
        load_psf(damaged)


def test_objects_in_a_file_are_not_made(tmp_path):
    """Reading a pickled object runs what its author wrote into it."""
    path = tmp_path / "psf.npz"
    table = np.ones((5, 5)).astype(object)
    np.savez(path, format=1, table=table, oversampling=1, shape=np.ones(3))
    with pytest.raises(InputError, match=r"not a star image made by PsfModel\.save \(.*pickle"):
        load_psf(path)


def test_an_archive_that_expands_beyond_the_limit_is_refused_unread(tmp_path):
    path = tmp_path / "psf.npz"
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open("table.npy", "w", force_zip64=True) as file,
    ):
        for _ in range(_MOST_EXPANDED_BYTES // 2**20 + 1):
            file.write(bytes(2**20))
    with pytest.raises(InputError, match=r"its tables have [0-9,]+ bytes"):
        load_psf(path)
