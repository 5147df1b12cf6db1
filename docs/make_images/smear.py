"""Picture of smear: a fast slew, a roll, jitter, a rolling shutter, frame transfer; run from anywhere, no arguments."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from simulator.optics.jitter import Jitter, draw_jitter, load_spectrum
from simulator.optics.psf import build_psf
from simulator.optics.psf_model import PsfModel
from simulator.optics.shutter import frame_transfer_smear, rolling_paths
from simulator.optics.smear import star_paths
from simulator.optics.splat import render_stars
from simulator.randomness import stream
from startracker.geometry.camera import Camera

OUTPUT = Path(__file__).parents[1] / "images" / "smear.png"
FloatArray = NDArray[np.float64]

CAMERA = Camera.from_fov(12.0, 360, 360)
PSF = build_psf(PsfModel(model="gaussian", sigma_px=1.1), 2.0, (10.0, 10.0))
EXPOSURE_S = 0.2
READ_NOISE_E = 8.0


def stars() -> tuple[FloatArray, FloatArray]:
    """Directions in camera axes and electrons of a made-up field: steep counts, 4 electrons to 4 magnitudes."""
    rng = np.random.default_rng(12)
    xy = rng.uniform(-60.0, 420.0, (130, 2))
    magnitude = 6.0 + np.log10(rng.uniform(0.004, 1.0, 130)) / 0.5
    return CAMERA.unproject(xy), 6e3 * 10.0 ** (-0.4 * (magnitude - 6.0))


def show(axes: Axes, image: FloatArray, title: str, top: float = 5.0) -> None:
    noisy = stream(1, "picture").normal(image, np.sqrt(image + READ_NOISE_E**2))
    axes.imshow(np.arcsinh(noisy / 25.0), cmap="gray", vmin=-0.4, vmax=top, interpolation="nearest")
    axes.set_title(title, fontsize=10)
    axes.set_xticks([0, 180, 359])
    axes.set_yticks([0, 180, 359])
    axes.tick_params(labelsize=7)


def main() -> None:
    directions, electrons = stars()
    bright = electrons * 6.0
    arcsec = np.degrees(CAMERA.pixel_rad) * 3600.0

    def exposed(rate_deg_s: tuple[float, float, float], **more: object) -> FloatArray:
        xy, weights = star_paths(CAMERA, directions, np.radians(rate_deg_s), EXPOSURE_S, PSF.feature_px, **more)
        return render_stars((360, 360), xy, weights, bright, PSF)

    def rolled(rate_deg_s: tuple[float, float, float], line_time_s: float) -> FloatArray:
        rate = np.radians(rate_deg_s)
        xy, weights, longer = rolling_paths(CAMERA, directions, rate, EXPOSURE_S, line_time_s, PSF.feature_px)
        return render_stars((360, 360), xy, weights, bright * longer, PSF)

    section = Jitter(rms_arcsec=(6.0 * arcsec, 6.0 * arcsec, 0.0), psd="lorentz", corner_hz=6.0)
    path = draw_jitter(section, load_spectrum(section), stream(3, "jitter", 0))
    assert path is not None
    still = exposed((0.0, 0.0, 0.0))
    few = np.argsort(bright)[-40:]
    xy, weights = star_paths(CAMERA, directions[few], [0, 0, 0], EXPOSURE_S, PSF.feature_px)
    strong = render_stars((360, 360), xy, weights, 40.0 * bright[few], PSF) + 20.0

    figure, panels = plt.subplots(2, 3, figsize=(11.0, 7.6), layout="constrained")
    show(panels[0, 0], still, "at rest")
    show(panels[0, 1], exposed((3.0, 9.5, 0.0)), "10°/s across the boresight, 0.2 s")
    show(panels[0, 2], exposed((0.0, 0.0, 60.0)), "60°/s about the boresight: arcs")
    show(
        panels[1, 0],
        exposed((0, 0, 0), jitter=path.centred(EXPOSURE_S)),
        "jitter, 6 px rms, Lorentz, 6 Hz (closer)",
        7.0,
    )
    panels[1, 0].set(xlim=(119.5, 219.5), ylim=(199.5, 99.5), xticks=[120, 219], yticks=[100, 199])
    show(panels[1, 1], rolled((0.0, 0.8, 0.0), 2e-3), "rolling shutter, 2 ms per line, 0.8°/s")
    panels[1, 1].contour(exposed((0.0, 0.8, 0.0)), levels=[150.0], colors="tab:orange", linewidths=0.7)
    panels[1, 1].set_xlabel("orange: where a global shutter sees them", fontsize=8)
    smear = frame_transfer_smear(strong, EXPOSURE_S, 20e-6, "up", "after")
    show(panels[1, 2], strong + smear, "frame transfer, 20 µs per line, upwards")
    OUTPUT.parent.mkdir(exist_ok=True)
    figure.savefig(OUTPUT, dpi=80)


if __name__ == "__main__":
    main()
