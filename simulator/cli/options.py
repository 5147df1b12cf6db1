"""Options that several commands take, and commands whose options are the fields of a request.

A request is a frozen dataclass: every option is declared once, with its help, its default and its type.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer


def option(name: str, metavar: str, help_text: str, panel: str | None = None) -> Any:
    """An option that takes a value; `panel` is the heading under which help lists it."""
    return typer.Option(name, metavar=metavar, help=help_text, rich_help_panel=panel)


def switch(name: str, help_text: str, panel: str | None = None) -> Any:
    """An option that takes none."""
    return typer.Option(name, help=help_text, rich_help_panel=panel)


def complete_scenario(incomplete: str) -> list[str]:
    """Included scenarios whose names begin as typed, for the shell."""
    from simulator.scenario.files import included_scenarios

    return [name for name in included_scenarios() if name.startswith(incomplete)]


def complete_key(incomplete: str) -> list[str]:
    """Keys of scenarios that begin as typed, for the shell."""
    from simulator.scenario.fields import all_keys

    return [f"{key.path}=" for key in all_keys() if key.path.startswith(incomplete)]


ScenarioFile = Annotated[
    Path,
    typer.Argument(
        metavar="SCENARIO",
        help="Scenario YAML, or an included scenario by name (cubesat, sunsat, moon ...).",
        show_default=False,
        autocompletion=complete_scenario,
    ),
]
ScenarioFiles = Annotated[
    list[Path],
    typer.Argument(
        metavar="SCENARIO...",
        help="Scenario YAMLs, or included scenarios by name.",
        show_default=False,
        autocompletion=complete_scenario,
    ),
]
SetValues = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="PATH=VALUE",
        help="Override a key, e.g. optics.aperture_mm=25; may be repeated.",
        autocompletion=complete_key,
    ),
]
Seed = Annotated[int | None, option("--seed", "S", "Seed; default: the scenario's.")]
Dask = Annotated[
    str | None,
    option("--dask", "ADDRESS", "Run on the workers of this dask.distributed scheduler."),
]
Catalog = Annotated[str, option("--catalog", "NAME", "Star catalogue: hipparcos, bsc5, gaia, or one that was added.")]


def as_command(request: type, module: str) -> Callable[..., None]:
    """A command whose arguments and options are the fields of `request`, and whose help is its docstring.

    ``simulator.cli.MODULE.main`` is given the request and returns the exit status; it loads when the command is called.
    """

    def command(**given: Any) -> None:
        raise typer.Exit(import_module(f"simulator.cli.{module}").main(request(**given)))

    command.__doc__ = request.__doc__
    command.__signature__ = inspect.signature(request, eval_str=True)  # type: ignore[attr-defined]  # for typer
    return command
