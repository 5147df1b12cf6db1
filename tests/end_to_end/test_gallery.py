"""Every scenario of the gallery renders, and what it is there to show is in its frame."""

from pathlib import Path

import numpy as np
import pytest

from simulator import Scenario
from simulator.renderer import Renderer

pytestmark = pytest.mark.system

GALLERY = Path(__file__).resolve().parents[2] / "scenarios" / "gallery"


def frame_of(name, *overrides):
    return Renderer(Scenario.load(GALLERY / f"{name}.yaml", overrides)).frame(0)


@pytest.mark.parametrize("path", sorted(GALLERY.glob("*.yaml")), ids=lambda path: path.stem)
def test_renders(path):
    frame, truth = Renderer(Scenario.load(path)).frame(0)
    assert frame.image.shape == (frame.camera.height, frame.camera.width)
    assert np.isfinite(truth.mean_electrons).all()
    # a sky, not a blank: stars or bodies in the field, and light from them
    assert np.sum(frame.camera.contains(truth.sources.xy)) > 5
    assert truth.mean_electrons.max() > 100


def test_moon_shows_its_quarter():
    _, truth = frame_of("moon")
    i = int(np.flatnonzero(truth.sources.kind == "moon")[0])
    x, y = np.round(truth.sources.xy[i]).astype(int)
    patch = truth.mean_electrons[y - 30 : y + 31, x - 30 : x + 31]
    lit = np.mean(patch > 0.1 * patch.max()) * patch.size
    radius = np.radians(0.2585) / frame_of("moon")[0].camera.pixel_rad  # mean apparent radius 15.5′
    # first quarter at 02:32 UTC of that day (almanac): half the disk, to the terminator's few pixels and the distance
    assert lit == pytest.approx(np.pi / 2 * radius**2, rel=0.25)


def test_blooming_fills_the_column_of_sirius():
    frame, truth = frame_of("blooming")
    x = round(float(truth.sources.xy[np.argmax(truth.sources.electrons), 0]))
    full = frame.image[:, x] >= 0.9 * frame.saturation_dn
    dry, _ = frame_of("blooming", "detector.antiblooming=1")
    assert full.sum() > 3 * np.sum(dry.image[:, x] >= 0.9 * dry.saturation_dn)


def test_radiation_hits_as_many_as_expected():
    with_hits, _ = frame_of("saa")
    without, _ = frame_of("saa", "detector.cosmic_rays.rate_cm2_s=0")
    changed = np.mean(with_hits.image != without.image)
    # 1100 /cm²/s × 0.317 cm² × 0.2 s = 70 hits (Poisson) of 1 to 30 pixels each, of 1,048,576
    assert 30 / 1_048_576 < changed < 70 * 40 / 1_048_576


def test_the_earth_hides_stars():
    hidden, truth = frame_of("earth_limb")
    _, open_sky = frame_of("earth_limb", "sky.earth=false")
    inside = hidden.camera.contains(truth.sources.xy).sum()
    assert inside < 0.8 * hidden.camera.contains(open_sky.sources.xy).sum()
    assert np.mean(hidden.image >= hidden.saturation_dn) > 0.2
