"""Free spin against Euler's equations.

Oracle: SciPy's DOP853 on I ω̇ = (I ω) × ω with I = diag(1, 1, r) and the kinematics of the attitude matrix,
dA/dt = −[ω×] A, at rtol = atol = 1e-12. Over 12.5 s (a turn) the integration keeps A orthogonal to 1e-10; the
tolerance of 1e-8 rad is that with a margin.
"""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from simulator.mission.parameters import Spin
from simulator.mission.spin import cone_rate_rad_s, spin_attitude, spin_rate_rad_s
from startracker.geometry.attitude import radec_to_direction


def spin(**keys):
    defaults = {
        "rate_deg_s": 28.8,
        "axis_deg": (349.085, 56.501),
        "phase_deg": 20.0,
        "cone_deg": 1.655,
        "cone_phase_deg": 191.57,
        "inertia_ratio": 1.209,
    }
    return Spin(**(defaults | keys))


@pytest.mark.parametrize(
    "keys",
    [{}, {"inertia_ratio": 0.1, "cone_deg": 12.0}, {"rate_deg_s": -28.8}, {"inertia_ratio": 1.0, "cone_deg": 30.0}],
    ids=["oedipus", "rod", "backwards", "sphere"],
)
def test_attitude_follows_eulers_equations(keys):
    section = spin(**keys)
    inertia = np.array([1.0, 1.0, section.inertia_ratio])

    def derivative(_t, state):
        matrix, rate = state[:9].reshape(3, 3), state[9:]
        x, y, z = rate
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        return np.concatenate([(-cross @ matrix).ravel(), np.cross(inertia * rate, rate) / inertia])

    start = np.concatenate([spin_attitude(section, 0.0).as_matrix().ravel(), spin_rate_rad_s(section, 0.0)])
    times = np.array([0.5, 4.0, 12.5])
    path = solve_ivp(derivative, (0.0, 12.5), start, method="DOP853", t_eval=times, rtol=1e-12, atol=1e-12)
    for t, state in zip(times, path.y.T, strict=True):
        np.testing.assert_allclose(spin_attitude(section, t).as_matrix(), state[:9].reshape(3, 3), atol=1e-8)
        np.testing.assert_allclose(spin_rate_rad_s(section, t), state[9:], atol=1e-8)


def test_angular_momentum_stands_still_on_the_given_axis():
    section = spin(cone_deg=5.0)
    axis = radec_to_direction(*np.radians(section.axis_deg))
    for t in (0.0, 3.3, 100.0):
        momentum = spin_attitude(section, t).inverse.apply(
            np.array([1.0, 1.0, section.inertia_ratio]) * spin_rate_rad_s(section, t)
        )
        np.testing.assert_allclose(momentum / np.linalg.norm(momentum), axis, atol=1e-12)
        assert spin_rate_rad_s(section, t)[2] == pytest.approx(np.radians(28.8), rel=1e-12)


def test_cone_and_phases_are_where_the_keys_say():
    section = spin(cone_deg=5.0, cone_phase_deg=90.0, axis_deg=(10.0, 0.0), phase_deg=0.0)
    towards = spin_attitude(section, 0.0).boresight  # +Z: five degrees east of the axis
    np.testing.assert_allclose(towards, radec_to_direction(*np.radians((15.0, 0.0))), atol=1e-12)
    still = spin(cone_deg=0.0, phase_deg=0.0, axis_deg=(0.0, 0.0))
    np.testing.assert_allclose(spin_attitude(still, 0.0).as_matrix()[0], [0.0, 1.0, 0.0], atol=1e-12)  # +X east
    assert cone_rate_rad_s(section) == pytest.approx(1.209 * np.radians(28.8) / np.cos(np.radians(5.0)))
