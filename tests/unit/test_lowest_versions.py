"""The constraints of `make test-lowest` are the lower bounds of pyproject.toml."""

import re
import tomllib
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def lowest():
    specification = spec_from_file_location("lowest_versions", ROOT / "tests" / "lowest_versions.py")
    module = module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def test_every_dependency_has_its_lower_bound(lowest):
    lines = lowest.constraints()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    names = [re.split("[><=]", requirement)[0] for requirement in project["dependencies"]]
    assert [line.split("==")[0] for line in lines][: len(names)] == names
    assert all(re.fullmatch(r"[\w.-]+==\d[\w.]*", line) for line in lines)


def test_a_dependency_without_a_bound_is_refused(lowest, tmp_path):
    file = tmp_path / "pyproject.toml"
    file.write_text('[project]\ndependencies = ["numpy"]\n[project.optional-dependencies]\ntest = []\n')
    with pytest.raises(ValueError, match="numpy: needs a lower bound"):
        lowest.constraints(file)


def test_classifiers_name_the_versions_of_python(lowest):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    named = {line.rpartition(" ")[2] for line in project["classifiers"] if line.startswith("Programming Language")}
    assert {"3.11", "3.12", "3.13"} <= named
    assert project["requires-python"] == ">=3.11"
