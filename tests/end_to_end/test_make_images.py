"""The scripts that draw the pictures of the documents run, and draw the pictures that are committed."""

import runpy
import sys
from pathlib import Path

import pytest
from matplotlib.figure import Figure
from PIL import Image

pytestmark = pytest.mark.system

ROOT = Path(__file__).resolve().parents[2]
IMAGES = ROOT / "docs" / "images"
NEEDED = {"basilisk": "Basilisk"}
"""Optional package of a script."""
ARGUMENTS = {"live_page": ["--frames", "3"]}
"""The figures of its guide are of 25 frames after each of 20 changes, which take more than ten minutes."""
SCRIPTS = sorted((ROOT / "docs" / "make_images").glob("*.py"))


@pytest.mark.slow
@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
@pytest.mark.filterwarnings("default")
def test_script_draws_its_pictures(script, tmp_path, monkeypatch):
    if script.stem in NEEDED:
        pytest.importorskip(NEEDED[script.stem])
    monkeypatch.setenv("MPLBACKEND", "Agg")
    monkeypatch.setattr("sys.argv", [str(script), *ARGUMENTS.get(script.stem, [])])
    monkeypatch.setattr("sys.path", list(sys.path))
    drawn = []
    for kind, method, position in ((Figure, "savefig", 0), (Image.Image, "save", 0), (Path, "write_bytes", None)):
        original = getattr(kind, method)

        def elsewhere(self, *arguments, original=original, position=position, **options):
            target = self if position is None else arguments[position]
            if not isinstance(target, str | Path) or Path(target).resolve().parent != IMAGES:
                return original(self, *arguments, **options)
            drawn.append(Path(target).resolve())
            there = tmp_path / Path(target).name
            return original(there, *arguments) if position is None else original(self, there, *arguments[1:], **options)

        monkeypatch.setattr(kind, method, elsewhere)
    runpy.run_path(str(script), run_name="__main__")
    assert drawn
    for path in drawn:
        assert path.is_file(), f"{path.name} is not committed"
        with Image.open(tmp_path / path.name) as new, Image.open(path) as shown:
            assert new.size == pytest.approx(shown.size, rel=0.01)
