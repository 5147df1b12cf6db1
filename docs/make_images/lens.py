"""Draws docs/images/lens.png: projections, distortion, vignetting, a ghost, and what temperature does.

Run it from the top folder: python docs/make_images/lens.py
"""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from scipy.ndimage import gaussian_filter, maximum_filter

from simulator import Renderer, Scenario
from simulator.optics.illumination import Vignetting, relative_illumination
from simulator.optics.thermal import true_camera
from startracker import Camera
from startracker.geometry.distortion import Distortion

mpl.use("Agg")
import matplotlib.pyplot as plt

OUT = Path(__file__).parents[1] / "images" / "lens.png"
BLUE, ORANGE, GREEN, RED = "#0072B2", "#E69F00", "#009E73", "#D55E00"
plt.rcParams.update({"font.size": 8, "figure.constrained_layout.use": True, "axes.grid": True, "grid.color": "#dddddd"})
figure, axes = plt.subplots(2, 3, figsize=(10.5, 6.4))

ax = axes[0, 0]
theta = np.radians(np.linspace(0.1, 88, 200))
rays = np.stack([np.sin(theta), 0 * theta, np.cos(theta)], axis=1)
for name, style, colour in (
    ("pinhole", "-", BLUE),
    ("equidistant", "--", GREEN),
    ("equisolid", ":", RED),
):
    camera = Camera(100.0, 100.0, 0.0, 0.0, 10, 10, projection=name)
    ax.plot(np.degrees(theta), camera.project(rays)[:, 0] / 100, style, color=colour, label=name)
ax.set(ylim=(0, 3), xlabel="angle off the axis [deg]", ylabel="radius / focal length", title="projections")
ax.legend()

ax = axes[0, 1]
camera = Camera.from_fov(60, 1024, 1024, Distortion(k1=-0.25, k2=0.06, p1=0.002, p2=-0.001))
ideal = Camera.from_fov(60, 1024, 1024)
for line in np.linspace(-0.55, 0.55, 12):
    along = np.linspace(-0.55, 0.55, 60)
    for x, y in ((along, np.full(60, line)), (np.full(60, line), along)):
        ax.plot(*camera.project(np.stack([x, y, np.ones(60)], axis=1)).T, color=BLUE, lw=0.8)
        ax.plot(*ideal.project(np.stack([x, y, np.ones(60)], axis=1)).T, color=ORANGE, lw=0.5, ls=":")
ax.set(
    xlabel="column [px]", ylabel="row [px]", title="Brown–Conrady distortion, k1 = −0.25 (dots: none)", aspect="equal"
)
ax.invert_yaxis()
ax.grid(visible=False)

ax = axes[0, 2]
wide = Camera.from_fov(60, 1024, 1024)
degrees = np.linspace(0, 30, 200)
for label, section, colour, style in (
    ("natural: stars", Vignetting(natural=True), BLUE, "-"),
    (
        "and mechanical, 15° to 32°",
        Vignetting(natural=True, mechanical_start_deg=15, mechanical_end_deg=32),
        RED,
        "--",
    ),
):
    ax.plot(degrees, relative_illumination(wide, section, np.radians(degrees)), style, color=colour, label=label)
ax.plot(degrees, np.cos(np.radians(degrees)) ** 4, ":", color=GREEN, label="cos⁴: uniform sky")
ax.set(ylim=(0, 1.05), xlabel="angle off the axis [deg]", ylabel="relative to the axis", title="vignetting")
ax.legend()

ax = axes[1, 0]
ghost = ["pointing.target=Alp CMa", "pointing.target_offset_deg=[3, 2]", "pointing.error_deg=0", "sky.earth=false"]
ghost += ["optics.ghosts=[{flux: 0.02, scale: -0.7, radius_px: 25}]"]
frame, _ = Renderer(Scenario.load("cubesat_ideal", ghost)).frame(0)
image = frame.image.astype(float) - np.median(frame.image)
ax.imshow(np.arcsinh(np.clip(maximum_filter(gaussian_filter(image, 1), 5) - 8, 0, None) / 10), cmap="Greys", vmax=4)
ax.annotate("Sirius", (775, 680), color=BLUE)
ax.annotate("its ghost", (330, 330), color=BLUE)
ax.set(xlabel="column [px]", ylabel="row [px]", title="a ghost of 2 % of the light (exaggerated)")
ax.grid(visible=False)

ax = axes[1, 1]
shifted = true_camera(wide, 30.0, -40.0)
rays = np.stack([np.tan(np.radians(degrees)), 0 * degrees, np.ones(200)], axis=1)
ax.plot(degrees, shifted.project(rays)[:, 0] - wide.project(rays)[:, 0], color=BLUE)
ax.set(xlabel="angle off the axis [deg]", ylabel="shift [px]", title="30 ppm/K, 40 K colder than calibrated")

ax = axes[1, 2]
limb, _ = Renderer(Scenario.load(Path(__file__).parents[2] / "scenarios" / "gallery" / "fisheye.yaml")).frame(0)
image = limb.image.astype(float) - np.median(limb.image)
ax.imshow(np.arcsinh(np.clip(maximum_filter(image, 7) - 15, 0, None) / 10), cmap="Greys", vmax=4)
ax.set(xlabel="column [px]", ylabel="row [px]", title="a 160° fisheye: Orion, Taurus, the Moon")
ax.grid(visible=False)

figure.savefig(OUT, dpi=95)
