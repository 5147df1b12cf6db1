"""Groups of commands that suggest what was meant, and mistakes in the use of a command as one line."""

from __future__ import annotations

import contextlib
import difflib
import re
from collections.abc import Iterator
from typing import Any

import typer
from typer.core import TyperGroup

from simulator.cli.streams import OutputError

_ORDER = ("run", "render", "sweep", "study", "solve", "calibrate", "report", "compare", "validate", "show", "schema")
"""Of the commands in help; others follow as they were registered."""


class SuggestingGroup(TyperGroup):
    """A group whose help lists commands in the order of their use, and which suggests the nearest known name."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        order = [name for name in _ORDER if name in self.commands]
        self.commands = {name: self.commands[name] for name in (*order, *self.commands)}

    def make_context(self, *arguments: Any, **more: Any) -> Any:
        """Read the arguments."""
        with _not_typers_own_exit():
            return super().make_context(*arguments, **more)

    def invoke(self, ctx: Any) -> Any:
        """Run the command."""
        with _not_typers_own_exit():
            return super().invoke(ctx)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command of a name."""
        if args and not args[0].startswith("-") and args[0] not in self.commands:
            close = difflib.get_close_matches(args[0], self.commands, n=1)
            hint = f"did you mean '{close[0]}'?" if close else f"choose from {', '.join(self.commands)}"
            kind = "study" if ctx.info_name == "study" else "command"
            ctx.fail(f"'{args[0]}' is not a {kind}; {hint}")
        return super().resolve_command(ctx, args)


@contextlib.contextmanager
def _not_typers_own_exit() -> Iterator[None]:
    """Ctrl-C as `typer.Abort` and errors of the system as `OutputError`, which reach the caller.

    typer and rich themselves make a silent exit of an interrupt and of a closed pipe.
    """
    try:
        yield
    except KeyboardInterrupt:
        raise typer.Abort from None
    except OSError as error:
        raise OutputError(error) from error
    except SystemExit as end:
        if isinstance(end.__context__, BrokenPipeError):  # from rich.console.Console.on_broken_pipe
            raise OutputError(end.__context__) from end
        raise


def _plain_number(match: re.Match[str]) -> str:
    return "must be a whole number" if match[1] == "integer" else "must be a number"


def usage_error_line(error: typer.TyperException) -> str:
    """One line for a wrong command, option or argument, with the command whose help says more."""
    context = getattr(error, "ctx", None)
    command = "boresight" if context is None else context.command_path
    option = getattr(error, "option_name", "")
    possible = getattr(error, "possibilities", None)
    if option and possible is not None:
        best = difflib.get_close_matches(option, possible, n=1) or sorted(possible)[:1]
        text = f"{option}: no such option" + (f"; did you mean '{best[0]}'?" if best else "")
    else:
        text = error.format_message() if hasattr(error, "format_message") else str(error)
        text = re.sub(r"Input should be a valid (integer|number), unable to parse .*", _plain_number, text)
    return f"{command}: {' '.join(text.split())} (see {command} --help)"
