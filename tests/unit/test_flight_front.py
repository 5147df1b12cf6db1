"""The front end of a flight build: the same bits from two compilers and under sanitizers, in adverse frames."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from simulator.renderer import Renderer
from simulator.scenario import Scenario
from simulator.study.flight.design import flight_design
from startracker.errors import InputError
from startracker.flight.front_tables import front_tables
from tests.helpers.flight_c import SANITIZED
from tests.helpers.flight_front import CompiledFront, assert_same

pytestmark = [pytest.mark.system, pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc on this machine")]
CAREFUL = (*SANITIZED, "-fsanitize=bounds-strict", "-O1")
SIZES = ((192, 165), (100, 70), (16, 16))
"""Columns and rows: those of the TC211, others, and the smallest."""
SETTINGS = (
    {"psf_sigma_px": 1.8, "max_stars": 5, "max_pixels": 3},
    {"reject_hits": False, "background_tile_px": 25},
)


def scenario(name):
    return Scenario.load(f"scenarios/{name}.yaml")


@pytest.fixture(scope="module")
def design():
    return flight_design(scenario("tc211"))


def resized(design, width, height, **detection):
    """Tables for a frame of another size."""
    camera = replace(design.camera, width=width, height=height)
    return front_tables(replace(design, camera=camera, detection=replace(design.detection, **detection)))


def adverse(width, height):
    """Frames without a sky, each with its name."""
    rng = np.random.default_rng(9)
    y, x = np.mgrid[:height, :width]
    yield "dark", np.zeros((height, width))
    yield "full", np.full((height, width), 65535)
    yield "checkerboard", 65535 * ((x + y) % 2)
    yield "sparse checkerboard", 4000 * ((x % 4 == 0) & (y % 4 == 0))
    yield "columns", 60000 * (x % 3 == 0)
    yield "single rows", 3000 * (y % 7 == 3) + rng.normal(100, 3, x.shape)
    yield "slope", (x * 65535 + y * 3) // max(width, 1)
    yield "steep along y", np.clip(40 * y**2, 0, 65535)
    yield "steps", 5000 * ((y // 9) % 2) + 100 + rng.integers(0, 9, x.shape)
    yield "random", rng.integers(0, 65536, x.shape)
    yield "noise", rng.normal(1000, 30, x.shape)
    yield "noise of no light", np.maximum(rng.normal(0, 2, x.shape), 0)
    yield "heavy tails", np.clip(rng.standard_cauchy(x.shape) * 20 + 500, 0, 65535)
    yield "ridge", np.clip(60000 - 900 * np.abs(x - y), 0, 65535)
    yield "disc", 200 + 3800 * (np.hypot(x - width / 2, y - height / 2) < min(width, height) / 4)
    yield "hot", rng.normal(100, 4, x.shape) + 3000 * (rng.random(x.shape) < 0.05)
    stars = rng.normal(100, 4, x.shape)
    for _ in range(width * height // 60):
        sx, sy, flux = rng.uniform(0, width), rng.uniform(0, height), 10 ** rng.uniform(1, 5)
        stars += flux / 5 * np.exp(-((x - sx) ** 2 + (y - sy) ** 2) / 1.6)
    yield "crowd", np.clip(stars, 0, 65535)
    yield "saturated crowd", np.clip(40 * stars, 0, 5000)
    pairs = rng.normal(100, 4, x.shape)
    for sy in range(8, height - 8, 28):
        for sx in range(8, width - 8, 28):
            bright, ratio, apart, turn = (
                rng.uniform(500, 3000),
                rng.uniform(2, 40),
                rng.uniform(2, 9),
                rng.uniform(0, 7),
            )
            ox, oy = sx + apart * np.cos(turn), sy + apart * np.sin(turn)
            pairs += bright * np.exp(-((x - sx) ** 2 + (y - sy) ** 2) / 1.6)
            pairs += bright / ratio * np.exp(-((x - ox) ** 2 + (y - oy) ** 2) / 1.6)
    yield "pairs", pairs
    trails = rng.normal(100, 4, x.shape)
    for _ in range(12):
        sx, sy = rng.uniform(0, width), rng.uniform(0, height)
        for t in np.linspace(-8, 8, 40):
            trails += 8 * np.exp(-((x - sx - t) ** 2 + (y - sy - 0.5 * t) ** 2) / 1.6)
    yield "trails", trails
    for name, (along_x, along_y), light in (
        ("flat", (26, 1), 500),
        ("steep", (-2, 25), 900),
        ("broken", (18, 18), 220),
    ):
        lines = rng.normal(100, 4, x.shape)
        for number in range(40):
            sx, sy = rng.uniform(0, width), rng.uniform(0, height)
            for t in np.linspace(-0.5, 0.5, 50):
                spot = np.exp(-((x - sx - t * along_x) ** 2 + (y - sy - t * along_y) ** 2) / 1.6)
                lines += (1 + 30 * (number % 8 == 0)) * light / 250 * spot
        yield f"{name} trails", np.clip(lines, 0, 4095)


def compare(one, other):
    """Number of stars in each adverse frame, of which both builds have the same."""
    found = {}
    for name, values in adverse(one.tables.width, one.tables.height):
        image = np.asarray(values).astype(np.uint16)
        frame = one.measure(image)
        assert_same(frame, other.measure(image))
        assert (frame.lowest, frame.highest) == (image.min(), image.max())
        found[name] = len(frame.stars.x)
    return found


@pytest.mark.parametrize("size", SIZES)
def test_adverse_frames_bit_for_bit(design, tmp_path, size):
    tables = resized(design, *size)
    found = compare(CompiledFront(tables, tmp_path), CompiledFront(tables, tmp_path, *CAREFUL))
    if size == SIZES[0]:
        assert min(found[name] for name in ("crowd", "saturated crowd", "pairs", "trails", "flat trails")) > 0
        for name in ("dark", "full", "columns", "slope", "noise of no light", "checkerboard"):
            assert found[name] == 0, name


@pytest.mark.skipif(shutil.which("clang") is None, reason="no clang on this machine")
@pytest.mark.parametrize("taken", SETTINGS)
def test_other_settings_and_compiler_bit_for_bit(design, tmp_path, taken):
    tables = resized(design, 90, 80, **taken)
    compare(CompiledFront(tables, tmp_path), CompiledFront(tables, tmp_path, compiler="clang"))


@pytest.mark.parametrize("name", ["cubesat", "tc211", "gallery/moon", "gallery/hot_pixels", "gallery/smear"])
def test_rendered_frames_bit_for_bit(name, tmp_path):
    """Errors and false stars: tests/statistical/test_flight_front.py."""
    wanted = scenario(name)
    tables, renderer = front_tables(flight_design(wanted)), Renderer(wanted)
    image = np.asarray(renderer.frame(1)[0].image)
    found = CompiledFront(tables, tmp_path).measure(image)
    assert len(found.stars.x) > 3
    assert_same(found, CompiledFront(tables, tmp_path, *CAREFUL).measure(image))


def test_trails_found_before_the_frame_is_one_of_points(tmp_path):
    """Four trails share a motion before 18 candidates, most of which are shorter than a line of 8 px."""
    values = ["study.sampling=sky", "tracker.prior=false", "pointing.rate_deg_s=[0.7,0,0.7]"]
    wanted = Scenario.load("scenarios/tc211.yaml", values, seed=307)
    tables, image = front_tables(flight_design(wanted)), np.asarray(Renderer(wanted).frame(5)[0].image)
    found = CompiledFront(tables, tmp_path).measure(image)
    assert len(found.stars.x) > 20
    assert_same(found, CompiledFront(tables, tmp_path, *CAREFUL).measure(image))


def test_pieces_of_broken_trails_do_not_make_the_motion(design, tmp_path):
    """More pieces of half the length than whole trails, and the first of both are pieces: all whole trails are found in
    their middles, and nothing at 7 px from them, where their halves would be."""
    rng, size, along, half = np.random.default_rng(8), 480, 28.0, 24
    image = rng.normal(100.0, 4.0, (size, size))
    y, x = np.mgrid[-half : half + 1, -half : half + 1]
    middles = np.stack(np.meshgrid(np.arange(60.0, 440.0, 90.0), np.arange(60.0, 440.0, 90.0)), axis=-1).reshape(-1, 2)
    offset = rng.uniform(-0.5, 0.5, middles.shape)
    whole = np.arange(len(middles)) % 5 > 2
    for (sx, sy), (dx, dy), share in zip(middles.astype(int), offset, np.where(whole, 1.0, 0.5), strict=True):
        steps = along * share * np.arange(-0.49, 0.5, 0.02)[:, None, None]
        line = np.exp(-((x - dx - steps) ** 2 + (y - dy - steps) ** 2) / 1.6).mean(axis=0)
        image[sy - half : sy + half + 1, sx - half : sx + half + 1] += 1060.0 * share**2 * line
    middles += offset
    found = CompiledFront(resized(design, size, size), tmp_path).measure(np.rint(image).astype(np.uint16))
    away = np.hypot(*(found.stars.xy_px[:, None] - middles[whole]).transpose(2, 0, 1))
    assert (away.min(axis=0) < 0.5).all()
    assert np.count_nonzero((away.min(axis=1) > 2.0) & (away.min(axis=1) < 20.0)) == 0


def test_memory_of_a_megapixel(design, tmp_path):
    """With the 2 KiB of a star list beside it less than the 64 KiB that the whole context may have."""
    assert CompiledFront(resized(design, 1024, 1024), tmp_path).bytes <= 62 * 1024


def test_missing_rows_and_frames_one_after_the_other(design, tmp_path):
    tables = front_tables(design)
    compiled = CompiledFront(tables, tmp_path)
    image = np.random.default_rng(1).integers(20, 30, (165, 192)).astype(np.uint16)
    assert compiled.measure(image, 164) is None
    assert compiled.measure(image, 0) is None
    first = compiled.measure(image)
    assert_same(first, compiled.measure(image))
    assert_same(first, compiled.measure(np.vstack([image, image]), 170))


def test_what_cannot_be_built(design):
    with pytest.raises(InputError, match="4096"):
        resized(design, 5000, 10)
    with pytest.raises(InputError, match="gain"):
        front_tables(replace(design, detector=replace(design.detector, gain_e_per_dn=1e6)))
