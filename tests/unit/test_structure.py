"""The first page for whoever takes over states the rooms as they are."""

import re

import pytest
import structure

from startracker.geometry.attitude import Attitude

PAGE = structure.PAGE.read_text(encoding="utf-8")


@pytest.mark.parametrize("package", structure.ROOMS)
def test_the_page_has_every_room_with_its_lines(package):
    """Within a tenth, so that the table is written again when a room changes and not with every commit."""
    table = PAGE.split(f"**`{package}/`**")[1]
    for room, lines in structure.rooms(package).items():
        name = re.escape(structure.HELPERS if room == structure.HELPERS else structure._code(room))
        stated = int(re.search(rf"\| {name} \| ([\d,]+) \|", table)[1].replace(",", ""))
        assert stated == pytest.approx(lines, rel=0.1), f"{room}: python tests/helpers/structure.py --write"


def test_a_frame_visits_no_more_files_than_stated():
    for call, files in structure.visits().items():
        stated = int(re.search(rf"\| `{call}` \| (\d+) \|", PAGE)[1])
        assert len(files) <= stated, (call, files)
        assert len(files) > 20  # the profiler sees them


def test_what_is_called_is_seen():
    files = structure.visited(lambda: Attitude.from_radec_roll(1.0, 2.0, 3.0))
    assert "startracker/geometry/attitude.py" in files
    assert "startracker/geometry/camera.py" not in files  # imported by it or not
