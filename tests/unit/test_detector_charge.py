"""Blooming, transfer, tracks, non-linearity: kernels against plain twins, and what must be conserved."""

from itertools import pairwise

import numpy as np
import pytest
from scipy import stats

from simulator.detector.blooming import bloom, full_well
from simulator.detector.cosmic_rays import add_tracks
from simulator.detector.readout import bend, saturation_dn
from simulator.detector.transfer import late_shares, transfer
from simulator.randomness import stream
from simulator.scenario.schema import DetectorSection
from tests.detectors import build_fixed_pattern, detect


# ------------------------------------------------------------------ blooming
def bloom_twin(column, full, spilt):
    """One column, charge walked pixel by pixel."""
    charge = np.minimum(column, full)
    excess = (column - charge) * spilt
    lost = 0.0
    while excess.max() > 1e-9 * full:
        arriving = np.zeros_like(charge)
        for step in (1, -1):
            room = full - charge
            for source in range(charge.size)[::step]:  # the nearest to where it goes to comes last
                rest = 0.5 * excess[source]
                place = source + step
                while rest > 0 and 0 <= place < charge.size:
                    fits = min(rest, room[place])
                    room[place] -= fits
                    arriving[place] += fits
                    rest -= fits
                    place += step
                lost += rest
        total = charge + arriving
        charge = np.minimum(total, full)
        excess = total - charge
    return charge, lost


def test_blooming_kernel_against_its_twin():
    rng = stream(1, "bloom")
    for spilt in (1.0, 0.4):
        image = rng.uniform(0.0, 90.0, (60, 30))
        image.flat[rng.choice(image.size, 60, replace=False)] = 10.0 ** rng.uniform(2, 3.3, 60)
        bloomed = image.copy()
        lost = bloom(bloomed, np.arange(30), 100.0, spilt)
        expected = [bloom_twin(image[:, k], 100.0, spilt) for k in range(30)]
        np.testing.assert_allclose(bloomed, np.stack([charge for charge, _ in expected], axis=1), rtol=0, atol=1e-6)
        assert lost == pytest.approx(sum(out for _, out in expected), abs=1e-6)


def test_charge_is_conserved():
    rng = stream(2, "bloom")
    image = rng.uniform(0.0, 90.0, (400, 20))
    image[180:220:7] = 1000.0
    before = image.sum(axis=0)
    lost = bloom(image, np.arange(20), 100.0, 1.0)
    assert lost == 0.0
    np.testing.assert_allclose(image.sum(axis=0), before, rtol=1e-9)
    assert image.max() <= 100.0
    short = np.full((10, 1), 150.0)
    assert bloom(short, np.arange(1), 100.0, 1.0) == pytest.approx(500.0, rel=1e-9)
    assert np.all(short == 100.0)


def test_a_single_star_blooms_evenly_up_and_down():
    image = np.zeros((41, 3))
    image[20, 1] = 1050.0
    full_well(image, 100.0, 0.0)
    assert np.all(image[:, [0, 2]] == 0.0)
    np.testing.assert_allclose(image[:, 1], image[::-1, 1], rtol=0, atol=1e-9)
    np.testing.assert_allclose(image[16:25, 1], 100.0)
    assert image[15, 1] == pytest.approx(75.0)
    assert image[:15, 1].max() == 0.0


def test_antiblooming_drains_its_share():
    for share in (0.0, 0.25, 0.9):
        image = np.zeros((61, 1))
        image[30] = 1100.0
        full_well(image, 100.0, share)
        assert image.sum() == pytest.approx(100.0 + 1000.0 * (1.0 - share), rel=1e-9)
    image = np.array([[50.0, 150.0]])
    assert full_well(image, 100.0, 1.0).tolist() == [[50.0, 100.0]]


# ------------------------------------------------------------------ transfer
def clock_by_clock(packets, cti):
    """Transfer simulated step by step: at each clock the share c of every packet stays for the next one."""
    line = np.array(packets, dtype=np.float64)
    read = []
    for _ in range(len(packets)):
        moving = line * (1.0 - cti)
        line -= moving
        read.append(moving[0])
        line[:-1] += moving[1:]
    return np.array(read)


@pytest.mark.parametrize("cti", [1e-6, 1e-3, 0.05, 0.4])
def test_transfer_against_step_by_step(cti):
    image = stream(3, "transfer").uniform(0.0, 1000.0, (37, 23))
    rows = np.stack([clock_by_clock(column, cti) for column in image.T], axis=1)
    np.testing.assert_allclose(transfer(image, cti, 0.0), rows, rtol=1e-12)
    both = np.stack([clock_by_clock(row, 0.5 * cti) for row in rows])
    np.testing.assert_allclose(transfer(image, cti, 0.5 * cti), both, rtol=1e-12)


def test_one_packet_keeps_its_share():
    cti = 2e-5
    image = np.zeros((1024, 64))
    image[900, 40] = 1e4
    moved = transfer(image, cti, cti)
    assert moved[900, 40] == pytest.approx(1e4 * (1 - cti) ** (901 + 41), rel=1e-12)
    assert moved[901, 40] == pytest.approx(1e4 * 901 * cti * (1 - cti) ** (901 + 41), rel=1e-12)
    assert moved.sum() == pytest.approx(1e4, rel=1e-12)
    assert not moved[:900].any()
    assert len(late_shares(1024, cti)) < 10


@pytest.mark.parametrize("cti", [0.4, 0.02])
def test_late_shares_are_negative_binomial(cti):
    """The delay of a packet of p + 1 transfers: SciPy's distribution, at both ends and in the middle. With an
    inefficiency of 0.4 the first shares of the last pixel are below 1e-100, far from its most likely delay of 400."""
    shares = late_shares(600, cti)
    delays, transfers = np.arange(len(shares))[:, None], np.array([1, 300, 600])
    expected = stats.nbinom.pmf(delays, transfers, 1.0 - cti)
    np.testing.assert_allclose(shares[:, transfers - 1], expected, rtol=1e-9, atol=1e-30)
    # the rest would come later than the last pixel, or falls below the truncation of 1e-17
    assert shares[:, -1].sum() == pytest.approx(stats.nbinom.cdf(599, 600, 1.0 - cti), rel=1e-12)


def test_the_corner_says_where_charge_goes():
    image = stream(4, "corner").uniform(0.0, 100.0, (12, 9))
    expected = transfer(image, 0.01, 0.02)
    kept = image.copy()
    for corner, flip in {
        "top_left": (1, 1), "top_right": (1, -1), "bottom_left": (-1, 1), "bottom_right": (-1, -1)
    }.items():  # fmt: skip
        view = np.ascontiguousarray(image[:: flip[0], :: flip[1]])
        np.testing.assert_array_equal(transfer(view, 0.01, 0.02, corner)[:: flip[0], :: flip[1]], expected)
    np.testing.assert_array_equal(image, kept)


# ------------------------------------------------------------------ tracks
def track_twin(shape, start, end, charge):
    """All crossings of the grid lines, sorted; the middle of each piece names its pixel."""
    image = np.zeros(shape)
    cuts = [0.0, 1.0]
    for axis in (0, 1):
        low, high = sorted((start[axis], end[axis]))
        for line in np.arange(np.floor(low), np.ceil(high) + 1) + 0.5:
            if low < line < high:
                cuts.append((line - start[axis]) / (end[axis] - start[axis]))
    cuts = np.sort(cuts)
    for t0, t1 in pairwise(cuts):
        x, y = np.rint(start + 0.5 * (t0 + t1) * (end - start)).astype(int)
        if 0 <= x < shape[1] and 0 <= y < shape[0]:
            image[y, x] += charge * (t1 - t0)
    return image


def test_tracks_against_their_twin():
    rng = stream(5, "tracks")
    for _ in range(300):
        start, end = rng.uniform(-4.0, 24.0, (2, 2))
        image = np.zeros((17, 20))
        add_tracks(image, start[None], end[None], np.array([1000.0]))
        np.testing.assert_allclose(image, track_twin(image.shape, start, end, 1000.0), rtol=0, atol=1e-9)


def test_tracks_along_the_grid_and_without_length():
    for start, end in [((2.0, 3.0), (7.0, 3.0)), ((2.0, 3.0), (2.0, -0.4)), ((5.2, 5.1), (5.2, 5.1))]:
        image = np.zeros((10, 12))
        add_tracks(image, np.array([start]), np.array([end]), np.array([500.0]))
        assert image.sum() == pytest.approx(500.0)
    diagonal = np.zeros((6, 6))
    add_tracks(diagonal, np.array([[0.0, 0.0]]), np.array([[5.0, 5.0]]), np.array([100.0]))
    np.testing.assert_allclose(np.diag(diagonal), [10, 20, 20, 20, 20, 10], atol=1e-12)
    assert diagonal.sum() == pytest.approx(100.0)


def test_most_probable_loss_of_the_particle_data_group():
    from simulator.detector.cosmic_rays import most_probable_loss_ev

    # Fast particles in 300 µm of silicon: about 23,000 electrons (84 keV), the textbook's figure; 2 %.
    assert most_probable_loss_ev(300.0) == pytest.approx(84e3, rel=0.02)


# ------------------------------------------------------------------ non-linearity and the chain
def test_nonlinearity_is_relative_at_the_full_well():
    bent = np.array([0.0, 100.0, 5000.0, 10_000.0])
    bend(bent, 10_000.0, -0.02, 0.005)
    np.testing.assert_allclose(
        bent, [0.0, 100 * (1 - 2e-4 + 5e-7), 5000 * (1 - 0.01 + 0.00125), 10_000 * 0.985], rtol=1e-14
    )


def noiseless(**keys):
    base = {"width": 24, "height": 64, "pixel_pitch_um": 5.0, "exposure_s": 0.1, "full_well_e": 1000.0}
    off = {"shot_noise": False, "adc_bits": None, "kind": "ccd_full_frame"}
    return DetectorSection(**(base | off | keys))


def test_saturation_follows_the_nonlinearity():
    detector = noiseless(nonlinearity=(-0.05, 0.0))
    frame = detect(np.full((64, 24), 2e3), detector, build_fixed_pattern(detector, 1), lambda name: stream(1, name))
    assert frame.saturation_dn == saturation_dn(detector) == pytest.approx(950.0)
    assert np.all(frame.image >= frame.saturation_dn * (1 - 1e-12))


def test_blooming_and_transfer_in_the_chain():
    mean = np.zeros((64, 24))
    mean[30, 10] = 4500.0
    detector = noiseless(antiblooming=0.0, cti_parallel=1e-3)
    frame = detect(mean, detector, build_fixed_pattern(detector, 1), lambda name: stream(1, name))
    assert frame.electrons.sum() == pytest.approx(4500.0)
    assert frame.saturated.sum() == 3
    np.testing.assert_allclose(frame.image, transfer(frame.electrons, 1e-3, 0.0), rtol=1e-15)
    assert frame.image[33, 10] > 0 and frame.image[27, 10] == 0.0  # noqa: PT018
