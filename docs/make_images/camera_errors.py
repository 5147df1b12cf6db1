"""Draws docs/images/camera-errors.png: a calibration residual, lateral colour, the response of pixels, and their sizes.

Run it from the top folder: python docs/make_images/camera_errors.py
"""

from pathlib import Path

import matplotlib as mpl
import numpy as np

from simulator import Scenario
from simulator.build import build_focal_plane
from simulator.optics.lens import Lens
from simulator.optics.psf import psf_of
from simulator.optics.psf_model import PsfModel
from simulator.optics.splat import render_stars
from simulator.study.trials.trial import TrialRunner, solve_frame

mpl.use("Agg")
import matplotlib.pyplot as plt

OUT = Path(__file__).parents[1] / "images" / "camera-errors.png"
BLUE, ORANGE, GREEN, RED = "#0072B2", "#E69F00", "#009E73", "#D55E00"
FLIGHT = {
    "calibration residual 0.03 px": ("optics.calibration_residual.rms_px=0.03",),
    "lateral colour 0.3 px": ("optics.lateral_colour.corner_px=0.3",),
    "decentring 0.05 µm per axis": ("optics.thermal.decentring_um_k=[0.005, 0.005]", "optics.thermal.temperature_c=30"),
    "centroid curve 0.01 px": ("detector.intra_pixel.centroid_curve_px=0.01",),
    "pixel contrast 0.1": ("detector.intra_pixel.contrast=0.1",),
    "faint stars to V = 12": ("sky.faint_magnitude_limit=12",),
    "catalogue 1 mas, 1 mas/yr": (
        "tracker.catalogue_errors.position_mas=1",
        "tracker.catalogue_errors.proper_motion_mas_yr=1",
    ),
    "time tag 0.5 ms": ("detector.time_tag.offset_s=5e-4",),
}
CAMERAS, FRAMES = 4, 8
plt.rcParams.update({"font.size": 8, "figure.constrained_layout.use": True, "axes.grid": True, "grid.color": "#dddddd"})
figure, axes = plt.subplots(2, 2, figsize=(10.0, 7.6))

ax = axes[0, 0]
plane = build_focal_plane(Scenario.load("cubesat_ideal", ["optics.calibration_residual.rms_px=0.05"]))
nodes = np.stack([a.ravel() for a in np.meshgrid(*2 * [np.linspace(20.0, 1003.0, 19)])], axis=1)
moved = plane.displacement.moved(nodes, np.zeros(len(nodes))) - nodes
arrows = ax.quiver(*nodes.T, *moved.T, color=BLUE, angles="xy", scale_units="xy", scale=0.0016, width=0.003)
ax.quiverkey(arrows, 0.86, 1.03, 0.1, "0.1 px", labelpos="E")
ax.set(xlim=(-130, 1153), ylim=(1153, -130), aspect="equal", xlabel="column [px]", ylabel="row [px]")
ax.set_title("calibration residual, 0.05 px rms", loc="left")

ax = axes[0, 1]
plane = build_focal_plane(Scenario.load("cubesat_ideal", ["optics.lateral_colour.corner_px=0.3"]))
b_v = np.linspace(-0.3, 1.9, 200)
wavelength_nm = plane.photometer.effective_wavelength_nm(b_v)
for share, style in ((1.0, "-"), (0.5, "--")):
    at = np.tile(511.5 + share * 512.0, (len(b_v), 2))
    outwards = (plane.displacement.moved(at, wavelength_nm) - at) @ np.full(2, np.sqrt(0.5))
    where = "in the corner" if share == 1.0 else "halfway to the corner"
    ax.plot(b_v, outwards, style, color=RED, label=where)
ax.set(xlabel="B − V of the star", ylabel="outward displacement [px]", title="lateral colour, 0.3 px from F to C")
ax.legend()

ax = axes[1, 0]
phase = np.linspace(-0.5, 0.5, 81)
for sigma, colour in ((0.35, RED), (0.5, ORANGE), (0.9, GREEN)):
    for contrast, style in ((0.0, ":"), (0.3, "-")):
        psf = psf_of(PsfModel(sigma_px=sigma), Lens(1.4, (5.5, 5.5), contrast=contrast))
        images = [render_stars((31, 31), np.array([[15.0 + x, 15.0]]), np.ones(1), [1e6], psf) for x in phase]
        mean = np.array([image.sum(axis=0) @ np.arange(31.0) / image.sum() - 15.0 for image in images]) - phase
        ax.plot(phase, mean, style, color=colour, label=f"σ = {sigma} px" if contrast else None)
ax.set(xlabel="position of the star in the pixel [px]", ylabel="first moment − position [px]")
ax.set_title("pixels with a contrast of 0.3 (dotted: uniform)")
ax.legend()

ax = axes[1, 1]


def errors_arcsec(keys: tuple[str, ...]) -> np.ndarray:
    """Errors about the camera's axes of frames of several cameras, (N, 3)."""
    found = []
    for seed in range(CAMERAS):
        runner = TrialRunner(
            Scenario.load("cubesat_ideal", ["detector.hot_pixel_fraction=0", f"seed={seed + 1}", *keys])
        )
        for index in range(FRAMES):
            frame, truth = runner.renderer.frame(index)
            found.append(truth.attitude_at_tag.rotation_vector_to(solve_frame(runner.tracker, frame).attitude))
    return np.degrees(found) * 3600.0


noise = errors_arcsec(())
sizes = {"noise": noise} | {name: errors_arcsec(keys) - noise for name, keys in FLIGHT.items()}
rms = np.array([np.sqrt(np.mean(turn**2, axis=0)) for turn in sizes.values()])
rows = np.arange(len(rms))
ax.barh(rows - 0.2, np.sqrt(0.5 * (rms[:, 0] ** 2 + rms[:, 1] ** 2)), 0.38, color=BLUE, label="across the boresight")
ax.barh(rows + 0.2, rms[:, 2], 0.38, color=ORANGE, label="about the boresight")
ax.set_yticks(rows, list(sizes))
ax.invert_yaxis()
ax.set(
    xscale="log",
    xlim=(5e-4, 200.0),
    xlabel="rms turn of the attitude [arcsec]",
    title="size of each alone in cubesat_ideal.yaml",
)
ax.legend(loc="lower right")

figure.savefig(OUT, dpi=95)
