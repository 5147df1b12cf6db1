"""Synthetic constellations: the pattern, the lines, and the list that ships."""

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from sgp4.io import compute_checksum

from simulator.constants import EARTH_RADIUS_KM
from simulator.mission.clock import Clock
from simulator.mission.element_list import ElementList
from simulator.mission.walker import Walker, walker_tle

EPOCH = datetime(2026, 3, 21, 12, tzinfo=UTC)
ROOT = Path(__file__).resolve().parents[2]


def test_lines_have_their_columns_and_check_digits():
    lines = walker_tle(Walker(1200.0, 87.9, 18, 3, 1), EPOCH).splitlines()
    assert len(lines) == 54
    for k, line in enumerate(lines):
        if k % 3:
            assert (len(line), line[0]) == (69, str(k % 3))
            assert line[68] == str(compute_checksum(line))
    assert lines[1][18:32] == "26080.50000000"


def test_the_pattern(tmp_path):
    """Equal spacing along the orbit and of the planes; phase between neighbouring planes f · 360°/t (Walker 1984)."""
    path = tmp_path / "shell.tle"
    path.write_text(walker_tle(Walker(1200.0, 60.0, 24, 4, 1), EPOCH))
    orbits = ElementList.read(path, Clock(EPOCH), 1.0)
    elements = orbits.elements
    phase = np.degrees([e.mean_anomaly_rad for e in elements]).reshape(4, 6)
    node = np.degrees([e.node_rad for e in elements]).reshape(4, 6)
    assert np.allclose(np.diff(phase, axis=1), 60.0, atol=1e-4)
    assert np.allclose(np.diff(phase[:, 0]), 360.0 / 24, atol=1e-4)
    assert np.allclose(node, 90.0 * np.arange(4)[:, None], atol=1e-4)
    r_km, v_km_s = (x[:, 0] for x in orbits.states(np.zeros(1)))
    # J2 moves the osculating orbit by some 10 km
    assert np.linalg.norm(r_km, axis=1) == pytest.approx(EARTH_RADIUS_KM + 1200.0, abs=20.0)
    poles = np.cross(r_km, v_km_s)
    inclination = np.degrees(np.arccos(poles[:, 2] / np.linalg.norm(poles, axis=1)))
    # TEME's pole against that of GCRS: precession since 2000, 0.15°
    assert inclination == pytest.approx(60.0, abs=0.2)


def test_impossible_patterns_are_refused():
    for shell in (Walker(550.0, 53.0, 10, 3), Walker(550.0, 53.0, 12_000, 10)):
        with pytest.raises(ValueError, match="multiple of planes"):
            walker_tle(shell, EPOCH)


def test_the_list_that_ships_is_the_pattern_it_says():
    text = (ROOT / "scenarios" / "constellation.tle").read_text()
    assert text.startswith("# Synthetic: no real satellites.")
    body = "".join(line for line in text.splitlines(keepends=True) if not line.startswith("#"))
    assert body == walker_tle(Walker(550.0, 53.0, 1584, 72, 17, "SHELL"), EPOCH)
