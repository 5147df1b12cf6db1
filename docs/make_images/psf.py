"""Draw docs/images/psf.png: the models of the point-spread function.

python docs/make_images/psf.py
"""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from simulator.optics.psf import Psf
from simulator.optics.psf_model import FieldAberrations, PsfModel, Zernike
from simulator.optics.psf_set import build_psf_set
from simulator.optics.splat import render_stars
from simulator.sky.spectra import blackbody

F_NUMBER, PITCH_UM, SIZE = 8.0, 2.0, 41


def weights_of(b_v: np.ndarray, edges_nm: np.ndarray, giant: np.ndarray) -> np.ndarray:
    middles = (edges_nm[1:] + edges_nm[:-1]) / 2
    inside = (middles > 400) & (middles < 900)
    return np.asarray(blackbody(middles, b_v) * inside * np.diff(edges_nm))


def star(psf: Psf, offset: float = 0.0) -> np.ndarray:
    xy = np.array([[SIZE // 2 + offset, SIZE // 2 + offset]])
    return render_stars((SIZE, SIZE), xy, np.ones(1), [1e6], psf) / 1e6


def single(obscuration: float = 0.0, b_v: float = 0.6, **keys: object) -> np.ndarray:
    section = PsfModel(**keys)
    stars = build_psf_set(
        section, F_NUMBER, (PITCH_UM, PITCH_UM), (400, 400), obscuration=obscuration, weights_of=weights_of
    )
    return star(stars.psf(b_v))


def main() -> None:
    panels = {
        "Airy, λN = 2.4 px": single(model="airy"),
        "obscuration 0.5": single(0.5, model="airy"),
        "defocus 0.4 waves rms": single(model="diffraction", zernike_waves=Zernike(defocus=0.4)),
        "coma 0.25 waves rms": single(model="diffraction", zernike_waves=Zernike(coma_x=0.25)),
        "astigmatism 0.2, defocus 0.1": single(
            model="diffraction", zernike_waves=Zernike(astigmatism=0.2, defocus=0.1)
        ),
        "polychromatic, B−V = −0.2": single(model="airy", polychromatic=True, b_v=-0.2),
        "polychromatic, B−V = 1.9": single(model="airy", polychromatic=True, b_v=1.9),
    }
    figure, axes = plt.subplots(2, 4, figsize=(12, 6.6), constrained_layout=True)
    for axis, (title, image) in zip(axes.flat, panels.items(), strict=False):
        axis.imshow(np.log10(image / image.max() + 1e-5), vmin=-4, vmax=0, cmap="magma")
        axis.set_title(title, fontsize=10)
    section = PsfModel(
        model="diffraction", field=FieldAberrations(coma_waves=0.3, astigmatism_waves=0.15, curvature_waves=0.15)
    )
    stars = build_psf_set(section, F_NUMBER, (PITCH_UM, PITCH_UM), (400, 400))
    grid = np.linspace(0.0, 399.0, 5)
    field = np.zeros((5 * SIZE, 5 * SIZE))
    for j, y in enumerate(grid):
        for i, x in enumerate(grid):
            image = star(stars.psf(xy=(float(x), float(y))))
            field[j * SIZE : (j + 1) * SIZE, i * SIZE : (i + 1) * SIZE] = image / image.max()
    shown = axes.flat[7].imshow(np.log10(field + 1e-5), vmin=-4, vmax=0, cmap="magma")
    axes.flat[7].set_title("over the field, to the corners", fontsize=10)
    for axis in axes.flat:
        axis.set_xticks([])
        axis.set_yticks([])
    figure.colorbar(shown, ax=axes, label="log₁₀ of the value relative to the brightest pixel", shrink=0.8)
    path = Path(__file__).parents[1] / "images" / "psf.png"
    figure.savefig(path, dpi=100)


if __name__ == "__main__":
    main()
