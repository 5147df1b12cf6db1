"""Pictures of the radiation environment: particles along the orbit, and ageing."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from simulator.study.environment.survey import ANOMALY_CM2_S, EnvironmentSurvey
from simulator.study.plots import BLUE, GREEN, GREY, ORANGE, VERMILION, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LEAST_CM2_S = 0.01


def environment_figures(result: EnvironmentSurvey) -> dict[str, Figure]:
    """All pictures by the names of their files."""
    return {"particles": particles_figure(result), "ageing": ageing_figure(result)}


def particles_figure(result: EnvironmentSurvey) -> Figure:
    """Particles through the detector over the first day, and their map along the ground track of a month."""
    figure, grid = picture(2, 1, (10, 8.6), height_ratios=(1.0, 1.25))
    over_time, chart = grid[:, 0]
    hours, flux = result.day.t_s / 3600.0, result.day.flux
    curves = (
        ("galactic cosmic rays", flux.galactic_protons + flux.galactic_helium, GREEN, "-"),
        ("trapped electrons", flux.trapped_electrons, ORANGE, "-"),
        ("trapped protons", flux.trapped_protons.sum(axis=1), BLUE, "-"),
    )
    for label, values, colour, style in curves:
        if values.max() > 0:
            over_time.semilogy(hours, np.where(values > _LEAST_CM2_S, values, np.nan), style, color=colour, label=label)
    over_time.axhline(ANOMALY_CM2_S, color=GREY, linestyle=":", lw=1.0)
    passes = result.anomaly()
    over_time.set_xlabel("hours after the epoch")
    over_time.set_ylabel("particles through the detector [/cm²/s]")
    over_time.set_xlim(0.0, 24.0)
    over_time.set_ylim(_LEAST_CM2_S, None)
    over_time.legend(fontsize=8, loc="lower center", ncols=3, bbox_to_anchor=(0.5, 1.0))
    figure.suptitle(
        f"{result.name}: {passes['passes']:g} passes of the South Atlantic Anomaly in the first day "
        f"(protons above {ANOMALY_CM2_S:g} /cm²/s for {100 * passes['share_of_time']:.1f} % of the time)",
        fontsize=10,
    )
    _chart(figure, chart, result)
    return figure


def _chart(figure: Figure, ax: Axes, result: EnvironmentSurvey) -> None:
    month = result.month
    total = np.maximum(month.flux.total, _LEAST_CM2_S)
    order = np.argsort(total, kind="stable")
    scale: dict[str, Any] = {"cmap": "cividis", "s": 9, "linewidths": 0}
    shown = ax.scatter(
        month.longitude_deg[order], month.latitude_deg[order], c=np.log10(total[order]), vmin=-1.5, vmax=4.0, **scale
    )
    bar = figure.colorbar(shown, ax=ax, pad=0.02, extend="both")
    bar.set_ticks([-1, 0, 1, 2, 3, 4], labels=["0.1", "1", "10", "100", "1000", "10⁴"])
    bar.set_label("particles through the detector [/cm²/s]")
    protons = month.flux.trapped_protons.sum(axis=1)
    if protons.max() > ANOMALY_CM2_S:
        peak = int(protons.argmax())
        where = (float(month.longitude_deg[peak]), float(month.latitude_deg[peak]))
        ax.plot(*where, "x", color="white", ms=9, mew=3.4)
        label = f"most protons: {protons[peak]:.0f} /cm²/s at latitude {where[1]:.0f}°, longitude {where[0]:.0f}°"
        ax.plot(*where, "x", color=VERMILION, ms=8, mew=1.6, label=label)
        ax.legend(fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    ax.set_xlim(-180, 180)
    ax.set_ylim(-90, 90)
    ax.set_xticks(range(-180, 181, 60))
    ax.set_yticks(range(-90, 91, 30))
    ax.set_xlabel("east longitude [°]")
    ax.set_ylabel("latitude [°]")


def ageing_figure(result: EnvironmentSurvey) -> Figure:
    """Dose by shield; increase of the dark current, random telegraph pixels and transmission of the glass with age."""
    figure, grid = picture(2, 2, (10, 7.4))
    _doses(grid[0, 0], result)
    environment = result.environment
    dark = {name: [d.mean_dark_e_s for d in rows] for name, rows in result.ageing.items()}
    telegraph = {name: [100 * d.telegraph.pixel_fraction for d in rows] for name, rows in result.ageing.items()}
    glass = {name: [100 * d.transmission for d in rows] for name, rows in result.ageing.items()}
    _band(grid[0, 1], result, dark, "mean increase of the dark current [e⁻/s/pixel]")
    _band(grid[1, 0], result, telegraph, "random telegraph pixels [%]")
    _band(grid[1, 1], result, glass, "transmission of the glass, relative [%]")
    if environment.glass == "none":
        grid[1, 1].set_title("environment.glass: none (no darkening)", fontsize=9)
    figure.suptitle(
        f"{result.name}: behind {environment.shield_mm:g} mm of aluminium, solar {environment.solar}imum; "
        "band: all coefficients at their low and high ends",
        fontsize=10,
    )
    return figure


def _doses(ax: Axes, result: EnvironmentSurvey) -> None:
    thickness = list(result.shields)
    parts = (
        ("trapped protons", [d.protons_krad for d in result.shields.values()], BLUE),
        ("trapped electrons", [d.electrons_krad for d in result.shields.values()], ORANGE),
        ("solar protons", [d.solar_krad for d in result.shields.values()], GREEN),
    )
    for label, values, colour in parts:
        if max(values) > 0:
            ax.loglog(
                thickness, np.where(np.array(values) > 1e-4, values, np.nan), "o-", ms=3.5, color=colour, label=label
            )
    ax.loglog(thickness, [d.ionising_krad for d in result.shields.values()], "--", color=GREY, label="all")
    ax.axvline(result.environment.shield_mm, color=VERMILION, linestyle=":", lw=1.2)
    ax.set_xlabel("aluminium [mm]")
    ax.set_xticks([1, 2, 3, 5, 10, 20], labels=["1", "2", "3", "5", "10", "20"])
    ax.minorticks_off()
    ax.set_ylabel(f"ionising dose in {result.environment.age_years:g} years [krad(Si)]")
    ax.legend(fontsize=8)


def _band(ax: Axes, result: EnvironmentSurvey, values: dict[Any, list[float]], label: str) -> None:
    ax.fill_between(result.ages, values["low"], values["high"], color=BLUE, alpha=0.2, linewidth=0)
    ax.plot(result.ages, values["nominal"], color=BLUE)
    ax.set_xlabel("years in orbit")
    ax.set_ylabel(label)
    ax.set_xlim(0.0, float(result.ages[-1]))
