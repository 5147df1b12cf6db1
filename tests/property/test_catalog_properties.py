"""What must hold for any catalogue."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from startracker.catalog import StarCatalog, merge_doubles
from startracker.catalog.hipparcos import match


@st.composite
def catalogues(draw):
    n = draw(st.integers(0, 30))

    def column(low, high):
        return draw(arrays(float, n, elements=st.floats(low, high, allow_nan=False)))

    # declinations to the poles; many stars within a degree of each other
    return StarCatalog(
        name="any",
        epoch_jyear=2000.0,
        id=np.arange(1, n + 1),
        ra_rad=column(0.0, 0.03) + draw(st.sampled_from([0.0, 3.0, 6.26])),
        dec_rad=np.clip(column(-0.02, 0.02) + draw(st.sampled_from([-1.57, 0.0, 1.57])), -np.pi / 2, np.pi / 2),
        pm_ra_rad_yr=column(-5e-5, 5e-5),
        pm_dec_rad_yr=column(-5e-5, 5e-5),
        parallax_rad=column(1e-8, 4e-6),
        radial_velocity_km_s=column(-300.0, 300.0),
        v_mag=np.round(column(-1.5, 12.0), 2),
        b_v=column(-0.4, 3.0),
        spectral_type=np.full(n, ""),
        star_name=np.full(n, ""),
    )


@settings(max_examples=60, deadline=None)
@given(catalogues(), st.floats(0.0, 0.05))
def test_merging_keeps_the_light(catalog, separation):
    merged = merge_doubles(catalog, separation)
    light = np.sum(10 ** (-0.4 * catalog.v_mag))
    assert np.isclose(np.sum(10 ** (-0.4 * merged.v_mag)), light, rtol=1e-12)
    assert set(merged.id.tolist()) <= set(catalog.id.tolist())
    assert len(set(merged.id.tolist())) == len(merged)
    # the brightest star of all is nobody's companion
    if len(catalog):
        assert (
            catalog.id[int(np.argmin(catalog.v_mag))] in merged.id or np.sum(catalog.v_mag == catalog.v_mag.min()) > 1
        )
    if len(merged) == len(catalog):
        np.testing.assert_array_equal(merged.ra_rad, catalog.ra_rad)


@settings(max_examples=60, deadline=None)
@given(catalogues(), st.floats(1850.0, 2150.0))
def test_epochs_join(catalog, epoch):
    there = catalog.at_epoch(epoch)
    for view in (1990.0, epoch, 2035.0):
        np.testing.assert_allclose(there.directions(view), catalog.directions(view), atol=1e-12)


@settings(max_examples=60, deadline=None)
@given(catalogues(), catalogues())
def test_a_match_is_one_to_one(one, other):
    found = match(one, other)
    hits = found[found >= 0]
    assert len(hits) == len(set(hits.tolist()))
    assert np.all(found < len(other))
