"""Draws docs/images/detector.png: hot pixels, protons, a blooming star, transfer trails, a photon-transfer curve.

Run it from the top folder: python docs/make_images/detector.py
"""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from scipy.special import erf

from simulator.build import detector_parameters
from simulator.detector import build_fixed_pattern, detect
from simulator.detector.cosmic_rays import draw_cosmic_rays
from simulator.detector.photon_transfer import photon_transfer
from simulator.randomness import stream
from simulator.scenario.schema import DetectorSection

mpl.use("Agg")
import matplotlib.pyplot as plt

OUT = Path(__file__).parents[1] / "images" / "detector.png"
TC211 = {
    "kind": "ccd_frame_transfer",
    "width": 192,
    "height": 165,
    "pixel_pitch_um": (13.75, 16.0),
    "exposure_s": 0.2,
    "temperature_c": 25.0,
    "full_well_e": 150_000.0,
    "read_noise_e": 12.0,
    "offset_dn": 100.0,
    "gain_e_per_dn": 10.0,
    "adc_bits": 14,
}
rng = np.random.default_rng(3)


def star_field(shape, stars, sigma_px=0.8, sky_e=20.0):
    """Mean electrons of Gaussian stars (x, y, electrons)."""
    image = np.full(shape, sky_e)
    y, x = np.arange(shape[0]), np.arange(shape[1])

    def share(pixel, centre):
        edge = (pixel - centre) / (np.sqrt(2) * sigma_px)
        half = 0.5 / (np.sqrt(2) * sigma_px)
        return 0.5 * (erf(edge + half) - erf(edge - half))

    for sx, sy, electrons in stars:
        image += electrons * np.outer(share(y, sy), share(x, sx))
    return image


def expose(mean, trial=0, seed=2, **keys):
    section = DetectorSection(**(TC211 | keys))
    device = detector_parameters(section)
    pattern = build_fixed_pattern(device, seed)
    return detect(mean, device, pattern, lambda name: stream(seed, name, trial), exposure_s=section.exposure_s)


field = [(rng.uniform(0, 192), rng.uniform(0, 165), 10 ** rng.uniform(3.2, 4.6)) for _ in range(14)]
sky = star_field((165, 192), field)
figure, axes = plt.subplots(2, 3, figsize=(15, 9.4), layout="constrained")


def show(axis, frame, title, top, window=(0, 192, 0, 165)):
    shown = axis.imshow(frame, cmap="gray", norm=mpl.colors.AsinhNorm(20.0, 95.0, top), interpolation="nearest")
    axis.set_xlim(window[0] - 0.5, window[1] - 0.5)
    axis.set_ylim(window[3] - 0.5, window[2] - 0.5)
    axis.set_title(title, fontsize=10.5)
    axis.set_xlabel("column")
    axis.set_ylabel("row")
    figure.colorbar(shown, ax=axis, label="DN", shrink=0.8)


defects = {
    "hot_pixel_fraction": 2e-3,
    "hot_pixel_dark_e_s": 30_000.0,
    "hot_columns": 2,
    "hot_column_dark_e_s": 4000.0,
    "dead_columns": 1,
    "dead_pixel_fraction": 5e-4,
}
dark = {"dark_current_e_s": 1500.0, "dsnu": 0.2}
show(axes[0, 0], expose(sky, **dark, **defects).image, "Hot and dead pixels and columns", 1500)
rays = {"rate_cm2_s": 1100.0, "depth_um": 15.0}
show(
    axes[0, 1],
    expose(sky, cosmic_rays=rays).image,
    "TC211, 0.2 s, South Atlantic Anomaly:\nmean of 15 protons per frame (circles)",
    1500,
    (0, 132, 95, 165),
)
tracks = draw_cosmic_rays(
    detector_parameters(DetectorSection(**TC211, cosmic_rays=rays)), 0.2, stream(2, "cosmic_rays", 0)
)
axes[0, 1].plot(*tracks.start_px.T, "o", ms=11, mfc="none", mec="tab:orange", mew=0.9)

sirius = star_field((165, 192), [(96.3, 82.4, 2.0e7), *field], sigma_px=1.0)
show(
    axes[0, 2],
    expose(sirius, antiblooming=0.0).image,
    "Blooming: a star of 2·10⁷ e⁻, such as Sirius,\nand a full well of 150,000 e⁻",
    15_500,
)

trails = {"cti_parallel": 2e-3, "cti_serial": 5e-4, "read_noise_e": 3.0, "gain_e_per_dn": 2.0}
grid = [(x, y, 4e4) for x in range(3, 192, 12) for y in range(5, 165, 12)]
show(
    axes[1, 0],
    expose(star_field((165, 192), grid, sigma_px=0.4), **trails).image,
    "The corner far from the output node (0, 0):\nc = 2·10⁻³ in columns, 5·10⁻⁴ in the register",
    6000,
    (140, 192, 120, 165),
)

axis = axes[1, 1]
cti = 4e-4
flat_line = np.full((165, 192), 0.0)
flat_line[120, 96] = 1e5
quiet = {"shot_noise": False, "read_noise_e": 0.0, "adc_bits": None, "gain_e_per_dn": 1.0, "offset_dn": 0.0}
read = expose(flat_line, cti_parallel=cti, **quiet).image[118:127, 96]
line = np.zeros(165)
line[120] = 1e5
arrived = []
for _ in range(127):  # one clock after the other
    moving = line * (1 - cti)
    line = line - moving
    arrived.append(moving[0])
    line[:-1] += moving[1:]
axis.semilogy(range(-2, 7), read.clip(1e-9), "o", label="boresight")
axis.semilogy(range(-2, 7), np.array(arrived)[118:127].clip(1e-9), "k+", ms=12, label="clock by clock")
axis.set(ylim=(1e-7, 3e5), xlabel="pixels late", ylabel="electrons")
axis.set_title("One packet of 10⁵ e⁻ after 121 transfers,\nc = 4·10⁻⁴", fontsize=11)
axis.axhline(1e5 * (1 - cti) ** 121, color="0.7", lw=0.8)
axis.text(3.0, 1.3e4, "(1 − c)¹²¹ remains", fontsize=10)
axis.legend()

flats = []
levels = np.geomspace(300.0, 300_000.0, 22)
for k, level in enumerate(levels):
    light = np.full((165, 192), level)
    flats.append(tuple(expose(light, trial=2 * k + i, prnu=0.01).image for i in (0, 1)))
bias = tuple(expose(np.zeros((165, 192)), trial=900 + i, exposure_s=1e-9).image for i in (0, 1))
curve = photon_transfer(flats, bias)
axis = axes[1, 2]
gain, noise = curve.gain_e_per_dn, curve.read_noise_e
axis.loglog(curve.signal_dn[curve.used], np.sqrt(curve.variance_dn2[curve.used]), "o", label="pairs of flats")
axis.loglog(curve.signal_dn[~curve.used], np.sqrt(curve.variance_dn2[~curve.used]), "o", mfc="none", label="saturated")
s = np.geomspace(20, 2e4)
axis.loglog(s, np.sqrt(s / gain.value + (noise.value / gain.value) ** 2), "k-", lw=1, label="fit")
axis.loglog(s, 0.01 * s, ":", color="0.5", label="PRNU of 1 % (removed by the difference)")
axis.set(xlabel="signal above the bias, DN", ylabel="noise, DN", ylim=(0.5, 1000))
axis.set_title(
    f"Photon transfer: {gain.value:.3f} ± {gain.error:.3f} e⁻/DN (true 10),\n"
    f"read noise {noise.value:.2f} ± {noise.error:.2f} e⁻ (true 12)",
    fontsize=11,
)
axis.legend(loc="upper left", fontsize=9)
figure.savefig(OUT, dpi=80)
