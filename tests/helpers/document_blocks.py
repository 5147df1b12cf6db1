"""Code blocks of the documents: found, run in a folder of their own, and their shown output compared or written.

======== ===========================================================================================================
sh       commands, run with few trials and few frames (`reduced`); nothing is compared
console  commands after ``$``, run as they stand; below them what they print, compared without its numbers
python   run, all blocks of a page in one namespace
yaml     keys of a scenario, checked on top of ``cubesat``
toml     parsed
text     what is not a code
======== ===========================================================================================================

A comment before a block changes this: ``<!-- not run: reason -->``; ``<!-- file: NAME -->`` saves the block under this
name first; ``<!-- output -->`` is a text block with what the Python block before it prints. ``<!-- picture: NAME as
PATH -->`` anywhere says which file of a command is a picture of the page.

``python tests/helpers/document_blocks.py PAGE.md ...`` runs pages and writes the outputs and pictures into them.
"""

from __future__ import annotations

import contextlib
import functools
import io
import os
import re
import shlex
import subprocess
import sys
import tempfile
import tomllib
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
LANGUAGES = ("sh", "console", "python", "yaml", "toml", "text")
ELEMENTS = """\
ISS (ZARYA)
1 25544U 98067A   24087.50000000  .00016717  00000-0  30571-3 0  9997
2 25544  51.6400 208.9163 0006317  69.9862  25.2906 15.49309432440163
"""
"""The file of satellites that the page on the sky names: a reader's scenario is refused without it."""
IGNORED = ("{toctree}", "{eval-rst}", "{grid}", "{image}", "{figure}")
"""Directives of the site, which are no code."""

_FENCE = re.compile(
    r"(?:^<!-- (?P<mark>not run|file|output)(?:: (?P<about>.+?))? -->\n+)?"
    r"^(?P<fence>`{3,})(?P<language>[^\n`]*)\n(?P<text>.*?)^(?P=fence)[ ]*$",
    re.MULTILINE | re.DOTALL,
)
_PICTURE = re.compile(r"<!-- picture: (?P<file>\S+) as (?P<path>\S+) -->")


@dataclass(frozen=True)
class Block:
    """One fenced block: language, text, line of its first line of text, and its mark."""

    language: str
    text: str
    line: int
    not_run: str = ""
    file: str = ""
    is_output: bool = False
    span: tuple[int, int] = (0, 0)


def blocks(document: str) -> list[Block]:
    """Every fenced code block of a document."""
    found = []
    for match in _FENCE.finditer(document):
        language = match["language"].strip()
        if language.startswith(IGNORED):
            continue
        line = document.count("\n", 0, match.start("text")) + 1
        about = {match["mark"]: match["about"]}
        found.append(
            Block(
                language,
                match["text"],
                line,
                not_run=about.get("not run", ""),
                file=about.get("file", ""),
                is_output="output" in about,
                span=match.span("text"),
            )
        )
    return found


# ---- commands


_LESS = {
    "run": {"--trials": "4", "--workers": "1"},
    "sequence": {"--frames": "4"},
    "sweep": {"--trials": "3", "--workers": "1"},
    "study coverage": {"--boresights": "200"},
    "study design": {"--boresights": "200", "--steps": "3", "--verify": "2"},
    "study budget": {"--trials": "2", "--workers": "1"},
    "study greyling1995": {"--section": "path"},
    "study yee1999": {"--section": "databases"},
    "export-c": {"--magnitude-limit": "5"},
}
"""Options with which a command of a document is run, in place of its own or in addition."""


def reduced(arguments: list[str]) -> list[str]:
    """A boresight command with few trials, frames and points."""
    words = [word for word in arguments if not word.startswith("-")]
    name = " ".join(words[:2]) if words[:1] == ["study"] else words[0]
    name = "sequence" if "--sequence" in arguments else name
    name = f"{name} --scenario" if name == "export-c" and "--scenario" in arguments else name  # has no fewer stars
    kept = list(arguments)
    for option, value in _LESS.get(name, {}).items():
        if option not in kept:
            kept += [option, value]
        elif option != "--section":
            kept[kept.index(option) + 1] = value
    if "--verify" in kept:
        kept[kept.index("--verify") + 1] = "2"
    for k, word in enumerate(kept):
        if word == "--over" and name == "sweep":
            kept[k + 1] = _two_values(kept[k + 1])
        elif word == "--lhs":
            kept[k + 1] = "2"
    return kept


def _two_values(over: str) -> str:
    """The values of a sweep's key, two of them."""
    key, _, values = over.partition("=")
    values = re.sub(r"^([^:,]+:[^:,]+):\d+", r"\1:2", values)
    if ":" not in values and "[" not in values:
        values = ",".join(values.split(",")[:2])
    return f"{key}={values}"


def command_lines(text: str) -> list[list[str]]:
    """The commands of a shell block, without comments, as lists of words; names with ``*`` become files."""
    commands = []
    for line in text.replace("\\\n", " ").splitlines():
        lexer = shlex.shlex(line, posix=True, punctuation_chars=";")
        lexer.whitespace_split, lexer.commenters = True, "#"
        command: list[str] = []
        for word in [*lexer, ";"]:
            if word != ";":
                command += sorted(map(str, Path().glob(word)))[:3] if "*" in word and "=" not in word else [word]
            elif command:
                commands.append(command)
                command = []
    return commands


def run_command(words: list[str]) -> str:
    """Run a command of boresight in this process; what it prints on standard output.

    `make -C FOLDER` is run in a folder that a command wrote; of other targets of make it is checked that they exist.

    Raises
    ------
    AssertionError
        If it fails, or is not a command that a block may have without the mark ``not run``.
    """
    if words[:2] == ["make", "-C"]:
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{shlex.join(words)} ended with {done.returncode}: {done.stderr}"
        return ""
    if words[0] == "make":
        targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
        assert set(words[1:]) <= set(targets), f"make has no target {' '.join(words[1:])}"
        return ""
    assert words[0] == "boresight", f"'{words[0]}' is not run here; mark the block: <!-- not run: reason -->"
    from simulator.cli import _run

    out, errors = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(errors):
        code = _run(words[1:])
    assert code == 0, f"{shlex.join(words)} ended with {code}: {errors.getvalue()}{out.getvalue()}"
    return out.getvalue()


def sessions(text: str) -> list[tuple[str, str]]:
    """Commands of a console block, each with the output shown below it."""
    parts = re.split(r"^\$ ", text, flags=re.MULTILINE)
    assert not parts[0].strip(), "a console block begins with '$ '"
    return [(command, output) for command, _, output in (part.partition("\n") for part in parts[1:])]


def without_numbers(output: str) -> list[str]:
    """Words of an output that do not depend on the machine or on the last digit."""
    text = re.sub(r"[─━│┃┏┓┡┩└┘├┤┼╇┳┴┬┌┐╭╮╰╯…]", " ", output)
    text = re.sub(r"[-+−]?\d[\d.,:]*(?:e[-+]?\d+)?|–", "0", text)
    return text.split()


# ---- pages


def run_page(path: Path, *, write: bool = False) -> None:
    """Run all blocks of a page in the current folder; with `write`, put the outputs and pictures into the page.

    Raises
    ------
    AssertionError
        With the page and the line of a block that fails, or whose shown output is not what is printed.
    """
    document = path.read_text(encoding="utf-8")
    names: dict[str, object] = {"__name__": "__page__"}
    new: list[tuple[tuple[int, int], str]] = []
    shown = ""
    for block in blocks(document):
        where = f"{path.name}:{block.line}"
        assert block.language in LANGUAGES, f"{where}: the language of a block is one of {', '.join(LANGUAGES)}"
        if block.file:
            Path(block.file).write_text(block.text, encoding="utf-8")
        if block.not_run or (block.language == "text" and not block.is_output):
            continue
        try:
            shown = shown if block.is_output else _run_block(block, where, names)
        except AssertionError as error:
            raise AssertionError(f"{where}: {error}") from None
        if block.language == "console" or block.is_output:
            new.append((block.span, shown))
            if not write:
                told = (
                    f"{where}: prints something else than is shown; `make docs-outputs` writes into the page:\n{shown}"
                )
                assert without_numbers(shown) == without_numbers(block.text), told
    for match in _PICTURE.finditer(document):
        assert Path(match["file"]).is_file(), f"{path.name}: no command wrote {match['file']}"
        if write:
            save_picture(Path(match["file"]), path.parent / match["path"])
    if write:
        for (start, stop), text in reversed(new):
            document = document[:start] + text + document[stop:]
        path.write_text(document, encoding="utf-8")


def save_picture(source: Path, target: Path) -> None:
    """A picture for a page: not wider than 1200 pixels."""
    from PIL import Image

    with Image.open(source) as picture:
        picture.thumbnail((1200, 1600))
        (picture.convert("RGB") if target.suffix == ".jpg" else picture).save(target, optimize=True)


def _run_block(block: Block, where: str, names: dict[str, object]) -> str:
    if block.language == "python":
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            exec(compile(block.text, where, "exec"), names)
        return printed.getvalue()
    if block.language == "yaml" and not block.file:
        check_scenario(block.text)
    elif block.language == "toml":
        tomllib.loads(block.text)
    elif block.language == "sh":
        for words in command_lines(block.text):
            run_command(["boresight", *reduced(words[1:])] if words[0] == "boresight" else words)
    elif block.language == "console":
        shown = ""
        for command, _ in sessions(block.text):
            printed = "".join(run_command(_one_process(words)) for words in command_lines(command))
            lines = [line.rstrip() for line in printed.splitlines()]
            shown += "\n".join([f"$ {command}", *lines]) + "\n"
        return shown
    return ""


def _one_process(words: list[str]) -> list[str]:
    """The command as it stands, in this process: a study's results do not depend on the number of them."""
    return [*words, "--workers", "1"] if words[1:2] in (["run"], ["sweep"]) and "--workers" not in words else words


def check_scenario(text: str) -> None:
    """Whether keys are those of a scenario, with values in their range; what is missing is that of ``cubesat``."""
    from simulator.checks import load_scenario

    part = Path("block.yaml")
    part.write_text(text if "base:" in text else f"base: cubesat\n{text}", encoding="utf-8")
    load_scenario(part, [])


@contextlib.contextmanager
def workspace(folder: Path, *, photographs: bool = True):
    """Work in a folder where the documents find what they name: scenarios, elements, photographs, those for a fit."""
    (folder / "scenarios").symlink_to(ROOT / "scenarios")
    (folder / "active.tle").write_text(ELEMENTS, encoding="utf-8")
    before = Path.cwd()
    os.chdir(folder)
    try:
        if photographs:
            make_photographs()
        yield
    finally:
        os.chdir(before)


def make_photographs() -> None:
    """Files that a reader brings: photo.jpg with 8 bits, and three with 16 bits in photos/."""
    Path("photos").mkdir()
    for name, data in _photographs().items():
        Path(name).write_bytes(data)


@functools.cache
def _photographs() -> dict[str, bytes]:
    """The same for all pages."""
    import numpy as np
    from PIL import Image

    from simulator import Renderer, Scenario

    files = {}
    for k, (ra, dec) in enumerate([(83, 0), (80, 2), (86, -3)]):
        scenario = Scenario.load("cubesat", [f"pointing.target=[{ra}, {dec}, {40 * k}]", "sky.earth=false"])
        dn = Renderer(scenario).frame(0)[0].image
        picture = Image.fromarray((dn.astype(np.uint32) * 16).clip(0, 65535).astype(np.uint16))
        picture.save(tiff := io.BytesIO(), "tiff")
        files[f"photos/{k}.tiff"] = tiff.getvalue()
        if k == 0:
            picture = Image.fromarray((dn.astype(float) / 4).clip(0, 255).astype(np.uint8))
            picture.save(jpeg := io.BytesIO(), "jpeg", quality=95)
            files["photo.jpg"] = jpeg.getvalue()
    return files


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    for name in sys.argv[1:]:
        page = Path(name).resolve()
        with tempfile.TemporaryDirectory() as temporary, workspace(Path(temporary)):
            run_page(page, write=True)
        print(name)
