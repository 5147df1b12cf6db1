"""The code blocks of README and of the documents run, and print what the pages show.

README, most tutorials and most guides run with every test; the others, among them the references with many long
commands, in `make test-all`.
"""

from pathlib import Path

import pytest
from document_blocks import ROOT, blocks, reduced, run_page, workspace

pytestmark = pytest.mark.system

DOCS = ROOT / "docs"
PAGES = [
    ROOT / "README.md",
    *sorted(DOCS.glob("*.md")),
    *sorted(DOCS.glob("tutorials/*.md")),
    *sorted(DOCS.glob("how-to/*.md")),
]
LONG = {"attitude", "camera", "choose-a-lens", "first-study", "orbit", "quantum-efficiency", "several-heads"}
"""Tutorials and guides with ten seconds and more of computing."""
QUICK = [p for p in PAGES if (p.parent != DOCS or p.stem == "index") and p.stem not in LONG]


def _with_code(pages: list[Path]) -> list[Path]:
    """Pages that have something to run."""
    code = {"sh", "console", "python", "yaml", "toml"}
    return [p for p in pages if any(b.language in code and not b.not_run for b in blocks(p.read_text("utf-8")))]


@pytest.mark.parametrize("page", _with_code(QUICK), ids=lambda page: page.stem)
@pytest.mark.filterwarnings("default")  # as a user runs them
def test_blocks_of_page_run(page, tmp_path, monkeypatch, no_drawing):
    """Their figures are drawn in the tests of each command; here it would be half of the time."""
    monkeypatch.setenv("MPLBACKEND", "Agg")
    with workspace(tmp_path):
        run_page(page)


@pytest.mark.slow
@pytest.mark.parametrize(
    "page", _with_code([p for p in PAGES if p not in QUICK]), ids=lambda page: f"{page.parent.name}-{page.stem}"
)
@pytest.mark.filterwarnings("default")
def test_blocks_of_reference_run(page, tmp_path, monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "Agg")
    with workspace(tmp_path):
        run_page(page)


def test_a_wrong_command_and_a_wrong_output_are_found(tmp_path):
    page = ROOT / "docs" / "index.md"
    for text, message in (
        ("```sh\nboresight solve nothing.png\n```\n", "ended with 2"),
        ("```sh\nls\n```\n", "not run here"),
        ("```yaml\noptics: {aperture: 3}\n```\n", "aperture"),
        ("```console\n$ boresight validate cubesat\nsomething else\n```\n", "something else than is shown"),
    ):
        wrong = tmp_path / page.name
        wrong.write_text(text, encoding="utf-8")
        folder = tmp_path / str(len(text))
        folder.mkdir()
        with workspace(folder, photographs=False), pytest.raises(Exception, match=message):
            run_page(wrong)


@pytest.mark.parametrize(
    ("command", "becomes"),
    [
        ("run cubesat --trials 5000 --workers 8", "run cubesat --trials 4 --workers 1"),
        ("run slew --sequence", "run slew --sequence --frames 4"),
        ("sweep cubesat --over a.b=6:24:10,log --over c=1,2,3", "sweep cubesat --over a.b=6:24:2,log --over c=1,2"),
        ("render cubesat", "render cubesat"),
    ],
)
def test_long_commands_are_reduced(command, becomes):
    assert " ".join(reduced(command.split())).startswith(becomes)
