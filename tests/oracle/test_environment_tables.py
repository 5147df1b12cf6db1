"""Numbers of the published tables and formulas of the radiation environment, one by one."""

import math

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from simulator.environment import matter
from simulator.environment.coefficients import COEFFICIENTS
from simulator.environment.galactic import HELIUM, MODULATION_MV, PROTON, GalacticCosmicRays, intensity
from simulator.environment.solar import event_fluence

# (low, nominal, high) as the sources state them; ranges that no source states are those of docs/environment.md
COEFFICIENT_RANGES = {
    "trapped_protons": (0.5, 1.0, 2.0),
    "trapped_electrons": (0.5, 1.0, 2.0),
    "galactic_flux": (0.8, 1.0, 1.25),
    "galactic_secondaries": (1.0, 1.0, 14.0),
    "niel_scale": (0.80, 0.85, 1.0),
    "dark_damage_factor": (1.3e5, 1.9e5, 2.5e5),
    "annealing": (0.45, 0.72, 1.0),
    "dark_activation": (0.63, 0.63, 0.63),
    "dose_per_interaction": (32_000.0, 42_200.0, 50_000.0),
    "telegraph_centres": (20.0, 30.0, 35.0),
    "telegraph_amplitude": (1000.0, 1200.0, 1400.0),
    "telegraph_low_time": (194.0, 194.0, 194.0),
    "telegraph_high_time": (97.0, 97.0, 97.0),
    "transfer_damage": (0.7e-6, 5.4e-6, 2.9e-5),
    "serial_transfer_share": (0.05, 0.1, 0.2),
    "glass_cerium": (0.0004, 0.0007, 0.0015),
    "glass_standard": (0.004, 0.012, 0.036),
}


def test_coefficients_and_their_ranges_are_those_of_the_sources():
    found = {name: (c.low, c.value, c.high) for name, c in COEFFICIENTS.items()}
    assert found == COEFFICIENT_RANGES


def test_tables_of_protons_are_smooth():
    """Each row beside a cubic spline in logarithms through all others: silicon within 0.3 % from 1 MeV, where the next
    points are at most a factor of 2 away, and 5 % at 0.2 and 0.5 MeV at the maximum of the stopping power; the
    non-ionising loss within 2.2 %, and 8 % at 2 GeV, whose neighbours are at 1 and 10 GeV. A misprint of a tenth
    shows."""
    energy = np.log(matter._PROTONS[:, 0])
    for column, tolerances in ((3, {0.2: 0.05, 0.5: 0.03}), (4, {2000.0: 0.08})):
        values = np.log(matter._PROTONS[:, column])
        for k in range(1, len(energy) - 1):
            others = np.arange(len(energy)) != k
            off = math.exp(values[k] - CubicSpline(energy[others], values[others])(energy[k])) - 1.0
            assert abs(off) < tolerances.get(matter._PROTONS[k, 0], 0.022), (column, k)


def test_ends_of_the_tables_of_protons():
    """NIST PSTAR and SR-NIEL at 0.1 MeV and 10 GeV, to the printed digits."""
    for energy, stopping, loss in ((0.1, 284.2, 0.4798), (1e4, 1.601, 0.0011364)):
        assert matter.proton_stopping_silicon(energy) == pytest.approx(stopping, rel=1e-9)
        assert matter.proton_niel_silicon(energy) == pytest.approx(loss, rel=1e-9)
    assert matter.proton_range_g_cm2([0.1, 1e4]) == pytest.approx([3.602e-4, 6287.0], rel=1e-9)


def test_stopping_powers_of_aluminium_and_silicon_differ_as_their_atoms_do():
    """Above 100 MeV by Z/A, 0.48181/0.49848, and by ln(2 m c² β²γ²/I): 0.98 to 0.985."""
    fast = matter._PROTONS[matter._PROTONS[:, 0] >= 100.0]
    assert np.all(np.abs(fast[:, 3] / fast[:, 1] - 0.9832) < 0.003)


def test_density_correction_of_silicon():
    """Sternheimer, Berger & Seltzer 1984: above x₁ = 2.8715 the correction is 2 ln(10) x − 4.4351, below x₀ = 0.2014 it
    is 0.14 × 10^(2 (x − x₀)), and between them it is larger than the first by 0.14921 (x₁ − x)^3.2546; for aluminium
    with 4.2395, 0.1708, 0.12, 0.08024, 3.0127, 3.6345. The two branches meet at x₀ to 0.03."""
    x = np.array([0.1, 1.0, 3.5])
    rising = 2.0 * math.log(10.0) * x
    silicon = [0.14 * 10.0 ** (2.0 * -0.1014), rising[1] - 4.4351 + 0.14921 * 1.8715**3.2546, rising[2] - 4.4351]
    aluminium = [0.12 * 10.0 ** (2.0 * -0.0708), rising[1] - 4.2395 + 0.08024 * 2.0127**3.6345, rising[2] - 4.2395]
    assert matter._density_effect(x, matter.SILICON) == pytest.approx(silicon, rel=1e-12)
    assert matter._density_effect(x, matter.ALUMINIUM) == pytest.approx(aluminium, rel=1e-12)
    for medium, bound in ((matter.SILICON, 0.2014), (matter.ALUMINIUM, 0.1708)):
        below, above = matter._density_effect(np.array([bound - 1e-9, bound + 1e-9]), medium)
        assert above == pytest.approx(below, abs=0.03)


def test_electrons_lose_energy_in_silicon_by_its_charge_and_excitation():
    """Difference of the two media at 10 keV, where the density correction is below 0.1 %: Z/A (ln(T/I)² + …), with I of
    173 and 166 eV (ICRU 37)."""
    tau = 0.01 / 0.510_998_95
    beta2 = tau * (tau + 2.0) / (tau + 1.0) ** 2
    common = math.log1p(tau / 2) + (1 - beta2) * (1 + tau**2 / 8 - (2 * tau + 1) * math.log(2.0))
    each = [z_a * (2.0 * math.log(1e4 / i_ev) + common) for z_a, i_ev in ((0.49848, 173.0), (0.48181, 166.0))]
    found = matter.electron_stopping(0.01) / matter.electron_stopping(0.01, matter.ALUMINIUM)
    assert found == pytest.approx(each[0] / each[1], rel=1e-3)
    # NIST ESTAR: 16.90 MeV cm²/g in silicon at 10 keV
    assert matter.electron_stopping(0.01) == pytest.approx(16.90, rel=0.0035)


def test_interstellar_protons_are_those_of_usoskin():
    """Usoskin et al. 2005, eq. 3: 1.9e4 P^−2.78 / (1 + 0.4866 P^−2.51) with P = √(T (T + 2 × 0.938)), by hand at 1 GeV
    (P = 1.6960) and 0.2 GeV (P = 0.64445); without modulation the spectrum is that."""
    assert intensity(PROTON, [1.0, 0.2], 0.0) == pytest.approx([3873.9, 26_136.0], rel=1e-3)


def test_helium_is_modulated_by_half_and_is_a_twentieth():
    """Φ = φ Z/A per nucleon; Usoskin et al. 2005: helium is 5 % of the protons at the same energy per nucleon."""
    for energy in (0.3, 2.0, 30.0):
        assert intensity(HELIUM, energy, 800.0) == pytest.approx(0.05 * intensity(PROTON, energy, 400.0), rel=1e-12)


def test_flux_of_helium_is_the_integral_above_its_rigidity():
    """R = A/Z √(T (T + 2 m c²)) with 0.9315 GeV a nucleon: 1 GeV per nucleon is 3.384 GV. 0.3 %: the trapezoidal rule
    on the 1,201 points of the table. Far above the pole nothing is hidden, and the cut-off is nil."""
    energy = np.geomspace(1.0, 1000.0, 20_001)
    density = intensity(HELIUM, energy, 400.0)
    expected = 4.0 * math.pi * 1e-4 * float(np.sum(0.5 * (density[1:] + density[:-1]) * np.diff(energy)))
    assert MODULATION_MV == {"min": 400.0, "max": 1000.0}
    far = np.array([[0.0, 0.0, 6.0e5]])
    assert GalacticCosmicRays("min").flux_cm2_s(far, 3.3841)[1][0] == pytest.approx(expected, rel=3e-3)


def test_events_of_king_at_the_ends_of_their_spectrum():
    """7.9e9 exp((30 − E) / 26.5) protons/cm² (King 1974), at 10 and 200 MeV; nothing above."""
    event = event_fluence(1.0)
    assert event.integral([10.0, 200.0]) == pytest.approx([1.6804e10, 1.2938e7], rel=1e-3)
    assert event.integral(201.0) == 0.0
