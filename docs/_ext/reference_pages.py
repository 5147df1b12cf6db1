"""Writes the pages that follow from the code: a scenario's keys, the commands, the Python names, the notebooks.

They go to docs/reference/generated and docs/notebooks, before Sphinx reads its sources. `scenario_pages`,
`command_pages` and `api_pages` return path and text of each page, which the tests read without a build.
"""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from public_names import GROUPS

if TYPE_CHECKING:
    from sphinx.application import Sphinx

DOCS = Path(__file__).parents[1]
GENERATED = DOCS / "reference" / "generated"
NOTEBOOKS = DOCS / "notebooks"

Pages = dict[str, str]
"""Path below docs/reference/generated, without suffix, to the page's text."""

KEYS_INTRODUCTION = """\
Every key that a scenario may have, with its unit, range and default. `boresight show SCENARIO` prints the same keys
with the values of a scenario, `boresight validate` checks a file, and `boresight schema` prints the JSON schema, with
which an editor completes and checks keys while you type."""
COMMANDS_INTRODUCTION = """\
`boresight COMMAND --help` prints the same text. A command ends with exit status 0 if it did what was asked, 1 if the
answer is negative (a field not solved, a specification not met), 2 after one line on standard error that says what to
correct, and 130 after Ctrl-C."""
API_INTRODUCTION = """\
The names of `simulator` and `startracker`. Angles are in degrees at the interface and in radians where the name or the
text says so; every name with a unit ends with it."""


def _toctree(names: list[str]) -> str:
    return "\n".join(["```{toctree}", ":hidden:", "", *names, "```"])


# ---- the keys of a scenario


def scenario_pages() -> Pages:
    """A page for each section of a scenario, and one for the keys at its top."""
    from simulator.scenario.fields import keys_of
    from simulator.scenario.schema import ScenarioModel

    top = keys_of(ScenarioModel)
    sections = [key for key in top.values() if key.section]
    index = [
        "# Scenario keys",
        "",
        KEYS_INTRODUCTION,
        "",
        "| section | content |",
        "|---|---|",
        *(f"| [`{key.name}`](scenario/{key.name}.md) | {key.description} |" for key in sections),
        "",
        "## Keys at the top level",
        "",
        *(line for key in top.values() if not key.section for line in _key_with_items(key)),
        _toctree([f"scenario/{key.name}" for key in sections]),
    ]
    pages = {"scenario": "\n".join(index)}
    for key in sections:
        lines = [f"# {key.name}", "", key.description, "", *_section(key.section, key.path)]
        pages[f"scenario/{key.name}"] = "\n".join(lines)
    return pages


def _section(section: Any, path: str, depth: int = 1) -> Iterator[str]:
    """Entries of a section's keys, plain ones first; each subsection below a heading of its own."""
    from simulator.scenario.fields import keys_of

    keys = keys_of(section, path).values()
    for key in keys:
        if key.section:
            continue
        yield from _key_with_items(key)
    for key in keys:
        if key.section:
            yield from ("#" * (depth + 1) + f" {key.path}", "", _inline(key.description), "")
            yield from _section(key.section, key.path, depth + 1)


def _key_with_items(key: Any) -> Iterator[str]:
    """Entry of a key, and of the keys of its items if it is a list of sections."""
    from simulator.scenario.fields import item_section, keys_of

    yield from _key(key)
    if item := item_section(key.annotation):
        for part in keys_of(item, f"{key.path}[]").values():
            yield from _key_with_items(part)


def _key(key: Any) -> Iterator[str]:
    from simulator.scenario.fields import MISSING, describe
    from simulator.scenario.output import yaml_value

    facts = [re.sub(r"'([^' ]+)'", r"`\1`", describe(key.annotation))]
    if key.unit:
        facts.append(key.unit)
    facts.append("required" if key.default is MISSING else f"default `{yaml_value(key.default)}`")
    yield from (f"::::{{key}} {key.path}", f"{{.facts}}\n{' · '.join(facts)}", "", _inline(key.description), "::::", "")


def _inline(text: str) -> str:
    """A docstring's text as Markdown: ``x`` becomes `x`, and Python's None is YAML's null."""
    return re.sub(r"\bNone\b", "null", text.replace("``", "`"))


# ---- the commands


def commands() -> dict[str, Any]:
    """Every command by its words, ``study coverage`` for example, in the order of the help."""
    from simulator.cli.application import app

    found: dict[str, Any] = {}

    def collect(command: Any, words: str) -> None:
        if subcommands := getattr(command, "commands", None):
            for name, part in subcommands.items():
                collect(part, f"{words} {name}".strip())
        elif not getattr(command, "hidden", False):
            found[words] = command

    collect(typer.main.get_command(app), "")
    return found


def command_pages() -> Pages:
    """A page for each command, and their list."""
    found = commands()
    index = [
        "# Commands",
        "",
        COMMANDS_INTRODUCTION,
        "",
        "| command | purpose |",
        "|---|---|",
        *(f"| [`{name}`](commands/{_file(name)}.md) | {_first_sentence(one.help)} |" for name, one in found.items()),
        "",
        _toctree([f"commands/{_file(name)}" for name in found]),
    ]
    pages = {"commands": "\n".join(index)}
    for name, command in found.items():
        pages[f"commands/{_file(name)}"] = "\n".join(_command(name, command))
    return pages


def _file(name: str) -> str:
    return name.replace(" ", "-")


def _first_sentence(text: str | None) -> str:
    line = _plain(text).split("\n\n")[0].replace("\n", " ").replace("|", "\\|")
    return re.split(r"(?<=\.) ", line)[0]


def _plain(text: str | None) -> str:
    """A help text without rich's markup of styles and without click's marks of paragraphs."""
    return re.sub(r"\[/?(?:bold|dim|cyan|green|red|yellow)\]", "", inspect.cleandoc(text or "").replace("\b\n", ""))


def _command(name: str, command: Any) -> Iterator[str]:
    arguments = [p for p in command.params if p.param_type_name == "argument"]
    options = [p for p in command.params if p.param_type_name == "option" and not p.hidden and p.name != "help"]
    words = " ".join(_metavar(argument) for argument in arguments)
    yield from (f"# boresight {name}", "", "```text", f"boresight {name} [OPTIONS] {words}".rstrip(), "```", "")
    yield from (_plain(command.help), "")
    if command.epilog:
        yield from (_plain(command.epilog), "")
    yield from (f"```{{program}} boresight {name}", "```", "")
    for title, parameters in (("Arguments", arguments), ("Options", options)):
        if parameters:
            yield from (f"## {title}", "")
        for parameter in parameters:
            signature = _metavar(parameter) if title == "Arguments" else _signature(parameter)
            yield from (f"::::{{option}} {signature}", _plain(parameter.help) + _default(parameter), "::::", "")


def _metavar(parameter: Any) -> str:
    return parameter.metavar or parameter.name.upper()


def _signature(parameter: Any) -> str:
    value = "" if parameter.is_flag else f" {_metavar(parameter)}"
    return ", ".join(f"{name}{value}" for name in [*parameter.opts, *parameter.secondary_opts])


def _default(parameter: Any) -> str:
    default = parameter.default
    if default in (None, False, True, ()) or callable(default) or parameter.required:
        return ""
    return f" Default: `{default}`."


# ---- the Python interface


def api_pages() -> Pages:
    """A page for each public name, and their list by group."""
    index = [
        "# Python interface",
        "",
        API_INTRODUCTION,
    ]
    pages: Pages = {}
    for title, names in GROUPS.items():
        index += ["", f"## {title}", "", "| name | purpose |", "|---|---|"]
        for name in names:
            pages[f"api/{name}"] = _api(name)
            index.append(f"| [`{name}`](api/{name}.md) | {summary(public_object(name))} |")
    index += ["", _toctree([f"api/{name}" for names in GROUPS.values() for name in names])]
    return {"api": "\n".join(index), **pages}


def public_object(name: str) -> Any:
    """The object of a dotted name."""
    module, _, attribute = name.rpartition(".")
    return getattr(import_module(module), attribute)


def summary(value: Any) -> str:
    """The first sentence of a docstring, in one line."""
    text = inspect.getdoc(value) or ""
    return re.split(r"(?<=[.:]) ", " ".join(text.split("\n\n")[0].split()).replace("``", "`").replace("|", "\\|"))[0]


def _api(name: str) -> str:
    value = public_object(name)
    lines = [f"# {name.rpartition('.')[2]}", "", "```{eval-rst}"]
    if inspect.isclass(value):
        lines += [f".. autoclass:: {name}", "   :members:", "   :member-order: bysource"]
    else:
        lines += [f".. autofunction:: {name}"]
    return "\n".join([*lines, "```", ""])


# ---- what lies beside docs/, as Sphinx reads nothing from there

BESIDE = {
    "../benchmarks/RESULTS.md": "reference/generated/RESULTS.md",
    "../benchmarks/RESULTS-identification.md": "reference/generated/RESULTS-identification.md",
    "../benchmarks/RESULTS-frames.md": "reference/generated/RESULTS-frames.md",
    "../examples/plugin/README.md": "reference/generated/plugin.md",
    "../CHANGELOG.md": "reference/generated/CHANGELOG.md",
}
"""Pages that the site shows in copies, by their paths from docs/ and below it."""


def copied_pages() -> Pages:
    """The changes and the results of the benchmarks, with their links to pages as seen from the copies."""
    return {
        Path(copy).stem: re.sub(r"\]\((?:\.\./)*docs/", "](../../", (DOCS / name).read_text(encoding="utf-8"))
        for name, copy in BESIDE.items()
    }


def link_to_copies(_app: Sphinx, docname: str, source: list[str]) -> None:
    """Links of a page to files beside docs/ lead to the copies."""
    up = "../" * docname.count("/")
    for name, copy in BESIDE.items():
        source[0] = source[0].replace(f"]({up}{name})", f"]({up}{copy})")


def copy_notebooks() -> None:
    """The notebooks, with their links to pages as seen from there."""
    NOTEBOOKS.mkdir(exist_ok=True)
    for source in sorted((DOCS.parent / "notebooks").glob("*.ipynb")):
        text = source.read_text(encoding="utf-8").replace("](../docs/", "](../")
        json.loads(text)
        _write(NOTEBOOKS / source.name, text)


def write_pages(_app: Sphinx | None = None) -> None:
    """Write what has changed, and delete what no longer exists."""
    pages = {**scenario_pages(), **command_pages(), **api_pages(), **copied_pages()}
    for name, text in pages.items():
        _write(GENERATED / f"{name}.md", text + "\n")
    for old in GENERATED.rglob("*.md"):
        if old.relative_to(GENERATED).as_posix().removesuffix(".md") not in pages:
            old.unlink()
    copy_notebooks()


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def setup(app: Sphinx) -> dict[str, bool]:
    """Scenario keys as objects of their own, so that the search and the index know them; the pages."""
    app.add_object_type("key", "key", indextemplate="single: %s; scenario key")
    app.connect("builder-inited", write_pages)
    app.connect("source-read", link_to_copies)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
