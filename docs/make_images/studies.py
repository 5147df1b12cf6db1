"""Draw docs/images/coverage.png and design.png: sky coverage and design of cubesat_ideal.yaml;
environment-particles.png and environment-ageing.png: the radiation environment of the gallery's `aged`.

python docs/make_images/studies.py
"""

from __future__ import annotations

from pathlib import Path

from simulator.checks import load_scenario
from simulator.study.coverage.maps import coverage_map
from simulator.study.coverage.survey import coverage
from simulator.study.design.plot import design_plot
from simulator.study.design.search import Trade, design
from simulator.study.design.verification import Verified
from simulator.study.environment.plots import ageing_figure, particles_figure
from simulator.study.environment.survey import survey
from startracker.images.picture import figure_bytes

IMAGES = Path(__file__).resolve().parents[1] / "images"


def main() -> None:
    cubesat = load_scenario("cubesat_ideal")
    (IMAGES / "coverage.png").write_bytes(figure_bytes(coverage_map(coverage(cubesat)), dpi=100))
    trade = design(cubesat, Trade("optics.aperture_mm", 3.0, 30.0))
    (IMAGES / "design.png").write_bytes(figure_bytes(design_plot(Verified(trade, ())), dpi=100))
    radiation = survey(load_scenario("aged"))
    for name, figure in (("particles", particles_figure(radiation)), ("ageing", ageing_figure(radiation))):
        (IMAGES / f"environment-{name}.png").write_bytes(figure_bytes(figure, dpi=100))


if __name__ == "__main__":
    main()
