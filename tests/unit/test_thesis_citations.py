"""Authors and titles of the two theses, wherever the repository names them.

Source: the title pages. B. C. Greyling, M.Eng., University of Stellenbosch, 1995; Tammy K. Yee, M.Sc., University of
Saskatchewan, 1999.
"""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FOLDERS = ("simulator", "startracker", "scenarios", "notebooks", "docs", "tests", "benchmarks")
ENDINGS = {".py", ".md", ".yaml", ".csv", ".ipynb", ".json", ".c", ".h", ".html", ".toml", ".txt"}

GREYLING = "A Charge Coupled Device Star Sensor System for a Low Earth Orbit Microsatellite"
YEE = "Attitude Determination Using Stellar Images"

INITIALS = re.compile(r"\b((?:Tammy )?(?:[A-Z]\. ?){1,2})(Greyling|Yee)\b")
RIGHT = {"Greyling": ("B. C.",), "Yee": ("T. K.", "Tammy K.")}
WRONG_TITLES = re.compile(r"CCD star sensor system for|attitude from stellar image", re.IGNORECASE)
QUOTED_TITLE = re.compile(r'\b(Greyling|Yee)(?: 1995| 1999)?,? (?:\(?(?:1995|1999)\)?, )?["*](?!")([A-Z][^"*]+)["*]')


def texts():
    found = [path for folder in FOLDERS for path in (ROOT / folder).rglob("*") if path.suffix in ENDINGS]
    found += [path for path in ROOT.iterdir() if path.suffix in ENDINGS]
    for path in sorted(found):
        if path != Path(__file__) and "__pycache__" not in path.parts:
            # lines of a comment joined, so that a name across a line break is found
            yield path.relative_to(ROOT), re.sub(r"\s*\n[\s#]*", " ", path.read_text(encoding="utf-8"))


def faults(text):
    initials = [
        (m.group(), " ".join(m.group(1).replace(".", ". ").split()), m.group(2)) for m in INITIALS.finditer(text)
    ]
    wrong = [found for found, letters, name in initials if letters not in RIGHT[name]]
    wrong += WRONG_TITLES.findall(text)
    titles = {"Greyling": GREYLING, "Yee": YEE}
    return wrong + [m.group(2) for m in QUOTED_TITLE.finditer(text) if m.group(2).rstrip(".,") != titles[m.group(1)]]


def test_no_wrong_author_or_title_in_the_tree():
    found = {str(path): wrong for path, text in texts() if (wrong := faults(text))}
    assert found == {}


@pytest.mark.parametrize(
    "text",
    [
        "J. F. Greyling, 1995",
        "J. Greyling",
        "S. Yee (Saskatchewan)",
        "by C. Yee",
        "A CCD star sensor system for a low Earth orbit",
        'Yee 1999, "Determination of attitude from stellar images"',
        "Yee, *Stars*, M.Sc.",
        'Greyling 1995, "Star Sensors"',
    ],
)
def test_a_wrong_citation_is_found(text):
    assert faults(text)


def test_the_right_citations_pass_and_are_there():
    assert faults(f'B. C. Greyling, *{GREYLING}*; T. K. Yee, *{YEE}*; Greyling 1995, "{GREYLING}".') == []
    page = (ROOT / "docs" / "theses.md").read_text(encoding="utf-8")
    readme = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    for name, title in (("B. C. Greyling", GREYLING), ("T. K. Yee", YEE)):
        assert f"{name}, *{title}*" in page
        assert f"{name}, *{title}*" in readme
