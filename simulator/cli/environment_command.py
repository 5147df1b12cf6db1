"""``boresight study environment``: radiation along the orbit and ageing."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from simulator.cli.options import ScenarioFile, SetValues, option, switch
from simulator.cli.terminal import open_console, print_table

if TYPE_CHECKING:
    from rich.console import Console

    from simulator.study.environment.survey import EnvironmentSurvey


def environment_study(
    scenario: ScenarioFile,
    set_values: SetValues = None,
    out: Annotated[
        Path | None, option("--out", "DIR", "Folder for the results; default: out/NAME-environment.")
    ] = None,
    force: Annotated[bool, switch("--force", "Replace results of another scenario or version in DIR.")] = False,
) -> int:
    """Radiation along the orbit: particles of each frame, dose by shield, and ageing with its range."""
    from simulator.checks import load_scenario
    from simulator.study.environment.plots import environment_figures
    from simulator.study.environment.survey import survey
    from simulator.study.result_files import write_study
    from simulator.study.results_folder import study_folder

    loaded = load_scenario(scenario, set_values)
    with study_folder("environment", loaded, out, force, environment=True) as (folder, identity):
        with open_console(error=True).status("computing"):
            result = survey(loaded)
        figures = environment_figures(result)
        files = write_study(folder, "environment", result.summary(), identity, figures, result.to_table())
    _print_environment(result, open_console())
    print(f"{folder}: {', '.join(files)}")
    return 0


def _print_environment(result: EnvironmentSurvey, console: Console) -> None:
    summary, environment = result.summary(), result.environment
    titles = {
        "galactic": "galactic cosmic rays",
        "trapped_protons": "trapped protons",
        "trapped_electrons": "trapped electrons",
        "total": "all",
    }
    rows = [
        (
            title,
            *(_number(summary["flux_cm2_s"][kind][value]) for value in ("median", "mean", "max")),
            *(_number(summary["particles_per_frame"][kind][value]) for value in ("median", "max")),
        )
        for kind, title in titles.items()
    ]
    passes = summary["anomaly_first_day"]
    print_table(
        console,
        f"{result.name}: particles through the detector behind {environment.shield_mm:g} mm of aluminium",
        ("", "median /cm²/s", "mean", "most", "median per frame", "most per frame"),
        rows,
    )
    console.print(
        f"South Atlantic Anomaly: {passes['passes']} passes in the first day, "
        f"{100 * passes['share_of_time']:.1f} % of the time (protons above {passes['above_cm2_s']:g} /cm²/s)"
    )
    doses = [
        (
            f"{mm:g}",
            *(f"{part:.3g}" for part in (d.protons_krad, d.electrons_krad, d.solar_krad, d.ionising_krad)),
            f"{d.displacement_mev_g:.2e}",
        )
        for mm, d in result.shields.items()
    ]
    headings = ("Al mm", "protons krad", "electrons", "solar", "all", "displacement MeV/g")
    print_table(console, f"dose in silicon in {environment.age_years:g} years", headings, doses)
    _print_ageing(result, console)


def _print_ageing(result: EnvironmentSurvey, console: Console) -> None:
    low, nominal, high = (result.at_age(estimate) for estimate in ("low", "nominal", "high"))
    aged = (low, nominal, high)
    rows = [
        ("dark current, mean increase, e⁻/s", *(f"{d.mean_dark_e_s:.3g}" for d in aged)),
        ("  interactions per pixel", *(f"{d.displacement.interactions_per_pixel:.3g}" for d in aged)),
        ("  dark current of one interaction, e⁻/s", *(f"{d.displacement.dark_e_s:.4g}" for d in aged)),
        ("random telegraph pixels, %", *(f"{100 * d.telegraph.pixel_fraction:.3g}" for d in aged)),
        ("  mean difference of their levels, e⁻/s", *(f"{d.telegraph.dark_e_s:.4g}" for d in aged)),
        ("transmission of the glass, %", *(f"{100 * d.transmission:.2f}" for d in aged)),
    ]
    if nominal.cti_parallel > 0:
        rows.append(("charge-transfer inefficiency, parallel", *(f"{d.cti_parallel:.2e}" for d in aged)))
    title = f"after {result.environment.age_years:g} years, at the detector's dark_reference_c"
    print_table(console, title, ("", "low", "nominal", "high"), rows)


def _number(value: float) -> str:
    return f"{value:.3g}" if value < 1e4 else f"{value:.0f}"
