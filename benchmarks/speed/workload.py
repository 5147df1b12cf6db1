"""What the speed benchmarks work on: skies of any number of stars, frames of any size, always the same ones.

A sky is even: stars at random all over the sphere, as many to a field as asked for, all bright enough to be found
(V = 2 to 6, growing in number as 10^(0.5 V)). The camera is that of `scenarios/cubesat_ideal.yaml`, its focal length in
proportion to the image's side, so that the field and the stars in it stay the same.
"""

from __future__ import annotations

import math
from functools import cache, partial
from pathlib import Path

import numpy as np

from simulator import Renderer, Scenario
from simulator.detector.chain import Readout
from simulator.randomness import stream
from simulator.scene import Scene
from startracker.catalog import CATALOGS, StarCatalog
from startracker.geometry.attitude import direction_to_radec

SIZES = (512, 1024, 2048)
STARS = (10, 100, 1000)
CUBESAT = Path(__file__).resolve().parents[2] / "scenarios" / "cubesat_ideal.yaml"
PLAIN = (
    "detector.dark_current_e_s=0",
    "detector.dsnu=0",
    "detector.prnu=0",
    "detector.hot_pixel_fraction=0",
    "detector.read_noise_e=10",
    "optics.distortion={}",
    "pointing.rate_deg_s=[0, 0, 0]",
)
"""A Gaussian star image with photon noise, read noise and 12 bits, nothing else."""
_FOCAL_MM, _SIDE_PX, _PITCH_MM = 25.0, 1024, 5.5e-3
_BRIGHTEST, _FAINTEST = 2.0, 6.0


def field_sr() -> float:
    """Solid angle of the square field (Khadjavi 1968)."""
    a2 = (0.5 * _SIDE_PX * _PITCH_MM / _FOCAL_MM) ** 2
    return 4.0 * math.atan(a2 / math.sqrt(1.0 + 2.0 * a2))


def even_sky(in_field: int) -> StarCatalog:
    """Catalogue with so many stars to the field on average."""
    n = round(in_field * 4.0 * math.pi / field_sr())
    rng = np.random.default_rng(in_field)
    ra, dec = direction_to_radec(rng.normal(size=(n, 3)))
    low, high = 10.0 ** (0.5 * _BRIGHTEST), 10.0 ** (0.5 * _FAINTEST)
    nothing, text = np.zeros(n), np.full(n, "")
    return StarCatalog(
        name=f"even-{in_field}",
        epoch_jyear=2016.0,
        id=np.arange(1, n + 1),
        ra_rad=ra,
        dec_rad=dec,
        pm_ra_rad_yr=nothing,
        pm_dec_rad_yr=nothing,
        parallax_rad=nothing,
        radial_velocity_km_s=nothing,
        v_mag=2.0 * np.log10(rng.uniform(low, high, n)),
        b_v=rng.uniform(0.0, 1.5, n),
        spectral_type=text,
        star_name=text,
    )


def even_scenario(size: int, in_field: int, *more: str) -> Scenario:
    """`cubesat_ideal.yaml` with another size and an even sky, lost in space."""
    name = f"even-{in_field}"
    CATALOGS.setdefault(name, partial(even_sky, in_field))
    return Scenario.load(
        CUBESAT,
        [
            f"detector.width={size}",
            f"detector.height={size}",
            f"optics.focal_length_mm={_FOCAL_MM * size / _SIDE_PX}",
            f"sky.catalog={name}",
            f"tracker.catalog={name}",
            "tracker.prior=false",
            *more,
        ],
    )


def small_scenario() -> Scenario:
    """`cubesat_ideal.yaml` on 512 × 512 pixels with a 16 mm f/1.4 lens, 10 degrees across, lost in space."""
    lens = ("optics.focal_length_mm=16.1", "optics.aperture_mm=11.5")
    return Scenario.load(CUBESAT, ("detector.width=512", "detector.height=512", "tracker.prior=false", *lens))


@cache
def renderer(scenario: Scenario) -> Renderer:
    """Kept, as building one costs seconds."""
    return Renderer(scenario)


def scene(made: Renderer, index: int) -> Scene:
    """Scene of a trial."""
    return made.scene(index)


def expose(made: Renderer, what: Scene, index: int) -> Readout:
    """Frame of a scene: focal plane and detector."""
    light = made.expose(what)
    streams = partial(_stream, made.scenario.seed, index)
    return made.detector.expose(light.mean_e, made.exposure_s, streams, keep_charge=False)


def _stream(seed: int, trial: int, stage: str) -> np.random.Generator:
    return stream(seed, stage, trial)
