"""Renders the sample photograph that ships with the tracker: Orion with a 28 mm lens, in colour.

    python tests/oracle/build_sample_photograph.py

Three frames of the same scene, one through each colour filter, become the channels of a JPEG file with the usual sRGB
curve. The picture is our own and may be used freely.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from simulator import Scenario
from simulator.renderer import Renderer
from startracker.geometry.attitude import Attitude

PHOTOGRAPH = Path(__file__).parents[2] / "startracker" / "sample_photo.jpg"
FILTERS_NM = {"red": (600.0, 45.0), "green": (535.0, 45.0), "blue": (465.0, 40.0)}
"""Centre and standard deviation of each colour filter, as of a common colour camera."""
CAMERA = {
    "sky.magnitude_limit": 9.0,
    "sky.earth": False,
    "sky.background_model": "constant",
    "sky.background_s10": 200.0,
    "optics.focal_length_mm": 28.0,
    "optics.aperture_mm": 10.0,
    "optics.distortion.k1": -0.06,
    "optics.psf.sigma_px": 0.85,
    "optics.vignetting.natural": True,
    "detector.width": 1200,
    "detector.height": 800,
    "detector.pixel_pitch_um": 18.0,
    "detector.exposure_s": 8.0,
    "detector.full_well_e": 40_000.0,
    "detector.hot_pixel_fraction": 1e-5,
    "detector.dark_current_e_s": 2.0,
    "detector.adc_bits": 14,
    "detector.gain_e_per_dn": 2.4,
}
BORESIGHT = Attitude.from_radec_roll(83.0, 1.0, 12.0)


def channel(colour: str, index: int) -> np.ndarray:
    """Signal of one colour filter, 1 at full scale."""
    centre, width = FILTERS_NM[colour]
    wavelength = np.arange(380.0, 721.0, 5.0)
    curve = 0.45 * np.exp(-0.5 * ((wavelength - centre) / width) ** 2)
    with tempfile.NamedTemporaryFile("w", suffix=".csv", delete=False) as file:
        file.write("wavelength_nm,qe\n" + "".join(f"{w:g},{q:.5f}\n" for w, q in zip(wavelength, curve, strict=True)))
    scenario = Scenario.load("cubesat_ideal", CAMERA | {"detector.quantum_efficiency": file.name})
    still = np.zeros(3)
    frame, _ = Renderer(scenario).frame(index, attitude=BORESIGHT, rate_camera_rad_s=still)
    return np.clip((frame.image.astype(float) - frame.offset_dn) / (frame.saturation_dn - frame.offset_dn), 0.0, 1.0)


def main() -> None:
    """Write the photograph."""
    light = np.stack([channel(colour, k) for k, colour in enumerate(FILTERS_NM)], axis=2)
    light = light / (3.0 * np.quantile(light, 0.999))
    srgb = np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055)
    picture = Image.fromarray(np.clip(255.0 * srgb, 0.0, 255.0).round().astype(np.uint8))
    picture.save(PHOTOGRAPH, "JPEG", quality=82, optimize=True)
    print(PHOTOGRAPH, PHOTOGRAPH.stat().st_size)


if __name__ == "__main__":
    main()
