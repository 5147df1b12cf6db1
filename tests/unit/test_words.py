"""Comments, docstrings, messages and documents use the standard terms of the field."""

import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCANNED = (
    "simulator", "startracker", "docs", "scenarios", "benchmarks", "examples", "notebooks", "README.md", "CHANGELOG.md",
    "CONTRIBUTING.md",
)  # fmt: skip
SUFFIXES = (".py", ".md", ".yaml", ".c", ".h", ".j2", ".ipynb")

TERMS = {
    r"places?": "position (of a star or an image), index (in a table)",
    r"hits?": "cosmic-ray event",
    r"drawn out": "trailed, smeared",
    r"blemish(?:es|ed)?": "defective pixel",
    r"tells?|told": "distinguishes, classified as, reports, states",
    r"(?:so|how) sure": "confidence, uncertainty",
    r"knobs?": "parameter, setting",
    r"lamps?": "light source",
    r"normal numbers?": "Gaussian deviates",
    r"off focus|refocus(?:ed)?": "defocused; focal-length correction",
    r"marked sky": "occupancy map",
    r"leaf among leaves": "isolation test",
    r"few of many": "rare-case mask",
    r"noise model knows": "systematic error floor",
    r"honest(?:ly)?": "state the limitation",
    r"identified rightly": "correctly identified",
    r"more trials would": "run more trials to decide",
    r"Trials a point": "Trials per point",
    r"(?:electrons|photons|degrees|radians|pixels|px|DN|mas|ns|µs|ms|°|″|trials|frames|stars|fields|points|centroids"
    r"|lines|bits|rows|triads|spots|candidates|particles|MB) a"
    r" (?:second|pixel|frame|trial|star|day|year|step|line|unit|point|run|image|turn|field)": "per second, per star",
    r"rightly": "correctly",
    r"anew": "again; a new copy",
    r"(?:not|is) to be had": "not available",
    r"tak(?:e|es|en) off": "subtracted",
    r"for people": "for display",
    r"beforehand": "a priori, prior",
    r"stands? still": "static, at rest, inertially fixed",
    r"could be [\d.]+ times": "margin 74×",
    r"band holds": "95 % band for a consistent covariance",
    r"fit to [\d.]+ (?:pixels|px)": "centroid residual 0.023 px rms",
    r"is no (?:number|image|file|folder|rotation|name|spacing|star|section|list|plate|camera)": "is not a",
    r"no image of it": "image shape does not match the camera",
    r"words of a pixel": "random bits",
    r"slip of the pen|nobody": "state the fact",
    r"by luck": "by chance",
    r"found out": "determined",
    r"stands? (?:there|in DIR)": "exists, contains, in DIR",
    r"(?:of|with) workers of its own|of one's own": "its own workers, your own",
}
"""Word that is not used here, as a regular expression, and what the field says."""

ALLOWED = (
    r"\b[Ii]n(?:to)?[ -]place(?: of)?\b",  # an array modified in place; one thing in place of another
    r"tak(?:es?|ing) place\b",
    r"(?:decimal|binary) places?\b",
    r"\bblemish(?:ed)?_\w+",  # settings and columns of the rules of operation, which users meet
    r"\"blemishes\"|\.blemishes\b",  # a key of sequence.json, and the map that it counts
    r"reject_hits\b",  # a setting of detection
)
"""Phrases in which such a word is right."""

_TERM = re.compile(
    r"(?<![\w-])(?=\w)(?:" + "|".join(f"(?P<t{k}>{term})" for k, term in enumerate(TERMS)) + r")(?![\w-])"
)
_ALLOWED = re.compile("|".join(ALLOWED))


def found(line: str) -> list[str]:
    """Words of a line that are not used here, each with what the field says."""
    terms = list(TERMS.values())
    return [
        f"'{match[0]}': {terms[int(match.lastgroup[1:])]}"
        for match in _TERM.finditer(_ALLOWED.sub("", line))
        if match.lastgroup
    ]


def _files() -> list[Path]:
    """Files that are checked."""
    every = [p for name in SCANNED for p in ([ROOT / name] if (ROOT / name).is_file() else (ROOT / name).rglob("*"))]
    made = {"generated", "_build"}  # of the site, from what is checked here, as are the copies in docs/notebooks
    names = {p: p.relative_to(ROOT).as_posix() for p in every if p.suffix in SUFFIXES and not made & set(p.parts)}
    return sorted(p for p, name in names.items() if not name.startswith("docs/notebooks/"))


def _text(path: Path) -> str:
    """Text of a file; of a notebook its cells without their outputs."""
    text = path.read_text(encoding="utf-8")
    return "\n".join("".join(cell["source"]) for cell in json.loads(text)["cells"]) if path.suffix == ".ipynb" else text


def test_texts_use_the_terms_of_the_field():
    faults = [
        f"{path.relative_to(ROOT)}:{number}: {fault}"
        for path in _files()
        for number, line in enumerate(_text(path).splitlines(), 1)
        for fault in found(line)
    ]
    assert not faults, "\n".join(faults)


@pytest.mark.parametrize(
    "line",
    [
        "# the places of the stars",
        "2 hits rejected",
        "told from a star",
        "1200 electrons a second",
        "a knob",
        "28 stars identified rightly",
        "whose positions fit to 0.023 pixels",
        "the band holds 95 % of trackers",
        "the error could be 74.2 times as large",
        "Trials a point",
        "3 trials a second",
        "is no number",
    ],
)
def test_a_word_of_another_language_is_found(line):
    assert found(line)


@pytest.mark.parametrize(
    "line", ["sorted in place", "NaN in place of zero", "to three decimal places", "blemish_frames: int", "reject_hits"]
)
def test_a_right_phrase_passes(line):
    assert not found(line)
