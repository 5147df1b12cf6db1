"""Draw docs/images/solved-frame.jpg: a frame of cubesat_ideal.yaml pointed at Orion, solved, with what is in the field.

python docs/make_images/solved_frame.py
"""

from __future__ import annotations

import io
from pathlib import Path

from PIL import Image

from simulator import Scenario
from simulator.renderer import Renderer
from startracker import Attitude, StarTracker
from startracker.annotation.annotate import annotated_picture
from startracker.images.star_colours import tinted

IMAGES = Path(__file__).resolve().parents[1] / "images"


def main() -> None:
    scenario = Scenario.load("cubesat_ideal", ["detector.exposure_s=0.4"])
    frame, truth = Renderer(scenario).frame(0, attitude=Attitude.from_radec_roll(83.6, -3.6, 0.0))
    tracker = StarTracker(frame.camera, magnitude_limit=6.5)
    solution = tracker.solve(
        frame.image, observer=frame.observer, saturation_dn=frame.saturation_dn, gain_e_per_dn=frame.gain_e_per_dn
    )
    stars = truth.sources
    shown = tinted(frame.image, stars.xy, stars.electrons, stars.b_v)
    picture = annotated_picture(shown, solution, names=30, grid=True, constellations=True, observer=frame.observer)
    with Image.open(io.BytesIO(picture)) as large:
        small = large.convert("RGB").resize((900, round(900 * large.height / large.width)), Image.Resampling.LANCZOS)
    small.save(IMAGES / "solved-frame.jpg", quality=90, subsampling=0, optimize=True)


if __name__ == "__main__":
    main()
