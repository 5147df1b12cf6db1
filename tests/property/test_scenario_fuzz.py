"""Whatever is in a file, loading it gives a `Scenario` or a `ScenarioError` of one-line messages, never a traceback."""

import warnings
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st

from simulator.scenario import Scenario, ScenarioError
from simulator.scenario.fields import all_keys
from startracker.errors import InputWarning

TEXT = (Path(__file__).resolve().parents[2] / "scenarios/cubesat_ideal.yaml").read_text(encoding="utf-8")
PIECES = ["\t", "  ", ":", ": ", "- ", "[", "]", "{", "}", "&a ", "*a", "!x ", "? ", "|", ">", "#", "'", '"', "%", "\\"]
PIECES += ["---\n", "...\n", "~", ".nan", "-1", "1e999", "0x", "null", "true", "<<: ", "base: x.yaml\n", "name: a\n"]
PIECES += ["\n", "\r", "\x00", "\ufeff", "\u2028", "é"]
KEYS = [key.path for key in all_keys()]


def attempt(text, overrides=()):
    problems = ()
    try:
        with warnings.catch_warnings():  # the answer to a valid setting of another identifier
            warnings.filterwarnings("ignore", ".*: not used by the identifier", InputWarning)
            scenario = Scenario.parse(text, overrides, name="fuzz.yaml")
            assert Scenario.parse(scenario.to_yaml()) == scenario
    except ScenarioError as error:
        problems = error.problems
        lines = str(error).splitlines()
    if problems:
        assert all(p.message for p in problems)
        assert len(lines) == len(problems)
        assert all(line.startswith(("fuzz.yaml", "--set")) for line in lines)


@settings(deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, len(TEXT)), st.integers(0, 12), st.sampled_from(PIECES)), min_size=1, max_size=6)
)
def test_mutated_files(edits):
    text = TEXT
    for at, cut, piece in edits:
        text = text[:at] + piece + text[at + cut :]
    attempt(text)


@settings(deadline=None)
@given(st.text(max_size=80))
def test_any_text(text):
    attempt(text)


scalars = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8)
values = st.recursive(
    scalars, lambda v: st.lists(v, max_size=4) | st.dictionaries(st.text(max_size=4), v, max_size=3), max_leaves=6
)


@settings(deadline=None)
@given(st.sampled_from(KEYS), values)
def test_any_value_of_any_key(path, value):
    attempt(TEXT, [f"{path}={flow(value)}"])


@settings(deadline=None)
@given(st.text(max_size=30))
def test_any_option(text):
    attempt(TEXT, [text])


def flow(value):
    from simulator.scenario.output import yaml_value

    if isinstance(value, dict):
        return "{" + ", ".join(f"{yaml_value(k)}: {flow(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(flow, value)) + "]"
    return yaml_value(value)
