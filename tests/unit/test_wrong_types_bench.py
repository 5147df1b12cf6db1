"""As test_wrong_types.py, for the stimulator."""

import functools
from datetime import date

import numpy as np
import pytest
from wrong_types import faults_of

from simulator import Renderer, Scenario
from simulator.live import stimulator as bench
from startracker import Attitude, Camera

CAMERA = Camera(500.0, 500.0, 63.5, 47.5, 128, 96)
GEOMETRY = bench.DisplayGeometry(CAMERA)
CURVES = {"red": bench.Curve(2.2)}
LIGHT = bench.Photometry((128, 96), {"red": 1.0}, CURVES, uniformity=np.zeros(14))
DISPLAY = bench.Stimulator(GEOMETRY, LIGHT, Attitude([0.0, 0.0, 0.0, 1.0], "collimator", "camera"))
ATTITUDE = Attitude.from_radec_roll(85.0, -2.0, 123.0)
PATTERN = bench.Pattern(512, 512, spacing_px=32)
PHOTOGRAPH = bench.Photograph("one", np.zeros((96, 128), np.float32), CAMERA)


@functools.cache
def parts():
    renderer = Renderer(Scenario.load("cubesat_ideal", ["detector.width=64", "detector.height=64"]))
    return renderer.scene(), renderer.focal_plane


CALLS = {
    "DisplayGeometry": (bench.DisplayGeometry, {"collimator": CAMERA, "tilt_deg": (1.0, 2.0)}),
    "DisplayGeometry.to_pixels": (GEOMETRY.to_pixels, {"directions": [[0.0, 0.0, 1.0]]}),
    "DisplayGeometry.to_directions": (GEOMETRY.to_directions, {"pixels": [[1.0, 2.0]]}),
    "nominal_geometry": (bench.nominal_geometry, {"size": (128, 96), "pitch_um": 20.0, "focal_mm": 100.0}),
    "Curve": (bench.Curve, {"gamma": 2.2}),
    "Curve of a table": (bench.Curve, {"levels": (100, 255), "relative": (0.1, 1.0)}),
    "Photometry": (
        bench.Photometry,
        {"size": (128, 96), "magnitude": {"red": 1.0}, "curve": CURVES, "white_factor": 1.0,
         "uniformity": np.zeros(14), "black": 0.0},
    ),
    "Pattern": (
        bench.Pattern,
        {"width": 512, "height": 512, "colours": ("red",), "spacing_px": 32, "dot_px": 3,
         "levels": (5, 50, 100, 150, 255)},
    ),
    "Pattern.position": (PATTERN.position, {"index": [[0, 1]]}),
    "Pattern.image": (PATTERN.image, {"name": "dots"}),
    "Photograph": (
        bench.Photograph,
        {"name": "one", "image": np.zeros((96, 128)), "camera": CAMERA, "saturation_dn": 255.0},
    ),
    "Stimulator": (
        bench.Stimulator,
        {"geometry": GEOMETRY, "photometry": LIGHT, "alignment": DISPLAY.alignment, "spot_px": 0.6,
         "dithering": "spatial", "uncertainty": {}},
    ),
    "Stimulator.picture": (
        DISPLAY.picture,
        {"attitude": ATTITUDE, "directions": ATTITUDE.boresight[None], "magnitude": [3.0], "number": 0},
    ),
    "Stimulator.limits": (DISPLAY.limits, {"magnitudes": [3.0], "positions": 2}),
    "calibrate_display": (
        bench.calibrate_display,
        {"pattern": PATTERN, "nominal": GEOMETRY, "photographs": {}, "taken": bench.Exposures(1.0)},
    ),
    "align_display": (
        bench.align_display, {"stimulator": DISPLAY, "pattern": PATTERN, "photograph": PHOTOGRAPH}
    ),
    "read_stimulator": (bench.read_stimulator, {"path": "nosuch.yaml"}),
    "stimulator_yaml": (
        bench.stimulator_yaml, {"stimulator": DISPLAY, "head": ["one"], "made": date(2026, 1, 1)}
    ),
    "point_sources": (
        lambda **given: bench.point_sources(**dict(zip(("scene", "focal_plane"), parts(), strict=True)) | given),
        {"scene": ..., "focal_plane": ...},
    ),
}  # fmt: skip


@pytest.mark.parametrize("label", CALLS)
def test_every_argument_of_a_wrong_type(label, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    faults = faults_of(*CALLS[label])
    assert not faults, "\n" + "\n".join(faults)
