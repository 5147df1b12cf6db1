"""Every scenario key, command, option, public name and result column has its description in the documents."""

import re
from pathlib import Path

import pytest
from document_blocks import IGNORED, LANGUAGES, blocks, without_numbers
from public_names import NOT_DOCUMENTED, OPTIONAL, documented
from reference_pages import api_pages, command_pages, commands, public_object, scenario_pages, summary

import simulator
import startracker
from simulator.scenario.fields import all_keys

ROOT = Path(__file__).parents[2]
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").glob("*.md"), *(ROOT / "docs").glob("[a-z]*/*.md")])
PAGES = [page for page in PAGES if "generated" not in page.parts]


def test_every_key_of_a_scenario_has_an_entry_with_its_facts():
    text = "\n".join(scenario_pages().values())
    for key in all_keys():
        assert key.description, f"{key.path} has no description"
        if key.section:
            continue
        start = re.escape(f"::::{{key}} {key.path}\n{{.facts}}\n")
        entry = re.search(rf"^{start}(.+)\n\n(.+)\n::::$", text, re.MULTILINE)
        assert entry, f"{key.path} has no entry"
        assert "default `" in entry[1] or "required" in entry[1]
        assert not key.unit or f"· {key.unit} ·" in entry[1]


def test_parts_of_lists_have_entries():
    text = "\n".join(scenario_pages().values())
    for path in ("optics.ghosts[].flux", "sequence.rates[].at_s", "sequence.dropouts[].duration_s"):
        assert f"{{key}} {path}\n" in text


def test_every_command_has_a_page_with_all_options():
    pages = command_pages()
    for name, command in commands().items():
        page = pages[f"commands/{name.replace(' ', '-')}"]
        assert command.help, f"boresight {name} has no help"
        for parameter in command.params:
            if parameter.name == "help" or getattr(parameter, "hidden", False):
                continue
            assert parameter.help or parameter.param_type_name == "argument", f"{name}: {parameter.name} has no help"
            assert parameter.param_type_name == "argument" or parameter.opts[0] in page


@pytest.mark.parametrize("package", [simulator, startracker])
def test_every_public_name_has_a_page(package):
    public = {f"{package.__name__}.{name}" for name in package.__all__}
    missing = public - set(documented()) - set(NOT_DOCUMENTED)
    assert not missing, f"docs/_ext/public_names.py lacks {', '.join(sorted(missing))}"


def test_every_page_of_a_name_has_a_description():
    pages = api_pages()
    for name in documented():
        assert f"api/{name}" in pages
        assert len(summary(public_object(name)).split()) >= 2, f"{name} has no docstring"


def test_names_that_the_documents_import_have_pages():
    imported = set()
    for page in PAGES:
        for block in blocks(page.read_text(encoding="utf-8")):
            if block.language == "python":
                for module, names in re.findall(r"^from ((?:startracker|simulator)\S*) import (.+)$", block.text, re.M):
                    imported |= {f"{module}.{name.strip()}" for name in names.split(",")}
    missing = {name for name in imported if not name.rpartition(".")[2].isupper()} - _reachable()
    assert not missing, f"imported in the documents, but without a page: {', '.join(sorted(missing))}"


def _reachable() -> set[str]:
    """Documented names, also under the modules in which they are defined, and modules."""
    names = set(documented())
    for name in documented():
        value = public_object(name)
        names.add(f"{value.__module__}.{name.rpartition('.')[2]}")
    return (
        names
        | set(OPTIONAL)
        | {
            "simulator.detector.chain",  # the guide that adds an effect
            "startracker.identification.Observed",
            "startracker.identification.adaptive",
            "startracker.identification.pyramid",
            "startracker.tracking.RateNoise",
            "startracker.tracking.TrackingSession",
        }
    )


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_blocks_have_a_language(page):
    for block in blocks(page.read_text(encoding="utf-8")):
        assert block.language in LANGUAGES, f"{page}:{block.line}: ```{block.language}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_links_lead_to_files(page):
    """Sphinx checks anchors as well when the site is built; this finds a moved page in a second."""
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", text):
        made = "generated/" in target or "notebooks/" in target
        if not made and not target.startswith("http"):
            assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_every_column_of_the_results_is_described():
    from simulator.scenario import Scenario
    from simulator.study.run import run

    small = ["detector.width=200", "detector.height=200", "detector.pixel_pitch_um=28"]
    study = run(Scenario.load("cubesat_ideal", small), trials=2)
    page = (ROOT / "docs" / "reference" / "files.md").read_text(encoding="utf-8")
    described = _described(page)
    assert set(study.columns) <= described, sorted(set(study.columns) - described)
    assert set(study.summary) <= described, sorted(set(study.summary) - described)


def test_columns_of_sequences_are_described_where_sequences_are():
    """The names in docs/sequences.md are those of the result files."""
    described = _described((ROOT / "docs" / "reference" / "files.md").read_text(encoding="utf-8"))
    for name in ("elapsed_s", "mode", "innovation_distance2", "true_rate_x_deg_s", "single_error_roll_deg", "rule"):
        assert name in described


def _described(page: str) -> set[str]:
    """Names in code in the first column of the tables, with their abbreviations written out."""
    axes = ("roll", "pitch", "yaw", "cross_x", "cross_y", "about_boresight")
    names = set()
    for row in re.findall(r"^\| (.+?) \| ", page.replace("\\|", "/"), re.MULTILINE):
        for name in re.findall(r"`([^`]+)`", row):
            names |= {name.replace("<axis>", axis).replace("<x/y/z>", letter) for axis in axes for letter in "xyz"}
    return names


def test_blocks_are_found_with_their_marks():
    text = "a\n<!-- not run: needs a cluster -->\n```sh\ndask scheduler\n```\n<!-- output -->\n```text\n1\n```\n"
    first, second = blocks(text)
    assert (first.language, first.not_run, first.line) == ("sh", "needs a cluster", 4)
    assert second.is_output
    assert not blocks(f"```{IGNORED[0]}\nx\n```\n")


def test_numbers_and_frames_of_tables_do_not_count():
    assert without_numbers("│ roll │ -0.17″ │ 41 ms") == without_numbers("┃ roll ┃ 12.4″ ┃ 7 ms")
    assert without_numbers("200 solved") != without_numbers("200 wrong")
