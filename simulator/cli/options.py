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


def option(name: str, metavar: str, help_text: str) -> Any:
    """An option that takes a value."""
    return typer.Option(name, metavar=metavar, help=help_text)


def switch(name: str, help_text: str) -> Any:
    """An option that takes none."""
    return typer.Option(name, help=help_text)


ScenarioFile = Annotated[
    Path,
    typer.Argument(help="Scenario YAML, or one that ships (sunsat, cubesat, tc211, orbit, slew).", show_default=False),
]
SetValues = Annotated[
    list[str] | None,
    option("--set", "PATH=VALUE", "Override a key, e.g. optics.aperture_mm=25; may be repeated."),
]
Seed = Annotated[int | None, option("--seed", "S", "In place of the scenario's seed.")]
Dask = Annotated[
    str | None,
    option("--dask", "ADDRESS", "Run on the workers of the dask.distributed scheduler there instead."),
]
Catalog = Annotated[str, option("--catalog", "NAME", "Star catalogue: hipparcos or bsc5.")]


def as_command(request: type, module: str) -> Callable[..., None]:
    """A command whose arguments and options are the fields of `request`, and whose help is its docstring.

    ``simulator.cli.MODULE.main`` is given the request and returns the exit status; it loads when the command is called.
    """

    def command(**given: Any) -> None:
        raise typer.Exit(import_module(f"simulator.cli.{module}").main(request(**given)))

    command.__doc__ = request.__doc__
    command.__signature__ = inspect.signature(request, eval_str=True)  # type: ignore[attr-defined]  # for typer
    return command
