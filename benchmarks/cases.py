"""Benchmark cases, on which other programs are measured as well, with this tracker's targets."""

from __future__ import annotations

from benchmarks.scenes import Case

_ALL = (
    Case("10deg 6.5, 0.1 px", target=0.999),
    Case("10deg 6.5, 0.3 px, 3 false", noise_px=0.3, false_stars=3),
    Case("10deg 6.5, 0.3 px, 5 false", noise_px=0.3, false_stars=5, target=0.997),
    Case("10deg 6.5, 0.3 px, 3 false, 20% dropped", noise_px=0.3, false_stars=3, dropped=0.2, target=0.985),
    Case("10deg 6.5, 1 px", noise_px=1.0, target=0.995),
    Case("10deg 6.5, 1 px, 5 false, 20% dropped", noise_px=1.0, false_stars=5, dropped=0.2, target=0.97),
    Case("10deg 6.5, focal length 1% wrong", focal_error=0.01, target=0.997),
    Case("10deg 6.0, 0.1 px", magnitude_limit=6.0, target=0.988),
    Case(
        "10deg 6.0, 0.3 px, 3 false, 20% dropped",
        magnitude_limit=6.0,
        noise_px=0.3,
        false_stars=3,
        dropped=0.2,
        target=0.91,
    ),
    Case("20deg 5.5, 0.1 px", fov_deg=20.0, magnitude_limit=5.5),
    Case(
        "20deg 5.5, 0.3 px, 3 false, 20% dropped",
        fov_deg=20.0,
        magnitude_limit=5.5,
        noise_px=0.3,
        false_stars=3,
        dropped=0.2,
    ),
    Case(
        "20deg 5.5, 1 px, 5 false, 20% dropped",
        fov_deg=20.0,
        magnitude_limit=5.5,
        noise_px=1.0,
        false_stars=5,
        dropped=0.2,
        target=0.995,
    ),
    Case("10deg 6.5, 2 px, 0.4 mag, 4 false", noise_px=2.0, noise_mag=0.4, false_stars=4, target=0.97),
    Case("10deg 6.5, fields of six, 0.3 px", noise_px=0.3, true_stars=6, target=0.99),
    Case("10deg 6.5, six brightest alone, 0.3 px", noise_px=0.3, brightest=6, target=0.99),
    Case("10deg 6.5, 0.3 px, 100 false", noise_px=0.3, false_stars=100, target=0.90),
    Case("8 random points", sky=False, false_stars=8),
    Case("15 random points", sky=False, false_stars=15),
    Case("25 random points", sky=False, false_stars=25),
    Case("100 random points", sky=False, false_stars=100),
)

CASES: dict[str, Case] = {case.name: case for case in _ALL}
MILLION = "10deg 6.5, 0.3 px, 3 false, 20% dropped"
"""The case of the long run."""
RANDOM_SHARES = {
    "8 random points": 0.8,
    "15 random points": 0.18,
    "25 random points": 0.016,
    "100 random points": 0.004,
}
"""Distribution of the frames of a long run of random points: more where chance matches are likely."""
ACCURACY = tuple(case.name for case in _ALL if case.noise_px == 0.1 and case.focal_error == 0.0 and case.sky)
"""Cases whose accuracy is compared with the oracle's."""


def matching(words: list[str]) -> list[Case]:
    """Cases by `chosen`."""
    return [CASES[name] for name in chosen(words, list(CASES))]


def chosen(words: list[str], names: list[str]) -> list[str]:
    """Names equal to one of the words, or else containing it; all names if there are no words."""
    if not words:
        return names
    whole = [word for word in words if word in names]
    parts = [word for word in words if word not in names]
    return [name for name in names if name in whole or any(part in name for part in parts)]
