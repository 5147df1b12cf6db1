"""Draw `docs/images/calibration_in_flight.png`: convergence of the calibration in the sequence `thermal`.

Run ``python docs/make_images/calibration_in_flight.py``; it takes some minutes.
"""

from pathlib import Path

import matplotlib as mpl
import numpy as np

from simulator import Scenario
from simulator.study.sequence.calibration_plots import draw_parameter
from simulator.study.sequence.run import run_sequence

mpl.use("Agg")
import matplotlib.pyplot as plt

OUT = Path(__file__).parents[1] / "images" / "calibration_in_flight.png"
BLUE, ORANGE = "#0072B2", "#D55E00"
PARAMETERS = {
    "focal_length_ppm": "focal length",
    "principal_point_x_px": "principal point, columns (1 µm = 0.18 px)",
    "principal_point_y_px": "principal point, rows",
    "psf_width_px": "width of star images",
}


def draw_axis(ax, columns, axis, title):
    """Error about an axis: calibrated in flight, and every frame solved with the camera of the ground."""
    t = columns["elapsed_s"]
    ground, error = columns[f"single_error_{axis}_deg"] * 3600.0, columns[f"error_{axis}_deg"] * 3600.0
    sigma = columns[f"sigma_{axis}_deg"] * 3600.0
    ax.fill_between(t, -3.0 * sigma, 3.0 * sigma, color=BLUE, alpha=0.13, lw=0, label="±3σ")
    ax.plot(t, ground, ".", color=ORANGE, ms=2, label="camera of the ground, single frames")
    ax.plot(t, error, "-", color=BLUE, lw=1, label="calibrated in flight")
    reach = float(np.nanpercentile(np.abs(np.concatenate([ground, 3.0 * sigma[len(t) // 10 :]])), 99))
    ax.set(title=title, xlabel="time [s]", ylabel="error [″]", xlim=(t[0], t[-1]), ylim=(-1.15 * reach, 1.6 * reach))
    ax.legend(loc="upper right", ncols=3, fontsize=7)


def draw(columns):
    """The figure."""
    plt.rcParams.update({"font.size": 8, "figure.constrained_layout.use": True, "axes.grid": True})
    plt.rcParams.update({"grid.color": "#dddddd", "legend.fontsize": 7})
    figure, axes = plt.subplots(3, 2, figsize=(10.5, 8.4))
    for ax, (name, title) in zip(axes.flat, PARAMETERS.items(), strict=False):
        draw_parameter(ax, columns, name)
        ax.set_title(title)
    draw_axis(axes[2, 0], columns, "cross_y", "attitude across the boresight, about y (the decentring)")
    draw_axis(axes[2, 1], columns, "about_boresight", "attitude about the boresight")
    return figure


if __name__ == "__main__":
    draw(run_sequence(Scenario.load("thermal"), single=True).columns).savefig(OUT, dpi=130)
