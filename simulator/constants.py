"""Physical constants of the simulator with units and sources, and how often its processes collect garbage."""

GARBAGE_THRESHOLDS = (10_000, 20, 20)
"""Of `gc.set_threshold`, for processes that compile. Compiling makes millions of objects that are referenced until it
ends; by default Python searches for garbage after every 700 new ones, a tenth of the time of a first run."""

EARTH_RADIUS_KM = 6378.137
"""Equatorial radius; WGS 84."""

EARTH_GM_KM3_S2 = 398_600.4418
"""Geocentric gravitational constant, atmosphere included; WGS 84 / IERS Conventions 2010 (TCG-compatible value)."""

EARTH_J2 = 1.08262668e-3
"""Second zonal harmonic, unnormalised; EGM96 / Vallado 2013, table D-5."""

EARTH_ZONALS = (EARTH_J2, -2.532_656_49e-6, -1.619_621_59e-6, -2.272_960_83e-7, 5.406_812_39e-7)
"""Zonal harmonics J2 to J6, unnormalised; EGM96 / Vallado 2013, table D-5."""

PLANCK_J_S = 6.626_070_15e-34
"""Exact, SI 2019."""

BOLTZMANN_J_K = 1.380_649e-23
"""Exact, SI 2019."""

ELEMENTARY_CHARGE_C = 1.602_176_634e-19
"""Exact, SI 2019."""

SECONDS_PER_YEAR = 365.25 * 86_400.0
"""Julian year."""

TROPICAL_YEAR_S = 365.2422 * 86_400.0
"""Tropical year, in which the Sun returns to the equinox; Explanatory Supplement 2013."""

DEFAULT_B_V = 0.6
"""Colour assumed for a star with unknown B−V: about the median of stars brighter than V = 9."""

RADIUS_KM = {
    "Mercury": 2440.53,
    "Venus": 6051.8,
    "Mars": 3396.19,
    "Jupiter": 71492.0,
    "Saturn": 60268.0,
    "Uranus": 25559.0,
    "Neptune": 24764.0,
    "Earth": EARTH_RADIUS_KM,
    "Moon": 1737.4,
    "Sun": 695_700.0,
}
"""Equatorial radii: IAU working group (Archinal et al. 2018); Sun: IAU 2015 Resolution B3."""
