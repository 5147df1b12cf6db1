"""Draw docs/images/heads.png: errors of the heads of two_heads.yaml about the body axes, and fused.

python docs/make_images/heads.py
"""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure

from simulator import Scenario
from simulator.study.sequence.heads_plots import heads_panels
from simulator.study.sequence.run import run_sequence
from simulator.study.style import STYLE
from startracker.images.picture import figure_bytes

OUT = Path(__file__).resolve().parents[1] / "images" / "heads.png"


def main() -> None:
    scenario = Scenario.load("two_heads")
    panels = heads_panels(run_sequence(scenario).columns, [head.name for head in scenario.heads])["Heads"]
    with mpl.rc_context({**STYLE, "figure.facecolor": "white"}):
        figure = Figure(figsize=(9.0, 5.6), layout="constrained")
        for ax, panel in zip(figure.subplots(2, 2).ravel(), panels, strict=True):
            panel.draw(ax)
            ax.set_title(panel.title)
        OUT.write_bytes(figure_bytes(figure, dpi=100))


if __name__ == "__main__":
    main()
