"""Draw `docs/images/jitter.png`: one realisation of a drift with vibration by wheels, over the frames of a sequence.

Run ``python docs/make_images/jitter.py``; it takes some seconds.
"""

import tempfile
from pathlib import Path

import matplotlib as mpl
import numpy as np
from scipy.signal import periodogram, welch

from simulator.optics.jitter import Jitter, draw_jitter, load_spectrum
from simulator.randomness import stream
from startracker.core import ARCSEC_RAD

mpl.use("Agg")
import matplotlib.pyplot as plt

OUT = Path(__file__).parents[1] / "images" / "jitter.png"
POINTS = [(0.01, 500.0), (0.1, 5.0), (1.0, 0.05), (10.0, 5e-4), (29.0, 6e-5), (30.0, 0.01), (60.0, 0.01)]
RMS_ARCSEC, STEP_S, EXPOSURE_S = 100.0, 0.5, 0.2


def spectrum_of(folder):
    """Section and spectrum: a density as 1/f², and a band from 30 to 60 Hz."""
    f = np.geomspace(0.01, 60.0, 4000)
    density = np.exp(np.interp(np.log(f), *np.log(POINTS).T))
    path = Path(folder) / "wide.csv"
    path.write_text("\n".join(f"{x:.9g},{y:.9g}" for x, y in zip(f, density, strict=True)), encoding="utf-8")
    section = Jitter(rms_arcsec=(RMS_ARCSEC,) * 3, psd="table", table=str(path))
    return section, load_spectrum(section)


def main():
    with tempfile.TemporaryDirectory() as folder:
        section, spectrum = spectrum_of(folder)
    path = draw_jitter(section, spectrum, stream(3, "jitter", 0), over_sequence=True)
    frames = np.array([path.shifted(k * STEP_S).mean(EXPOSURE_S) for k in range(4096)]) / ARCSEC_RAD
    slow_hz, slow = welch(frames, 1.0 / STEP_S, nperseg=512, axis=0, detrend=False)
    within = (np.arange(100) - 49.5) * 5e-3
    fast = []
    for k in range(200):
        angles = path.shifted(0.7 * k).at(within) / ARCSEC_RAD
        fast_hz, power = periodogram(angles, 200.0, window="hann", detrend="linear", axis=0)
        fast.append(power.mean(axis=1))

    figure, (left, right) = plt.subplots(1, 2, figsize=(9.5, 3.6), layout="constrained")
    f = np.geomspace(0.01, 60.0, 2000)
    left.loglog(f, spectrum.per_hz(f) * RMS_ARCSEC**2, color="#1b1f24", linewidth=1.0, label="asked for")
    left.loglog(
        slow_hz[4:-8], slow.mean(axis=1)[4:-8], ".", color="#0072b2", markersize=3, label="over frames, up to 1 Hz"
    )
    shown = (fast_hz > 8.0) & (fast_hz < 59.0)
    left.loglog(
        fast_hz[shown], np.mean(fast, axis=0)[shown], ".", color="#c24a00", markersize=4, label="within exposures"
    )
    left.set(xlabel="frequency [Hz]", ylabel="density [arcsec²/Hz]", ylim=(1e-3, 1e6), title="Power spectrum")
    left.legend(frameon=False)
    t = STEP_S * np.arange(240)
    right.plot(t, frames[:240, 0], ".-", color="#0072b2", markersize=3, linewidth=0.6)
    right.set(xlabel="time [s]", ylabel="mean angle of each exposure [″]", title="Frames of the same realisation")
    for axes in (left, right):
        axes.grid(color="#dddddd", linewidth=0.5)
    figure.savefig(OUT, dpi=110)


if __name__ == "__main__":
    main()
