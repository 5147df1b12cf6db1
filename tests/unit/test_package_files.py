"""Files about the package: they agree with each other, and name what exists."""

import re
from pathlib import Path

from ruamel.yaml import YAML

from startracker._version import __version__

ROOT = Path(__file__).resolve().parents[2]


def text(name):
    return (ROOT / name).read_text(encoding="utf-8")


def test_the_citation_is_of_this_version():
    citation = YAML(typ="safe").load(text("CITATION.cff"))
    assert citation["version"] == __version__
    assert citation["license"] == "BSD-3-Clause"
    assert {"cff-version", "message", "title", "authors"} <= set(citation)


def test_the_changelog_has_this_version_first():
    headings = re.findall(r"^## (\S+)", text("CHANGELOG.md"), re.MULTILINE)
    assert headings[0] == __version__


def test_the_workflow_runs_the_checks_of_the_project():
    jobs = YAML(typ="safe").load(text(".github/workflows/ci.yml"))["jobs"]
    commands = [step.get("run") for job in jobs.values() for step in job["steps"]]
    assert ".ci/run" in commands
    assert "make dist" in commands


def test_the_image_of_the_container_is_made_of_files_that_exist():
    copied = re.findall(r"^COPY (?!--from)(.+) \S+$", text("Dockerfile"), re.MULTILINE)
    names = [name for line in copied for name in line.split()]
    assert "simulator" in names
    for name in names:
        assert (ROOT / name).exists()
        assert f"!{name}" in text(".dockerignore").splitlines()


def test_contributing_names_what_exists():
    document = text("CONTRIBUTING.md")
    for name in re.findall(r"`((?:simulator|startracker|tests|docs|scenarios|examples)/[^`*]+)`", document):
        assert name.startswith("docs/_build") or (ROOT / name).exists(), name
    targets = re.findall(r"^([a-z-]+):", text("Makefile"), re.MULTILINE)
    for target in re.findall(r"`make ([a-z-]+)`", document):
        assert target in targets, target
