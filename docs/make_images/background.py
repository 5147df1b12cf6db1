"""Pictures of the sky background, the Moon with its phase and the Earth's limb; run from anywhere, no arguments."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from numpy.typing import NDArray

from simulator import Scenario
from simulator.renderer import Renderer
from simulator.scene import Scene
from simulator.sky.background import ECLIPTIC, sky_brightness_s10
from simulator.sky.parameters import Sky
from startracker.geometry.attitude import Attitude, direction_to_radec, radec_to_direction

ROOT = Path(__file__).parents[2]
IMAGES = ROOT / "docs" / "images"
FloatArray = NDArray[np.float64]


def scene_at(renderer: Renderer, t_s: float) -> Scene:
    return renderer.scene(0, at_s=t_s)


def looking_at(direction: FloatArray, roll_deg: float, shift_deg: tuple[float, float] = (0.0, 0.0)) -> Attitude:
    ra, dec = np.degrees(direction_to_radec(direction))
    return Attitude.from_radec_roll(float(ra) + shift_deg[0], float(dec) + shift_deg[1], roll_deg)


def body(scene: Scene, name: str) -> FloatArray:
    return scene.bodies.direction[list(scene.bodies.name).index(name)]


def show(axes: Axes, image: FloatArray, title: str, low: float, high: float) -> None:
    axes.imshow(np.arcsinh((image - low) / (high - low) * 10.0), cmap="gray", vmin=0.0, vmax=np.arcsinh(10.0))
    axes.set_title(title, fontsize=9)
    axes.set_xticks([])
    axes.set_yticks([])


def whole_sky() -> None:
    """All-sky map on the day of the scenario, Sun at the spring equinox."""
    sun = radec_to_direction(0.0, 0.0)
    ra, dec = np.meshgrid(np.radians(np.arange(-180.0, 181.0)), np.radians(np.arange(-90.0, 91.0)))
    directions = radec_to_direction(ra.ravel(), dec.ravel())
    s10 = sky_brightness_s10(directions, sun, Sky(background_model="leinert1998")).reshape(ra.shape)
    figure, axes = plt.subplots(figsize=(8, 4.4), subplot_kw={"projection": "mollweide"}, layout="constrained")
    drawn = axes.pcolormesh(-ra, dec, s10, cmap="magma", norm=LogNorm(50.0, 5000.0), rasterized=True)
    track = radec_to_direction(np.linspace(0, 2 * np.pi, 400), np.zeros(400)) @ ECLIPTIC
    x, y = direction_to_radec(track)
    x = (x + np.pi) % (2 * np.pi) - np.pi
    order = np.argsort(x)
    axes.plot(-x[order], y[order], color="white", lw=0.5, ls=":")
    axes.plot(0.0, 0.0, "o", color="gold", ms=7, mec="k")
    axes.set_xticklabels([f"{h % 24} h" for h in (10, 8, 6, 4, 2, 0, 22, 20, 18, 16, 14)], fontsize=7, color="0.75")
    axes.tick_params(axis="y", labelsize=7)
    axes.grid(alpha=0.2)
    figure.colorbar(drawn, label="stars of V = 10 per square degree (S10)", shrink=0.7, extend="max")
    axes.set_title("Zodiacal light and unresolved starlight, Sun at the spring equinox (dotted: ecliptic)", fontsize=9)
    figure.savefig(IMAGES / "sky-background.png", dpi=100)


def moon_and_planets() -> None:
    """The Moon in the field of the cubesat's camera; the Moon and Venus through longer lenses."""
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(10.5, 3.8), layout="constrained")
    renderer = Renderer(Scenario.load(ROOT / "scenarios" / "cubesat_ideal.yaml"))
    t_s = 6.1 * 86_400.0
    scene = scene_at(renderer, t_s)
    attitude = looking_at(body(scene, "Moon"), 30.0, (2.0, 1.5))
    frame, _ = renderer.frame(0, at_s=t_s, attitude=attitude)
    show(left, frame.image.astype(float), "Moon, 25 mm lens, 12.9° × 12.9°", 55.0, 600.0)
    for axes, name, focal_mm, aperture_mm, t_s in (
        (middle, "Moon", 400, 40, 6.1 * 86_400.0),
        (right, "Venus", 4000, 400, 185.0 * 86_400.0),
    ):
        telescope = Renderer(
            Scenario.load(
                ROOT / "scenarios" / "cubesat_ideal.yaml",
                overrides=[
                    f"optics.focal_length_mm={focal_mm}",
                    f"optics.aperture_mm={aperture_mm}",
                    "detector.width=768" if name == "Moon" else "detector.width=160",
                    "detector.height=768" if name == "Moon" else "detector.height=160",
                    "sky.earth=false",
                    "tracker.prior=false",
                ],
            )
        )
        seen = scene_at(telescope, t_s)
        light = telescope.expose(telescope_scene(telescope, seen, looking_at(body(seen, name), 0.0)))
        axes.imshow(light.mean_e, cmap="gray")
        axes.set_title(f"{name}, {focal_mm / 1000:g} m focal length, north up", fontsize=9)
        axes.set_xticks([])
        axes.set_yticks([])
    figure.savefig(IMAGES / "moon-phase.png", dpi=100)


def telescope_scene(renderer: Renderer, scene: Scene, attitude: Attitude) -> Scene:
    return renderer.scene(0, at_s=scene.t_s, attitude=attitude)


def earth_limb() -> None:
    """The day side's limb across the cubesat's field, and the terminator."""
    renderer = Renderer(
        Scenario.load(
            ROOT / "scenarios" / "cubesat_ideal.yaml", overrides=["detector.exposure_s=1e-6", "tracker.prior=false"]
        )
    )
    figure, axes = plt.subplots(1, 2, figsize=(8.4, 3.9), layout="constrained")
    scene = scene_at(renderer, 1500.0)
    sun = scene.sun_direction
    nadir = -scene.r_km / np.linalg.norm(scene.r_km)
    pole = np.cross(nadir, sun)
    pole /= np.linalg.norm(pole)
    horizon = np.radians(62.7)
    for one, azimuth_deg, title in ((axes[0], 0.0, "day side"), (axes[1], None, "terminator")):
        azimuth = np.radians(azimuth_deg) if azimuth_deg is not None else terminator_azimuth(nadir, sun, pole, horizon)
        side = np.cos(azimuth) * np.cross(pole, nadir) + np.sin(azimuth) * pole
        limb = np.cos(horizon) * nadir + np.sin(horizon) * side
        attitude = upright(limb, nadir)
        rate, _ = renderer.focal_plane.background_rate_e_s(telescope_scene(renderer, scene, attitude))
        drawn = one.imshow(np.maximum(rate, 1.0), cmap="cividis", norm=LogNorm(1.0, 3e9))
        one.set_title(f"Earth's limb from 800 km, {title}", fontsize=9)
        one.set_xticks([])
        one.set_yticks([])
    figure.colorbar(drawn, ax=axes, label="electrons per second and pixel", shrink=0.85)
    figure.savefig(IMAGES / "earth-limb.png", dpi=100)


def terminator_azimuth(nadir: FloatArray, sun: FloatArray, pole: FloatArray, horizon: float) -> float:
    """Azimuth of the point of the horizon where the Sun is at the horizon as well."""
    azimuth = np.linspace(0.0, np.pi, 2000)
    side = np.cos(azimuth)[:, None] * np.cross(pole, nadir) + np.sin(azimuth)[:, None] * pole
    vertical = -np.sin(horizon) * nadir + np.cos(horizon) * side
    return float(azimuth[np.argmin(np.abs(vertical @ sun))])


def upright(boresight: FloatArray, nadir: FloatArray) -> Attitude:
    """Attitude with the nadir downwards in the image."""
    down = nadir - (nadir @ boresight) * boresight
    down /= np.linalg.norm(down)
    return Attitude.from_matrix(np.stack([np.cross(down, boresight), down, boresight]), "icrs", "camera")


if __name__ == "__main__":
    IMAGES.mkdir(exist_ok=True)
    whole_sky()
    moon_and_planets()
    earth_limb()
