"""Draws docs/images/stimulator.png: a simulated bench calibrated, and how well its display shows stars.

Run it from the top folder: python docs/make_images/stimulator.py. It prints the report of the calibration.
"""

import math
import sys
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import matplotlib as mpl
import numpy as np

from simulator.live.stimulator import Exposures, Pattern, Photograph, calibrate_display, nominal_geometry
from startracker import Attitude, Camera, Distortion, load_catalog
from startracker.images.picture import stretch

mpl.use("Agg")
import matplotlib.pyplot as plt

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tests" / "helpers"))
Bench = import_module("synthetic_bench").Bench

OUT = ROOT / "docs" / "images" / "stimulator.png"
BLUE, ORANGE, GREEN, RED = "#0072B2", "#E69F00", "#009E73", "#D55E00"
plt.rcParams.update({"font.size": 8, "figure.constrained_layout.use": True, "axes.grid": True, "grid.color": "#dddddd"})

bench, rng, pattern = Bench(black=2e-4), np.random.default_rng(1), Pattern(1280, 1024)
camera = Camera(*bench.camera_matrix, *bench.camera_size, Distortion(k1=-0.05, k2=0.02, p1=2e-4, p2=-1e-4))
photographs = {}
for name in (*pattern.names, "off"):
    shown = pattern.image("black" if name == "off" else name)
    pixels = bench.photograph(shown, 0.01 if name == "dots" else 0.016, rng, on=name != "off")
    photographs[name] = Photograph(name, pixels.astype(np.float32), camera, bench.saturation_dn)
taken = Exposures(0.016, bench.gain, 2.5 * math.log10(bench.zero_e_s / bench.gain))
calibration = calibrate_display(pattern, nominal_geometry((1280, 1024), 12.0, 60.0), photographs, taken)
print("\n".join(calibration.summary()))
stimulator = calibration.stimulator

figure, axes = plt.subplots(2, 2, figsize=(10.0, 8.4))

ax = axes[0, 0]
ax.imshow(stretch(photographs["dots"].image), cmap="gray", vmin=0, vmax=1)
ax.set(title="photograph of the dots, with its three markers", xlabel="camera column [px]", ylabel="row [px]")
ax.grid(visible=False)

ax = axes[0, 1]
for colour, tint in (("red", RED), ("green", GREEN), ("blue", BLUE)):
    curve = stimulator.photometry.curve[colour].table
    ax.plot(curve * 10 ** (-0.4 * stimulator.photometry.magnitude[colour]), color=tint, label=f"{colour}, calibrated")
    levels = np.arange(5, 256, 25)
    true = bench.relative(colour, levels) * 10 ** (-0.4 * bench.magnitude[colour])
    ax.plot(levels, true, "o", ms=4, mfc="none", color=tint)
ax.plot([], [], "ko", ms=4, mfc="none", label="truth of the simulated bench")
ax.set(yscale="log", ylim=(1e-5, 2), xlabel="level", ylabel="light of a pixel (star of magnitude 0 = 1)")
ax.set_title("brightness and curve of each colour")
ax.legend()

ax = axes[1, 0]
magnitudes = np.arange(-1.0, 12.1, 0.5)
for dithering, tint in (("none", ORANGE), ("spatial", BLUE), ("temporal", GREEN)):
    limits = replace(stimulator, dithering=dithering).limits(magnitudes, positions=60)
    label = dithering + (", one picture" if dithering == "temporal" else "")
    ax.plot(magnitudes, [1e3 * one.brightness_mag for one in limits], color=tint, label=label)
    ax.plot(magnitudes, [one.position_arcsec for one in limits], color=tint, ls="--")
ax.plot([], [], "k-", label="brightness [mmag]")
ax.plot([], [], "k--", label="position [″]")
ax.set(yscale="log", ylim=(1e-3, 1e3), xlabel="magnitude in the tracker's band", ylabel="rms error")
ax.set_title("stars as the display shows them, by dithering")
ax.legend(ncols=2)

ax = axes[1, 1]
stars = load_catalog("hipparcos").brighter_than(6.5)
picture = stimulator.picture(Attitude.from_radec_roll(83.0, -1.0, 0.0), stars.directions(2000.0), stars.v_mag)
image = np.zeros((1024, 1280, 3), np.uint8)
image[picture.pixels[:, 1], picture.pixels[:, 0]] = picture.rgb
ax.imshow(stretch(bench.photograph(image, 0.2, rng)), cmap="gray", vmin=0, vmax=1)
ax.set(title="what the tracker sees: Orion", xlabel="camera column [px]", ylabel="row [px]")
ax.grid(visible=False)

figure.savefig(OUT, dpi=110)
