"""Draw `docs/images/colours.png`: synthetic colours of the spectra beside the published ones.

Run ``python docs/make_images/colours.py`` from the repository's root.
"""

from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from simulator.sky.library import ANCHORS_DWARF, ANCHORS_GIANT, ANCHORS_LATE, published_colours, synthetic_colours
from simulator.sky.spectra import blackbody, colour_sequence

OUT = Path(__file__).parents[1] / "images" / "colours.png"
W = np.arange(295.0, 1200.0, 0.5)
BLUE, ORANGE, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#7A7A7A"  # Okabe & Ito 2008
NAMES = ("u_b", "b_v", "v_r", "v_i")
LABELS = {"u_b": "U − B, mag", "v_r": "V − R, mag", "v_i": "V − I, mag"}


def synthetic(spectrum, b_v, giant):
    photons = spectrum(W, b_v, giant)
    return dict(zip(NAMES, np.array([synthetic_colours(W, row / W) for row in photons]).T, strict=True))


def panel(axes, name, lines):
    for colours, style in lines:
        axes.plot(colours["b_v"], colours[name], **style)
    for kind, anchors, colour, label in (
        ("dwarfs", ANCHORS_DWARF, BLUE, "dwarfs (Mamajek 2018)"),
        ("giants", ANCHORS_GIANT + ANCHORS_LATE, ORANGE, "giants (BSC5, Hipparcos)"),
    ):
        table = {t: c for t, c in published_colours(kind).items() if t not in {"M6V", "M5.5V"}}
        for imposed in (True, False):
            rows = [c for t, c in table.items() if (t in anchors) == imposed]
            axes.plot(
                [c["b_v"] for c in rows],
                [c[name] for c in rows],
                "o" if kind == "dwarfs" else "s",
                ms=4.5,
                mfc=colour if imposed else "white",
                mec=colour,
                mew=1.1,
                label=f"published {label}, {'imposed' if imposed else 'not imposed'}",
                zorder=3,
            )
    axes.set_ylabel(LABELS[name])
    axes.set_xlabel("B − V, mag")
    axes.grid(alpha=0.25, lw=0.6)
    if name == "v_r":
        axes.plot(
            [1.055, 1.190, 1.345, 1.515],
            [0.532, 0.609, 0.700, 0.796],
            "^",
            ms=6,
            mfc="white",
            mec="black",
            mew=1.1,
            label="giants of Alonso et al. 1999",
            zorder=4,
        )
        axes.legend(*([part[-1:] for part in axes.get_legend_handles_labels()]), frameon=False, loc="upper left")
    if name == "u_b":
        axes.invert_yaxis()


def main():
    mpl.rcParams.update({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False})
    dwarfs, giants = np.linspace(-0.307, 1.874, 110), np.linspace(-0.307, 1.51, 90)
    late = np.linspace(10.0, 16.0, 31)
    lines = [
        (synthetic(blackbody, dwarfs, 0.0), {"color": GREY, "ls": ":", "lw": 1.6, "label": "synthetic, black bodies"}),
        (synthetic(colour_sequence, dwarfs, 0.0), {"color": BLUE, "lw": 1.5, "label": "synthetic, dwarfs"}),
        (synthetic(colour_sequence, giants, 1.0), {"color": ORANGE, "lw": 1.5, "label": "synthetic, giants to K5"}),
        (
            synthetic(colour_sequence, np.full(31, 1.6), late),
            {"color": ORANGE, "lw": 1.5, "ls": "--", "label": "synthetic, giants M0 to M6"},
        ),
    ]
    figure, grid = plt.subplots(2, 2, figsize=(10.5, 8.2), layout="constrained")
    for axes, name in zip((grid[0, 0], grid[0, 1], grid[1, 0]), ("u_b", "v_r", "v_i"), strict=True):
        panel(axes, name, lines)
    handles, labels = grid[0, 0].get_legend_handles_labels()

    axes = grid[1, 1]
    types = (("A0V", 0.0, 0.0, BLUE, "-"), ("G2V", 0.65, 0.0, GREEN, "-"), ("K5III", 1.51, 1.0, ORANGE, "-"))
    for label, b_v, giant, colour, style in (*types, ("M4III", 1.62, 14.0, "#882255", "-")):
        shown = W > 300
        photons = colour_sequence(W, np.array([b_v]), giant)[0] / 10.0
        black = blackbody(W, np.array([b_v]))[0] / 10.0
        axes.plot(W[shown], photons[shown], color=colour, ls=style, lw=1.2, label=label)
        axes.plot(W[shown], black[shown], color=colour, ls=":", lw=1.0)
    published = {360: 756, 438: 1393, 545: 995.5, 641: 702, 798: 452}
    at, flux = list(published), list(published.values())
    axes.plot(at, flux, "kD", ms=5, mfc="white", label="A0V, Bessell et al. 1998", zorder=4)
    axes.plot([], [], color=GREY, ls=":", label="black body of the same B − V")
    axes.set(
        xlim=(300, 1050),
        ylim=(8, 12000),
        yscale="log",
        xlabel="wavelength, nm",
        ylabel="photons of V = 0, cm⁻² s⁻¹ Å⁻¹",
    )
    axes.grid(alpha=0.25, lw=0.6)
    axes.legend(frameon=False, ncols=2, loc="lower right")
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False)
    OUT.parent.mkdir(exist_ok=True)
    figure.savefig(OUT, dpi=130)


if __name__ == "__main__":
    main()
