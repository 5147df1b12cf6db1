"""Names that the notebooks use exist and are what they are used as; the notebooks themselves run in slow tests."""

import ast
import importlib
import inspect
import json
from pathlib import Path

import pytest

NOTEBOOKS = sorted((Path(__file__).resolve().parents[2] / "notebooks").glob("*.ipynb"))
OURS = ("simulator", "startracker", "benchmarks")


def code_of(path):
    """The code cells as one module, without the lines of IPython."""
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    lines = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code").splitlines()
    return ast.parse("\n".join("" if line.lstrip().startswith(("%", "!")) else line for line in lines))


def imported(tree):
    """Names that a notebook imports from our packages, with the objects; unknown ones are faults."""
    known, faults = {}, []
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module.split(".")[0] in OURS:
            module = importlib.import_module(node.module)
            for alias in node.names:
                try:
                    known[alias.asname or alias.name] = getattr(module, alias.name)
                except AttributeError:
                    try:
                        known[alias.asname or alias.name] = importlib.import_module(f"{node.module}.{alias.name}")
                    except ImportError:
                        faults.append(f"{node.module} has no {alias.name}")
        elif isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.split(".")[0] in OURS:
                    module = importlib.import_module(alias.name)
                    known[alias.asname or alias.name.split(".")[0]] = (
                        module if alias.asname else importlib.import_module(alias.name.split(".")[0])
                    )
    return known, faults


def resolved(node, known):
    """Object of a name or of attributes of modules and classes; None where it is not known before the code runs."""
    if isinstance(node, ast.Name):
        return known.get(node.id)
    if isinstance(node, ast.Attribute):
        owner = resolved(node.value, known)
        if inspect.ismodule(owner) or inspect.isclass(owner):
            return getattr(owner, node.attr, f"{ast.unparse(node)} does not exist")
    return None


def faults_of(tree):
    known, faults = imported(tree)
    stored = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
    known = {name: value for name, value in known.items() if name not in stored}
    for node in ast.walk(tree):
        found = resolved(node, known)
        if isinstance(found, str) and found.endswith("does not exist"):
            faults.append(found)
        if not isinstance(node, ast.Call):
            continue
        called = resolved(node.func, known)
        if called is None or isinstance(called, str):
            continue
        if not callable(called):
            faults.append(f"{ast.unparse(node.func)} is a {type(called).__name__}, and cannot be called")
            continue
        try:
            parameters = inspect.signature(called).parameters
        except ValueError:
            continue
        if any(p.kind is p.VAR_KEYWORD for p in parameters.values()):
            continue
        faults += [
            f"{ast.unparse(node.func)} has no argument {word.arg}"
            for word in node.keywords
            if word.arg and word.arg not in parameters
        ]
    return faults


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_uses_names_that_exist(path):
    assert faults_of(code_of(path)) == []


def test_stale_names_are_found():
    """As in the fifth cell of a notebook, from the day a function gave its name to a module."""
    tree = ast.parse(
        "from simulator.theses import yee1999\nfrom startracker import StarTracker, Camera, nothing\n"
        "yee1999.vega_tables(1)\nyee1999.no_such\nCamera.from_fov(10.0, 256, hight=256)\n"
        "yee1999.analyse(yee1999.vega())\n"
    )
    assert sorted(faults_of(tree)) == [
        "Camera.from_fov has no argument hight",
        "startracker has no nothing",
        "yee1999.no_such does not exist",
        "yee1999.vega_tables is a module, and cannot be called",
    ]
