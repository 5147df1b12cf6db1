"""Draw docs/images/satellites.png: a frame with a constellation, and what satellites in the field do to the tracker.

The curves are those of satellites-prior.json and satellites-lost.json beside this file, by
python -m benchmarks.satellites [--set tracker.prior=false] --json FILE
"""

from __future__ import annotations

import json
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from simulator.checks import load_scenario
from simulator.renderer import Renderer

HERE = Path(__file__).resolve().parent
AT_S = 2010.0
BLUE, ORANGE, AMBER = "#0072B2", "#D55E00", "#FFB547"


def draw_frame(axes: plt.Axes) -> None:
    frame, truth = Renderer(load_scenario("constellation", ["detector.exposure_s=1"])).frame(0, at_s=AT_S)
    image = np.asarray(frame.image, dtype=float)
    level, noise = np.median(image), np.std(image[image < np.quantile(image, 0.9)])
    axes.imshow(np.arcsinh((image - level) / (3.0 * noise)), cmap="gray", vmin=-0.3, vmax=4.0)
    sources = truth.sources
    for k in np.flatnonzero(sources.kind == "satellite"):
        x, y = sources.image_xy[k]
        axes.plot(x, y, "o", ms=16, mfc="none", mec=AMBER, mew=1.0)
        axes.annotate(
            f"{sources.name[k]}, V {sources.v_mag[k]:.1f}",
            (x, y), (12, -14), textcoords="offset points", color=AMBER, fontsize=8,
        )  # fmt: skip
    axes.set(xlim=(150, 700), ylim=(1023, 100), title="Five satellites in one second", xlabel="column", ylabel="row")


def draw_curves(top: plt.Axes, bottom: plt.Axes) -> None:
    for name, label, colour in (("prior", "with a prior of 1°", BLUE), ("lost", "lost in space", ORANGE)):
        rows = json.loads((HERE / f"satellites-{name}.json").read_text(encoding="utf-8"))
        count = np.array([row["satellites"] for row in rows])
        solved = np.array([row["solved"] / row["trials"] for row in rows]) * 100.0
        low, high = 100.0 * np.array([row["solved_interval95"] for row in rows]).T
        top.errorbar(count, solved, (solved - low, high - solved), fmt="o-", color=colour, ms=4, capsize=2, label=label)
        bottom.plot(count, [row["matched_mean"] for row in rows], "o-", color=colour, ms=4)
    for axes in (top, bottom):
        axes.set_xscale("symlog", linthresh=1.0)
        axes.set_xticks([0, 1, 2, 5, 10, 20, 50, 100], ["0", "1", "2", "5", "10", "20", "50", "100"])
        axes.grid(alpha=0.3)
    top.set(ylabel="frames solved, %", ylim=(0, 105), title="200 frames of cubesat each; none wrong")
    top.legend(loc="lower left", fontsize=8, frameon=False)
    bottom.set(ylabel="stars identified, mean", ylim=(0, 33), xlabel="satellites in the field, V 1 to 6, 0.02 to 2°/s")


def main() -> None:
    figure = plt.figure(figsize=(11.0, 6.2), layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=[1.0, 1.15])
    draw_frame(figure.add_subplot(grid[:, 0]))
    draw_curves(figure.add_subplot(grid[0, 1]), figure.add_subplot(grid[1, 1]))
    figure.savefig(HERE.parent / "images" / "satellites.png", dpi=100)


if __name__ == "__main__":
    main()
