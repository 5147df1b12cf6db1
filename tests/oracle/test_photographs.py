"""Real photographs against positions that two or three independent solvers agree on.

Source: the table in ../shared/sky/README.md (beside the checkout, not part of it; the tests skip where it is missing).
Tolerance: the stated agreement of the solvers plus 0.02° for the centre, 2 % for the field, whose definition differs
where the lens distorts.
"""

import math
from pathlib import Path

import numpy as np
import pytest

from startracker import read_image, solve_unknown_fov
from startracker.geometry.attitude import radec_to_direction

FOLDER = Path(__file__).parents[3] / "shared" / "sky"
PHOTOGRAPHS = {
    "night_alt40_azi-135.tiff": (230.6677, 11.0359, 11.42, 0.0007),
    "night_alt40_azi045.tiff": (355.2048, 58.1518, 11.42, 0.0002),
    "night_alt60_azi-045.tiff": (212.2124, 64.2006, 11.43, 0.0012),
    "hale_bopp.jpg": (42.455, 45.800, 15.46, 0.005),
    "orion_belt.jpg": (84.010, -0.770, 10.11, 0.0012),
    "virgo.jpg": (189.251, 5.952, 20.34, 0.007),
    "short_exposure_50ms.jpg": (53.203, 13.276, 10.95, 0.0015),
    "faint_6deg.png": (169.986, 13.750, 6.078, 0.0),
}

pytestmark = pytest.mark.skipif(not FOLDER.is_dir(), reason="the photographs of ../shared/sky are not here")


@pytest.mark.parametrize("hint", [True, False])
@pytest.mark.parametrize("name", PHOTOGRAPHS)
def test_centre_and_field(name, hint):
    ra_deg, dec_deg, fov_deg, agreement_deg = PHOTOGRAPHS[name]
    loaded = read_image(FOLDER / name)
    known = {"fov_deg": 1.01 * fov_deg, "fov_error": 0.03} if hint else {}
    solution = solve_unknown_fov(loaded.image, saturation_dn=loaded.saturation_dn, **known)
    assert solution.solved, solution.reason
    camera = solution.camera
    middle = camera.unproject([[(camera.width - 1) / 2, (camera.height - 1) / 2]])
    expected = radec_to_direction(math.radians(ra_deg), math.radians(dec_deg))
    found = solution.attitude.inverse.apply(middle)[0]
    assert math.degrees(math.acos(min(1.0, float(found @ expected)))) < agreement_deg + 0.02
    assert solution.fov_deg == pytest.approx(fov_deg, rel=0.02)
    assert solution.parity == 1
    assert np.sqrt(np.mean(solution.stars.residual_px**2)) < 0.6


@pytest.mark.parametrize("name", PHOTOGRAPHS)
def test_a_mirrored_photograph_is_found_mirrored(name):
    loaded = read_image(FOLDER / name)
    mirrored = np.ascontiguousarray(loaded.image[:, ::-1])
    solution = solve_unknown_fov(mirrored, saturation_dn=loaded.saturation_dn)
    assert solution.solved, solution.reason
    assert solution.parity == -1
    assert solution.fov_deg == pytest.approx(PHOTOGRAPHS[name][2], rel=0.02)


def test_a_picture_with_a_tree_is_not_solved_wrongly():
    loaded = read_image(FOLDER / "tree.jpg")
    solution = solve_unknown_fov(loaded.image, saturation_dn=loaded.saturation_dn)
    if solution.solved:
        expected = radec_to_direction(math.radians(268.435), math.radians(-8.327))
        assert math.degrees(math.acos(float(solution.attitude.boresight @ expected))) < 0.5
